"""Fuse one arm's points from several depth cameras by their uncertainty.

A measured point is weighted by its information 1/sd² (inverse-variance weighting: J. Hartung, G. Knapp, B. Sinha,
*Statistical Meta-Analysis with Applications* (2008), section 4.1); inferred points are used only if no view measures
them. If views disagree, the largest group that agrees is used. If views agree less than their uncertainty implies, that
of the mean is increased by the Birge ratio (R. Birge, Phys. Rev. 40 (1932) 207).
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.hand import BASES, DIGIT_ANGLES, WRIST
from mocapella.settings import check

Bools = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class ArmFusionSettings:
    """Parameters of the fusion.

    Attributes:
        least_sd_m: lower bound of the standard deviation of a point's coordinate; larger: views count more equally [m].
        unsaid_sd_m: standard deviation of a coordinate for a view that gives none; larger: views without one count less
            [m].
        gate_m: two views agree about a point within this distance plus ``gate_sds`` standard deviations of their
            difference; larger: contradicting views are averaged instead of left out [m].
        gate_sds: number of standard deviations of the difference of two views, added to ``gate_m``, within which they
            agree [standard deviations].
        far_m: upper bound of the whole distance within which two views agree, however uncertain they are [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    least_sd_m: float = 0.003
    unsaid_sd_m: float = 0.02
    gate_m: float = 0.01
    gate_sds: float = 3.0
    far_m: float = 0.06

    def __post_init__(self) -> None:
        for name in ("least_sd_m", "unsaid_sd_m", "gate_m", "gate_sds", "far_m"):
            check(0 < getattr(self, name) <= 100, name, getattr(self, name), "above 0 and at most 100")


class FusedPoints(msgspec.Struct, frozen=True, eq=False):
    """Result of `fuse_points`.

    Attributes:
        points: (n, 3) in the views' common frame [m]; NaN where no view has the point.
        states: (n,) the highest `JointState` of the views that have the point; not tracked if none has it.
        sd: (n,) standard deviation of a coordinate [m]; NaN where no view has the point.
        weights: (views, n) information 1/sd² of the fused views [1/m²]; 0 for the others.
        disputed: (views, n) whether a view's measured point was left out because it contradicts the fused views.
    """

    points: Float64
    states: UInt8
    sd: Float32
    weights: Float64
    disputed: Bools


def fuse_points(
    points: Float64, states: UInt8, sd: Float64, expected: Float64, settings: ArmFusionSettings | None = None
) -> FusedPoints:
    """Fuse several views of the same points at one time, each point separately.

    Args:
        points: (views, n, 3) of one view or more, all in one frame [m]; NaN where not known.
        states: (views, n) `JointState`; a point that is not tracked is not used, an inferred one only if no view
            measures the point.
        sd: (views, n) standard deviation of a coordinate [m]; NaN where a view gives none.
        expected: (n, 3) predicted points [m], or NaN. If equally many views contradict each other, those about the view
            nearest to it are used; if it is NaN, those about the view with the smallest standard deviation.
        settings: gates and bounds; the defaults if None.
    """
    s = settings or ArmFusionSettings()
    known = (states > 0) & np.isfinite(points).all(axis=-1)
    level = np.where(known, states, 0).astype(np.uint8)
    best = level.max(axis=0)
    usable = known & (level == best)
    sd = np.maximum(np.where(np.isfinite(sd), sd, s.unsaid_sd_m), s.least_sd_m)
    p = np.where(usable[..., None], points, 0.0)
    apart = np.linalg.norm(p[:, None] - p[None], axis=-1)  # (views, views, n)
    gate = np.minimum(s.gate_m + s.gate_sds * np.hypot(sd[:, None], sd[None]), s.far_m)
    agree = (apart <= gate) & usable[:, None] & usable[None]
    off = np.linalg.norm(points - expected, axis=-1)
    tie = np.where(np.isfinite(off), off, sd)
    score = np.where(usable, agree.sum(axis=1) - tie / (1.0 + tie), -np.inf)
    anchor = np.argmax(score, axis=0)
    used = np.take_along_axis(agree, anchor[None, None, :], axis=0)[0]
    weights = np.where(used, 1.0 / (sd * sd), 0.0)
    total = weights.sum(axis=0)
    there = total > 0
    safe = np.where(there, total, 1.0)
    mean = (weights[..., None] * p).sum(axis=0) / safe[:, None]
    scatter = (weights * ((p - mean) ** 2).sum(axis=-1)).sum(axis=0)
    birge = np.maximum(1.0, scatter / np.maximum(3 * (used.sum(axis=0) - 1), 1))
    return FusedPoints(
        np.where(there[:, None], mean, np.nan),
        best,
        np.where(there, np.sqrt(birge / safe), np.nan).astype(np.float32),
        weights,
        usable & ~used & (level == 2),
    )


def fuse_angles(angles: Float64, weights: Float64) -> Float64:
    """Return the weighted mean of the views' hand angles, by the sum of each view's weights of the angle's digit.

    Args:
        angles: (views, 21) angles in the order of `mocapella.model.hand.ANGLES` [rad]; NaN where not known.
        weights: (views, n) of `FusedPoints` [1/m²]; the first 21 points are the hand's landmarks. If no point of a
            digit was used, its angles are unweighted means of the views.

    Returns:
        (21,) angles [rad]; NaN where no view knows the angle.
    """
    of_digit = weights[:, 1:21].reshape(len(weights), 5, 4).sum(axis=-1)
    w = np.zeros(angles.shape)
    for digit, places in enumerate(DIGIT_ANGLES):
        w[:, places[places >= 0]] = of_digit[:, digit, None]
    w = np.where(np.isfinite(angles), w + 1e-9, 0.0)  # also if only views with unused points have it
    total = w.sum(axis=0)
    mean = (w * np.nan_to_num(angles)).sum(axis=0) / np.where(total > 0, total, 1.0)
    return np.where(total > 0, mean, np.nan)


def fuse_poses(T: Float64, weights: Float64) -> Float64 | None:
    """Return the weighted mean (4, 4) of the views' palm poses ``T`` (views, 4, 4); None if no view has a pose.

    The poses are finite and in one frame. A view's weight is the information of its wrist and knuckles in ``weights``
    (views, n) of `FusedPoints`; the mean is unweighted if no view has any.

    The rotation is the nearest one to the weighted mean of the matrices (the chordal mean: R. Hartley et al., "Rotation
    Averaging", International Journal of Computer Vision 103 (2013), section 5.3).
    """
    if not len(T):
        return None
    w = weights[:, [WRIST, *BASES]].sum(axis=1) + 1e-9
    mean = (w[:, None, None] * T).sum(axis=0) / w.sum()
    U, _, Vt = np.linalg.svd(mean[:3, :3])
    out = np.eye(4)
    out[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    out[:3, 3] = mean[:3, 3]
    return out
