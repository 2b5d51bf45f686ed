"""Queue between the bus's threads and the tracker's: a short one for each sensor, which drops the oldest frames.

Nodes that hold no sensor's name yet are *strangers*, nodes *without a seat*. Their messages share one queue with a
limited rate, so that a flood of them delays no sensor.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

from mocapella.model.limits import STRANGERS_A_SECOND, STRANGERS_WAITING
from mocapella.wire.keys import NodeKey

_STRANGER_EVERY_NS: Final = 1_000_000_000 // STRANGERS_A_SECOND


class ReceivedMessage(NamedTuple):
    """A message from a node that waits for the tracker's thread.

    Attributes:
        node: the node that sent it.
        data: the encoded message.
        arrived_ns: its arrival on the server's monotonic clock [ns].
        stranger: whether the node did not hold its sensor's name when it arrived.
    """

    node: NodeKey
    data: bytes
    arrived_ns: int
    stranger: bool = False


class Inbox:
    """Messages of all sensors in the order of their arrival, at most the newest ``depth`` of each sensor.

    A tracker that falls behind loses the oldest frames of the fastest sensors, and a sensor at ten times its rate
    cannot crowd out another. The newest `STRANGERS_WAITING` messages of strangers are kept; at most
    `STRANGERS_A_SECOND` are taken each second.

    Args:
        depth: messages of a sensor that are kept.
        clock_ns: the monotonic clock [ns].

    Attributes:
        strangers_dropped: number of strangers' messages dropped without being decoded.
    """

    def __init__(self, depth: int = 6, *, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.strangers_dropped = 0
        self._depth, self._clock_ns = depth, clock_ns
        self._strangers: deque[ReceivedMessage] = deque()
        self._stranger_due_ns = 0
        self._skipped: Counter[NodeKey] = Counter()
        self._queues: dict[NodeKey, deque[ReceivedMessage]] = {}
        self._ready = threading.Condition()
        self._woken = False

    def put(self, message: ReceivedMessage) -> None:
        """Add a message, and drop the sensor's oldest one beyond ``depth``; on any thread."""
        with self._ready:
            if message.stranger:
                self._put_stranger(message)
                return
            queue = self._queues.setdefault(message.node, deque())
            if len(queue) >= self._depth:
                queue.popleft()
                self._skipped[message.node] += 1
            queue.append(message)
            self._ready.notify()

    def _put_stranger(self, message: ReceivedMessage) -> None:
        if len(self._strangers) >= STRANGERS_WAITING:
            self._strangers.popleft()
            self.strangers_dropped += 1
        self._strangers.append(message)
        if len(self._strangers) == 1:
            self._ready.notify()

    def wake(self) -> None:
        """Make a waiting `take` return at once."""
        with self._ready:
            self._woken = True
            self._ready.notify()

    def take(self, timeout: float) -> ReceivedMessage | None:
        """Remove and return a stranger's message if one is due, else the oldest message.

        Args:
            timeout: longest wait for a message [s].

        Returns:
            The message; None if none came before the timeout or a call of `wake`.
        """
        with self._ready:
            if not self._queues and not self._woken and not self._stranger_due():
                self._ready.wait(timeout)
            self._woken = False
            if self._stranger_due():
                self._stranger_due_ns = self._clock_ns() + _STRANGER_EVERY_NS
                return self._strangers.popleft()
            if not self._queues:
                return None
            queue = min(self._queues.values(), key=lambda queue: queue[0].arrived_ns)
            message = queue.popleft()
            if not queue:
                del self._queues[message.node]
            return message

    def _stranger_due(self) -> bool:
        return bool(self._strangers) and self._clock_ns() >= self._stranger_due_ns

    def take_skipped(self) -> dict[NodeKey, int]:
        """Return the number of each sensor's messages that were dropped for newer ones since the last call."""
        with self._ready:
            skipped, self._skipped = self._skipped, Counter()
            return dict(skipped)

    def forget(self, node: NodeKey) -> None:
        """Discard the messages of a node that has left."""
        with self._ready:
            self._queues.pop(node, None)
