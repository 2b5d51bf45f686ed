"""Topologies are data, and the data must be a tree with a mirror."""

from __future__ import annotations

import pytest

from mocapella.errors import SettingsError
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG, Topology, topology, topology_from_toml, topology_names

ALL = [topology(name) for name in topology_names()]


@pytest.fixture(params=ALL, ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> Topology:
    return request.param  # type: ignore[no-any-return]


def test_both_kinects_are_there() -> None:
    assert {kind.name: len(kind) for kind in ALL}.items() >= {"kinect_v1": 20, "kinect_v2": 25}.items()


def test_the_joints_are_in_the_order_of_the_sdk() -> None:
    v2 = topology("kinect_v2")
    numbers = {"SpineBase": 0, "Head": 3, "ShoulderLeft": 4, "HandRight": 11, "FootRight": 19, "SpineShoulder": 20}
    assert {joint: v2.index(joint) for joint in numbers} == numbers
    assert v2.index("ThumbRight") == 24
    assert topology("kinect_v1").index("HipCenter") == 0


def test_names_are_unique(kind: Topology) -> None:
    assert len(set(kind.joints)) == len(kind)


def test_bones_are_a_tree_from_the_root(kind: Topology) -> None:
    parents = {child: parent for parent, child in kind.bones}
    assert len(parents) == len(kind.bones) == len(kind) - 1
    for start in range(len(kind)):
        joint, steps = start, 0
        while joint != kind.parts["root"]:
            joint, steps = parents[joint], steps + 1
            assert steps < len(kind)


def test_the_mirror_is_an_involution_that_maps_bones_to_bones(kind: Topology) -> None:
    assert tuple(kind.mirror[i] for i in kind.mirror) == tuple(range(len(kind)))
    mirrored = {(kind.mirror[a], kind.mirror[b]) for a, b in kind.bones}
    assert mirrored == set(kind.bones)


def test_left_mirrors_to_right(kind: Topology) -> None:
    for i, joint in enumerate(kind.joints):
        swapped = joint.replace("Left", "Right") if "Left" in joint else joint.replace("Right", "Left")
        assert kind.joints[kind.mirror[i]] == swapped


def test_the_parts_that_methods_ask_for_are_there(kind: Topology) -> None:
    wanted = {"root", "head", "shoulder_left", "shoulder_right", "hand_left", "hand_right", "foot_left", "foot_right"}
    if kind.name == "hand":
        wanted = {"root"}
    assert wanted <= set(kind.parts)
    for part, joint in kind.parts.items():
        if part.endswith("_left"):
            assert kind.mirror[joint] == kind.parts[part.replace("_left", "_right")]


def test_an_unknown_joint_is_named_with_a_suggestion() -> None:
    with pytest.raises(SettingsError, match=r"kinect_v2 has no joint 'Haed'.*did you mean Head\?"):
        topology("kinect_v2").index("Haed")


def test_an_unknown_topology_is_named_with_a_suggestion() -> None:
    with pytest.raises(SettingsError, match=r"unknown topology 'kinect_v22'; known: .*did you mean kinect_v2\?"):
        topology("kinect_v22")


ARM = """
joints = ["Root", "L", "R"]
bones = [["Root", "L"], ["Root", "R"]]
mirror = [["L", "R"]]
[parts]
root = "Root"
"""


def test_a_new_topology_needs_only_its_text() -> None:
    arm = topology_from_toml(ARM, "arm")
    assert arm == Topology("arm", ("Root", "L", "R"), ((0, 1), (0, 2)), (0, 2, 1), {"root": 0})


def test_the_field_of_view_is_the_files_and_else_the_stated_one() -> None:
    assert topology("kinect_v2").field_of_view_deg == (70.6, 60.0)
    assert topology("kinect_v1").field_of_view_deg == (57.5, 43.5)
    assert topology_from_toml(ARM, "arm").field_of_view_deg == UNKNOWN_FIELD_OF_VIEW_DEG
    assert topology_from_toml("field_of_view_deg = [90, 65]" + ARM, "arm").field_of_view_deg == (90.0, 65.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[parts]", "field_of_view_deg = [70, 180]\n[parts]", r"field_of_view_deg is \[70, 180\].*below 180"),
        ('["Root", "R"]]', '["Root", "X"]]', "a bone names 'X'; joints are Root, L, R"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "Y"]]', "a mirror pair names 'Y'"),
        ('root = "Root"', 'root = "Roof"', r"part root names 'Roof'.*did you mean Root\?"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "L"]]', "L and L cannot be a mirror pair"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "R"], ["L", "Root"]]', "L and Root cannot be a mirror pair"),
        ('["Root", "R"]]', '["Root", "R"], ["L", "R"]]', "bone L–R does not continue the tree"),
        ('[["Root", "L"],', '[["R", "L"],', "bone R–L does not continue the tree"),
        ('["Root", "R"]]', '["L", "Root"]]', "bone L–Root does not continue the tree"),
        (', ["Root", "R"]]', "]", "no bone reaches R"),
    ],
)
def test_a_text_that_is_no_topology_is_refused(old: str, new: str, message: str) -> None:
    assert ARM.count(old) == 1
    with pytest.raises(SettingsError, match="topology arm: " + message):
        topology_from_toml(ARM.replace(old, new), "arm")
