"""One picture of a source, by number."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.fake_capture import FakeDevice
from support.silhouette_pictures import write_video

from mocapella.errors import InputError
from mocapella.sources import open_pictures as opening
from mocapella.sources.capture_camera import CaptureCamera
from mocapella.sources.open_pictures import SETTLED, is_live, one_picture
from mocapella.sources.picture_source import SourceState
from mocapella.sources.simulate.hand_scene import load_hand_scene


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three images, darker to lighter, in the order of their names."""
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((4, 6, 3), 50 * k, np.uint8))
    return tmp_path


@pytest.mark.parametrize("wanted", [None, 0, 1, 2])
def test_the_picture_of_a_number_is_read_and_its_size_is_told(folder: Path, wanted: int | None) -> None:
    image, state = one_picture(str(folder), wanted)
    np.testing.assert_array_equal(image, 50 * (wanted or 0))
    assert state == SourceState((6, 4))


def test_a_frame_of_a_video_is_read_by_its_number(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", [np.full((48, 64, 3), 40 * k, np.uint8) for k in range(4)], 25.0)
    for wanted in range(4):
        image, state = one_picture(str(tmp_path / "a.avi"), wanted)
        assert image.mean() == pytest.approx(40 * wanted, abs=3)
        assert state == SourceState((64, 48))


def test_a_number_beyond_the_last_is_refused(folder: Path) -> None:
    for path, wanted in ((folder, 3), (folder / "1.png", 1)):
        with pytest.raises(InputError, match=f"{path.name}: field frame: {wanted}.*has no such picture"):
            one_picture(str(path), wanted)
    np.testing.assert_array_equal(one_picture(str(folder / "1.png"), 0)[0], 50)


def test_a_picture_of_a_scene_is_that_of_its_instant() -> None:
    scene = load_hand_scene("demo", seed=3)
    for wanted in (None, 2):
        image, state = one_picture("rendered:demo/left", wanted, seed=3)
        np.testing.assert_array_equal(image, scene.at("left", (wanted or 0) / 20).image)
        assert state.fps == 20.0


@pytest.mark.parametrize(("wanted", "read"), [(None, SETTLED + 1), (0, 1), (4, 5)])
def test_a_cameras_earlier_pictures_are_awaited(monkeypatch: pytest.MonkeyPatch, wanted: int | None, read: int) -> None:
    device = FakeDevice((32, 16))
    camera = CaptureCamera(0, "camera:0", open_capture=device.open)
    monkeypatch.setattr(opening, "open_pictures", lambda *_how, **_more: camera)
    opened = FakeDevice((32, 16))
    CaptureCamera(0, "camera:0", open_capture=opened.open).open()
    image, state = one_picture("camera:0", wanted)
    assert device.grabs == opened.grabs + read
    np.testing.assert_array_equal(image, device.grabs)
    assert (state.size_px, image.shape) == ((32, 16), (16, 32, 3))
    assert camera.read(opening.threading.Event()) is None, "it is closed"


def test_a_camera_that_gives_no_picture_is_told_and_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    device = FakeDevice()
    camera = CaptureCamera(0, "camera:0", open_capture=device.open)
    monkeypatch.setattr(opening, "open_pictures", lambda *_how, **_more: camera)
    monkeypatch.setattr(camera, "read", lambda _stop: None)
    with pytest.raises(InputError, match="camera:0: gives no picture"):
        one_picture("camera:0")


@pytest.mark.parametrize(
    ("text", "live"),
    [("camera:1", True), ("http://a/b", True), ("rtsp://a", True), ("rendered:demo/left", True), ("a.mp4", False)],
)
def test_cameras_streams_and_scenes_are_live(text: str, live: bool) -> None:
    assert is_live(text) is live
