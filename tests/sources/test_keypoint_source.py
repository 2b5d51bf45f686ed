"""A simulated camera as a source: it goes on when its scene ends, and has a rig as calibrated."""

from __future__ import annotations

import dataclasses
from itertools import islice, takewhile

import msgspec
import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.sources.simulate.crowd import build_crowd, crowd_scene, crowd_settings
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypointCamera
from mocapella.sources.simulate.keypoint_source import LEAST_S, repeated, rig_of, shown_crowd, simulated_camera


def test_frames_go_on_after_the_end_of_the_scene() -> None:
    scene = crowd_scene("turning")
    camera, seconds = scene.cameras[0], scene.settings.seconds
    once = list(camera.frames())
    rows = list(islice(repeated(camera, seconds), len(once) + 3))
    assert [frame.sequence for _, frame in rows] == list(range(len(once) + 3))
    times = np.array([frame.time_ns for _, frame in rows])
    assert (np.diff(times) > 0).all()
    assert rows[len(once)][0] == pytest.approx(rows[0][0] + seconds, abs=1e-6)
    np.testing.assert_array_equal(rows[len(once)][1].positions_px, rows[0][1].positions_px)


@pytest.mark.parametrize("since_s", [0.0, 1.23, 5.01, 9.99, 13.4, 300.2])
def test_frames_since_a_time_are_those_that_are_due_then_and_later(since_s: float) -> None:
    seconds = 5.0
    camera = _of_seconds("free-running", seconds, 1)  # it loses frames
    assert 0 < camera.kept < len(camera._lost)
    if since_s < 20:
        every = takewhile(lambda row: row[0] < 25, repeated(camera, seconds))
        wanted = [row for row in every if row[0] >= since_s][:40]
    else:  # many rounds are as one round, later
        wanted = [row for row in islice(repeated(camera, seconds), 100) if row[0] >= since_s - 300][:40]
        rounds = 60
        wanted = [
            (due_s + 300, msgspec.structs.replace(frame, sequence=frame.sequence + rounds * camera.kept,
                                                  time_ns=frame.time_ns + 300 * NS_PER_S))
            for due_s, frame in wanted
        ]  # fmt: skip
    got = list(islice(repeated(camera, seconds, since_s), len(wanted)))
    assert [frame.sequence for _, frame in got] == [frame.sequence for _, frame in wanted]
    assert [frame.time_ns for _, frame in got] == [frame.time_ns for _, frame in wanted]
    for (_, one), (_, other) in zip(got, wanted, strict=True):
        np.testing.assert_array_equal(one.positions_px, other.positions_px)


def _of_seconds(name: str, seconds: float, index: int) -> SimulatedKeypointCamera:
    return build_crowd(dataclasses.replace(crowd_settings(name), seconds=seconds)).cameras[index]


def test_people_who_wander_do_so_for_long() -> None:
    assert shown_crowd("two-walk").settings.seconds >= LEAST_S
    assert shown_crowd("hug").settings.seconds == crowd_scene("hug").settings.seconds


@pytest.mark.parametrize("text", ["simulated:nowhere/c1", "simulated:two-walk", "simulated:hug/c7"])
def test_unknown_simulated_cameras_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=r"two-walk|c1"):
        simulated_camera(text)


def test_a_rig_has_covariances() -> None:
    rig = rig_of(crowd_scene("turning"))
    assert all(np.isfinite(placed.covariance).all() for placed in rig.cameras.values())
