"""A followed body as a file, back as it was; and what is none."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.twists import exp_twist
from mocapella.model.twist_tree import TreePose
from mocapella.recording.bodies_file import (
    ALONE,
    PEOPLE_FORMAT,
    FollowedBody,
    FollowedPeople,
    check_person_name,
    frame_of,
    is_followed_body,
    is_followed_people,
    joints_of_people,
    named_joints,
    read_followed_body,
    read_followed_people,
)

NAMES = ("left knee flexion", "waist bend")


def a_frame(pose, number=3):
    return frame_of(
        number, 0.1, pose, joint_names=NAMES, landmarks={"nose": np.array([1.0, 2.0, 3.0])}, overlap={"c1": 0.912345},
        left_out={"c2": "its image is black"}, lost=False,
    )  # fmt: skip


@given(st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6), st.lists(st.floats(-3, 3), min_size=2, max_size=2))
def test_a_pose_comes_back(twist, angles):
    pose = TreePose(exp_twist(np.array(twist)), np.array(angles))
    frame = msgspec.json.decode(msgspec.json.encode(a_frame(pose)), type=type(a_frame(pose)))
    again = frame.pose(NAMES)
    np.testing.assert_allclose(again.T_world_model, pose.T_world_model, atol=1e-9)
    np.testing.assert_array_equal(again.angles, pose.angles)
    assert (frame.overlap, frame.left_out) == ({"c1": 0.9123}, {"c2": "its image is black"})
    assert frame.joints == {"nose": (1.0, 2.0, 3.0)}


def written(path, **changes):
    body = FollowedBody("male", [a_frame(TreePose(np.eye(4), np.zeros(2)))], None, {"thigh": 0.4})
    path.write_text(json.dumps({**msgspec.to_builtins(body), **changes}))
    return path


def test_a_file_comes_back(tmp_path):
    body = read_followed_body(written(tmp_path / "out.json", rig="rig.toml"))
    assert (body.model, body.proportions, body.frames[0].frame) == ("male", {"thigh": 0.4}, 3)
    assert is_followed_body(msgspec.to_builtins(body))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format": "other"}, "field format: 'other'"),
        ({"version": 9}, "field version: 9.*this program reads version 1"),
        ({"frames": []}, "field frames: has no frame"),
        ({"frames": [{"frame": "x"}]}, r"\$\.frames\[0\]\.frame"),
    ],
)
def test_a_file_that_is_none_is_named(tmp_path, changes, said):
    with pytest.raises(InputError, match=f"out.json: .*{said}"):
        read_followed_body(written(tmp_path / "out.json", **changes))
    (tmp_path / "no.json").write_text("{")
    with pytest.raises(InputError, match=r"no\.json: is no JSON"):
        read_followed_body(tmp_path / "no.json")


@pytest.mark.parametrize(
    ("data", "body", "people"),
    [
        ({"frames": []}, True, False),
        ({"format": PEOPLE_FORMAT}, False, True),
        ({"format": "other"}, False, False),
        (["frames"], False, False),
        ("frames", False, False),
        ({}, False, False),
    ],
)
def test_what_a_file_has_is_told_by_its_fields(data, body, people):
    assert (is_followed_body(data), is_followed_people(data)) == (body, people)


names = st.text(st.characters(categories=("L", "N", "P", "Zs")), min_size=1, max_size=40).filter(
    lambda name: name == name.strip() and "=" not in name and name.isprintable()
)


@given(st.dictionaries(names, st.lists(st.floats(-9, 9), min_size=3, max_size=3), min_size=1, max_size=3))
def test_people_come_back_by_whatever_they_are_called(tmp_path_factory, people):
    path = tmp_path_factory.mktemp("people") / "out.json"
    bodies = {}
    for name, place in people.items():
        T = np.eye(4)
        T[:3, 3] = place
        bodies[check_person_name(name)] = FollowedBody("female", [a_frame(TreePose(T, np.zeros(2)))], 1.6)
    path.write_text(json.dumps(msgspec.to_builtins(FollowedPeople(bodies))))
    assert is_followed_people(json.loads(path.read_text()))
    assert read_followed_people(path) == bodies
    starts = {name: {"nose": place} for name, place in people.items()}
    for name, joints in joints_of_people(starts, path).items():
        np.testing.assert_array_equal(joints["nose"], people[name])


def test_one_body_is_nobody_by_name(tmp_path):
    path = written(tmp_path / "out.json")
    assert list(read_followed_people(path)) == [ALONE]
    assert not is_followed_people(json.loads(path.read_text()))
    assert list(joints_of_people({"nose": [0, 1, 2]}, path)) == [ALONE]


@pytest.mark.parametrize("name", ["", " anna", "anna\n", "a=b", "\x00", "x" * 41])
def test_nobody_is_called_so(name):
    with pytest.raises(SettingsError, match="cannot be a person's name"):
        check_person_name(name)


def test_joints_by_name(tmp_path):
    found = named_joints({"left_hip": [1, 2, 3], "nose": [0.5, 0, 0]}, tmp_path)
    assert list(found) == ["left hip", "nose"]
    np.testing.assert_array_equal(found["left hip"], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("value", [[1, 2], [1, 2, "3"], [1, 2, None], [True, 0, 0], {"x": 1}, [1, 2, 5000.0]])
def test_joints_that_are_none_are_named(tmp_path, value):
    with pytest.raises(InputError, match="field left hip"):
        named_joints({"left hip": value}, tmp_path / "joints.json")
    with pytest.raises(InputError, match="has no named joints"):
        named_joints([value], tmp_path / "joints.json")
