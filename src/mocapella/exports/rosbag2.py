"""Write rosbag2: a folder with an MCAP of messages of ROS 2 and its metadata.yaml, for RViz, Foxglove and ros2 bag."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import Final

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import mocapella
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.exports.ros_messages import (
    JOINT_STATE,
    LINE_LIST,
    MARKERS,
    SPHERE_LIST,
    TF,
    Marker,
    definition,
    joint_state_message,
    markers_message,
    tf_message,
)
from mocapella.model.joint_angles import JointAngles
from mocapella.model.observations import JointState
from mocapella.model.trajectories import ORIGIN, Trajectories

Float64 = NDArray[np.float64]

FILE: Final = "motion_0.mcap"
FRAME: Final = "world"
"""Name of the parent frame of all transforms and markers: x forward, y left, z up."""
R_ROS_WORLD: Final = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""ROS' axes (REP 103: z up) from the world's (y up): x is the world's z, y its x."""
_COLOURS: Final = np.array(
    [[0.12, 0.47, 0.71], [1.0, 0.5, 0.05], [0.17, 0.63, 0.17], [0.84, 0.15, 0.16], [0.58, 0.4, 0.74]]
)
_INFERRED_OPACITY: Final = 0.35
_JOINT_M: Final = 0.04
_BONE_M: Final = 0.015
_LEAST_LIFETIME_S: Final = 0.2


@dataclass
class _Topic:
    """A topic of the bag: its type, the number of its channel, and of its messages so far."""

    type: str
    channel: int
    count: int = 0


@dataclass
class _Bag:
    """An MCAP with the profile ``ros2`` that takes messages."""

    writer: Writer
    topics: dict[str, _Topic] = field(default_factory=dict)
    schemas: dict[str, int] = field(default_factory=dict)

    def add(self, name: str, type_name: str, unix_ns: int, data: bytes) -> None:
        topic = self.topics.get(name)
        if topic is None:
            if type_name not in self.schemas:
                text = definition(type_name).encode()
                self.schemas[type_name] = self.writer.register_schema(type_name, "ros2msg", text)
            channel = self.writer.register_channel(name, "cdr", self.schemas[type_name], {"offered_qos_profiles": ""})
            topic = self.topics[name] = _Topic(type_name, channel)
        self.writer.add_message(topic.channel, unix_ns, data, unix_ns, topic.count)
        topic.count += 1


def write_rosbag2(trajectories: Trajectories, path: Path) -> None:
    """Write a folder with `FILE` and metadata.yaml; positions have ROS' axes, z up.

    At each time, ``/tf`` has a frame ``anna/Head`` for each known keypoint, and ``cup/origin`` with the rotation of an
    object, a palm or a body's root; ``/people/markers`` has spheres and lines, more transparent where inferred, and
    ``/people/anna/joint_states`` the known joint angles [rad]. Standard deviations are in no message.

    Args:
        trajectories: individuals of one kind, at any times.
        path: the folder, which must not exist.

    Raises:
        OSError: a file cannot be written.
    """
    path.mkdir()
    try:
        angles = JointAngles.of(trajectories, with_sd=False)
    except SettingsError:  # objects, and points of no body, have none
        angles = None
    stamps = trajectories.began_unix_ns + np.rint(trajectories.times_s * NS_PER_S).astype(np.int64)
    with (path / FILE).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=f"mocapella {mocapella.__version__}")
        bag = _Bag(writer)
        for name, type_name, unix_ns, data in _messages(trajectories, angles, stamps):
            bag.add(name, type_name, unix_ns, data)
        writer.finish()  # type: ignore[no-untyped-call]
    text = _metadata(bag.topics, int(stamps[0]) if len(stamps) else 0, int(np.ptp(stamps)) if len(stamps) else 0)
    (path / "metadata.yaml").write_text(text, encoding="utf-8", newline="")


