"""Pictures of one instant from cameras that are not in step: the newest of each, as near to each other as can be.

Cameras of one rate that begin when they like are up to a period apart. Of any instant each has a picture within half a
period; so a frame has one of every camera that gives any. Which ones belong together is chosen anew for every frame:
where a camera's next picture would be nearer to the others than the one that is there, it is waited for.

Where a camera's pictures come later after their times than others' do, by more than a period, they would never meet
those of their instant, for these are gone by then. So all pictures are held back until its own are there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.settings import check
from mocapella.sources.picture_source import Picture

INTERVALS: Final = 15
"""A camera's period is the median of so many last intervals."""
FEWEST: Final = 5
"""So many intervals say it."""
OVERDUE: Final = 1.5
"""A picture is waited for until so many periods after the camera's last."""
NEARER: Final = 0.125
"""It is waited for where it is nearer by so much of a period."""
LONGEST: Final = 2.0
"""Nothing is waited for longer than so many periods."""
LATE, LATE_AGAIN = 1.0, 0.5
"""A camera is held to be late from so many periods on, and no longer below."""
STEADY: Final = 0.5
"""How late pictures come is known where half of them are so within so many periods."""
LATEST_S: Final = 0.5
"""Nobody waits for a camera that is later: that many pictures would have to be kept."""


class PictureSet(msgspec.Struct, frozen=True, eq=False):
    """Pictures that belong together.

    Attributes:
        time_ns: the middle of their times.
        pictures: by camera, each within half a period of it.
    """

    time_ns: int
    pictures: Mapping[str, Picture]


