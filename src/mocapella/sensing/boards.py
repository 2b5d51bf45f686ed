"""Detect calibration boards in images, and explain why none was found.

OpenCV finds the corners of chessboards and ChArUco boards; their accuracy in pixels is what calibration rests on.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.homography import homography
from mocapella.model.board import DICTIONARIES, Board, BoardView
from mocapella.sensing.chessboards import chessboard_corners, chessboard_size

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

FEW_MARKERS: Final = 4
"""Least number of markers that shows that a board of a dictionary is in an image; fewer are detected by chance."""

MOST_SEARCHED: Final = 6
"""Largest number of images that are searched for a chessboard of another size, which takes seconds each."""


@dataclass
class BoardReport:
    """Counts of the images that were searched for a board.

    Attributes:
        pictures: number of images that were searched.
        found: number of images that show the board.
        corners: number of corners found in all of them.
    """

    pictures: int = 0
    found: int = 0
    corners: int = 0


class BoardDetector:
    """Detects one board in images of any camera.

    Args:
        board: the board to detect.

    Attributes:
        board: as given.
        report: counts of the images and corners since the detector was made, updated in place.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self.report = BoardReport()
        self._charuco = _charuco_detector(board) if board.kind == "charuco" else None

    def update(self, image: UInt8, camera: str, frame: int) -> BoardView | None:
        """Detect the board's corners in an image, and count the image in ``report``.

        A chessboard is detected only as a whole, a ChArUco board also in part.

        Args:
            image: (height, width) gray or (height, width, 3) BGR, uint8.
            camera: its name, for the result.
            frame: number of the image in its video, from 0, for the result.

        Returns:
            The detected corners [px]; None if there is none.
        """
        gray = _gray(image, self.board.inverted)
        self.report.pictures += 1
        found = (
            self._corners_of_charuco(gray) if self._charuco is not None else _corners_of_chessboard(gray, self.board)
        )
        if found is None:
            return None
        ids, corners = found
        self.report.found += 1
        self.report.corners += len(ids)
        size = (gray.shape[1], gray.shape[0])
        return BoardView(
            camera, frame, size, ids, corners, edge_width(gray, corners, _spacing(ids, corners, self.board))
        )

    def _corners_of_charuco(self, gray: UInt8) -> tuple[NDArray[np.int64], Float64] | None:
        assert self._charuco is not None
        corners, ids, _, _ = self._charuco.detectBoard(gray)
        if ids is None or not len(ids):
            return None
        order = np.argsort(ids.ravel())
        ids, corners = ids.ravel()[order].astype(np.int64), corners.reshape(-1, 2)[order].astype(np.float64)
        return ids, _refined(gray, corners, _spacing(ids, corners, self.board), self.board)


def _refined(gray: UInt8, corners: Float64, spacing: Float64, board: Board) -> Float64:
    """Refine corners by the gradients around them (Förstner and Gülch 1987), in a window that excludes the markers.

    OpenCV 4.11 returns the corners of a ChArUco board half a pixel too far right and down: relative to a pixel's edge.
    """
    out = corners.copy()
    apart = np.where(np.isfinite(spacing), spacing, np.nanmin(spacing, initial=np.inf))
    for k, (corner, space) in enumerate(zip(corners, apart, strict=True)):
        reach = int(np.clip(0.45 * (1 - board.marker_ratio) * space if np.isfinite(space) else 2, 2, 8))
        start = (corner - 0.5).astype(np.float32).reshape(1, 1, 2)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.002)
        refined = cv2.cornerSubPix(gray, start.copy(), (reach, reach), (-1, -1), stop)[0, 0]
        # The refinement diverges if there is no corner after all, such as under a finger.
        out[k] = refined if np.abs(refined - start[0, 0]).max() <= reach else start[0, 0]
    return out


def _gray(image: UInt8, inverted: bool) -> UInt8:
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(255 - gray if inverted else gray)


