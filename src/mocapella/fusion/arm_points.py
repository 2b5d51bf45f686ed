"""One arm's points of several depth cameras' views of it, by how sure each view is of each.

What measures a point counts by its information 1/sd² (inverse-variance weighting: J. Hartung, G. Knapp, B. Sinha,
*Statistical Meta-Analysis with Applications* (2008), section 4.1); what only infers it counts where nobody measures it.
Views that disagree about a point are told apart first: the largest group that agrees is believed. Where views agree
less than they say, their mean is said to be less sure, by the Birge ratio (R. Birge, Phys. Rev. 40 (1932) 207).
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
    """How views of an arm become one.

    Attributes:
        least_sd_m: no view is surer of a point than that.
        unsaid_sd_m: of a point of which a view does not say.
        gate_m: views agree about a point that they have no farther apart than that …
        gate_sds: … and so many standard deviations of their difference.
        far_m: views that agree never have it farther apart than that, whatever they say.
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
    """Points of all views together.

    Attributes:
        points: (n, 3) [m]; NaN where no view knows.
        states: (n,) `JointState`: of the best view.
        sd: (n,) [m]; NaN where not known.
        weights: (views, n) information of what was used [1/m²], 0 where it was not.
        disputed: (views, n) what a view measured, and the others do not agree with.
    """

    points: Float64
    states: UInt8
    sd: Float32
    weights: Float64
    disputed: Bools


def fuse_points(
    points: Float64, states: UInt8, sd: Float64, expected: Float64, settings: ArmFusionSettings | None = None
) -> FusedPoints:
    """What several views of one instant say together.

    Args:
        points: (views, n, 3), all in one frame [m]; NaN where not known.
        states: (views, n) `JointState`.
        sd: (views, n) [m]; NaN where a view does not say.
        expected: (n, 3) where they were expected [m], NaN where nowhere; settles which of two that disagree is right.
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
    """(21,) of `mocapella.model.hand.ANGLES`: each digit's by what its points counted; NaN where no view has one.

    Args:
        angles: (views, 21) [rad]; NaN where not known.
        weights: (views, n) as of `FusedPoints`, the hand's 21 landmarks first.
    """
    of_digit = weights[:, 1:21].reshape(len(weights), 5, 4).sum(axis=-1)
    w = np.zeros(angles.shape)
    for digit, places in enumerate(DIGIT_ANGLES):
        w[:, places[places >= 0]] = of_digit[:, digit, None]
    w = np.where(np.isfinite(angles), w + 1e-9, 0.0)  # also where only views tell of it whose points were not used
    total = w.sum(axis=0)
    mean = (w * np.nan_to_num(angles)).sum(axis=0) / np.where(total > 0, total, 1.0)
    return np.where(total > 0, mean, np.nan)


def fuse_poses(T: Float64, weights: Float64) -> Float64 | None:
    """The palm's pose (4, 4) of (views, 4, 4), by what wrist and knuckles counted; None of no views.

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
