"""The analysis of a study in one process, beside `pandas.read_csv` of the same files: rows a second, and memory.

There is one thread: a second one would wait for Python's lock. `python -m benchmarks study_engines` has processes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from benchmarks.harness import Row, at_least, at_most, compared, measured
from mocapella.studies.analysis import analyze_file, merge
from mocapella.studies.recordings import find_recordings
from mocapella.studies.study_tables import tables_of

RECORDINGS = "MOCAPELLA_DATA"
"""Variable that names the folder of recordings, as for the tests."""
ROWS_PER_S = 90_000.0
MOST_MIB = 2048.0

_PEAK = """
import resource, sys
from pathlib import Path
from benchmarks.studies import analyzed
analyzed(Path(sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def analyzed(folder: Path) -> int:
    """Analyse a folder up to its tables; return the number of rows."""
    found = find_recordings(folder)
    results = merge(map(analyze_file, found.paths), found.findings)
    tables_of(results)
    return sum(one.rows for one in results.files)


def read_by_pandas(folder: Path) -> int:
    return sum(len(pd.read_csv(path, skipinitialspace=True)) for path in find_recordings(folder).paths)


def run(quick: bool = False) -> list[Row]:
    root = Path(__file__).resolve().parent.parent
    folder = Path(os.environ.get(RECORDINGS) or root.parent / "shared" / "data") / "kinectmultitrack"
    if not folder.is_dir():
        return []
    analyzed(folder)
    ours, peer = [], []
    rows = 0
    for _ in range(1 if quick else 5):
        for seconds, work in ((ours, analyzed), (peer, read_by_pandas)):
            begin = time.perf_counter()
            rows = work(folder)
            seconds.append(time.perf_counter() - begin)
    best, peers_best = min(ours), min(peer)
    memory = subprocess.run(
        [sys.executable, "-c", _PEAK, str(folder)], cwd=root, check=True, capture_output=True, text=True
    )
    name = f"studies: clean, pair, sum and tabulate {rows} rows"
    return [
        compared(
            name, 1e6 * best / rows, "µs/row", peer="pandas.read_csv, without more", peer_value=1e6 * peers_best / rows
        ),
        measured("studies: the same", rows / best, "rows/s", goal=at_least(ROWS_PER_S)),
        measured("studies: largest memory", float(memory.stdout), "MiB", goal=at_most(MOST_MIB)),
    ]
