"""Images that are rendered beforehand: the scene's own, repeated without a jump, at any rate."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.open_pictures import open_pictures
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.sources.simulate.prerendered_camera import PrerenderedCamera

SCENE = load_hand_scene("demo", seed=3)


def test_they_are_the_scenes_images_forwards_and_backwards() -> None:
    camera = PrerenderedCamera(SCENE, "right", "rendered:demo/right", 3, 50.0)  # it begins 25 ms late
    assert camera.open().fps == 50.0
    own = [SCENE.at("right", k / 50).image for k in range(3)]
    for turn, which in enumerate((0, 1, 2, 1, 0, 1, 2, 1)):
        assert np.array_equal(camera.render(0.025 + turn / 50), own[which])
    camera.render(0.025)[:] = 0  # a copy
    assert np.array_equal(camera.render(0.025), own[0])
    assert camera.controls() == ()
    with pytest.raises(SettingsError, match="leave the setting prerender out"):
        camera.set_controls({"exposure": 5.0}, {})


def test_it_keeps_a_rate_that_is_asked_for_and_colours_can_be_learnt_before() -> None:
    now_s = [0.0]
    camera = open_pictures("rendered:demo/left", CameraWishes(fps=90.0), seed=3, prerender=2)
    assert isinstance(camera, PrerenderedCamera)
    assert camera.profile().names == SCENE.names
    camera._clock = lambda: now_s[0]
    camera.open()
    camera.begin(0.0)
    times = []
    for _ in range(5):
        picture = camera.read(threading.Event())
        assert picture is not None
        times.append(picture.time_ns)
        now_s[0] += 1 / 90
    assert np.diff(times) == pytest.approx(1e9 / 90, abs=2)


@pytest.mark.parametrize("count", [1, 1001])
def test_too_few_or_too_many_are_refused(count: int) -> None:
    with pytest.raises(SettingsError, match=r"prerender is .*from 2 to 1000 images"):
        PrerenderedCamera(SCENE, "left", "rendered:demo/left", count)
