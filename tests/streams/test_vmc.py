"""One person by VMC: the bones that a receiver poses are where the person's are, in Unity's axes."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.walkers import Room

from mocapella.model.humanoid_bones import BONES, HUMANOIDS, parent_of
from mocapella.model.humanoid_joints import INDEX, average_joints
from mocapella.model.scene import Scene
from mocapella.sources.osc import messages
from mocapella.streams.vmc import VmcPerformer

ROOM = Room(people=2, sensors=2, first_id=3)
PART_OF = {name: part for part, name in HUMANOIDS["unity"].items()}
FLIP = np.array([-1.0, 1.0, 1.0])


def scene_at(at_s: float = 1.0) -> Scene:
    made: Scene = ROOM.scene(at_s, ROOM.frames(at_s))
    return made


def alone(positions: Any, at_s: float = 1.0) -> Scene:
    """A scene with one person whose joints are all measured."""
    scene = scene_at(at_s)
    first = scene.people[0]
    states = np.full(len(positions), 2, np.uint8)
    return scene.with_parts(people=(msgspec.structs.replace(first, positions=positions, states=states),))


def received(performer: VmcPerformer, scene: Scene) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a receiver keeps of the one datagram: the bones, and the other messages."""
    (data,) = performer.datagrams(scene)
    bones, others = {}, {}
    for address, arguments in messages(data):
        if address == "/VMC/Ext/Bone/Pos":
            bones[arguments[0]] = np.array(arguments[1:])
        else:
            others[address] = arguments
    return bones, others


def posed(bones: dict[str, Any]) -> dict[str, tuple[Any, Rotation]]:
    """Place and rotation in Unity's space of each bone, as a receiver composes them from parent to child."""
    found: dict[str, tuple[Any, Rotation]] = {}
    for name, values in bones.items():
        parent = HUMANOIDS["unity"].get(parent_of("unity", PART_OF[name]), "")
        place, turn = found.get(parent, (np.zeros(3), Rotation.identity()))
        found[name] = place + turn.apply(values[:3]), turn * Rotation.from_quat(values[3:])
    return found


def test_a_person_at_rest_has_no_rotation_and_unitys_sides() -> None:
    bones, others = received(VmcPerformer(), alone(average_joints()[:25]))
    for name, values in bones.items():
        if PART_OF[name].split()[-1] not in {"hand", "foot", "neck", "head", "shoulder", "spine"}:
            np.testing.assert_allclose(np.abs(values[6]), 1.0, atol=0.02, err_msg=name)
    places = {name: place for name, (place, _) in posed(bones).items()}
    assert places["LeftHand"][0] < -0.4 < 0.4 < places["RightHand"][0]
    assert others["/VMC/Ext/OK"] == (1, 3, 0, 1)
    assert others["/VMC/Ext/Root/Pos"] == ("root", 0, 0, 0, 0, 0, 0, 1)


@pytest.mark.parametrize("at_s", [0.4, 1.0, 2.7])
def test_posed_bones_point_where_the_persons_do(at_s: float) -> None:
    scene = scene_at(at_s)
    person = scene.people[0]
    bones, _ = received(VmcPerformer(), scene)
    turned = posed(bones)
    for name in ("LeftUpperArm", "RightLowerArm", "LeftUpperLeg", "RightLowerLeg", "Neck"):
        bone = BONES[PART_OF[name]]
        real = person.positions[INDEX[bone.end]] - person.positions[INDEX[bone.joint]]
        if np.isfinite(real).all():
            shown = turned[name][1].apply(FLIP * bone.rest)
            np.testing.assert_allclose(shown, FLIP * real / np.linalg.norm(real), atol=1e-5, err_msg=name)


def test_the_hips_are_above_a_floor_below_the_lowest_joint() -> None:
    scene = scene_at()
    positions = scene.people[0].positions
    bones, _ = received(VmcPerformer(), scene)
    hips = positions[INDEX["SpineBase"]]
    np.testing.assert_allclose(bones["Hips"][[0, 2]], [-hips[0], hips[2]], atol=1e-5)
    assert bones["Hips"][1] == pytest.approx(hips[1] - np.nanmin(positions[:, 1]), abs=1e-5)


def test_bones_that_are_unknown_keep_their_rotation_and_who_leaves_is_not_tracked() -> None:
    performer, scene = VmcPerformer(), scene_at()
    before, _ = received(performer, scene)
    person = scene.people[0]
    positions = person.positions.copy()
    positions[[INDEX["ElbowLeft"], INDEX["WristLeft"]]] = np.nan
    hidden = scene.with_parts(people=(msgspec.structs.replace(person, positions=positions), scene.people[1]))
    bones, _ = received(performer, hidden)
    np.testing.assert_array_equal(bones["LeftUpperArm"][3:], before["LeftUpperArm"][3:])
    bones, others = received(performer, scene.with_parts(people=()))
    assert (bones, others["/VMC/Ext/OK"][3]) == ({}, 0)


def test_the_next_person_follows_when_the_first_leaves_unless_only_one_is_wanted() -> None:
    scene = scene_at()
    first, second = scene.people
    both, one = VmcPerformer(), VmcPerformer(("person_3",))
    for performer in (both, one):
        received(performer, scene)
    left = scene.with_parts(people=(second,))
    bones, _ = received(both, left)
    assert bones["Hips"][0] == pytest.approx(-second.positions[INDEX["SpineBase"], 0], abs=1e-5)
    assert received(one, left)[0] == {}
    again, _ = received(both, scene)  # it stays with the second
    np.testing.assert_allclose(again["Hips"], bones["Hips"], atol=1e-5)
    assert first.id == 3
