"""Read TRC, the marker file of OpenSim, Pose2Sim and Mocapella."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.decoding import FAULTS, MOST_TABLE_BYTES, decode_text, read_whole
from mocapella.errors import InputError
from mocapella.model.names import distinct
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

METRES: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "dm": 1e-1}
"""Length of the units that a TRC may name [m]."""
_FIX: Final = "give a .trc file, such as `mocapella export trc` writes"


def read_trc(path: Path) -> Trajectories:
    """Read a TRC as trajectories of the kind ``points``, in metres, with one individual, named like the file.

    Cells are separated by tabs or commas. Unknown coordinates are NaN. A known marker counts as measured, as a TRC does
    not tell.

    Raises:
        InputError: it cannot be read, is no TRC, or has an unknown unit.
    """
    text = decode_text(read_whole(path, fix=_FIX, most_bytes=MOST_TABLE_BYTES), file=path, fix=_FIX)
    try:
        separator = "\t" if "\t" in text.partition("\n")[0] else ","  # spreadsheets write commas
        lines = [line.split(separator) for line in text.splitlines()]
        header = dict(zip(lines[1], lines[2], strict=False))
        names = tuple(name.strip() for name in lines[3][2:] if name.strip())
        rows = [line for line in lines[5:] if line[0].strip()]
        times = np.array([float(row[1]) for row in rows])
        if 3 * len(names) * len(rows) > 2 * len(text):
            raise ValueError("most of its cells are missing")
        cells = [(row[2:] + [""] * 3 * len(names))[: 3 * len(names)] for row in rows]
        claimed, short = int(header.get("NumFrames", len(rows))), sum(len(row) < 2 + 3 * len(names) for row in rows)
        points = np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in cells])
        positions = points.reshape(len(rows), 1, len(names), 3)
        rate_hz = float(header["DataRate"])
    except FAULTS as error:
        raise InputError(f"is no TRC: {error}", file=path, fix=_FIX) from None
    unit = header.get("Units", "").strip()
    if unit not in METRES:
        raise InputError("is an unknown unit", file=path, field="Units", value=unit, fix=f"write {', '.join(METRES)}")
    if not names or not rows or not (np.diff(times) > 0).all() or not np.isfinite(times).all():
        raise InputError("has no markers, or no frames at rising times", file=path, fix=_FIX)
    if not 0 < rate_hz < math.inf:
        raise InputError(
            "is no rate", file=path, field="DataRate", value=rate_hz, fix="write frames a second, such as 60"
        )
    notes = [f"its header says {claimed} frames, and it has {len(rows)}"] if claimed != len(rows) else []
    notes += [f"{short} rows have too few cells; the missing ones are unknown"] if short else []
    known = np.all(np.isfinite(positions), axis=3)
    positions = np.where(known[..., None], METRES[unit] * positions, np.nan)
    states = np.where(known, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)
    return Trajectories(
        "points", times, np.zeros(len(rows), np.int64), (path.stem,), distinct(names), positions, states,
        np.full(known.shape, np.nan, np.float32), rate_hz=rate_hz, notes=tuple(notes),
        cut_off=len(rows) < claimed,
    )  # fmt: skip
