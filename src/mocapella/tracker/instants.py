"""Collect the frames of free-running cameras into instants, each with at most one frame a camera.

An instant spans at most one frame period of the fastest camera. It is complete when every camera whose next frame is
due has delivered; else the next frame of a camera that is already in it, or one after the span, completes it. So a
camera that stops or is late delays the others by at most one period, and its late frames join the next instant. Late
frames alone make no instant. Of several late frames of a camera, the newest counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.model.keypoints import KeypointFrame

FIRST_PERIOD_NS: Final = 40_000_000
"""Frame period that is assumed of a camera before its second frame, if no other camera has a shorter one [ns]."""
FORGETS: Final = 0.2
"""Weight of a new interval in the running mean of a camera's period."""

MOST_DETECTIONS: Final = 32
"""Detections of one image that are used, those with most confidence first."""


class InstantFrame(msgspec.Struct, frozen=True, eq=False):
    """A frame and its capture time ``at_ns`` on the common clock [ns]."""

    frame: KeypointFrame
    at_ns: int


class CameraInstant(msgspec.Struct, frozen=True, eq=False):
    """Frames of one instant.

    Attributes:
        at_ns: the newest capture time of its frames, not before that of the last instant, on the common clock [ns].
        frames: the frames, by sensor, in the order of the sensors' names.
    """

    at_ns: int
    frames: Mapping[str, InstantFrame]


class Instants:
    """Collects frames into instants; see the module.

    Args:
        silent_after_s: a camera without a frame for longer is not waited for [s].
        cameras: number of all cameras, for which the first instant waits.
    """

    def __init__(self, silent_after_s: float, cameras: int = 0) -> None:
        self._silent_after_ns = round(silent_after_s * NS_PER_S)
        self._cameras = cameras
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._open: dict[str, InstantFrame] = {}
        self._heard_ns: dict[str, int] = {}
        self._period_ns: dict[str, float] = {}
        self._last_ns: int | None = None

    @property
    def newest_ns(self) -> int | None:
        """Capture time of the last instant [ns]; None before the first."""
        return self._last_ns

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in MEMORY}

    def active(self) -> list[str]:
        """Return the names of the cameras that are not silent, sorted."""
        return self._heard_within(self._silent_after_ns)

    def present(self, within_s: float) -> list[str]:
        """Return the names of the cameras with a frame within a time before the newest frame [s], sorted."""
        return self._heard_within(round(within_s * NS_PER_S))

    def _heard_within(self, within_ns: int) -> list[str]:
        if not self._heard_ns:
            return []
        since = max(self._heard_ns.values()) - within_ns
        return sorted(name for name, at_ns in self._heard_ns.items() if at_ns >= since)

    def update(self, frame: KeypointFrame, at_ns: int) -> list[CameraInstant]:
        """Add a frame, and return the instants that it completes, in order: none, one or two.

        Args:
            frame: the frame, newer than the camera's last one.
            at_ns: its capture time on the common clock [ns].
        """
        name, done = frame.sensor, []
        last = self._heard_ns.get(name)
        if last is not None and 0 < at_ns - last < self._silent_after_ns:
            known = self._period_ns.get(name, float(at_ns - last))
            self._period_ns[name] = known + FORGETS * (at_ns - last - known)
        self._heard_ns[name] = at_ns if last is None else max(at_ns, last)
        # A camera's second frame is expected after the period of the fastest camera that has one.
        first = min([FIRST_PERIOD_NS, *self._period_ns.values()])
        periods = {one: self._period_ns.get(one, first) for one in self.active()}
        span = min(periods.values())
        fresh = self._fresh()
        if name in fresh or (fresh and at_ns - min(fresh.values()) >= span):
            done.append(self._close())
        self._open[name] = InstantFrame(frame, at_ns)
        fresh = self._fresh()
        if not fresh or (self._last_ns is None and len(self._open) < self._cameras):
            return done
        until = max(fresh.values()) + 0.5 * span
        if any(one not in fresh and self._heard_ns[one] + period <= until for one, period in periods.items()):
            return done  # the frame of a camera is due soon
        return [*done, self._close()]

    def _fresh(self) -> dict[str, int]:
        """Return the capture times of the collected frames that are newer than the last instant, by camera [ns]."""
        since = self._last_ns
        return {name: one.at_ns for name, one in self._open.items() if since is None or one.at_ns > since}

    def collected(self) -> CameraInstant | None:
        """Return the next instant with the frames that it has so far; None without a frame newer than the last one."""
        return self._gathered() if self._fresh() else None

    def _gathered(self) -> CameraInstant:
        at_ns = max(one.at_ns for one in self._open.values())
        if self._last_ns is not None:
            at_ns = max(at_ns, self._last_ns)
        return CameraInstant(at_ns, dict(sorted(self._open.items())))

    def _close(self) -> CameraInstant:
        instant = self._gathered()
        self._open, self._last_ns = {}, instant.at_ns
        return instant


def most_confident(frame: KeypointFrame) -> Any:
    """Return the indices of the detections that are used, in their order."""
    if len(frame.ids) <= MOST_DETECTIONS:
        return np.arange(len(frame.ids))
    return np.sort(np.argsort(-frame.confidences.sum(axis=1), kind="stable")[:MOST_DETECTIONS])


MEMORY: Final = ("_open", "_heard_ns", "_period_ns", "_last_ns")
"""Attributes of `Instants` that are its state."""
