"""The newest frames of a sensor's bodies: how many are kept, and how much room they take."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walking_people import KINECT_V2

from mocapella.calibration.pair_memory import FRAMES_KEPT, NO_LEGS, BodyTrack, SensorTracks, legs_of
from mocapella.model.anatomy import MOST_STRAY, THIGH_SHARE
from mocapella.model.topology import Topology, topology

STATES = np.full((1, 25), 2, np.uint8)


def test_a_track_without_frames_has_no_newest() -> None:
    assert BodyTrack.empty(25).newest == -np.inf


def test_each_body_keeps_its_newest_frames_in_order() -> None:
    tracks = SensorTracks.empty(25)
    for k in range(5 * FRAMES_KEPT):
        tracks.add(float(k), [7], np.full((1, 25, 3), 1.0 + k), STATES, 0.2)
        begin, end = tracks.bodies[7].held
        kept = tracks.bodies[7].times[begin:end]
        np.testing.assert_array_equal(kept, np.arange(max(0, k + 1 - FRAMES_KEPT), k + 1))
        assert tracks.bodies[7].newest == k


def test_room_is_made_only_where_there_is_none_and_is_used_again() -> None:
    tracks = SensorTracks.empty(25, slots=2)
    tracks.add(0.0, [1, 2], np.ones((2, 25, 3)), np.repeat(STATES, 2, axis=0), 0.2)
    assert len(tracks.ids) == 2
    tracks.add(1.0, [2], np.ones((1, 25, 3)), STATES, 0.2)
    tracks.forget_before(1.0)
    assert set(tracks.bodies) == {2}
    tracks.add(2.0, [3], np.ones((1, 25, 3)), STATES, 0.2)
    assert (len(tracks.ids), set(tracks.bodies)) == (2, {2, 3})
    tracks.add(3.0, [4], np.ones((1, 25, 3)), STATES, 0.2)
    assert set(tracks.bodies) == {2, 3, 4}
    assert len(tracks.ids) > 2
    assert [tracks.bodies[body].newest for body in (2, 3, 4)] == [1.0, 2.0, 3.0]


def test_bodies_that_come_again_under_their_old_ids_get_new_tracks() -> None:
    tracks = SensorTracks.empty(25)
    both, states = np.ones((2, 25, 3)), np.repeat(STATES, 2, axis=0)
    tracks.add(0.0, (1, 2), both, states, 0.2)
    tracks.clear()
    tracks.add(1.0, (3, 1), both, states, 0.2)
    tracks.add(2.0, (1, 2), both, states, 0.2)
    newest = {body: track.newest for body, track in tracks.bodies.items()}
    assert newest == {1: 2.0, 2: 2.0, 3: 1.0}
    assert len(set(tracks.slots.values())) == 3


LEGS = legs_of(KINECT_V2)


def body_with_knees(*shares: float, bend: float = 0.0, leg_m: float = 0.9) -> np.ndarray:
    """(25, 3) joints of a body whose thighs are these shares of its legs, with knees bent by an angle [rad]."""
    joints = np.tile([0.0, 1.0, 2.0], (len(KINECT_V2), 1))
    for (hip, knee, ankle), share in zip(LEGS, shares, strict=True):
        joints[knee] = joints[hip] - [0.0, share * leg_m, 0.0]
        joints[ankle] = joints[knee] - (1 - share) * leg_m * np.array([0.0, np.cos(bend), np.sin(bend)])
    return joints


def weights_of(joints: np.ndarray, legs: np.ndarray = LEGS) -> np.ndarray:
    """The weights of a body's joints, of which the head is inferred."""
    track, states = BodyTrack.empty(25), STATES[0].copy()
    states[KINECT_V2.index("Head")] = 1
    assert track.add(0.0, joints, states, 0.2, legs=legs)
    return track.weights[0]


@given(st.floats(0.1, 0.9), st.floats(0.1, 0.9), st.floats(0.0, 2.5))
def test_a_body_counts_as_inferred_only_where_both_its_knees_are_misplaced(
    left: float, right: float, bend: float
) -> None:
    weights = weights_of(body_with_knees(left, right, bend=bend))
    wrong = min(abs(share - THIGH_SHARE) for share in (left, right)) > MOST_STRAY
    assert weights[KINECT_V2.index("Head")] == 0.2
    assert set(np.delete(weights, KINECT_V2.index("Head"))) == {0.2 if wrong else 1.0}


def test_a_knee_that_is_not_seen_and_a_topology_without_legs_are_no_fault() -> None:
    seen = body_with_knees(0.2, 0.2)
    assert weights_of(seen, NO_LEGS).max() == 1.0
    seen[LEGS[0, 1]] = np.nan
    assert weights_of(seen).max() == 1.0
    seen[LEGS] = [0.0, 1.0, 2.0]  # legs without a length
    assert weights_of(seen).max() == 1.0


@pytest.mark.parametrize(("of", "legs"), [(KINECT_V2, 2), (topology("azure_kinect"), 0), (topology("halpe_26"), 0)])
def test_legs_are_found_by_the_names_of_a_kinect_v2(of: Topology, legs: int) -> None:
    assert len(legs_of(of)) == legs
