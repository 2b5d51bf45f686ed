"""Read the bodies of one sensor from a CSV file that another program wrote (docs/sensors.md).

Two kinds are read, plain or gzip-compressed: positions of Azure Kinect Body Tracking, ``;``-separated with a header,
and joints of a Kinect v2, ``,``-separated without one. All numbers of a block of rows are parsed at once; only if that
fails, a second, slow pass finds the row and the column of the error.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import text_blocks
from mocapella.errors import InputError, one_of
from mocapella.model.azure_kinect import AZURE_KINECT, STATES, TO_CAMERA_SPACE
from mocapella.model.body_rows import BodyRows
from mocapella.model.observations import JointState
from mocapella.model.topology import Topology, topology

Float64 = NDArray[np.float64]

FARTHEST_M: Final = 100.0
"""Coordinates of this absolute value or more are refused [m]."""
NEAREST_M: Final = 0.1
"""If no coordinate in a file reaches this [m], the file is refused, because its unit must be another one."""
_WANTED: Final = (
    "a file of Azure Kinect Body Tracking begins with timestamp;body_idx;PELVIS (c);PELVIS (x);…, one of a Kinect v2 "
    "has a time and x,y,z,state of 25 joints in each row"
)
_LARGEST: Final = 2.0**53
"""Whole numbers up to this are exact."""
_LATEST_NS: Final = 2.0**62
"""Latest time, 146 years [ns]."""


class _Kind(NamedTuple):
    """Format of a kind of file.

    Attributes:
        topology: joints of the sensor's skeletons.
        separator: between two cells.
        header: whether the first row has the names of the columns.
        time: name of the column of the time.
        tick_ns: unit of the time [ns].
        body: name of the column of the body's number; empty if a file has one body.
        axes: names of the coordinates; the file's x, y, z.
        state: name of the column of the state.
        scale: (3,) from the file's coordinates to camera space [m].
        states: the state for each value of the file, from 0.
        units: advice if coordinates are too large or too small.
    """

    topology: Topology
    separator: str
    header: bool
    time: str
    tick_ns: int
    body: str
    axes: tuple[str, str, str]
    state: str
    scale: tuple[float, float, float]
    states: NDArray[np.uint8]
    units: str

    def columns(self) -> list[str]:
        """Names of all columns, in the usual order."""
        return [
            self.time, *([self.body] if self.body else []),
            *(name.format(joint) for joint in self.topology.joints for name in self.of_joint()),
        ]  # fmt: skip

    def of_joint(self) -> tuple[str, ...]:
        """Names of a joint's columns, in the usual order, with {} for the joint."""
        return (self.state, *self.axes) if self.header else (*self.axes, self.state)


_AZURE: Final = _Kind(
    AZURE_KINECT, ";", True, "timestamp", 1000, "body_idx", ("{} (x)", "{} (y)", "{} (z)"), "{} (c)",
    TO_CAMERA_SPACE, STATES, "positions are in millimetres",
)  # fmt: skip
_KINECT: Final = _Kind(
    topology("kinect_v2"), ",", False, "time", 100, "", ("{} x", "{} y", "{} z"), "{} state",
    (1.0, 1.0, 1.0), np.arange(3, dtype=np.uint8), "positions are in metres",
)  # fmt: skip


def is_body_csv(path: Path) -> bool:
    """Whether the first row of a file is that of one of the two kinds of body CSV; False if it cannot be read.

    It is False for a study log.
    """
    try:
        return _kind_of(_first_row(path)) is not None
    except InputError:
        return False


def _first_row(path: Path) -> str:
    return next(text_blocks(path, fix=_WANTED), "").partition("\n")[0]


def _kind_of(first: str) -> _Kind | None:
    """Return the kind of a file by its first row; None for others."""
    if first.startswith((_AZURE.time + _AZURE.separator, _AZURE.body + _AZURE.separator)):
        return _AZURE
    cells = first.split(_KINECT.separator)
    return _KINECT if len(cells) > 1 and _number(cells[0]) is not None else None


