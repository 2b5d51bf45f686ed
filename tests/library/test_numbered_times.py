"""Films whose frames have equal times are tracked with times that are as certain as their frame rate says."""

from __future__ import annotations

import math

import pytest
from support.webcam_people import circling, frames, walker

from mocapella.library.keypoint_tracking import _times_of
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_calibration import STAMP_SD_S, SelfCalibration
from mocapella.tracker.webcams_settings import WebcamsSettings, numbered_time_sd_s
from mocapella.tracker.webcams_warmup import circle_of_cameras

TWO = circle_of_cameras(2)


def test_numbered_frames_are_within_half_a_period_of_their_time() -> None:
    arrivals = frames(TWO, [lambda t: walker(t, circling(0.9, 5.0))], seconds=0.5)
    expected = 1 / 30 / math.sqrt(12)
    assert numbered_time_sd_s(30.0) == pytest.approx(expected)
    assert _times_of(arrivals)["time_sd_s"] == pytest.approx(expected, rel=1e-6)


def test_free_running_cameras_have_no_numbered_frames() -> None:
    arrivals = frames(TWO, [lambda t: walker(t, circling(0.9, 5.0))], seconds=0.5, offsets_s={"cam-1": 0.01})
    assert _times_of(arrivals) == {}
    assert _times_of(arrivals[:1]) == {}


def test_a_tracker_has_the_times_of_its_settings() -> None:
    tracker = WebcamsTracker(TWO, WebcamsSettings(time_sd_s=0.01))
    assert tracker._counts.late[:, 7] == pytest.approx([1e4, 1e4])


def test_a_calibration_without_a_rig_states_no_times() -> None:
    calibration = SelfCalibration(WebcamsSettings(), 2)
    assert all(math.isinf(sd) for sd in calibration.time_sds_s(["cam-0", "cam-1"]))
    assert 0.0 < STAMP_SD_S < 0.03
