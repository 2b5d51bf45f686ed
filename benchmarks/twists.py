"""What fitting a body in twists costs: a Gauss–Newton step, and a fit until it rests, beside plain numpy.

`OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks twists`: ours is one thread, and these keep numpy's
library from more. Both sides take the same points, lines and prior, and come to the same pose, which is checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, against_peer, measured, median_seconds, times_the_peer
from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.plucker import join
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.twists import adjoint, exp_twist, revolute
from mocapella.kinematics.twist_fit import FitSettings, OnLines, Prior, fit
from mocapella.kinematics.twist_prediction import JitterPenalty, predicted, smoothness
from mocapella.model.twist_tree import TreePose, TwistTree, part_motions, twist_tree

Float64 = NDArray[np.float64]

POINTS: Final = 1000
PARENTS: Final = (-1, 0, 1, 2, 1, 4, 5, 1, 7, 8, 0, 10, 11, 0, 13, 14)
"""Pelvis, chest, neck, head, arms of three parts, legs of three."""
JOINTS: Final = (2, 1, 1, 2, 1, 1, 2, 1, 1, 2, 1, 1, 2, 1, 1)
"""Of each part but the pelvis: with the root's six, 26 degrees of freedom."""
SD_M: Final = 0.01
PENALTY: Final = JitterPenalty(root_per_m=50.0, root_per_rad=20.0, angle_per_rad=10.0)
SEED: Final = 11


def run(quick: bool = False) -> list[Row]:
    return [*steps(quick), *parts(quick)]


def steps(quick: bool) -> Iterator[Row]:
    tree, start, lines, prior = scene()
    settings = FitSettings(rest_m=1e-6, rest_rad=1e-6)
    found = fit(tree, start, [lines], [prior], settings)
    peer = Plain(tree, lines, prior)
    for what, most, goal in ((f"a step, {POINTS} lines × {tree.dofs} dofs", 1, times_the_peer(8)),
                             (f"{found.steps} steps, until it rests", found.steps, None)):  # fmt: skip
        some = FitSettings(most, settings.rest_m, settings.rest_rad)
        ours, theirs = fit(tree, start, [lines], [prior], some).pose, peer.fit(start, most)
        np.testing.assert_allclose(ours.angles, theirs.angles, atol=1e-8)
        np.testing.assert_allclose(ours.T_world_model, theirs.T_world_model, atol=1e-8)
        yield against_peer(
            f"twists: {what}",
            partial(fit, tree, start, [lines], [prior], some),
            partial(peer.fit, start, most),
            "numpy",
            goal=goal,
            repeat=3 if quick else 15,
            number=20 if quick else 300,
            peer_number=3 if quick else 20,
        )


def parts(quick: bool) -> Iterator[Row]:
    """What else a frame takes."""
    tree, start, *_ = scene()
    number = 20 if quick else 500
    for what, call in (("where the parts are", lambda: part_motions(tree, start)),
                       ("prediction", lambda: predicted(start, start))):  # fmt: skip
        yield measured(f"twists: {what}", 1e6 * median_seconds(call, number=number), "µs")


def scene() -> tuple[TwistTree, TreePose, OnLines, Prior]:
    """A body, where it was thought to be, and what four cameras see of it, with noise."""
    rng = np.random.default_rng(SEED)
    joint_parts = np.repeat(np.arange(1, len(PARENTS)), JOINTS)
    twists = revolute(rng.normal(size=(len(joint_parts), 3)), 0.5 * rng.normal(size=(len(joint_parts), 3)))
    tree = twist_tree(PARENTS, joint_parts, twists)
    truth = TreePose(exp_twist(rng.normal(size=6)), 0.4 * rng.normal(size=len(joint_parts)))
    start = TreePose(
        truth.T_world_model @ exp_twist(0.03 * rng.normal(size=6)),
        truth.angles + 0.05 * rng.normal(size=len(joint_parts)),
    )
    part = rng.integers(len(PARENTS), size=POINTS)
    points = 0.3 * rng.normal(size=(POINTS, 3))
    x = apply(part_motions(tree, truth)[part], points[:, None])[:, 0] + SD_M * rng.normal(size=(POINTS, 3))
    eyes = 3.0 * np.array([[1, 0.5, 1], [1, 0.5, -1], [-1, 0.5, 1], [-1, 0.5, -1]])
    lines = OnLines(part, points, join(eyes[rng.integers(4, size=POINTS)], x), np.full(POINTS, SD_M**-2))
    return tree, start, lines, smoothness(tree, start, PENALTY)


