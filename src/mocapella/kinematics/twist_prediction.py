"""Where a tree will be next, and the penalty on being elsewhere: smoothness that is part of the estimate.

The prediction repeats the last motion: the root's in its own frame, so that what runs in a circle goes on in it, and
the angles' velocities (B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion
Capture", DAGM 2007, equations 16 and 17). How far the estimate is from it costs what `smoothness` says (equation 18).
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
    """How steady the estimate is to be, against constraints of the weights they have; 0 is off.

    Attributes:
        root_per_m: of the root's way from where it was predicted [1/m].
        root_per_rad: of its turn from there [1/rad].
        angle_per_rad: of every angle [1/rad].
    """

    root_per_m: float
    root_per_rad: float
    angle_per_rad: float

    def __post_init__(self) -> None:
        for name in ("root_per_m", "root_per_rad", "angle_per_rad"):
            check(0 <= getattr(self, name) < np.inf, name, getattr(self, name), "0 or more")


def predicted(before: TreePose, last: TreePose, ratio: float = 1.0) -> TreePose:
    """The pose that comes next if everything goes on as from ``before`` to ``last``.

    Args:
        before, last: one after the other; leading batch axes.
        ratio: of the time until then to the time between these two.
    """
    T = np.empty(np.shape(last.T_world_model))
    for k in np.ndindex(T.shape[:-2]):
        _kernels().carry_on(before.T_world_model[k], last.T_world_model[k], float(ratio), T[k])
    return TreePose(T, last.angles + ratio * (last.angles - before.angles))


def looser(prior: Prior, times: float) -> Prior:
    """The same with deviations that are so many times as large."""
    per_m, per_rad = prior.root_per_m / times, prior.root_per_rad / times
    return Prior(prior.pose, per_m, per_rad, np.asarray(prior.angles_per_rad) / times)


def smoothness(tree: TwistTree, prediction: TreePose, penalty: JitterPenalty) -> Prior:
    """The penalty on a pose other than the predicted one, for `fit`."""
    every = np.full(len(tree.joint_parts), penalty.angle_per_rad)
    return Prior(prediction, penalty.root_per_m, penalty.root_per_rad, every)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import turn_kernels

    return turn_kernels
