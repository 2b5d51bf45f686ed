"""Live cameras of a rig: the newest pictures of one instant, again and again; what nobody had time for is dropped."""

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
"""So long a camera has for its first picture."""
MEASURED: Final = FEWEST + 1
"""After so many pictures a camera's rate is known."""
POLL_S: Final = 0.1
"""So soon Ctrl-C is seen while no picture comes."""
LAGS_EVERY_S: Final = 3.0
"""So often it is asked whether what moves is seen later in a camera's pictures than in the others'."""
SAME_LAG_S: Final = 0.02
"""A lag is told once it was found twice, so much alike."""
UNUSED: Final = 60
"""So many pictures in a row that belong to no frame are said."""


class LiveSet:
    """The cameras of a rig, each read in a thread of its own. A context manager; leaving it ends the threads.

    Films and folders count as cameras, too, at their own pace: all sources do, or none.

    Args:
        sources: closed, by any name that `match_cameras` knows; they are opened at once.
        rig: of calibrated cameras, of which not all need have a source.
        other_size: of `OTHER_SIZES`, of pictures of another size than the calibration's; None: they are an error.
        late_s: by camera, how long ago that was which its pictures show, when they come; as ``sources`` are named.
        settings: of the threads.
        clock: the monotonic clock, in seconds.

    Attributes:
        rig: of the cameras that have sources, for pictures of the sources' sizes.
        rate_hz: frames a second, as the cameras began.
        notes: what was found when they were opened, a line each.

    Raises:
        InputError: no source, one of a camera that the rig does not have, one that cannot be opened, that gives no
            picture, or of another size than the calibration's.
        SettingsError: cameras and films together; ``other_size`` is none of them.
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
            match_cameras([name], rig.cameras, file=source.name)  # says which source it is
        names = match_cameras(list(sources), rig.cameras)
        given = dict(zip(names, sources.values(), strict=True))
        self.notes: list[str] = []
        self._clock, self._changed = clock, threading.Condition()
        self._heard: deque[str] = deque()
        self._zero_s: float | None = None
        self._dropped_before: dict[str, int] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        self._other_sizes: dict[str, tuple[int, int]] = {}
        self._few: set[str] = set()
        self._late_s = dict(zip(names, ((late_s or {}).get(name, 0.0) for name in sources), strict=True))
        self._lags = MotionLags(names)
        self._lag_s: dict[str, float] = {}
        self._asked_s = -float("inf")
        self._unused = dict.fromkeys(names, 0)
        self._told: set[tuple[str, str]] = set()
        with ExitStack() as opened:
            self._cameras = {
                name: opened.enter_context(
                    Acquisition(given[name], settings, say=partial(self._hear, name), changed=self._changed)
                )
                for name in rig.cameras
                if name in given
            }
            self._set = NewestInstant(self._cameras, NS_PER_S / self._stated_hz())
            self._look_at_first()
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
            told = "; ".join(f"{name}: {times}" for name, times in clocks.items())
            self.notes.append(
                f"the cameras' times are of different kinds, and some may be late ({told}); by how much is said once "
                "somebody has moved"
            )

    @property
    def count(self) -> None:
        """Nobody knows how many frames there will be."""

    @property
    def dropped(self) -> dict[str, int]:
        """By camera, pictures of this run that nobody had time for."""
        now = self._all_dropped()
        return {name: count - self._dropped_before.get(name, 0) for name, count in now.items()}

    def described(self) -> dict[str, dict[str, Any]]:
        """As ``--json`` has the cameras."""
        return {
            name: {"source": camera.source.name, "size_px": list(self._sizes[name])}
            for name, camera in self._cameras.items()
        }

    def summary(self) -> dict[str, Any]:
        """What is to be told of it at the end, as ``--json`` has it."""
        return {"dropped": self.dropped}

    def __iter__(self) -> Iterator[FrameSet]:
        """As `until` nobody stops it."""
        return self.until(threading.Event())

    def until(
        self, stop: threading.Event, seconds: float | None = None, say: Callable[[str], None] | None = None
    ) -> Iterator[FrameSet]:
        """Frames from now on, numbered from 0: the newest pictures whenever the last ones have been looked at.

        It ends when ``stop`` is set, after so many seconds, or when all sources have ended.

        Args:
            stop: ends it, within a moment.
            seconds: that it goes on; None: no limit.
            say: is told in words when cameras are lost, silent, and there again; without it, nobody is.
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
                self._tell_late(say or (lambda _text: None))
                yield FrameSet(number, found.time_ns - zero_ns, images)
                number += 1
            elif over:
                return
            else:
                self._wait()

    def close(self) -> None:
        """End the threads, and give the cameras back."""
        self._opened.close()

    def __enter__(self) -> LiveSet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _hear(self, name: str, text: str) -> None:
        """What a thread says, to be passed on by the loop."""
        self._heard.append(f"{name}: {text}")

    def _stated_hz(self) -> float:
        """Frames a second as the sources state them, before any has given a picture."""
        stated = [camera.state.fps for camera in self._cameras.values() if camera.state.fps]
        return statistics.median(stated) if stated else USUAL_FPS

    def _look_at_first(self) -> None:
        """The sizes, and of cameras the rate, by the first pictures; films are not begun for that."""
        live = {name: camera for name, camera in self._cameras.items() if camera.source.live}
        for name, camera in self._cameras.items():
            if name not in live:
                size = camera.state.size_px
                assert size is not None  # only a stream's is not known before its first picture
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
                    fix="look whether it is plugged in, and nobody else's",
                )  # fmt: skip

    def _begin(self) -> float:
        """Films begin now; of cameras only what comes from now on counts. Returns what time it is [s]."""
        now_s = self._clock()
        if self._zero_s is None:
            self._zero_s = now_s
            for camera in self._cameras.values():
                if not camera.source.live:
                    camera.start(now_s)
        for camera in self._cameras.values():
            if camera.source.live:
                camera.take(0.0)
        self._set.begin()
        self._unused.update(dict.fromkeys(self._unused, 0))
        self._dropped_before = self._all_dropped()
        return now_s

    def _collect(self, say: Callable[[str], None]) -> bool:
        """Take in what has come; whether nothing more will."""
        # Who is prompt meets who is late in pictures of before, of which none is to be missing then.
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
        while self._heard:
            say(self._heard.popleft())
        return all(camera.ended for camera in self._cameras.values())

    def _add(self, name: str, picture: Picture, say: Callable[[str], None]) -> None:
        """A picture; what has another size than the first does not count, for it was seen through another lens."""
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
                "first: they do not count; set it back, or begin anew"
            )

    def _tell_late(self, say: Callable[[str], None]) -> None:
        """What is known of cameras whose pictures come later than the others', each once."""
        late_s = {name: late / NS_PER_S for name, late in self._set.late_ns().items()}
        if self._set.held_ns is not None:
            for name, late in late_s.items():
                if self._set.period_ns / NS_PER_S < late <= LATEST_S:
                    self._tell_once(say, name, "held", f"its pictures come {_ms(late)} ms later after their times than "
                                    "the others'; these wait for them, so that a frame is of one instant")  # fmt: skip
        for name, count in self._unused.items():
            if count > UNUSED:
                delay = late_s.get(name, 0.0)
                much = f": their latency is {_ms(delay)} ms above the others'" if delay > LATEST_S else ""
                self._tell_once(say, name, "unused", f"no frame has its pictures, whose times are never near the "
                                f"others'{much}; pictures that are more than {_ms(LATEST_S)} ms late are not waited "
                                "for: make its stream smaller, or set it to a lower latency")  # fmt: skip
        now_s = self._clock()
        if now_s < self._asked_s + LAGS_EVERY_S:
            return
        self._asked_s = now_s
        before, self._lag_s = self._lag_s, self._lags.measure()
        for name, lag in self._lag_s.items():
            steady = abs(lag - before.get(name, float("inf"))) <= SAME_LAG_S
            if steady and lag > self._set.period_ns / NS_PER_S / 2:
                self._tell_once(say, name, "lag", f"what moves is seen {_ms(lag)} ms later in its pictures than in the "
                                f"others': --late {name}={_ms(lag + self._late_s[name])} puts it right")  # fmt: skip

    def _tell_once(self, say: Callable[[str], None], name: str, what: str, text: str) -> None:
        if (name, what) not in self._told:
            self._told.add((name, what))
            say(f"{name}: {text}")

    def _all_dropped(self) -> dict[str, int]:
        return {name: camera.report().dropped + self._set.dropped[name] for name, camera in self._cameras.items()}

    def _wait(self) -> None:
        """For a picture; not for long where some are there already, whose others may be late."""
        timeout = self._set.period_ns / NS_PER_S / 8 if self._set.pending else POLL_S
        with self._changed:
            self._changed.wait_for(lambda: any(one.ready for one in self._cameras.values()), min(timeout, POLL_S))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"


def _check_alike(sources: Mapping[str, PictureSource]) -> None:
    """See that all are cameras, or none: their times are of different clocks.

    Raises:
        SettingsError: they are not.
    """
    live = [name for name, source in sources.items() if source.live]
    films = [name for name in sources if name not in live]
    if live and films:
        raise SettingsError(
            f"live cameras and films cannot be followed together: {live[0]}={sources[live[0]].name} is live, and "
            f"{films[0]}={sources[films[0]].name} is not; name cameras for all, or films for all"
        )
