"""A simulated camera as a source: it goes on when its scene ends, and has a rig as calibrated."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sources.simulate.crowd import crowd_scene
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
