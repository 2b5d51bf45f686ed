"""The newest frames of a sensor's bodies: how many are kept, and how much room they take."""

from __future__ import annotations

import numpy as np

from mocapella.calibration.pair_memory import FRAMES_KEPT, BodyTrack, SensorTracks

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
