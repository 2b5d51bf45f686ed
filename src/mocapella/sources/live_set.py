"""Live cameras of a rig: the newest synchronised images, again and again; images that are not read in time drop."""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.model.camera import CameraRig
from mocapella.model.point_tracks import match_cameras
from mocapella.sources.acquisition import Acquisition, AcquisitionSettings
from mocapella.sources.frame_set import FrameSet, check_other_size, fitted
from mocapella.sources.motion_lags import MotionLags
from mocapella.sources.newest_instant import FEWEST, LATEST_S, NewestInstant
from mocapella.sources.paced_pictures import USUAL_FPS
from mocapella.sources.picture_source import Picture, PictureSource

UInt8 = NDArray[np.uint8]

FIRST_S: Final = 5.0
"""Longest wait for a camera's first image [s]."""
MEASURED: Final = FEWEST + 1
"""Number of images after which a camera's frame rate is known."""
POLL_S: Final = 0.1
"""Longest wait for an image before checking for the end (Ctrl-C) [s]."""
LAGS_EVERY_S: Final = 3.0
"""Interval between two measurements of the cameras' lags from motion [s]."""
SAME_LAG_S: Final = 0.02
"""Greatest difference of two successive lags at which the lag is reported [s]."""
UNUSED: Final = 60
"""Number of successive unused images of a camera after which that is reported."""


