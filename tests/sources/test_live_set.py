"""Live cameras of a rig: what comes of them, and cameras that go, come back, fail or change."""

from __future__ import annotations

import threading
import time
from collections import deque
from functools import partial
from itertools import islice, pairwise
from typing import Any

import cv2
import numpy as np
import pytest
from support.fake_capture import FakeDevice, FilmWithoutRate
from support.programs import wait_until
from support.silhouette_pictures import ring, write_folders, write_video

import mocapella.sources.live_set as module
import mocapella.sources.open_pictures as opening
from mocapella.cli.silhouette_live import LiveWishes, open_live
from mocapella.errors import InputError, SettingsError
from mocapella.sources import paced_pictures
from mocapella.sources.acquisition import Acquisition, AcquisitionSettings
from mocapella.sources.capture_camera import CaptureCamera
from mocapella.sources.live_set import LiveSet
from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.picture_source import Picture, SourceState

SIZE = (64, 48)
RIG = ring(3, SIZE)
QUICK = AcquisitionSettings(retry_s=0.02, longest_retry_s=0.05, silent_s=0.2, close_s=0.2)
MANY = 100_000


def number(image):
    """Which picture of a `Scripted` camera it is, from 1."""
    return int(image[0, 0, 0]) + 256 * int(image[0, 0, 1])


