"""Arms of a scene: there and back, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from schema.test_codec_scenes import assert_same
from support.messages import arms_scene

from mocapella.errors import WireError
from mocapella.schema import decode_scene, encode_scene
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.arms import MAX_CAMERAS


def changed(field: str, value: Any) -> bytes:
    m: Any = pb.Scene.FromString(encode_scene(arms_scene()))
    if field == "cameras":
        del m.arms[0].cameras[:]
        m.arms[0].cameras.extend(value)
    else:
        setattr(m.arms[0], field, value)
    return m.SerializeToString()  # type: ignore[no-any-return]


def test_arms_come_back_as_they_were() -> None:
    scene = arms_scene()
    data = encode_scene(scene)
    assert_same(scene, decode_scene(data))
    assert encode_scene(decode_scene(data)) == data
    assert [arm.person for arm in decode_scene(data).arms] == [7, -1]


def test_the_person_0_is_somebody() -> None:
    assert decode_scene(changed("person", 0)).arms[0].person == 0


HALF = np.zeros((23, 3))
HALF[4, 1] = np.nan


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("points_m", b"\0" * 8, "Arm.points_m has 8 bytes"),
        ("points_m", np.full((23, 3), 1.5e6).tobytes(), r"Arm.points_m has a 1.5e\+06"),
        ("points_m", HALF.tobytes(), "Arm.points_m has a point with a part"),
        ("points_m", np.zeros((23, 3)).tobytes(), "Arm.point_states has a point known without a place, or one with"),
        ("point_states", b"\3" * 23, "Arm.point_states has a 3"),
        ("point_sd_m", np.full(23, -1, np.float32).tobytes(), "Arm.point_sd_m has a value"),
        ("angles_rad", np.full(21, 4.0).tobytes(), "Arm.angles_rad has a value beyond"),
        ("T_world_palm", np.ones((3, 4)).tobytes(), "Arm.T_world_palm is no rigid motion"),
        ("gesture", "x" * 81, "Arm.gesture has 81 characters"),
        ("gesture_sure", 1.5, "Arm.gesture_sure is 1.5"),
        ("gesture_sure", np.nan, "Arm.gesture_sure is nan"),
        ("cameras", ["no name"], "sensor name 'no name'"),
        ("cameras", ["a", "b", "a"], "Arm.cameras has a name twice"),
        ("cameras", [f"c{k}" for k in range(MAX_CAMERAS + 1)], "Arm.cameras has 65 names"),
    ],
)
def test_an_arm_that_is_none_is_refused(field: str, value: Any, said: str) -> None:
    with pytest.raises(WireError, match=said):
        decode_scene(changed(field, value))