class LiveSet:
    """The cameras of a rig, each read in its own thread. A context manager; leaving it ends the threads.

    Videos and folders may stand in for cameras, in real time, if all sources are such. The constructor waits for the
    cameras' first images, up to `FIRST_S` seconds, to measure their sizes and frame rates.

    Args:
        sources: the sources, not opened yet, by any camera name that `match_cameras` knows; they are opened at once.
        rig: calibrated cameras; not all need a source.
        other_size: how the images' size may differ from the calibration's, one of `OTHER_SIZES`; None refuses another
            size.
        late_s: known latency of cameras without capture times, by the names of ``sources``; subtracted from their
            images' times [s].
        settings: timing of the threads.
        clock: the monotonic clock, in seconds.

    Attributes:
        rig: the cameras that have sources, with intrinsics for the sources' image sizes.
        rate_hz: frame rate, measured at the start [Hz].
        notes: findings from opening the cameras, one line each.

    Raises:
        InputError: there is no source, or one is of a camera that the rig does not have, cannot be opened, gives no
            image, or has another size than the calibration's.
        SettingsError: cameras and videos together, or an unknown ``other_size``.
    """

    def __init__(
        self,
        sources: Mapping[str, PictureSource],
        rig: CameraRig,
        *,
        other_size: str | None = None,
        late_s: Mapping[str, float] | None = None,
        settings: AcquisitionSettings | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not sources:
            raise InputError("no cameras are named", field="SOURCE…", fix="name a source for each camera of the rig")
        check_other_size(other_size)
        _check_alike(sources)
        for name, source in sources.items():
            match_cameras([name], rig.cameras, file=source.name)  # an error names the source
        names = match_cameras(list(sources), rig.cameras)
        given = dict(zip(names, sources.values(), strict=True))
        self.notes: list[str] = []
        self._clock, self._changed = clock, threading.Condition()
        self._messages: deque[str] = deque()
        self._zero_s: float | None = None
        self._dropped_before: dict[str, int] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        self._other_sizes: dict[str, tuple[int, int]] = {}
        self._few: set[str] = set()
        self._late_s = dict(zip(names, ((late_s or {}).get(name, 0.0) for name in sources), strict=True))
        self._lags = MotionLags(names)
        self._lag_s: dict[str, float] = {}
        self._measured_s = -float("inf")
        self._unused = dict.fromkeys(names, 0)
        self._reported: set[tuple[str, str]] = set()
        with ExitStack() as opened:
            self._cameras = {
                name: opened.enter_context(
                    Acquisition(given[name], settings, say=partial(self._queue_message, name), changed=self._changed)
                )
                for name in rig.cameras
                if name in given
            }
            self._set = NewestInstant(self._cameras, NS_PER_S / self._stated_hz())
            self._read_first()
            placed = {}
            for name, camera in self._cameras.items():
                placed[name], note = fitted(rig.cameras[name], self._sizes[name], other_size, source=camera.source.name)
                self.notes += [note] if note else []
                self.notes += [f"{name}: {problem}" for problem in camera.state.problems]
            self._opened = opened.pop_all()
        self.rig = CameraRig(placed)
        self.rate_hz = round(NS_PER_S / self._set.period_ns, 3)
        clocks = {name: camera.source.times for name, camera in self._cameras.items()}
        if len(set(clocks.values())) > 1:
            origins = "; ".join(f"{name}: {times}" for name, times in clocks.items())
            self.notes.append(
                f"the cameras' times have different origins, so some cameras may lag ({origins}); lags are measured "
                "and reported once a person has moved"
            )

    @property
    def count(self) -> None:
        """None: the number of frames is not known in advance."""

    @property
    def dropped(self) -> dict[str, int]:
        """Number of images that no frame used since `until` began, by camera."""
        now = self._all_dropped()
        return {name: count - self._dropped_before.get(name, 0) for name, count in now.items()}

    def described(self) -> dict[str, dict[str, Any]]:
        """Return source and image size by camera, as JSON types, for ``--json``."""
        return {
            name: {"source": camera.source.name, "size_px": list(self._sizes[name])}
            for name, camera in self._cameras.items()
        }

    def summary(self) -> dict[str, Any]:
        """Return the dropped images by camera, as JSON types, for ``--json``."""
        return {"dropped": self.dropped}

    def __iter__(self) -> Iterator[FrameSet]:
        """Yield frames as `until` does, without a stop or messages, until all sources have ended."""
        return self.until(threading.Event())

    def until(
        self, stop: threading.Event, seconds: float | None = None, say: Callable[[str], None] | None = None
    ) -> Iterator[FrameSet]:
        """Yield frames from now on, numbered from 0: the newest images each time the caller asks.

        The iteration ends when ``stop`` is set, after ``seconds``, or when all sources have ended; the failure of one
        camera does not end it. `until` may be called again: cameras' images in between are dropped, and videos go on.

        Args:
            stop: ends the iteration within `POLL_S`.
            seconds: duration [s]; None for no limit.
            say: receives messages when cameras are lost, silent, late or available again; None for no messages.
        """
        begin_s = self._begin()
        number, zero_ns = 0, 0
        while not stop.is_set() and (seconds is None or self._clock() < begin_s + seconds):
            over = self._collect(say or (lambda _text: None))
            found = self._set.take(float("inf") if over else self._clock())
            if found is not None:
                zero_ns = zero_ns if number else found.time_ns
                images = {name: np.asarray(one.image, np.uint8) for name, one in found.pictures.items()}
                self._unused.update(dict.fromkeys(images, 0))
                self._report_late(say or (lambda _text: None))
                yield FrameSet(number, found.time_ns - zero_ns, images)
                number += 1
            elif over:
                self._set.drop_rest()
                return
            else:
                self._wait()

    def close(self) -> None:
        """End the threads and close the cameras; may be called twice."""
        self._opened.close()

    def __enter__(self) -> LiveSet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _queue_message(self, name: str, text: str) -> None:
        """Queue a thread's message, to be passed on by the loop."""
        self._messages.append(f"{name}: {text}")

    def _stated_hz(self) -> float:
        """Median of the frame rates that the sources state."""
        stated = [camera.state.fps for camera in self._cameras.values() if camera.state.fps]
        return statistics.median(stated) if stated else USUAL_FPS

    def _read_first(self) -> None:
        """Read cameras' first images for their sizes and frame rates; videos are not started for this."""
        live = {name: camera for name, camera in self._cameras.items() if camera.source.live}
        for name, camera in self._cameras.items():
            if name not in live:
                size = camera.state.size_px
                assert size is not None  # only a stream's size is unknown before its first image
                self._sizes[name] = size
        for camera in live.values():
            camera.start()
        deadline_s, taken = self._clock() + FIRST_S, dict.fromkeys(live, 0)
        while self._clock() < deadline_s and any(count < MEASURED for count in taken.values()):
            for name, camera in live.items():
                picture = camera.take(0.0)
                if picture is not None:
                    self._sizes.setdefault(name, picture.size_px)
                    self._add(name, picture, self.notes.append)
                    taken[name] += 1
            self._wait()
        for name, camera in live.items():
            if not taken[name]:
                raise InputError(
                    "gives no picture", file=camera.source.name, field=name,
                    fix="look whether it is plugged in and used by no other program",
                )  # fmt: skip

    def _begin(self) -> float:
        """Discard cameras' earlier images, and start videos. Return the present time [s]."""
        now_s = self._clock()
        for camera in self._cameras.values():
            if camera.source.live:
                camera.take(0.0)
        self._set.begin()
        self._unused.update(dict.fromkeys(self._unused, 0))
        self._dropped_before = self._all_dropped()
        # After the counts so far: what a video drops from its first image on is of this run.
        if self._zero_s is None:
            self._zero_s = now_s
            for camera in self._cameras.values():
                if not camera.source.live:
                    camera.start(now_s)
        return now_s

    def _collect(self, say: Callable[[str], None]) -> bool:
        """Process the images that have arrived; whether all sources have ended."""
        # With a late camera, the others' older images are needed for the same instant: keep enough of them.
        held = self._set.held_ns is not None
        kept = 1 + round(LATEST_S * NS_PER_S / self._set.period_ns) if held else 1
        for name, camera in self._cameras.items():
            camera.keep(kept)
            try:
                pictures = camera.take_all(0.0)
            except MocapellaError as error:
                say(f"{name}: {error}; the others go on")
                pictures = []
            for picture in pictures:
                self._add(name, picture, say)
            few = camera.report().too_few if name not in self._few else ""
            if few:
                self._few.add(name)
                say(f"{name}: {few}")
        while self._messages:
            say(self._messages.popleft())
        return all(camera.ended for camera in self._cameras.values())

    def _add(self, name: str, picture: Picture, say: Callable[[str], None]) -> None:
        """Process an image; one of another size than the first is ignored, since its intrinsics are unknown."""
        size, first = picture.size_px, self._sizes[name]
        if size == first:
            self._other_sizes.pop(name, None)
            picture = replace(picture, time_ns=picture.time_ns - round(self._late_s[name] * NS_PER_S))
            self._unused[name] += 1
            self._lags.add(name, picture.time_ns, np.asarray(picture.image, np.uint8))
            self._set.add(name, picture)
        elif self._other_sizes.get(name) != size:
            self._other_sizes[name] = size
            say(
                f"{name}: gives pictures of {size[0]} × {size[1]} px now, not of {first[0]} × {first[1]} px as at "
                "first: they are ignored; set the size back, or restart"
            )

    def _report_late(self, say: Callable[[str], None]) -> None:
        """Report cameras whose images arrive later than the others', or show motion later; each once."""
        late_s = {name: late / NS_PER_S for name, late in self._set.late_ns().items()}
        if self._set.held_ns is not None:
            for name, late in late_s.items():
                if self._set.period_ns / NS_PER_S < late <= LATEST_S:
                    self._say_once(say, name, "held", f"its latency is {_ms(late)} ms above the others', which wait "
                                   "for it, so that a frame is of one instant")  # fmt: skip
        for name, count in self._unused.items():
            if count > UNUSED:
                delay = late_s.get(name, 0.0)
                much = f": its latency is {_ms(delay)} ms above the others'" if delay > LATEST_S else ""
                self._say_once(say, name, "unused", f"no frame uses its images, whose times are never near the "
                               f"others'{much}; images that are more than {_ms(LATEST_S)} ms late are not waited "
                               "for: make its stream smaller, or set it to a lower latency")  # fmt: skip
        now_s = self._clock()
        if now_s < self._measured_s + LAGS_EVERY_S:
            return
        self._measured_s = now_s
        before, self._lag_s = self._lag_s, self._lags.measure()
        for name, lag in self._lag_s.items():
            steady = abs(lag - before.get(name, float("inf"))) <= SAME_LAG_S
            if steady and lag > self._set.period_ns / NS_PER_S / 2:
                self._say_once(say, name, "lag", f"motion appears {_ms(lag)} ms later in its images than in the "
                               f"others': --set late={name}={_ms(lag + self._late_s[name])} corrects it")  # fmt: skip

    def _say_once(self, say: Callable[[str], None], name: str, topic: str, text: str) -> None:
        if (name, topic) not in self._reported:
            self._reported.add((name, topic))
            say(f"{name}: {text}")

    def _all_dropped(self) -> dict[str, int]:
        return {name: camera.report().dropped + self._set.dropped[name] for name, camera in self._cameras.items()}

    def _wait(self) -> None:
        """Wait for an image; only briefly if some cameras' images are there and wait for the others."""
        timeout = self._set.period_ns / NS_PER_S / 8 if self._set.pending else POLL_S
        with self._changed:
            self._changed.wait_for(lambda: any(one.ready for one in self._cameras.values()), min(timeout, POLL_S))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"


def _check_alike(sources: Mapping[str, PictureSource]) -> None:
    """Check that all sources are cameras, or none: their capture times have different clocks.

    Raises:
        SettingsError: cameras and videos are mixed.
    """
    live = [name for name, source in sources.items() if source.live]
    films = [name for name in sources if name not in live]
    if live and films:
        raise SettingsError(
            f"live cameras and films cannot be followed together: {live[0]}={sources[live[0]].name} is live, and "
            f"{films[0]}={sources[films[0]].name} is not; name cameras for all, or films for all"
        )
