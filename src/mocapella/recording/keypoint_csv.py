"""Read tables of keypoints: the long CSV of ``mocapella export csv``, and markers in columns without times."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.decoding import FAULTS, MOST_TABLE_BYTES, check_filled, decode_csv, decode_text, read_whole, text_blocks
from mocapella.errors import InputError
from mocapella.model.names import distinct, of_cell
from mocapella.model.observations import STATE_NAMES, JointState
from mocapella.model.trajectories import LABELS, Trajectories
from mocapella.recording.body_csv import is_body_csv, read_body_csv
from mocapella.recording.known_keypoints import known_keypoints
from mocapella.recording.study_log import is_study_log

Float64 = NDArray[np.float64]

STATES: Final = STATE_NAMES
COLUMNS: Final = ("time_s", "run", "individual", "keypoint", "state", "x_m", "y_m", "z_m")
"""Columns that a long table must have; it may have labels and ``sd_m`` as well."""
NO_TIMES: Final = "has no times: its rate is unknown"
"""Beginning of the note of a file without times, whose times are numbers of frames."""
MM: Final = 1e-3
_FIX: Final = (
    "give a table of `mocapella export csv`, bodies of an Azure Kinect or Kinect v2, or markers with columns NAME (x), "
    "NAME (y), NAME (z) in millimetres"
)
_MARKER: Final = re.compile(r"(.+) \(([xyz])\)")
_FARTHEST_M: Final = 1e4
_SMALLEST_M: Final = 0.02
"""Several markers that are all within this distance must be in another unit than millimetres [m]."""


def read_csv_keypoints(path: Path) -> Trajectories:
    """Read one of the CSVs with keypoints, plain or, but for ours, gzip-compressed; its header tells which one it is.

    Raises:
        InputError: it is none of them, or damaged; names file, row, field and value.
    """
    if is_body_csv(path):
        return _bodies(path)
    first = next(text_blocks(path, fix=_FIX), "").partition("\n")[0] if path.suffix == ".gz" else _first(path)
    if _MARKER.fullmatch(first.partition(";")[0].strip()):
        return _markers(path)
    return _long(path)


def _first(path: Path) -> str:
    return decode_text(read_whole(path, fix=_FIX, most_bytes=MOST_TABLE_BYTES), file=path, fix=_FIX).partition("\n")[0]


def _long(path: Path) -> Trajectories:
    """Read the long table of ``mocapella export csv``; the kind is found by the names of the keypoints."""
    columns, rows = decode_csv(read_whole(path, fix=_FIX, most_bytes=MOST_TABLE_BYTES), file=path, fix=_FIX)
    if is_study_log(path):
        fix = "make a take of it with `mocapella replay LOG --record NAME`"
        raise InputError("is a study log, which has no results", file=path, fix=fix)
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise InputError("a column is missing", file=path, row=1, field=missing[0], fix=_FIX)
    table = [_cells(path, row, cells) for row, cells in rows]
    if not table:
        raise InputError("the table has no rows", file=path, fix="export a take with results")
    times, frame = np.unique([one[0] for one in table], return_inverse=True)
    individuals, keypoints = (tuple(dict.fromkeys(one[k] for one in table)) for k in (2, 3))
    check_filled(len(times) * len(individuals) * len(keypoints), len(table), file=path)
    who, what = ({name: k for k, name in enumerate(names)} for names in (individuals, keypoints))
    at = (frame, np.array([who[one[2]] for one in table]), np.array([what[one[3]] for one in table]))
    shape = (len(times), len(individuals), len(keypoints))
    filled = np.zeros(shape, np.int64)
    np.add.at(filled, at, 1)
    if filled.max() > 1:
        row = int(np.flatnonzero(filled[at] > 1)[0]) + 2
        raise InputError("the keypoint is there twice at this time", file=path, row=row, fix="remove one of the rows")
    positions, sd = np.full((*shape, 3), np.nan), np.full(shape, np.nan, np.float32)
    positions[at], sd[at] = np.array([one[5:8] for one in table]), [one[8] for one in table]
    states = np.zeros(shape, np.uint8)
    states[at] = [one[4] for one in table]
    runs = np.zeros(len(times), np.int64)
    runs[frame] = [one[1] for one in table]
    labels = {one[1]: dict(zip(LABELS, one[9:], strict=True)) for one in table}
    found = known_keypoints(keypoints)
    return Trajectories(
        found.kind, times, runs, individuals, keypoints, positions, states, sd, found.bones,
        rate_hz=_rate_hz(times), labels=labels,
    )  # fmt: skip


def _cells(path: Path, row: int, cells: dict[str, str]) -> tuple[Any, ...]:
    """Return time, run, individual, keypoint, state, x, y, z, sd and the labels of one row."""

    def number(field: str, least: float, most: float, *, empty: bool = True) -> float:
        text = cells.get(field, "")
        if empty and not text:
            return math.nan
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            fix = f"write a number from {least:g} to {most:g}"
            raise InputError("is no usable number", file=path, row=row, field=field, value=text, fix=fix)
        return value

    state = cells.get("state", "")
    if state not in STATES:
        raise InputError("is no state", file=path, row=row, field="state", value=state, fix=f"write {STATES}")
    point = [number(axis, -_FARTHEST_M, _FARTHEST_M) for axis in ("x_m", "y_m", "z_m")]
    known = not any(map(math.isnan, point))
    return (
        number("time_s", -1e9, 1e12, empty=False), int(number("run", 0, 1e9, empty=False)),
        of_cell(cells.get("individual", "")), of_cell(cells.get("keypoint", "")),
        STATES.index(state) if known else 0, *(point if known else [math.nan] * 3), number("sd_m", 0, _FARTHEST_M),
        *(of_cell(cells.get(label, "")) for label in LABELS),
    )  # fmt: skip


def _markers(path: Path) -> Trajectories:
    """Read markers in millimetres, a row for each frame, as motion-capture viewers write them.

    Without times, the frames are numbered: 1 Hz, with the ``rate_hz`` NaN and a note.
    """
    text = "\n".join(text_blocks(path, fix=_FIX))
    try:
        header, *rows = [line.split(";") for line in text.split("\n")]
        found = [_MARKER.fullmatch(cell.strip()) for cell in header]
        axes = [one.groups() if one else ("", "") for one in found]
        names = [name for name, axis in axes if axis == "x"]
        if axes != [(name, axis) for name in names for axis in "xyz"]:
            raise ValueError("its columns are not NAME (x), NAME (y), NAME (z) of one marker after another")
        if any(len(row) != len(header) for row in rows) or not rows:
            raise ValueError("its rows have not all a cell for each column")
        values = np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in rows])
    except FAULTS as error:
        raise InputError(f"is no table of markers: {error}", file=path, fix=_FIX) from None
    positions = MM * values.reshape(len(rows), 1, len(names), 3)
    known = np.all(np.abs(positions) < _FARTHEST_M, axis=3)  # false for NaN
    if known.any() and len(names) > 1 and np.ptp(positions[known], axis=0).max() < _SMALLEST_M:
        raise InputError(f"all markers are within {_SMALLEST_M:g} m", file=path, fix="write millimetres")
    return Trajectories(
        kind="points",
        times_s=np.arange(len(rows), dtype=np.float64),
        runs=np.zeros(len(rows), np.int64),
        individuals=(path.name.partition(".")[0],),
        keypoints=distinct(names),
        positions=np.where(known[..., None], positions, np.nan),
        states=np.where(known, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8),
        sd=np.full(known.shape, np.nan, np.float32),
        notes=(f"{NO_TIMES}; times are numbers of frames",),
    )


def _bodies(path: Path) -> Trajectories:
    """Read one sensor's bodies, in its camera space; time 0 is that of the first row."""
    rows = read_body_csv(path)
    ids, who = np.unique(rows.ids, return_inverse=True)
    at_ns, frame = np.unique(rows.time_ns, return_inverse=True)
    shape = (len(at_ns), len(ids), len(rows.topology))
    check_filled(len(at_ns) * len(ids), len(rows.ids), file=path)
    positions, states = np.full((*shape, 3), np.nan), np.zeros(shape, np.uint8)
    positions[frame, who], states[frame, who] = rows.positions, rows.states
    times, names = (at_ns - at_ns[0]) / NS_PER_S, tuple(f"body_{number}" for number in ids)
    return Trajectories(
        "people", times, np.zeros(len(times), np.int64), names, rows.topology.joints, positions, states,
        np.full(shape, np.nan, np.float32), rows.topology.bones, rate_hz=_rate_hz(times),
    )  # fmt: skip


def _rate_hz(times: Float64) -> float:
    return 1.0 / float(np.median(np.diff(times))) if len(times) > 1 else math.nan
