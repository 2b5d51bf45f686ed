"""Two plain ways of 2012 to count fingers, of which the problems are shown beside those of the line skeleton.

Convexity defects of the outline, and Hough lines of the edges. The two that the document of `line-skeleton` gave up are
the detectors `angular-segments` and `line-skeleton-3d`.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


def hand_mask(depth: Float32, wrist_row: int) -> NDArray[np.uint8]:
    """255 where an upright hand is, above the wrist's row."""
    mask = np.asarray(255 * (depth > 0), dtype=np.uint8)
    mask[wrist_row:] = 0
    return mask


def fingers_by_defects(mask: NDArray[np.uint8], deep_px: float) -> int:
    """How many fingers a deep gap of the outline is between: one more than there are gaps."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=cv2.contourArea)
    defects = cv2.convexityDefects(outline, cv2.convexHull(outline, returnPoints=False))
    gaps = 0
    for start, end, far, depth in () if defects is None else defects[:, 0]:
        a, b = outline[start, 0] - outline[far, 0], outline[end, 0] - outline[far, 0]
        gaps += depth / 256 > deep_px and float(a @ b) > 0  # narrower than a right angle
    return gaps + 1 if gaps else 0


def lines_of_fingers(mask: NDArray[np.uint8], long_px: float) -> Float64:
    """(n, 4) straight lines of the outline that are as long as a finger."""
    found = cv2.HoughLinesP(cv2.Canny(mask, 50, 150), 1, np.pi / 180, 20, None, long_px, 4)
    return np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)
