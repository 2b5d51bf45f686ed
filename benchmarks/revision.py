"""Measure groups in turns with an earlier revision of the project, to see what a change costs.

``python -m benchmarks live recording --against REVISION``. Each revision measures itself, in processes of its own and
with its own benchmarks; rows of the same name are compared.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.harness import UNITS_PER_SECOND, Row, compared, measured, times_the_peer

ROOT = Path(__file__).resolve().parents[1]
TURNS = 5
"""Measurements of each revision."""
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
            for folder, measurements in sorted(rows.items(), reverse=bool(turn % 2)):  # neither is always the first
                found = _measure(folder, groups, options if turn else ["--quick"])
                if turn:
                    measurements.append(found)
    return paired(rows[ROOT], rows[earlier], f"revision {revision}")


def paired(
    ours: Sequence[Sequence[dict[str, Any]]], theirs: Sequence[Sequence[dict[str, Any]]], peer: str
) -> list[Row]:
    """Return our medians over the turns, given as rows of JSON; times and loads are compared.

    The peer's value is ours times the median over the turns of the ratio of both: a machine's speed drifts from turn to
    turn. A row that the earlier revision does not have, or that is not above 0 in each turn, stands without a peer.
    """
    rows = []
    for row in ours[-1]:
        name, unit = row["name"], row["unit"]
        mine, before = _values(ours, name), _values(theirs, name)
        value = statistics.median(mine)
        both = len(before) == len(mine) and min(*mine, *before) > 0
        if both and (unit in UNITS_PER_SECOND or unit == "%"):
            ratio = statistics.median(b / a for a, b in zip(mine, before, strict=True))
            rows.append(compared(name, value, unit, peer=peer, peer_value=ratio * value, goal=times_the_peer(LEAST)))
        else:
            rows.append(measured(name, value, unit))
    return rows


def _values(measurements: Sequence[Sequence[dict[str, Any]]], name: str) -> list[float]:
    return [row["value"] for measurement in measurements for row in measurement if row["name"] == name]


def _measure(folder: Path, groups: Sequence[str], options: Sequence[str]) -> list[dict[str, Any]]:
    environment = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
    environment["UV_PYTHON"] = str(Path(sys.executable).resolve())  # the same for both
    command = ["uv", "run", "--quiet", "python", "-m", "benchmarks", *groups, *options, "--json", "-"]
    done = subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed in {folder} (status {done.returncode}):\n{done.stderr}")
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