def charuco_board(board: Board) -> Any:
    """Return OpenCV's ``CharucoBoard`` of a board, to draw or detect it."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    drawn = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_m, board.square_m * board.marker_ratio, markers
    )
    drawn.setLegacyPattern(board.legacy)
    return drawn


def draw_board(board: Board, square_px: int) -> UInt8:
    """Draw the board for printing, with a white margin of half a square; black if the board is inverted.

    Args:
        board: the board.
        square_px: side of a square [px].

    Returns:
        (height, width) uint8 gray.
    """
    margin = square_px // 2
    if board.kind == "charuco":
        size = (board.columns * square_px, board.rows * square_px)
        image = charuco_board(board).generateImage(size, marginSize=0)
    else:
        dark = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2 == 0
        image = np.kron(np.where(dark, 0, 255).astype(np.uint8), np.ones((square_px, square_px), dtype=np.uint8))
    image = np.pad(image, margin, constant_values=255)
    return np.asarray(255 - image if board.inverted else image, dtype=np.uint8)


def board_png(board: Board, dots_per_inch: int) -> bytes:
    """Return the content of a PNG file of `draw_board` with its physical size, so that it is printed to scale.

    The squares' sides are rounded to whole dots, so they differ from the board's by up to half a dot.
    """
    dots_per_m = round(dots_per_inch / 0.0254)
    image = draw_board(board, round(board.square_m * dots_per_m))
    data = cv2.imencode(".png", image)[1].tobytes()
    size = b"pHYs" + struct.pack(">IIB", dots_per_m, dots_per_m, 1)
    chunk = struct.pack(">I", 9) + size + struct.pack(">I", zlib.crc32(size))
    header = 8 + 25  # the signature and IHDR, before pHYs
    return data[:header] + chunk + data[header:]


def _charuco_detector(board: Board) -> Any:
    return cv2.aruco.CharucoDetector(charuco_board(board))


def _corners_of_chessboard(gray: UInt8, board: Board) -> tuple[NDArray[np.int64], Float64] | None:
    """Return sub-pixel corners; the first square is black if colours determine the order."""
    corners = chessboard_corners(gray, (board.columns - 1, board.rows - 1))
    if corners is None:
        return None
    if not board.turnable and _first_square_is_light(gray, corners, board):
        corners = corners[::-1].copy()
    return np.arange(board.corners), corners


def _first_square_is_light(gray: UInt8, corners: Float64, board: Board) -> bool:
    """Return whether the board's black squares are the lighter ones, by the centres of the inner squares."""
    H = homography(board.corners_m[:, :2], corners)
    row, column = np.mgrid[1 : board.rows - 1, 1 : board.columns - 1].reshape(2, -1)
    middle = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))]) * [board.square_m, board.square_m, 1]
    x, y = ((middle @ H.T)[:, :2] / (middle @ H.T)[:, 2:]).round().astype(int).T
    value = gray[np.clip(y, 0, gray.shape[0] - 1), np.clip(x, 0, gray.shape[1] - 1)].astype(np.float64)
    dark = (row + column) % 2 == 0
    return bool(value[dark].mean() > value[~dark].mean())


def _spacing(ids: NDArray[np.int64], corners: Float64, board: Board) -> Float64:
    """Return (n,) the distance of each corner to its nearest detected neighbour on the board [px]; NaN without one."""
    row, column = np.divmod(ids, board.columns - 1)
    next_to = abs(row[:, None] - row) + abs(column[:, None] - column) == 1
    distance = np.where(next_to, np.linalg.norm(corners[:, None] - corners, axis=-1), np.inf).min(axis=1)
    return np.where(np.isfinite(distance), distance, np.nan)


def edge_width(gray: UInt8, corners: Float64, spacing: Float64) -> float:
    """Return the width of the edges at the corners: contrast over steepest slope, median over the corners [px].

    It shows how blurred an image is. NaN if it can be measured at no corner, because all are too near to their
    neighbours (below 5 px) or to the image's border. A step blurred by a Gaussian of standard deviation s is √(2π) s
    wide.

    Args:
        gray: (height, width) uint8.
        corners: (n, 2) [px].
        spacing: (n,) distance of each corner to its nearest neighbour on the board [px]; NaN for a corner to leave out.
    """
    widths = []
    for (x, y), space in zip(corners, spacing, strict=True):
        reach = int(0.4 * space) if np.isfinite(space) else 0
        left, top = round(x) - reach, round(y) - reach
        right, bottom = left + 2 * reach + 1, top + 2 * reach + 1
        if reach < 2 or left < 0 or top < 0 or right > gray.shape[1] or bottom > gray.shape[0]:
            continue
        patch = gray[top:bottom, left:right].astype(np.float64)
        low, high = np.percentile(patch, [5, 95])
        down, across = np.gradient(patch)
        slope = np.percentile(np.hypot(down, across), 98)
        if slope > 0:
            widths.append((high - low) / slope)
    return float(np.median(widths)) if widths else float("nan")


