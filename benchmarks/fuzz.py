"""Damaged input for every reader of files and messages: what escapes our errors, how long it takes, and what memory.

Valid inputs are damaged in bytes, in words (`_text_mutations`) and, of takes, in contents whose checksums are made
right again (`_take_mutations`). The same seed gives the same inputs. ``--inputs 1e8`` asks for so many.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

import psutil

from benchmarks._doors import Door, doors
from benchmarks.harness import Row, at_most, measured
from mocapella.errors import MocapellaError

SEED: Final = 23
INPUTS: Final = 1_000_000
QUICK: Final = 4_000
MOST_MIB: Final = 256
MOST_SECONDS: Final = 5.0
_MIB: Final = 1 << 20
_LOOK: Final = 64
"""Inputs between looks at the memory; after a slow one there is a look, too."""


PARTS: Final = (
    "frames", "scenes", "truths", "bridge stream", "marker datagrams", "OSC", "bus keys", "camera rigs",
    "sensor layouts", "hands", "boards", "runs of takes", "bodies' builds", "colours", "questions", "answers",
    "commands", "replies", "pairing codes", "session keys", "rings",
    "study logs", "study logs, packed", "image tracks", "keypoints", "point recordings", "distances", "timestamps",
    "followed bodies", "named joints", "space alignments", "depth sidecars", "BVH", "TRC", "facing models",
    "bias models",
    "depth images", "images .png", "images .jpg", "images .bmp", "images .tiff", "images .webp", "meshes .glb",
    "meshes .gltf", "memories of stand-still", "memories of default", "contents of takes",
)  # fmt: skip
"""Names of the doors."""


@dataclass
class Report:
    """Results of one door.

    Attributes:
        inputs: number of damaged inputs.
        refused: of these, with an error of ours.
        escaped: number of others' errors by type and place, with the first input of each.
        seconds: time in the reader.
        whole_s: time with the making of the inputs.
        slowest_s: of one input.
        grown_bytes: most memory above that before the first input.
    """

    name: str
    inputs: int = 0
    refused: int = 0
    escaped: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    seconds: float = 0.0
    whole_s: float = 0.0
    slowest_s: float = 0.0
    grown_bytes: int = 0

    @property
    def escapes(self) -> int:
        return sum(count for count, _ in self.escaped.values())


def run(quick: bool = False, parts: Sequence[str] = (), inputs: int | None = None) -> list[Row]:
    count = inputs or (QUICK if quick else INPUTS)
    with tempfile.TemporaryDirectory(prefix="mocapella-fuzz-", dir=_memory_disk()) as folder:
        chosen = [door for door in doors(Path(folder)) if not parts or door.name in parts]
        total = sum(door.share for door in chosen)
        reports = [feed(door, max(1, round(count * door.share / total))) for door in chosen]
    for report in reports:
        tell(report)
    return rows_of(reports)


def rows_of(reports: Sequence[Report]) -> list[Row]:
    """Return the rows of all doors together, and of each its rate."""
    fed, seconds = sum(one.inputs for one in reports), sum(one.whole_s for one in reports)
    slowest = max(reports, key=lambda one: one.slowest_s)
    hungry = max(reports, key=lambda one: one.grown_bytes)
    return [
        measured(f"fuzz: escaped of {fed:,} inputs", sum(one.escapes for one in reports), "errors", goal=at_most(0)),
        measured("fuzz: refused", 100 * sum(one.refused for one in reports) / fed, "%"),
        measured(f"fuzz: slowest input ({slowest.name})", slowest.slowest_s, "s", goal=at_most(MOST_SECONDS)),
        measured(f"fuzz: most memory ({hungry.name})", hungry.grown_bytes / _MIB, "MiB", goal=at_most(MOST_MIB)),
        measured("fuzz: rate, one process", fed / seconds, "inputs/s"),
        *(
            measured(f"fuzz: {one.name}, {one.inputs:,} inputs", one.inputs / one.seconds, "inputs/s")
            for one in reports
        ),
    ]


def feed(door: Door, count: int, seed: int = SEED) -> Report:
    """Read damaged inputs, and count what happens."""
    report = Report(door.name)
    process = psutil.Process()
    before, peak_before, started = process.memory_info().rss, _peak_bytes(), time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number, (read, data) in enumerate(islice(door.inputs(random.Random(f"{seed}/{door.name}")), count)):
            begin = time.perf_counter()
            try:
                read()
            except MocapellaError as error:
                report.refused += 1
                if "\n" in str(error):
                    _note(report, f"{type(error).__name__} of several lines", data)
            except Exception as error:  # noqa: BLE001  counted here
                _note(report, _place(error), data)
            took = time.perf_counter() - begin
            report.seconds, report.slowest_s = report.seconds + took, max(report.slowest_s, took)
            if number % _LOOK == 0 or took > 0.05:
                report.grown_bytes = max(report.grown_bytes, process.memory_info().rss - before)
            report.inputs += 1
        report.whole_s = time.perf_counter() - started
    if (peak := _peak_bytes()) > peak_before:  # between two looks
        report.grown_bytes = max(report.grown_bytes, peak - before)
    return report


def tell(report: Report) -> None:
    """Print what escaped, with its first input, to standard error."""
    for place, (count, data) in report.escaped.items():
        print(f"{report.name}: {count} × {place}: {data[:200]!r}", file=sys.stderr)


def _note(report: Report, place: str, data: bytes) -> None:
    count, first = report.escaped.get(place, (0, data))
    report.escaped[place] = (count + 1, first)


def _place(error: Exception) -> str:
    """Return the error's type and the last place of ours that it came through."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if f"mocapella{os.sep}" in frame.filename]
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__} at {where} ({str(error)[:80]})"


def _peak_bytes() -> int:
    """Return the most memory that this process ever had; 0 where that is not known."""
    if sys.platform in ("win32", "darwin"):
        return 0
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _memory_disk() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None
