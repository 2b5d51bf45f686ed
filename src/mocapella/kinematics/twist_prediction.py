"""Predict the next pose of a tree, and penalise deviations from it, so that smoothing is part of the estimate.

The prediction repeats the last motion: the root's in its own frame, so that a person who runs in a circle is
predicted on the circle, and the angles' velocities (B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online
Smoothing for Markerless Motion Capture", DAGM 2007, equations 16 and 17). `smoothness` is the cost of a deviation from
it (equation 18).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mocapella.kinematics.twist_fit import Prior
from mocapella.model.twist_tree import TreePose, TwistTree
from mocapella.settings import check


@dataclass(frozen=True)
class JitterPenalty:
    """Weights of the smoothness prior, the penalty on deviations from the predicted pose; 0 disables a term.

    Attributes:
        root_per_m: inverse standard deviation of the root's position [1/m].
        root_per_rad: inverse standard deviation of its orientation [1/rad].
        angle_per_rad: inverse standard deviation of every angle [1/rad].
    """

    root_per_m: float
    root_per_rad: float
    angle_per_rad: float

    def __post_init__(self) -> None:
        for name in ("root_per_m", "root_per_rad", "angle_per_rad"):
            check(0 <= getattr(self, name) < np.inf, name, getattr(self, name), "0 or more")


def predicted(before: TreePose, last: TreePose, ratio: float = 1.0) -> TreePose:
    """Extrapolate a pose by repeating the motion from ``before`` to ``last``; its angles may be beyond the limits.

    Args:
        before, last: successive poses, with leading batch axes.
        ratio: time from ``last`` to the instant of the prediction, divided by the time from ``before`` to ``last``.
    """
    T = np.empty(np.shape(last.T_world_model))
    for k in np.ndindex(T.shape[:-2]):
        _kernels().carry_on(before.T_world_model[k], last.T_world_model[k], float(ratio), T[k])
    return TreePose(T, last.angles + ratio * (last.angles - before.angles))


def looser(prior: Prior, times: float) -> Prior:
    """Inflate a prior's uncertainty: multiply its standard deviations by ``times``, above 0; its pose is shared."""
    per_m, per_rad = prior.root_per_m / times, prior.root_per_rad / times
    return Prior(prior.pose, per_m, per_rad, np.asarray(prior.angles_per_rad) / times)


def smoothness(tree: TwistTree, prediction: TreePose, penalty: JitterPenalty) -> Prior:
    """Return the smoothness prior: a Gaussian about the predicted pose, for `mocapella.kinematics.twist_fit.fit`.

    The prediction is one of `predicted`, without batch axes; the same weight applies to every angle.
    """
    every = np.full(len(tree.joint_parts), penalty.angle_per_rad)
    return Prior(prediction, penalty.root_per_m, penalty.root_per_rad, every)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import turn_kernels

    return turn_kernels
