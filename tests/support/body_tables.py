"""Texts of files with one sensor's bodies, as other programs write them, of made-up people."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import topology

AZURE, KINECT = topology("azure_kinect"), topology("kinect_v2")
AZURE_COLUMNS = ["timestamp", "body_idx", *(f"{joint} ({what})" for joint in AZURE.joints for what in "cxyz")]


class Row(NamedTuple):
    """One body at one instant: time in the file's unit, number, coordinates (joints, 3) and states (joints,) in it."""

    time: int
    body: int
    at: NDArray[np.float64]
    states: NDArray[np.int64]


def azure_rows(frames: int = 3, bodies: int = 2, seed: int = 0) -> list[Row]:
    """Rows of an Azure Kinect: µs, mm, confidence levels."""
    rng = np.random.default_rng(seed)
    return [
        Row(33_000 * (k + 1), body, rng.normal((0, 0, 2000), 300, (32, 3)).round(3), rng.integers(0, 4, 32))
        for k in range(frames)
        for body in range(1, bodies + 1)
    ]


def kinect_rows(frames: int = 3, seed: int = 0) -> list[Row]:
    """Rows of a Kinect v2: 100 ns, m, tracking states."""
    rng = np.random.default_rng(seed)
    return [
        Row(330_000 * (k + 1), 0, rng.normal((0, 0, 2), 0.3, (25, 3)).round(6), rng.integers(0, 3, 25))
        for k in range(frames)
    ]


def azure_text(rows: list[Row], columns: list[str] | None = None) -> str:
    order = [AZURE_COLUMNS.index(name) for name in columns or AZURE_COLUMNS]
    lines = [";".join(columns or AZURE_COLUMNS)]
    for row in rows:
        joints = [cell for at, c in zip(row.at, row.states, strict=True) for cell in (str(c), *map(repr, at.tolist()))]
        cells = [str(row.time), str(row.body), *joints]
        lines.append(";".join(cells[place] for place in order))
    return "\n".join(lines) + "\n"


def kinect_text(rows: list[Row], end: str = ",") -> str:
    lines = [
        ",".join([str(row.time), *(f"{x},{y},{z},{s}" for (x, y, z), s in zip(row.at, row.states, strict=True))]) + end
        for row in rows
    ]
    return "\n".join(lines) + "\n"
