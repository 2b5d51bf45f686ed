"""The library rosbags reads our bag, by its folder, with its own definitions of the types.

uv run --group interop pytest tests/interop/test_rosbags.py -m slow
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.clients import MARKS, read_by
from support.posed_person import person, points_of

from mocapella.exports.rosbag2 import R_ROS_WORLD, write_rosbag2
from mocapella.model.joint_angles import JointAngles

pytestmark = MARKS
FRAMES = 20
ROSBAGS = """
import json, sys
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores[sys.argv[2]])
frames = {}
with Reader(sys.argv[1]) as reader:
    assert reader.message_count == sum(one.msgcount for one in reader.connections)
    for connection, stamp, raw in reader.messages():
        message, frame = store.deserialize_cdr(raw, connection.msgtype), frames.setdefault(stamp, {})
        if connection.topic == "/tf":
            frame["tf"] = {one.child_frame_id: [one.transform.translation.x, one.transform.translation.y,
                           one.transform.translation.z] for one in message.transforms}
            head = message.transforms[0].header
            assert head.stamp.sec * 10**9 + head.stamp.nanosec == stamp and head.frame_id == "world"
        elif connection.topic == "/people/markers":
            frame["points"] = [[p.x, p.y, p.z] for p in message.markers[0].points]
            assert [one.type for one in message.markers] == [7, 5]
            assert len(message.markers[1].points) == len(message.markers[1].colors) > 0
        else:
            assert connection.topic == "/people/anna/joint_states"
            frame["angles"] = dict(zip(message.name, message.position.tolist()))
print(json.dumps([frames[stamp] for stamp in sorted(frames)]))
"""


@pytest.mark.parametrize("distribution", ["ROS2_HUMBLE", "ROS2_JAZZY"])
def test_rosbags_reads_what_we_write(tmp_path: Path, distribution: str) -> None:
    bend = np.linspace(0.4, 1.2, FRAMES)
    own = person(points_of({"knee_angle_r": bend, "elbow_flex_l": bend, "pelvis_ty": 0.5 + 0 * bend}, FRAMES))
    write_rosbag2(own, tmp_path / "a.rosbag2")
    found = read_by(tmp_path, ROSBAGS, ["rosbags>=0.10"], str(tmp_path / "a.rosbag2"), distribution)
    assert len(found) == FRAMES
    angles, known = JointAngles.of(own), np.isfinite(own.positions[:, 0]).all(axis=2)
    for f, frame in enumerate(found):
        places = own.positions[f, 0] @ R_ROS_WORLD.T
        wanted = {f"anna/{name}": places[k].tolist() for k, name in enumerate(own.keypoints) if known[f, k]}
        assert frame["tf"] == wanted
        np.testing.assert_array_equal(frame["points"], places[known[f]])
        values = dict(zip(angles.names, angles.angles[f, 0].tolist(), strict=True))
        assert frame["angles"] == {name: value for name, value in values.items() if np.isfinite(value)}