class _Camera:
    """A camera's newest picture that nobody had yet, those that are held back, and how often and how late they come."""

    def __init__(self) -> None:
        self.fresh: Picture | None = None
        self.last: Picture | None = None
        self.held: deque[Picture] = deque()
        self.dropped = 0
        self.last_out_s = -math.inf
        self._came: Picture | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._late: deque[float] = deque(maxlen=INTERVALS)

    def came(self, picture: Picture) -> None:
        """Learn from the next picture."""
        before, self._came = self._came, picture
        if before is not None and picture.number > before.number:
            self._intervals.append((picture.time_ns - before.time_ns) / (picture.number - before.number))
        self._late.append(picture.ready_s * NS_PER_S - picture.time_ns)

    def give(self, picture: Picture, out_s: float) -> None:
        """It can be had from now on; one that nobody had is dropped."""
        self.dropped += self.fresh is not None
        self.fresh = self.last = picture
        self.last_out_s = max(out_s, picture.ready_s)

    @property
    def period_ns(self) -> float | None:
        """Of its own pictures; None while that is not known."""
        known = sorted(self._intervals)
        return known[len(known) // 2] if len(known) >= FEWEST else None

    def late_ns(self, period_ns: float) -> float | None:
        """How long after their times its pictures come, on a clock of all cameras; None while that is not known."""
        known = sorted(self._late)
        count = len(known)
        if count <= FEWEST or known[3 * count // 4] - known[count // 4] > STEADY * period_ns:
            return None
        return known[count // 2]

    def expected_ns(self, usual_ns: float, now_s: float, *, first: bool) -> float:
        """When its next picture is of; never, where that should be there by now. At ``first`` any may come at once."""
        if self.last is None:
            return -math.inf if first else math.inf
        period_ns = self.period_ns or usual_ns
        overdue = now_s > self.last_out_s + OVERDUE * period_ns / NS_PER_S
        return math.inf if overdue else self.last.time_ns + period_ns

    def silent(self, usual_ns: float, now_s: float) -> bool:
        """Whether it has given nothing for so long that nobody waits for it."""
        period_ns = self.period_ns or usual_ns
        return self._came is None or now_s > self._came.ready_s + LATEST_S + OVERDUE * period_ns / NS_PER_S


class NewestInstant:
    """Remembers each camera's newest picture.

    Args:
        cameras: their names.
        period_ns: of all cameras, as long as their pictures have not shown it.
    """

    def __init__(self, cameras: Iterable[str], period_ns: float) -> None:
        check(0 < period_ns < math.inf, "period_ns", period_ns, "above 0")
        self._cameras = {name: _Camera() for name in cameras}
        self._first_ns = period_ns
        self._last_ns: int | None = None
        self._since_s: float | None = None
        self._out_ns: float | None = None

    @property
    def period_ns(self) -> float:
        """The median of the cameras' periods, as far as they are known."""
        known = sorted(one.period_ns for one in self._cameras.values() if one.period_ns)
        return known[len(known) // 2] if known else self._first_ns

    @property
    def dropped(self) -> dict[str, int]:
        """By camera, pictures that were replaced by newer ones before anybody had them."""
        return {name: camera.dropped for name, camera in self._cameras.items()}

    @property
    def pending(self) -> bool:
        """Whether there is a picture that nobody had."""
        return any(camera.fresh is not None or camera.held for camera in self._cameras.values())

    @property
    def held_ns(self) -> float | None:
        """How long after their times pictures are given because some camera's come late; None where that is at once."""
        return self._out_ns

    def late_ns(self) -> dict[str, float]:
        """How much later after their times each camera's pictures come than the most prompt one's, as far as known."""
        period = self.period_ns
        known = {name: late for name, one in self._cameras.items() if (late := one.late_ns(period)) is not None}
        least = min(known.values(), default=0.0)
        return {name: late - least for name, late in known.items()}

    def add(self, name: str, picture: Picture) -> None:
        """A camera's next picture."""
        camera = self._cameras[name]
        camera.came(picture)
        if self._out_ns is None:
            camera.give(picture, picture.ready_s)
        else:
            camera.held.append(picture)

    def begin(self) -> None:
        """What has come so far is of before: only what comes from now on counts."""
        for camera in self._cameras.values():
            camera.fresh, camera.dropped = None, 0
            camera.held.clear()
        self._last_ns = self._since_s = None

    def take(self, now_s: float) -> PictureSet | None:
        """The newest pictures, each once; None where there is none, or a better one is about to come.

        Times rise by half a period at least: what moves is told from two frames, and jitter of the cameras' clocks is
        no speed.

        Args:
            now_s: on the clock of the pictures' ``ready_s``; infinite where nothing more will come.
        """
        period = self.period_ns
        self._hold(period, now_s)
        fresh = {name: camera.fresh for name, camera in self._cameras.items() if camera.fresh is not None}
        newest = max((picture.time_ns for picture in fresh.values()), default=0)
        together = {name: picture for name, picture in fresh.items() if newest - picture.time_ns <= period}
        if not together:
            return None
        oldest = min(picture.time_ns for picture in together.values())
        middle = (oldest + newest) // 2
        if self._last_ns is not None and middle - self._last_ns < period / 2:
            return None
        self._since_s = now_s if self._since_s is None else self._since_s
        long = now_s == math.inf or now_s > self._since_s + LONGEST * period / NS_PER_S
        if not long and self._better_soon(together, period, now_s):
            return None
        for name in together:
            self._cameras[name].fresh = None
        self._last_ns, self._since_s = middle, None
        return PictureSet(middle, together)

    def _hold(self, period: float, now_s: float) -> None:
        """See whether some camera is late, and let go what is old enough by now."""
        known = [
            late
            for camera in self._cameras.values()
            if not camera.silent(period, now_s) and (late := camera.late_ns(period)) is not None
        ]
        least = min(known, default=0.0)
        latest = max((late for late in known if late - least <= LATEST_S * NS_PER_S), default=0.0)
        late = latest - least > (LATE if self._out_ns is None else LATE_AGAIN) * period
        self._out_ns = latest if late else None
        for camera in self._cameras.values():
            while camera.held:
                out_s = (
                    camera.held[0].ready_s
                    if self._out_ns is None
                    else ((camera.held[0].time_ns + self._out_ns) / NS_PER_S)
                )
                if now_s < out_s:
                    break
                camera.give(camera.held.popleft(), out_s)

    def _better_soon(self, together: Mapping[str, Picture], period: float, now_s: float) -> bool:
        """Whether a camera that is missing is about to come, or the next pictures of some are nearer to the others."""
        times = {name: picture.time_ns for name, picture in together.items()}
        order = sorted(times, key=lambda name: times[name])
        begin, end = times[order[0]], times[order[-1]]
        first = self._last_ns is None
        expected = {name: camera.expected_ns(period, now_s, first=first) for name, camera in self._cameras.items()}
        if any(at <= begin + period for name, at in expected.items() if name not in together):
            return True
        ends = [max(end, *(expected[name] for name in order[:k])) for k in range(1, len(order))]
        spans = [later - times[name] for later, name in zip(ends, order[1:], strict=True)]
        return min(spans, default=math.inf) < end - begin - NEARER * period
