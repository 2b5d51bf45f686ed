"""A rendered camera's controls act on its pictures as a sensor's do, and are set as its profile has them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.open_pictures import one_picture, open_pictures
from mocapella.sources.picture_source import ControlledSource
from mocapella.sources.simulate.camera_image import CameraImageSettings, camera_image
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.sources.simulate.rendered_camera import RenderedCamera
from mocapella.sources.simulate.rendered_controls import MIDDLE_GREY, RenderedControls

SCENE = load_hand_scene("demo", seed=3)
CLEAN = CameraImageSettings(lens_blur_px=0.0, photons=1e6, read_noise=0.0, bayer=False, shared_chroma=False, exposure=1)
ALL = ("exposure", "gain", "white_balance_red", "white_balance_blue", "saturation", "contrast", "brightness")


def camera(wanted: CameraControls | None = None) -> RenderedCamera:
    return RenderedCamera(SCENE, "left", "rendered:demo/left", wanted)


def picture(**values: float) -> np.ndarray:
    """(h, w, 3) of one instant, as floats."""
    made = camera()
    made.set_controls(values, {})
    return np.asarray(made.render(0.2)).astype(float)


def linear(image: np.ndarray) -> np.ndarray:
    coded = image / 255
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def test_it_has_all_of_a_sensors_controls_each_in_its_range() -> None:
    made = camera()
    assert isinstance(made, ControlledSource)
    found = made.controls()
    assert tuple(control.name for control in found) == ALL
    exposure = found[0]
    assert (exposure.unit, exposure.value, exposure.most) == ("100 µs", 60, 500)  # 6 ms; a frame's 50 ms at most
    assert all(control.accepted(control.default) == control.default for control in found)
    assert RenderedControls(made.camera).camera is made.camera


def test_the_defaults_change_no_bit_of_a_picture() -> None:
    plain = SCENE.at("left", 0.2).image
    made = camera()
    assert np.array_equal(made.render(0.2), plain)
    made.set_controls({"gain": 6.0, "contrast": 1.5}, {})
    assert not np.array_equal(made.render(0.2), plain)
    made.set_controls({control.name: control.default for control in made.controls()}, {})
    assert np.array_equal(made.render(0.2), plain)


def test_twice_the_exposure_and_six_decibels_are_twice_the_light() -> None:
    for doubled in (picture(exposure=60), picture(exposure=30, gain=6.0)):
        ratio = np.median(linear(doubled).mean(axis=-1) / np.maximum(linear(picture(exposure=30)).mean(axis=-1), 1e-4))
        assert 1.8 < ratio < 2.2


def test_gain_amplifies_noise_and_a_longer_exposure_does_not() -> None:
    grey = np.full((64, 64, 3), 0.05, np.float32)
    noisy = replace(CLEAN, photons=2000.0)

    def sd(settings: CameraImageSettings) -> float:
        return float(camera_image(grey, settings, np.random.default_rng(0)).astype(float).std())

    assert sd(replace(noisy, gain=4.0)) > 1.5 * sd(replace(noisy, exposure=4.0))


def test_red_blue_saturation_contrast_and_brightness_do_what_they_say() -> None:
    plain = picture()
    red, blue = picture(white_balance_red=1.5), picture(white_balance_blue=1.5)
    assert red[..., 2].mean() > plain[..., 2].mean() + 10
    assert blue[..., 0].mean() > plain[..., 0].mean() + 10
    grey = picture(saturation=0.0)
    assert np.abs(grey - grey.mean(axis=-1, keepdims=True)).max() <= 1.0
    assert picture(contrast=2.0).std() > 1.4 * plain.std()
    assert abs((picture(brightness=20) - plain).mean() - 20) < 2.0


def test_the_automatic_exposure_comes_to_a_middle_grey_and_the_white_balance_to_grey() -> None:
    made = camera()
    made.set_controls({"exposure": 5, "white_balance_red": 2.0}, {})
    assert made.set_controls({}, {"exposure": True, "white_balance": True}) == ()
    for _ in range(25):
        image = np.asarray(made.render(0.2)).astype(float)
    assert abs(image.mean() - MIDDLE_GREY) < 12
    blue, green, red = image.reshape(-1, 3).mean(axis=0)
    assert max(blue, green, red) - min(blue, green, red) < 8
    value = made.controls()[0].value
    with pytest.raises(SettingsError, match="switch that off first"):
        made.set_controls({"exposure": 60}, {})
    made.set_controls({}, {"exposure": False, "white_balance": False})
    made.render(0.2)
    assert made.controls()[0].value == value  # it stays where it was


def test_a_profiles_values_are_set_at_the_start_and_what_the_camera_lacks_is_said_not_fatal() -> None:
    values = {"exposure": 90.0, "gain": 900.0, "white_balance": 4600.0, "white_balance_red": 3.0, "brightness": 5.0}
    wanted = CameraControls(**values, automatic=("white_balance",))
    made = open_pictures("rendered:demo/left", CameraWishes(controls=wanted), seed=3)
    state = made.open()
    assert (state.controls.exposure, state.controls.brightness, state.controls.gain) == (90.0, 5.0, 0.0)
    assert state.controls.automatic == ("white_balance",)
    assert state.controls.white_balance_red != 3.0  # its mode sets it
    assert not any("white balance red" in problem for problem in state.problems)
    said = " | ".join(state.problems)
    assert "white balance cannot be set to 4600: there is no such control" in said
    assert r"gain cannot be set to 900: gain is 900.0; it must be from 0 to 24 (dB)" in said
    assert "automatic white balance is on, as saved" in said
    lacks = camera(CameraControls(white_balance=4600.0)).open().problems
    assert lacks == ("white balance cannot be set to 4600: there is no such control; learn the colours again",)


def test_one_picture_is_taken_with_the_wished_controls_too() -> None:
    dark, state = one_picture("rendered:demo/left", 4, CameraWishes(controls=CameraControls(exposure=10.0)), seed=3)
    plain, _ = one_picture("rendered:demo/left", 4, seed=3)
    assert dark.mean() < 0.7 * plain.mean()
    assert state.controls.exposure == 10.0


def test_colours_are_pointed_at_as_the_camera_is_set_and_the_profile_says_how() -> None:
    made = camera(CameraControls(exposure=90.0, gain=3.0))
    profile = made.profile()
    assert (profile.controls.exposure, profile.controls.gain) == (90.0, 3.0)
    assert profile.names == SCENE.names


class Halfway(dict[str, float]):
    """Values whose update stops after the first one until ``go`` is set."""

    def __init__(self, values: dict[str, float]) -> None:
        super().__init__(values)
        self.reached, self.go = threading.Event(), threading.Event()

    def update(self, wanted: dict[str, float]) -> None:  # type: ignore[override]
        for count, (name, value) in enumerate(wanted.items()):
            self[name] = value
            if count == 0:
                self.reached.set()
                assert self.go.wait(60)


class ToldLock:
    """A lock that calls ``held_up`` before a thread waits for it."""

    def __init__(self, held_up: Callable[[], None]) -> None:
        self._lock, self._held_up = threading.Lock(), held_up

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            self._held_up()
            assert self._lock.acquire(timeout=60)

    def __exit__(self, *error: object) -> None:
        self._lock.release()


@pytest.mark.parametrize(
    "read",
    [
        lambda made: (made.camera.exposure_s, made.camera.image.gain),
        lambda made: tuple(control.value for control in made.controls()),
    ],
    ids=["camera", "controls"],
)
def test_a_request_that_is_being_set_is_never_read_in_part(
    read: Callable[[RenderedControls], tuple[float, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    request = {"exposure": 30.0, "gain": 6.0}
    whole = RenderedControls(SCENE.cameras["left"])
    whole.set_controls(request, {})
    made, settled = RenderedControls(SCENE.cameras["left"]), threading.Event()
    values = Halfway(vars(made)["_values"])
    monkeypatch.setattr(made, "_values", values)
    monkeypatch.setattr(made, "_lock", ToldLock(settled.set))
    seen: list[tuple[float, ...]] = []

    def look() -> None:
        seen.append(read(made))
        settled.set()

    setter, reader = threading.Thread(target=made.set_controls, args=(request, {})), threading.Thread(target=look)
    setter.start()
    assert values.reached.wait(60)
    reader.start()
    assert settled.wait(60)  # the reader waits for the lock, or has read half of the request
    values.go.set()
    setter.join()
    reader.join()
    assert seen == [read(whole)]


@pytest.mark.parametrize("wrong", [{"gain": 0.5}, {"contrast": -1.0}, {"brightness": 300.0}])
def test_image_settings_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        CameraImageSettings(**wrong)
