"""A Linux driver's controls: their ranges, what is set and read back, and a device that refuses or is unplugged."""

from __future__ import annotations

import os
from dataclasses import replace

import cv2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import fake_v4l2
from support.fake_capture import FakeDevice
from support.fake_v4l2 import FakeV4l2

from mocapella.errors import SettingsError
from mocapella.model.camera_controls import ControlDescription
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes, set_camera
from mocapella.sources.capture_camera import CaptureCamera
from mocapella.sources.picture_source import ControlledSource, controls_of
from mocapella.sources.v4l2_controls import V4l2Controls, open_v4l2

OFF = {"exposure": False, "white_balance": False}


def opened(device: FakeV4l2) -> V4l2Controls:
    return V4l2Controls(os.open(os.devnull, os.O_RDWR), device.ioctl)


def by_name(controls: V4l2Controls) -> dict[str, ControlDescription]:
    return {control.name: control for control in controls.controls()}


def test_the_drivers_own_ranges_are_told() -> None:
    found = by_name(opened(FakeV4l2()))
    assert list(found) == ["exposure", "gain", "white_balance", "saturation", "contrast", "brightness"]
    told = ControlDescription("exposure", "100 µs", 1, 5000, 1, 156, 156, "exposure", True)
    assert found["exposure"] == told
    assert found["white_balance"] == ControlDescription(
        "white_balance", "K", 2800, 6500, 10, 4600, 4600, "white_balance", True
    )
    assert found["gain"].mode == ""  # this one has no automatic gain
    assert found["brightness"].least == -64


@given(st.integers(1, 5000), st.integers(0, 100), st.integers(2800, 6500))
def test_what_is_set_is_read_back_on_the_drivers_grid(exposure: int, gain: int, kelvin: int) -> None:
    controls = opened(FakeV4l2())
    assert controls.set_controls({"exposure": exposure, "gain": gain, "white_balance": kelvin}, OFF) == ()
    found = by_name(controls)
    assert (found["exposure"].value, found["gain"].value) == (exposure, gain)
    assert abs(found["white_balance"].value - kelvin) <= 5
    assert found["white_balance"].value % 10 == 0
    controls.close()


def test_an_automatic_mode_is_switched_as_the_drivers_menu_has_it() -> None:
    for modes, automatic in (((1, 3), 3), ((0, 1), 0)):
        device = FakeV4l2(modes=modes)
        controls = opened(device)
        for wanted in (False, True, False):
            assert controls.set_controls({}, {"exposure": wanted}) == ()
            assert by_name(controls)["exposure"].automatic is wanted
            assert device.controls[fake_v4l2.EXPOSURE_AUTO].value == (automatic if wanted else 1)


def test_a_request_that_is_refused_sets_nothing() -> None:
    controls = opened(FakeV4l2())
    before = controls.controls()
    for values, automatic, says in (
        ({"gain": 5.0, "exposure": 9999.0}, OFF, "from 1 to 5000"),
        ({"gain": 5.0, "zoom": 1.0}, {}, "no control 'zoom'"),
        ({"exposure": 5.0}, {}, "switch that off first"),
    ):
        with pytest.raises(SettingsError, match=says):
            controls.set_controls(values, automatic)
        assert controls.controls() == before


def test_what_a_driver_does_not_do_is_said() -> None:
    device = FakeV4l2()
    device.controls[fake_v4l2.GAIN].refuses = device.controls[fake_v4l2.AUTO_WHITE_BALANCE].refuses = True
    said = opened(device).set_controls({"gain": 5.0}, {"white_balance": False})
    assert said == ("automatic white balance cannot be switched off", "gain cannot be set to 5: it stays 10")


def test_controls_that_cannot_be_sliders_are_left_out_or_are_read_only() -> None:
    device = FakeV4l2()
    device.controls[fake_v4l2.GAIN].kind = fake_v4l2.MENU
    device.controls[fake_v4l2.CONTRAST].flags = fake_v4l2.DISABLED
    device.controls[fake_v4l2.SATURATION].flags = fake_v4l2.READ_ONLY
    device.controls[fake_v4l2.BRIGHTNESS].step = 0
    found = by_name(opened(device))
    assert set(found) == {"exposure", "white_balance", "saturation", "brightness"}
    assert found["saturation"].read_only
    assert found["brightness"].step == 1


def test_red_and_blue_share_their_automatic_mode_and_gain_can_have_one() -> None:
    device = FakeV4l2()
    device.controls |= {number: fake_v4l2.Control(0, 7999, 1, 1000, 1000) for number in
                        (fake_v4l2.RED_BALANCE, fake_v4l2.BLUE_BALANCE)}  # fmt: skip
    device.controls[fake_v4l2.AUTO_GAIN] = fake_v4l2.Control(0, 1, 1, 1, 1, fake_v4l2.BOOLEAN)
    controls = opened(device)
    assert controls_of(controls.controls()).automatic == ("exposure", "gain", "white_balance")
    assert controls.set_controls({"white_balance_red": 1500, "gain": 3}, {"white_balance": False, "gain": False}) == ()
    found = by_name(controls)
    assert (found["white_balance_red"].value, found["white_balance_blue"].automatic) == (1500, False)


