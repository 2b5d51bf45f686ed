"""Group the frames of several cameras into simultaneous sets, from their order of arrival alone.

    sync = FrameSync(rig.cameras)
    for arrival in arrivals:
        for instant in sync.update(arrival):
            instant.time_ns, instant.frames["left"]

Synchronised cameras, such as files, give frames of equal ``at_ns``: a set closes with the last of them. Cameras of one
rate without synchronisation are up to a period apart: a set has the first waiting frame of each camera within `WITHIN`
of a period of the oldest; if a camera's next frame would be nearer to the others, its first one is dropped. A camera
without a waiting frame is waited for until an arrival shows that its frame will not come: a later one of its own, or
one of another camera that is late enough. So the order of arrival within a set does not matter, except for the first
frame after a silence, which is not waited for.

The only clock is the newest ``at_ns`` so far. A camera whose frames are constantly late is waited for that much longer.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.model.observations import Arrival
from mocapella.settings import check

INTERVALS: Final = 15
"""Number of intervals whose median is a camera's period."""
FEWEST: Final = 5
"""Fewest intervals to predict a camera's next frame; its typical delay needs more delays than this."""
WITHIN: Final = 0.9
"""Largest span of a set, in periods."""
OVERDUE: Final = 1.5
"""A camera is waited for until the newest time is this many periods, and its delay, after the oldest frame."""
NEARER: Final = 0.125
"""A frame is dropped if the camera's next one makes the set's span shorter by this many periods."""
STEADY: Final = 0.5
"""Largest interquartile range, in periods, of a camera's delays for its typical delay to be known."""
LATEST_S: Final = 0.5
"""Longest delay that is waited for, which bounds the number of stored images [s]."""

NOT_RISING: Final = "its time does not rise"
CLOSED: Final = "its set was closed before it came"
NOT_NEAREST: Final = "a later image of this camera is nearer to the others'"


