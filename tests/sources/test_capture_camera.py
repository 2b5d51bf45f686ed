"""Cameras through OpenCV's interface: what is set, what is read back, and when a frame was captured."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fake_capture import NONE, FakeDevice

from mocapella.errors import InputError, SettingsError
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes, set_camera
from mocapella.sources.capture_camera import CaptureCamera
from mocapella.sources.open_pictures import open_pictures
from mocapella.sources.paced_pictures import PacedPictures

STOP = threading.Event()
WISHES = CameraWishes((320, 240), 60.0, "MJPG", CameraControls(100.0, 5.0, 5000.0, 80.0, 40.0))


def test_an_obedient_camera_is_set_as_wished_with_automatic_modes_off() -> None:
    device = FakeDevice()
    state = set_camera(device.open(), WISHES)
    assert state.problems == ()
    assert state.controls == CameraControls(100.0, 5.0, 5000.0, 80.0, 40.0)
    assert (state.size_px, state.fps) == ((320, 240), 60.0)
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0  # V4L2's manual
    assert device.values[cv2.CAP_PROP_AUTO_WB] == 0.0
    assert device.values[cv2.CAP_PROP_BUFFERSIZE] == 1


CONTROLS = {
    cv2.CAP_PROP_EXPOSURE: "exposure cannot be set to 100: it stays 156",
    cv2.CAP_PROP_GAIN: "gain cannot be set to 5: it stays 10",
    cv2.CAP_PROP_WB_TEMPERATURE: "white balance cannot be set to 5000: it stays 4600",
    cv2.CAP_PROP_SATURATION: "saturation cannot be set to 80: it stays 64",
    cv2.CAP_PROP_CONTRAST: "contrast cannot be set to 40: it stays 32",
    cv2.CAP_PROP_AUTO_EXPOSURE: "automatic exposure cannot be switched off",
    cv2.CAP_PROP_AUTO_WB: "automatic white balance cannot be switched off",
    cv2.CAP_PROP_FPS: "it reports 30 frames a second, not the requested 60",
    cv2.CAP_PROP_FOURCC: "it does not support the pixel format MJPG",
}


@given(st.sets(st.sampled_from(sorted(CONTROLS))))
def test_exactly_what_a_camera_refuses_is_stated(refused: set[int]) -> None:
    state = set_camera(FakeDevice(refuses=tuple(refused)).open(), WISHES)
    said = " | ".join(state.problems)
    for prop, words in CONTROLS.items():
        assert (words in said) == (prop in refused)
    automatic = {cv2.CAP_PROP_AUTO_EXPOSURE: "exposure", cv2.CAP_PROP_AUTO_WB: "white_balance"}
    assert state.controls.automatic == tuple(name for prop, name in automatic.items() if prop in refused)


def test_a_control_that_there_is_not_is_none_and_stated_where_it_was_wished() -> None:
    device = FakeDevice(values={cv2.CAP_PROP_GAIN: NONE}, refuses=(cv2.CAP_PROP_GAIN,))
    state = set_camera(device.open(), WISHES)
    assert state.controls.gain is None
    assert any("gain cannot be set to 5: there is no such control" in problem for problem in state.problems)
    assert set_camera(device.open(), CameraWishes()).problems == ()


def test_an_automatic_focus_that_stays_on_is_stated() -> None:
    device = FakeDevice(values={cv2.CAP_PROP_AUTOFOCUS: 1.0}, refuses=(cv2.CAP_PROP_AUTOFOCUS,))
    assert set_camera(device.open(), CameraWishes()).controls.automatic == ("focus",)


@pytest.mark.parametrize("wrong", [{"fps": 0.0}, {"size_px": (1, 5)}, {"fourcc": "MJPEG"}])
def test_wishes_that_no_camera_can_have_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        CameraWishes(**wrong)  # type: ignore[arg-type]


def taken(device: FakeDevice, clock: list[float]) -> tuple[CaptureCamera, list[int]]:
    ticks = iter(clock)
    camera = CaptureCamera(0, "camera:0", open_capture=device.open, clock=lambda: next(ticks))
    camera.open()
    times = []
    for _ in range(len(clock) // 2):  # each read looks at the clock when a frame came, and when it was decoded
        picture = camera.read(STOP)
        assert picture is not None
        times.append(picture.time_ns)
    return camera, times


def test_without_stamps_a_frame_was_captured_when_it_came() -> None:
    camera, times = taken(FakeDevice(), [10.0, 10.001, 10.1, 10.102])
    assert times == [10_000_000_000, 10_100_000_000]
    assert "when a frame was there" in camera.times


def test_stamps_of_the_driver_are_taken_where_they_are_on_our_clock() -> None:
    device = FakeDevice(stamps=0.02)
    camera = CaptureCamera(0, "camera:0", open_capture=device.open)
    camera.open()
    first, second = camera.read(STOP), camera.read(STOP)
    assert first is not None
    assert second is not None
    for picture in (first, second):
        lag_s = picture.ready_s - picture.retrieval_s - picture.time_ns / 1e9
        assert 0.02 <= lag_s < 0.45  # the device stamps 20 ms before it hands a frame out
    assert "driver" in camera.times


@pytest.mark.parametrize("stamps", [0.9, -0.5, 1e6])
def test_stamps_of_another_clock_are_not_believed(stamps: float) -> None:
    camera = CaptureCamera(0, "camera:0", open_capture=FakeDevice(stamps=stamps).open)
    camera.open()
    picture = camera.read(STOP)
    assert picture is not None
    assert picture.time_ns / 1e9 == pytest.approx(picture.ready_s - picture.retrieval_s, abs=1e-6)
    assert "when a frame was there" in camera.times


def test_times_rise_whatever_the_clock_does() -> None:
    _, times = taken(FakeDevice(), [5.0, 5.0, 5.0, 5.0, 4.0, 4.0])
    assert times[0] < times[1] < times[2]


def test_a_camera_that_is_not_there_names_it_and_says_what_to_do() -> None:
    device = FakeDevice()
    device.plugged = False
    with pytest.raises(InputError, match="camera:7: cannot be opened; see mocapella doctor"):
        CaptureCamera(7, "camera:7", open_capture=device.open).open()
    with pytest.raises(InputError, match="whether a browser or a player shows the stream"):
        CaptureCamera("http://127.0.0.1:9/", "http://127.0.0.1:9/", open_capture=device.open).open()


def test_what_a_user_writes_leads_to_its_source(tmp_path: Path) -> None:
    for text in ("camera:0", "/dev/video3", "http://127.0.0.1/stream", "rtsp://127.0.0.1/stream"):
        source = open_pictures(text)
        assert isinstance(source, CaptureCamera)
        assert source.live
    assert isinstance(open_pictures(str(tmp_path / "a.mp4")), PacedPictures)
    assert open_pictures("rendered:demo/left").name == "rendered:demo/left"
    for text, says in (
        ("camera:", "camera:0"),
        ("camera:-1", "camera:0"),
        ("rendered:demo", "rendered:demo/left"),
        ("rendered:demo/up", "known: left, right"),
        ("rendered:nowhere/left", "unknown scene"),
        ("", "no source"),
    ):
        with pytest.raises(SettingsError, match=says):
            open_pictures(text)
