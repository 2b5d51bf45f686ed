"""Keypoints by OSC: what is decoded is what the scene has, and who left is told."""

from __future__ import annotations

import msgspec
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import Room

from mocapella.model.scene import Scene
from mocapella.schema.osc_messages import MOST_BYTES, osc_bundles, osc_message, osc_name
from mocapella.sources.osc import messages
from mocapella.streams.keypoint_osc import KeypointOsc

ROOM = Room(people=2, sensors=2, first_id=3)
VALUES = st.one_of(
    st.integers(-(2**31), 2**31 - 1),
    st.floats(width=32, allow_nan=False),
    st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9),
)


def scene_at(at_s: float = 1.0) -> Scene:
    made: Scene = ROOM.scene(at_s, ROOM.frames(at_s))
    return made


def decoded(datagrams: list[bytes]) -> dict[str, tuple[object, ...]]:
    return {one.address: one.arguments for data in datagrams for one in messages(data)}


@given(st.lists(st.lists(VALUES, max_size=4), max_size=9), st.integers(16, 200))
def test_messages_survive_bundles_of_any_size_in_their_order(values: list[list[object]], most: int) -> None:
    sent = [osc_message(f"/{k}", *own) for k, own in enumerate(values)]  # type: ignore[arg-type]
    bundles = list(osc_bundles(sent, most))
    read = [one for data in bundles for one in messages(data)]
    assert [(one.address, list(one.arguments)) for one in read] == [(f"/{k}", own) for k, own in enumerate(values)]
    for data in bundles:
        assert len(data) <= most or len(list(messages(data))) == 1


@given(st.text(max_size=12))
def test_a_name_is_one_part_of_an_address_whatever_it_is(text: str) -> None:
    name = osc_name(text)
    assert name.isascii()
    assert name.isprintable()
    assert not set(name) & set(" #*,/?[]{}")
    (read,) = messages(osc_message(f"/mocapella/people/{name}"))
    assert read.address.rsplit("/", 1)[1] == name


def test_every_tracked_joint_of_everybody_is_sent_with_its_state_and_uncertainty() -> None:
    scene = scene_at()
    bundles = KeypointOsc().datagrams(scene)
    assert max(map(len, bundles)) <= MOST_BYTES
    found = decoded(bundles)
    assert found["/mocapella/people"] == ("person_3", "person_4")
    for person in scene.people:
        for k, joint in enumerate(scene.topology.joints):
            address = f"/mocapella/people/person_{person.id}/{joint}"
            assert (address in found) == (person.states[k] > 0)
            if address in found:
                *place, state, sd = found[address]
                np.testing.assert_allclose(place, person.positions[k], atol=1e-6)  # type: ignore[arg-type]
                assert state == person.states[k]
                assert sd == -1.0 if person.sd is None else sd == np.float32(person.sd[k])


def test_who_left_is_no_longer_named_and_joints_that_are_not_tracked_are_not_sent() -> None:
    scene, stream = scene_at(), KeypointOsc()
    stream.datagrams(scene)
    first, second = scene.people
    states = first.states.copy()
    states[3] = 0
    left = scene.with_parts(people=(msgspec.structs.replace(first, states=states),))
    found = decoded(stream.datagrams(left))
    assert found["/mocapella/people"] == ("person_3",)
    assert not any(f"person_{second.id}" in address for address in found)
    assert f"/mocapella/people/person_3/{scene.topology.joints[3]}" not in found
    assert decoded(stream.datagrams(scene.with_parts(people=())))["/mocapella/people"] == ()


def test_only_named_individuals_are_sent() -> None:
    assert decoded(KeypointOsc(("person_4",)).datagrams(scene_at()))["/mocapella/people"] == ("person_4",)