def test_an_unplugged_device_has_no_controls_and_an_interrupted_call_is_repeated() -> None:
    device = FakeV4l2()
    controls = opened(device)
    found = controls.controls()
    assert len(found) == 6
    device.interrupted = 3
    assert controls.controls() == found
    device.plugged = False
    assert controls.controls() == ()
    controls.close()
    controls.close()
    device.plugged = True
    assert controls.controls() == ()


def test_a_missing_device_has_no_controls() -> None:
    assert open_v4l2(987) is None


def test_a_camera_that_comes_back_has_the_values_that_were_set_while_it_ran() -> None:
    driver, device = FakeV4l2(), FakeDevice()
    driver.controls[fake_v4l2.AUTO_GAIN] = fake_v4l2.Control(0, 1, 1, 1, 1, fake_v4l2.BOOLEAN)
    camera = CaptureCamera(0, "camera:0", open_capture=device.open, open_controls=lambda number: opened(driver))
    assert isinstance(camera, ControlledSource)
    assert camera.controls() == ()  # not open yet
    state = camera.open()
    assert state.controls.brightness == 0.0  # the driver's, which OpenCV could not tell from no control
    assert "gain" not in state.controls.automatic
    driver.controls[fake_v4l2.EXPOSURE_AUTO].value = 1
    assert camera.set_controls({"exposure": 321.0, "brightness": -1.0}, {}) == ()
    camera.close()
    assert camera.controls() == ()
    camera.open()
    assert device.values[cv2.CAP_PROP_EXPOSURE] == 321.0
    with pytest.raises(SettingsError, match="from 1 to 5000"):
        camera.set_controls({"exposure": 0.0}, {})
    camera.close()


@pytest.mark.parametrize(
    ("wanted", "says"), [((), "cannot be switched off: colours may drift"), (("gain",), "as saved")]
)
def test_a_gain_that_stays_automatic_is_told_once_and_its_value_is_not_set(wanted: tuple[str, ...], says: str) -> None:
    driver, device = FakeV4l2(), FakeDevice()
    driver.controls[fake_v4l2.AUTO_GAIN] = fake_v4l2.Control(0, 1, 1, 1, 1, fake_v4l2.BOOLEAN, refuses=True)
    wishes = CameraWishes(controls=CameraControls(gain=42.0, saturation=50.0, automatic=wanted))
    camera = CaptureCamera(0, "camera:0", wishes, open_capture=device.open, open_controls=lambda number: opened(driver))
    for _ in range(2):  # at the start, and when it comes back
        state = camera.open()
        said = [problem for problem in state.problems if "gain" in problem]
        assert len(said) == 1
        assert says in said[0]
        assert "gain" in state.controls.automatic
        assert (device.values[cv2.CAP_PROP_GAIN], device.values[cv2.CAP_PROP_SATURATION]) == (10.0, 50.0)
    with pytest.raises(SettingsError, match="switch that off first"):
        camera.set_controls({"gain": 42.0}, {})
    camera.close()


def test_an_automatic_gain_that_can_be_switched_off_is_and_the_value_is_set() -> None:
    driver, device = FakeV4l2(), FakeDevice()
    driver.controls[fake_v4l2.AUTO_GAIN] = fake_v4l2.Control(0, 1, 1, 1, 1, fake_v4l2.BOOLEAN)
    wishes = CameraWishes(controls=CameraControls(gain=42.0))
    camera = CaptureCamera(0, "camera:0", wishes, open_capture=device.open, open_controls=lambda number: opened(driver))
    assert not [problem for problem in camera.open().problems if "gain" in problem]
    assert device.values[cv2.CAP_PROP_GAIN] == 42.0
    camera.close()


@pytest.mark.parametrize(("target", "says"), [(0, "at its start"), ("http://it/", "at the camera")])
def test_without_a_driver_that_states_ranges_nothing_can_be_set(target: int | str, says: str) -> None:
    camera = CaptureCamera(target, str(target), open_capture=FakeDevice().open, open_controls=lambda number: None)
    camera.open()
    assert camera.controls() == ()
    with pytest.raises(SettingsError, match=says):
        camera.set_controls({"gain": 1.0}, {})


def test_modes_that_a_profile_has_on_are_left_on_with_a_word_and_their_values_are_not_set() -> None:
    device = FakeDevice(values={cv2.CAP_PROP_AUTO_EXPOSURE: 1.0})
    wanted = CameraControls(exposure=99.0, gain=7.0, automatic=("exposure",))
    state = set_camera(device.open(), CameraWishes(controls=wanted))
    assert state.controls.automatic == ("exposure",)
    assert state.problems == ("automatic exposure is on, as saved: colours may drift; switch it off in the view",)
    assert (device.values[cv2.CAP_PROP_EXPOSURE], device.values[cv2.CAP_PROP_GAIN]) == (156.0, 7.0)
    assert device.values[cv2.CAP_PROP_AUTO_WB] == 0.0
    again = set_camera(device.open(), CameraWishes(controls=replace(wanted, automatic=())))
    assert (again.controls.exposure, again.problems) == (99.0, ())
