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
from mocapella.geometry.turn_kernels import turned
from mocapella.kinematics import arm_fit_kernels as k
from mocapella.kinematics import arm_flesh_kernels as fk
from mocapella.kinematics import arm_residual_kernels as rk
from mocapella.kinematics.arm_arrays import FitParameters
from mocapella.kinematics.arm_fit import ArmEvidence, ArmFitSettings, ArmModel, ArmPose
from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import ANGLES, BASES, TIPS, WRIST, Handedness, hand_model
from mocapella.sensing import arm_region_kernels as region

SIDES: tuple[Handedness, Handedness] = ("right", "left")
WIDTH, HEIGHT = 120, 140
HAND_PIECES = 25
OPEN = np.radians([-5, 4, 6, 0, 6, 4, 9, 8, 5, 3, 1, 8, 5, 4, -7, 8, 5, 5, -13, 9, 6])
LENS = np.array([150.0, 150.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2])
seeds = st.integers(0, 2**32 - 1)
sides = st.sampled_from(SIDES)


@cache
def arm_model(side: Handedness) -> ArmModel:
    model = hand_model("full").stretched(25.0, 28.0, 4.0)
    return ArmModel(model, model.shape(side))


@pytest.mark.parametrize("side", SIDES)
def test_the_flesh_of_a_longer_hand_is_as_much_longer_and_thicker(side: Handedness) -> None:
    model = hand_model("full")
    small, large = (ArmModel(model, model.shape(side, hand_length_m=length)) for length in (0.16, 0.2))
    for name in ("palm", "radii", "length_m", "forearm_m"):
        np.testing.assert_allclose(getattr(large, name), 1.25 * getattr(small, name), rtol=1e-9, err_msg=name)


