"""Bodies of the model itself that move, and the rays of cameras around them, for the tests of the body of rays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.kinematics.articulated_body import Pose, joints
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL
from mocapella.kinematics.ray_body import RayBody, RayEstimate, ray_model
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

HALPE = topology("halpe_26")
MODEL = ray_model()
JOINTS = len(HALPE)
MISFITS = np.sqrt(MODEL.joint_values[:, 11])
Change = Callable[[int, Int64, Float64, Int64], tuple[Int64, Float64, NDArray[np.bool_]]]
"""From frame, joints (n,), directions (n, 3) and cameras (n,): other joints and directions, and which rays remain."""


def around(cameras: int, radius: float = 4.0, height: float = 1.6) -> Float64:
    """(cameras, 3) centres of cameras on a circle; of two, a quarter of it apart [m]."""
    angles = 0.3 + np.arange(cameras) * (2 * np.pi / cameras if cameras > 2 else np.pi / 2)
    return np.column_stack([radius * np.cos(angles), np.full(cameras, height), radius * np.sin(angles)])


def lengths(stature: float) -> Float64:
    """(lengths,) of somebody of the template's proportions [m]."""
    values = np.zeros(MODEL.layout.lengths)
    has = MODEL.joint_table[:, 4] >= 0
    values[MODEL.joint_table[has, 4]] = stature * MODEL.joint_values[has, 3]
    return values


def moving(at_s: float, seed: int, speed: float = 1.0, stature: float = 1.75) -> Float64:
    """(26, 3) joints of somebody who turns and walks in a circle, while every joint swings in its own time [m]."""
    rng = np.random.default_rng(seed)
    hinge = (MODEL.dof_kind >= ABOUT) & (MODEL.dof_kind < OF_BALL)
    low, high = np.where(hinge, MODEL.dof_values[:, 0], 0.0), np.where(hinge, MODEL.dof_values[:, 1], 0.0)
    phases, rates = rng.uniform(0, 2 * np.pi, len(hinge)), speed * rng.uniform(1, 4, len(hinge))
    angles = 0.15 * (low + high) + 0.15 * (high - low) * np.sin(rates * at_s + phases)
    position = np.array([0.5 * np.sin(speed * at_s), 0.95 + 0.03 * np.sin(4 * at_s), 0.5 * np.cos(speed * at_s)])
    angles[:3] = position
    turns = rng.normal(0, 0.3, (5, 3))
    turns += 0.4 * np.sin(speed * rng.uniform(1, 4, (5, 3)) * at_s + rng.uniform(0, 2 * np.pi, (5, 3)))
    turns[0] = 0.1 * np.sin(at_s), 0.8 * speed * at_s, 0.1 * np.cos(at_s)
    rotations = Rotation.from_rotvec(turns).as_matrix()
    for name, hanging in (("LElbow", -1.0), ("RElbow", 1.0)):
        ball = MODEL.joint_table[HALPE.index(name), 3]
        rotations[ball] = Rotation.from_rotvec((0.0, 0.0, hanging)).as_matrix() @ rotations[ball]
    return joints(MODEL, Pose(position, rotations, angles, lengths(stature)))


def offsets(frames: int, rng: np.random.Generator, hz: float = 30.0) -> Float64:
    """(frames, 26, 3) offsets of keypoints from the chain, as the model describes them [m]."""
    fade, x = np.exp(-1.0 / hz), rng.normal(0, 1, (JOINTS, 3))
    found = []
    for _ in range(frames):
        found.append(x * MISFITS[:, None])
        x = fade * x + np.sqrt(1 - fade**2) * rng.normal(0, 1, x.shape)
    return np.array(found)


def rays_to(
    x: Float64, centres: Float64, sd_rad: float, rng: np.random.Generator
) -> tuple[Int64, Float64, Float64, Int64]:
    """Joints (n,), origins (n, 3), directions (n, 3) and cameras (n,) of all cameras' noisy rays to joints (26, 3)."""
    d = x[None] - centres[:, None]
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d += rng.normal(0, sd_rad, d.shape)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    seen = np.tile(np.arange(len(x)), len(centres))
    cameras = np.repeat(np.arange(len(centres)), len(x))
    return seen, centres[cameras], d.reshape(-1, 3), cameras


def follow(
    truth: Float64, centres: Float64, sd_rad: float, seed: int, *, hz: float = 30.0, change: Change | None = None,
    body: RayBody | None = None,
) -> list[RayEstimate]:  # fmt: skip
    """Follow joints (frames, 26, 3) by noisy rays, which ``change`` may alter and leave out."""
    rng, body, found = np.random.default_rng(seed), body or RayBody(), []
    for k, x in enumerate(truth):
        seen, origins, directions, cameras = rays_to(x, centres, sd_rad, rng)
        keep = np.ones(len(seen), bool)
        if change is not None:
            seen, directions, keep = change(k, seen, directions, cameras)
        found.append(body.update(k / hz, seen[keep], origins[keep], directions[keep], max(sd_rad, 1e-3)))
    return found


def errors(found: list[RayEstimate], truth: Float64) -> Float64:
    """(frames, 26) distances of estimates from the truth [m]."""
    return np.asarray(np.linalg.norm(np.stack([one.positions for one in found]) - truth, axis=-1))


def nees(found: list[RayEstimate], truth: Float64) -> Float64:
    """(frames, 26) normalised squared errors of estimates, 1 on average where the covariances are right."""
    off = np.stack([one.positions for one in found]) - truth
    inverse = np.linalg.inv(np.stack([one.covariances for one in found]))
    return np.asarray(np.einsum("tji,tjik,tjk->tj", off, inverse, off) / 3)
