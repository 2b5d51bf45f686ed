"""Typical lenses of inexpensive cameras, as a prior for coefficients that few views of a board do not determine.

The standard deviations are wide for webcams and machine-vision lenses; that of k1 covers a wide angle of 110°.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.board_bundle import LensPrior

Float64 = NDArray[np.float64]

COEFFICIENTS: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
CENTRE_SD: Final = 0.04
"""Standard deviation of the principal point, as a fraction of the image width."""
ASPECT_SD: Final = 0.005
"""Standard deviation of fy/fx."""
DISTORTION_SD: Final = (0.4, 0.4, 0.005, 0.005, 0.3)
"""Standard deviations of k1 k2 p1 p2 k3."""
OBSERVED: Final = 0.5
"""A coefficient is determined if the views leave less than this fraction of its prior standard deviation."""


def lens_prior(sizes_px: Float64, focal_px: Float64) -> LensPrior:
    """Return the prior of the lenses of several cameras, for `board_bundle.adjust`; focal lengths are free in it.

    Args:
        sizes_px: (cameras, 2) width and height of the images [px].
        focal_px: (cameras,) rough focal lengths, which scale the prior of fy/fx only [px].
    """
    cameras = len(sizes_px)
    mean, precision = np.zeros((cameras, 9)), np.zeros((cameras, 9, 9))
    mean[:, 2:4] = (sizes_px - 1) / 2
    for c in range(cameras):
        precision[c, :2, :2] = np.array([[1, -1], [-1, 1]]) / (ASPECT_SD * focal_px[c]) ** 2
        sd = np.array([CENTRE_SD * sizes_px[c, 0]] * 2 + list(DISTORTION_SD))
        precision[c, 2:, 2:] = np.diag(sd**-2.0)
    return LensPrior(mean, precision)


def observed(covariance: Float64, size_px: tuple[int, int]) -> list[str]:
    """Return the coefficients among cx cy k1 k2 p1 p2 k3 that the views determined, in this order.

    Their standard deviations are below half of the prior's (`OBSERVED`); the others are typical values.

    Args:
        covariance: (9, 9) covariance of the estimated lens.
        size_px: (width, height) of the image.
    """
    before = np.array([CENTRE_SD * size_px[0]] * 2 + list(DISTORTION_SD))
    after = np.sqrt(np.diag(covariance)[2:])
    return [name for name, a, b in zip(COEFFICIENTS[2:], after, before, strict=True) if a < OBSERVED * b]
