from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.sources.video import Frames, LiveCameras, parse_frames, pictures, read_timestamps


@given(st.integers(0, 50), st.integers(0, 50), st.integers(1, 9))
def test_frames_are_those_of_a_range(first: int, end: int, step: int) -> None:
    chosen = parse_frames(f"{first}:{end}:{step}")
    assert [k for k in range(60) if chosen.wants(k)] == list(range(first, end, step))


def test_words_for_frames() -> None:
    assert parse_frames(None) == Frames()
    assert parse_frames("odd") == Frames(1, None, 2)
    assert parse_frames("even") == Frames(0, None, 2)
    assert parse_frames("5:") == Frames(5)
    for text in ("5", "a:b", "1:2:0", "-1:4"):
        with pytest.raises(SettingsError, match="write odd, even or FROM:TO:STEP"):
            parse_frames(text)


def gray(value: int) -> np.ndarray:
    return np.full((48, 64, 3), value, dtype=np.uint8)


def test_a_video_an_image_and_a_folder_give_their_pictures(tmp_path: Path) -> None:
    video = tmp_path / "a.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    for k in range(6):
        writer.write(gray(40 * k))
    writer.release()
    found = list(pictures(video, Frames(1, 6, 2)))
    assert [k for k, _ in found] == [1, 3, 5]
    assert [round(image.mean() / 40) for _, image in found] == [1, 3, 5]
    folder = tmp_path / "photos"
    folder.mkdir()
    for name, value in (("b.png", 20), ("a.png", 10), ("note.txt", 0)):
        if name.endswith("txt"):
            (folder / name).write_text("x")
        else:
            cv2.imwrite(str(folder / name), gray(value))
    assert [(k, int(image.mean())) for k, image in pictures(folder)] == [(0, 10), (1, 20)]
    assert [(k, int(image.mean())) for k, image in pictures(folder / "b.png")] == [(0, 20)]


def test_what_cannot_be_read_says_what_could(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no picture")
    (tmp_path / "a.mp4").write_bytes(b"no video")
    (tmp_path / "empty").mkdir()
    for name, says in (
        ("a.png", "is no image that can be read"),
        ("a.mp4", "is no video that can be read"),
        ("empty", "is a folder without images"),
        ("b.mp4", "is not there"),
        ("b.png", "is not there"),
    ):
        with pytest.raises(InputError, match=says):
            list(pictures(tmp_path / name))


class FakeCapture:
    """A camera whose picture is its number; ``fails`` says at which grabs it has none."""

    def __init__(self, number: int, fails: tuple[int, ...] = (), opened: bool = True) -> None:
        self.number, self.fails, self.opened = number, fails, opened
        self.grabs, self.released = 0, False

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's
        return self.opened

    def grab(self) -> bool:
        self.grabs += 1
        return self.grabs not in self.fails

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, gray(self.number)

    def release(self) -> None:
        self.released = True


def test_an_mp4_that_is_cut_off_is_said_to_be_no_whole_one(tmp_path: Path) -> None:
    whole = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48))
    for k in range(6):
        writer.write(gray(40 * k))
    writer.release()
    assert len(list(pictures(whole))) == 6
    data = whole.read_bytes()
    for size in (20, len(data) // 2):
        (tmp_path / "cut.mp4").write_bytes(data[:size])
        with pytest.raises(InputError, match=r"cut\.mp4: is an MP4 that ends before its index.*copy it again"):
            list(pictures(tmp_path / "cut.mp4"))
    (tmp_path / "empty.mp4").write_bytes(b"")
    with pytest.raises(InputError, match="is no video that can be read"):
        list(pictures(tmp_path / "empty.mp4"))


def test_live_cameras_are_read_together_and_losses_counted() -> None:
    made = {0: FakeCapture(0), 3: FakeCapture(3, fails=(2,))}
    ticks = iter(range(100))
    cameras = LiveCameras({"a": 0, "b": 3}, open_capture=made.__getitem__, clock=lambda: float(next(ticks)))
    first, second, third = (cameras.read() for _ in range(3))
    assert [(name, at, int(image.mean())) for name, (at, image) in first.items()] == [("a", 0.0, 0), ("b", 1.0, 3)]
    assert list(second) == ["a"]
    assert list(third) == ["a", "b"]
    assert cameras.lost == {"a": 0, "b": 1}
    cameras.close()
    assert all(capture.released for capture in made.values())


def test_a_camera_that_cannot_be_opened_gives_the_others_back() -> None:
    made = {0: FakeCapture(0), 1: FakeCapture(1, opened=False)}
    with pytest.raises(InputError, match="camera:1: cannot be opened"):
        LiveCameras({"a": 0, "b": 1}, open_capture=made.__getitem__)
    assert made[0].released


def test_times_of_numbered_and_of_unnumbered_frames(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    path.write_text("camera,frame,time_s\nleft,0,1.0\nleft,2,1.2\nright,0,1.01\nother,0,5\n")
    found = read_timestamps(path, ["left", "right"])
    np.testing.assert_array_equal(found["left"], [1.0, np.nan, 1.2])
    assert found["right"] == [1.01]
    path.write_text("sync_index,cam_id,frame_time\n35,1,25.2\n35,0,25.1\n36,1,25.0\n")
    assert read_timestamps(path, ["cam_0", "cam_1"]) == {"cam_0": [25.1], "cam_1": [25.0, 25.2]}


def test_a_file_of_times_that_cannot_be_used_says_why(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    with pytest.raises(InputError, match="cannot be read"):
        read_timestamps(path, ["a"])
    for text, says in (
        ("a,b\n1,2\n", "has no columns camera and time_s"),
        ("camera,time_s\na,x\n", "row 2"),
        ("camera,time_s\nb,1\n", "field camera: 'a': has no row"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=says):
            read_timestamps(path, ["a"])


def test_timestamps_of_a_far_frame_do_not_ask_for_a_long_list(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    path.write_text("camera,frame,time_s\na,0,0.1\na,999999999999,0.2\n")
    with pytest.raises(InputError, match="1000000000000 places would be needed"):
        read_timestamps(path, ["a"])


def test_a_video_of_huge_images_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "small.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (32, 16))
    writer.write(np.zeros((16, 32, 3), np.uint8))
    writer.release()
    assert len(list(pictures(path))) == 1
    monkeypatch.setattr("mocapella.sources.video.MOST_PX", 32 * 16 - 1)
    with pytest.raises(InputError, match=r"small\.avi: has images of 32 × 16 px; at most 511"):
        next(pictures(path))
    monkeypatch.setattr("cv2.VideoCapture", lambda _: (_ for _ in ()).throw(cv2.error("refused")))
    with pytest.raises(InputError, match="no video that can be read"):
        next(pictures(path))
