"""A Raspberry Pi's camera: when a picture was taken, what is set, and what is said where it does not work."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from support.fake_picamera2 import BOOT_S, FakePicamera2

from mocapella.errors import InputError, SettingsError
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.device_checks import pi_cameras
from mocapella.sources.open_pictures import is_live, open_pictures
from mocapella.sources.pi_camera import FPS, SETTLED, SIZE_PX, PiCamera, load_picamera2
from mocapella.sources.picture_source import ControlledSource, PictureSource

STOP = threading.Event()
LEARNT = CameraControls(exposure=5000.0, gain=2.0, white_balance_red=1.8, white_balance_blue=1.5, saturation=1.2)


def made(device: FakePicamera2, wishes: CameraWishes | None = None, timeout_s: float = 10.0) -> PiCamera:
    return PiCamera(
        0, "picamera:0", wishes, open_camera=lambda number: device, clock=lambda: device.now_s + 0.02,
        boot_clock=lambda: device.now_s + 0.02 + BOOT_S, timeout_s=timeout_s,
    )  # fmt: skip


def test_it_takes_pictures_of_the_thesis_size_at_its_rate() -> None:
    device = FakePicamera2()
    camera = made(device)
    assert isinstance(camera, ControlledSource)
    source: PictureSource = camera
    state = source.open()
    assert (state.size_px, state.fps) == (SIZE_PX, FPS) == ((640, 480), 90.0)
    assert device.configuration["controls"] == {"FrameDurationLimits": (11111, 11111)}
    first, second = camera.read(STOP), camera.read(STOP)
    assert first is not None
    assert second is not None
    assert (first.image.shape, first.image.dtype, first.image.flags.c_contiguous) == ((480, 640, 3), np.uint8, True)
    assert [first.number, second.number] == [0, 1]
    assert device.held == 0  # every buffer goes back
    camera.close()
    camera.close()
    assert device.closed
    assert camera.read(STOP) is None
    assert camera.controls() == ()


def test_a_picture_was_taken_in_the_middle_of_the_first_rows_exposure() -> None:
    device = FakePicamera2()
    camera = made(device, CameraWishes(controls=LEARNT))
    camera.open()
    picture = camera.read(STOP)
    assert picture is not None
    assert picture.time_ns == pytest.approx(1e9 * (device.now_s - 0.0025), abs=1e4)  # half of 5 ms before the readout


def test_times_rise_even_if_the_stamps_do_not() -> None:
    device = FakePicamera2()
    camera = made(device)
    camera.open()
    times = []
    for now_s in (6.0, 6.0, 5.0):
        device.now_s = now_s
        picture = camera.read(STOP)
        assert picture is not None
        times.append(picture.time_ns)
    assert times[0] < times[1] < times[2]


def test_without_wishes_the_automatic_modes_settle_and_are_switched_off() -> None:
    device = FakePicamera2()
    state = made(device).open()
    assert device.count == SETTLED
    assert state.problems == ()
    assert state.controls.automatic == ()
    assert (state.controls.exposure, state.controls.gain) == (8000.0, 4.0)
    assert (state.controls.white_balance_red, state.controls.white_balance_blue) == (2.1, 1.6)
    assert device.set == {
        "AeEnable": False, "AwbEnable": False, "ExposureTime": 8000, "AnalogueGain": 4.0, "ColourGains": (2.1, 1.6),
    }  # fmt: skip


def test_the_profiles_values_are_set_at_once_and_again_when_it_was_unplugged() -> None:
    device = FakePicamera2()
    camera = made(device, CameraWishes(controls=LEARNT))
    state = camera.open()
    assert device.count == 0  # nothing to settle
    assert state.controls.values == LEARNT.values | {"contrast": 1.0, "brightness": 0.0}
    assert device.set["ColourGains"] == (1.8, 1.5)
    camera.read(STOP)
    assert camera.controls()[0].value == 5000.0  # as set, although the sensor exposes for 7 µs less
    assert camera.set_controls({"white_balance_blue": 1.7, "brightness": 0.104}, {}) == ()
    assert (device.set["ColourGains"], device.set["Brightness"]) == ((1.8, 1.7), 0.1)
    device.plugged = False
    assert camera.read(STOP) is None
    device.plugged, device.set = True, {}
    camera.open()
    assert (device.set["ColourGains"], device.set["Brightness"]) == ((1.8, 1.7), 0.1)


def test_its_ranges_are_told_and_an_exposure_is_never_longer_than_a_frame() -> None:
    camera = made(FakePicamera2(), CameraWishes(fps=60.0))
    camera.open()
    found = {control.name: control for control in camera.controls()}
    assert (found["exposure"].least, found["exposure"].most, found["exposure"].unit) == (75, 16667, "µs")
    assert (found["gain"].most, found["gain"].mode, found["white_balance_red"].mode) == (
        10.666, "exposure", "white_balance",
    )  # fmt: skip
    with pytest.raises(SettingsError, match="from 75 to 16667"):
        camera.set_controls({"exposure": 20000.0}, {})


def test_an_automatic_mode_is_followed_and_its_values_stay_when_it_is_switched_off() -> None:
    device = FakePicamera2()
    camera = made(device, CameraWishes(controls=LEARNT))
    camera.open()
    assert camera.set_controls({}, {"exposure": True}) == ()
    assert "ExposureTime" not in {key for key in device.set if device.set[key] == 8000}
    camera.read(STOP)
    found = {control.name: control for control in camera.controls()}
    assert (found["exposure"].value, found["exposure"].automatic, found["white_balance_red"].automatic) == (
        8000.0, True, False,
    )  # fmt: skip
    camera.set_controls({}, {"exposure": False})
    assert (device.set["ExposureTime"], device.set["AnalogueGain"]) == (8000, 4.0)


@pytest.mark.parametrize("step", ["configure", "start", "capture_metadata"])
def test_a_camera_that_does_not_start_is_released_and_the_error_is_ours(step: str) -> None:
    class Broken(FakePicamera2):
        def stop(self) -> None:
            raise RuntimeError("not started")

    def fails(*_: Any, **__: Any) -> None:
        raise RuntimeError("Failed to allocate buffers.")

    device = Broken()
    setattr(device, step, fails)
    camera = made(device)
    with pytest.raises(InputError, match=r"cannot be started .*Failed to allocate buffers"):
        camera.open()
    assert device.closed
    assert camera.controls() == ()
    with pytest.raises(SettingsError, match="lost just now"):
        camera.set_controls({"gain": 2.0}, {})


def test_a_camera_that_stops_giving_images_is_closed_and_is_there_again_when_opened() -> None:
    device = FakePicamera2()
    camera = made(device, CameraWishes(controls=LEARNT), timeout_s=0.05)
    camera.open()
    assert camera.read(STOP) is not None
    device.silent = True
    assert camera.read(STOP) is None
    assert (device.closed, device.queued) == (True, 0)
    assert camera.read(STOP) is None
    device.silent = False
    camera.open()
    assert camera.read(STOP) is not None


def test_a_camera_that_gives_no_image_at_its_start_is_an_error_with_a_remedy() -> None:
    device = FakePicamera2()
    device.silent = True
    with pytest.raises(InputError, match=r"cannot be started \(no image within 0.05 s\); look at the cable"):
        made(device, timeout_s=0.05).open()
    assert device.closed


def test_a_long_frame_interval_is_awaited_longer() -> None:
    device = FakePicamera2()
    device.silent = True
    with pytest.raises(InputError, match=r"no image within 0.4 s"):
        made(device, CameraWishes(fps=5.0), timeout_s=0.05).open()


def test_a_libcamera_that_does_not_answer_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.sources.pi_camera._CLOSE_S", 0.05)

    class Stuck(FakePicamera2):
        def __getattribute__(self, name: str) -> Any:  # an older picamera2
            if name == "cancel_all_and_flush":
                raise AttributeError(name)
            return super().__getattribute__(name)

    device = Stuck()
    camera = made(device, CameraWishes(controls=LEARNT), timeout_s=0.05)
    camera.open()
    device.silent = True
    assert camera.read(STOP) is None  # and does not wait for the end of the stop
    assert not device.closed
    device.queued = 0
    device.stuck.set()


def test_a_camera_without_colour_has_fewer_controls_and_says_so() -> None:
    device = FakePicamera2(size=(632, 480))
    for name in ("ColourGains", "AwbEnable", "Saturation"):
        del device.camera_controls[name]
    state = made(device, CameraWishes(fourcc="MJPG", controls=LEARNT)).open()
    said = " | ".join(state.problems)
    for words in ("white balance red cannot be set to 1.8: there is no such control", "fourcc=MJPG has no effect",
                  "it gives 632 × 480 px, not 640 × 480"):  # fmt: skip
        assert words in said


def test_it_is_read_like_every_other_camera() -> None:
    device = FakePicamera2()
    with Acquisition(made(device, CameraWishes(controls=LEARNT))) as acquisition:
        acquisition.start()
        picture = acquisition.take(5.0)
    assert picture is not None
    assert device.closed


def test_its_name_is_picamera_and_a_number() -> None:
    assert is_live("picamera:0")
    assert open_pictures("picamera:1").name == "picamera:1"
    with pytest.raises(SettingsError, match="write picamera:0"):
        open_pictures("picamera:front")


class Broken(ModuleType):
    def __init__(self, error: Exception) -> None:
        super().__init__("picamera2")
        self._error = error

    def Picamera2(self, number: int) -> Any:  # noqa: N802 - the vendor's
        raise self._error


@pytest.mark.parametrize(
    ("module", "says"),
    [
        (None, "needs the package picamera2 .*docs/markers-rig.md"),
        (
            Broken(IndexError("list index out of range")),
            "cannot be opened .list index out of range.; look at the cable",
        ),
    ],
)
def test_what_is_missing_is_said_with_a_remedy(module: Any, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", module)
    with pytest.raises(InputError, match=f"picamera:3: {says}"):
        load_picamera2(3)


@pytest.mark.parametrize(("model", "count"), [(b"Raspberry Pi 4 Model B Rev 1.5\0", 1), (b"Other board\0", 0)])
def test_the_doctor_looks_for_its_package_on_a_raspberry_pi_only(tmp_path: Path, model: bytes, count: int) -> None:
    (tmp_path / "model").write_bytes(model)
    found = list(pi_cameras(tmp_path / "model"))
    assert len(found) == count
    assert list(pi_cameras(tmp_path / "none")) == []
