"""What is said of a camera that gives no picture, or always the same, on a clock that a test turns."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from support.passing_time import PassingTime

from mocapella.sources import acquisition
from mocapella.sources.acquisition import FROZEN_OF, Acquisition, AcquisitionSettings
from mocapella.sources.picture_source import Picture, SourceState

SILENT_S = 3.0


class Asked:
    """A source that gives the shades that are put into it."""

    name, times = "by hand", "a counter"

    def __init__(self, live: bool) -> None:
        self.live, self.shades, self.count = live, queue.Queue[int | None](), 0

    def open(self) -> SourceState:
        return SourceState((4, 2), None)

    def begin(self, zero_s: float) -> None:
        pass

    def read(self, stop: threading.Event) -> Picture | None:
        while not stop.is_set():
            try:
                shade = self.shades.get(timeout=0.02)
            except queue.Empty:
                continue
            if shade is None:
                return None
            self.count += 1
            return Picture(np.full((2, 4, 3), shade, np.uint8), self.count, self.count - 1, 0.0, 0.0)
        return None

    def close(self) -> None:
        pass


class Watched:
    """An acquisition of such a source, its clock, and what it said."""

    def __init__(self, time: PassingTime, live: bool) -> None:
        self.time, self.source, self.said = time, Asked(live), list[str]()
        self.pictures = Acquisition(self.source, AcquisitionSettings(silent_s=SILENT_S), say=self.said.append)

    def comes(self, shade: int) -> None:
        self.source.shades.put(shade)
        assert self.pictures.take(30.0) is not None

    def said_when_asked_at(self, now_s: float) -> list[str]:
        self.time.now_s = now_s
        assert self.pictures.take(0.0) is None
        return self.said


@contextmanager
def watched(monkeypatch: pytest.MonkeyPatch, *, live: bool = True) -> Iterator[Watched]:
    time: Any = PassingTime(1000.0)
    monkeypatch.setattr(acquisition, "time", time)
    made = Watched(time, live)
    with made.pictures:
        made.pictures.start()
        yield made


def test_a_camera_is_silent_when_more_than_the_limit_has_passed_and_is_said_to_be_so_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    says = "by hand: no picture for {} s; is it plugged in, or used elsewhere?"
    with watched(monkeypatch) as made:
        assert made.said_when_asked_at(1000.0 + SILENT_S) == []
        assert made.said_when_asked_at(1000.0 + SILENT_S + 1) == [says.format(4)]
        assert made.said_when_asked_at(1010.0) == [says.format(4)]
        made.time.now_s = 2000.0
        made.comes(1)
        assert made.said_when_asked_at(2000.0 + SILENT_S) == [says.format(4)]
        assert made.said_when_asked_at(2010.0) == [says.format(4), says.format(10)]


def test_a_video_is_never_silent_nor_frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    with watched(monkeypatch, live=False) as made:
        for k in range(2 * FROZEN_OF):
            made.time.now_s = 1000.0 + 10 * k
            made.comes(1)
        assert made.said_when_asked_at(5000.0) == []


def test_a_camera_is_frozen_when_enough_pictures_over_more_than_the_limit_are_equal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with watched(monkeypatch) as made:
        for k in range(FROZEN_OF - 1):
            made.time.now_s = 1000.0 + 10 * k
            made.comes(1)
        assert made.said == [], "so few may be equal by chance"
        made.comes(1)
        assert [line.partition(";")[0] for line in made.said] == [
            f"by hand: its picture has not changed for {10 * (FROZEN_OF - 2)} s"
        ]
        made.comes(1)
        assert len(made.said) == 1
        made.comes(2)
        assert made.said[1:] == ["by hand: its picture changes again"]
        begun_s = made.time.now_s
        made.time.now_s = begun_s + SILENT_S
        for _ in range(2 * FROZEN_OF):
            made.comes(2)
        assert len(made.said) == 2, "not longer than the limit"
        made.time.now_s += 1
        made.comes(2)
        assert len(made.said) == 3
