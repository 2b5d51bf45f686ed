"""The border of a silhouette as polylines of few points, to draw or send.

The border is traced along the samples, and thinned out evenly.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.model.silhouettes import Silhouette

Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

MOST_POINTS: Final = 300
"""Approximate limit of the points of a silhouette's lines together."""
FEWEST: Final = 3
"""Least number of samples of a line that encloses an area."""
_BETWEEN: Final = np.full((1, 2), np.nan, np.float32)


def border_samples(silhouette: Silhouette) -> Iterator[Int64]:
    """Yield (n, 2) x, y of the border samples of each part and hole of a silhouette [px], in order along the border."""
    mask = (silhouette.phi > 0).astype(np.uint8)
    for line in cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
        yield line[:, 0].astype(np.int64) * silhouette.step_px + np.array(silhouette.origin_px)


def border_lines(silhouette: Silhouette, most: int = MOST_POINTS) -> Float32:
    """Return (k, 2) float32 closed lines [px], separated by rows of NaN; (0, 2) if the silhouette is empty.

    A line's first point is not repeated at its end. Parts of fewer than three border samples are left out.

    Args:
        silhouette: its border is returned, in pixels of the whole image.
        most: approximate limit of points; longer borders are thinned out evenly.
    """
    return mask_lines((silhouette.phi > 0).view(np.uint8), silhouette.origin_px, silhouette.step_px, most)


def mask_lines(mask: UInt8, origin_px: tuple[int, int], step_px: int, most: int = MOST_POINTS) -> Float32:
    """Trace a mask's borders: (k, 2) float32 closed lines [px], separated by rows of NaN; (0, 2) if it is empty.

    Args:
        mask: (rows, columns) uint8 of a window of an image, not 0 on covered samples.
        origin_px, step_px: x and y of the window's first sample, and distance between samples [px].
        most: approximate limit of points; longer borders are thinned out evenly.
    """
    found = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    lines = [line for line in found if len(line) >= FEWEST]
    every = max(1, -(-sum(map(len, lines)) // most))
    rows: list[NDArray[Any]] = []
    for line in lines:
        rows += [line[::every, 0], _BETWEEN]
    if not rows:
        return np.empty((0, 2), np.float32)
    return np.concatenate(rows[:-1], dtype=np.float32) * np.float32(step_px) + np.array(origin_px, np.float32)
