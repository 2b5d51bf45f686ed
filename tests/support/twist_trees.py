"""Random trees in random poses, and what is asked of them with every row written out, for the tests of this room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.geometry.plucker import join, residual
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.twists import adjoint, exp_twist, revolute
from mocapella.kinematics.twist_fit import Constraints, InPlanes, OnLines, OnPoints, Prior
from mocapella.model.twist_tree import TreePose, TwistTree, twist_tree

Float64 = NDArray[np.float64]


def tree(rng: np.random.Generator, parts: int = 6, joints: int = 9, limits: Float64 | None = None) -> TwistTree:
    """Every part but the root has a joint, some have several."""
    parents = [-1, *(int(rng.integers(p)) for p in range(1, parts))]
    joint_parts = np.sort([*range(1, parts), *rng.integers(1, parts, joints - parts + 1)])
    twists = revolute(rng.normal(size=(joints, 3)), 0.4 * rng.normal(size=(joints, 3)))
    return twist_tree(parents, joint_parts, twists, limits, 0.3 * rng.normal(size=3))


def pose(rng: np.random.Generator, model: TwistTree, bent: float = 0.6) -> TreePose:
    T = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    return TreePose(T, bent * rng.normal(size=len(model.joint_parts)))


def near(rng: np.random.Generator, model: TwistTree, at: TreePose, far: float) -> TreePose:
    """A pose close to another one; the root moves about itself."""
    place = rigid(np.eye(3), at.T_world_model[:3, :3] @ model.root + at.T_world_model[:3, 3])
    away = rigid(np.eye(3), -place[:3, 3])
    T = place @ exp_twist(far * rng.normal(size=6)) @ away @ at.T_world_model
    return TreePose(T, at.angles + far * rng.normal(size=len(at.angles)))


def motions(model: TwistTree, at: TreePose) -> tuple[Float64, Float64]:
    """The parts' motions and the joints' twists in the world, as products of exponentials, one after the other."""
    T, xi = np.empty((len(model.parents), 4, 4)), np.empty((len(model.joint_parts), 6))
    for p, parent in enumerate(model.parents):
        T[p] = at.T_world_model if parent < 0 else T[parent]
        for j in np.flatnonzero(model.joint_parts == p):
            xi[j] = adjoint(T[p]) @ model.twists[j]
            T[p] = T[p] @ exp_twist(at.angles[j] * model.twists[j])
    return T, xi


def moves(model: TwistTree) -> NDArray[np.bool_]:
    """(parts, joints) whether a joint moves a part."""
    out = np.zeros((len(model.parents), len(model.joint_parts)), dtype=np.bool_)
    for p, parent in enumerate(model.parents):
        out[p] = model.joint_parts == p
        if parent >= 0:
            out[p] |= out[parent]
    return out


def place(model: TwistTree, at: TreePose) -> Float64:
    """(3,) where the root's point is [m]."""
    return np.asarray(apply(at.T_world_model, model.root[None])[0])


def seen(rng: np.random.Generator, model: TwistTree, at: TreePose, n: int = 60, cameras: int = 3) -> OnLines:
    """Points of all parts, on lines from points that stand around."""
    part, points, x = points_of(rng, model, at, n)
    eyes = place(model, at) + 3.0 * rng.normal(size=(cameras, 3))
    return OnLines(part, points, join(eyes[rng.integers(cameras, size=n)], x), np.full(n, 1e4))


def points_of(
    rng: np.random.Generator, model: TwistTree, at: TreePose, n: int
) -> tuple[NDArray[np.int64], Float64, Float64]:
    """Parts, points at rest, and where they are."""
    part = np.resize(rng.permutation(len(model.parents)), n).astype(np.int64)
    points = 0.4 * rng.normal(size=(n, 3))
    return part, points, apply(motions(model, at)[0][part], points[:, None])[:, 0]


