"""Reduce an image to samples, each the mean of a square of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]


def image_samples(image: UInt8, step_px: int) -> UInt8:
    """Return the samples (rows, columns, channels) of an image; pixels beyond the last whole square are left out.

    Args:
        image: (height, width) or (height, width, 3) uint8.
        step_px: distance between samples, 1 or more [px].
    """
    import cv2

    height, width = image.shape[:2]
    size = (max(width // step_px, 1), max(height // step_px, 1))
    whole = image[: size[1] * step_px, : size[0] * step_px]
    small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)
    return small.reshape(size[1], size[0], -1)
