"""The method webcams uses the clock offsets of a given rig only with the setting `rig_clocks`."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.webcam_people import circling, frames, last_of_each, run, walker

from mocapella.model.camera import CameraRig
from mocapella.model.observations import Arrival
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras

LATE_S = 0.1
LATE = "cam-2"
THREE = circle_of_cameras(3)


def with_clock(late_s: float) -> CameraRig:
    """Return the rig with the clock of one camera ahead."""
    late = msgspec.structs.replace(THREE.cameras[LATE], clock_s=late_s)
    return CameraRig({**THREE.cameras, LATE: late})


def stamped(late_s: float, seconds: float = 2.0) -> list[Arrival]:
    """Return frames of a walker, with times of one camera that are later than its captures by its clock."""
    found = [
        Arrival(one.frame, one.at_ns + (round(1e9 * late_s) if one.frame.sensor == LATE else 0))
        for one in frames(THREE, [lambda t: walker(t, circling(0.9, 5.0))], seconds=seconds, noise=0.002)
    ]
    return sorted(found, key=lambda one: (one.at_ns, one.frame.sensor))


def error_m(rig: CameraRig, *, rig_clocks: bool) -> float:
    """Return the median error of the joints of the walker, whose cameras' times are taken as exact [m]."""
    settings = WebcamsSettings(time_sd_s=0.0, rig_clocks=rig_clocks)
    scenes = last_of_each(run(WebcamsTracker(rig, settings), stamped(LATE_S)))
    off = []
    for scene in scenes[len(scenes) // 2 :]:
        true = walker(scene.at_ns / 1e9 - 1.0, circling(0.9, 5.0))
        off += [np.nanmedian(np.linalg.norm(one.positions - true, axis=1)) for one in scene.people]
    assert off
    return float(np.median(off))


@pytest.mark.slow
def test_the_clocks_of_a_rig_take_away_the_error_of_a_late_camera() -> None:
    ignored, used = (error_m(with_clock(LATE_S), rig_clocks=of) for of in (False, True))
    assert ignored > 1.5 * used


def test_clocks_of_zero_change_nothing_and_clocks_are_ignored_without_the_setting() -> None:
    arrivals = stamped(0.0, 0.6)
    trackers = [
        WebcamsTracker(THREE),
        WebcamsTracker(THREE, WebcamsSettings(rig_clocks=True)),
        WebcamsTracker(with_clock(0.05)),
    ]
    first, *others = [[scene.people for scene in run(tracker, arrivals)] for tracker in trackers]
    assert any(first)
    for other in others:
        assert msgspec.msgpack.encode([len(of) for of in other]) == msgspec.msgpack.encode([len(of) for of in first])
        for one, two in zip(first, other, strict=True):
            for a, b in zip(one, two, strict=True):
                np.testing.assert_array_equal(a.positions, b.positions)
