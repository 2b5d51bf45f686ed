"""Queue between the bus's threads and the tracker's: a short one for each sensor, which drops the oldest frames."""

from __future__ import annotations

import threading
from collections import deque
from typing import NamedTuple

from mocapella.wire.keys import NodeKey


class ReceivedMessage(NamedTuple):
    """A received message: its node, its bytes, and its arrival on the server's monotonic clock [ns]."""

    node: NodeKey
    data: bytes
    arrived_ns: int


class Inbox:
    """Messages of all sensors in the order of their arrival, at most the newest ``depth`` of each sensor.

    A tracker that falls behind loses the oldest frames of the fastest sensors (counted by the gap in their sequence
    numbers), and a sensor at ten times its rate cannot crowd out another.
    """

    def __init__(self, depth: int = 6) -> None:
        self._depth = depth
        self._queues: dict[NodeKey, deque[ReceivedMessage]] = {}
        self._ready = threading.Condition()
        self._woken = False

    def put(self, message: ReceivedMessage) -> None:
        """Add a message; on any thread."""
        with self._ready:
            queue = self._queues.setdefault(message.node, deque())
            if len(queue) >= self._depth:
                queue.popleft()
            queue.append(message)
            self._ready.notify()

    def wake(self) -> None:
        """Make a waiting `take` return at once."""
        with self._ready:
            self._woken = True
            self._ready.notify()

    def take(self, timeout: float) -> ReceivedMessage | None:
        """Remove and return the oldest message; None after ``timeout`` seconds or a `wake`."""
        with self._ready:
            if not self._queues and not self._woken:
                self._ready.wait(timeout)
            self._woken = False
            if not self._queues:
                return None
            queue = min(self._queues.values(), key=lambda queue: queue[0].arrived_ns)
            message = queue.popleft()
            if not queue:
                del self._queues[message.node]
            return message

    def forget(self, node: NodeKey) -> None:
        """Discard the messages of a node that has left."""
        with self._ready:
            self._queues.pop(node, None)
