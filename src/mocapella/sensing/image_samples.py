"""Reduce an image to samples, each the mean of a square of pixels, and read them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


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


def samples_at(samples: UInt8 | Bool, step_px: int, pixels: Float64) -> Float32:
    """Return the sample (n, channels) nearest to each pixel x, y (n, 2), and to those outside of the image.

    Args:
        samples: (rows, columns, channels).
        step_px: distance between samples, 1 or more [px].
        pixels: (n, 2) x, y [px].
    """
    column, row = np.floor((pixels + 0.5) / step_px).astype(np.int64).T
    rows, columns = samples.shape[:2]
    return np.asarray(samples[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)], np.float32)
