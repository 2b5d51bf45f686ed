"""Agreement of two methods of measurement: mean, SD, RMSE, bias and 95 % limits (J. Bland, D. Altman, Lancet 1986)."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

LIMIT: Final = 1.96
"""Half-width of the 95 % limits of agreement, in standard deviations of the differences (Bland and Altman, 1986)."""


class LimitsOfAgreement(msgspec.Struct, frozen=True):
    """Agreement of a value, in the value's own unit.

    Attributes:
        n: number of compared samples. They follow each other in time, so fewer of them are independent.
        mean: mean of the absolute differences; for positions, mean distance.
        sd: standard deviation of the absolute differences; for positions, of the distance.
        rmse: root of the mean square difference; for positions, of the distance.
        bias: mean difference, recording minus reference; for positions x, y and z.
        difference_sd: standard deviation of the differences; for positions, in x, y and z.
        low, high: 95 % limits of agreement, bias ∓ 1.96 standard deviations; for positions, in x, y and z.
    """

    n: int
    mean: float
    sd: float
    rmse: float
    bias: tuple[float, ...]
    difference_sd: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


def agreement(differences: Float64) -> LimitsOfAgreement | None:
    """Return the agreement of differences (samples, axes), recording minus reference; None with fewer than two.

    Samples with an unknown axis are left out.
    """
    known = differences[np.isfinite(differences).all(axis=1)]
    if len(known) < 2:
        return None
    size = np.linalg.norm(known, axis=1)
    bias, sd = known.mean(axis=0), known.std(axis=0, ddof=1)
    return LimitsOfAgreement(
        len(known), float(size.mean()), float(size.std(ddof=1)), float(np.sqrt((size**2).mean())),
        *(tuple(float(value) for value in one) for one in (bias, sd, bias - LIMIT * sd, bias + LIMIT * sd)),
    )  # fmt: skip
