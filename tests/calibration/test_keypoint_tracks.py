"""Tracks of detections in one camera."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.calibration.keypoint_tracks import CameraTracks, as_halpe, at_instants, sizes_of, velocities_at
from mocapella.errors import CalibrationError
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology

HALPE = topology("halpe_26")
BODY = np.random.default_rng(0).uniform(0, 100, (26, 2))


def frame(
    number: int, shifts: list[float], ids: list[int] | None = None, size: tuple[int, int] = (640, 480)
) -> KeypointFrame:
    positions = np.array([np.array([shift, 0.0]) + BODY for shift in shifts]).reshape(-1, 26, 2)
    return keypoint_frame("a", HALPE, time_ns=number, size_px=size, positions_px=positions, ids=ids)


def test_two_people_keep_their_tracks_in_any_order_of_detections() -> None:
    tracks = CameraTracks("a", (640, 480))
    for k in range(30):
        people = [10.0 + k, 400.0 - k]
        tracks.update(frame(k, people if k % 2 else people[::-1]), k / 30)
    one, other = tracks.tracks()
    assert {round(float(t.pixels[0, :, 0].min() - BODY[:, 0].min())) for t in (one, other)} == {10, 400}
    assert len(one.at_s) == len(other.at_s) == 30
    assert np.abs(np.diff(one.pixels[:, 0, 0])).max() < 1.5


def test_the_ids_of_a_detector_decide_before_distances() -> None:
    tracks = CameraTracks("a", (640, 480))
    for k in range(20):
        tracks.update(frame(k, [0.0, 300.0] if k < 10 else [300.0, 0.0], ids=[7, 8]), k / 30)
    assert sorted(round(float(np.ptp(t.pixels[:, 0, 0]))) for t in tracks.tracks()) == [300, 300]


def test_another_image_size_is_refused() -> None:
    tracks = CameraTracks("a", (640, 480))
    with pytest.raises(CalibrationError, match="640×480 and 1280×720 px: film with one size"):
        tracks.update(frame(0, [0.0], size=(1280, 720)), 0.0)


def test_keypoints_of_a_hand_are_refused() -> None:
    hand = topology("hand")
    found = keypoint_frame(
        "a", hand, time_ns=1, size_px=(640, 480), positions_px=np.zeros((1, len(hand), 2)), confidences=1.0
    )
    with pytest.raises(CalibrationError, match="too few joints of halpe_26"):
        as_halpe(found)


def test_keypoints_are_linear_between_frames_and_unknown_outside() -> None:
    tracks = CameraTracks("a", (640, 480))
    for k in range(30):
        tracks.update(frame(k, [2.0 * k]), k / 30)
    (track,) = tracks.tracks()
    at_s = np.array([-0.1, 0.5 + 1 / 60, 2.0])
    (pixels, sizes), velocities = at_instants(track, at_s), velocities_at(track, at_s)
    assert np.isnan(pixels[[0, 2]]).all()
    np.testing.assert_allclose(pixels[1], np.array([31.0, 0.0]) + BODY, atol=1e-3)
    np.testing.assert_allclose(velocities[1], np.tile([60.0, 0.0], (26, 1)), atol=1e-2)
    assert sizes[1] == pytest.approx(sizes_of(BODY), rel=1e-5)


def test_forgotten_tracks_begin_later() -> None:
    tracks = CameraTracks("a", (640, 480))
    for k in range(60):
        tracks.update(frame(k, [1.0 * k]), k / 30)
    tracks.forget(1.0)
    (track,) = tracks.tracks()
    assert track.at_s[0] == tracks.first_s == 1.0
