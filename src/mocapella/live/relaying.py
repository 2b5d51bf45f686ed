"""Serve the sensors of programs that keep their frames until they are acknowledged, over the bridge.

Such a program numbers its frames, keeps them on its own disk, and sends them again after a bridge or its connection has
ended: the node has the program's id and numbers, also at the next bridge. An acknowledgement says that no take needs a
frame any more (docs/decisions/0041-kinect-v2-client.md).
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import UnstoredFramesError, WireError
from mocapella.live.node import Membership
from mocapella.live.node_disk import open_link
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.observations import BodyFrame
from mocapella.sources.bridge_messages import BridgeStart
from mocapella.wire.node import NodeStart

CALM_S: Final = 10.0
"""A server that is heard for this long and asks for no frames records none that are older [s].

A server asks the nodes of a take several times a second.
"""
HEARD_S: Final = 2.5
"""A server counts as heard if its last query is not older; it probes the clock each second [s]."""
FRESH_S: Final = 1.0
"""Older frames are recorded, but not published live [s]."""
SETTLE_S: Final = 3.0
"""How long the frames of a program that vanished are offered to a recording server [s]."""


class RelayedSensor:
    """The node of one program that keeps its frames.

    Args:
        connect: address of the server.
        start: the program's request.
        say: receives messages about the link.
        clock_ns: the monotonic clock [ns].

    Attributes:
        problem: after `end`, None until the sensor has left; then why its frames are not stored, or an empty text.
        unstored: then which frames of an open take are in a file of this machine; else empty.

    Raises:
        BusError, KeyFileError: as `mocapella.wire.node.NodeLink`.
    """

    def __init__(
        self,
        connect: str,
        start: BridgeStart,
        say: Callable[[str], None],
        *,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.problem: str | None = None
        self.unstored = ""
        self._say, self._clock_ns = say, clock_ns
        self._shift_ns = clock_ns() - start.now_ns
        self._live_from, self._acknowledged = start.next, start.first
        self._sent: deque[tuple[int, int]] = deque()
        self._calm_since_ns: int | None = None
        self._stop, self._hurry = threading.Event(), threading.Event()
        self._closing: threading.Thread | None = None
        self._stack = ExitStack()
        identity = NodeStart(start.node_id, start.first, start.lost)
        self._link = self._stack.enter_context(open_link(connect, start.sensor, say=say, start=identity))
        self._membership = Membership(self._link, self._stop, say)

    @property
    def closed(self) -> bool:
        """Whether the node has left the bus, after `end` or `gone`."""
        return self._closing is not None and not self._closing.is_alive()

    def frame(self, frame: BodyFrame) -> None:
        """Keep a frame for a recording server, and publish it unless it is old.

        Raises:
            NameTakenError: a server has refused the sensor's name.
            WireError: its number is not the next one.
        """
        self._raise_refusal()
        if frame.sequence != self._link.published:
            raise WireError(
                f"BodyFrame.sequence is {frame.sequence}, and {self._link.published} is next; "
                "connect again after a loss, and say in start how many frames are lost"
            )
        now_ns = self._clock_ns()
        sent_ns = min(now_ns, frame.sent_ns + self._shift_ns) if frame.sent_ns else now_ns
        live = frame.sequence >= self._live_from and now_ns - sent_ns < FRESH_S * NS_PER_S
        self._link.relay(msgspec.structs.replace(frame, sent_ns=sent_ns), live=live)
        self._sent.append((frame.sequence, sent_ns))

    def acknowledged(self) -> int:
        """Return the number below which no take needs the frames.

        Raises:
            NameTakenError: a server has refused the sensor's name.
        """
        self._raise_refusal()
        holds = self._link.outbox.holds
        if holds:
            self._calm_since_ns = None
            below = min(hold.stored for hold in holds.values())
        else:
            below = self._unwanted()
        if self.problem == "":  # it has left, and everything is stored
            below = self._link.published
        self._acknowledged = max(self._acknowledged, min(below, self._link.published))
        while self._sent and self._sent[0][0] < self._acknowledged:
            self._sent.popleft()
        return self._acknowledged

    def end(self) -> None:
        """Say to the server that no frame follows, and leave the bus once all are stored, on a thread of its own."""
        self._close(self._leave)

    def gone(self) -> None:
        """Leave the bus on a thread of its own, without an end of the sensor: its program may come back."""
        self._close(self._vanish)

    def hurry(self) -> None:
        """Let `gone` wait for no server; `end` still does."""
        self._hurry.set()

    def wait(self) -> None:
        """Wait until the node has left the bus."""
        if self._closing is not None:
            self._closing.join()

    def _raise_refusal(self) -> None:
        if self._membership.refusal is not None:
            raise self._membership.refusal

    def _unwanted(self) -> int:
        """Return the number below which frames are so old that a take would have asked for them."""
        now_ns = self._clock_ns()
        if now_ns / NS_PER_S - self._link.heard_s > HEARD_S or not self._membership.served.is_set():
            self._calm_since_ns = None
            return 0
        if self._calm_since_ns is None:
            self._calm_since_ns = now_ns
        before_ns = now_ns - round(CALM_S * NS_PER_S)
        if self._calm_since_ns > before_ns:
            return 0
        return next((number for number, sent_ns in self._sent if sent_ns > before_ns), self._link.published)

    def _close(self, how: Callable[[], None]) -> None:
        if self._closing is None:
            self._closing = threading.Thread(target=how, name="leaving")
            self._closing.start()

    def _leave(self) -> None:
        self._stop.set()
        self._membership.wait()
        problem = ""
        try:
            self._stack.close()
        except UnstoredFramesError as error:
            problem = self.unstored = str(error)
            self._say(problem)
        if not (problem or self._link.left):  # one that is away may have a take that needs them
            problem = (
                f"no server at {self._link.address} has heard the end of {self._link.node.sensor}; keep its frames"
            )
        self.problem = problem

    def _vanish(self) -> None:
        deadline_ns = self._clock_ns() + round(SETTLE_S * NS_PER_S)
        while not self._settled() and not self._hurry.wait(0.02) and self._clock_ns() < deadline_ns:
            pass
        self._stop.set()
        self._membership.wait()
        self._link.detach()
        self._stack.close()

    def _settled(self) -> bool:
        return all(hold.stored >= self._link.published for hold in self._link.outbox.holds.values())


class Relays:
    """The sensors of all programs that keep their frames: a `mocapella.sources.bridge_messages.Relay`.

    Args:
        connect: address of the server.
        say: receives messages about the sensors.
    """

    def __init__(self, connect: str, say: Callable[[str], None]) -> None:
        self._connect, self._say = connect, say
        self._sensors: dict[str, RelayedSensor] = {}
        self._unstored: list[str] = []

    def start(self, start: BridgeStart) -> int:
        """Begin to serve a sensor; return how many frames may be sent before they are acknowledged.

        Raises:
            WireError: the sensor's last connection is still being closed.
            BusError, KeyFileError: as `mocapella.wire.node.NodeLink`.
        """
        last = self._sensors.get(start.sensor)
        if last is not None and not last.closed:
            last.hurry()
            raise WireError(f"the last connection of sensor {start.sensor} is being closed; connect again in a second")
        if last is not None and last.unstored:
            self._unstored.append(last.unstored)
        self._sensors[start.sensor] = RelayedSensor(self._connect, start, self._say)
        if start.lost:
            self._say(f"{start.sensor}: its program has lost {start.lost} frames before frame {start.first}")
        return HISTORY_FRAMES

    def frame(self, frame: BodyFrame) -> None:
        """Take the next frame of a sensor; raises as `RelayedSensor.frame`."""
        self._sensors[frame.sensor].frame(frame)

    def acknowledged(self, sensor: str) -> int:
        """Return the number below which no take needs the sensor's frames; raises as `RelayedSensor.acknowledged`."""
        return self._sensors[sensor].acknowledged()

    def end(self, sensor: str) -> None:
        """Begin to leave: the sensor has no further frame."""
        self._sensors[sensor].end()

    def ended(self, sensor: str) -> str | None:
        """Return None until the sensor has left, then an empty text, or why its frames are not stored."""
        return self._sensors[sensor].problem

    def gone(self, sensor: str) -> None:
        """Note that the program's connection has ended."""
        self._sensors[sensor].gone()

    def close(self) -> list[str]:
        """Leave the bus with all sensors; return messages about frames that no server has stored.

        Programs that have not ended keep what is not stored.
        """
        for sensor in self._sensors.values():
            sensor.gone()
            sensor.hurry()
        for sensor in self._sensors.values():
            sensor.wait()
        return [*self._unstored, *(sensor.unstored for sensor in self._sensors.values() if sensor.unstored)]
