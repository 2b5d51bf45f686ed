"""Frames that a program hands over, as a recording that is tracked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.live.new_take import NewTake
from mocapella.live.track_again import UNCHANGED, Changes, FrameToTrack, RunToTrack
from mocapella.model.observations import Arrival
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup
from mocapella.recording.take import TakeInfo
from mocapella.tracker.method import never_tracked


class GivenFrames:
    """Frames in the order of tracking.

    A frame alone is tracked at its own ``time_ns``, so all sensors must have one clock; an `Arrival` states the time.
    If two frames have the same identity, the frames of each sensor are numbered anew.

    Args:
        frames: the frames.
        changes: how they are tracked.
        setup: labels and the number of sensors to wait for; None for the number in ``frames``.

    Raises:
        InputError: there are no frames.
    """

    files: Final[tuple[Path, ...]] = ()
    missing: Final[list[str]] = []
    damaged: Final = False

    def __init__(
        self, frames: Iterable[SensorFrame | Arrival], changes: Changes = UNCHANGED, setup: Setup | None = None
    ) -> None:
        self._changes = changes
        self._arrivals = _numbered([one if isinstance(one, Arrival) else Arrival(one, one.time_ns) for one in frames])
        if not self._arrivals:
            raise InputError("there are no frames to track")
        self.sensors = tuple(sorted({arrival.frame.sensor for arrival in self._arrivals}))
        times = [arrival.at_ns for arrival in self._arrivals]
        self.seconds = (max(times) - min(times)) / NS_PER_S
        setup = setup or Setup(sensors_expected=len(self.sensors))
        self._info = changes.info(TakeInfo(setup, times[0], times[0]))

    def origin(self) -> None:
        """Return that the frames are of no recording."""

    def runs_to_track(self) -> list[RunToTrack]:
        """Return the frames as one run.

        Raises:
            InputError: the method takes none of the frames.
        """
        firsts = {arrival.frame.sensor: arrival.frame for arrival in reversed(self._arrivals)}
        reasons = [never_tracked(frame, self._info.method) for frame in firsts.values()]
        if all(reasons):
            raise InputError(f"the frames cannot be tracked: {reasons[0]}")
        return [RunToTrack(self._info, self._events(), self._changes.layout)]

    def _events(self) -> Iterator[FrameToTrack]:
        for arrival in self._arrivals:
            yield FrameToTrack(arrival, None, arrival.at_ns)

    def add_rest(self, take: NewTake) -> None:
        """Add what else there is: nothing."""

    def notes(self) -> dict[str, Any]:
        """Return that there are no problems."""
        return {"problems": []}


def _numbered(arrivals: list[Arrival]) -> list[Arrival]:
    if len({arrival.frame.key for arrival in arrivals}) == len(arrivals):
        return arrivals
    counts: dict[tuple[str, int], int] = {}
    found = []
    for arrival in arrivals:
        node = arrival.frame.key[:2]
        counts[node] = counts.get(node, -1) + 1
        frame = msgspec.structs.replace(arrival.frame, sequence=counts[node])
        found.append(Arrival(frame, arrival.at_ns))
    return found
