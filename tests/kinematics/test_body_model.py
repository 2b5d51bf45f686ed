"""Body models are data; what is wrong in one is refused."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.kinematics.articulated_model import ArticulatedModel, memory_size
from mocapella.kinematics.body_model import body_model, body_model_from_toml, body_model_names
from mocapella.model.skeleton import SKELETON
from mocapella.model.topology import Topology, topology

KINECT = topology("kinect_v2")
TEXT = files("mocapella.kinematics").joinpath("models", "kinect_v2.toml").read_text(encoding="utf-8")


def test_the_skeleton_of_people_has_a_body_model_whose_sides_are_alike() -> None:
    assert body_model_names() == ("halpe_26", SKELETON.name)
    for name in body_model_names():
        body, tree = body_model(name), topology(name)
        assert {child for _, child in body.tree} == {child for _, child in tree.bones}
        model = ArticulatedModel.of(tree)
        assert memory_size(model) == model.layout[-1]
        for parent, child in body.tree:
            other = tree.mirror[child]
            np.testing.assert_allclose(np.array(body.bones[child].offset) * (1 if other == child else -1, 1, 1),
                                       body.bones[other].offset)  # fmt: skip
            assert model.joint_table[child, 0] == parent
            assert model.joint_table[child, 2] == model.joint_table[other, 2]
            assert model.joint_table[child, 4] == model.joint_table[other, 4]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (TEXT[TEXT.index("[bones.") :], "", "kinect_v2.*`bones`"),
        (TEXT[: TEXT.index("[bones.")], "", "kinect_v2.*`torso`"),
        ("[bones.Neck]", "[bones]\nNeck = 3\n[bones.Nick]", "kinect_v2.*bones"),
        ("torso = [", "speed = 3\ntorso = [", "speed"),
        ('"Neck", "ShoulderLeft", "ShoulderRight", "HipLeft", "HipRight"]', "]", "torso"),
        ('"ShoulderLeft", "ShoulderRight", "HipLeft"', '"ShoulderLeft", "HipLeft"', "torso"),
        ("[bones.Neck]", "[bones.Nick]", "Nick"),
        ("[bones.Neck]", "[bones.SpineBase]", "no bone Neck"),
        ('motion = "hand"', 'motion = "wing"', "wing"),
        ("offset = [0.0, 0.052, 0.0]", "offset = [0.0, 0.0, 0.0]", "offset"),
        ('axis = "x", limits_deg = [-50, 60]', 'axis = "w", limits_deg = [-50, 60]', "axis"),
        ("limits_deg = [-50, 60]", "limits_deg = [10, 60]", "limits_deg"),
        ("cone_deg = 120", "cone_deg = 0", "cone_deg"),
        ("twist_deg = [-130, 130]", "twist_deg = [-190, 130]", "twist_deg"),
        ("centre = [0.6, -0.2, 0.77]", "centre = [0, 0, 0]", "centre"),
        ("misfit_m = 0.03", "misfit_m = -1", "misfit_m"),
        ("misfit_m = 0.03", "misfits_m = 0.03", "misfits_m"),
        ("misfit_m = 0.03", "stiffness = -1", "stiffness"),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, says: str) -> None:
    assert old in TEXT
    with pytest.raises(SettingsError, match=says):
        body_model_from_toml(TEXT.replace(old, new), KINECT)


def test_a_bone_has_hinges_or_a_ball_and_three_hinges_at_most() -> None:
    ball = 'ball = { name = "b", centre = [1, 0, 0], cone_deg = 9, twist_deg = [-1, 1] }\n'
    with pytest.raises(SettingsError, match="ball"):
        body_model_from_toml(TEXT.replace("[bones.Neck]\n", f"[bones.Neck]\n{ball}"), KINECT)
    hinge = '{ name = "neck flexion", axis = "x", limits_deg = [-50, 60] },'
    with pytest.raises(SettingsError, match="hinges"):
        body_model_from_toml(TEXT.replace(hinge, 3 * hinge), KINECT)


def test_a_topology_without_a_body_model_is_refused() -> None:
    hand = Topology("hand", KINECT.joints, KINECT.bones, KINECT.mirror, KINECT.parts)
    with pytest.raises(SettingsError, match="kinect_v2"):
        ArticulatedModel.of(hand)


def test_a_heel_hangs_at_the_toe_of_its_own_side_and_so_turns_with_the_foot() -> None:
    halpe = topology("halpe_26")
    table = ArticulatedModel.of(halpe).joint_table
    for side in "LR":
        heel, toe, ankle = (halpe.index(f"{side}{name}") for name in ("Heel", "BigToe", "Ankle"))
        assert table[heel, 0] == toe
        assert table[toe, 0] == ankle
        assert table[heel, 2] == 0


def test_bones_that_reach_no_root_are_refused() -> None:
    with pytest.raises(SettingsError, match="hangs at no bone that reaches the root"):
        body_model_from_toml(TEXT.replace("[bones.WristLeft]\n", '[bones.WristLeft]\nparent = "HandLeft"\n'), KINECT)
    with pytest.raises(SettingsError, match="Nowhere"):
        body_model_from_toml(TEXT.replace("[bones.WristLeft]\n", '[bones.WristLeft]\nparent = "Nowhere"\n'), KINECT)


def test_a_root_bone_is_refused() -> None:
    with pytest.raises(SettingsError, match="root"):
        body_model_from_toml(TEXT + '[bones.SpineBase]\noffset = [0, 1, 0]\nmotion = "trunk"\n', KINECT)
