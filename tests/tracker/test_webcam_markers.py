"""Colour markers on fingertips beside keypoints: they sharpen the tips, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_hands import arm_alone, errors_of, frames, seen_points
from support.webcam_people import run

from mocapella.errors import SettingsError
from mocapella.model.hand import TIPS
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.testing import check_tracker
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
FOUR = circle_of_cameras(4)
NAMES = WebcamsSettings().hands.marker_tips
KEYPOINTS, MARKERS = ("cam-0", "cam-1"), ("cam-2", "cam-3")
AT = arm_alone("right")


def keypoints(seconds: float, noise_px: float = 2.0) -> list[Arrival]:
    def seen(name: str, at_s: float) -> list[tuple[Float64, Float64]]:
        return [(AT(at_s), np.full(21, 0.9))] if name in KEYPOINTS else []

    everything = frames(FOUR, seen, seconds=seconds, of="hand", noise_px=noise_px)
    return [arrival for arrival in everything if arrival.frame.sensor in KEYPOINTS]


def markers(seconds: float, *, begin_s: float = 0.0, late_s: float = 0.006, noise_px: float = 0.3) -> Iterator[Arrival]:
    rng = np.random.default_rng(4)
    for k in range(round(seconds * 30)):
        at_s = k / 30 + late_s
        if at_s < begin_s:
            continue
        at_ns = round(1e9 * (1.0 + at_s))
        for name in MARKERS:
            px = seen_points(FOUR, name, AT(at_s)[list(TIPS)]) + rng.normal(size=(5, 2)) * noise_px
            size = FOUR.cameras[name].camera.size_px
            frame = marker_frame(name, NAMES, time_ns=at_ns, size_px=size, positions_px=px, sd_px=0.3, sequence=k)
            yield Arrival(frame, at_ns)


def both(*parts: list[Arrival]) -> list[Arrival]:
    return sorted((one for part in parts for one in part), key=lambda one: one.at_ns)


def tips_off(arrivals: list[Arrival]) -> float:
    """Median distance of the tips in the second second [m]."""
    scenes = [scene for scene in run(WebcamsTracker(FOUR), arrivals) if scene.sensor == "cam-1" and scene.hands]
    away = errors_of(scenes[30:], lambda at_s: {False: AT(at_s)})[False].reshape(-1, 21)
    return float(np.median(away[:, list(TIPS)]))


@pytest.mark.slow
def test_markers_bring_the_tips_nearer() -> None:
    plain, more = keypoints(2.0), list(markers(2.0))
    assert tips_off(both(plain, more)) < 0.6 * tips_off(plain)


@pytest.mark.slow
def test_a_tracker_with_markers_keeps_its_promises() -> None:
    scenes = check_tracker(lambda: WebcamsTracker(FOUR), both(keypoints(0.6), list(markers(0.6))))
    assert (scenes[-1].hands[0].states == JointState.TRACKED).any()


def test_markers_alone_begin_no_hand_and_their_cameras_count_as_sensors() -> None:
    tracker = WebcamsTracker(FOUR, sensors_expected=4)
    assert not any(scene.hands for scene in run(tracker, list(markers(0.4))))
    scenes = run(tracker, both(keypoints(1.0), list(markers(1.0, begin_s=0.45)))[40:])
    assert scenes[-1].state.sensors_missing == 0


def test_markers_far_from_the_hand_or_of_another_time_change_nothing() -> None:
    plain = keypoints(1.0)
    far = [msgspec.structs.replace(one, frame=shifted(one)) for one in markers(1.0)]
    delayed = both(plain, list(markers(1.0)))
    old = [Arrival(one.frame, one.at_ns - 100_000_000 * (one.frame.sensor in MARKERS)) for one in delayed]
    expected = run(WebcamsTracker(FOUR), plain)[-1].hands[0].landmarks
    for arrivals in (both(plain, far), old):
        tracker = WebcamsTracker(FOUR)
        found = [scene for scene in run(tracker, arrivals) if scene.sensor in KEYPOINTS][-1]
        np.testing.assert_array_equal(found.hands[0].landmarks, expected)


def shifted(arrival: Arrival) -> object:
    frame = arrival.frame
    return msgspec.structs.replace(frame, positions_px=frame.positions_px + np.float32(150.0))  # type: ignore[attr-defined]


def test_markers_that_cannot_be_used_are_rejected_with_the_remedy() -> None:
    (one, *_) = markers(0.1)
    changes = {
        "the rig has no camera": {"sensor": "cam-9"},
        "calibrate with this size": {"size_px": (320, 240)},
        "hands.marker_tips": {"names": ("a", "b", "c", "d", "e")},
    }
    for said, change in changes.items():
        tracker = WebcamsTracker(FOUR)
        tracker.update(msgspec.structs.replace(one, frame=msgspec.structs.replace(one.frame, **change)))
        assert any(said in problem for problem in tracker.report.rejected), said
    tracker = WebcamsTracker(None)
    tracker.update(one)
    assert any("give a rig" in problem for problem in tracker.report.rejected)


@pytest.mark.parametrize(
    ("name", "value"), [("marker_tips", ("red",)), ("marker_tips", ("red",) * 5), ("marker_sd_m", 0.0)]
)
def test_invalid_settings_of_markers_on_hands_are_refused(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=name):
        type(WebcamsSettings().hands)(**{name: value})  # type: ignore[arg-type]
