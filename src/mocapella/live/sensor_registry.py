"""Which node serves which sensor, and how each does. Time is an argument."""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass, field

from mocapella.errors import WireError
from mocapella.model.frame_types import frame_type_of, what_it_sends
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SensorHealth, Setup
from mocapella.wire.clock import ClockEstimate, SensorClock
from mocapella.wire.keys import NodeKey

SILENT_AFTER_S = 2.0
"""A sensor that has sent nothing for so long is called silent."""
_RECENT_S = 3.0
_REASONS_TOLD = 32
"""Of one node; what sends nonsense must not fill the memory with reasons."""


@dataclass
class _Seat:
    """A sensor's name and the node that holds it."""

    node: NodeKey
    connected: bool = False
    left: bool = False
    local: bool = False
    clock: SensorClock = field(default_factory=SensorClock)
    offset: ClockEstimate | None = None
    last_frame: SensorFrame | None = None
    heard_ns: int = 0
    silent: bool = False
    frames: int = 0
    skipped: int = 0
    rejected: int = 0
    rejection: str = ""
    told: set[str] = field(default_factory=set)
    arrivals: deque[int] = field(default_factory=lambda: deque(maxlen=256))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=256))

    def may_speak(self, now_ns: int) -> bool:
        """Whether a node without a token can be believed to be there still."""
        return not self.left and now_ns - self.heard_ns < SILENT_AFTER_S * 1e9


class SensorRegistry:
    """The sensors that there are. None is announced beforehand: the first node to use a name holds it.

    A name is free again when its node has left the bus, or never showed a liveliness token and has been silent.
    """

    def __init__(self) -> None:
        self._seats: dict[str, _Seat] = {}
        self._refused: set[NodeKey] = set()
        self._notices: list[str] = []

    def admit(self, node: NodeKey, now_ns: int) -> str:
        """Give the node the sensor's name, or say why not; empty when it holds the name."""
        seat = self._seats.get(node.sensor)
        if seat is not None and seat.node == node:
            return ""
        if seat is not None and (seat.connected or seat.may_speak(now_ns)):
            return self._refuse(node)
        self._seats[node.sensor] = _Seat(node, heard_ns=now_ns)
        self._notices.append(f'sensor "{node.sensor}" ' + ("has a new node" if seat else "is here"))
        return ""

    def set_connected(self, node: NodeKey, connected: bool, now_ns: int) -> None:
        """The node's liveliness token came or went."""
        if connected:
            if self.admit(node, now_ns) == "":
                self._seats[node.sensor].connected = True
                self._seats[node.sensor].left = False
            return
        self._refused.discard(node)
        if self.holds(node):
            self._seats[node.sensor].connected = False
            self._seats[node.sensor].left = True
            self._notices.append(f'sensor "{node.sensor}" left the session')

    def holds(self, node: NodeKey) -> bool:
        """Whether the node holds its sensor's name."""
        seat = self._seats.get(node.sensor)
        return seat is not None and seat.node == node

    def set_local(self, node: NodeKey, local: bool) -> None:
        """Whether the node runs on the server's machine."""
        if self.holds(node):
            self._seats[node.sensor].local = local

    def set_clock(self, node: NodeKey, offset: ClockEstimate) -> None:
        """The node's clock was measured."""
        if self.holds(node):
            self._seats[node.sensor].offset = offset

    def arrived(self, frame: SensorFrame, node: NodeKey, arrived_ns: int) -> int:
        """A frame of the node that holds the name; returns its capture time on the server's clock [ns].

        Raises:
            WireError: its number is not above that of the last frame. A take tells frames apart by their numbers.
        """
        seat = self._seats[node.sensor]
        if seat.last_frame is not None:
            last = seat.last_frame.sequence
            if frame.sequence <= last:
                raise WireError(
                    f"{type(frame).__name__}.sequence is {frame.sequence} after {last}; count the frames 0, 1, 2, …, "
                    "and take a new node id at each start"
                )
            seat.skipped += frame.sequence - last - 1
        if seat.silent:
            self._notices.append(f'sensor "{node.sensor}" is back')
        seat.last_frame, seat.heard_ns, seat.silent = frame, arrived_ns, False
        seat.rejection = ""
        seat.frames += 1
        seat.arrivals.append(arrived_ns)
        return seat.clock.update(frame.time_ns, arrived_ns)

    def rejected(self, node: NodeKey, reason: str) -> None:
        """A message of the node was refused at the door, or by the tracker. Each reason is told once."""
        if self.holds(node):
            seat = self._seats[node.sensor]
            if reason not in seat.told and len(seat.told) < _REASONS_TOLD:
                seat.told.add(reason)
                self._notices.append(f'sensor "{node.sensor}": {reason}')
            seat.rejected += 1
            seat.rejection = reason

    def finished(self, node: NodeKey, sent_ns: int, now_ns: int) -> float | None:
        """The frame's result is out; returns the time from publish to result [s], None where clocks are unknown."""
        seat = self._seats[node.sensor]
        if seat.offset is None or sent_ns == 0:
            return None
        latency = (now_ns - (sent_ns - seat.offset.offset_ns)) / 1e9
        seat.latencies.append(latency)
        return latency

    def notice_silence(self, now_ns: int) -> None:
        """Find the sensors that have fallen silent since the last call."""
        for name, seat in self._seats.items():
            if seat.frames and not seat.silent and now_ns - seat.heard_ns > SILENT_AFTER_S * 1e9:
                seat.silent = True
                self._notices.append(f'sensor "{name}" has sent nothing for {SILENT_AFTER_S:g} s')

    def take_notices(self) -> list[str]:
        """What has happened since the last call, in words."""
        notices, self._notices = self._notices, []
        return notices

    def newest(self) -> dict[NodeKey, int]:
        """The number of each node's newest frame that was let in."""
        seats = self._seats.values()
        return {seat.node: seat.last_frame.sequence for seat in seats if seat.last_frame is not None}

    def nodes(self) -> list[NodeKey]:
        """The nodes that hold names, are connected and speak: those that would answer."""
        return [seat.node for seat in self._seats.values() if seat.connected and not seat.silent]

    def health(self, now_ns: int, setup: Setup, stored: dict[str, int], lost: dict[str, int]) -> list[SensorHealth]:
        """One row for each sensor, by name; ``stored`` and ``lost`` are the record path's counts by sensor."""
        self.notice_silence(now_ns)
        return [
            _health(seat, now_ns, setup, stored.get(name, 0), lost.get(name, 0))
            for name, seat in sorted(self._seats.items())
        ]

    def _refuse(self, node: NodeKey) -> str:
        message = f"another node serves the sensor {node.sensor}; give this one another with --name, or end that node"
        if node not in self._refused:
            self._refused.add(node)
            self._notices.append(f"a second node under the name {node.sensor} was refused ({node.node_id:016x})")
        return message


