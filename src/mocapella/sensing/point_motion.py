"""Motion of points between two grey images: pyramidal Lucas-Kanade optical flow (J.-Y. Bouguet, Intel, 2001)."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

_WINDOW_PX: Final = (21, 21)
_LEVELS: Final = 3


def grey(image: UInt8, scale: float = 1.0) -> UInt8:
    """Return an image (height, width, 3) BGR as grey (height, width), resized by ``scale``, 1 or less."""
    found = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if scale < 1.0:
        found = cv2.resize(found, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(found, np.uint8)


def point_motion(before: UInt8, after: UInt8, points_px: Float64) -> Float64:
    """Return by how much points (n, 2) [px] of an image move to another image: (n, 2) [px]; NaN where it is not found.

    Args:
        before, after: (height, width) uint8 grey images of one size.
        points_px: (n, 2) places in ``before``; NaN gives NaN.
    """
    out = np.full(points_px.shape, np.nan)
    known = np.isfinite(points_px).all(axis=1)
    if known.any():
        start = points_px[known].astype(np.float32).reshape(-1, 1, 2)
        end, status, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
            before, after, start, None, winSize=_WINDOW_PX, maxLevel=_LEVELS
        )
        out[known] = np.where(status > 0, (end - start)[:, 0], np.nan)
    return out
