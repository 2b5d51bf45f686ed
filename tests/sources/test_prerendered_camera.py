"""Images that are rendered beforehand: the scene's own, repeated without a jump, at any rate."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.open_pictures import open_pictures
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.sources.simulate.prerendered_camera import PrerenderedCamera
from mocapella.sources.simulate.rendered_camera import RenderedCamera

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


def test_the_images_have_the_controls_of_the_start_which_are_told_and_learnt_with() -> None:
    wanted = CameraControls(gain=1.0, saturation=0.9, contrast=1.1, brightness=4.0)
    camera = open_pictures("rendered:demo/left", CameraWishes(controls=wanted), seed=3, prerender=2)
    live = open_pictures("rendered:demo/left", CameraWishes(controls=wanted), seed=3)
    plain = open_pictures("rendered:demo/left", seed=3, prerender=2)
    assert isinstance(camera, PrerenderedCamera)
    assert isinstance(live, RenderedCamera)
    assert isinstance(plain, PrerenderedCamera)
    state = camera.open()
    assert state.controls == live.open().controls == camera.profile().controls
    assert {name: state.controls.values[name] for name in wanted.values} == wanted.values
    assert np.array_equal(camera.render(0.0), live.render(0.0))
    plain.open()
    assert not np.array_equal(camera.render(0.0), plain.render(0.0))


def test_a_control_that_the_camera_refuses_is_a_sentence_of_its_state() -> None:
    wanted = CameraControls(gain=999.0)
    camera = open_pictures("rendered:demo/left", CameraWishes(controls=wanted), seed=3, prerender=2)
    assert "gain cannot be set to 999" in " ".join(camera.open().problems)


@pytest.mark.parametrize("count", [1, 1001])
def test_too_few_or_too_many_are_refused(count: int) -> None:
    with pytest.raises(SettingsError, match=r"prerender is .*from 2 to 1000 images"):
        PrerenderedCamera(SCENE, "left", "rendered:demo/left", count)