@dataclass(frozen=True)
class FrameSyncSettings:
    """Assumptions before the first frame.

    Attributes:
        period_s: frame period of the cameras, used until their frames show it [s].
        silent_after_s: a camera without a frame for this long is not waited for [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    period_s: float = 1.0 / 30.0
    silent_after_s: float = 1.0

    def __post_init__(self) -> None:
        check(0 < self.period_s <= 3600, "period_s", self.period_s, "above 0 and at most 3600 s")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")


class SyncedFrames(msgspec.Struct, frozen=True, eq=False):
    """Simultaneous frames.

    Attributes:
        time_ns: midpoint of the oldest and the newest capture time, on the common clock.
        frames: the frame of each camera that has one in this set, by the camera's name.
    """

    time_ns: int
    frames: Mapping[str, Arrival]


class _Waiting:
    """One camera's waiting frames, its intervals and its delays."""

    def __init__(self) -> None:
        self.frames: deque[Arrival] = deque()
        self.newest_ns: int | None = None
        self.heard_ns: int | None = None
        self._left: tuple[int, int, int] | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._late: deque[int] = deque(maxlen=INTERVALS)

    def hear(self, arrival: Arrival, now_ns: int) -> None:
        """Record the arrival of a frame when the newest time was ``now_ns``."""
        self.heard_ns = now_ns
        self._late.append(now_ns - arrival.at_ns)

    def leave(self) -> None:
        """Remove the first frame, and learn its interval.

        It is not learnt on arrival, so that sets do not depend on the order of arrival.
        """
        arrival, before = self.frames.popleft(), self._left
        self._left = arrival.frame.node_id, arrival.frame.sequence, arrival.at_ns
        if before is not None and before[0] == self._left[0]:
            self._intervals.append((self._left[2] - before[2]) / max(self._left[1] - before[1], 1))

    @property
    def period_ns(self) -> float | None:
        """Median of the camera's intervals; None before there is one."""
        known = sorted(self._intervals)
        return known[len(known) // 2] if known else None

    def late_ns(self, period_ns: float) -> float:
        """Return the typical delay of the camera's frames; 0 while it is unknown, or too long to wait for."""
        known = sorted(self._late)
        count = len(known)
        if count <= FEWEST or known[3 * count // 4] - known[count // 4] > STEADY * period_ns:
            return 0.0
        return known[count // 2] if known[count // 2] <= LATEST_S * NS_PER_S else 0.0

    def next_ns(self) -> float | None:
        """Return the expected time of the frame after the first; None if unknown."""
        period_ns = self.period_ns
        return None if period_ns is None or len(self._intervals) < FEWEST else self.frames[0].at_ns + period_ns

    def memory(self) -> list[Any]:
        return [list(self.frames), self.newest_ns, self.heard_ns, self._left, self._intervals, self._late]

    def recall(self, memory: Sequence[Any]) -> None:
        frames, self.newest_ns, self.heard_ns, self._left, self._intervals, self._late = memory
        self.frames = deque(frames)


class FrameSync:
    """Holds frames until their set is complete.

    Args:
        cameras: names of the cameras to wait for.
        settings: assumptions before the first frame; the defaults if None.

    Attributes:
        used: number of frames that became part of a set.
        dropped: number of dropped frames, by reason.
    """

    def __init__(self, cameras: Iterable[str], settings: FrameSyncSettings | None = None) -> None:
        self.settings = settings or FrameSyncSettings()
        self._names = tuple(cameras)
        self.reset()

    def reset(self) -> None:
        """Forget every frame."""
        self._cameras = {name: _Waiting() for name in self._names}
        self._first_ns: int | None = None
        self._now_ns: int | None = None
        self._last_ns: int | None = None
        self.used = 0
        self.dropped: Counter[str] = Counter()

    @property
    def waiting(self) -> int:
        """Number of frames whose set is not complete."""
        return sum(len(camera.frames) for camera in self._cameras.values())

    @property
    def period_ns(self) -> float:
        """Median of the cameras' frame periods [ns]; the setting ``period_s`` before a period is known."""
        known = sorted(period for camera in self._cameras.values() if (period := camera.period_ns) is not None)
        return known[len(known) // 2] if known else self.settings.period_s * NS_PER_S

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the cameras without a frame for ``silent_after_s``, in the order of ``cameras``.

        No set waits for them.
        """
        return tuple(name for name, camera in self._cameras.items() if self._is_silent(camera))

    @property
    def heard(self) -> tuple[str, ...]:
        """Names of the cameras that have sent a frame within ``silent_after_s``, in the order of ``cameras``."""
        return tuple(
            name for name, one in self._cameras.items() if one.heard_ns is not None and not self._is_silent(one)
        )

    def update(self, arrival: Arrival) -> list[SyncedFrames]:
        """Process a frame; return the sets that it completes, in the order of their times; often none.

        A frame whose time does not rise, or whose set is closed, is counted in `dropped`.

        Raises:
            KeyError: its sensor is none of the cameras.
        """
        camera = self._cameras[arrival.frame.sensor]
        self._first_ns = arrival.at_ns if self._first_ns is None else self._first_ns
        self._now_ns = arrival.at_ns if self._now_ns is None else max(self._now_ns, arrival.at_ns)
        camera.hear(arrival, self._now_ns)
        if camera.newest_ns is not None and arrival.at_ns <= camera.newest_ns:
            self.dropped[NOT_RISING] += 1
        elif self._last_ns is not None and arrival.at_ns <= self._last_ns:
            self.dropped[CLOSED] += 1
        else:
            camera.newest_ns = arrival.at_ns
            camera.frames.append(arrival)
        return list(self._closed())

    def flush(self) -> list[SyncedFrames]:
        """Close the sets of all waiting frames, after the last frame; return them in the order of their times."""
        return list(self._closed(ended=True))

    def memory(self) -> list[Any]:
        """Return all state, for `recall`, as plain values and arrivals."""
        cameras = {name: camera.memory() for name, camera in self._cameras.items()}
        return [cameras, self._first_ns, self._now_ns, self._last_ns, self.used, self.dropped]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same cameras."""
        cameras, self._first_ns, self._now_ns, self._last_ns, self.used, self.dropped = memory
        for name, camera in self._cameras.items():
            camera.recall(cameras[name])

    def _closed(self, *, ended: bool = False) -> Iterator[SyncedFrames]:
        while True:
            first = {name: camera.frames[0] for name, camera in self._cameras.items() if camera.frames}
            if not first:
                return
            begin_ns, period_ns = min(frame.at_ns for frame in first.values()), self.period_ns
            missing = [camera for name, camera in self._cameras.items() if name not in first]
            if not ended and any(self._may_come(camera, begin_ns, period_ns) for camera in missing):
                return
            together = {name: frame for name, frame in first.items() if frame.at_ns - begin_ns <= WITHIN * period_ns}
            others_nearer = self._not_nearest(together, period_ns)
            for name in others_nearer:
                self._cameras[name].leave()
            self.dropped.update([NOT_NEAREST] * len(others_nearer))
            if not others_nearer:
                yield self._set_of(together, begin_ns)

    def _set_of(self, together: Mapping[str, Arrival], begin_ns: int) -> SyncedFrames:
        self._last_ns = (begin_ns + max(frame.at_ns for frame in together.values())) // 2
        self.used += len(together)
        for name in together:
            self._cameras[name].leave()
        for camera in self._cameras.values():
            while camera.frames and camera.frames[0].at_ns <= self._last_ns:
                camera.leave()
                self.dropped[CLOSED] += 1
        return SyncedFrames(self._last_ns, together)

    def _is_silent(self, camera: _Waiting) -> bool:
        since_ns = self._first_ns if camera.heard_ns is None else camera.heard_ns
        if since_ns is None or self._now_ns is None:
            return False
        return self._now_ns - since_ns > self.settings.silent_after_s * NS_PER_S

    def _may_come(self, camera: _Waiting, begin_ns: int, period_ns: float) -> bool:
        """Return whether a camera without a waiting frame may still give one for the set that begins then."""
        overdue_ns = camera.late_ns(period_ns) + OVERDUE * period_ns
        return self._now_ns is not None and self._now_ns - begin_ns <= overdue_ns and not self._is_silent(camera)

    def _not_nearest(self, together: Mapping[str, Arrival], period_ns: float) -> Sequence[str]:
        """Return cameras, the oldest first, whose next frames would make the set shorter."""
        order = sorted(together, key=lambda name: (together[name].at_ns, name))
        begin_ns, end_ns = together[order[0]].at_ns, together[order[-1]].at_ns
        best, shortest_ns, later_ns = 0, end_ns - begin_ns - NEARER * period_ns, float(end_ns)
        for count, name in enumerate(order[:-1], 1):
            next_ns = self._cameras[name].next_ns()
            if next_ns is None:
                break
            later_ns = max(later_ns, next_ns)
            span_ns = later_ns - together[order[count]].at_ns
            if span_ns < shortest_ns:
                best, shortest_ns = count, span_ns
        return order[:best]


REMEMBERED: Final[tuple[type, ...]] = (Arrival,)
"""Classes in the state that `FrameSync.memory` returns, besides the frames' own, for `mocapella.model.memory`."""
