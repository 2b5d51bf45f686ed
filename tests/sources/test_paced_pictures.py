"""Videos in real time: each frame at the video's own time, on a clock that passes only while somebody waits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.passing_time import PassingTime
from support.silhouette_pictures import write_video

from mocapella.sources import paced_pictures
from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.picture_source import Picture

COUNT = 5
BEGUN_S = 1000.0
DECODING_S = 0.002


def shown(path: Path, hz: float, works_s: float = 0.0) -> list[Picture]:
    """The pictures of a video of a rate, given to a reader who works for a while after each."""
    write_video(path, [np.full((48, 64, 3), 40 * k, np.uint8) for k in range(COUNT)], hz)
    time: Any = PassingTime(BEGUN_S)
    source = PacedPictures(path, clock=time.monotonic)
    source.open()
    source.begin(BEGUN_S)
    found = []
    while (picture := source.read(time)) is not None:
        found.append(picture)
        time.now_s += works_s
    source.close()
    return found


@pytest.mark.parametrize("hz", [10.0, 25.0, 60.0])
def test_frames_have_the_videos_own_times_and_come_at_them(tmp_path: Path, hz: float) -> None:
    found = shown(tmp_path / "a.avi", hz)
    due_s = np.arange(COUNT) / hz
    np.testing.assert_allclose([(one.time_ns - 1) / 1e9 for one in found], due_s, atol=1e-4)
    np.testing.assert_allclose([one.ready_s - BEGUN_S for one in found], due_s, atol=1e-4)


def test_overdue_frames_come_at_once_with_their_own_times(tmp_path: Path) -> None:
    found = shown(tmp_path / "a.avi", 25.0, works_s=0.5)
    np.testing.assert_allclose([(one.time_ns - 1) / 1e9 for one in found], np.arange(COUNT) / 25, atol=1e-4)
    np.testing.assert_allclose([one.ready_s - BEGUN_S for one in found], 0.5 * np.arange(COUNT), atol=1e-6)


class Stamped:
    """A video as OpenCV reads it, whose frames have these stamps [s]."""

    def __init__(self, stamps: Sequence[float], hz: float, time: Any) -> None:
        self._stamps, self._hz, self._at, self.time = stamps, hz, -1, time

    def get(self, prop: int) -> float:
        if prop == cv2.CAP_PROP_POS_MSEC:
            return 1e3 * self._stamps[self._at]
        return self._hz if prop == cv2.CAP_PROP_FPS else 8.0

    def grab(self) -> bool:
        self._at += 1
        return self._at < len(self._stamps)

    def retrieve(self) -> tuple[bool, np.ndarray]:
        self.time.now_s += DECODING_S
        return True, np.full((8, 8, 3), self._at % 256, np.uint8)

    def open(self, _path: str) -> None:
        self._at = -1

    def release(self) -> None:
        pass


def times(
    monkeypatch: pytest.MonkeyPatch, path: Path, stamps: Sequence[float], count: int, hz: float = 25.0, **how: Any
) -> list[float]:
    """The times of the first pictures of such a video [s]."""
    path.write_bytes(b"")
    time: Any = PassingTime(BEGUN_S)
    monkeypatch.setattr(paced_pictures, "open_video", lambda _path: Stamped(stamps, hz, time))
    source = PacedPictures(path, clock=time.monotonic, **how)
    source.open()
    source.begin(BEGUN_S)
    read = [source.read(time) for _ in range(count)]
    found = [picture for picture in read if picture is not None]
    assert [picture.retrieval_s for picture in found] == pytest.approx([DECODING_S] * len(found))
    return [(picture.time_ns - 1) / 1e9 for picture in found]


def test_stamps_at_uneven_intervals_are_kept_and_those_that_do_not_rise_are_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """After a stamp that does not rise, a frame is one period of the stated rate after the one before."""
    uneven = [5.0, 5.04, 5.05, 5.13, 5.131]
    found = times(monkeypatch, tmp_path / "a.avi", uneven, 9)
    np.testing.assert_allclose(found, np.array(uneven) - 5.0, atol=1e-6)
    found = times(monkeypatch, tmp_path / "a.avi", [*uneven, 5.131, 5.1, 5.25], 9)
    np.testing.assert_allclose(found, [0.0, 0.04, 0.05, 0.13, 0.131, 0.171, 0.211, 0.25], atol=1e-6)
    np.testing.assert_allclose(times(monkeypatch, tmp_path / "a.avi", [0.0] * 5, 9), np.arange(5) / 25, atol=1e-6)


@pytest.mark.parametrize("hz", [24000 / 1001, 25.0, 30.0, 50.0])
def test_no_two_frames_have_one_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hz: float) -> None:
    """Even if each stamp is there twice, at any time that rounding may move."""
    for step_s in (0.04, 1 / hz):
        stamps = np.repeat(step_s * np.arange(200), 2).tolist()
        found = times(monkeypatch, tmp_path / "a.avi", stamps, 400, hz=hz)
        assert (np.diff(found) > 1e-3).all()


def test_a_repeated_video_goes_on_a_period_after_its_last_frame(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    found = times(monkeypatch, tmp_path / "a.avi", [3.0, 3.02, 3.08], 7, loop=True)
    np.testing.assert_allclose(found, [0.0, 0.02, 0.08, 0.12, 0.14, 0.20, 0.24], atol=1e-6)


def test_at_a_wished_rate_stamps_do_not_count(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = times(monkeypatch, tmp_path / "a.avi", [3.0, 3.3, 3.31], 7, loop=True, fps=10.0)
    np.testing.assert_allclose(found, np.arange(7) / 10, atol=1e-6)
