"""Webcams that calibrate themselves: from the first frame to people, in bounded steps, or untracked with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.keypoint_people import centre_of, filmed, ring, standing, walking

from mocapella.calibration.people_rig import PlacedByPeople, RigFromPeople
from mocapella.calibration.people_rig_live import WALK, LiveRigFromPeople, LiveRigSettings
from mocapella.calibration.stepwise import Steps, result_of
from mocapella.errors import SettingsError
from mocapella.evaluation.rig_from_people import pose_errors
from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.testing import check_tracker
from mocapella.tracker import METHODS
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_calibration import (
    REMEMBERED,
    SelfCalibration,
    in_world_of,
    largest_step_m,
    why_not,
)
from mocapella.tracker.webcams_settings import WebcamsSettings

QUICK = LiveRigSettings(first_s=5.0, instants=24, step_s=0.0, steps=6)
PATIENT = WebcamsSettings(calibration=QUICK, start_position_m=1.0, start_rotation_deg=5.0)


@cache
def two_walk(cameras: int = 3, seconds: float = 9.0) -> tuple[CameraRig, list[KeypointFrame]]:
    rig = ring(cameras, 0)
    people = walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65], 0)
    return rig, filmed(rig, people, seconds, seed=0, hz=12)


def arrivals(frames: Sequence[KeypointFrame]) -> list[Arrival]:
    return [Arrival(frame, frame.time_ns) for frame in frames]


def run(tracker: WebcamsTracker, frames: Sequence[KeypointFrame]) -> list[Scene]:
    return [tracker.update(one) for one in arrivals(frames)]


def last_untracked(frames: Sequence[KeypointFrame], cameras: int, settings: WebcamsSettings = PATIENT) -> Scene:
    """The last scene; no scene has people or a camera's pose."""
    tracker = WebcamsTracker(None, settings, sensors_expected=cameras)
    scenes = run(tracker, frames)
    assert not any(scene.people or scene.sensors for scene in scenes)
    assert tracker.report.calibrations == 0
    return scenes[-1]


@pytest.mark.slow
def test_cameras_calibrate_themselves_and_the_people_are_tracked() -> None:
    rig, frames = two_walk()
    tracker = WebcamsTracker(None, changed(PATIENT, height_m=1.7), sensors_expected=3)
    scenes = run(tracker, frames)
    assert scenes[0].state.phase == Phase.WAITING_FOR_SENSORS
    calibrating = [scene.state for scene in scenes if scene.state.phase == Phase.CALIBRATING]
    left = [state.frames_remaining for state in calibrating]
    assert left[0] > 0.9 * calibrating[0].frames_wanted
    assert all(later <= before for before, later in pairwise(left[: left.index(0)]))
    assert all(WALK in state.reason for state in calibrating)
    assert scenes[-1].state.phase == Phase.TRACKING
    assert len(scenes[-1].people) == 2
    assert tracker.report.calibrations >= 1
    _, direction = pose_errors(tracker.rig, rig)
    assert np.degrees(direction.max()) < 3.0
    for place in scenes[-1].sensors:
        assert place.position_sd >= 0.0
        assert "mm" in place.quality
        assert "guessed" not in place.quality


@pytest.mark.slow
def test_a_tracker_without_a_rig_keeps_the_promises_of_a_tracker() -> None:
    _, frames = two_walk(2, 7.5)
    settings = changed(PATIENT, calibration=LiveRigSettings(first_s=3.0, instants=12, step_s=0.0, steps=8, growth=1.0))
    scenes = check_tracker(lambda: WebcamsTracker(None, settings, sensors_expected=2), arrivals(frames))
    assert any(scene.sensors for scene in scenes)
    assert "scale guessed" in scenes[-1].sensors[0].quality


@pytest.mark.slow
def test_people_who_stand_still_are_not_tracked_and_are_told_to_walk() -> None:
    rig = ring(3, 5)
    reason = last_untracked(filmed(rig, standing(20), 8.5, hz=12), 3).state.reason
    assert "stayed within" in reason or "not determined" in reason
    assert WALK in reason


@pytest.mark.slow
def test_cameras_of_different_rooms_are_not_used() -> None:
    rig, here = two_walk(2)
    there = filmed(rig, walking(25, [(0.3, 0.9), (-0.2, -0.9)], [1.6, 1.8], 99), 9.0, seed=3, hz=12)
    mixed = [f for f in here if f.sensor == "cam1"] + [f for f in there if f.sensor == "cam2"]
    settings = changed(PATIENT, start_position_m=0.4, start_rotation_deg=2.0)
    reason = last_untracked(sorted(mixed, key=lambda f: f.time_ns), 2, settings).state.reason
    assert "see nobody in common" in reason or "different rooms" in reason or "another room" in reason


def test_one_camera_waits_for_another() -> None:
    _, frames = two_walk()
    state = last_untracked([f for f in frames if f.sensor == "cam1"], 2).state
    assert (state.phase, state.sensors_missing, state.reason) == (Phase.WAITING_FOR_SENSORS, 1, WALK)