class Scripted:
    """A camera whose pictures are there as soon as somebody reads, so many milliseconds apart by its own clock."""

    live, times = True, "a counter"

    def __init__(self, name="scripted", period_ms=20, fps=None, breaks_at=MANY):
        self.name, self.period_ms, self.fps, self.breaks_at = name, period_ms, fps, breaks_at
        self.count, self.closed = 0, False

    def open(self):
        return SourceState(SIZE, self.fps, problems=("gain cannot be set",) if self.fps else ())

    def begin(self, zero_s):
        pass

    def read(self, stop):
        stop.wait(0.001)
        if stop.is_set():
            return None
        if self.count >= self.breaks_at:
            raise InputError("is broken", file=self.name)
        self.count += 1
        image = np.full((SIZE[1], SIZE[0], 3), (self.count % 256, self.count // 256, 0), np.uint8)
        return Picture(image, self.count * self.period_ms * 1_000_000, self.count - 1, time.monotonic(), 0.0)

    def close(self):
        self.closed = True


def devices(count=2, fps=100.0, **how):
    return {f"c{k + 1}": FakeDevice(SIZE, fps=fps, **how) for k in range(count)}


def cameras(of):
    return {
        name: CaptureCamera(k, f"camera:{k}", open_capture=device.open) for k, (name, device) in enumerate(of.items())
    }


def test_frames_count_up_from_time_zero_and_every_picture_is_used_once():
    of = {"c2": Scripted("two"), "c1": Scripted("one")}
    with LiveSet(of, RIG) as live:
        assert list(live.rig.cameras) == ["c1", "c2"]
        assert live.rate_hz == 50.0  # as measured: nobody states it
        assert live.count is None
        assert live.described()["c1"] == {"source": "one", "size_px": [64, 48]}
        found = list(islice(live, 20))
        assert live.summary() == {"dropped": live.dropped}
        again = list(islice(live, 3))
    assert [one.frame for one in found] == list(range(20))
    assert found[0].time_ns == again[0].time_ns == again[0].frame == 0
    assert all(after.time_ns - before.time_ns >= 10_000_000 for before, after in pairwise(found))
    for name in of:
        numbers = [number(one.images[name]) for one in (*found, *again) if name in one.images]
        assert numbers == sorted(set(numbers))


def test_a_camera_is_measured_by_so_many_pictures_and_not_one_more(monkeypatch):
    taken, add = list[str](), LiveSet._add
    monkeypatch.setattr(LiveSet, "_add", lambda self, name, *rest: (taken.append(name), add(self, name, *rest)))
    with LiveSet({"c1": Scripted("one")}, RIG, clock=lambda: 0.0) as live:
        assert taken == ["c1"] * module.MEASURED
        assert live.rate_hz == 50.0


def test_who_is_slow_gets_the_newest_and_it_is_counted_what_was_dropped():
    of, stop = {"c1": Scripted(), "c2": Scripted()}, threading.Event()
    with LiveSet(of, RIG) as live:
        frames = live.until(stop)
        next(frames)
        counts = {name: source.count for name, source in of.items()}
        wait_until("many have come", lambda: all(of[name].count > counts[name] + 50 for name in of))
        late = next(frames)
        for name, image in late.images.items():
            assert number(image) > counts[name] + 50
            assert live.dropped[name] >= 48
        stop.set()
        assert list(frames) == []


def test_a_camera_that_is_pulled_out_is_missing_said_and_counts_again():
    of, said, stop = devices(3), list[str](), threading.Event()
    with LiveSet(cameras(of), RIG, settings=QUICK) as live:
        frames = live.until(stop, say=said.append)

        def comes(name):
            """Whether it is in one of the next frames."""
            return any(name in one.images for one in islice(frames, 10))

        assert comes("c2")
        of["c2"].plugged = False
        wait_until("it is missing", lambda: not comes("c2"))
        assert said[0].startswith("c2: camera:1: gives no picture any more (unplugged?)")
        of["c2"].plugged = True
        wait_until("it is there again", lambda: comes("c2"))
        assert said[-1] == "c2: camera:1: there again"
        # It is told once; on a busy machine the silence until then may be long enough to be told, too.
        assert len([line for line in said if "is it plugged in" not in line]) == 2
        stop.set()


def test_a_camera_that_fails_for_good_is_said_and_the_others_go_on_until_none_is_left():
    of, said = {"c1": Scripted("one", breaks_at=60), "c2": Scripted("two", breaks_at=150)}, list[str]()
    with LiveSet(of, RIG) as live:
        found = list(live.until(threading.Event(), say=said.append))
    assert found
    assert [line for line in said if "broken" in line] == [
        "c1: one: is broken; the others go on", "c2: two: is broken; the others go on",
    ]  # fmt: skip
    assert all(list(one.images) == ["c2"] for one in found[-3:])


def test_pictures_of_another_size_do_not_count_and_that_is_said_once():
    of, said, stop = devices(2), list[str](), threading.Event()
    with LiveSet(cameras(of), RIG, settings=QUICK) as live:
        frames = live.until(stop, say=said.append)
        next(frames)
        of["c1"].values[cv2.CAP_PROP_FRAME_WIDTH] = 32
        wait_until("it is missing", lambda: not any("c1" in one.images for one in islice(frames, 10)))
        assert all(one.images["c2"].shape == (48, 64, 3) for one in islice(frames, 10))
        assert said == [
            "c1: gives pictures of 32 × 48 px now, not of 64 × 48 px as at first: they are ignored; set the size "
            "back, or restart"
        ]
        of["c1"].values[cv2.CAP_PROP_FRAME_WIDTH] = 64
        wait_until("it counts again", lambda: any("c1" in one.images for one in islice(frames, 10)))
        stop.set()


def test_it_ends_when_it_is_told_even_if_no_picture_comes():
    of, stop = devices(1), threading.Event()
    with LiveSet(cameras(of), RIG, settings=QUICK) as live:
        of["c1"].plugged = False
        found, done = [], threading.Event()

        def loop():
            found.extend(live.until(stop))
            done.set()

        threading.Thread(target=loop, daemon=True).start()
        stop.set()
        assert done.wait(30.0)
        assert list(live.until(threading.Event(), 0.05)) == []  # nor after so many seconds


def test_a_rate_that_is_not_reached_is_said_once_and_problems_are_noted():
    said = list[str]()
    with LiveSet({"c1": Scripted(period_ms=100, fps=30.0)}, RIG) as live:
        assert live.notes == ["c1: gain cannot be set"]
        assert live.rate_hz == 10.0
        for _ in islice(live.until(threading.Event(), say=said.append), 60):
            pass
    assert [line for line in said if "10.0 frames a second, not 30" in line] == said
    assert len(said) == 1


def test_times_of_different_kinds_are_noted():
    one, other = devices(1), devices(1, stamps=0.005)
    with LiveSet(cameras({"c1": one["c1"], "c2": other["c1"]}), RIG, settings=QUICK) as live:
        (note,) = live.notes
    assert "times have different origins" in note
    assert "c1: the monotonic clock" in note
    assert "c2: the driver's stamps" in note


def test_a_camera_that_gives_nothing_at_first_is_refused_and_all_are_given_back(monkeypatch):
    monkeypatch.setattr(module, "FIRST_S", 0.3)
    of, silent = Scripted(), Scripted("silent")
    silent.read = lambda stop: stop.wait(30.0) and None
    with pytest.raises(InputError, match=r"silent: field c2: gives no picture; look whether it is plugged in"):
        LiveSet({"c1": of, "c2": silent}, RIG)
    assert of.closed
    assert silent.closed
    of, gone = Scripted(), devices(1)
    gone["c1"].plugged = False
    with pytest.raises(InputError, match="camera:0: cannot be opened"):
        LiveSet({"c1": of, "c2": cameras(gone)["c1"]}, RIG)
    assert of.closed


def test_what_cannot_be_used_together_is_named(tmp_path):
    write_folders(tmp_path, [{"c1": np.zeros((48, 64, 3), np.uint8)}])
    film = PacedPictures(tmp_path / "c1")
    with pytest.raises(InputError, match="no cameras are named"):
        LiveSet({}, RIG)
    with pytest.raises(SettingsError, match=r"c1=scripted is live, and c2=.*c1 is not"):
        LiveSet({"c1": Scripted(), "c2": film}, RIG)
    with pytest.raises(InputError, match=r"scripted: field camera: 'c9'.*the rig's are c1, c2, c3"):
        LiveSet({"c9": Scripted()}, RIG)
    with pytest.raises(SettingsError, match=r"other_size is 'crob'.*did you mean crop"):
        LiveSet({"c1": Scripted()}, RIG, other_size="crob")
    with pytest.raises(InputError, match=r"scripted: field size: \(64, 48\): has images of 64 × 48 px"):
        LiveSet({"c1": Scripted()}, ring(3, (80, 60)))
    with LiveSet({"c1": Scripted()}, ring(3, (80, 60)), other_size="scale") as live:
        assert live.rig.cameras["c1"].camera.size_px == SIZE
        assert "--set other_size=scale" in live.notes[0]


def test_films_begin_with_the_first_frame_and_end_together(tmp_path):
    shades = [np.full((48, 64, 3), 20 * k + 10, np.uint8) for k in range(6)]
    write_folders(tmp_path, [{"c1": one, "c2": one} for one in shades])
    sources = {name: PacedPictures(tmp_path / name, fps=20.0) for name in ("c1", "c2")}
    with LiveSet(sources, RIG) as live:
        assert live.rate_hz == 20.0
        found = list(live)
        assert list(live) == []  # they have ended
    assert {int(image[0, 0, 0]) for image in found[0].images.values()} == {10}
    for one in found:
        assert len({int(image[0, 0, 0]) for image in one.images.values()}) == 1  # of one instant


def test_films_are_started_once_by_whoever_follows_them_first(tmp_path, monkeypatch):
    write_folders(tmp_path, [{"c1": np.zeros((48, 64, 3), np.uint8)}])
    started, stop = [], threading.Event()
    monkeypatch.setattr(Acquisition, "start", lambda self, zero_s=None: started.append(zero_s))
    stop.set()
    with LiveSet({"c1": PacedPictures(tmp_path / "c1")}, RIG, clock=lambda: 5.0) as live:
        assert started == []
        for _ in range(2):
            assert list(live.until(stop)) == []
            assert started == [5.0]


def test_what_films_drop_while_they_are_started_is_counted(tmp_path, monkeypatch):
    shades = [np.full((48, 64, 3), 20 * k + 10, np.uint8) for k in range(6)]
    write_folders(tmp_path, [{"c1": one} for one in shades])
    start = Acquisition.start

    def start_on_a_busy_machine(self, zero_s=None):
        start(self, zero_s)
        wait_until("all pictures have come", lambda: self.report().taken == len(shades))

    monkeypatch.setattr(Acquisition, "start", start_on_a_busy_machine)
    with LiveSet({"c1": PacedPictures(tmp_path / "c1", fps=20.0)}, RIG) as live:
        found = list(live)
        assert [int(one.images["c1"][0, 0, 0]) for one in found] == [110]
        assert live.dropped == {"c1": len(shades) - 1}


def test_the_command_asks_cameras_for_the_calibrations_size_and_takes_what_is_expected(monkeypatch):
    for other_size, size in ((None, SIZE), ("scale", (128, 96))):
        device = FakeDevice((128, 96), fps=100.0)
        monkeypatch.setattr(opening, "CaptureCamera", partial(CaptureCamera, open_capture=device.open))
        with open_live(LiveWishes({"C1": "camera:0"}, hz=15.0, other_size=other_size, fourcc="MJPG"), RIG) as live:
            assert live.described() == {"c1": {"source": "camera:0", "size_px": list(size)}}
        assert device.values[cv2.CAP_PROP_FPS] == 15.0
        assert device.values[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter_fourcc(*"MJPG")


def test_of_films_without_a_rate_the_command_names_its_own_option(tmp_path, monkeypatch):
    write_video(tmp_path / "c1.avi", [np.full((48, 64, 3), 20 * k, np.uint8) for k in range(3)])
    monkeypatch.setattr(paced_pictures.cv2, "VideoCapture", FilmWithoutRate)
    with open_live(LiveWishes({"c1": str(tmp_path / "c1.avi")}, as_live=True), RIG) as live:
        assert live.notes == ["c1: does not state its frame rate; 30 Hz is assumed (--fps sets it)"]


class Clocked(Scripted):
    """A camera in real time that counts from when all begin; its pictures come late, and may be stamped so."""

    def __init__(self, begin_s, late_ms=0, stamped=True, period_ms=20):
        super().__init__("clocked", period_ms)
        self.begin_s, self.late_ms, self.stamped = begin_s, late_ms, stamped

    def read(self, stop):
        shown_ms = (self.count + 1) * self.period_ms
        if stop.wait(max(0.0, self.begin_s + (shown_ms + self.late_ms) / 1e3 - time.monotonic())):
            return None
        self.count += 1
        image = np.full((SIZE[1], SIZE[0], 3), (self.count % 256, self.count // 256, 0), np.uint8)
        stamp_s = self.begin_s + (shown_ms + (0 if self.stamped else self.late_ms)) / 1e3
        return Picture(image, round(1e9 * stamp_s), self.count - 1, time.monotonic(), 0.0)


def pairs(live, said, count=30, most=400):
    """By how many pictures the second camera's are behind the first's, of frames that have both; and how many had.

    Of the second half of ``count`` frames, or of as many later ones once nearly all have both: a busy machine is late.
    """
    newest = deque[Any](maxlen=count // 2)
    for k, one in enumerate(live.until(threading.Event(), say=said.append), start=1):
        newest.append(one.images)
        both = [images for images in newest if len(images) == 2]
        share = len(both) / len(newest)
        if k >= most or (k >= count and share > 0.8):
            return [number(images["c1"]) - number(images["c2"]) for images in both], share
    raise AssertionError("the cameras have ended")


@pytest.mark.parametrize("late_ms", [0, 120])
def test_a_camera_whose_stamped_pictures_come_late_is_waited_for_and_that_is_said(late_ms):
    begin_s, said = time.monotonic(), list[str]()
    of = {"c1": Clocked(begin_s), "c2": Clocked(begin_s, late_ms)}
    with LiveSet(of, RIG) as live:
        behind, share = pairs(live, said)
    assert share > 0.8
    assert abs(np.median(behind)) <= 1
    if not late_ms:
        assert said == []
    else:
        (line,) = said
        assert line.startswith("c2: its latency is 1")  # 120 ms, and what a busy machine takes
        assert "ms above the others', which wait for it" in line


def test_of_who_looks_seldom_frames_are_of_one_instant_too_where_a_camera_is_late():
    """Pictures that come while nobody looks are the very ones that the late camera's belong to."""
    begin_s = time.monotonic()
    of = {"c1": Clocked(begin_s), "c2": Clocked(begin_s, 130)}
    with LiveSet(of, RIG) as live:
        found = []
        for frame in islice(live.until(threading.Event()), 30):
            found.append(frame.images)
            time.sleep(0.085)  # more than four periods
    later = found[10:]
    assert sum(len(one) == 2 for one in later) > 0.3 * len(later)  # nearly all, but on a busy machine
    behind = [number(one["c1"]) - number(one["c2"]) for one in later if len(one) == 2]
    assert np.abs(behind).max() <= 1


def test_a_camera_that_is_said_to_be_late_is_put_right():
    for late_s, behind_by in ({}, 6), ({"C2": 0.12}, 0):
        begin_s, said = time.monotonic(), list[str]()
        of = {"c1": Clocked(begin_s), "C2": Clocked(begin_s, 120, stamped=False)}
        with LiveSet(of, RIG, late_s=late_s) as live:
            behind, share = pairs(live, said)
        assert share > 0.8
        assert abs(np.median(behind) - behind_by) <= 1


@pytest.mark.slow
def test_a_camera_that_is_too_late_for_any_frame_is_said():
    begin_s, said = time.monotonic(), list[str]()
    of = {"c1": Clocked(begin_s, period_ms=5), "c2": Clocked(begin_s, 700, period_ms=5)}
    with LiveSet(of, RIG) as live:
        frames = live.until(threading.Event(), say=said.append)
        for _ in islice(frames, 400):
            pass
    (line,) = said
    assert line.startswith("c2: no frame uses its images")
    assert "its latency is 7" in line
    assert "lower latency" in line


class Moving(Scripted):
    """Before it something goes to and fro as nobody foresees; it shows that so many milliseconds late."""

    def __init__(self, late_ms=0):
        super().__init__("moving")
        rng, at_s = np.random.default_rng(0), np.arange(0, 60, 0.02)
        self.speed = np.interp(at_s, np.arange(0, 61, 0.4), rng.uniform(0, 3, 153) * rng.integers(0, 2, 153))
        self.late = late_ms // 20

    def read(self, stop):
        picture = super().read(stop)
        if picture is not None:
            at = abs(int(np.cumsum(self.speed)[max(0, picture.number - self.late) % 3000]) % 80 - 40)
            picture.image[:] = 60
            picture.image[10:30, at : at + 20] = 200
        return picture


@pytest.mark.slow
@pytest.mark.parametrize("told_ms", [0, 100])
def test_what_moves_later_in_one_cameras_pictures_is_measured_and_the_option_named(monkeypatch, told_ms):
    monkeypatch.setattr(module, "LAGS_EVERY_S", 0.05)
    late_s = {"c2": told_ms / 1e3}
    of, said = {"c1": Moving(), "c2": Moving(100), "c3": Moving()}, list[str]()
    with LiveSet(of, RIG, late_s=late_s) as live:
        frames = live.until(threading.Event(), say=said.append)
        for _ in frames:
            if of["c1"].count > 900:
                break
    lags = [line for line in said if "motion appears" in line]
    if told_ms:
        assert lags == []
        assert max(live._lags.measure().values()) < 0.03
    else:
        (line,) = lags
        assert line.startswith("c2: motion appears ")
        assert abs(int(line.split("--set late=c2=")[1].split()[0]) - 100) <= 10