def why_not_found(images: Sequence[UInt8], board: Board) -> str:
    """Explain, for users, what images show instead of a board; slow, for use when no board was found.

    Args:
        images: (height, width) gray or (height, width, 3) BGR, uint8.
        board: the board that was searched.

    Returns:
        One line that suggests what to change: from the first image that shows another board, or general advice if none
        does.
    """
    wanted = _describe(board)
    if board.kind == "chessboard" and (other := _other_chessboard(images, board)):
        return f"found no corner of {wanted}; {other}"
    for image in images:
        for inverted in (board.inverted, not board.inverted):
            gray = _gray(image, inverted)
            said = (
                ""
                if inverted == board.inverted
                else f" with black and white exchanged: set inverted = {_toml(inverted)}"
            )
            if inverted != board.inverted and _finds(gray, board):
                return f"found no {wanted}, but one{said}"
            if _finds(np.ascontiguousarray(gray[:, ::-1]), board) and board.kind == "charuco":
                return f"found no {wanted}, but one in the mirrored picture: switch off the camera's mirroring{said}"
            other = _other_dictionary(gray, board) if board.kind == "charuco" else ""
            if other:
                return f"found no corner of {wanted}; {other}{said}"
    return f"found no corner of {wanted}, nor any other board: is it in the picture, whole, flat, lit and sharp?"


def _toml(value: bool) -> str:
    return "true" if value else "false"


def _describe(board: Board) -> str:
    name = "chessboard" if board.kind == "chessboard" else board.dictionary
    return f"{name} board of {board.columns} × {board.rows} squares"


def _finds(gray: UInt8, board: Board) -> bool:
    if board.kind == "chessboard":
        return _corners_of_chessboard(gray, board) is not None
    ids = _charuco_detector(board).detectBoard(gray)[1]
    return ids is not None and len(ids) >= FEW_MARKERS


def _other_dictionary(gray: UInt8, board: Board) -> str:
    best, most, highest = "", 0, 0
    for name in (board.dictionary, *DICTIONARIES):
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        ids = cv2.aruco.ArucoDetector(markers).detectMarkers(gray)[1]
        # Of nested dictionaries, the smallest with the most markers is named.
        if ids is not None and len(np.unique(ids)) > most:
            best, most, highest = name, len(np.unique(ids)), int(ids.max())
    if most < FEW_MARKERS:
        return ""
    if best == board.dictionary:
        needed = board.columns * board.rows // 2
        return (
            f"its markers are there ({most}, the highest number {highest}; this board has 0 to {needed - 1}), but in "
            "another order: are columns and rows right, or is it a legacy = true board?"
        )
    return f"of {best} there are {most} markers: is that the board? Then set dictionary = {best!r}".replace("'", '"')


def _other_chessboard(images: Sequence[UInt8], board: Board) -> str:
    """Return the size of the largest chessboard in some of the images, or empty; a part of a board is often seen."""
    step = max(1, len(images) // MOST_SEARCHED)
    sizes = [size for image in images[::step][:MOST_SEARCHED] if (size := chessboard_size(_gray(image, False)))]
    found = max(sizes, key=lambda size: size[0] * size[1], default=None)
    if found is None or set(found) == {board.columns - 1, board.rows - 1}:
        return ""
    columns, rows = found[0] + 1, found[1] + 1
    inner = set(found) == {board.columns, board.rows}
    said = " (columns and rows count squares, not inner corners)" if inner else ""
    return f"there is one of {columns} × {rows} squares: set columns and rows so{said}"