def noisy(rng: np.random.Generator, model: TwistTree, at: TreePose) -> list[Constraints]:
    """Constraints of all kinds that do not agree with each other."""
    lines = seen(rng, model, at, 40)
    eyes = rng.normal(size=(40, 3))
    made: list[Constraints] = [
        OnLines(lines.part, lines.points, join(eyes, eyes + rng.normal(size=(40, 3))), rng.uniform(0.5, 2.0, 40))
    ]
    for _ in range(2):
        part, points, x = points_of(rng, model, at, 20)
        made.append(OnPoints(part, points, x + 0.1 * rng.normal(size=x.shape), rng.uniform(0.5, 2.0, 20)))
    part, points, x = points_of(rng, model, at, 30)
    n = rng.normal(size=(30, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    d = (n * x).sum(axis=1) + 0.1 * rng.normal(size=30)
    return [*made, InPlanes(part, points, np.c_[n, d], rng.uniform(0.5, 2.0, 30))]


def rows(
    model: TwistTree, at: TreePose, constraints: Sequence[Constraints], priors: Sequence[Prior] = ()
) -> tuple[Float64, Float64]:
    """Every residual, weighted, and its derivatives: J (rows, dofs) and r (rows,), of which J δ = −r is asked.

    The root's twist is told about its point.
    """
    T, xi = motions(model, at)
    about, moved_by = place(model, at), moves(model)
    xi = (adjoint(rigid(np.eye(3), -about)) @ xi[..., None])[..., 0]
    J, r = [np.empty((0, model.dofs))], [np.empty(0)]
    for given in constraints:
        for k, (part, x0, w) in enumerate(zip(given.part, given.points, np.sqrt(given.weights), strict=True)):
            x = apply(T[part], x0[None])[0]
            columns = np.vstack([np.eye(6), np.where(moved_by[part, :, None], xi, 0.0)])
            velocity = columns[:, :3] + np.cross(columns[:, 3:], x - about)
            if isinstance(given, OnLines):
                line = given.lines[k]
                J.append(w * np.cross(velocity, line[:3]).T)
                r.append(w * residual(x, line))
            elif isinstance(given, OnPoints):
                J.append(w * velocity.T)
                r.append(w * (x - given.targets[k]))
            else:
                plane = given.planes[k]
                J.append(w * (velocity @ plane[:3])[None])
                r.append(w * (x @ plane[:3] - plane[3])[None])
    for prior in priors:
        root, turn, angles = deviation(model, at, prior)
        J += [np.pad(w * np.eye(3), ((0, 0), (3 * i, model.dofs - 3 - 3 * i)))
              for i, w in enumerate((prior.root_per_m, prior.root_per_rad))]  # fmt: skip
        J.append(np.c_[np.zeros((len(angles), 6)), np.diag(prior.angles_per_rad)])
        r += [prior.root_per_m * root, prior.root_per_rad * turn, prior.angles_per_rad * angles]
    return np.concatenate(J), np.concatenate(r)


def deviation(model: TwistTree, at: TreePose, prior: Prior) -> tuple[Float64, Float64, Float64]:
    """How far a pose is from what a prior expects: the root's way and turn, and the angles'."""
    turn = at.T_world_model[:3, :3] @ prior.pose.T_world_model[:3, :3].T
    way = place(model, at) - place(model, prior.pose)
    return way, Rotation.from_matrix(turn).as_rotvec(), at.angles - prior.pose.angles


def stepped(model: TwistTree, at: TreePose, delta: Float64) -> TreePose:
    """The pose after a small step of all degrees of freedom, the root's twist told about its point."""
    about = place(model, at)
    T = rigid(np.eye(3), about) @ exp_twist(delta[:6]) @ rigid(np.eye(3), -about) @ at.T_world_model
    return TreePose(T, at.angles + delta[6:])


def prior_of(rng: np.random.Generator, model: TwistTree, at: TreePose, far: float = 0.2) -> Prior:
    """Something known, of different weights."""
    weights = rng.uniform(0.5, 3.0, len(model.joint_parts))
    return Prior(near(rng, model, at, far), rng.uniform(1.0, 5.0), rng.uniform(1.0, 5.0), weights)
