"""Topologies are data, and the data must be a tree with a mirror."""

from __future__ import annotations

import re

import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG, Topology, topology, topology_from_toml, topology_names

ALL = [topology(name) for name in topology_names()]


@pytest.fixture(params=ALL, ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> Topology:
    return request.param  # type: ignore[no-any-return]


def test_all_sensors_are_there() -> None:
    assert {kind.name: len(kind) for kind in ALL} == {
        "arkit": 91, "azure_kinect": 32, "body_25": 25, "body_25b": 25, "coco_17": 17, "coco_18": 18,
        "coco_wholebody_133": 133, "halpe_26": 26, "halpe_136": 136, "hand": 21, "kinect_v1": 20, "kinect_v2": 25,
        "mediapipe_pose": 33, "nite": 15,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("arkit", {"root": 0, "left_foot_joint": 4, "spine_7_joint": 18, "left_handThumbEnd_joint": 46,
                   "head_joint": 51, "nose_joint": 58, "right_hand_joint": 66, "right_handThumbEnd_joint": 90}),
        ("azure_kinect", {"NECK": 3, "CLAVICLE_LEFT": 4, "THUMB_LEFT": 10, "HIP_LEFT": 18, "HEAD": 26}),
        ("body_25", {"Nose": 0, "RShoulder": 2, "LShoulder": 5, "MidHip": 8, "REye": 15, "LBigToe": 19, "RHeel": 24}),
        ("body_25b", {"Nose": 0, "LShoulder": 5, "LHip": 11, "Neck": 17, "Head": 18, "LBigToe": 19, "RHeel": 24}),
        ("coco_18", {"Nose": 0, "Neck": 1, "RShoulder": 2, "LShoulder": 5, "RHip": 8, "LAnkle": 13, "LEar": 17}),
        ("coco_wholebody_133", {"right_ankle": 16, "left_big_toe": 17, "right_heel": 22, "face_0": 23, "face_67": 90,
                                "left_hand_root": 91, "left_thumb4": 95, "right_hand_root": 112,
                                "right_pinky_finger4": 132}),
        ("halpe_136", {"Nose": 0, "RHeel": 25, "face_0": 26, "left_hand_root": 94, "right_hand_root": 115}),
        ("coco_17", {"nose": 0, "left_ear": 3, "left_shoulder": 5, "right_hip": 12, "right_ankle": 16}),
        ("halpe_26", {"Nose": 0, "LShoulder": 5, "Head": 17, "Neck": 18, "Hip": 19, "LSmallToe": 22, "RHeel": 25}),
        ("mediapipe_pose", {"LEFT_EYE_OUTER": 3, "MOUTH_LEFT": 9, "LEFT_PINKY": 17, "LEFT_HIP": 23, "LEFT_HEEL": 29}),
        ("nite", {"JOINT_HEAD": 0, "JOINT_RIGHT_HAND": 7, "JOINT_TORSO": 8, "JOINT_LEFT_FOOT": 13}),
    ],
)  # fmt: skip
def test_the_joints_have_the_vendors_numbers(name: str, numbers: dict[str, int]) -> None:
    assert {joint: topology(name).index(joint) for joint in numbers} == numbers


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
    sides = {"Left": "Right", "LEFT": "RIGHT", "left": "right"}
    sides |= {right: left for left, right in sides.items()}
    for i, joint in enumerate(kind.joints):
        swapped = re.sub("|".join(sides), lambda side: sides[side[0]], joint)
        if re.match("[LR][A-Z][a-z]", joint):  # LEar, RBigToe
            swapped = re.sub("^[LR]", lambda side: "R" if side[0] == "L" else "L", joint)
        if joint.startswith("face_"):
            continue  # numbered; see below
        assert kind.joints[kind.mirror[i]] == swapped


@pytest.mark.parametrize("name", ["coco_wholebody_133", "halpe_136"])
def test_the_face_is_mirrored_as_ibug_numbers_it(name: str) -> None:
    kind = topology(name)
    central = {int(kind.joints[i].removeprefix("face_")) for i, other in enumerate(kind.mirror)
               if i == other and kind.joints[i].startswith("face_")}  # fmt: skip
    assert central == {8, 27, 28, 29, 30, 33, 51, 57, 62, 66}
    for left, right in ((0, 16), (21, 22), (36, 45), (41, 46), (48, 54), (59, 55), (60, 64), (67, 65)):
        assert kind.mirror[kind.index(f"face_{left}")] == kind.index(f"face_{right}")