def posed(model: ArmModel, rng: np.random.Generator, opened: bool = False) -> ArmPose:
    """A hand at 0.6 m that is half open, or opened, its palm about to the camera, its forearm about straight."""
    view = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T  # of a right hand's palm, fingers up
    mirror = np.diag(model.shape.mirror)
    R = mirror @ rotation_about_x(rng.normal(0, 0.2)) @ rotation_about_y(rng.normal(0, 0.3)) @ view @ mirror
    z = model.natural + rng.normal(0, 0.25, len(model.natural))
    if opened:
        z = OPEN[model.angle_of] + rng.normal(0, 0.05, len(model.natural))
    k.within(model.digits, model.columns, model.gains, z, model.c_max)
    v = model.state()
    v[4:7] = rng.normal(0, 0.1), rng.normal(0, 0.2), -1.0
    v[4:7] /= np.linalg.norm(v[4:7])
    v[7:10] = np.array([0, 0.5, -0.5]) + rng.normal(0, 0.5, 3)
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
    elif body < fk.D_LENGTH:
        k._turn(v, (fk.FOREARM, fk.UPPER)[body // 2], *(by * np.eye(2)[body % 2]))
    elif body == fk.D_LENGTH:
        v[fk.FOREARM_M] += by
    else:
        at = {fk.D_SCALE: fk.SCALE, fk.D_THICK: fk.THICK, fk.D_ARM_THICK: fk.ARM_THICK}
        v[at.get(body, fk.DIGITS + body - fk.D_DIGITS)] *= np.exp(by)
    return ArmPose(R, t, z, v)


def support(model: ArmModel, pose: ArmPose, piece: int, part: float, normal: Any) -> float:
    """How far a ball of the flesh reaches along a normal of the camera's space [m]."""
    p = model.pieces(pose)[0][piece]
    centre = p[fk.FROM : fk.FROM + 3] + part * p[fk.LENGTH] * p[fk.U : fk.U + 3]
    in_camera = pose.R.reshape(3, 3) @ centre + pose.t
    return float(in_camera @ normal + p[fk.RA] + part * (p[fk.RB] - p[fk.RA]))


def derivatives(model: ArmModel, pose: ArmPose, piece: int, part: float, normal: Any) -> np.ndarray:
    """(n,) those of the kernel; the normal is of the palm's frame."""
    pieces, _ = model.pieces(pose)
    rows, joints, axes = np.empty((5, k.DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    k.flesh(
        model.digits, model.mirror, model.radii, model.palm, model.columns, model.gains, pose.z, pose.v, rows, joints,
        axes, pieces,
    )  # fmt: skip
    p = pieces[piece]
    centre = p[fk.FROM : fk.FROM + 3] + part * p[fk.LENGTH] * p[fk.U : fk.U + 3]
    A, at = np.empty((rk.GROUPS, rk.MOVERS, rk.ROW)), np.empty((rk.GROUPS, rk.MOVERS), np.int64)
    counts, q = np.empty(rk.GROUPS, np.int64), np.empty(rk.ROW)
    rk.group_derivatives(joints, axes, model.columns, model.gains, model.rising, pose.v, len(pose.z), A, at, counts)
    group = rk.group_of(*model.owners[piece])
    rk.residual_numbers(group, *normal, *centre, p[fk.RA] + part * (p[fk.RB] - p[fk.RA]), pose.v, q)
    own = at[group, : counts[group]]
    assert (np.diff(own) > 0).all()  # what `add_groups` relies on
    assert own[0] >= 6
    out = np.zeros(6 + len(pose.z) + fk.BODY_DOFS)
    out[:6] = q[:6]
    out[own] = A[group, : counts[group]] @ q
    return out


@pytest.mark.slow
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
                 for dof in range(body + fk.BODY_DOFS) for h in (1e-6, -1e-6)]  # fmt: skip
        true = np.diff(np.reshape(steps, (-1, 2))[:, ::-1], axis=1)[:, 0] / 2e-6
        loose = np.full(len(true), 1e-7)
        if owner >= 0 and bone == 2:
            loose[[body + fk.D_THICK, body + fk.D_DIGITS + owner]] = inset
        if owner == fk.OF_FOREARM:
            loose[body : body + 2] = apart
            loose[body + fk.D_LENGTH] = apart / model.forearm_m
            loose[body + fk.D_ARM_THICK] = apart
        if owner < fk.OF_PALM:
            true[body + fk.D_SCALE] = 0.0
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
        centres = p[:3] + f[:, None] * p[fk.LENGTH] * p[3:6]
        radii = p[fk.RA] + f * (p[fk.RB] - p[fk.RA])
        for j, point in enumerate(points):
            apart = np.linalg.norm(point - centres, axis=1)
            best = int(np.argmin(apart - radii))
            facing = float((point - centres[best]) @ view[j])
            out[j, i] = facing + radii[best] if facing > 0.2 * apart[best] else apart[best] - radii[best]
    return out


@pytest.mark.slow
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
        centre = p[:3] + f * p[fk.LENGTH] * p[3:6]
        towards /= np.linalg.norm(towards)
        towards = -towards if towards @ (centre - eye) > 0 else towards  # the side that is seen
        points[i] = centre + (p[fk.RA] + f * (p[fk.RB] - p[fk.RA]) + rng.uniform(-0.002, 0.002)) * towards
    view = (points - eye) / np.linalg.norm(points - eye, axis=1)[:, None]
    brute = distances(pieces, points, view)
    hit = np.empty(5)
    for i, point in enumerate(points):
        nearest = np.abs(brute[i]).min()
        for first in (-1, 0, int(which[i])):
            piece = fk.closest(pieces, len(pieces), first, *point, *view[i], hit)
            assert abs(hit[4]) == pytest.approx(nearest, abs=2e-5)
            assert abs(brute[i, piece]) == pytest.approx(nearest, abs=2e-5)
            assert np.linalg.norm(hit[:3]) == pytest.approx(1.0)


def test_behind_a_capsule_the_distance_is_from_its_front_along_the_view() -> None:
    row = np.empty((1, fk.PIECE))
    fk.write_piece(row[0], -0.05, 0.0, 0.5, 0.05, 0.0, 0.5, 0.01, 0.01)
    hit = np.empty(5)
    for z, distance, normal in ((0.48, 0.01, -1.0), (0.495, -0.005, -1.0), (0.505, 0.015, 1.0), (0.53, 0.04, 1.0)):
        fk.closest(row, 1, 0, 0.01, 0.0, z, 0.0, 0.0, 1.0, hit)
        assert hit[4] == pytest.approx(distance)
        np.testing.assert_allclose(hit[:3], [0, 0, normal], atol=1e-12)
        assert hit[3] == pytest.approx(0.06)


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
        y, x = rk.nearest_opposite(front, columns, i, j)
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
        for f in np.linspace(0, 1, max(int(p[fk.LENGTH] / 0.0015), 2)):
            c, r = R @ (p[:3] + f * p[fk.LENGTH] * p[3:6]) + pose.t, p[fk.RA] + f * (p[fk.RB] - p[fk.RA])
            u, w, reach = LENS[0] * c[0] / c[2] + LENS[2], LENS[1] * c[1] / c[2] + LENS[3], LENS[0] * 1.1 * r / c[2] + 1
            part = np.s_[
                max(int(w - reach), 0) : max(int(w + reach) + 1, 0), max(int(u - reach), 0) : max(int(u + reach) + 1, 0)
            ]
            ray = rays[part]
            a, b = (ray**2).sum(-1), ray @ c
            inner = b * b - a * (c @ c - r * r)
            z = (b - np.sqrt(np.maximum(inner, 0))) / a
            depth[part] = np.where((inner > 0) & (z < depth[part]), z, depth[part])
    return np.where(np.isfinite(depth), depth, 0.0)


def evidence_of(depth: np.ndarray) -> ArmEvidence:
    front, columns, points = np.ascontiguousarray(depth), np.empty(depth.shape, np.int64), np.empty((3000, 3))
    region.opposite(front, columns)
    points = points[: region.unprojected(front, LENS, points)]
    return ArmEvidence(points, np.ones(len(points)), front, columns, LENS)


def disturbed(model: ArmModel, pose: ArmPose, rng: np.random.Generator, far: float) -> ArmPose:
    """About 4 mm and 2° beside, angles by 2°, and that times `far`; where far, of an average person."""
    for dof in range(6):
        pose = moved(model, pose, dof, far * rng.normal(0, 0.0025 if dof < 3 else 0.02))
    z = pose.z + far * rng.normal(0, 0.035, len(pose.z))
    k.within(model.digits, model.columns, model.gains, z, model.c_max)
    v = model.state() if far > 1 else pose.v.copy()
    v[4:10] = pose.v[4:10]
    return ArmPose(pose.R, pose.t, z, v)


def seen(seed: int, side: Handedness, far: float) -> tuple[ArmModel, ArmPose, ArmPose, ArmEvidence]:
    """A model, the pose that is seen, where a fit may begin, and what is seen."""
    model, rng = arm_model(side), np.random.default_rng(seed)
    true = posed(model, rng, opened=True)
    return model, true, disturbed(model, true, rng, far), evidence_of(rendered(model, true))


def off_m(model: ArmModel, one: ArmPose, other: ArmPose) -> np.ndarray:
    return np.linalg.norm(model.points(one) - model.points(other), axis=1)


def near_its_front(model: ArmModel, pose: ArmPose, points: np.ndarray) -> np.ndarray:
    """Those within 15 mm of the hand's flesh, on the side that is seen."""
    pieces, hit, R = model.pieces(pose)[0], np.empty(5), pose.R.reshape(3, 3)
    kept = []
    for point in points:
        x, view = R.T @ (point - pose.t), R.T @ (point / np.linalg.norm(point))
        fk.closest(pieces, HAND_PIECES, 0, *x, *view, hit)
        if abs(hit[4]) < 0.015 and hit[:3] @ view < -0.1:
            kept.append(point)
    assert len(kept) > 100
    return np.array(kept)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("side", SIDES)
def test_the_points_gradient_is_that_of_their_robust_cost(side: Handedness, seed: int) -> None:
    """Of motion, angles and size; where the distance has a derivative, and no point counts for nothing."""
    model, _, pose, evidence = seen(seed, side, 1.0)
    points = near_its_front(model, pose, evidence.points[::5] - [0, 0, 0.004])
    body = 6 + len(pose.z)
    n = body + fk.BODY_DOFS
    numbers = FitParameters(0.02, 0.015, 1.0, 0.0, 0.0, 0.0, 0.0, HAND_PIECES, 0.0, 1.0)
    nothing = ArmEvidence(points, np.ones(len(points)), np.zeros((2, 2)), np.full((2, 2), -1), LENS)

    def at(pose: ArmPose) -> tuple[float, np.ndarray]:
        g, costs = np.zeros(n), np.empty(k.COST_TERMS)
        k.system(
            model.arrays, nothing, np.zeros(len(points), np.int64), pose, numbers, np.zeros((n, n)), g, costs,
            np.full((5, 3), np.nan), False,
        )  # fmt: skip
        return 0.5 * numbers.point_scale_m**2 * float(costs[0]), g

    dofs = [*range(body), body + fk.D_SCALE]
    steps = [at(moved(model, pose, dof, h))[0] for dof in dofs for h in (-1e-6, 1e-6)]
    true = -np.diff(np.reshape(steps, (-1, 2)), axis=1)[:, 0] / 2e-6
    told = at(pose)[1][dofs]
    np.testing.assert_allclose(told, true, atol=1e-3 * np.abs(true).max())


@pytest.mark.slow
@settings(max_examples=4)
@given(seeds, sides)
def test_what_is_kept_of_residuals_tells_as_much_as_each_of_them(seed: int, side: Handedness) -> None:
    """Their normal equations, summed by group and told once, are those of their rows."""
    model, rng = arm_model(side), np.random.default_rng(seed)
    pose = posed(model, rng)
    n = 6 + len(pose.z) + fk.BODY_DOFS
    rows, joints, axes = np.empty((5, k.DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    pieces, _ = model.pieces(pose)
    k.flesh(
        model.digits, model.mirror, model.radii, model.palm, model.columns, model.gains, pose.z, pose.v, rows, joints,
        axes, pieces,
    )  # fmt: skip
    A, at = np.empty((rk.GROUPS, rk.MOVERS, rk.ROW)), np.empty((rk.GROUPS, rk.MOVERS), np.int64)
    counts, q = np.empty(rk.GROUPS, np.int64), np.empty(rk.ROW)
    rk.group_derivatives(joints, axes, model.columns, model.gains, model.rising, pose.v, len(pose.z), A, at, counts)
    Q, b = np.zeros((rk.GROUPS, rk.ROW, rk.ROW)), np.zeros((rk.GROUPS, rk.ROW))
    H, g, true_H, true_g = np.zeros((n, n)), np.zeros(n), np.zeros((n, n)), np.zeros(n)
    for piece in rng.integers(len(pieces), size=60):
        normal, part, w, e = rng.normal(size=3), float(rng.uniform()), float(rng.uniform()), float(rng.normal())
        p, group = pieces[piece], rk.group_of(*model.owners[piece])
        centre = p[fk.FROM : fk.FROM + 3] + part * p[fk.LENGTH] * p[fk.U : fk.U + 3]
        rk.residual_numbers(group, *normal, *centre, p[fk.RA] + part * (p[fk.RB] - p[fk.RA]), pose.v, q)
        rk.add_residual(q, w, e, Q[group], b[group])
        row = derivatives(model, pose, int(piece), part, normal)
        true_H += w * np.outer(row, row)
        true_g += w * e * row
    rk.add_groups(A, at, counts, Q, b, H, g)
    np.testing.assert_allclose(np.tril(H), np.tril(true_H), atol=1e-9)
    np.testing.assert_allclose(g, true_g, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_costs_alone_are_those_of_the_whole_system(side: Handedness) -> None:
    model, _, pose, evidence = seen(1, side, 2.0)
    numbers, n = model._parameters(pose, evidence, 400.0), 6 + len(pose.z) + fk.BODY_DOFS
    told = []
    for only in (False, True):
        H, g, costs = np.zeros((n, n)), np.zeros(n), np.empty(k.COST_TERMS)
        k.system(
            model.arrays, evidence, np.zeros(len(evidence.points), np.int64), pose, numbers, H, g, costs,
            np.zeros((5, 3)), only,
        )  # fmt: skip
        assert np.any(H) == np.any(g) == (not only)
        told.append(costs)
    np.testing.assert_array_equal(told[0], told[1])
    assert (told[0][[0, 1, 3]] > 0).all()


@pytest.mark.slow
def test_an_array_too_short_for_the_costs_is_refused() -> None:
    model, _, pose, evidence = seen(1, "left", 2.0)
    numbers, n = model._parameters(pose, evidence, 400.0), 6 + len(pose.z) + fk.BODY_DOFS
    with pytest.raises(ValueError, match="costs"):
        k.system(
            model.arrays, evidence, np.zeros(len(evidence.points), np.int64), pose, numbers, np.zeros((n, n)),
            np.zeros(n), np.empty(k.COST_TERMS - 1), np.zeros((5, 3)), True,
        )  # fmt: skip


def test_what_is_not_in_the_image_is_not_pulled_at() -> None:
    """Without points, and with the flesh beside the image, what was expected stays."""
    model = arm_model("left")
    pose = ArmPose(np.eye(3).reshape(9), np.array([0, 0, 0.6]), model.natural.copy(), model.state())
    blank = ArmEvidence(np.empty((0, 3)), np.empty(0), np.zeros((2, 2)), np.full((2, 2), -1), LENS)
    end = model.fit(pose, model.unexpected(pose), blank)
    np.testing.assert_allclose(model.points(end.pose), model.points(pose), atol=2e-4)
    assert end.costs[0] == 0.0


def test_flesh_is_not_pulled_to_pixels_where_no_edge_is_near() -> None:
    """Far from any edge there is nothing to tell which way: outside it costs much, deep inside nothing."""
    model = arm_model("left")
    pose = ArmPose(np.eye(3).reshape(9), np.array([0, 0, 0.6]), OPEN[model.angle_of], model.state())
    # Where nothing was measured it costs less than before what was; behind a surface that is very near, nothing.
    for depth, cost in ((0.0, rk._UNMEASURED), (-2.0, 1.0), (0.04, 0.0)):
        front = np.full((HEIGHT, WIDTH), depth)
        picture = ArmEvidence(np.empty((0, 3)), np.empty(0), front, np.full(front.shape, -1), LENS)
        end = model.fit(pose, model.unexpected(pose), picture, iterations=0)
        assert end.costs[1] == pytest.approx(cost)
        moving = model.fit(pose, model.unexpected(pose), picture)
        np.testing.assert_allclose(moving.pose.t, pose.t, atol=1e-3)


@pytest.mark.parametrize("side", SIDES)
def test_a_pose_that_is_nearly_right_is_found_again(side: Handedness) -> None:
    """From frame to frame; a thumb behind the hand may stay where it was."""
    offs = []
    for seed in range(8):
        model, true, start, evidence = seen(seed, side, 1.0)
        before = model.fit(start, model.unexpected(start), evidence, iterations=0)
        end = model.fit(start, model.unexpected(start), evidence, iterations=12, loose=1.0)
        assert end.cost < 0.3 * before.cost
        off = off_m(model, end.pose, true)
        assert off[PALM] < 0.010
        assert np.median(off[[*TIPS]]) < 0.008
        offs.append(off)
    assert np.median(np.array(offs)[:, [*TIPS]]) < 0.005
    assert np.median(np.array(offs)[:, [WRIST, PALM]]) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_from_farther_away_what_fits_well_is_right(side: Handedness) -> None:
    """A fit goes down to where it is best nearby, which may be the neighbouring finger; its cost tells."""
    fitting = []
    for seed in range(10):
        model, true, start, evidence = seen(seed, side, 2.3)
        before = model.fit(start, model.unexpected(start), evidence, iterations=0)
        end = model.fit(start, model.unexpected(start), evidence, iterations=15)
        assert end.cost < 0.5 * before.cost
        if end.cost < 0.02:
            fitting.append(off_m(model, end.pose, true)[[*TIPS, PALM]])
    assert len(fitting) >= 5
    assert np.median(fitting) < 0.005
    assert np.percentile(fitting, 90) < 0.015


def mirrored(pose: ArmPose) -> ArmPose:
    M, v = np.diag([-1.0, 1, 1]), pose.v.copy()
    v[[fk.FOREARM, fk.UPPER]] *= -1
    return ArmPose((M @ pose.R.reshape(3, 3) @ M).reshape(9).copy(), M @ pose.t, pose.z.copy(), v)


@settings(max_examples=6)
@given(st.integers(0, 1000), sides)
def test_the_mirrored_picture_of_the_other_hand_gives_the_mirrored_pose(seed: int, side: Handedness) -> None:
    model, _, start, seen_so = seen(seed, side, 1.0)
    other = arm_model("left" if side == "right" else "right")
    mirrored_columns = seen_so.opposite[:, ::-1]
    mirrored_columns = np.where(mirrored_columns < 0, -1, WIDTH - 1 - mirrored_columns)
    seen_other = ArmEvidence(
        seen_so.points * [-1, 1, 1], seen_so.weights, np.ascontiguousarray(seen_so.front[:, ::-1]), mirrored_columns,
        LENS,
    )  # fmt: skip
    begin = mirrored(start)
    one = model.fit(start, model.unexpected(start), seen_so)
    two = other.fit(begin, other.unexpected(begin), seen_other)
    np.testing.assert_allclose(other.points(two.pose) * [-1, 1, 1], model.points(one.pose), atol=1e-6)
    np.testing.assert_allclose(two.costs, one.costs, atol=1e-6)


@settings(max_examples=12)
@given(seeds, sides, st.floats(0, 0.3))
def test_limits_and_sizes_are_kept_whatever_is_seen(seed: int, side: Handedness, spread_m: float) -> None:
    """Points anywhere, and a picture that is not theirs."""
    rng = np.random.default_rng(seed)
    model = arm_model(side)
    start = posed(model, rng)
    front = rng.choice([0.0, 0.55, 0.62, -0.7], (HEIGHT, WIDTH))
    columns = np.empty(front.shape, np.int64)
    region.opposite(front, columns)
    points = start.t + rng.normal(0, 0.02 + spread_m, (150, 3))
    evidence = ArmEvidence(np.ascontiguousarray(points), np.ones(150), front, columns, LENS)
    targets = start.t + rng.normal(0, 0.1, (5, 3))
    end = model.fit(start, model.unexpected(start), evidence, tips=targets)
    R, t, z, v = end.pose
    assert model.model.within(model.angles(end.pose), 1e-6)
    np.testing.assert_allclose(R.reshape(3, 3) @ R.reshape(3, 3).T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(v[4:10].reshape(2, 3), axis=1), 1.0)
    for least, most, sizes in (
        (0.6, 1.4, v[:1]), (0.7, 1.4, v[1:2]), (0.12, 0.4, v[2:3]), (0.7, 1.6, v[3:4]), (0.75, 1.3, v[10:])
    ):  # fmt: skip
        assert ((sizes >= least) & (sizes <= most)).all()
    assert np.isfinite(t).all()
    assert np.isfinite(z).all()
    assert (end.costs >= 0).all()
    assert end.costs[:2].max() <= 1.0


def test_a_start_is_not_written_into() -> None:
    model, _, start, evidence = seen(0, "right", 1.0)
    before = start.copied()
    end = model.fit(start, model.unexpected(start), evidence)
    assert not np.array_equal(end.pose.t, before.t)
    for one, other in zip(start, before, strict=True):
        np.testing.assert_array_equal(one, other)


def test_digits_that_overlap_are_pushed_apart() -> None:
    model = arm_model("right")
    pose = ArmPose(np.eye(3).reshape(9), np.array([0, 0, 0.6]), OPEN[model.angle_of], model.state())
    index, middle = model.columns[1, 1], model.columns[2, 1]
    pose.z[index], pose.z[middle] = np.radians([-8.0, 8.0])
    blank = ArmEvidence(np.empty((0, 3)), np.empty(0), np.zeros((2, 2)), np.full((2, 2), -1), LENS)
    before = model.fit(pose, model.unexpected(pose), blank, iterations=0)
    after = model.fit(pose, model.unexpected(pose), blank, iterations=8)
    assert before.costs[2] > 1.0
    assert after.costs[2] < 0.1 * before.costs[2]


def folded(model: ArmModel, pose: ArmPose, digit: int) -> ArmPose:
    z = pose.z.copy()
    for column, angle in zip(
        model.columns[digit], np.radians([65, 0, 80, 50, 0] if digit else [30, 20, 30, 60, 0]), strict=True
    ):
        if column >= 0:
            z[column] = angle
    k.within(model.digits, model.columns, model.gains, z, model.c_max)
    return pose._replace(z=z)


@pytest.mark.parametrize("digit", range(5))
def test_a_digit_that_is_held_otherwise_is_found_and_what_is_promised_is_gained(digit: int) -> None:
    for seed, side in ((0, "right"), (1, "left")):
        model, true, _, _ = seen(seed, side, 1.0)
        true = folded(model, true, digit)
        evidence = evidence_of(rendered(model, true))
        wrong = true._replace(z=posed(model, np.random.default_rng(seed), opened=True).z)
        gain, better, _ = model.held_otherwise(wrong, evidence, digit)
        before, after = (
            model.fit(pose, model.unexpected(pose), evidence, iterations=0).cost for pose in (wrong, better)
        )
        assert gain > 0.006
        assert before - after == pytest.approx(gain, abs=0.02)
        tip = 4 + 4 * digit
        assert off_m(model, better, true)[tip] < 0.6 * off_m(model, wrong, true)[tip]
        others = [column for d in range(5) if d != digit for column in model.columns[d] if column >= 0]
        np.testing.assert_array_equal(better.z[others], wrong.z[others])


def test_a_digit_that_is_right_is_left_as_it_is() -> None:
    for seed in range(3):
        model, true, _, evidence = seen(seed, "right", 1.0)
        for digit in range(5):
            gain, *_ = model.held_otherwise(true, evidence, digit)
            assert 0 <= gain < 0.02


def test_a_fingertip_is_clear_where_it_is_seen_and_not_where_nothing_is() -> None:
    model, true, _, _ = seen(0, "right", 1.0)
    evidence = evidence_of(rendered(model, true))
    unseen = evidence._replace(
        points=evidence.points[:0], weights=evidence.weights[:0], front=np.zeros_like(evidence.front)
    )
    for digit in range(5):
        assert model.held_otherwise(true, evidence, digit).clearness > 0.005
        assert model.held_otherwise(true, unseen, digit).clearness < 0.005


def test_fingers_that_are_bent_unlike_are_exchanged_and_others_are_not() -> None:
    model, true, _, _ = seen(0, "right", 1.0)
    assert not list(model.exchanged(true))
    pointing = true
    for digit in (2, 3, 4):
        pointing = folded(model, pointing, digit)
    poses = list(model.exchanged(pointing))
    columns = [[column for column in model.columns[digit] if column >= 0] for digit in range(1, 5)]
    straight = [[bool(pose.z[c[0]] < 0.5) for c in columns] for pose in poses]
    assert [False, True, False, False] in straight
    assert all(np.array_equal(pose.z[model.columns[0]], pointing.z[model.columns[0]]) for pose in poses)


def test_fingers_are_held_alike_and_the_thumb_and_what_spreads_them_as_they_are() -> None:
    model = arm_model("left")
    pose = posed(model, np.random.default_rng(6))
    poses = list(model.alike(pose))
    for alike in poses:
        for column in (0, 2):
            assert np.ptp(alike.z[model.columns[1:, column]]) == 0
        assert np.array_equal(alike.z[model.columns[1:, 1]], pose.z[model.columns[1:, 1]])
        thumb = model.columns[0][model.columns[0] >= 0]
        assert np.array_equal(alike.z[thumb], pose.z[thumb])
    assert np.ptp([alike.z[model.columns[1, 0]] for alike in poses]) > 1.2


@pytest.mark.parametrize("side", SIDES)
def test_a_rigid_hand_is_found_five_centimetres_away_in_its_posture(side: Handedness) -> None:
    model, true, _, evidence = seen(3, side, 1.0)
    start = true._replace(t=true.t + np.array([0.04, -0.03, 0.0]))
    end = model.fit(start, model.rigid(start, np.radians(1)), evidence, iterations=12, loose=4.0).pose
    assert np.linalg.norm(end.t - true.t) < 0.006
    assert np.abs(end.z - true.z).max() < np.radians(6)
    np.testing.assert_allclose(end.v[[0, 1, 3, *range(10, 15)]], true.v[[0, 1, 3, *range(10, 15)]], atol=0.06)


@pytest.mark.parametrize("side", SIDES)
def test_landmarks_are_visible_where_their_flesh_is_seen(side: Handedness) -> None:
    model, true, _, evidence = seen(3, side, 1.0)
    shown = model.visible(true, evidence.front, evidence.lens)
    assert (shown[[TIPS[1], TIPS[2], TIPS[4], 9]] > 0.1).all()
    assert np.median(shown) > 0.5
    behind = evidence._replace(front=np.where(evidence.front > 0, 0.3, -0.3))
    assert (model.visible(true, behind.front, behind.lens) == 0).all()
    assert (model.visible(true._replace(t=true.t + np.array([5.0, 0, 0])), evidence.front, evidence.lens) == 0).all()


def test_what_other_things_hide_is_told() -> None:
    model, true, _, evidence = seen(0, "right", 1.0)
    for front, hidden in ((evidence.front, 0.0), (np.full(evidence.front.shape, -0.3), 1.0)):
        end = model.fit(true, model.unexpected(true), evidence._replace(front=front), iterations=0)
        assert end.costs[4] == pytest.approx(hidden, abs=0.02)


def test_tips_that_are_known_are_reached() -> None:
    model = arm_model("left")
    pose = ArmPose(np.eye(3).reshape(9), np.array([0, 0, 0.6]), OPEN[model.angle_of], model.state())
    bent = pose.copied()
    bent.z[model.columns[1, 0]] += 0.6
    tips = np.full((5, 3), np.nan)
    tips[1] = model.points(bent)[TIPS[1]]
    blank = ArmEvidence(np.empty((0, 3)), np.empty(0), np.zeros((2, 2)), np.full((2, 2), -1), LENS)
    end = model.fit(pose, model.unexpected(pose), blank, tips=tips, keep=1.0, iterations=15)
    began = np.linalg.norm(model.points(pose)[TIPS[1]] - tips[1])
    assert np.linalg.norm(model.points(end.pose)[TIPS[1]] - tips[1]) < 0.2 * began


@pytest.mark.parametrize("side", SIDES)
def test_angles_are_those_of_the_hand_and_points_those_of_its_chain(side: Handedness) -> None:
    model, rng = arm_model(side), np.random.default_rng(5)
    pose = posed(model, rng)
    angles = model.angles(pose)
    assert angles.shape == (len(ANGLES),)
    np.testing.assert_allclose(angles[model.angle_of], pose.z)
    points = model.points(pose)
    in_palm = (points - pose.t) @ pose.R.reshape(3, 3)
    np.testing.assert_allclose(in_palm[WRIST], 0.0, atol=1e-12)
    np.testing.assert_allclose(in_palm[[*BASES]], model.shape.bases * model.shape.mirror * pose.v[0], atol=1e-12)
    bones = np.linalg.norm(np.diff(in_palm[1:21].reshape(5, 4, 3), axis=1), axis=-1)
    np.testing.assert_allclose(bones, model.shape.lengths * pose.v[0] * pose.v[10:, None], atol=1e-12)
    np.testing.assert_allclose(pose.T_camera_palm[:3, :3].reshape(9), pose.R)
    np.testing.assert_allclose(points[PALM], points[[WRIST, 9]].mean(axis=0))
    assert np.linalg.norm(in_palm[ELBOW]) == pytest.approx(pose.v[2], abs=0.03)


@pytest.mark.parametrize("side", SIDES)
def test_the_palms_flesh_has_no_step_at_a_knuckle(side: Handedness) -> None:
    """Pieces from the wrist end at the fingers' knuckles; those across go from each of these ends to the next."""
    palm = arm_model(side).palm
    ends, across = palm[:4, 3:6], palm[4:7, :6].reshape(3, 2, 3)
    np.testing.assert_allclose(across, np.stack([ends[:-1], ends[1:]], axis=1), atol=1e-12)


def test_relevance_is_of_the_hand_then_the_forearm_then_little() -> None:
    model = arm_model("right")
    pose = ArmPose(np.eye(3).reshape(9), np.array([0, 0, 0.6]), OPEN[model.angle_of], model.state())
    places = np.array([[0, 0, 0.7], [0, 0, 0.4], [0.2, 0, 0.4], [0, 0, 1.2]])
    np.testing.assert_allclose(model.relevance(places, pose), [1.0, 0.5, 0.05, 0.05])
    np.testing.assert_allclose(model.relevance(places, pose, 0.2)[2:], 0.2)


def test_balls_along_the_flesh_say_whose_they_are() -> None:
    model = arm_model("right")
    pose = posed(model, np.random.default_rng(3))
    balls = model.spheres(pose)
    hand = balls[:, 4] == 1
    points = model.points(pose)
    for tip in TIPS:
        assert (np.linalg.norm(balls[hand, :3] - points[tip], axis=1) < 0.01).any()
    elbow = np.linalg.norm(balls[:, :3] - points[ELBOW], axis=1)
    assert elbow[~hand].min() < 0.04 < elbow[hand].min()
    assert len(model.spheres(pose, 0.001)) == 400  # as many as are kept


def test_the_thumb_of_a_new_arm_may_be_less_usual_than_a_finger_but_for_poor_starts() -> None:
    model, pose = arm_model("right"), posed(arm_model("right"), np.random.default_rng(3))
    s = model.settings
    usual = model.unexpected(pose, usual=True)
    np.testing.assert_allclose(model.unexpected(pose).information[10:], [s.thumb_sd**-2.0, *[s.digit_sd**-2.0] * 4])
    np.testing.assert_allclose(usual.information[10:], s.digit_sd**-2.0)
    np.testing.assert_array_equal(usual.information[:10], model.unexpected(pose).information[:10])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        *((name, (0.0, 1.0, -1.0)) for name in ("point_scale_m", "silhouette_scale_m", "point_sd_m", "silhouette_sd_m",
          "collision_sd_m", "size_sd", "thickness_sd", "digit_sd", "thumb_sd", "forearm_sd")),
        *((name, (-0.01, 0.1)) for name in ("ahead_m", "overlap_m")),
        *((name, (0.0, 1e5, float("nan"))) for name in ("deviation_sd_deg", "flexion_sd_deg", "angle_rate_deg_s",
          "palm_rate_deg_s", "palm_rate_m_s")),
        ("edge", (-1.1, 1.1)), ("loose", (0.9, 10.1)), ("iterations", (0, 101)),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(name: str, values: tuple[float, ...]) -> None:
    for value in values:
        with pytest.raises(SettingsError, match=name):
            replace(ArmFitSettings(), **{name: value})
