"""The valid name that an error suggests: never a joint of the other side."""

from __future__ import annotations

import pytest

from mocapella.errors import one_of
from mocapella.model.topology import topology, topology_names

HALPE = topology("halpe_26").joints


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("KneeLeft", "(did you mean LKnee?)"),
        ("left_knee", "(did you mean LKnee?)"),
        ("KneeRight", "(did you mean RKnee?)"),
        ("Knee", "(did you mean LKnee or RKnee?)"),
        ("LKne", "(did you mean LKnee?)"),
        ("Haed", "(did you mean Head?)"),
    ],
)
def test_a_joint_of_another_program_s_name_is_suggested(value: str, said: str) -> None:
    assert one_of(value, HALPE).endswith(said)


@pytest.mark.parametrize("name", topology_names())
def test_no_joint_of_the_other_side_is_suggested(name: str) -> None:
    own = topology(name)
    for joint, mirror in zip(own.joints, own.mirror, strict=True):
        if own.joints[mirror] != joint and not joint.startswith("face"):  # points of a face are numbered
            rest = [other for other in own.joints if other != joint]
            assert f"(did you mean {own.joints[mirror]}?)" not in one_of(joint, rest), joint


def test_angles_keep_their_side_and_other_names_are_compared_as_before() -> None:
    assert one_of("knee_left", ["knee_angle_r", "knee_angle_l"]).endswith("(did you mean knee_angle_l?)")
    assert one_of("smothing", ["frames", "smoothing"]) == "frames, smoothing (did you mean smoothing?)"
    assert one_of("rihgt", ["left", "right"]) == "left, right (did you mean right?)"
    assert one_of("zzz", ["frames", "smoothing"]) == "frames, smoothing"
    assert one_of("", []) == ""
