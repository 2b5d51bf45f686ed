"""What the articulated body from rays costs and how exact it is: people in simulation, seen by cameras around them.

`OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks rays`: ours is one thread. The peer triangulates the same
rays by least squares in numpy, all joints at once, without a body, a motion, or anything robust.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.harness import Row, against_peer, at_most, measured
from mocapella.geometry.plucker import line, nearest_point
from mocapella.kinematics.articulated_body import Pose, joints
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL, memory_size
from mocapella.kinematics.ray_body import RayBody, RayEstimate, ray_model
from mocapella.kinematics.ray_body_kernels import correct_by_rays

Float64 = NDArray[np.float64]

MODEL: Final = ray_model()
JOINTS: Final = MODEL.layout.joints
SD_RAD: Final = 0.004
HZ: Final = 30.0
STATURE: Final = 1.75
SETTLED: Final = 30
"""Frames after which errors count."""
PEOPLE: Final = 6


def run(quick: bool = False) -> list[Row]:
    return [*cost(quick), *errors(quick), *one_camera(quick)]


def cost(quick: bool) -> Iterator[Row]:
    """One frame of all people, from the kernel that the tracker calls; the motion goes forth and back."""
    for cameras in (4, 8):
        centres, frames = around(cameras), 20
        people = [[rays(moving(k / HZ, seed), centres, seed + k) for k in range(frames)] for seed in range(PEOPLE)]
        lines = [np.stack([line(centres[:, None], own[k]) for own in people]).swapaxes(1, 2) for k in range(frames)]
        yield against_peer(
            f"rays: {PEOPLE} people, {cameras} cameras, a frame", Followed(people, centres),
            partial(nearest_point, lines[0]), "numpy triangulation",
            goal=at_most(1.0), unit="ms", repeat=5 if quick else 501, number=1,
        )  # fmt: skip


class Followed:
    """People that are followed by rays; each call is the next frame.

    Args:
        people: of each, the directions (cameras, joints, 3) of each frame.
        centres: (cameras, 3) the cameras' centres [m].
    """

    def __init__(self, people: list[list[Float64]], centres: Float64) -> None:
        self.people = [[np.ascontiguousarray(own.reshape(-1, 3)) for own in person] for person in people]
        n = len(self.people[0][0])
        self.seen, self.origins = np.tile(np.arange(JOINTS), len(centres)), np.repeat(centres, JOINTS, axis=0)
        self.sds, self.after, self.weights = np.full(n, SD_RAD), np.zeros(n), np.zeros(n)
        self.rows = np.full((len(people), memory_size(MODEL)), np.nan)
        self.found, self.covariances = np.empty((JOINTS, 3)), np.empty((JOINTS, 3, 3))
        self.support, self.model, self.frame = np.zeros(JOINTS, np.uint8), MODEL.arrays, 0

    def __call__(self) -> None:
        k, last = self.frame, len(self.people[0]) - 1
        at = last - abs(k % (2 * last) - last)
        for row, own in zip(self.rows, self.people, strict=True):
            correct_by_rays(
                self.model, row, k / HZ, self.seen, self.origins, own[at], self.sds, self.after, self.weights,
                self.found, self.covariances, self.support,
            )  # fmt: skip
        self.frame += 1


def errors(quick: bool) -> Iterator[Row]:
    for cameras in (2, 4, 8):
        yield from followed(f"{cameras} cameras", around(cameras), 90, 2 if quick else 6)
    yield from followed("4 cameras, fast", around(4), 90, 2 if quick else 6, speed=4.0)


def one_camera(quick: bool) -> Iterator[Row]:
    """All but one of four cameras are cut after two seconds, for one second."""
    yield from followed("one of 4 cameras for 1 s, slow", around(4), 90, 2 if quick else 6, speed=0.3, cut=60)
    yield from followed("one of 4 cameras for 1 s, walking", around(4), 90, 2 if quick else 6, cut=60)


def followed(
    what: str, centres: Float64, frames: int, people: int, *, speed: float = 1.0, cut: int | None = None
) -> Iterator[Row]:
    """Mean and 95th percentile of the joints' errors, and their normalised squared error, over people's motions."""
    distances, normalised = [], []
    for seed in range(people):
        body, offsets = RayBody(), wandering(frames, seed)
        for k in range(frames):
            truth = moving(k / HZ, seed, speed) + offsets[k]
            used = centres[:1] if cut is not None and k >= cut else centres
            d = rays(truth, used, 1000 * seed + k)
            seen = np.tile(np.arange(JOINTS), len(used))
            estimate = body.update(k / HZ, seen, np.repeat(used, JOINTS, axis=0), d.reshape(-1, 3), SD_RAD)
            if k >= (SETTLED if cut is None else cut):
                off = estimate.positions - truth
                distances.append(np.linalg.norm(off, axis=1))
                normalised.append(squared(off, estimate))
    yield measured(f"rays: {what}: mean error", 1000 * float(np.mean(distances)), "mm")
    yield measured(f"rays: {what}: 95th percentile", 1000 * float(np.percentile(distances, 95)), "mm")
    yield measured(f"rays: {what}: squared error over its covariance", float(np.mean(normalised)), "")


def squared(off: Float64, estimate: RayEstimate) -> Float64:
    """(joints,) squared errors over their covariances, 1 on average where those are right."""
    return np.asarray(np.einsum("ji,jik,jk->j", off, np.linalg.inv(estimate.covariances), off) / 3)


def around(cameras: int) -> Float64:
    """(cameras, 3) centres on a circle of 4 m; of two, a quarter of it apart [m]."""
    angles = 0.3 + np.arange(cameras) * (2 * np.pi / cameras if cameras > 2 else np.pi / 2)
    return np.column_stack([4.0 * np.cos(angles), np.full(cameras, 1.6), 4.0 * np.sin(angles)])


def rays(x: Float64, centres: Float64, seed: int) -> Float64:
    """(cameras, joints, 3) unit directions from the cameras to joints, with noise."""
    d = x[None] - centres[:, None]
    d = d / np.linalg.norm(d, axis=-1, keepdims=True) + np.random.default_rng(seed).normal(0, SD_RAD, d.shape)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


def wandering(frames: int, seed: int) -> Float64:
    """(frames, joints, 3) offsets of keypoints from the chain, as the model describes those of a moving body [m]."""
    rng, fade, found = np.random.default_rng(seed), np.exp(-1.0 / HZ), []
    x = rng.normal(0, 1, (JOINTS, 3))
    for _ in range(frames):
        found.append(x * np.sqrt(MODEL.joint_values[:, 11:12]))
        x = fade * x + np.sqrt(1 - fade**2) * rng.normal(0, 1, x.shape)
    return np.array(found)


def moving(at_s: float, seed: int, speed: float = 1.0) -> Float64:
    """(joints, 3) joints of somebody who turns and walks in a circle, while every joint swings in its own time [m]."""
    rng, layout = np.random.default_rng(seed), MODEL.layout
    hinge = (MODEL.dof_kind >= ABOUT) & (MODEL.dof_kind < OF_BALL)
    low, high = np.where(hinge, MODEL.dof_values[:, 0], 0.0), np.where(hinge, MODEL.dof_values[:, 1], 0.0)
    swing = np.sin(speed * rng.uniform(1, 4, len(hinge)) * at_s + rng.uniform(0, 2 * np.pi, len(hinge)))
    angles = 0.15 * (low + high) + 0.15 * (high - low) * swing
    angles[:3] = 0.5 * np.sin(speed * at_s), 0.95, 0.5 * np.cos(speed * at_s)
    shape = (layout.balls, 3)
    turns = rng.normal(0, 0.3, shape)
    turns += 0.4 * np.sin(speed * rng.uniform(1, 4, shape) * at_s + rng.uniform(0, 2 * np.pi, shape))
    turns[0] = 0.0, 0.8 * speed * at_s, 0.0
    lengths, has = np.zeros(layout.lengths), MODEL.joint_table[:, 4] >= 0
    lengths[MODEL.joint_table[has, 4]] = STATURE * MODEL.joint_values[has, 3]
    return joints(MODEL, Pose(angles[:3].copy(), Rotation.from_rotvec(turns).as_matrix(), angles, lengths))
