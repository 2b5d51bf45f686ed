"""Fit a kinematic tree's pose to lines of sight, points and planes, with priors.

The estimate minimises

    Σ w |x × n − m|² + Σ w |x − y|² + Σ w (n·x − d)²
    + Σ (per_m |p − p̂|)² + (per_rad φ)² + Σ (angles_per_rad (θ − θ̂))²

over the root's motion and the angles θ within their limits, for points x of the parts, by Gauss–Newton steps in twists:
B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007, equations
10 to 14 and 26. `mocapella.kinematics.twist_fit_kernels` describes the algorithm. Lines (n, m), points y and planes
(n, d) are `Constraints`. The second line is a `Prior`; p is the tree's point ``root``, φ the angle of its rotation from
the expected one.

Weights are inverse variances w in 1/m²; priors take inverse standard deviations in 1/m and 1/rad. Only their ratios
affect the result. The caller computes robust weights from the residuals at the previous pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.twist_tree import TreePose, TwistTree
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


class OnLines(msgspec.Struct, frozen=True, eq=False):
    """Constraints that points of a tree lie on lines, such as a camera's lines of sight.

    A row with a number that is not finite, or without a positive weight, is ignored, also in `OnPoints` and `InPlanes`.

    Attributes:
        part: (n,) index of the tree's part that moves each point.
        points: (n, 3) positions in the rest pose [m].
        lines: (n, 6) Plücker lines (`geometry.plucker`) in the world.
        weights: (n,) inverse variances of the distances from the lines [1/m²].
    """

    part: Int64
    points: Float64
    lines: Float64
    weights: Float64


class OnPoints(msgspec.Struct, frozen=True, eq=False):
    """Constraints that points of a tree lie at given positions.

    Attributes:
        part, points, weights: (n,), (n, 3) [m], (n,) [1/m²] as of `OnLines`.
        targets: (n, 3) in the world [m].
    """

    part: Int64
    points: Float64
    targets: Float64
    weights: Float64


class InPlanes(msgspec.Struct, frozen=True, eq=False):
    """Constraints that points of a tree lie in planes.

    Attributes:
        part, points, weights: (n,), (n, 3) [m], (n,) [1/m²] as of `OnLines`.
        planes: (n, 4) of n·x = d in the world: unit normals, then d [m].
    """

    part: Int64
    points: Float64
    planes: Float64
    weights: Float64


Constraints = OnLines | OnPoints | InPlanes


class Prior(msgspec.Struct, frozen=True, eq=False):
    """Gaussian prior of the pose: a prediction, or a typical pose. An inverse standard deviation of 0 means no prior.

    Attributes:
        pose: mean of the prior.
        root_per_m: inverse standard deviation of the position of the tree's point ``root`` [1/m].
        root_per_rad: inverse standard deviation of the root's orientation [1/rad].
        angles_per_rad: (joints,) inverse standard deviations of the angles [1/rad].

    Raises:
        SettingsError: a weight is below 0 or not finite.
    """

    pose: TreePose
    root_per_m: float
    root_per_rad: float
    angles_per_rad: Float64

    def __post_init__(self) -> None:
        angles = np.asarray(self.angles_per_rad)
        least, most = float(angles.min(initial=0.0)), float(angles.max(initial=0.0))
        fine = least >= 0 and most < np.inf and 0 <= self.root_per_m < np.inf and 0 <= self.root_per_rad < np.inf
        check(fine, "weights of a prior", (self.root_per_m, self.root_per_rad, angles), "0 or more")


@dataclass(frozen=True)
class FitSettings:
    """Stopping criteria of a fit, which has converged when a step is below both ``rest_m`` and ``rest_rad``.

    Attributes:
        most_steps: largest number of accepted steps.
        rest_m: motion of the root in a step [m].
        rest_rad: largest rotation of the root and of any joint in a step [rad].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    most_steps: int = 20
    rest_m: float = 1e-5
    rest_rad: float = 1e-5

    def __post_init__(self) -> None:
        check(self.most_steps >= 1, "most_steps", self.most_steps, "1 or more")
        check(self.rest_m > 0, "rest_m", self.rest_m, "above 0 m")
        check(self.rest_rad > 0, "rest_rad", self.rest_rad, "above 0 rad")


DEFAULT = FitSettings()


class TreeFit(msgspec.Struct, frozen=True, eq=False):
    """Result of a fit.

    Attributes:
        pose: the fitted pose; its angles are within the limits.
        held: (joints,) whether each angle is at a limit.
        steps: number of accepted steps.
        rests: whether the fit converged, by the criteria of `FitSettings`.
        cost: weighted sum of squared residuals of the constraints at this pose.
        prior_cost: weighted sum of squared residuals of the priors.
    """

    pose: TreePose
    held: NDArray[np.bool_]
    steps: int
    rests: bool
    cost: float
    prior_cost: float


def fit(
    tree: TwistTree,
    start: TreePose,
    constraints: Sequence[Constraints],
    priors: Sequence[Prior] = (),
    settings: FitSettings = DEFAULT,
) -> TreeFit:
    """Fit the pose from an initial one; unconstrained degrees of freedom keep their initial values.

    Args:
        tree: the kinematic tree.
        start: the initial pose, not changed; the fit begins with its angles clamped to the limits.
        constraints: any number, including none.
        priors: any number, including none.
        settings: the stopping criteria.

    Raises:
        SettingsError: wrong shapes, a part that the tree does not have, or a pose, also of a prior, that is not finite.
    """
    problem = _problem(tree, start, constraints, priors)
    T, angles = np.array(start.T_world_model, np.float64), np.array(start.angles, np.float64)
    held = np.empty(len(angles), dtype=np.bool_)
    steps, rests, cost, prior_cost = kernels().fit(
        *tree.arrays, tree.limits, tree.root, *problem, settings.most_steps, settings.rest_m, settings.rest_rad,
        T, angles, held,
    )  # fmt: skip
    return TreeFit(TreePose(T, angles), held, steps, rests, cost, prior_cost)


