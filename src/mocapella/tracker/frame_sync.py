"""Group the frames of several cameras into sets of one instant, by their order of arrival alone.

    sync = FrameSync(rig.cameras)
    for arrival in arrivals:
        for instant in sync.update(arrival):
            instant.time_ns, instant.frames["left"]

Cameras in step, as of files, give frames of equal ``at_ns``: a set closes with the last of them. Cameras of one rate
that are not in step are up to a period apart: a set has the first waiting frame of each that is within `WITHIN` of a
period of the oldest, and where a camera's next one would be nearer to the others, its first is dropped. A camera that
has nothing waiting is waited for until an arrival shows that its frame will not come: one of its own of a later
instant, or one of another camera that is too much later. So the order of arrival within an instant does not matter,
except for the first frame after a silence, which is not waited for.

The only clock is the newest ``at_ns`` so far. A camera whose frames come steadily behind it is waited for that much
longer.
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
"""A camera's period is the median of so many last intervals."""
FEWEST: Final = 5
"""Fewest intervals, or delays, for an estimate of a camera's period or lateness."""
WITHIN: Final = 0.9
"""Frames of one instant are less than so many periods apart."""
OVERDUE: Final = 1.5
"""A prompt camera is waited for until another one is so many periods later."""
NEARER: Final = 0.125
"""A frame is dropped where the camera's next one makes a set shorter by so many periods."""
STEADY: Final = 0.5
"""How late frames come is known where half of them differ by less than so many periods."""
LATEST_S: Final = 0.5
"""Nobody waits for a camera that is later: that many images would have to be kept."""

NOT_RISING: Final = "its time does not rise"
CLOSED: Final = "its set was closed before it came"
NOT_NEAREST: Final = "a later image of this camera is nearer to the others'"


@dataclass(frozen=True)
class FrameSyncSettings:
    """What is to be known before the first frame.

    Attributes:
        period_s: of the cameras, as long as their frames have not shown it [s].
        silent_after_s: a camera without a frame for so long is not waited for [s].
    """

    period_s: float = 1.0 / 30.0
    silent_after_s: float = 1.0

    def __post_init__(self) -> None:
        check(0 < self.period_s <= 3600, "period_s", self.period_s, "above 0 and at most 3600 s")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")


class SyncedFrames(msgspec.Struct, frozen=True, eq=False):
    """Frames of one instant.

    Attributes:
        time_ns: middle of the oldest and the newest, on the clock of all cameras.
        frames: one of each camera that has one, by its name.
    """

    time_ns: int
    frames: Mapping[str, Arrival]


class _Waiting:
    """One camera's frames that are in no set yet, and how often and how late its frames come."""

    def __init__(self) -> None:
        self.frames: deque[Arrival] = deque()
        self.newest_ns: int | None = None
        self.heard_ns: int | None = None
        self._left: tuple[int, int, int] | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._late: deque[int] = deque(maxlen=INTERVALS)

    def hear(self, arrival: Arrival, now_ns: int) -> None:
        """A frame came when the newest of all was of ``now_ns``."""
        self.heard_ns = now_ns
        self._late.append(now_ns - arrival.at_ns)

    def leave(self) -> None:
        """The first frame waits no more. Its interval is learnt now, not when it came: what a set is made of must not
        depend on the order of arrival.
        """
        arrival, before = self.frames.popleft(), self._left
        self._left = arrival.frame.node_id, arrival.frame.sequence, arrival.at_ns
        if before is not None and before[0] == self._left[0]:
            self._intervals.append((self._left[2] - before[2]) / max(self._left[1] - before[1], 1))

    @property
    def period_ns(self) -> float | None:
        """The median of the camera's intervals; None before there is one."""
        known = sorted(self._intervals)
        return known[len(known) // 2] if known else None

    def late_ns(self, period_ns: float) -> float:
        """How late the camera's frames come, in general; 0 while that is not known, or too much to be waited for."""
        known = sorted(self._late)
        count = len(known)
        if count <= FEWEST or known[3 * count // 4] - known[count // 4] > STEADY * period_ns:
            return 0.0
        return known[count // 2] if known[count // 2] <= LATEST_S * NS_PER_S else 0.0

    def next_ns(self) -> float | None:
        """When the frame after the first is expected; None where that is not known."""
        period_ns = self.period_ns
        return None if period_ns is None or len(self._intervals) < FEWEST else self.frames[0].at_ns + period_ns

    def memory(self) -> list[Any]:
        return [list(self.frames), self.newest_ns, self.heard_ns, self._left, self._intervals, self._late]

    def recall(self, memory: Sequence[Any]) -> None:
        frames, self.newest_ns, self.heard_ns, self._left, self._intervals, self._late = memory
        self.frames = deque(frames)


class FrameSync:
    """Holds frames until the set of their instant is complete.

    Args:
        cameras: names of the cameras to wait for.
        settings: see there.

    Attributes:
        used: frames that became part of a set.
        dropped: how many did not, by the reason.
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
        """Frames whose instant is not complete."""
        return sum(len(camera.frames) for camera in self._cameras.values())

    @property
    def period_ns(self) -> float:
        """The median of the cameras' periods; as the settings say before the first is known."""
        known = sorted(period for camera in self._cameras.values() if (period := camera.period_ns) is not None)
        return known[len(known) // 2] if known else self.settings.period_s * NS_PER_S

    @property
    def silent(self) -> tuple[str, ...]:
        """Cameras that are not waited for, in the order of their names given."""
        return tuple(name for name, camera in self._cameras.items() if self._is_silent(camera))

    @property
    def heard(self) -> tuple[str, ...]:
        """Cameras that speak."""
        return tuple(
            name for name, one in self._cameras.items() if one.heard_ns is not None and not self._is_silent(one)
        )

    def update(self, arrival: Arrival) -> list[SyncedFrames]:
        """Take a frame in; returns the sets that are complete with it, in the order of their times.

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
        """Close the sets of all waiting frames, after the last frame."""
        return list(self._closed(ended=True))

    def memory(self) -> list[Any]:
        """All that `recall` wants, of plain values and arrivals."""
        cameras = {name: camera.memory() for name, camera in self._cameras.items()}
        return [cameras, self._first_ns, self._now_ns, self._last_ns, self.used, self.dropped]

    def recall(self, memory: Sequence[Any]) -> None:
        """Be as when `memory` was made."""
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
        """Whether a camera without a waiting frame may still give one of the instant that begins then."""
        overdue_ns = camera.late_ns(period_ns) + OVERDUE * period_ns
        return self._now_ns is not None and self._now_ns - begin_ns <= overdue_ns and not self._is_silent(camera)

    def _not_nearest(self, together: Mapping[str, Arrival], period_ns: float) -> Sequence[str]:
        """Cameras, the oldest first, without whose frames the set would be shorter: their next ones are nearer."""
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
"""Types in a memory, beside the frames' own."""