class Plain:
    """The same in numpy, vectorised: every row of the Jacobian, part by part, and the normal equations by BLAS."""

    def __init__(self, tree: TwistTree, lines: OnLines, prior: Prior) -> None:
        order = np.argsort(lines.part, kind="stable")
        self.tree, self.prior, self.points = tree, prior, lines.points[order]
        ends = np.searchsorted(lines.part[order], np.arange(len(tree.parents) + 1))
        self.runs = [slice(a, b) for a, b in pairwise(ends)]
        self.part = lines.part[order]
        self.root_weights = np.square(np.repeat([prior.root_per_m, prior.root_per_rad], 3))
        self.angle_weights = np.square(prior.angles_per_rad)
        self.scale = np.sqrt(lines.weights[order])
        self.across = -cross_matrix(lines.lines[order, :3]) * self.scale[:, None, None]  # x × n = −[n]× x
        self.moment = lines.lines[order, 3:] * self.scale[:, None]
        self.moves = np.zeros((len(tree.parents), len(tree.joint_parts)), dtype=np.bool_)
        for p, parent in enumerate(tree.parents):
            self.moves[p] = tree.joint_parts == p
            if parent >= 0:
                self.moves[p] |= self.moves[parent]

    def fit(self, start: TreePose, steps: int) -> TreePose:
        T, angles = start.T_world_model, start.angles
        for _ in range(steps):
            delta = self.step(T, angles)
            # The turn is about the root, as ours: the same step, and the same pose after it.
            turn = exp_twist(np.concatenate([np.zeros(3), delta[3:6]]))[:3, :3]
            place = T[:3, 3] + delta[:3] + np.cross(delta[3:6], T[:3, 3])
            T, angles = rigid(turn @ T[:3, :3], place), angles + delta[6:]
        return TreePose(T, angles)

    def step(self, T_root: Float64, angles: Float64) -> Float64:
        tree, n = self.tree, len(angles)
        turns = exp_twist(angles[:, None] * tree.twists)
        T, before, j = np.empty((len(tree.parents), 4, 4)), np.empty((n, 4, 4)), 0
        for p, parent in enumerate(tree.parents):
            T[p] = T_root if parent < 0 else T[parent]
            while j < n and tree.joint_parts[j] == p:
                before[j] = T[p]
                T[p] = T[p] @ turns[j]
                j += 1
        xi = (adjoint(before) @ tree.twists[..., None])[..., 0]
        x = (T[self.part, :3, :3] @ self.points[..., None])[..., 0] + T[self.part, :3, 3]
        per_twist = np.concatenate([self.across, -self.across @ cross_matrix(x)], axis=-1)
        residuals = (self.across @ x[..., None])[..., 0] - self.moment
        J = np.empty((3 * len(x), 6 + n))
        J[:, :6] = per_twist.reshape(-1, 6)
        for p, run in enumerate(self.runs):
            rows = slice(3 * run.start, 3 * run.stop)
            J[rows, 6:] = J[rows, :6] @ (xi * self.moves[p, :, None]).T
        H, g = J.T @ J, -J.T @ residuals.ravel()
        self.expect(T_root, angles, H, g)
        return np.linalg.solve(H, g)

    def expect(self, T: Float64, angles: Float64, H: Float64, g: Float64) -> None:
        """Add the prior: the root's way, told about the world's origin, its turn, and the angles."""
        expected, w, u = self.prior.pose, self.root_weights[0], self.root_weights[3]
        K = np.concatenate([np.eye(3), -cross_matrix(T[:3, 3])], axis=1)
        H[:6, :6] += w * (K.T @ K)
        H[3:6, 3:6] += u * np.eye(3)
        g[:6] += w * (K.T @ (expected.T_world_model[:3, 3] - T[:3, 3]))
        R = expected.T_world_model[:3, :3] @ T[:3, :3].T
        twist = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        sine = np.linalg.norm(twist)
        g[3:6] += u * twist * (np.arcsin(sine) / sine if sine > 0 else 1.0)
        k = 6 + np.arange(len(angles))
        H[k, k] += self.angle_weights
        g[6:] += self.angle_weights * (expected.angles - angles)
