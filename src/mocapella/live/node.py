"""One sensor's process: frames of a source, each at its time, onto the bus."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from mocapella.errors import NameTakenError, NoServerError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.truth import Truth
from mocapella.wire.node import NodeLink

_ASKED_IN_VAIN = 5
"""Joining takes some tries, because the connection is only just being made; so many, and a person is told."""


class DueFrame(NamedTuple):
    """A frame, what a simulation knows beside it, and when it is due, in seconds of the source's own time."""

    due_s: float
    frame: SensorFrame
    truth: Truth | None = None


@dataclass(frozen=True)
class NodeSummary:
    """What a node did.

    Attributes:
        sensor, node_id: who it was on the bus; the id as 16 hex digits.
        served: whether a server was there at any time, and gave the node its sensor's name.
        published: frames.
        late: of these, how many left more than 10 ms after they were due.
        worst_delay: of any frame [s].
        seconds: from the first frame's turn to the end [s].
    """

    sensor: str
    node_id: str
    served: bool
    published: int
    late: int
    worst_delay: float
    seconds: float


class Membership:
    """Keeps asking for the sensor's name until a server gives it, and again when a server comes back.

    Attributes:
        served: is set once a server has given the name.
        refusal: why a server did not.
    """

    def __init__(self, link: NodeLink, stop: threading.Event, say: Callable[[str], None]) -> None:
        self._link = link
        self._stop = stop
        self._say = say
        self.served = threading.Event()
        self.refusal: NameTakenError | None = None
        self._thread = threading.Thread(target=self._run, name="membership")
        self._thread.start()

    def wait_for_server(self) -> None:
        """Until a server has given the name, has refused it, or the stop event is set."""
        while not self.served.is_set() and not self._stop.wait(0.02):
            pass

    def wait(self) -> None:
        """Until it has stopped asking, after the stop event was set."""
        self._thread.join()

    def close(self) -> None:
        """As `wait`.

        Raises:
            NameTakenError: the name was refused.
        """
        self.wait()
        if self.refusal is not None:
            raise self.refusal

    def _run(self) -> None:
        sensor, address = self._link.node.sensor, self._link.address
        joined = False
        asked = 0
        while not self._stop.is_set():
            try:
                there = self._link.server_is_there() if joined else self._link.join()
            except NameTakenError as refusal:
                self.refusal = refusal
                self._stop.set()
                return
            asked += 1
            if asked == _ASKED_IN_VAIN and not self.served.is_set() and not there:
                self._say(f"{sensor}: waiting for a server at {address} (mocapella serve starts one)")
            if there and not joined:
                self.served.set()
                self._say(f"{sensor}: serving {address}")
            if joined and not there:
                self._say(f"{sensor}: the server at {address} is gone; frames are kept for it, looking again …")
            joined = there
            self._stop.wait(1.0 if joined else 0.2)


def run_node(
    link: NodeLink,
    frames: Callable[[], Iterable[DueFrame]],
    *,
    epoch: float | None,
    stop: threading.Event,
    wait: bool = True,
    say: Callable[[str], None] = lambda text: None,
    linger_s: float = 0.0,
) -> NodeSummary:
    """Publish every frame when it is due, until they end or ``stop`` is set.

    Args:
        link: the sensor's end of the bus; stays open.
        frames: makes them, in the order of their time; is called when the run begins.
        epoch: the Unix time [s] at which the source's time was 0; two nodes with one epoch are in step. None is when
            the run begins.
        stop: ends the run.
        wait: whether the run begins when a server is there, or at once.
        say: is told in words what happens.
        linger_s: how long to stay after the last frame, so that a recording server can fetch what it missed.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the frames have ended, and no server was ever there to receive them.
    """
    membership = Membership(link, stop, say)
    late, worst = 0, 0.0
    try:
        if wait:
            membership.wait_for_server()
        began = time.monotonic()
        zero = began if epoch is None else began + (epoch - time.time())
        for due in () if stop.is_set() else frames():
            if stop.wait(max(0.0, zero + due.due_s - time.monotonic())):
                break
            delay = time.monotonic() - (zero + due.due_s)
            late, worst = late + (delay > 0.010), max(worst, delay)
            link.publish(due.frame, due.truth)
        ended_by_itself = not stop.wait(linger_s)
    finally:
        stop.set()
        membership.close()
    if ended_by_itself and not membership.served.is_set():
        raise NoServerError(
            f"{link.node.sensor}: {link.published} frames went nowhere: no server was at {link.address}; "
            "start it first (mocapella serve)"
        )
    return NodeSummary(
        sensor=link.node.sensor,
        node_id=f"{link.node.node_id:016x}",
        served=membership.served.is_set(),
        published=link.published,
        late=late,
        worst_delay=round(worst, 4),
        seconds=round(time.monotonic() - began, 3),
    )
