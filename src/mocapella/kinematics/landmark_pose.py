"""Fit a rigged mesh's pose to landmarks: the initialisation of a tracker from a rough skeleton.

    pose = pose_of(body, {"left hip": (0.1, 0.9, 2.0), "left knee": …})

It needs no initial pose. The trunk is aligned as a rigid body, then all joints are fitted (`twist_fit`). A joint with a
large range has local minima, such as an arm that points the wrong way; so each limb is fitted from several initial
poses, and the best result is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.alignment import align, moments
from mocapella.kinematics.twist_fit import FitSettings, OnPoints, Prior, fit
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.twist_tree import TreePose, TwistTree, limbs_of
from mocapella.settings import check

Float64 = NDArray[np.float64]

NEAR_M: Final = 1e-4
"""A limb is not fitted from further initial poses if all its landmarks are at least this near [m]."""
STARTS: Final = 24
_FIT: Final = FitSettings(most_steps=40, rest_m=1e-7, rest_rad=1e-7)
_USUAL_PER_RAD: Final = 0.0005
"""Weight of the prior that angles are 0, relative to landmarks [m/rad]: so small that it decides only what landmarks do
not determine, such as the turn of a straight arm. The last fit uses the landmarks' root mean square residual instead,
because their noise alone would turn a nearly straight arm."""
_HELD: Final = 1e3
"""Inverse standard deviation that holds the rest of the body while one limb is fitted from a new start [1/m, 1/rad]."""
_LINE: Final = 0.05
"""Ratio of width to length below which points count as a line, about which they determine no rotation."""


def pose_of(mesh: RiggedMesh, joints: Mapping[str, Any]) -> TreePose:
    """Fit a mesh's pose to landmarks, with angles within their limits.

    Args:
        mesh: a mesh with landmarks, such as a body or a hand.
        joints: positions (3,) of landmarks in the world by name [m]; unknown ones are NaN or left out.

    Returns:
        The pose with the least sum of squared distances; an angle that no landmark determines is near 0, or near the
        limit next to it. Equal inputs give equal poses.

    Raises:
        SettingsError: an unknown name, a position of another shape, or fewer than three known positions off a line.
    """
    for name in joints:
        if name not in mesh.landmarks:
            raise SettingsError(f"{mesh.name} has no landmark {name!r}; known: {one_of(name, mesh.landmarks)}")
        check(np.shape(joints[name]) == (3,), f"shape of {name}", np.shape(joints[name]), "(3,)")
    targets = np.array([joints.get(name, (np.nan,) * 3) for name in mesh.landmarks], dtype=np.float64).reshape(-1, 3)
    parts = np.array([landmark.part for landmark in mesh.landmarks.values()], dtype=np.int64)
    points = np.array([landmark.point for landmark in mesh.landmarks.values()], dtype=np.float64).reshape(-1, 3)
    seen = np.isfinite(targets).all(axis=1)
    usual = _usual(mesh.tree)
    start = TreePose(_aligned(mesh, parts, points, targets, seen), np.clip(0.0, *mesh.tree.limits.T))
    constraints = [OnPoints(parts, points, targets, np.ones(len(parts)))]
    prior = Prior(TreePose(np.eye(4), usual), 0.0, 0.0, np.full(len(usual), _USUAL_PER_RAD))

    best, rng = fit(mesh.tree, start, constraints, [prior], _FIT), np.random.default_rng(0)
    limits = np.clip(mesh.tree.limits, -np.pi, np.pi)
    for _ in range(STARTS):
        for joints_of, parts_of in limbs_of(mesh.tree):
            away = np.linalg.norm(landmarks_at(mesh, best.pose) - targets, axis=1)[np.isin(parts, parts_of) & seen]
            if away.max(initial=0.0) > NEAR_M:
                # The limb alone to begin with, or it drags all else along.
                sure = np.full(len(usual), _HELD)
                sure[joints_of] = 0.0
                angles = best.pose.angles.copy()
                angles[joints_of] = rng.uniform(*limits[joints_of].T)
                at = TreePose(best.pose.T_world_model, angles)
                alone = fit(mesh.tree, at, constraints, [prior, Prior(best.pose, _HELD, _HELD, sure)], _FIT)
                other = fit(mesh.tree, alone.pose, constraints, [prior], _FIT)
                best = other if other.cost + other.prior_cost < best.cost + best.prior_cost else best
    away = np.linalg.norm(landmarks_at(mesh, best.pose) - targets, axis=1)[seen]
    noise = float(np.sqrt((away * away).mean()))
    return fit(
        mesh.tree,
        best.pose,
        constraints,
        [msgspec.structs.replace(prior, angles_per_rad=np.full(len(usual), noise))],
        _FIT,
    ).pose


def _usual(tree: TwistTree) -> Float64:
    """Return the angles (joints,) within the limits that are nearest to 0 [rad]."""
    return np.asarray(np.clip(0.0, tree.limits[:, 0], tree.limits[:, 1]))


def _aligned(mesh: RiggedMesh, parts: Any, points: Float64, targets: Float64, seen: Any) -> Float64:
    """Align the root's landmarks, (4, 4); if on a line, add the child's that has the most, else all landmarks."""
    children = np.flatnonzero(mesh.tree.parents == 0)
    shown = [np.count_nonzero(seen & (parts == child)) for child in children]
    trunk = [0, *([int(children[np.argmax(shown)])] if shown else [])]
    for chosen in (parts == 0, np.isin(parts, trunk), np.ones(len(parts), np.bool_)):
        used = chosen & seen
        spans = [np.linalg.svd(p[used] - p[used].mean(axis=0))[1] for p in (points, targets)] if used.sum() > 2 else []
        if spans and all(span[1] > _LINE * span[0] for span in spans):
            return align(moments(targets[used], points[used]))
    names = [name for name, is_seen in zip(mesh.landmarks, seen, strict=True) if is_seen]
    raise SettingsError(f"joints that are seen are {names}; they must be three or more that are not on a line")