@pytest.mark.parametrize("kind", [kind for kind in ALL if "halpe_26" in kind.mappings], ids=lambda kind: kind.name)
def test_keypoints_of_detectors_are_single_joints_of_halpe(kind: Topology) -> None:
    for joint, terms in kind.mappings["halpe_26"].items():
        assert list(terms.values()) == [1.0]
        (own,) = terms
        assert (
            topology("halpe_26").joints[joint][-3:].lower() in kind.joints[own].lower() or "INDEX" in kind.joints[own]
        )


def test_the_topologies_of_detectors_have_a_mapping_to_halpe() -> None:
    assert {kind.name: len(kind.mappings["halpe_26"]) for kind in ALL if "halpe_26" in kind.mappings} == {
        "body_25": 25, "body_25b": 25, "coco_17": 17, "coco_18": 18, "coco_wholebody_133": 23, "halpe_136": 26,
        "mediapipe_pose": 21,
    }  # fmt: skip


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
    assert topology("azure_kinect").field_of_view_deg == (75.0, 65.0)
    assert topology_from_toml(ARM, "arm").field_of_view_deg == UNKNOWN_FIELD_OF_VIEW_DEG
    assert topology_from_toml("field_of_view_deg = [90, 65]" + ARM, "arm").field_of_view_deg == (90.0, 65.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[parts]", "field_of_view_deg = [70, 180]\n[parts]", r"field_of_view_deg is \[70.0, 180.0\].*below 180"),
        ("[parts]", "noise = 0\n[parts]", r"noise is 0.0.*from 0.01 to 100"),
        ("[parts]", "scale_sd = 0.5\n[parts]", r"scale_sd is 0.5.*below 0.5"),
        ('["Root", "R"]]', '["Root", "X"]]', "a bone names 'X'; joints are Root, L, R"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "Y"]]', "a mirror pair names 'Y'"),
        ('root = "Root"', 'root = "Roof"', r"part root names 'Roof'.*did you mean Root\?"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "L"]]', "L and L cannot be a mirror pair"),
        ('mirror = [["L", "R"]]', 'mirror = [["L", "R"], ["L", "Root"]]', "L and Root cannot be a mirror pair"),
        ('["Root", "R"]]', '["Root", "R"], ["L", "R"]]', "bone L–R does not continue the tree"),
        ('[["Root", "L"],', '[["R", "L"],', "bone R–L does not continue the tree"),
        ('["Root", "R"]]', '["L", "Root"]]', "bone L–Root does not continue the tree"),
        (', ["Root", "R"]]', "]", "no bone reaches R"),
        ('root = "Root"', 'head = "Root"', "parts has no root"),
    ],
)
def test_a_text_that_is_no_topology_is_refused(old: str, new: str, message: str) -> None:
    assert ARM.count(old) == 1
    with pytest.raises(SettingsError, match="topology arm: " + message):
        topology_from_toml(ARM.replace(old, new), "arm")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('mirror = [["L", "R"]]', "", "missing required field `mirror`"),
        ("mirror = ", "miror = ", "unknown field `miror`"),
        ('["Root", "L", "R"]', '["Root", "L", 3]', "Expected `str`, got `int`"),
        ('["Root", "L"]', '["Root"]', "length 2"),
    ],
)
def test_a_missing_or_wrong_field_is_named(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match="(?i)is no topology arm: .*" + message):
        topology_from_toml(ARM.replace(old, new), "arm")


MAPPED = (
    ARM
    + """
[mapping.kinect_v2]
SpineBase = "Root"
SpineMid = { Root = 1.5, L = -0.25, R = -0.25 }
HandLeft = { Root = 0.25, L = 0.75 }
HandRight = { Root = 0.25, R = 0.75 }
"""
)