def read_body_csv(path: Path | str) -> BodyRows:
    """Read a file of one sensor's bodies, ``.csv`` or ``.csv.gz``.

    Columns of an Azure Kinect are found by name, columns of a Kinect v2 by order. An empty cell at the end of a row is
    ignored.

    Raises:
        InputError: the file cannot be read, is of neither kind, has no rows, or has an invalid row or value; or a
            column of the header is unknown, repeated or missing. Names row, column and value.
    """
    file = str(path)
    blocks = text_blocks(Path(path), fix=_WANTED)
    block = next(blocks, "")
    first, newline, body = block.partition("\n")
    if not first.strip():
        raise InputError("the file is empty" if not newline else "the first row is empty", file=file, fix=_WANTED)
    kind = _kind_of(first)
    if kind is None:
        raise InputError("is no file of a sensor's bodies", file=file, row=1, value=first, fix=_WANTED)
    columns = _header(first, kind, file) if kind.header else kind.columns()
    reader = _Reader(file, kind, columns)
    rows = 1
    if kind.header:
        rows, block = 2, body
    parts = list(_parts(reader, block, blocks, rows))
    if not parts:
        raise InputError("the file has a header and no rows", file=file, fix="record somebody, or leave it out")
    _check_units(parts, kind, file)
    joined = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return BodyRows(file, kind.topology, rows, *joined)


class _Part(NamedTuple):
    """The arrays of `BodyRows` for a block of rows."""

    time_ns: NDArray[np.int64]
    ids: NDArray[np.int64]
    positions: NDArray[np.float32]
    states: NDArray[np.uint8]


def _parts(reader: _Reader, block: str, blocks: Iterator[str], row: int) -> Iterator[_Part]:
    for text in chain([block] if block else [], blocks):
        yield reader.read(text, row)
        row += text.count("\n") + 1


def _header(first: str, kind: _Kind, file: str) -> list[str]:
    """Return the names of the columns in the file's order.

    Raises:
        InputError: a column is unknown, repeated or missing.
    """
    columns = [cell.strip() for cell in first.split(kind.separator)]
    if columns[-1] == "":
        columns.pop()
    wanted = kind.columns()
    if f"{kind.topology.joints[0]} (w)" in columns:
        fix = "orientations are not read; give the file of positions"
        raise InputError("has orientations", file=file, row=1, field=f"{kind.topology.joints[0]} (w)", fix=fix)
    for name in columns:
        if name not in wanted:
            raise InputError(
                "is an unknown column", file=file, row=1, value=name, fix=f"columns are {_some(name, wanted)}"
            )
        if columns.count(name) > 1:
            raise InputError("is there twice", file=file, row=1, field=name, fix="remove one of the columns")
    for name in wanted:
        if name not in columns:
            raise InputError("the column is missing", file=file, row=1, field=name, fix=_WANTED)
    return columns


def _some(name: str, wanted: list[str]) -> str:
    """Return the first columns, and the one that resembles the name."""
    close = one_of(name, wanted).rpartition(" (did you mean ")
    return ", ".join(wanted[:6]) + ", …" + (" (did you mean " + close[2] if close[1] else "")