def _messages(
    own: Trajectories, angles: JointAngles | None, stamps: NDArray[np.int64]
) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, time [ns] and bytes of each message, in the order of time."""
    names = ros_names(own.individuals)
    joints = ros_names(own.keypoints)
    turns = None if own.poses is None else _quaternions(own.poses)
    bones = np.array(own.bones, dtype=np.int64).reshape(-1, 2)
    lifetime = round(NS_PER_S * max(_LEAST_LIFETIME_S, 3.0 / own.rate_hz if own.rate_hz > 0 else 0.0))
    points = [k for k, name in enumerate(own.keypoints) if name != ORIGIN or own.poses is None]
    frames = [[f"{name}/{joints[k]}" for k in points] for name in names]
    labels = () if angles is None else ros_names(angles.names)
    for f, stamp in enumerate(stamps.tolist()):
        positions = own.positions[f] @ R_ROS_WORLD.T
        known = np.isfinite(positions).all(axis=2)
        children: list[str] = []
        poses, markers = [], []
        for i, name in enumerate(names):
            seen = known[i, points]
            children += compress(frames[i], seen.tolist())
            poses.append(np.zeros((int(seen.sum()), 7)))
            poses[-1][:, :3], poses[-1][:, 6] = positions[i, points][seen], 1.0
            if turns is not None and own.poses is not None and np.isfinite(turns[f, i]).all():
                children.append(f"{name}/{ORIGIN}")
                poses.append(np.concatenate([R_ROS_WORLD @ own.poses[f, i, :3, 3], turns[f, i]])[None])
            if known[i].any():
                colours = _colours(own.states[f, i], i)
                markers += _markers(name, i, positions[i], known[i], colours, bones)
        if children:
            yield "/tf", TF, stamp, tf_message(stamp, FRAME, children, np.vstack(poses))
        if markers:
            yield f"/{own.kind}/markers", MARKERS, stamp, markers_message(stamp, FRAME, markers, lifetime)
        if angles is not None:
            for i, name in enumerate(names):
                there = np.flatnonzero(np.isfinite(angles.angles[f, i]))
                if len(there):
                    data = joint_state_message(stamp, [labels[k] for k in there], angles.angles[f, i, there])
                    yield f"/{own.kind}/{name}/joint_states", JOINT_STATE, stamp, data


def ros_names(texts: Iterable[str]) -> tuple[str, ...]:
    """Return `ros_name` of each text, with numbers behind names that would be equal."""
    found: dict[str, None] = {}
    for text in texts:
        name, number = ros_name(text), 2
        while name in found:
            name, number = f"{ros_name(text)}_{number}", number + 1
        found[name] = None
    return tuple(found)


def ros_name(text: str) -> str:
    """Return a text as a part of a topic: letters of ASCII, digits and underscores, with no digit in front."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text) or "_"
    return f"_{name}" if name[0].isdigit() else name


def _quaternions(poses: Float64) -> Float64:
    """Return the rotations of poses (..., 4, 4) in ROS' axes as (..., 4), in the order x, y, z, w; NaN stays NaN."""
    R = R_ROS_WORLD @ poses[..., :3, :3]
    out = np.full((*R.shape[:-2], 4), np.nan)
    known = np.isfinite(poses).all(axis=(-1, -2))
    if known.any():
        out[known] = Rotation.from_matrix(R[known]).as_quat()
    return out


def _colours(states: NDArray[np.uint8], individual: int) -> NDArray[np.float32]:
    out = np.empty((len(states), 4), np.float32)
    out[:, :3] = _COLOURS[individual % len(_COLOURS)]
    out[:, 3] = np.where(states == JointState.TRACKED, 1.0, _INFERRED_OPACITY)
    return out


def _markers(  # noqa: PLR0917  # arrays of one individual
    name: str,
    i: int,
    positions: Float64,
    known: NDArray[np.bool_],
    colours: NDArray[np.float32],
    bones: NDArray[np.int64],
) -> list[Marker]:
    """Return spheres at the known keypoints of one individual, and lines of its bones with two known ends."""
    found = [Marker(name, 2 * i, SPHERE_LIST, positions[known], colours[known], _JOINT_M)]
    ends = bones[known[bones].all(axis=1)].ravel()
    if len(ends):
        found.append(Marker(name, 2 * i + 1, LINE_LIST, positions[ends], colours[ends], _BONE_M))
    return found


def _metadata(topics: dict[str, _Topic], start_ns: int, duration_ns: int) -> str:
    """Return the text of metadata.yaml, version 5, which ROS 2 Humble and later read."""
    count = sum(topic.count for topic in topics.values())
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        "  storage_identifier: mcap",
        f"  duration: {{nanoseconds: {duration_ns}}}",
        f"  starting_time: {{nanoseconds_since_epoch: {start_ns}}}",
        f"  message_count: {count}",
        "  topics_with_message_count:" + ("" if topics else " []"),
    ]
    for name, topic in topics.items():
        lines += [
            "    - topic_metadata:",
            *_indented(8, [f"name: {json.dumps(name)}", f"type: {topic.type}", "serialization_format: cdr",
                           'offered_qos_profiles: ""']),
            f"      message_count: {topic.count}",
        ]  # fmt: skip
    lines += [
        '  compression_format: ""',
        '  compression_mode: ""',
        f"  relative_file_paths: [{FILE}]",
        "  files:",
        f"    - path: {FILE}",
        f"      starting_time: {{nanoseconds_since_epoch: {start_ns}}}",
        f"      duration: {{nanoseconds: {duration_ns}}}",
        f"      message_count: {count}",
    ]
    return "\n".join(lines) + "\n"


def _indented(spaces: int, lines: Sequence[str]) -> list[str]:
    return [" " * spaces + line for line in lines]
