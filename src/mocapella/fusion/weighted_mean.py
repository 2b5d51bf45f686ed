"""Fuse many views of one person into one skeleton, weighted by their reliability.

A joint's variance in a view grows with the distance and depends on its tracking state; a view that is far from the
predicted joint counts less, by the weight of a Student-t distribution (Lange, Little, Taylor: Robust Statistical
Modeling Using the t Distribution, 1989), so that one wrong sensor does not displace the person.

Sensors disagree by several centimetres, more so from opposite directions: a joint would jump whenever one of them loses
it. So each view is brought to the common mean by its own slowly changing offset of each joint, which stays while the
view is missing, and fades while it is the only one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


class FusionParameters(NamedTuple):
    """The fields of `FusionSettings`, with the same meaning and units, as floats for the kernels."""

    sd_m: float
    inferred_factor: float
    clipped_factor: float
    degrees_of_freedom: float
    offset_s: float
    age_speed_m_s: float


@dataclass(frozen=True)
class FusionSettings:
    """Reliability of views.

    Attributes:
        sd_m: standard deviation of a tracked joint's coordinate at a distance of 2 m; it grows with the square of the
            distance; larger: the prediction counts more, with less jitter and more lag [m].
        inferred_factor: factor of the standard deviation of an inferred joint; larger: inferred joints count less. Of a
            Kinect v2 it is smaller, as a geometric mean over joints and directions (the table `sd_m` of
            ``kinect_v2_measured.json``); with 2, postures with most joints inferred are taken for measured [ratio].
        clipped_factor: factor of the standard deviation for a body that is cut off at an edge of the image; larger:
            such a view counts less [ratio].
        degrees_of_freedom: parameter of the Student-t weight of a view; smaller: a view far from the prediction counts
            less; infinity disables the weight [degrees of freedom].
        offset_s: time constant of learning and fading of a view's offset from the mean; larger: smoother when views
            come and go [s].
        age_speed_m_s: growth of the standard deviation with a view's age; larger: older views count less [m/s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    sd_m: float = 0.015
    inferred_factor: float = 2.5
    clipped_factor: float = 2.0
    degrees_of_freedom: float = 5.0
    offset_s: float = 0.3
    age_speed_m_s: float = 0.5

    def __post_init__(self) -> None:
        check(0 < self.sd_m < 10, "sd_m", self.sd_m, "above 0 m")
        check(self.inferred_factor >= 1, "inferred_factor", self.inferred_factor, "1 or more")
        check(self.clipped_factor >= 1, "clipped_factor", self.clipped_factor, "1 or more")
        check(self.degrees_of_freedom > 0, "degrees_of_freedom", self.degrees_of_freedom, "above 0")
        check(0 <= self.offset_s < 1e6, "offset_s", self.offset_s, "0 s or more")
        check(0 <= self.age_speed_m_s < 1e3, "age_speed_m_s", self.age_speed_m_s, "0 m/s or more")

    @cached_property
    def parameters(self) -> FusionParameters:
        """The settings for the kernels, as floats."""
        return FusionParameters(
            float(self.sd_m), float(self.inferred_factor), float(self.clipped_factor), float(self.degrees_of_freedom),
            float(self.offset_s), float(self.age_speed_m_s),
        )  # fmt: skip


def view_variances(
    states: UInt8, distances_m: Float64, clipped: NDArray[np.bool_], ages_s: Float64, settings: FusionSettings
) -> Float64:
    """Return the variance of a coordinate of each joint in each view, as the weights of `weighted_mean`.

    Args:
        states: (views, joints) `JointState`.
        distances_m: (views,) distance from the sensor to the body; less than 0.5 m counts as 0.5 m [m].
        clipped: (views,) whether the body is cut off at an edge of the image.
        ages_s: (views,) age of the view [s].
        settings: the settings.

    Returns:
        (views, joints) variances [m²]; infinite where not tracked.
    """
    s, kernels = settings, _kernels()
    variances = np.empty(states.shape)
    for i in range(len(states)):
        sd = kernels.sd_at(s.sd_m, distances_m[i], clipped[i], s.clipped_factor)
        kernels.joint_variances(states[i], sd, s.inferred_factor, (s.age_speed_m_s * ages_s[i]) ** 2, variances[i])
    return variances


class Fused(msgspec.Struct, frozen=True, eq=False):
    """Fused joints: ``positions`` (joints, 3) [m] and ``variances`` (joints,) of a coordinate [m²].

    A joint that no view has is NaN, with infinite variance.
    """

    positions: Float64
    variances: Float64


def weighted_mean(
    views: Float64, variances: Float64, expected: Float64, expected_variances: Float64, degrees_of_freedom: float
) -> Fused:
    """Return the mean of the views by inverse variance, with less weight far from the prediction.

    Args:
        views: (views, joints, 3) positions in one frame of reference at one time [m]; NaN where not seen.
        variances: (views, joints) [m²]; infinite where not seen.
        expected: (joints, 3) predicted joints [m]; where NaN, the weights are the inverse variances alone.
        expected_variances: (joints,) variance of a predicted coordinate [m²].
        degrees_of_freedom: parameter of the Student-t weight, which lowers views far from the prediction; infinity
            disables it.

    Returns:
        The mean and its variance, which includes the scatter of the views about their mean; see `Fused` for joints that
        no view has.
    """
    fused = Fused(np.empty(expected.shape), np.empty(len(expected)))
    _kernels().fuse(
        views, variances, expected, expected_variances, float(degrees_of_freedom), fused.positions, fused.variances
    )
    return fused


def learn_offsets(offsets: Float64, views: Float64, mean: Float64, dt: float, settings: FusionSettings) -> Float64:
    """Return each view's offset from the mean after a time step; subtracted from the view, it avoids jumps of the mean.

    If two or more views have a joint, their offsets approach the present differences; the offset of a single view
    fades to 0. The offset of a view without the joint stays.

    Args:
        offsets: (views, joints, 3) before [m].
        views: (views, joints, 3), not corrected by the offsets [m]; NaN where not seen.
        mean: (joints, 3) mean of the uncorrected views [m].
        dt: time step, 0 or more [s].
        settings: the settings.

    Returns:
        (views, joints, 3), a new array [m].
    """
    step = 1.0 if settings.offset_s == 0.0 else -math.expm1(-dt / settings.offset_s)
    offsets = offsets.copy()
    _kernels().follow_offsets(offsets, views, mean, step)
    return offsets


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.fusion import view_kernels

    return view_kernels