class _Reader:
    """Reads blocks of rows.

    Args:
        file: path of the file, named in errors.
        kind: how the file is read.
        columns: names of the columns, in the file's order.
    """

    def __init__(self, file: str, kind: _Kind, columns: list[str]) -> None:
        self._file, self._kind, self._columns = file, kind, columns
        place = {name: i for i, name in enumerate(columns)}
        joints = kind.topology.joints
        self._time = place[kind.time]
        self._body = place.get(kind.body)
        self._states = [place[kind.state.format(joint)] for joint in joints]
        self._axes = [[place[axis.format(joint)] for axis in kind.axes] for joint in joints]
        self._whole = {self._time, *self._states} | (set() if self._body is None else {self._body})
        self._farthest = FARTHEST_M / abs(kind.scale[0])

    def read(self, text: str, row: int) -> _Part:
        """Read rows, the first of which has that number in the file.

        Raises:
            InputError: a row or a value is invalid.
        """
        table = self._table(text)
        if table is None or not self._fits(table).all():
            raise self._culprit(text, row)
        kind = self._kind
        states = kind.states[table[:, self._states].astype(np.int64)]
        positions = (table[:, self._axes] * kind.scale).astype(np.float32)
        positions[states == JointState.NOT_TRACKED] = np.nan
        ids = np.zeros(len(table)) if self._body is None else table[:, self._body]
        return _Part(table[:, self._time].astype(np.int64) * kind.tick_ns, ids.astype(np.int64), positions, states)

    def _table(self, text: str) -> Float64 | None:
        """Return all numbers (rows, columns); None if a cell is no number, or a row has too many or few."""
        separator = self._kind.separator
        plain = "\n".join(line.removesuffix(separator) for line in text.split("\n"))
        try:
            table = np.loadtxt(io.StringIO(plain), delimiter=separator, comments=None, ndmin=2)
        except ValueError:
            return None
        return table if table.shape == (text.count("\n") + 1, len(self._columns)) else None

    def _fits(self, table: Float64) -> NDArray[np.bool_]:
        """Return which numbers (rows, columns) can be used."""
        fits = np.isfinite(table) & (np.abs(table) < self._farthest)
        for place in self._whole:
            values = table[:, place]
            most = len(self._kind.states) if place in self._states else _LARGEST
            most = min(most, _LATEST_NS / self._kind.tick_ns) if place == self._time else most
            fits[:, place] = (values >= 0) & (values < most) & (values == np.floor(values))
        return fits

    def _culprit(self, text: str, row: int) -> InputError:
        """Return the error of the first invalid row or value of a block."""
        for number, line in enumerate(text.split("\n"), start=row):
            cells = line.removesuffix(self._kind.separator).split(self._kind.separator)
            if len(cells) != len(self._columns):
                fix = "remove the row or complete it"
                problem = f"the row has {len(cells)} cells and not {len(self._columns)}"
                return InputError(problem, file=self._file, row=number, fix=fix)
            values = [_number(cell) for cell in cells]
            fits = self._fits(np.array([[np.nan if value is None else value for value in values]]))[0]
            if not fits.all():
                place = int(fits.argmin())
                problem, fix = self._problem(place, values[place])
                name, value = self._columns[place], cells[place].strip()
                return InputError(problem, file=self._file, row=number, field=name, value=value, fix=fix)
        return InputError("the rows cannot be read", file=self._file, fix=_WANTED)

    def _problem(self, place: int, value: float | None) -> tuple[str, str]:
        """Return the fault of an invalid value, and its fix."""
        kind = self._kind
        if value is None or not np.isfinite(value):
            return "is no number", "write a number with a point"
        if place in self._states:
            return "is no state", f"states are 0 to {len(kind.states) - 1}"
        if place == self._time:
            return "is no time of a sensor", f"it counts {kind.tick_ns} ns, from the sensor's start"
        if place == self._body:
            return "is no number of a body", "it is a whole number, 0 or more"
        return f"is {FARTHEST_M:g} m away or farther", kind.units


def _number(cell: str) -> float | None:
    """Return the number of a cell; None if it has none."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def _check_units(parts: list[_Part], kind: _Kind, file: str) -> None:
    """Check that a coordinate reaches `NEAREST_M`, if any joint is tracked: else the coordinates have another unit.

    Raises:
        InputError: none does.
    """
    most = max((float(np.abs(part.positions[np.isfinite(part.positions)]).max(initial=0)) for part in parts), default=0)
    tracked = any((part.states > 0).any() for part in parts)
    if tracked and most < NEAREST_M:
        raise InputError(f"all joints are within {NEAREST_M:g} m of the sensor", file=file, fix=kind.units)
