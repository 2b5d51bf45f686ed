"""Measure groups in turns with an earlier revision of the project, to see what a change costs.

``python -m benchmarks live recording --against REVISION``. Each revision measures itself, in processes of its own and
with its own benchmarks; rows of the same name are compared.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.harness import UNITS_PER_SECOND, Row, compared, measured, times_the_peer

ROOT = Path(__file__).resolve().parents[1]
TURNS = 3
"""Measurements of each revision; medians are compared."""
LEAST = 0.95
"""A time or load may be 1 / LEAST of the earlier one."""


def in_turns(revision: str, groups: Sequence[str], options: Sequence[str], turns: int = TURNS) -> list[Row]:
    """Return the rows of our groups, each beside that of an earlier revision; less is better.

    Args:
        revision: anything that git understands.
        groups: names of the groups, which the earlier revision must have too.
        options: further arguments of both, such as ``--quick``.
        turns: measurements of each, after one that is thrown away, which compiles.

    Raises:
        SystemExit: there is no such revision, or a measurement failed.
    """
    with _checked_out(revision) as earlier:
        rows: dict[Path, list[list[dict[str, Any]]]] = {ROOT: [], earlier: []}
        for turn in range(turns + 1):
            for folder, measurements in rows.items():
                found = _measure(folder, groups, options if turn else ["--quick"])
                if turn:
                    measurements.append(found)
    return paired(rows[ROOT], rows[earlier], f"revision {revision}")


def paired(
    ours: Sequence[Sequence[dict[str, Any]]], theirs: Sequence[Sequence[dict[str, Any]]], peer: str
) -> list[Row]:
    """Return the medians over the measurements, given as rows of JSON; times and loads are compared.

    A row that the earlier revision does not have, or whose value is not above 0, stands without a peer.
    """
    medians = [{row["name"]: statistics.median(_values(of, row["name"])) for row in of[-1]} for of in (ours, theirs)]
    rows = []
    for row in ours[-1]:
        name, unit = row["name"], row["unit"]
        value, before = medians[0][name], medians[1].get(name, 0.0)
        if (unit in UNITS_PER_SECOND or unit == "%") and value > 0 and before > 0:
            rows.append(compared(name, value, unit, peer=peer, peer_value=before, goal=times_the_peer(LEAST)))
        else:
            rows.append(measured(name, value, unit))
    return rows


def _values(measurements: Sequence[Sequence[dict[str, Any]]], name: str) -> list[float]:
    return [row["value"] for measurement in measurements for row in measurement if row["name"] == name]


def _measure(folder: Path, groups: Sequence[str], options: Sequence[str]) -> list[dict[str, Any]]:
    environment = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
    command = ["uv", "run", "--quiet", "python", "-m", "benchmarks", *groups, *options, "--json", "-"]
    done = subprocess.run(command, cwd=folder, env=environment, check=False, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed in {folder} (status {done.returncode})")
    return list(json.loads(done.stdout))


@contextmanager
def _checked_out(revision: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="mocapella-revision-") as place:
        folder = Path(place) / "main"
        git = ["git", "-C", str(ROOT), "worktree"]
        done = subprocess.run(
            [*git, "add", "--quiet", "--detach", str(folder), revision], check=False, capture_output=True, text=True
        )
        if done.returncode:
            raise SystemExit(f"no revision {revision!r}: {done.stderr.strip()}")
        try:
            yield folder
        finally:
            subprocess.run([*git, "remove", "--force", str(folder)], check=False)
