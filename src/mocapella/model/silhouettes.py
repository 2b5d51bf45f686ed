"""Silhouettes in images, as level sets: of segmentations and of projected meshes."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


class Silhouette(msgspec.Struct, frozen=True, eq=False):
    """The silhouette of a body in a window of an image.

    Attributes:
        origin_px: (x, y) of the window's first sample in the image; whole pixels.
        step_px: stride of the samples [px]; 1 samples every pixel.
        phi: (rows, columns) signed distance of each sample to the contour, in pixels of the image, above 0 inside,
            clipped to a few pixels. The body lies within the window.
    """

    origin_px: tuple[int, int]
    step_px: int
    phi: Float32

    def mask(self, size_px: tuple[int, int]) -> NDArray[np.bool_]:
        """Return the mask (height, width) in an image of size (width, height), True inside the silhouette.

        Each sample covers the square of ``step_px`` pixels about it. Parts outside the image are cut off.
        """
        width, height = size_px
        out = np.zeros((height, width), dtype=np.bool_)
        x, y = self.origin_px
        inside = np.kron(self.phi > 0, np.ones((self.step_px, self.step_px), dtype=np.bool_))
        x -= (self.step_px - 1) // 2
        y -= (self.step_px - 1) // 2
        left, top = max(x, 0), max(y, 0)
        part = inside[top - y : max(height - y, 0), left - x : max(width - x, 0)]
        out[top : top + part.shape[0], left : left + part.shape[1]] = part
        return out


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Return the intersection over union of two masks of one shape; 0 if both are empty."""
    both = np.count_nonzero(a & b)
    union = np.count_nonzero(a) + np.count_nonzero(b) - both
    return both / union if union else 0.0
