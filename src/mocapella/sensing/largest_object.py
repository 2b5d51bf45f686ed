"""Find the largest object in a mask of foreground samples, such as a person before a known background."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.model.silhouettes import Silhouette

_GAP, _GRAIN = 5, 3
"""Sides of the squares that close gaps and remove grains [samples]."""


def largest_object(changed: NDArray[np.bool_], step_px: int) -> Silhouette | None:
    """Return the largest connected object of a mask, after gaps are closed and single samples removed.

    Args:
        changed: (rows, columns) foreground samples of the whole image.
        step_px: distance between samples [px].

    Returns:
        A silhouette in the whole image, with phi of 0.5 on the object and −0.5 elsewhere instead of signed distances;
        None if there is no object.
    """
    cleaned = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((_GAP, _GAP), np.uint8))
    cleaned = cv2.morphologyEx(cleaned, cv2.MORPH_OPEN, np.ones((_GRAIN, _GRAIN), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned)
    if len(stats) < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return Silhouette((0, 0), step_px, (labels == largest).astype(np.float32) - np.float32(0.5))
