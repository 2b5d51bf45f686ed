"""Many views of one person → one skeleton, by what each view is worth.

A joint's variance in a view grows with the distance and with what the sensor itself says of it; a view that is far from
where the joint is expected counts less, by the weight of a Student-t distribution (Lange, Little, Taylor: Robust
Statistical Modeling Using the t Distribution, 1989), so that one sensor that is wrong does not pull everybody along.

Sensors disagree by several centimetres, and by more the further apart they look from: a joint would jump whenever one
of them loses it. So each view is brought to the common mean by its own slowly changing offset, which lives on while the
others are gone and fades.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class FusionSettings:
    """What a view is worth.

    Attributes:
        sd_m: standard deviation of a tracked joint's coordinate at 2 m [m]; it grows with the square of the distance.
        inferred_factor: how many times that an inferred joint's is.
        clipped_factor: and that of a body that is cut off at an edge of the view.
        degrees_of_freedom: of the Student-t weight; infinity trusts every view as it says.
        offset_s: time constant with which a view's offset from the mean is learnt and fades [s].
        age_speed_m_s: how much less certain a view is for each second of its age [m/s].
    """

    sd_m: float = 0.015
    inferred_factor: float = 5.0
    clipped_factor: float = 2.0
    degrees_of_freedom: float = 5.0
    offset_s: float = 1.0
    age_speed_m_s: float = 0.5

    def __post_init__(self) -> None:
        check(0 < self.sd_m < 10, "sd_m", self.sd_m, "above 0 m")
        check(self.inferred_factor >= 1, "inferred_factor", self.inferred_factor, "1 or more")
        check(self.clipped_factor >= 1, "clipped_factor", self.clipped_factor, "1 or more")
        check(self.degrees_of_freedom > 0, "degrees_of_freedom", self.degrees_of_freedom, "above 0")
        check(0 <= self.offset_s < 1e6, "offset_s", self.offset_s, "0 s or more")
        check(0 <= self.age_speed_m_s < 1e3, "age_speed_m_s", self.age_speed_m_s, "0 m/s or more")


_REFERENCE_M = 2.0


def view_variances(
    states: UInt8, distances_m: Float64, clipped: NDArray[np.bool_], ages_s: Float64, settings: FusionSettings
) -> Float64:
    """What a coordinate of each joint may be wrong by.

    Args:
        states: (..., joints) `JointState`.
        distances_m: (...,) from the sensor to the body.
        clipped: (...,) whether the body is cut off at an edge of the view.
        ages_s: (...,) how old the view is.
        settings: see there.

    Returns:
        (..., joints) variances [m²]; infinite where not tracked.
    """
    s = settings
    sd = s.sd_m * np.maximum(distances_m / _REFERENCE_M, 0.25) ** 2 * np.where(clipped, s.clipped_factor, 1.0)
    factor = np.where(states == JointState.INFERRED, s.inferred_factor, 1.0)
    variances = (sd[..., None] * factor) ** 2 + ((s.age_speed_m_s * ages_s) ** 2)[..., None]
    return np.where(states == JointState.NOT_TRACKED, np.inf, variances)


class Fused(msgspec.Struct, frozen=True, eq=False):
    """``positions`` (..., joints, 3) [m], NaN where no view has the joint; ``variances`` (..., joints) [m²]."""

    positions: Float64
    variances: Float64


def weighted_mean(
    views: Float64, variances: Float64, expected: Float64, expected_variances: Float64, degrees_of_freedom: float
) -> Fused:
    """The mean of the views by the inverse of their variances; those far from what is expected count less.

    Args:
        views: (..., views, joints, 3), in one frame at one instant [m]; NaN where not seen.
        variances: (..., views, joints) [m²]; infinite where not seen.
        expected: (..., joints, 3) where the joints are expected; NaN where nobody knows.
        expected_variances: (..., joints) [m²].
        degrees_of_freedom: of the Student-t weight.

    Returns:
        The mean and its variance, with that of the views about their mean in it: they may disagree by more than they
        say.
    """
    seen = np.isfinite(variances) & np.isfinite(views).all(axis=-1)
    weights = np.where(seen, 1.0 / variances, 0.0)
    if np.isfinite(degrees_of_freedom):
        known = seen & np.isfinite(expected[..., None, :, 0])
        away = np.where(known[..., None], views - expected[..., None, :, :], 0.0)
        allowed = np.where(known, variances + expected_variances[..., None, :], 1.0)
        surprise = (away**2).sum(axis=-1) / allowed
        weights *= (degrees_of_freedom + 3.0) / (degrees_of_freedom + np.maximum(surprise, 3.0))
    total = weights.sum(axis=-2)
    some = total > 0.0
    share = weights / np.where(some, total, 1.0)[..., None, :]
    mean = np.where(seen[..., None], share[..., None] * views, 0.0).sum(axis=-3)
    apart = np.where(seen[..., None], views - mean[..., None, :, :], 0.0)
    spread = (share * (apart**2).sum(axis=-1)).sum(axis=-2) / 3.0
    variance = 1.0 / np.where(some, total, 1.0) + spread
    return Fused(np.where(some[..., None], mean, np.nan), np.where(some, variance, np.inf))


def learn_offsets(offsets: Float64, views: Float64, mean: Float64, dt: float, settings: FusionSettings) -> Float64:
    """Each view's offset from the mean, a moment later.

    Where two or more views have a joint, their offsets approach what they are now; where one has it, it has nobody to
    differ from and its offset fades.

    Args:
        offsets: (..., views, joints, 3) as they were [m].
        views: (..., views, joints, 3), not corrected; NaN where not seen.
        mean: (..., joints, 3) of the views that are not corrected.
        dt: time since [s].
        settings: see there.
    """
    step = 1.0 if settings.offset_s == 0.0 else -np.expm1(-dt / settings.offset_s)
    seen = np.isfinite(views).all(axis=-1)
    several = seen.sum(axis=-2, keepdims=True) > 1
    now = np.where((seen & several)[..., None], views - mean[..., None, :, :], 0.0)
    return np.where(seen[..., None], offsets + step * (now - offsets), offsets)
