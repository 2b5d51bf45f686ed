"""A rosbag2 holds positions, rotations and angles; its bytes are read here by a small reader of CDR of our own."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from support.posed_person import person, points_of

from mocapella.exports.ros_messages import definition
from mocapella.exports.rosbag2 import FILE, R_ROS_WORLD, ros_name, ros_names, write_rosbag2
from mocapella.geometry.rigid import rigid
from mocapella.model.hand import ANGLES, LANDMARKS
from mocapella.model.joint_angles import JointAngles
from mocapella.model.trajectories import HAND_BONES, ORIGIN, Trajectories

BEGAN_NS = 1_700_000_000_123_456_789
FRAMES = 5
SIZES = {"int32": "i", "uint32": "I", "float32": "f", "float64": "d", "bool": "?", "uint8": "B"}


class Reader:
    """Reads a message by its definition, as a client does that knows nothing of the type."""

    def __init__(self, text: str, data: bytes) -> None:
        first, *others = text.split("=" * 80 + "\n")
        self.types = {"": first.split("\n")}
        for other in others:
            head, *fields = other.split("\n")
            self.types[head.removeprefix("MSG: ")] = fields
        assert data[:4] == b"\0\1\0\0"
        self.data, self.at = data[4:], 0

    def whole(self) -> dict[str, Any]:
        found = self.message("")
        assert self.at == len(self.data)
        return found

    def message(self, name: str) -> dict[str, Any]:
        fields = [line.split(" ") for line in self.types[name] if line]
        return {field: self.value(kind) for kind, field in fields}

    def value(self, kind: str) -> Any:
        if kind.endswith("[]"):
            return [self.value(kind[:-2]) for _ in range(self.value("uint32"))]
        if kind == "string":
            length = self.value("uint32")
            raw = self.data[self.at : self.at + length]
            self.at += length
            assert raw[-1:] == b"\0"
            return raw[:-1].decode()
        if kind not in SIZES:
            return self.message(kind)
        size = struct.calcsize(SIZES[kind])
        self.at += -self.at % size
        (found,) = struct.unpack_from("<" + SIZES[kind], self.data, self.at)
        self.at += size
        return found


def messages(path: Path) -> list[tuple[str, int, dict[str, Any]]]:
    with (path / FILE).open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        found = []
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            text = schema.data.decode()
            assert text == definition(schema.name)
            found.append((channel.topic, message.log_time, Reader(text, message.data).whole()))
        return found


def walk(seed: int = 0) -> Trajectories:
    """Two people: one who bends the knees, with an unknown and an inferred joint, and one who comes later."""
    rng = np.random.default_rng(seed)
    one, two = (
        person(points_of({"knee_angle_r": rng.uniform(0.5, 1.0, FRAMES), "pelvis_tx": np.full(FRAMES, x)}, FRAMES))
        for x in (0.0, 1.0)
    )
    positions = np.concatenate([one.positions, two.positions], axis=1)
    states = np.concatenate([one.states, two.states], axis=1)
    positions[:2, 1], states[:2, 1] = math.nan, 0
    ankle, wrist = one.keypoints.index("AnkleLeft"), one.keypoints.index("WristLeft")
    positions[3, 0, ankle], states[3, 0, ankle], states[:, 0, wrist] = math.nan, 0, 1
    return replace(
        one, positions=positions, states=states, sd=np.concatenate([one.sd, two.sd], axis=1),
        individuals=("Änna", "2"), began_unix_ns=BEGAN_NS,
    )  # fmt: skip


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_transforms_markers_and_angles_are_those_of_the_motion(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    own, path = walk(seed), tmp_path_factory.mktemp("bag") / "a.rosbag2"
    write_rosbag2(own, path)
    angles = JointAngles.of(own)
    found = messages(path)
    stamps = [BEGAN_NS + round(time * 1e9) for time in own.times_s.tolist()]
    at = {(topic, stamp): message for topic, stamp, message in found}
    assert len(at) == len(found) == 2 * FRAMES + FRAMES + FRAMES - 2
    for f, stamp in enumerate(stamps):
        places = own.positions[f] @ R_ROS_WORLD.T
        wanted = {
            f"{name}/{joint}": places[i, k]
            for i, name in enumerate(("_nna", "_2"))
            for k, joint in enumerate(own.keypoints)
            if np.isfinite(places[i, k]).all()
        }
        transforms = at["/tf", stamp]["transforms"]
        assert [one["child_frame_id"] for one in transforms] == list(wanted)
        for one in transforms:
            assert one["header"] == {
                "stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "world",
            }  # fmt: skip
            np.testing.assert_array_equal(list(one["transform"]["translation"].values()), wanted[one["child_frame_id"]])
            assert list(one["transform"]["rotation"].values()) == [0, 0, 0, 1]
        markers = at["/people/markers", stamp]["markers"]
        assert [one["type"] for one in markers] == [7, 5] * (1 if f < 2 else 2)
        assert len({(one["ns"], one["id"]) for one in markers}) == len(markers)
        known = np.isfinite(places[0]).all(axis=1)
        np.testing.assert_array_equal([list(point.values()) for point in markers[0]["points"]], places[0, known])
        np.testing.assert_array_equal(
            [colour["a"] == 1.0 for colour in markers[0]["colors"]], own.states[f, 0, known] == 2
        )
        ends = [bone for bone in own.bones if known[list(bone)].all()]
        assert [list(point.values()) for point in markers[1]["points"]] == places[0, np.array(ends).ravel()].tolist()
        assert all(len(one["points"]) == len(one["colors"]) for one in markers)
        joints = at["/people/_nna/joint_states", stamp]
        there = np.isfinite(angles.angles[f, 0])
        assert joints["name"] == [name for name, one in zip(angles.names, there, strict=True) if one]
        np.testing.assert_array_equal(joints["position"], angles.angles[f, 0, there])
        assert joints["velocity"] == joints["effort"] == []
        assert (("/people/_2/joint_states", stamp) in at) == (f >= 2)


def test_an_object_has_a_frame_with_its_rotation(tmp_path: Path) -> None:
    R = Rotation.random(2, random_state=np.random.default_rng(1)).as_matrix()
    pose = rigid(R, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))[:, None]
    pose[1] = math.nan
    cup = Trajectories(
        "objects", np.arange(2.0), np.zeros(2, np.int64), ("cup",), (ORIGIN,), pose[:, :, None, :3, 3],
        np.array([[[2]], [[0]]], np.uint8), np.full((2, 1, 1), math.nan, np.float32), poses=pose,
    )  # fmt: skip
    write_rosbag2(cup, tmp_path / "a.rosbag2")
    found = messages(tmp_path / "a.rosbag2")
    assert [topic for topic, _, _ in found] == ["/tf", "/objects/markers"]
    (one,) = found[0][2]["transforms"]
    assert one["child_frame_id"] == "cup/origin"
    assert list(one["transform"]["translation"].values()) == [3.0, 1.0, 2.0]
    turn = Rotation.from_quat(list(one["transform"]["rotation"].values())).as_matrix()
    np.testing.assert_allclose(turn, R_ROS_WORLD @ R[0], atol=1e-12)


def test_axes_are_those_of_ros_and_up_is_up() -> None:
    assert np.linalg.det(R_ROS_WORLD) == pytest.approx(1.0)
    np.testing.assert_array_equal(R_ROS_WORLD @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def test_the_metadata_counts_the_messages(tmp_path: Path) -> None:
    write_rosbag2(walk(), tmp_path / "a.rosbag2")
    text = (tmp_path / "a.rosbag2" / "metadata.yaml").read_text(encoding="utf-8")
    count = len(messages(tmp_path / "a.rosbag2"))
    assert text.count(f"message_count: {count}\n") == 2
    assert '      name: "/people/_nna/joint_states"\n' in text
    assert f"starting_time: {{nanoseconds_since_epoch: {BEGAN_NS}}}" in text
    assert "duration: {nanoseconds: 133333333}" in text


def test_nobody_is_an_empty_bag(tmp_path: Path) -> None:
    write_rosbag2(walk().at(slice(0, 0)), tmp_path / "a.rosbag2")
    assert messages(tmp_path / "a.rosbag2") == []
    assert "topics_with_message_count: []" in (tmp_path / "a.rosbag2" / "metadata.yaml").read_text(encoding="utf-8")


def test_names_become_parts_of_topics() -> None:
    for text, name in (("anna", "anna"), ("run1 person_1", "run1_person_1"), ("7", "_7"), ("", "_"), ("ö/~{", "____")):
        assert ros_name(text) == name


@given(st.lists(st.text(max_size=3), max_size=6, unique=True))
def test_different_names_stay_different(texts: list[str]) -> None:
    names = ros_names(texts)
    assert len(set(names)) == len(texts)
    assert ros_names(["x y", "x_y", "x_y_2"]) == ("x_y", "x_y_2", "x_y_2_2")


def test_a_hand_has_its_palm_and_its_own_angles(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    pose = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))[None, None]
    hand = Trajectories(
        "hands", np.zeros(1), np.zeros(1, np.int64), ("hand_1_left",), LANDMARKS, rng.normal(size=(1, 1, 21, 3)),
        np.full((1, 1, 21), 2, np.uint8), np.full((1, 1, 21), 0.01, np.float32), HAND_BONES, ANGLES,
        rng.normal(size=(1, 1, len(ANGLES))), pose,
    )  # fmt: skip
    write_rosbag2(hand, tmp_path / "a.rosbag2")
    found = {topic: message for topic, _, message in messages(tmp_path / "a.rosbag2")}
    children = [one["child_frame_id"] for one in found["/tf"]["transforms"]]
    assert children == [*(f"hand_1_left/{name.replace(' ', '_')}" for name in LANDMARKS), "hand_1_left/origin"]
    joints = found["/hands/hand_1_left/joint_states"]
    assert joints["name"] == [name.replace(" ", "_") for name in ANGLES]
    np.testing.assert_array_equal(joints["position"], hand.angles[0, 0])
