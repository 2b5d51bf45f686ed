"""Cameras of different rooms: simulated crowds of which one camera sees another one; it is named with the remedy."""

from __future__ import annotations

import dataclasses
from functools import cache

import msgspec
import pytest

from mocapella.association.image_agreement import CONTRARY
from mocapella.library.people_report import PeopleComparison, PeopleReport, alarms
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.sources.simulate.crowd import CrowdScene, build_crowd, crowd_settings
from mocapella.tracker import make_tracker

pytestmark = pytest.mark.slow
SECONDS = 4.0


def crowd(cameras: int, seed: int) -> CrowdScene:
    settings = crowd_settings("two-walk")
    ring = dataclasses.replace(settings.ring, count=cameras)
    return build_crowd(dataclasses.replace(settings, seconds=SECONDS, ring=ring, seed=seed))


@cache
def tracked(cameras: int, *, another_room: bool) -> tuple[PeopleReport, tuple[Scene, ...]]:
    """Track two people who walk; the last camera sees other people, in another room, if ``another_room``."""
    here, there = crowd(cameras, 1), crowd(cameras, 8)
    last = list(here.rig.cameras)[-1]
    items = [item for item in here.frames() if item.frame.sensor != last]
    items += [item for item in (there if another_room else here).frames() if item.frame.sensor == last]
    items.sort(key=lambda item: (item.at_ns, item.frame.sensor))
    settings = {"rig": encode_camera_rig(here.calibrated)}
    tracker = make_tracker("webcams", sensors_expected=cameras, settings=settings)
    compared, scenes, frames = PeopleComparison(here.calibrated), list[Scene](), list[KeypointFrame]()
    numbers = dict.fromkeys(here.rig.cameras, 0)
    for item in items:
        name = item.frame.sensor
        frame = msgspec.structs.replace(item.frame, sequence=numbers[name])
        numbers[name] += 1
        scenes.append(tracker.update(Arrival(frame, item.at_ns)))
        frames.append(frame)
        if len(frames) == cameras:
            compared.add(frames, scenes[-1])
            frames = []
    return compared.report(), tuple(scenes)


@pytest.mark.parametrize("cameras", [2, 4])
def test_cameras_of_one_room_are_not_suspected(cameras: int) -> None:
    report, scenes = tracked(cameras, another_room=False)
    assert len(report.people) == 2
    assert alarms(report, films=True) == []
    assert all(camera.contrary_share < CONTRARY / 3 for camera in report.cameras.values())
    assert not any(place.problem for scene in scenes for place in scene.sensors)


def test_of_four_cameras_the_one_that_sees_another_room_is_named() -> None:
    report, scenes = tracked(4, another_room=True)
    (alarm,) = alarms(report, films=True)
    assert alarm.startswith("camera c4: ")
    assert "it sees another room" in alarm
    assert "leave it out, or calibrate it again" in alarm
    problems = {place.sensor: place.problem for place in scenes[-1].sensors if place.problem}
    assert list(problems) == ["c4"]
    assert "sees another room" in problems["c4"]
    assert "calibrate again" in problems["c4"]


def test_of_two_cameras_of_different_rooms_both_are_named() -> None:
    report, scenes = tracked(2, another_room=True)
    (alarm,) = alarms(report, films=True)
    assert "c1" in alarm
    assert "c2" in alarm
    assert "same room" in alarm
    problems = {place.sensor: place.problem for place in scenes[-1].sensors}
    said = [*problems.values(), *(scene.state.reason for scene in scenes)]
    assert any("another room" in text or "the same place" in text for text in said)
