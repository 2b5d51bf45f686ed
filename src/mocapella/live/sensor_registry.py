"""Registry of sensors: which node serves each, and its health (rate, gaps, clock offset). Time is an argument.

A *node* is the process that serves a sensor. At most one node *holds* a sensor's name, and thus has a *seat*: only its
frames are tracked. A second node with that name is refused.
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from mocapella.errors import WireError
from mocapella.live.sequence_leaps import check_leap
from mocapella.model.frame_types import frame_type_of, what_it_sends
from mocapella.model.limits import MOST_REFUSED_NODES, MOST_SENSORS, MOST_UNPROVEN, UNPROVEN_S
from mocapella.model.pace import Pace
from mocapella.model.scene import SensorPlace
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SensorHealth, Setup
from mocapella.wire.clock import POOR_BOUND_S, ClockEstimate, ClockProbe, OffsetFilter, SensorClock
from mocapella.wire.keys import NodeKey

HOLDS_FOR_S: Final = 2.0
"""Time without a frame after which a node without a liveliness token no longer holds its name [s]."""
STOOD_STILL_S: Final = 0.5
"""Time between two checks for silence above which the server itself must have been suspended [s]."""
_RECENT_S = 3.0
_MOST_REASONS = 32
"""Largest number of different reasons reported for one node, so that a faulty node does not fill the memory."""


class NodeStanding(Enum):
    """Whether a node that sends a message is admitted.

    Attributes:
        SEATED: yes: it holds its sensor's name.
        STRANGER: not yet: no node holds its sensor's name, which it can get with `SensorRegistry.admit`.
        REFUSED: no: another node holds its sensor's name.
    """

    SEATED = "seated"
    STRANGER = "stranger"
    REFUSED = "refused"


@dataclass
class _Entry:
    """A sensor's name, the node that holds it, and statistics."""

    node: NodeKey
    connected: bool = False
    left: bool = False
    local: bool = False
    clock: SensorClock = field(default_factory=SensorClock)
    offset: OffsetFilter = field(default_factory=OffsetFilter)
    last_frame: SensorFrame | None = None
    heard_ns: int = 0
    pace: Pace = field(default_factory=Pace)
    silent: bool = False
    poor_clock: bool = False
    frames: int = 0
    skipped: int = 0
    behind: int = 0
    before: tuple[int, int] | None = (0, 0)
    rejected: int = 0
    rejection: str = ""
    reported: set[str] = field(default_factory=set)
    arrivals: deque[int] = field(default_factory=lambda: deque(maxlen=256))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=256))

    def may_run(self, now_ns: int) -> bool:
        """Whether a node without a liveliness token was heard so recently that it holds its name."""
        return not self.left and now_ns - self.heard_ns < HOLDS_FOR_S * 1e9


