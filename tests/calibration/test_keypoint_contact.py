"""Feet that rest are on one floor, and the joints of a body are eliminated exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.webcam_people import circling, standing, walker

from mocapella.calibration.keypoint_bundle import (
    BONES,
    CAMERA,
    CLOCK,
    JOINTS,
    POSE,
    STATURES,
    BundlePrior,
    KeypointViews,
    PeopleBundle,
    _joint_inverse,
    adjust_people,
)
from mocapella.calibration.keypoint_contact import (
    CONTACT_SD,
    CONTACTS,
    FLOOR,
    contact_derivatives,
    contact_residuals,
    moved_floor,
    no_floor,
)
from mocapella.calibration.people_floor import find_contacts
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
ALL = np.ones((3, JOINTS), dtype=bool)


def some(seed: int) -> tuple[Float64, Float64]:
    """Joints (3, 26, 3) and a floor (7,)."""
    random = np.random.default_rng(seed)
    floor = np.r_[random.normal(size=3), random.normal(size=4)]
    floor[:3] /= np.linalg.norm(floor[:3])
    return random.normal(size=(3, JOINTS, 3)), floor


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_derivatives_are_those_of_finite_differences(seed: int) -> None:
    joints, floor = some(seed)
    by_joint, by_floor = contact_derivatives(joints, floor)
    h = 1e-6
    for k in range(FLOOR):
        step = np.zeros(FLOOR)
        step[k] = h
        ahead, back = (contact_residuals(joints, ALL, moved_floor(floor, sign * step)) for sign in (1.0, -1.0))
        np.testing.assert_allclose((ahead - back) / (2 * h), by_floor[..., k], atol=1e-5)
    for axis in range(3):
        step3 = np.eye(3)[axis] * h
        ahead, back = (contact_residuals(joints + sign * step3, ALL, floor) for sign in (1.0, -1.0))
        np.testing.assert_allclose((ahead - back) / (2 * h), by_joint[axis], atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_residuals_do_not_depend_on_the_frame(seed: int) -> None:
    joints, floor = some(seed)
    T = rigid(rotation_about_x(0.7), np.array([1.0, -2.0, 0.5]))
    normal = T[:3, :3] @ floor[:3]
    moved = np.r_[normal, floor[3:] + normal @ T[:3, 3]]
    np.testing.assert_allclose(
        contact_residuals(apply(T, joints), ALL, moved), contact_residuals(joints, ALL, floor), atol=1e-9
    )


def test_feet_that_do_not_rest_say_nothing() -> None:
    joints, floor = some(1)
    assert not contact_residuals(joints, ~ALL, floor).any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.0, 0.1, 10.0]))
def test_joints_are_eliminated_as_by_the_inverse_of_the_whole(seed: int, damping: float) -> None:
    random = np.random.default_rng(seed)
    blocks = np.zeros((2, JOINTS, 3, JOINTS, 3))
    for joint in range(JOINTS):
        A = random.normal(size=(3, 3))
        blocks[:, joint, :, joint] = A @ A.T + np.eye(3)
    for one, other, _ in BONES:
        across = random.normal(size=3)
        square = np.outer(across, across)
        for i, j, sign in ((one, one, 1), (other, other, 1), (one, other, -1), (other, one, -1)):
            blocks[:, i, :, j] += sign * square
    whole, values = blocks.reshape(2, 3 * JOINTS, -1), random.normal(size=(2, 3 * JOINTS, 4))
    diagonal = np.einsum("bi,ij->bij", damping * np.einsum("bii->bi", whole) + 1e-9, np.eye(3 * JOINTS))
    expected = np.linalg.solve(whole + diagonal, values)
    np.testing.assert_allclose(_joint_inverse(whole, damping).times(values), expected, atol=1e-9)


@pytest.mark.parametrize(("walks", "some_rest"), [(False, True), (True, False)])
def test_standing_feet_rest_and_gliding_feet_do_not(walks: bool, some_rest: bool) -> None:
    at_s = np.arange(30) / 5.0
    places = [circling(1.5, 4.0) if walks else standing(0.5 * (k // 5), 0.2 * (k // 5)) for k in range(30)]
    joints = np.array([walker(0.0 if not walks else t, place) for t, place in zip(at_s, places, strict=True)])
    T = rigid(rotation_about_x(0.4), np.array([0.0, -1.0, 4.0]))  # a camera that looks down
    resting, floor = find_contacts(apply(T, joints), np.zeros(30, np.int64), at_s, 1.74)
    assert resting[:, CONTACTS].any() == some_rest
    assert not np.delete(resting, CONTACTS, axis=1).any()
    if some_rest:
        np.testing.assert_allclose(floor[:3], T[:3, 1], atol=0.02)
        heights = contact_residuals(apply(T, joints), resting, floor)
        assert np.abs(heights[resting[:, CONTACTS]]).max() * CONTACT_SD < 0.02
    else:
        assert np.array_equal(floor, no_floor())


@pytest.mark.slow
def test_the_floor_brings_resting_feet_to_one_height() -> None:
    rig = list(circle_of_cameras(3).cameras.values())
    T = np.array([one.T_camera_world @ inverse(rig[0].T_camera_world) for one in rig])
    lenses, bodies = np.array([one.camera.lens for one in rig]), 16
    joints = np.array(
        [apply(rig[0].T_camera_world, walker(t, circling(0.9, 6.0))) for t in np.linspace(0.0, 6.0, bodies)]
    )
    camera, body, joint = (i.ravel() for i in np.meshgrid(range(3), range(bodies), range(JOINTS), indexing="ij"))
    seen = np.array([project(apply(one, joints), lens) for one, lens in zip(T, lenses, strict=True)]).reshape(-1, 2)
    seen += np.random.default_rng(0).normal(0.0, 4.0, seen.shape)
    count = len(camera)
    views = KeypointViews(
        camera, body, joint, seen, np.zeros((count, 2)), np.ones(count), np.zeros(bodies, np.int64),
        np.arange(bodies) // 4,
    )  # fmt: skip
    lengths: list[list[float]] = [[] for _ in STATURES]
    for one, other, which in BONES:
        lengths[which] += np.linalg.norm(joints[:, one] - joints[:, other], axis=-1).tolist()
    log_lengths = np.log([[float(np.mean(of)) for of in lengths]])
    free = np.zeros((3, CAMERA), dtype=bool)
    free[1:, POSE], free[:, CLOCK] = True, False
    stature = float(np.exp(np.mean(log_lengths - np.log(STATURES))))
    prior = BundlePrior(free, lenses, np.zeros(3), np.full((3, CAMERA), np.inf), stature)
    resting = np.zeros((bodies, JOINTS), dtype=bool)
    resting[:, CONTACTS] = True
    up = rig[0].T_camera_world[:3, 1]
    floor = np.r_[up, (joints[:, CONTACTS] @ up).mean(axis=0).reshape(-1, 2).mean(axis=1)]
    start = PeopleBundle(T, lenses, np.zeros(3), joints, log_lengths, floor)
    spread = []
    for known in (None, resting):
        found = adjust_people(replace(views, resting=known), start, prior, rounds=2).bundle
        heights = found.joints[:, CONTACTS] @ up
        spread.append(float((heights - heights.mean(axis=0)).std()))
    assert spread[1] < 0.7 * spread[0]
