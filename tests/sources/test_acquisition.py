"""Pictures in a thread of their own: the newest wins, a camera may go and come back, films keep real time."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.fake_capture import FakeDevice, FilmWithoutRate
from support.mjpeg_streams import MjpegStreams, jpeg
from support.programs import free_port, wait_until

from mocapella.errors import InputError, SettingsError
from mocapella.sources import paced_pictures
from mocapella.sources.acquisition import FROZEN_OF, Acquisition, AcquisitionReport, AcquisitionSettings
from mocapella.sources.capture_camera import CaptureCamera
from mocapella.sources.open_pictures import open_pictures
from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.sources.simulate.rendered_camera import RenderedCamera

QUICK = AcquisitionSettings(retry_s=0.02, longest_retry_s=0.05, silent_s=0.2, close_s=0.2)


class ByHand:
    """A source that gives a picture whenever somebody says so."""

    live, name, times = False, "by hand", "a counter"

    def __init__(self, fps: float | None = None) -> None:
        self.fps, self.count = fps, 0
        self._wanted, self._given = threading.Semaphore(0), threading.Semaphore(0)
        self.fails = False

    def open(self) -> SourceState:
        return SourceState((4, 2), self.fps)

    def begin(self, zero_s: float) -> None:
        self.zero_s = zero_s

    def give(self, count: int) -> None:
        """So many more; comes back when the thread asks for the next, so that all are in the slot or beyond."""
        for _ in range(count):
            self._wanted.release()
        for _ in range(count):
            assert self._given.acquire(timeout=30.0)

    def read(self, stop: threading.Event) -> Picture | None:
        if self.count:
            self._given.release()
        while not self._wanted.acquire(timeout=0.02):
            if stop.is_set():
                return None
        if self.fails:
            raise InputError("is broken", file=self.name)
        self.count += 1
        now_s = time.monotonic()
        return Picture(np.zeros((2, 4, 3), np.uint8), self.count * 100_000_000, self.count - 1, now_s, 0.0)

    def close(self) -> None:
        pass


def test_the_newest_wins_and_what_nobody_looked_at_is_counted() -> None:
    source = ByHand()
    with Acquisition(source) as pictures:
        pictures.start()
        source.give(1)
        first = pictures.take(30.0)
        source.give(5)
        second = pictures.take(30.0)
        assert first is not None
        assert second is not None
        assert (first.number, second.number) == (0, 5)
        assert pictures.take(0.01) is None
        report = pictures.report()
    assert (report.taken, report.dropped, report.lost) == (6, 4, 0)


def test_a_source_that_gives_fewer_frames_than_asked_is_said_to() -> None:
    for asked, few in ((10.0, False), (11.0, False), (12.0, True), (30.0, True), (None, False)):
        source = ByHand(fps=asked)
        with Acquisition(source) as pictures:
            pictures.start()
            source.give(10)
            assert pictures.report().too_few == ""  # too early to say
            source.give(30)
            report = pictures.report()
        assert report.fps == pytest.approx(10.0)
        assert bool(report.too_few) == few
    assert (
        "gives 10.0 frames a second, not 30; shorten the exposure"
        in AcquisitionReport(9, 0, 0, 10.0, 30.0, live=True).too_few
    )


def test_what_goes_wrong_in_the_thread_is_raised_where_pictures_are_taken() -> None:
    source = ByHand()
    with Acquisition(source) as pictures:
        pictures.start()
        source.fails = True
        source._wanted.release()
        wait_until("it has ended", lambda: pictures.ended)
        with pytest.raises(InputError, match="by hand: is broken"):
            pictures.take(0.3)


def test_sources_that_share_a_condition_are_waited_for_together() -> None:
    changed, one, other = threading.Condition(), ByHand(), ByHand()
    with Acquisition(one, changed=changed) as first, Acquisition(other, changed=changed) as second:
        first.start()
        second.start()
        for source, has in ((one, (True, False)), (other, (False, True))):
            source.give(1)
            with changed:
                assert changed.wait_for(lambda: first.ready or second.ready, 30.0)
            assert (first.ready, second.ready) == has
            assert (first.take(0.0) is not None, second.take(0.0) is not None) == has
        one.fails = True
        one._wanted.release()
        with changed:
            assert changed.wait_for(lambda: first.ready, 30.0)
        with pytest.raises(InputError, match="is broken"):
            first.take(0.0)
        assert not first.ready


def test_a_camera_that_is_pulled_out_is_looked_for_and_found_again() -> None:
    device, said = FakeDevice(fps=200), list[str]()
    with Acquisition(CaptureCamera(0, "camera:0", open_capture=device.open), QUICK, say=said.append) as pictures:
        pictures.start()
        before = pictures.take(30.0)
        device.plugged = False
        wait_until("it says so", lambda: any("looking again" in line for line in said))
        opened = device.opened
        wait_until("it looks", lambda: device.opened > opened + 2)
        assert not pictures.ended
        device.plugged = True
        wait_until("it is there again", lambda: "camera:0: there again" in said)
        after = pictures.take(30.0)
        assert before is not None
        assert after is not None
        assert after.time_ns > before.time_ns
        assert after.number > before.number
        assert pictures.report().lost == 1


def test_a_camera_that_hangs_is_said_to_and_holds_nobody_up() -> None:
    device, said = FakeDevice(fps=200), list[str]()
    pictures = Acquisition(CaptureCamera(0, "camera:0", open_capture=device.open), QUICK, say=said.append)
    pictures.start()
    assert pictures.take(30.0) is not None
    device.hangs.set()

    def silent() -> bool:
        pictures.take(0.05)
        return any("no picture for" in line for line in said)

    wait_until("it says so", silent)
    begin = time.monotonic()
    pictures.close()
    assert time.monotonic() - begin < 20.0  # the device hangs for 30 s
    assert sum("no picture for" in line for line in said) == 1


class Camera(ByHand):
    """A source that is a camera; its pictures have the shade that is set."""

    live, shade = True, 0

    def read(self, stop: threading.Event) -> Picture | None:
        picture = super().read(stop)
        if picture is not None:
            picture.image[:] = self.shade
        return picture


@pytest.mark.parametrize("live", [True, False])
def test_a_camera_whose_picture_does_not_change_is_said_to_be_frozen_once_until_it_changes(live: bool) -> None:
    source, said = Camera(), list[str]()
    source.live = live
    with Acquisition(source, AcquisitionSettings(silent_s=0.05), say=said.append) as pictures:
        pictures.start()
        source.give(FROZEN_OF - 1)
        time.sleep(0.1)
        assert said == []  # so few may be equal by chance
        source.give(3)
        assert [line.partition(" for ")[0] for line in said] == ["by hand: its picture has not changed"] * live
        source.shade = 9
        source.give(2)
        assert said[1:] == ["by hand: its picture changes again"] * live


def film(path: Path, frames: int = 8, fps: float = 50.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), fps, (64, 48))
    for k in range(frames):
        writer.write(np.full((48, 64, 3), 25 * k, np.uint8))
    writer.release()
    return path


def read_all(source: PacedPictures, count: int | None = None) -> list[Picture]:
    source.open()
    source.begin(time.monotonic())
    found: list[Picture] = []
    while (count is None or len(found) < count) and (picture := source.read(threading.Event())) is not None:
        found.append(picture)
    source.close()
    return found


def test_a_film_gives_each_frame_at_its_time_and_ends(tmp_path: Path) -> None:
    source = PacedPictures(film(tmp_path / "a.avi"))
    begin = time.monotonic()
    found = read_all(source)
    assert [round(p.image.mean() / 25) for p in found] == list(range(8))
    np.testing.assert_allclose([(p.time_ns - 1) / 1e9 for p in found], np.arange(8) / 50, atol=1e-6)
    assert all(p.ready_s >= begin + (p.time_ns - 1) / 1e9 for p in found)  # none before its time
    assert [p.number for p in found] == list(range(8))


def test_a_film_that_loops_goes_on_in_time(tmp_path: Path) -> None:
    found = read_all(PacedPictures(film(tmp_path / "a.avi", 4), loop=True), 11)
    assert [round(p.image.mean() / 25) for p in found] == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2]
    np.testing.assert_allclose(np.diff([p.time_ns for p in found]), 2e7, atol=1e3)
    faster = read_all(PacedPictures(tmp_path / "a.avi", fps=200.0, loop=True), 9)
    np.testing.assert_allclose(np.diff([p.time_ns for p in faster]), 5e6, atol=1e3)


def test_a_folder_is_shown_by_name(tmp_path: Path) -> None:
    for name, value in (("b.png", 2), ("a.png", 1), ("c.png", 3)):
        cv2.imwrite(str(tmp_path / name), np.full((4, 6, 3), value, np.uint8))
    found = read_all(PacedPictures(tmp_path, fps=100.0, loop=True), 5)
    assert [int(p.image.mean()) for p in found] == [1, 2, 3, 1, 2]
    np.testing.assert_allclose(np.diff([p.time_ns for p in found]), 1e7, atol=1e3)
    assert PacedPictures(tmp_path).open() == SourceState((6, 4), 30.0)
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.mp4").write_bytes(b"no film")
    for name, says in (("empty", "folder without images"), ("a.mp4", "no video"), ("b.mp4", "is not there")):
        with pytest.raises(InputError, match=says):
            PacedPictures(tmp_path / name).open()


def test_a_film_without_a_rate_names_the_commands_own_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film(tmp_path / "a.avi")
    monkeypatch.setattr(paced_pictures.cv2, "VideoCapture", FilmWithoutRate)
    for source, said in (
        (PacedPictures(tmp_path / "a.avi"), "30 Hz is assumed (--fps sets it)"),
        (open_pictures(str(tmp_path / "a.avi"), rate_option="--hz"), "30 Hz is assumed (--hz sets it)"),
    ):
        (problem,) = source.open().problems
        assert problem.endswith(said)
        source.close()
    assert PacedPictures(tmp_path / "a.avi", fps=20.0).open() == SourceState((64, 48), 20.0)


def test_an_acquisition_of_a_film_ends_with_its_last_picture(tmp_path: Path) -> None:
    with Acquisition(PacedPictures(film(tmp_path / "a.avi", fps=100.0))) as pictures:
        pictures.start()
        found = []
        while not pictures.ended:
            picture = pictures.take(0.05)
            found += [] if picture is None else [picture.number]
        report = pictures.report()
    assert found[-1] == 7
    assert report.taken == 8
    assert report.dropped == 8 - len(found)


def test_a_rendered_camera_shows_the_scene_at_its_own_time() -> None:
    scene = load_hand_scene("demo", seed=5)
    source = RenderedCamera(scene, "right", "rendered:demo/right")
    state = source.open()
    assert (state.size_px, state.fps) == ((320, 240), 20.0)
    source.begin(time.monotonic() - 7.0)
    first, second = (source.read(threading.Event()) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.time_ns > 7e9
    for picture in (first, second):
        at_s = (picture.time_ns - 1) / 1e9
        turns = (at_s - scene.cameras["right"].phase_s) * 20
        assert turns == pytest.approx(round(turns), abs=1e-6)
        np.testing.assert_array_equal(picture.image, scene.at("right", at_s).image)
    assert second.time_ns > first.time_ns
    with pytest.raises(SettingsError, match="known: left, right"):
        RenderedCamera(scene, "top", "rendered:demo/top")


@pytest.fixture
def streams() -> Iterator[MjpegStreams]:
    shades = [jpeg(np.full((48, 64, 3), 5 * k, np.uint8)) for k in range(40)]
    with MjpegStreams(lambda _name: iter(shades)) as server:
        yield server


def test_a_stream_of_the_network_is_shown_and_opened_again_when_it_ends(streams: MjpegStreams) -> None:
    said, stream = list[str](), streams.address("video")
    with Acquisition(CaptureCamera(stream, stream), QUICK, say=said.append) as pictures:
        pictures.start()
        found: list[Picture] = []

        def seen() -> bool:
            picture = pictures.take(0.5)
            if picture is not None:
                found.append(picture)
            return any("there again" in line for line in said)

        wait_until("it has ended and is there again", seen)
    assert streams.served["video"] >= 2
    assert len(found) > 5
    assert all(picture.image.shape == (48, 64, 3) for picture in found)
    assert all(a.time_ns < b.time_ns for a, b in pairwise(found))
    assert len({round(picture.image.mean()) for picture in found}) > 5


def test_a_stream_that_is_not_there_is_refused_at_once() -> None:
    address = f"http://127.0.0.1:{free_port()}/video"
    with pytest.raises(InputError, match=f"{address}: cannot be opened"):
        Acquisition(CaptureCamera(address, address))


@pytest.mark.parametrize("wrong", [{"retry_s": 0.0}, {"longest_retry_s": 0.1}, {"silent_s": 0.0}, {"close_s": -1.0}])
def test_settings_have_ranges(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        AcquisitionSettings(**wrong)


def test_more_than_the_newest_are_kept_where_that_is_wished(tmp_path: Path) -> None:
    with Acquisition(PacedPictures(film(tmp_path / "a.avi", 8, fps=200.0))) as pictures:
        pictures.keep(3)
        pictures.start()
        wait_until("all have come", lambda: pictures.report().taken == 8)
        wait_until("it has ended", lambda: pictures._ended)
        assert pictures.report().dropped == 5
        assert [one.number for one in pictures.take_all(0.0)] == [5, 6, 7]
        assert pictures.take_all(0.0) == []
        assert pictures.ended
    with Acquisition(PacedPictures(tmp_path / "a.avi", fps=200.0)) as pictures:
        pictures.keep(4)
        pictures.start()
        wait_until("all have come", lambda: pictures.report().taken == 8)
        pictures.keep(2)
        assert pictures.report().dropped == 6
        newest = pictures.take(0.0)
        assert newest is not None
        assert newest.number == 7
        assert pictures.report().dropped == 7