class SensorRegistry:
    """The sensors of a session. None is configured beforehand: the first node to use a name holds it.

    The registry has no lock of its own: threads that share it need one.

    A name is free again when its node has left the bus, or is silent and never had a liveliness token.

    A sensor is unproven until a valid frame of it has come. There are at most `MOST_UNPROVEN` of these, and at most
    `MOST_SENSORS` others.

    Attributes:
        turned_away: number of sensors refused because the limit is reached.
    """

    def __init__(self) -> None:
        self.turned_away = 0
        self._entries: dict[str, _Entry] = {}
        self._tokens: set[NodeKey] = set()
        self._refused: set[NodeKey] = set()
        self._notices: list[str] = []
        self._looked_ns: int | None = None

    def standing(self, node: NodeKey, now_ns: int) -> NodeStanding:
        """Return whether a node that sends a message is admitted; a stranger stays unknown.

        Args:
            node: the node.
            now_ns: the present time on the server's monotonic clock [ns].
        """
        entry = self._entries.get(node.sensor)
        if entry is not None and entry.node == node:
            return NodeStanding.SEATED
        if entry is not None and (entry.connected or entry.may_run(now_ns)):
            self._refuse(node)
            return NodeStanding.REFUSED
        return NodeStanding.STRANGER

    def join(self, node: NodeKey, now_ns: int) -> str:
        """Give the node its sensor's name if the limits allow it; return why it was refused, or an empty text.

        Beyond the limit of unproven sensors, the node gets the name with its first valid frame.

        Args:
            node: the node.
            now_ns: the present time on the server's monotonic clock [ns].
        """
        if self.standing(node, now_ns) is NodeStanding.REFUSED:
            return _taken(node)
        self.admit(node, now_ns)
        return ""

    def admit(self, node: NodeKey, now_ns: int, *, proven: bool = False, quiet: bool = False) -> str:
        """Give the node the sensor's name; return why it was refused, or an empty text.

        Args:
            node: the node.
            now_ns: the present time on the server's monotonic clock [ns].
            proven: whether it has sent a valid frame; `arrived` is called next with that frame.
            quiet: whether to make no notice, because its message was not a valid frame.
        """
        entry = self._entries.get(node.sensor)
        if entry is not None and entry.node == node:
            return ""
        if entry is not None and (entry.connected or entry.may_run(now_ns)):
            return self._refuse(node)
        if entry is None and not proven and not self._make_room(now_ns, proven=False):
            self.turned_away += 1
            return f"no seat is free for the sensor {node.sensor}: {MOST_UNPROVEN} others have not sent a frame yet"
        self._entries[node.sensor] = _Entry(node, heard_ns=now_ns, connected=node in self._tokens)
        if not quiet:
            self._notices.append(f'sensor "{node.sensor}" ' + ("has a new node" if entry else "is here"))
        return ""

    def _make_room(self, now_ns: int, *, proven: bool) -> bool:
        """Whether there is room for one more sensor; if need be, remove the disconnected one that is silent longest."""
        kind = [entry for entry in self._entries.values() if bool(entry.frames) == proven]
        if len(kind) < (MOST_SENSORS if proven else MOST_UNPROVEN):
            return True
        free = [entry for entry in kind if not entry.connected and not (proven and entry.may_run(now_ns))]
        if not free:
            return False
        del self._entries[min(free, key=lambda entry: entry.heard_ns).node.sensor]
        return True

    def set_connected(self, node: NodeKey, connected: bool, now_ns: int) -> None:
        """Record that a node's liveliness token has appeared on the bus, or disappeared.

        A token gives the node its sensor's name, if that is free. When the token disappears, the name is free again.

        Args:
            node: the node.
            connected: whether the token is present.
            now_ns: the present time on the server's monotonic clock [ns].
        """
        if connected:
            if len(self._tokens) < MOST_REFUSED_NODES:
                self._tokens.add(node)
            if self.admit(node, now_ns) == "":
                self._entries[node.sensor].connected = True
                self._entries[node.sensor].left = False
            return
        self._tokens.discard(node)
        self._refused.discard(node)
        if self.holds(node):
            self._entries[node.sensor].connected = False
            self._entries[node.sensor].left = True
            self._notices.append(f'sensor "{node.sensor}" left the session')

    def holds(self, node: NodeKey) -> bool:
        """Whether the node holds its sensor's name."""
        entry = self._entries.get(node.sensor)
        return entry is not None and entry.node == node

    def proven(self, node: NodeKey) -> bool:
        """Whether the node holds its sensor's name and has sent a valid frame."""
        return self.holds(node) and self._entries[node.sensor].frames > 0

    def set_local(self, node: NodeKey, local: bool) -> None:
        """Set whether the node runs on the server's machine."""
        if self.holds(node):
            self._entries[node.sensor].local = local

    def compare_clock(self, node: NodeKey, probes: Iterable[ClockProbe], now_ns: int) -> ClockEstimate | None:
        """Use further probes of the node's clock; return the estimate of its offset, None if there is none.

        Args:
            node: the node; ignored if another holds the name.
            probes: further clock probes, in the order of their times.
            now_ns: the present time on the server's monotonic clock [ns].
        """
        if not self.holds(node):
            return None
        entry = self._entries[node.sensor]
        restarts = entry.offset.restarts
        entry.offset.update(probes)
        if entry.offset.restarts > restarts:
            self._notices.append(f'sensor "{node.sensor}": its clock jumped against the server\'s')
        return entry.offset.estimate(now_ns)

    def arrived(self, frame: SensorFrame, node: NodeKey, arrived_ns: int) -> int:
        """Count a frame of the node that holds the name; return its capture time on the server's clock [ns].

        The node must hold the name (`holds`); ``arrived_ns`` is on the server's monotonic clock.

        Raises:
            WireError: its sequence number, the identity of frames in a take, is not above the last one, or leaps too
                far (`check_leap`); or it is the first, and there are `MOST_SENSORS` others.
        """
        entry = self._entries[node.sensor]
        if not entry.frames and not self._make_room(arrived_ns, proven=True):
            self.turned_away += 1
            raise WireError(f"there are {MOST_SENSORS} sensors already; end one of them")
        if entry.last_frame is not None:
            last = entry.last_frame.sequence
            if frame.sequence <= last:
                raise WireError(
                    f"{type(frame).__name__}.sequence is {frame.sequence} after {last}; count the frames 0, 1, 2, …, "
                    "and take a new node id at each start"
                )
            check_leap(frame.sequence, last, (arrived_ns - entry.heard_ns) / 1e9)
            entry.skipped += frame.sequence - last - 1
        if entry.silent:
            self._notices.append(f'sensor "{node.sensor}" is back')
        entry.pace.update(arrived_ns)
        entry.last_frame, entry.heard_ns, entry.silent = frame, arrived_ns, False
        entry.rejection = ""
        if entry.before is None:
            entry.before = entry.frames, entry.skipped
        entry.frames += 1
        entry.arrivals.append(arrived_ns)
        return entry.clock.update(frame.time_ns, arrived_ns)

    def tracking_began(self) -> None:
        """Note that tracking starts: a sensor's frames and losses before its next frame are reported separately."""
        for entry in self._entries.values():
            entry.before = None

    def fell_behind(self, node: NodeKey, frames: int) -> None:
        """Count frames that the tracker skipped because newer ones were waiting; ignored if another holds the name."""
        if self.holds(node):
            self._entries[node.sensor].behind += frames

    def rejected(self, node: NodeKey, reason: str) -> None:
        """Count a message of the node that was not accepted or not usable; report each reason once."""
        if self.holds(node):
            entry = self._entries[node.sensor]
            if reason not in entry.reported and len(entry.reported) < _MOST_REASONS:
                entry.reported.add(reason)
                self._notices.append(f'sensor "{node.sensor}": {reason}')
            entry.rejected += 1
            entry.rejection = reason

    def finished(self, node: NodeKey, sent_ns: int, now_ns: int) -> float | None:
        """Count a published scene; return the latency [s] since its frame was sent, None if clocks are unknown.

        Args:
            node: the frame's node; it holds its sensor's name.
            sent_ns: when the frame was sent, on the node's clock [ns]; 0 if unknown.
            now_ns: the present time on the server's monotonic clock [ns].
        """
        entry = self._entries[node.sensor]
        offset_ns = entry.offset.offset_ns
        if offset_ns is None or sent_ns == 0:
            return None
        latency = (now_ns - (sent_ns - offset_ns)) / 1e9
        entry.latencies.append(latency)
        return latency

    def notice_silence(self, now_ns: int) -> None:
        """Mark sensors that are silent (`Pace.silent`) or poorly synchronised; forget unproven ones after `UNPROVEN_S`.

        Call it several times a second. After more than `STOOD_STILL_S` without a call, the server was suspended, so
        silences are counted anew from now on, once (`Pace.awake`).

        Args:
            now_ns: the present time on the server's monotonic clock [ns].
        """
        if self._looked_ns is not None and now_ns - self._looked_ns > STOOD_STILL_S * 1e9:
            for entry in self._entries.values():
                entry.pace.awake(now_ns)
        self._looked_ns = now_ns
        for name, entry in list(self._entries.items()):
            if not entry.frames and not entry.connected and now_ns - entry.heard_ns > UNPROVEN_S * 1e9:
                del self._entries[name]
        for name, entry in self._entries.items():
            if not entry.silent and entry.pace.silent(now_ns):
                entry.silent = True
                self._notices.append(f'sensor "{name}" has sent nothing for {entry.pace.silent_after_s:.2g} s')
            self._notice_clock(entry, now_ns)

    def _notice_clock(self, entry: _Entry, now_ns: int) -> None:
        clock = entry.offset.estimate(now_ns)
        if clock is None or entry.silent or not entry.connected:  # which is known already
            return
        name = entry.node.sensor
        if clock.poor and not entry.poor_clock:
            entry.poor_clock = True
            self._notices.append(f'sensor "{name}" is {_poor(clock)}')
        elif entry.poor_clock and clock.bound < POOR_BOUND_S / 2:
            entry.poor_clock = False
            self._notices.append(f'sensor "{name}" is well synchronised again')

    def take_notices(self) -> list[str]:
        """Return messages for users about the events since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def newest(self) -> dict[NodeKey, int]:
        """Return the sequence number of each node's newest accepted frame."""
        entries = self._entries.values()
        return {entry.node: entry.last_frame.sequence for entry in entries if entry.last_frame is not None}

    def connected(self) -> list[NodeKey]:
        """Return the nodes whose liveliness token is present."""
        return [entry.node for entry in self._entries.values() if entry.connected]

    def nodes(self) -> list[NodeKey]:
        """Return the nodes that are connected and not silent: those that would answer."""
        return [entry.node for entry in self._entries.values() if entry.connected and not entry.silent]

    def health(
        self,
        now_ns: int,
        setup: Setup,
        stored: dict[str, int],
        lost: dict[str, int],
        places: Sequence[SensorPlace] = (),
    ) -> list[SensorHealth]:
        """Return each sensor's health, sorted by name.

        Args:
            now_ns: the present time on the server's monotonic clock [ns].
            setup: the session's present configuration.
            stored: number of stored frames, by sensor.
            lost: number of lost frames, by sensor.
            places: the calibrated poses.
        """
        self.notice_silence(now_ns)
        placed = {place.sensor: place for place in places}
        return [
            _health(entry, now_ns, setup, stored.get(name, 0), lost.get(name, 0), place=placed.get(name))
            for name, entry in sorted(self._entries.items())
        ]

    def _refuse(self, node: NodeKey) -> str:
        if node not in self._refused and len(self._refused) < MOST_REFUSED_NODES:
            self._refused.add(node)
            self._notices.append(f"a second node under the name {node.sensor} was refused ({node.node_id:016x})")
        return _taken(node)