def test_the_method_needs_no_rig_and_checks_what_is_stated() -> None:
    tracker = METHODS["webcams"].make({"height_m": 1.8}, 1, {})
    assert isinstance(tracker, WebcamsTracker)
    assert tracker.rig.cameras == {}
    for wrong in ({"height_m": 9.0}, {"start_position_m": 0.0}, {"start_rotation_deg": 90.0}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            WebcamsSettings(**wrong)
    for name in ("rate_hz", "step_s", "steps"):
        with pytest.raises(SettingsError, match=name):
            LiveRigSettings(**{name: -1})


def test_a_camera_that_comes_late_or_leaves_is_counted() -> None:
    _, frames = two_walk()
    live = LiveRigFromPeople(3, settings=QUICK)
    for frame in frames[:60]:
        live.update(frame, frame.time_ns / 1e9)
    assert live.cameras == 3
    some = [frame for frame in frames[60:] if frame.sensor != "cam3"]
    for frame in some:
        live.update(frame, frame.time_ns / 1e9)
    assert (live.cameras, live.rig()) == (2, None)
    assert live.problem.startswith("2 of 3 cameras are there")


@pytest.mark.slow
def test_an_estimate_goes_on_from_a_snapshot() -> None:
    _, frames = two_walk()
    settings = LiveRigSettings(first_s=2.5, instants=10, step_s=0.0)
    live, other = (LiveRigFromPeople(3, settings=settings) for _ in range(2))
    given_frames = iter(frames)
    while not (live.estimating and live.memory()["done"] > 2):
        frame = next(given_frames)
        live.update(frame, frame.time_ns / 1e9)
    other.recall(unpack(pack(live.memory(), REMEMBERED), REMEMBERED))
    for _, frame in zip(range(12), given_frames, strict=False):
        assert live.update(frame, frame.time_ns / 1e9) == other.update(frame, frame.time_ns / 1e9)
    assert pack(live.memory(), REMEMBERED) == pack(other.memory(), REMEMBERED)


def test_a_moved_camera_restarts_the_calibration_once() -> None:
    own = SelfCalibration(PATIENT, 2)
    own.begin_anew()
    own.begin_anew()
    assert own.restarts == 1
    own.reset()
    assert own.restarts == 0


def test_steps_give_the_result_at_their_end() -> None:
    def counting() -> Steps[int]:
        for _ in range(3):
            yield
        return 7

    assert result_of(counting()) == 7


@given(st.floats(-3.0, 3.0), st.tuples(*[st.floats(-5.0, 5.0)] * 2), st.floats(-0.3, 0.3))
def test_a_new_rig_is_moved_along_the_floor_only(turn: float, along: tuple[float, float], above: float) -> None:
    old = ring(3, 1)
    T = rigid(rotation_about_y(turn), (along[0], above, along[1]))
    new = CameraRig({
        name: msgspec.structs.replace(one, T_camera_world=one.T_camera_world @ inverse(T))
        for name, one in old.cameras.items()
    })  # fmt: skip
    fitted = in_world_of(new, old)
    for name, one in fitted.cameras.items():
        there = centre_of(old.cameras[name]) + np.array([0.0, above, 0.0])
        np.testing.assert_allclose(centre_of(one), there, atol=1e-9)
    assert largest_step_m(fitted, old) == pytest.approx(abs(above), abs=1e-9)


def test_rigs_without_two_common_cameras_are_not_aligned() -> None:
    old = ring(3, 1)
    one = CameraRig({"cam1": old.cameras["cam1"]})
    assert in_world_of(one, old) is one
    assert largest_step_m(CameraRig({}), old) == float("inf")


def changed(settings: WebcamsSettings, **changes: object) -> WebcamsSettings:
    return replace(settings, **changes)  # type: ignore[arg-type]


def estimated(cameras: int, position_sd_mm: float, focal_sd_percent: float) -> RigFromPeople:
    own = PlacedByPeople(1000, 3.0, position_sd_mm, 0.5, focal_sd_percent, 2.0, 0.0)
    names = [f"cam{k + 1}" for k in range(cameras)]
    return RigFromPeople(
        ring(cameras), dict.fromkeys(names, own), "guessed", 0.07, guessed=True, floor_known=True, up_sd_deg=1.0,
        people=2, instants=60, stature_m=1.7, extent_m=1.0, notes=[],
    )  # fmt: skip


def test_two_cameras_of_unknown_lenses_are_told_what_would_help() -> None:
    assert why_not(estimated(2, 300.0, 10.0), WebcamsSettings()) == ""
    reason = why_not(estimated(2, 600.0, 10.0), WebcamsSettings())
    assert reason.startswith("the cameras are known to ± 600 mm and 0.5°, and 400 mm and 2° are needed")
    assert "a third camera helps" in reason
    assert "calibration.same_lenses=true" in reason
    assert "third camera" not in why_not(estimated(2, 600.0, 0.0), WebcamsSettings())
    assert "third camera" not in why_not(estimated(3, 600.0, 10.0), WebcamsSettings())
    stated = WebcamsSettings(calibration=LiveRigSettings(same_lenses=True))
    assert "same_lenses" not in why_not(estimated(2, 600.0, 10.0), stated)
