"""Every topology's bodies become bodies with the joints of people, by means that move rigidly with their joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.skeleton import SKELETON, JointMapping, mapping_problem, skeleton_mapping, to_skeleton
from mocapella.model.topology import Topology, topology, topology_names

MAPPED = [topology(name) for name in topology_names() if name not in {"hand", "kinect_v2"}]
seeds = st.integers(0, 2**32 - 1)


def mapping_of(kind: Topology) -> JointMapping:
    mapping = skeleton_mapping(kind.name)
    assert mapping is not None
    return mapping


def bodies_of(kind: Topology, seed: int, missing: float = 0.2) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Two bodies: (2, joints, 3) random positions, NaN where the state (2, joints) is 0."""
    rng = np.random.default_rng(seed)
    positions, states = rng.normal(size=(2, len(kind), 3)), rng.integers(1, 3, size=(2, len(kind)), dtype=np.uint8)
    states[rng.random(states.shape) < missing] = 0
    positions[states == 0] = np.nan
    return positions, states


@pytest.fixture(params=MAPPED, ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> Topology:
    return request.param  # type: ignore[no-any-return]


def test_every_topology_of_people_has_a_mapping() -> None:
    assert [name for name in topology_names() if mapping_problem(topology(name))] == ["hand"]


@given(st.sampled_from(MAPPED), seeds)
def test_mirrored_bodies_are_mapped_to_mirrored_people(kind: Topology, seed: int) -> None:
    positions, states = bodies_of(kind, seed)
    mapping, own, people = mapping_of(kind), list(kind.mirror), list(SKELETON.mirror)
    mirrored = mapping.positions(positions[:, own])
    np.testing.assert_allclose(mirrored, mapping.positions(positions)[:, people], atol=1e-12)
    np.testing.assert_array_equal(mapping.states(states[:, own]), mapping.states(states)[:, people])


@given(st.sampled_from(MAPPED), seeds, st.floats(-3, 3), st.floats(-1, 1))
def test_moved_bodies_are_mapped_to_moved_people(kind: Topology, seed: int, yaw: float, tilt: float) -> None:
    positions, mapping = bodies_of(kind, seed)[0], mapping_of(kind)
    T = rigid(rotation_about_y(yaw) @ rotation_about_x(tilt), (1.0, -2.0, 3.0))
    np.testing.assert_allclose(
        mapping.positions(apply(T, positions)), apply(T, mapping.positions(positions)), atol=1e-9
    )


@given(st.sampled_from(MAPPED), seeds)
def test_a_joint_is_as_sure_as_its_least_sure_contributor(kind: Topology, seed: int) -> None:
    positions, states = bodies_of(kind, seed)
    mapping = mapping_of(kind)
    mapped, found = mapping.positions(positions), mapping.states(states)
    for joint in range(len(SKELETON)):
        terms = list(kind.mappings[SKELETON.name].get(joint, {}))
        worst = states[:, terms].min(axis=1) if terms else np.zeros(2)
        np.testing.assert_array_equal(found[:, joint], worst)
        np.testing.assert_array_equal(np.isnan(mapped[:, joint]).all(axis=-1), worst == JointState.NOT_TRACKED)


def test_a_joint_at_the_position_of_another_is_that_to_the_bit(kind: Topology) -> None:
    positions = bodies_of(kind, 0, missing=0.0)[0]
    mapped = mapping_of(kind).positions(positions)
    same = {joint: next(iter(terms)) for joint, terms in kind.mappings[SKELETON.name].items() if len(terms) == 1}
    assert same
    np.testing.assert_array_equal(mapped[:, list(same)], positions[:, list(same.values())])


def test_what_is_a_skeleton_already_stays_the_same_object_and_what_cannot_be_one_is_refused() -> None:
    own = Bodies("a", SKELETON, (), np.empty((0, 25, 3)), np.empty((0, 25), np.uint8))
    assert to_skeleton(own) is own
    hand = topology("hand")
    with pytest.raises(ValueError, match="hand has no mapping to kinect_v2"):
        to_skeleton(Bodies("a", hand, (), np.empty((0, 21, 3)), np.empty((0, 21), np.uint8)))


def test_nobody_is_mapped_to_nobody(kind: Topology) -> None:
    nobody = Bodies("a", kind, (), np.empty((0, len(kind), 3)), np.empty((0, len(kind)), np.uint8))
    mapped = to_skeleton(nobody)
    assert (mapped.topology, mapped.positions.shape, mapped.states.shape) == (SKELETON, (0, 25, 3), (0, 25))
    assert (mapped.positions.dtype, mapped.states.dtype) == (np.float64, np.uint8)