def test_a_joint_is_mapped_by_weights_or_by_the_name_of_the_joint_at_its_position() -> None:
    v2 = topology("kinect_v2")
    assert topology_from_toml(MAPPED, "arm").mappings == {
        "kinect_v2": {
            v2.index("SpineBase"): {0: 1.0},
            v2.index("SpineMid"): {0: 1.5, 1: -0.25, 2: -0.25},
            v2.index("HandLeft"): {0: 0.25, 1: 0.75},
            v2.index("HandRight"): {0: 0.25, 2: 0.75},
        }
    }


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[mapping.kinect_v2]", "[mapping.kinect_v3]", "unknown topology 'kinect_v3'.*did you mean kinect_v2"),
        ("SpineBase =", "SpineBas =", r"mapping.kinect_v2 names 'SpineBas'.*did you mean SpineBase\?"),
        ('"Root"\nSpineMid', '"Roof"\nSpineMid', r"mapping.kinect_v2 names 'Roof'.*did you mean Root\?"),
        ("L = 0.75", "X = 0.75", "mapping.kinect_v2 names 'X'; joints are Root, L, R"),
        ("L = 0.75", "L = 0.7", r"mapping.kinect_v2.HandLeft is \[0.25, 0.7\].*sum to 1"),
        ("Root = 0.25, L = 0.75", "Root = 6, L = -5", "mapping.kinect_v2.HandLeft.*weights up to 4"),
        ("Root = 0.25, L = 0.75", "Root = 1, L = 0", "mapping.kinect_v2.HandLeft.*not 0"),
        ("Root = 0.25, L = 0.75", "Root = 0.25, L = nan", "mapping.kinect_v2.HandLeft"),
        (
            "Root = 0.25, R = 0.75",
            "Root = 0.5, R = 0.5",
            "mapping.kinect_v2: HandLeft has other weights than its mirror",
        ),
        ("R = -0.25", "R = -0.5", "mapping.kinect_v2.SpineMid.*sum to 1"),
        ("L = -0.25, R = -0.25", "L = -0.5", "mapping.kinect_v2: SpineMid has other weights than its mirror image"),
        ("HandRight = { Root = 0.25, R = 0.75 }", "", "mapping.kinect_v2: HandLeft has other weights than its mirror"),
    ],
)
def test_a_mapping_that_cannot_be_used_is_refused(old: str, new: str, message: str) -> None:
    assert MAPPED.count(old) == 1
    with pytest.raises(SettingsError, match=message):
        topology_from_toml(MAPPED.replace(old, new), "arm")


SHIFTED = (
    MAPPED.replace("{ Root = 0.25, L = 0.75 }", '"L"').replace("{ Root = 0.25, R = 0.75 }", '"R"')
    + """
[shift.kinect_v2]
HandLeft = { towards = "Root", share = 0.1 }
HandRight = { towards = "Root", share = 0.1 }
"""
)


def test_a_joint_is_shifted_towards_another_one() -> None:
    v2, arm = topology("kinect_v2"), topology_from_toml(SHIFTED, "arm")
    root = (arm.index("Root"), 0.1)
    assert arm.shifts == {"kinect_v2": {v2.index("HandLeft"): root, v2.index("HandRight"): root}}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('HandLeft = { towards = "Root"', 'SpineMid = { towards = "Root"', "shift.kinect_v2 names 'SpineMid'; single"),
        ('HandLeft = { towards = "Root"', 'HandLeft = { towards = "Roof"', r"'Roof'.*did you mean Root\?"),
        (
            '{ towards = "Root", share = 0.1 }\nHandR',
            '{ towards = "Root", share = 0.4 }\nHandR',
            "HandLeft is 0.4.*0.3",
        ),
        ('{ towards = "Root", share = 0.1 }\nHandR', '{ towards = "Root", share = nan }\nHandR', "HandLeft is nan"),
        (
            '{ towards = "Root", share = 0.1 }\nHandR',
            '{ towards = "Root", share = 0.2 }\nHandR',
            "than its mirror image",
        ),
    ],
)
def test_a_shift_that_cannot_be_used_is_refused(old: str, new: str, message: str) -> None:
    assert SHIFTED.count(old) == 1
    with pytest.raises(SettingsError, match=message):
        topology_from_toml(SHIFTED.replace(old, new), "arm")


def test_single_joints_of_a_mapping_leave_out_means_of_several_joints() -> None:
    kinect, coco = topology("kinect_v2"), topology("coco_17")
    assert coco.single_joints("halpe_26") == {k: k for k in range(17)}
    mapping = coco.mappings["kinect_v2"]
    single = coco.single_joints("kinect_v2")
    assert set(single) == {joint for joint, weights in mapping.items() if list(weights.values()) == [1.0]}
    assert 0 < len(single) < len(mapping)
    assert all(mapping[joint] == {source: 1.0} for joint, source in single.items())
    assert kinect.single_joints("kinect_v2") == {joint: joint for joint in range(25)}
    assert kinect.single_joints("halpe_26") == {}
