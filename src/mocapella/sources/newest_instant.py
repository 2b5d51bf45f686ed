"""Group the newest images of unsynchronised cameras into frames of one instant.

Free-running cameras of the same frame rate are up to one period apart. For any instant, each camera has an image within
half a period, so a frame has one image of every camera that delivers any. The grouping is decided anew for each frame:
if a camera's next image would be nearer to the others than the present one, the frame waits for it.

A camera whose latency exceeds the others' by more than a period would never match their images of the same instant,
because these would be gone. So all images are held back until the late camera's have arrived.
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
"""Number of a camera's last frame intervals, whose median is its period; also of its last latencies."""
FEWEST: Final = 5
"""Least number of intervals for a period."""
OVERDUE: Final = 1.5
"""Time after a camera's last image until its next one is no longer expected, in periods."""
NEARER: Final = 0.125
"""Least decrease of the time span of a frame's images for which the frame waits, in periods."""
LONGEST: Final = 2.0
"""Longest time for which a frame waits for better images, in periods."""
LATE, LATE_AGAIN = 1.0, 0.5
"""Latency above the least one from which a camera counts as late, and below which no longer, in periods."""
STEADY: Final = 0.5
"""Largest interquartile range of a camera's latency at which it is known, in periods."""
LATEST_S: Final = 0.5
"""Largest latency above the least one that the other cameras wait for; it limits the number of images kept [s]."""


class PictureSet(msgspec.Struct, frozen=True, eq=False):
    """Images of one instant.

    Attributes:
        time_ns: midpoint of the earliest and the latest capture time, on the clock of the images [ns].
        pictures: the images, by camera, each within half a period of ``time_ns``; cameras without such an image are
            missing.
    """

    time_ns: int
    pictures: Mapping[str, Picture]


class _Camera:
    """A camera's newest unread image, the images held back, and the statistics of its period and latency."""

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
        """Update period and latency from the next image."""
        before, self._came = self._came, picture
        if before is not None and picture.number > before.number:
            self._intervals.append((picture.time_ns - before.time_ns) / (picture.number - before.number))
        self._late.append(picture.ready_s * NS_PER_S - picture.time_ns)

    def give(self, picture: Picture, out_s: float) -> None:
        """Make an image the newest; an unread one before it is dropped."""
        self.dropped += self.fresh is not None
        self.fresh = self.last = picture
        self.last_out_s = max(out_s, picture.ready_s)

    @property
    def period_ns(self) -> float | None:
        """The camera's period; None while unknown."""
        known = sorted(self._intervals)
        return known[len(known) // 2] if len(known) >= FEWEST else None

    def late_ns(self, period_ns: float) -> float | None:
        """Median latency (arrival minus capture time) [ns]; None while it is unknown or varies, see `STEADY`."""
        known = sorted(self._late)
        count = len(known)
        if count <= FEWEST or known[3 * count // 4] - known[count // 4] > STEADY * period_ns:
            return None
        return known[count // 2]

    def expected_ns(self, usual_ns: float, now_s: float, *, first: bool) -> float:
        """Expected capture time of its next image; infinite if that is overdue.

        With ``first``, a camera without any image yet is expected at once.
        """
        if self.last is None:
            return -math.inf if first else math.inf
        period_ns = self.period_ns or usual_ns
        overdue = now_s > self.last_out_s + OVERDUE * period_ns / NS_PER_S
        return math.inf if overdue else self.last.time_ns + period_ns

    def silent(self, usual_ns: float, now_s: float) -> bool:
        """Whether it has been silent for so long that the others do not wait for it."""
        period_ns = self.period_ns or usual_ns
        return self._came is None or now_s > self._came.ready_s + LATEST_S + OVERDUE * period_ns / NS_PER_S


class NewestInstant:
    """Synchroniser of the newest images of several cameras: `add` images as they arrive, `take` frames.

    Args:
        cameras: names of the cameras.
        period_ns: frame period that is assumed until a camera's images show it [ns].

    Raises:
        SettingsError: ``period_ns`` is not above 0 and finite.
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
        """The median of the cameras' known frame periods; the assumed period while none is known [ns]."""
        known = sorted(one.period_ns for one in self._cameras.values() if one.period_ns)
        return known[len(known) // 2] if known else self._first_ns

    @property
    def dropped(self) -> dict[str, int]:
        """Number of images that newer ones replaced before `take`, or that `drop_rest` dropped, by camera."""
        return {name: camera.dropped for name, camera in self._cameras.items()}

    @property
    def pending(self) -> bool:
        """Whether there is an image that `take` has not returned yet, also one that is held back."""
        return any(camera.fresh is not None or camera.held for camera in self._cameras.values())

    @property
    def held_ns(self) -> float | None:
        """Latency of the late camera, to which the others' images are delayed [ns]; None if no camera is late."""
        return self._out_ns

    def late_ns(self) -> dict[str, float]:
        """Return each camera's latency relative to the camera with the least latency [ns], as far as known."""
        period = self.period_ns
        known = {name: late for name, one in self._cameras.items() if (late := one.late_ns(period)) is not None}
        least = min(known.values(), default=0.0)
        return {name: late - least for name, late in known.items()}

    def add(self, name: str, picture: Picture) -> None:
        """Add a camera's next image, in the order of capture; it replaces an earlier one that was not taken.

        While images are held back for a late camera, it is queued instead.
        """
        camera = self._cameras[name]
        camera.came(picture)
        if self._out_ns is None:
            camera.give(picture, picture.ready_s)
        else:
            camera.held.append(picture)

    def begin(self) -> None:
        """Begin a new run: discard all images and the counts of dropped ones, but keep periods and latencies."""
        for camera in self._cameras.values():
            camera.fresh, camera.dropped = None, 0
            camera.held.clear()
        self._last_ns = self._since_s = None

    def drop_rest(self) -> None:
        """Drop and count the unread images: at the end, the last ones may be too near the last frame."""
        for camera in self._cameras.values():
            camera.dropped += (camera.fresh is not None) + len(camera.held)
            camera.fresh = None
            camera.held.clear()

    def take(self, now_s: float) -> PictureSet | None:
        """Take the newest images, each once; None if there is none, or a better one is about to arrive.

        Times of successive frames differ by at least half a period, so that jitter of the cameras' clocks does not
        appear as speed. An image more than a period older than the newest one is not taken.

        Args:
            now_s: the present time on the monotonic clock, as the images' ``ready_s`` [s]; infinite if no more images
                will arrive.
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
        """Determine whether a camera is late, and release held images that are old enough."""
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
        """Whether a missing camera's image is about to arrive, or some cameras' next images fit the others better."""
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
