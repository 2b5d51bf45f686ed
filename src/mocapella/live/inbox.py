"""Between the bus's threads and the tracker's: a short queue for each sensor, freshest first to survive."""

from __future__ import annotations

import threading
from collections import deque
from typing import NamedTuple

from mocapella.wire.keys import NodeKey


class Letter(NamedTuple):
    """A message as it came: from whom, what, and when on the server's monotonic clock [ns]."""

    node: NodeKey
    data: bytes
    arrived_ns: int


class Inbox:
    """Letters of all sensors in the order of their arrival; of a sensor that is ahead, only the newest ``depth``.

    A tracker that falls behind loses the oldest frames of the sensors that overrun it (the gap in their numbers counts
    them), and a sensor at ten times its rate cannot crowd out another.
    """

    def __init__(self, depth: int = 6) -> None:
        self._depth = depth
        self._queues: dict[NodeKey, deque[Letter]] = {}
        self._ready = threading.Condition()
        self._woken = False

    def put(self, letter: Letter) -> None:
        """Add a letter; called on any thread."""
        with self._ready:
            queue = self._queues.setdefault(letter.node, deque())
            if len(queue) >= self._depth:
                queue.popleft()
            queue.append(letter)
            self._ready.notify()

    def wake(self) -> None:
        """Make a waiting `take` return at once."""
        with self._ready:
            self._woken = True
            self._ready.notify()

    def take(self, timeout: float) -> Letter | None:
        """The oldest letter; None after ``timeout`` seconds or a `wake`."""
        with self._ready:
            if not self._queues and not self._woken:
                self._ready.wait(timeout)
            self._woken = False
            if not self._queues:
                return None
            queue = min(self._queues.values(), key=lambda queue: queue[0].arrived_ns)
            letter = queue.popleft()
            if not queue:
                del self._queues[letter.node]
            return letter

    def forget(self, node: NodeKey) -> None:
        """The node is gone for good."""
        with self._ready:
            self._queues.pop(node, None)
