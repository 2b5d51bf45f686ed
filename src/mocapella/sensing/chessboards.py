"""Find the inner corners of chessboards in images, by either of OpenCV's detectors, and tell a board's size.

The newer detector (Duda and Frese 2018) is more accurate; the older one finds boards that are tilted, small or partly
in shadow. A grid of corners may be a part of a larger board: beyond a true board's outer squares the colours do not go
on alternating.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.homography import homography

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SEEDS: Final = ((3, 3), (4, 3), (5, 4))
"""Numbers of inner corners of the first part of a board of unknown size."""
_ALTERNATES: Final = 0.5
"""Least difference of neighbouring squares beyond a grid, by that within it, of a board that goes on."""
_MOST: Final = 40
"""Largest number of inner corners a side of a board that is grown."""
_OLDER: Final = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE


def chessboard_corners(gray: UInt8, shape: tuple[int, int]) -> Float64 | None:
    """Find a chessboard with exactly so many inner corners.

    Args:
        gray: (height, width) uint8.
        shape: numbers of inner corners in a row and in a column.

    Returns:
        (corners, 2) row by row [px]; None if no detector finds them, or they are a part of a larger board.
    """
    if min(shape) < min(SEEDS[0]):
        return None  # too small for both detectors
    found, corners, larger = _largest(gray, shape)
    if found and larger != shape and set(larger) == set(shape):
        found, corners = cv2.findChessboardCornersSB(gray, shape, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        larger = shape
    new = found and larger == shape
    grid = np.asarray(corners, dtype=np.float64).reshape(-1, 2) if new else _older(gray, shape)
    return grid if grid is not None and grown(gray, grid, shape) == shape else None


def chessboard_size(gray: UInt8) -> tuple[int, int] | None:
    """Return the numbers of inner corners, the larger first, of the chessboard in an image; None if there is none."""
    best: tuple[int, int] | None = None
    for seed in SEEDS:
        found, corners, shape = _largest(gray, seed)
        if not found:
            old = _older(gray, seed)
            if old is None:
                continue
            corners, shape = old, seed
        whole = grown(gray, np.asarray(corners, dtype=np.float64).reshape(-1, 2), shape)
        size = (max(whole), min(whole))
        if best is None or size[0] * size[1] > best[0] * best[1]:
            best = size
    return best


def grown(gray: UInt8, corners: Float64, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of inner corners of the board that a grid of corners is a part of; ``shape`` if it is whole.

    Args:
        gray: (height, width) uint8.
        corners: (corners, 2) row by row [px].
        shape: numbers of corners in a row and in a column.
    """
    grid = corners.reshape(shape[1], shape[0], 2)
    sides = ((0, False), (0, True), (1, False), (1, True))
    moved = True
    while moved and max(grid.shape[:2]) < _MOST:
        moved = False
        for axis, at_end in sides:
            turned = _turned(grid, axis, at_end)
            if _goes_on(gray, turned):
                grid = _turned(_with_column(gray, turned), axis, at_end)
                moved = True
    return grid.shape[1], grid.shape[0]


def _turned(grid: Float64, axis: int, at_end: bool) -> Float64:
    """Return the grid with one of its sides as the last column; a second call with the same sides undoes it."""
    if axis == 1:
        return grid if at_end else grid[:, ::-1]
    return grid.transpose(1, 0, 2) if at_end else grid[::-1, ::-1].transpose(1, 0, 2)


def _goes_on(gray: UInt8, grid: Float64) -> bool:
    """Return whether the squares beyond the outer ones, on the side of the last column, alternate as these do."""
    rows, columns = grid.shape[:2]
    H = _homography(grid)
    contrasts = []
    for column in (columns - 1, columns):
        row = np.arange(-1, rows)
        value = _values(gray, H, row, np.full(len(row), column))
        contrasts.append(float((np.where((row + column) % 2 == 0, 1.0, -1.0) * (value - value.mean())).mean()))
    outer, beyond = contrasts
    return abs(outer) > 5.0 and beyond / outer > _ALTERNATES


def _with_column(gray: UInt8, grid: Float64) -> Float64:
    """Return the grid with one more column, at the image's corners next to where the others put them."""
    rows, columns = grid.shape[:2]
    H = _homography(grid)
    points = np.column_stack([np.full(rows, columns), np.arange(rows), np.ones(rows)]) @ H.T
    expected = (points[:, :2] / points[:, 2:]).astype(np.float32)
    spacing = float(np.linalg.norm(expected - grid[:, -1], axis=-1).min())
    reach = int(np.clip(0.25 * spacing, 2, 8))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
    refined: Any = cv2.cornerSubPix(gray, expected.reshape(-1, 1, 2).copy(), (reach, reach), (-1, -1), stop)
    column = np.asarray(refined, dtype=np.float64).reshape(rows, 1, 2)
    return np.concatenate([grid, column], axis=1)


def _homography(grid: Float64) -> Float64:
    rows, columns = grid.shape[:2]
    row, column = np.mgrid[0:rows, 0:columns].reshape(2, -1)
    return homography(np.column_stack([column, row]).astype(np.float64), grid.reshape(-1, 2))


def _values(gray: UInt8, H: Float64, row: Any, column: Any) -> Float64:
    """Return the brightness of squares, given by the corner at their beginning; NaN outside the image."""
    found = []
    for right, down in ((0.5, 0.5), (0.3, 0.5), (0.7, 0.5), (0.5, 0.3), (0.5, 0.7)):
        points = np.column_stack([column + right, row + down, np.ones(len(row))]) @ H.T
        x, y = (points[:, :2] / points[:, 2:]).round().T
        inside = (x >= 0) & (y >= 0) & (x < gray.shape[1]) & (y < gray.shape[0]) & (points[:, 2] * H[2, 2] > 0)
        value = np.full(len(row), np.nan)
        value[inside] = gray[y[inside].astype(int), x[inside].astype(int)]
        found.append(value)
    return np.asarray(np.mean(found, axis=0))


def _largest(gray: UInt8, least: tuple[int, int]) -> tuple[bool, Any, tuple[int, int]]:
    """Detect a chessboard with at least so many inner corners a row and column; return its corners and their counts."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, squares = cv2.findChessboardCornersSBWithMeta(gray, least, flags)
    return found, corners, (squares.shape[1], squares.shape[0]) if found else (0, 0)


def _older(gray: UInt8, shape: tuple[int, int]) -> Float64 | None:
    """Return (corners, 2) of OpenCV's older detector, refined, with rows to the right of columns; None without."""
    found, corners = cv2.findChessboardCorners(gray, shape, flags=_OLDER)
    if not found:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(shape[1], shape[0], 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[::-1]
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1)]
    reach = int(np.clip(0.3 * min(float(step.min()) for step in steps), 2, 11))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.002)
    start = grid.reshape(-1, 1, 2).astype(np.float32)
    refined = np.asarray(cv2.cornerSubPix(gray, start.copy(), (reach, reach), (-1, -1), stop), dtype=np.float64)
    far = np.abs(refined - start).max(axis=-1) > reach
    return np.where(far[..., None], start, refined).reshape(-1, 2)