def _health(seat: _Seat, now_ns: int, setup: Setup, stored: int, lost: int) -> SensorHealth:
    frame = seat.last_frame
    recent = [t for t in seat.arrivals if now_ns - t < _RECENT_S * 1e9]
    span = (recent[-1] - recent[0]) / 1e9 if len(recent) > 1 else 0.0
    pose = setup.sensors.get(seat.node.sensor)
    kind = None if frame is None else frame_type_of(frame)
    silent = seat.silent or not seat.frames
    if not seat.connected and silent:
        problem = "gone"
    elif seat.silent:
        problem = f"silent for {(now_ns - seat.heard_ns) / 1e9:.0f} s"
    else:
        problem = seat.rejection
    return SensorHealth(
        name=seat.node.sensor,
        node_id=seat.node.node_id,
        connected=seat.connected,
        silent=silent,
        local=seat.local,
        bodies=frame.bodies if frame is not None and not silent else 0,
        rate_hz=round((len(recent) - 1) / span, 2) if span > 0 else 0.0,
        latency=statistics.median(seat.latencies) if seat.latencies else None,
        frames=seat.frames,
        dropped=seat.skipped,
        rejected=seat.rejected,
        clock_offset=seat.offset.offset if seat.offset else None,
        clock_bound=seat.offset.bound if seat.offset else None,
        stored=stored,
        lost=lost,
        tilt=pose.tilt if pose else getattr(frame, "tilt", 0.0),  # a camera of markers says nothing of it
        height=pose.height if pose else getattr(frame, "height", 0.0),
        problem=problem,
        pictures=kind is not None and kind.pictures,
        sends="skeletons" if frame is None else what_it_sends(frame),
        capture_offset=None if seat.clock.offset_ns is None else seat.clock.offset_ns / 1e9,
    )
