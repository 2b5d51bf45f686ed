"""Calibration boards, and a camera's view of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.settings import check, parse

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

DICTIONARIES: Final = (
    *(f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    *(f"DICT_APRILTAG_{name}" for name in ("16H5", "25H9", "36H10", "36H11")),
)
"""OpenCV's names of its predefined dictionaries of ArUco markers."""


@dataclass(frozen=True)
class Board:
    """A flat board of squares, black where row + column is even, whose inner corners are detected in images.

    The board's frame has the origin at the outer corner of the first square and z into the board; seen from the front,
    x points right and y down.

    Attributes:
        kind: ``chessboard``, or ``charuco`` with a marker in every white square.
        columns: number of squares in a row.
        rows: number of squares in a column.
        square_m: side of a square, as measured on the print [m].
        marker_ratio: side of a marker over side of a square, of a ChArUco board.
        dictionary: dictionary of the ArUco markers, one of `DICTIONARIES`.
        inverted: whether it is printed with black and white exchanged.
        legacy: whether it is a ChArUco board of OpenCV before 4.6, whose first square is white if the number of rows is
            even.

    Raises:
        SettingsError: a value is out of range, or the dictionary unknown.
    """

    kind: Literal["chessboard", "charuco"]
    columns: int
    rows: int
    square_m: float
    marker_ratio: float = 0.75
    dictionary: str = "DICT_4X4_1000"
    inverted: bool = False
    legacy: bool = False

    def __post_init__(self) -> None:
        check(3 <= self.columns <= 100, "columns", self.columns, "3 to 100 squares")
        check(3 <= self.rows <= 100, "rows", self.rows, "3 to 100 squares")
        check(0.001 <= self.square_m <= 10, "square_m", self.square_m, "0.001 to 10 m, as measured on the print")
        check(0.2 <= self.marker_ratio < 1, "marker_ratio", self.marker_ratio, "0.2 or more and below 1")
        check(self.dictionary in DICTIONARIES, "dictionary", self.dictionary, f"one of {', '.join(DICTIONARIES)}")

    @property
    def corners(self) -> int:
        """Number of inner corners."""
        return (self.columns - 1) * (self.rows - 1)

    @cached_property
    def corners_m(self) -> Float64:
        """(corners, 3) in the board's frame [m], in the order of their ids: row by row."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns].reshape(2, -1) * self.square_m
        return np.column_stack([x, y, np.zeros(len(x))]).astype(np.float64)

    @property
    def turnable(self) -> bool:
        """Whether it looks the same when rotated by 180°, so that images do not determine the first corner."""
        return self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0


class BoardView(msgspec.Struct, frozen=True, eq=False):
    """The board's corners in one image of one camera.

    Attributes:
        camera: name of the camera.
        frame: number of the image in its video, from 0.
        size_px: (width, height) of the image.
        ids: (n,) ids of the detected corners, ascending: their rows in `Board.corners_m`.
        corners_px: (n, 2) x, y, refined to fractions of a pixel [px]; (0, 0) is the centre of the first pixel.
        edge_px: median width of the edges at the corners [px]: large if the image is blurred; NaN
            where that was not measured.
    """

    camera: str
    frame: int
    size_px: tuple[int, int]
    ids: Int64
    corners_px: Float64
    edge_px: float = float("nan")


_CALISCOPE: Final = {"square_size_override_cm", "square_size_overide_cm"}
_KEYS: Final = "kind, columns, rows, square_m, and of a ChArUco board marker_ratio, dictionary, inverted, legacy"


def load_board(path: Path | str) -> Board:
    """Read a board's TOML file, or a ``charuco.toml`` of Caliscope.

    Raises:
        InputError: there is no such file, it is no TOML, or a value is invalid; names valid ones.
    """
    return parse_board(read_whole(path, fix=f"write one with {_KEYS}"), path)


def parse_board(text: bytes | str, path: Path | str = "board") -> Board:
    """Decode the TOML text of a file that `load_board` reads; errors name ``path``.

    Raises:
        InputError: it is no TOML, or a value is invalid; names valid ones.
    """
    data = decode_toml(text, file=path, fix=f"write one with {_KEYS}")
    if _CALISCOPE & set(data) and "kind" not in data:
        data = _of_caliscope(data, path)
    for key in ("kind", "columns", "rows", "square_m"):
        if key not in data:
            raise InputError("is missing", file=path, field=key, fix=f"a board has {_KEYS}")
    try:
        return parse(Board, data, where=str(path))
    except SettingsError as error:
        said = str(error).removeprefix(f"{path}: ")
        raise InputError(said, file=path, fix=f"a board has {_KEYS}") from None


def encode_board(board: Board) -> str:
    """Return the text of a board's TOML file, which `parse_board` reads."""
    import tomli_w

    return tomli_w.dumps(asdict(board))


def _of_caliscope(data: Mapping[str, Any], path: Path | str) -> dict[str, Any]:
    """Convert Caliscope's keys to ours; the paper size is redundant."""
    try:
        side_cm = next(float(data[key]) for key in _CALISCOPE if key in data)
        given = {key: data[key] for key in ("columns", "rows", "dictionary", "inverted") if key in data}
        return {
            "kind": "charuco",
            "square_m": round(side_cm / 100, 9),
            "marker_ratio": float(data["aruco_scale"]),
            **given,
        }
    except (KeyError, TypeError, ValueError) as error:
        fix = "it has columns, rows, dictionary, aruco_scale and square_size_override_cm"
        raise InputError(f"is no charuco.toml of Caliscope: {error}", file=path, fix=fix) from None
