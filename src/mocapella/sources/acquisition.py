"""Read an image source in its own thread, so that slow processing never delays the camera.

A single slot holds the newest image. A reader that synchronises several cameras may ask to keep more images.
"""

from __future__ import annotations

import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Final

from mocapella.conventions import NS_PER_S
from mocapella.errors import MocapellaError, SettingsError
from mocapella.settings import check
from mocapella.sources.picture_source import Picture, PictureSource, SourceState

RATE_OVER_S: Final = 3.0
RATE_OF: Final = 10
"""The frame rate is measured over `RATE_OVER_S` seconds or `RATE_OF` images, whichever is longer."""
TOO_FEW: Final = 0.9
"""A source whose frame rate is below this fraction of its nominal rate is reported as too slow."""
FROZEN_OF: Final = 10
"""Least number of equal images in a row after which a camera is reported as frozen: noise makes images differ."""
_EVERY_PX: Final = 4


@dataclass(frozen=True)
class AcquisitionSettings:
    """Timing of the acquisition.

    Attributes:
        retry_s, longest_retry_s: first and longest wait before a lost camera is reopened [s]; the wait doubles each
            time.
        silent_s: time without an image after which a camera is reported as silent; also, time for which its images must
            have been equal before it is reported as frozen [s].
        close_s: longest wait for the thread to end when the acquisition is closed [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    retry_s: float = 0.5
    longest_retry_s: float = 5.0
    silent_s: float = 3.0
    close_s: float = 1.0

    def __post_init__(self) -> None:
        check(0 < self.retry_s <= 60, "retry_s", self.retry_s, "above 0, at most 60 s")
        check(self.retry_s <= self.longest_retry_s <= 600, "longest_retry_s", self.longest_retry_s, "retry_s to 600 s")
        check(0 < self.silent_s <= 600, "silent_s", self.silent_s, "above 0, at most 600 s")
        check(0 <= self.close_s <= 60, "close_s", self.close_s, "from 0 to 60 s")


@dataclass(frozen=True)
class AcquisitionReport:
    """Counts and rate of an acquisition.

    Attributes:
        taken: number of images received from the source.
        dropped: number of these images that a newer one replaced before the caller took them.
        lost: number of times that the camera was lost.
        fps: measured frame rate of the last seconds, by the capture times [Hz]; 0 while unknown.
        asked_fps: requested or stated frame rate [Hz]; None if unknown.
        live: whether the source is a camera.
    """

    taken: int
    dropped: int
    lost: int
    fps: float
    asked_fps: float | None
    live: bool

    @property
    def too_few(self) -> str:
        """Message if the rate is below `TOO_FEW` of ``asked_fps``; empty if it is not, or if a rate is unknown."""
        if not self.asked_fps or not self.fps or self.fps >= TOO_FEW * self.asked_fps:
            return ""
        camera = "shorten the exposure, make the pictures smaller, or try --set fourcc=MJPG"
        advice = camera if self.live else "this computer is too busy"
        return f"gives {self.fps:.1f} frames a second, not {self.asked_fps:g}; {advice}"


class Acquisition:
    """Reader of one source in a thread. A context manager: entering does not start it (`start` does), leaving ends it.

    A lost camera is reopened until it gives an image again.

    Args:
        source: the source, not opened yet; the constructor opens it.
        settings: the timing.
        say: receives messages when the source is lost, silent, frozen, and available again; called by the thread, and
            by `take` and `take_all` for a silent source.
        changed: notified when an image arrives or the source ends; several acquisitions may share one, to be waited
            for together. None for one of its own.

    Attributes:
        source, settings: as given.
        state: the source's state when it was last opened.

    Raises:
        InputError: the source cannot be opened.
    """

    def __init__(
        self,
        source: PictureSource,
        settings: AcquisitionSettings | None = None,
        *,
        say: Callable[[str], None] = lambda text: None,
        changed: threading.Condition | None = None,
    ) -> None:
        self.source, self.settings, self._say = source, settings or AcquisitionSettings(), say
        self.state: SourceState = source.open()
        self._stop, self._changed = threading.Event(), changed or threading.Condition()
        self._slot: deque[Picture] = deque(maxlen=1)
        self._taken = self._dropped = self._lost = 0
        self._ended = False
        self._failure: MocapellaError | None = None
        self._times: deque[float] = deque()
        self._last_s = 0.0
        self._silent = self._frozen = False
        self._shown, self._equal, self._different_s = 0, 0, 0.0
        self._thread: threading.Thread | None = None

    def start(self, zero_s: float | None = None) -> None:
        """Start the thread; call it once. ``zero_s``: the source's time 0 on the monotonic clock [s], None for now."""
        self.source.begin(time.monotonic() if zero_s is None else zero_s)
        self._last_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)
        self._thread.start()

    def keep(self, count: int) -> None:
        """Set how many of the newest images are kept until they are taken; 1 at first. Excess images are dropped."""
        if count != self._slot.maxlen:
            with self._changed:
                self._dropped += max(0, len(self._slot) - count)
                self._slot = deque(self._slot, maxlen=count)

    def take(self, timeout: float) -> Picture | None:
        """Take the newest image and drop older ones; None if there is none within ``timeout`` seconds.

        Each image is returned once. The wait is shorter if the source has ended, or if another acquisition notifies a
        shared ``changed``.

        Raises:
            MocapellaError: the source raised it, and is not read any more; raised once.
        """
        found = self.take_all(timeout)
        with self._changed:
            self._dropped += max(0, len(found) - 1)
        return found[-1] if found else None

    def take_all(self, timeout: float) -> list[Picture]:
        """Take all kept images, the oldest first, each once; wait up to ``timeout`` seconds if there is none.

        The list is empty if none arrives in that time. The wait is shorter in the cases that `take` names.

        Raises:
            MocapellaError: the source raised it, and is not read any more; raised once.
        """
        with self._changed:
            if not self._slot and not self._ended:
                self._changed.wait(timeout)
            found = list(self._slot)
            self._slot.clear()
            failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        if not found:
            self._say_if_silent()
        return found

    @property
    def ready(self) -> bool:
        """Whether `take` returns an image or raises without waiting."""
        with self._changed:
            return bool(self._slot) or self._failure is not None

    @property
    def ended(self) -> bool:
        """Whether the source has ended and all its images have been taken."""
        with self._changed:
            return self._ended and not self._slot

    def report(self) -> AcquisitionReport:
        """Return the counts and the rate so far."""
        with self._changed:
            times = self._times
            long = len(times) > 1 and times[-1] - times[0] > 0.5 * RATE_OVER_S
            fps = (len(times) - 1) / (times[-1] - times[0]) if long else 0.0
            return AcquisitionReport(self._taken, self._dropped, self._lost, fps, self.state.fps, self.source.live)

    def close(self) -> None:
        """End the thread and close the source.

        A thread that hangs in a driver is abandoned after `AcquisitionSettings.close_s`; its source stays open.
        """
        self._stop.set()
        if self._thread is not None:
            self._thread.join(self.settings.close_s)
        if self._thread is None or not self._thread.is_alive():
            self.source.close()

    def __enter__(self) -> Acquisition:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                picture = self.source.read(self._stop)
                if picture is not None:
                    self._put(picture)
                elif self._stop.is_set() or not self.source.live or not self._reopen():
                    break
        except MocapellaError as error:
            self._failure = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _put(self, picture: Picture) -> None:
        if self.source.live:
            self._say_if_frozen(picture)
        with self._changed:
            self._dropped += len(self._slot) == self._slot.maxlen
            self._slot.append(picture)
            self._taken += 1
            self._times.append(picture.time_ns / NS_PER_S)
            while self._times[-1] - self._times[0] > RATE_OVER_S and len(self._times) > RATE_OF:
                self._times.popleft()
            self._last_s, self._silent = time.monotonic(), False
            self._changed.notify_all()

    def _reopen(self) -> bool:
        """Reopen a lost camera until it gives an image; False if the acquisition was closed first."""
        self._lost += 1
        self._say(f"{self.source.name}: gives no picture any more (unplugged?); looking again …")
        self.source.close()
        wait_s = self.settings.retry_s
        while not self._stop.wait(wait_s):
            wait_s = min(2 * wait_s, self.settings.longest_retry_s)
            try:
                state = self.source.open()
                first = self.source.read(self._stop)
            except SettingsError:
                raise
            except MocapellaError:
                continue
            if first is None:
                self.source.close()
                continue
            self.state = state
            with self._changed:
                self._times.clear()
            self._put(first)
            self._say(f"{self.source.name}: there again")
            for problem in state.problems:
                self._say(f"{self.source.name}: {problem}")
            return True
        return False

    def _say_if_silent(self) -> None:
        silent_s = time.monotonic() - self._last_s
        if self.source.live and not self._silent and silent_s > self.settings.silent_s and not self._ended:
            self._silent = True
            self._say(f"{self.source.name}: no picture for {silent_s:.0f} s; is it plugged in, or used elsewhere?")

    def _say_if_frozen(self, picture: Picture) -> None:
        now_s = time.monotonic()
        shown = zlib.crc32(picture.image[::_EVERY_PX, ::_EVERY_PX].tobytes())
        if shown != self._shown or not self._equal:
            self._shown, self._equal, self._different_s = shown, 1, now_s
            if self._frozen:
                self._frozen = False
                self._say(f"{self.source.name}: its picture changes again")
            return
        self._equal += 1
        same_s = now_s - self._different_s
        if not self._frozen and self._equal >= FROZEN_OF and same_s > self.settings.silent_s:
            self._frozen = True
            self._say(
                f"{self.source.name}: its picture has not changed for {same_s:.0f} s; is the lens covered? if not, "
                "unplug the camera and plug it in again"
            )