def _taken(node: NodeKey) -> str:
    return f"another node serves the sensor {node.sensor}; give this one another with --name, or end that node"


def _poor(clock: ClockEstimate) -> str:
    return f"poorly synchronised: its clock is known to ±{1e3 * clock.bound:.0f} ms"


def _health(
    entry: _Entry, now_ns: int, setup: Setup, stored: int, lost: int, *, place: SensorPlace | None
) -> SensorHealth:
    frame = entry.last_frame
    recent = [t for t in entry.arrivals if now_ns - t < _RECENT_S * 1e9]
    span = (recent[-1] - recent[0]) / 1e9 if len(recent) > 1 else 0.0
    pose = setup.sensors.get(entry.node.sensor)
    kind = None if frame is None else frame_type_of(frame)
    silent = entry.silent or not entry.frames
    if not entry.connected and silent:
        problem = "gone"
    elif entry.silent:
        problem = f"silent for {(now_ns - entry.heard_ns) / 1e9:.0f} s"
    else:
        problem = entry.rejection
    clock = entry.offset.estimate(now_ns)
    if clock is not None and clock.poor and not problem:
        problem = _poor(clock)
    frames_before, dropped_before = entry.before or (entry.frames, entry.skipped)
    return SensorHealth(
        name=entry.node.sensor,
        node_id=entry.node.node_id,
        connected=entry.connected,
        silent=silent,
        local=entry.local,
        bodies=frame.bodies if frame is not None and not silent else 0,
        rate_hz=round((len(recent) - 1) / span, 2) if span > 0 else 0.0,
        latency=statistics.median(entry.latencies) if entry.latencies else None,
        frames=entry.frames,
        dropped=entry.skipped,
        rejected=entry.rejected,
        clock_offset=clock.offset if clock else None,
        clock_bound=clock.bound if clock else None,
        stored=stored,
        lost=lost,
        tilt=pose.tilt if pose else getattr(frame, "tilt", 0.0),  # marker frames do not have it
        height=pose.height if pose else getattr(frame, "height", 0.0),
        problem=problem,
        pictures=kind is not None and kind.pictures,
        frames_before=frames_before,
        dropped_before=dropped_before,
        sends="skeletons" if frame is None else what_it_sends(frame),
        behind=entry.behind,
        calibration="" if place is None else place.problem or place.quality,
        capture_offset=None if entry.clock.offset_ns is None else entry.clock.offset_ns / 1e9,
        clock_drift_ppm=clock.drift_ppm if clock else None,
        clock_drift_bound_ppm=clock.drift_bound_ppm if clock else None,
        clock_poor=clock is not None and clock.poor,
    )
