"""The fit of an arm to a depth image: its derivatives, what a point is assigned to, and that a pose is found again."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import rotation_about_x, rotation_about_y
from mocapella.kinematics import arm_fit_kernels as k
from mocapella.kinematics.arm_fit import ArmFitSettings, ArmModel, ArmPose, Evidence, Fitted
from mocapella.kinematics.chain_kernels import turned
from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import ANGLES, BASES, TIPS, WRIST, Handedness, hand_model
from mocapella.sensing import arm_region_kernels as region

SIDES: tuple[Handedness, Handedness] = ("right", "left")
WIDTH, HEIGHT = 120, 140
OPEN = np.radians([-5, 4, 6, 0, 6, 4, 9, 8, 5, 3, 1, 8, 5, 4, -7, 8, 5, 5, -13, 9, 6])
LENS = np.array([150.0, 150.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2])
seeds = st.integers(0, 2**32 - 1)
sides = st.sampled_from(SIDES)


@cache
def arm_model(side: Handedness) -> ArmModel:
    model = hand_model("full").stretched(25.0, 28.0)
    return ArmModel(model, model.shape(side))


def posed(model: ArmModel, rng: np.random.Generator, opened: bool = False) -> ArmPose:
    """A hand at 0.6 m that is half open, or opened, its palm about to the camera, its forearm about straight."""
    view = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T  # of a right hand's palm, fingers up
    mirror = np.diag(model.shape.mirror)
    R = mirror @ rotation_about_x(rng.normal(0, 0.2)) @ rotation_about_y(rng.normal(0, 0.3)) @ view @ mirror
    z = model.natural + rng.normal(0, 0.25, len(model.natural))
    if opened:
        z = OPEN[model.angle_of] + rng.normal(0, 0.05, len(model.natural))
    k.within(model.digits, model.columns, model.gains, z, model.c_max)
    v = model.state(np.array([rng.normal(0, 0.1), rng.normal(0, 0.2), -1.0]))
    v[7:10] = rng.normal(0, 0.5, 3) + [0, 0.5, -0.5]
    v[7:10] /= np.linalg.norm(v[7:10])
    v[[0, 1, 3]] = rng.uniform(0.9, 1.1, 3)
    v[2] = model.forearm_m * rng.uniform(0.9, 1.1)
    v[10:] = rng.uniform(0.95, 1.05, 5)
    return ArmPose(np.ascontiguousarray(R).reshape(9), np.array([0.02, -0.02, 0.6]), z, v)


def moved(model: ArmModel, pose: ArmPose, dof: int, by: float) -> ArmPose:
    """A pose whose dof is another, as the fit's steps move it."""
    R, t, z, v = pose.copied()
    body = dof - 6 - len(z)
    if dof < 3:
        t = t + by * R.reshape(3, 3)[:, dof]
    elif dof < 6:
        new = np.empty(9)
        turned(R, 0, *(by * np.eye(3)[dof - 3]), new)
        R = new
    elif body < 0:
        z[dof - 6] += by
    elif body < k.D_LENGTH:
        k._turn(v, (k.FOREARM, k.UPPER)[body // 2], *(by * np.eye(2)[body % 2]))
    elif body == k.D_LENGTH:
        v[k.FOREARM_M] += by
    else:
        at = {k.D_SCALE: k.SCALE, k.D_THICK: k.THICK, k.D_ARM_THICK: k.ARM_THICK}
        v[at.get(body, k.DIGITS + body - k.D_DIGITS)] *= np.exp(by)
    return ArmPose(R, t, z, v)


def support(model: ArmModel, pose: ArmPose, piece: int, part: float, normal: Any) -> float:
    """How far a ball of the flesh reaches along a normal of the camera's space [m]."""
    p = model.pieces(pose)[0][piece]
    centre = p[k.A : k.A + 3] + part * p[k.LENGTH] * p[k.U : k.U + 3]
    in_camera = pose.R.reshape(3, 3) @ centre + pose.t
    return float(in_camera @ normal + p[k.RA] + part * (p[k.RB] - p[k.RA]))


def derivatives(model: ArmModel, pose: ArmPose, piece: int, part: float, normal: Any) -> np.ndarray:
    """(n,) those of the kernel; the normal is of the palm's frame."""
    pieces, _ = model.pieces(pose)
    rows, joints, axes = np.empty((5, k.DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    k.flesh(
        model.digits, model.mirror, model.radii, model.palm, model.columns, model.gains, pose.z, pose.v, rows, joints,
        axes, pieces,
    )  # fmt: skip
    p = pieces[piece]
    centre = p[k.A : k.A + 3] + part * p[k.LENGTH] * p[k.U : k.U + 3]
    J, at = np.empty(24), np.empty(24, np.int64)
    n = k._derivatives(
        *model.owners[piece], *normal, *centre, p[k.RA] + part * (p[k.RB] - p[k.RA]), joints, axes, model.columns,
        model.gains, model.rising, pose.v, len(pose.z), J, at,
    )  # fmt: skip
    assert (np.diff(at[:n]) > 0).all()  # what `_add` relies on
    out = np.zeros(6 + len(pose.z) + k.BODY_DOFS)
    out[at[:n]] = J[:n]
    return out


@settings(max_examples=6)
@given(seeds, sides)
def test_derivatives_of_the_flesh_are_finite_differences(seed: int, side: Handedness) -> None:
    """Of the hand's flesh all are exact, but that a fingertip's round end keeps its length; the arm's leave out that
    the forearm's two bones stand apart, and that a larger hand is of a thicker arm."""
    model, rng = arm_model(side), np.random.default_rng(seed)
    pose = posed(model, rng)
    angles, body = len(pose.z), 6 + len(pose.z)
    inset, apart = model.radii[5, 4] * 1.3, model.radii[5, 1] * 1.3
    for piece, (owner, bone) in enumerate(model.owners):
        normal, part = rng.normal(size=3), float(rng.uniform())
        normal /= np.linalg.norm(normal)
        told = derivatives(model, pose, piece, part, normal)
        in_camera = pose.R.reshape(3, 3) @ normal
        steps = [support(model, moved(model, pose, dof, h), piece, part, in_camera)
                 for dof in range(body + k.BODY_DOFS) for h in (1e-6, -1e-6)]  # fmt: skip
        true = np.diff(np.reshape(steps, (-1, 2))[:, ::-1], axis=1)[:, 0] / 2e-6
        loose = np.full(len(true), 1e-7)
        if owner >= 0 and bone == 2:
            loose[[body + k.D_THICK, body + k.D_DIGITS + owner]] = inset
        if owner == k.OF_FOREARM:
            loose[body : body + 2] = apart
            loose[body + k.D_LENGTH] = apart / model.forearm_m
            loose[body + k.D_ARM_THICK] = apart
        if owner < k.OF_PALM:
            true[body + k.D_SCALE] = 0.0
        assert (np.abs(told - true) <= loose).all(), (piece, np.abs(told - true).argmax())
        assert np.count_nonzero(told[6 : 6 + angles]) == (0 if owner < 0 else model_dofs(model, owner, bone))


def model_dofs(model: ArmModel, digit: int, bone: int) -> int:
    """How many angles move a digit's bone."""
    return int((model.columns[digit, [0, 1, 2, 4, 3][: (2, 4, 5)[bone]]] >= 0).sum())


def distances(pieces: np.ndarray, points: np.ndarray, view: np.ndarray) -> np.ndarray:
    """(points, pieces) signed distances by search along the axes, the front's along the view behind them."""
    f = np.linspace(0, 1, 2001)
    out = np.empty((len(points), len(pieces)))
    for i, p in enumerate(pieces):
        centres = p[:3] + f[:, None] * p[k.LENGTH] * p[3:6]
        radii = p[k.RA] + f * (p[k.RB] - p[k.RA])
        for j, point in enumerate(points):
            apart = np.linalg.norm(point - centres, axis=1)
            best = int(np.argmin(apart - radii))
            facing = float((point - centres[best]) @ view[j])
            out[j, i] = facing + radii[best] if facing > 0.2 * apart[best] else apart[best] - radii[best]
    return out


@settings(max_examples=5)
@given(seeds, sides)
def test_a_point_is_assigned_to_the_nearest_piece(seed: int, side: Handedness) -> None:
    """Points within half a finger's radius of the flesh, which piece the search begins with does not matter."""
    model, rng = arm_model(side), np.random.default_rng(seed)
    pose = posed(model, rng)
    pieces, _ = model.pieces(pose)
    eye = -pose.R.reshape(3, 3).T @ pose.t
    which = rng.integers(len(pieces), size=40)
    points = np.empty((40, 3))
    for i, p in enumerate(pieces[which]):
        towards, f = rng.normal(size=3), rng.uniform()
        centre = p[:3] + f * p[k.LENGTH] * p[3:6]
        towards /= np.linalg.norm(towards)
        towards = -towards if towards @ (centre - eye) > 0 else towards  # the side that is seen
        points[i] = centre + (p[k.RA] + f * (p[k.RB] - p[k.RA]) + rng.uniform(-0.002, 0.002)) * towards
    view = (points - eye) / np.linalg.norm(points - eye, axis=1)[:, None]
    brute = distances(pieces, points, view)
    hit = np.empty(5)
    for i, point in enumerate(points):
        nearest = np.abs(brute[i]).min()
        for first in (-1, 0, int(which[i])):
            piece = k.closest(pieces, len(pieces), first, *point, *view[i], hit)
            assert abs(hit[4]) == pytest.approx(nearest, abs=2e-5)
            assert abs(brute[i, piece]) == pytest.approx(nearest, abs=2e-5)
            assert np.linalg.norm(hit[:3]) == pytest.approx(1.0)


def test_behind_a_capsule_the_distance_is_from_its_front_along_the_view() -> None:
    row = np.empty((1, k.PIECE))
    k._piece(row[0], -0.05, 0.0, 0.5, 0.05, 0.0, 0.5, 0.01, 0.01)
    hit = np.empty(5)
    for z, distance, normal in ((0.48, 0.01, -1.0), (0.495, -0.005, -1.0), (0.505, 0.015, 1.0), (0.53, 0.04, 1.0)):
        k.closest(row, 1, 0, 0.01, 0.0, z, 0.0, 0.0, 1.0, hit)
        assert hit[4] == pytest.approx(distance)
        np.testing.assert_allclose(hit[:3], [0, 0, normal], atol=1e-12)
        assert hit[3] == pytest.approx(0.06)


def test_only_the_first_pieces_are_looked_at_where_the_arm_does_not_count() -> None:
    model = arm_model("right")
    pieces, _ = model.pieces(posed(model, np.random.default_rng(0)))
    elbow, hit = pieces[-1, :3], np.empty(5)
    assert k.closest(pieces, len(pieces), 0, *elbow, 0.0, 1.0, 0.0, hit) >= model.hand_pieces
    assert k.closest(pieces, model.hand_pieces, 0, *elbow, 0.0, 1.0, 0.0, hit) < model.hand_pieces


@settings(max_examples=8)
@given(seeds)
def test_the_nearest_opposite_pixel_is_that_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    front = np.where(rng.random((23, 31)) < rng.choice([0.02, 0.5, 0.98]), 0.5, -0.7)
    columns = np.empty(front.shape, np.int64)
    region.opposite(front, columns)
    arm = front > 0
    for i, j in np.ndindex(front.shape):
        there = np.argwhere(arm != arm[i, j])
        y, x = k._nearest_opposite(front, columns, i, j)
        if len(there):
            assert arm[y, x] != arm[i, j]
            assert (y - i) ** 2 + (x - j) ** 2 == ((there - [i, j]) ** 2).sum(axis=1).min()
        else:
            assert (y, x) == (i, j)


def rendered(model: ArmModel, pose: ArmPose) -> np.ndarray:
    """(HEIGHT, WIDTH) depths of the flesh, as balls 1.5 mm apart [m]; 0 where there is none."""
    depth = np.full((HEIGHT, WIDTH), np.inf)
    ys, xs = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(xs - LENS[2]) / LENS[0], (ys - LENS[3]) / LENS[1], np.ones(xs.shape)], axis=-1)
    R = pose.R.reshape(3, 3)
    for p in model.pieces(pose)[0]:
        for f in np.linspace(0, 1, max(int(p[k.LENGTH] / 0.0015), 2)):
            c, r = R @ (p[:3] + f * p[k.LENGTH] * p[3:6]) + pose.t, p[k.RA] + f * (p[k.RB] - p[k.RA])
            u, w, reach = LENS[0] * c[0] / c[2] + LENS[2], LENS[1] * c[1] / c[2] + LENS[3], LENS[0] * 1.1 * r / c[2] + 1
            part = np.s_[max(int(w - reach), 0) : max(int(w + reach) + 1, 0), max(int(u - reach), 0) : max(int(u + reach) + 1, 0)]
            ray = rays[part]
            a, b = (ray**2).sum(-1), ray @ c
            inner = b * b - a * (c @ c - r * r)
            z = (b - np.sqrt(np.maximum(inner, 0))) / a
            depth[part] = np.where((inner > 0) & (z < depth[part]), z, depth[part])
    return np.where(np.isfinite(depth), depth, 0.0)


def evidence_of(depth: np.ndarray) -> Evidence:
    front, columns, points = np.ascontiguousarray(depth), np.empty(depth.shape, np.int64), np.empty((3000, 3))
    region.opposite(front, columns)
    points = points[: region.unprojected(front, LENS, points)]
    return Evidence(points, np.ones(len(points)), front, columns, LENS)


def disturbed(model: ArmModel, pose: ArmPose, rng: np.random.Generator, far: float) -> ArmPose:
    """About 4 mm and 2° beside, angles by 2°, and that times `far`; where far, of an average person."""
    for dof in range(6):
        pose = moved(model, pose, dof, far * rng.normal(0, 0.0025 if dof < 3 else 0.02))
    z = pose.z + far * rng.normal(0, 0.035, len(pose.z))
    k.within(model.digits, model.columns, model.gains, z, model.c_max)
    v = model.state() if far > 1 else pose.v.copy()
    v[4:10] = pose.v[4:10]
    return ArmPose(pose.R, pose.t, z, v)


def seen(seed: int, side: Handedness, far: float) -> tuple[ArmModel, ArmPose, ArmPose, Evidence]:
    """A model, the pose that is seen, where a fit may begin, and what is seen."""
    model, rng = arm_model(side), np.random.default_rng(seed)
    true = posed(model, rng, opened=True)
    return model, true, disturbed(model, true, rng, far), evidence_of(rendered(model, true))


def off_m(model: ArmModel, one: ArmPose, other: ArmPose) -> np.ndarray:
    return np.linalg.norm(model.points(one) - model.points(other), axis=1)
