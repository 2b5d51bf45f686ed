"""The simulated body: proportions, reach, mirror images, and what other topologies call its joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.simulate.body import (
    BODY,
    JOINT,
    ROOT,
    body_template,
    bone_lengths,
    facing,
    joint_positions,
    simulated_joints,
)
from mocapella.sources.simulate.motion import normalised


def _random_directions(seed: int) -> np.ndarray:
    directions = normalised(np.random.default_rng(seed).standard_normal((len(BODY), 3)))
    directions[ROOT] = 0
    return directions


@given(st.integers(0, 2**31), st.floats(1.0, 2.2))
def test_bones_keep_their_length_in_any_pose(seed: int, stature: float) -> None:
    positions = joint_positions(np.array([0.3, 1.0, 2.0]), _random_directions(seed), bone_lengths(stature))
    for parent, child in BODY.bones:
        bone = np.linalg.norm(positions[child] - positions[parent])
        assert bone == pytest.approx(bone_lengths(stature)[child], abs=1e-12)


@given(st.integers(0, 2**31))
def test_no_joint_is_farther_from_the_root_than_its_bones_reach(seed: int) -> None:
    lengths = bone_lengths(1.8)
    positions = joint_positions(np.zeros(3), _random_directions(seed), lengths)
    assert (np.linalg.norm(positions, axis=1) <= body_template().chain @ lengths + 1e-12).all()


def test_segments_are_the_published_fractions_of_stature() -> None:
    lengths = bone_lengths(2.0) / 2.0
    published = {
        "ElbowRight": 0.186,
        "WristLeft": 0.146,
        "KneeLeft": 0.245,
        "AnkleRight": 0.246,
        "ShoulderRight": 0.129,
    }
    for joint, fraction in published.items():
        assert lengths[JOINT[joint]] == pytest.approx(fraction)
    upright = body_template().chain @ body_template().offsets
    hip_height = 0.039 + 0.246 + 0.245
    assert upright[JOINT["SpineShoulder"], 1] + hip_height == pytest.approx(0.818)
    assert upright[JOINT["Head"], 1] + hip_height == pytest.approx(0.936)


def test_right_is_the_mirror_image_of_left() -> None:
    model = body_template()
    mirror = list(BODY.mirror)
    np.testing.assert_array_equal(model.offsets[mirror] * (-1, 1, 1), model.offsets)
    np.testing.assert_array_equal(model.within[np.ix_(mirror, mirror)], model.within)


def test_a_joint_lies_in_the_bones_that_meet_in_it_and_not_in_the_far_side() -> None:
    within = body_template().within
    for parent, child in BODY.bones:
        assert within[parent, child]
        assert within[child, child]
    assert not within[JOINT["HandLeft"], JOINT["SpineMid"]]
    assert not within[JOINT["ShoulderLeft"], JOINT["ElbowRight"]]


@given(st.floats(-3.1, 3.1))
def test_facing_follows_the_shoulders(yaw: float) -> None:
    left_up_forward = body_template().chain @ body_template().offsets
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    np.testing.assert_allclose(facing(left_up_forward @ turn.T), [np.sin(yaw), 0, np.cos(yaw)], atol=1e-12)


def test_a_topology_is_simulated_by_the_bodys_own_joints() -> None:
    v1 = simulated_joints("kinect_v1")
    assert [BODY.joints[i] for i in v1.weights.argmax(axis=1)[:3]] == ["SpineBase", "SpineMid", "SpineShoulder"]
    np.testing.assert_array_equal(np.sort(v1.weights, axis=1)[:, -2:], [[0.0, 1.0]] * 20)
    np.testing.assert_array_equal(simulated_joints("kinect_v2").weights, np.eye(25))
    azure = simulated_joints("azure_kinect")
    assert azure.known.all()
    np.testing.assert_allclose(azure.weights.sum(axis=1), 1)


def test_a_topology_with_a_joint_of_its_own_is_refused_by_name() -> None:
    with pytest.raises(
        SettingsError, match=r"topology nite cannot be simulated: .* JOINT_HEAD.*; take one of kinect_v2,"
    ):
        simulated_joints("nite")