class NormalEquations(msgspec.Struct, frozen=True, eq=False):
    """Normal equations H δ = g of a Gauss–Newton step δ: the root's twist, translation first, then the angles.

    The twist refers to the point ``about``, with the world's axes. H is half the Gauss–Newton approximation of the
    cost's Hessian, and g half its negative gradient.

    Attributes:
        H, g: (dofs, dofs), (dofs,), without regard to the joint limits.
        about: (3,) position of the tree's point ``root`` in the world [m].
        cost: cost of constraints and priors at the pose.
    """

    H: Float64
    g: Float64
    about: Float64
    cost: float


def normal_equations(
    tree: TwistTree, pose: TreePose, constraints: Sequence[Constraints], priors: Sequence[Prior] = ()
) -> NormalEquations:
    """Linearise constraints and priors at a pose: return the normal equations, whose H⁻¹ is the estimate's covariance.

    Args:
        tree, constraints, priors: as in `fit`.
        pose: the pose at which residuals and derivatives are taken; not changed.

    Raises:
        SettingsError: wrong shapes, a part that the tree does not have, or a pose, also of a prior, that is not finite.
    """
    problem = _problem(tree, pose, constraints, priors)
    parts, joints, k = len(tree.parents), len(tree.joint_parts), kernels()
    above = np.empty(tree.dofs, dtype=np.int64)
    k.path(tree.parents, tree.joint_parts, above)
    R, t, xi, Q = np.empty((parts, 9)), np.empty((parts, 3)), np.empty((joints, 6)), np.empty((parts, k.MOTION))
    D, e, H, g = np.empty(joints), np.empty(joints), np.empty((tree.dofs, tree.dofs)), np.empty(tree.dofs)
    T, angles = np.array(pose.T_world_model, np.float64), np.array(pose.angles, np.float64)
    cost = k.measure(*tree.arrays, tree.root, *problem, T, angles, R, t, xi, Q, D, e)
    k.normal_equations(tree.parents, tree.joint_parts, above, xi, Q, H, g)
    g[k.ROOT :] += e
    H = np.tril(H) + np.tril(H, -1).T
    H[k.ROOT :, k.ROOT :] += np.diag(D)
    return NormalEquations(H, g, problem[1], sum(cost))


def _problem(
    tree: TwistTree, start: TreePose, constraints: Sequence[Constraints], priors: Sequence[Prior]
) -> tuple[Float64, ...]:
    """Return the arguments of `measure`: sums about the initial position, and priors."""
    joints = len(tree.joint_parts)
    T, angles = np.asarray(start.T_world_model), np.asarray(start.angles)
    _check_shapes(T, angles, joints)
    about = T[:3, :3] @ tree.root + T[:3, 3]
    sums = np.zeros((len(tree.parents), kernels().SUMS))
    for given in constraints:
        _add(given, about, sums)
    prior_T, prior_root = np.empty((len(priors), 4, 4)), np.empty((len(priors), 2))
    prior_angles, prior_joints = np.empty((len(priors), joints)), np.empty((len(priors), joints))
    for k, prior in enumerate(priors):
        _check_shapes(prior.pose.T_world_model, prior.pose.angles, joints)
        shape = np.shape(prior.angles_per_rad)
        check(shape == (joints,), "the shape of angles_per_rad", shape, f"({joints},)")
        prior_T[k], prior_angles[k] = prior.pose.T_world_model, prior.pose.angles
        prior_root[k], prior_joints[k] = (prior.root_per_m, prior.root_per_rad), prior.angles_per_rad
    poses = (T, prior_T, angles, prior_angles)
    check(all(bool(np.isfinite(some).all()) for some in poses), "a pose", poses, "finite")
    return sums, about, prior_T, prior_root, prior_angles, prior_joints


def _check_shapes(T: Any, angles: Any, joints: int) -> None:
    shapes = (np.shape(T), np.shape(angles))
    check(shapes == ((4, 4), (joints,)), "a pose's shapes", shapes, f"(4, 4) and ({joints},)")


def _add(given: Constraints, about: Float64, sums: Float64) -> None:
    k = kernels()
    if isinstance(given, OnLines):
        kind, targets, width = k.LINES, given.lines, 6
    elif isinstance(given, OnPoints):
        kind, targets, width = k.POINTS, given.targets, 3
    else:
        kind, targets, width = k.PLANES, given.planes, 4
    n = len(given.part)
    shapes = (given.points.shape, targets.shape, given.weights.shape)
    check(shapes == ((n, 3), (n, width), (n,)), "shapes", shapes, f"({n}, 3), ({n}, {width}) and ({n},)")
    part = np.ascontiguousarray(given.part, np.int64)
    points, targets, weights = (np.ascontiguousarray(a, np.float64) for a in (given.points, targets, given.weights))
    wrong = k.add_constraints(kind, part, points, targets, weights, about, sums)
    check(wrong < 0, "part", int(part[wrong]) if n else 0, f"0 to {len(sums) - 1}")


@cache
def kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import twist_fit_kernels

    return twist_fit_kernels
