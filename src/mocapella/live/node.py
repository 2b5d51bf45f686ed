"""A sensor's node: publishes the frames of a source, each at its time, and claims the sensor's name at the server."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from mocapella.errors import NameTakenError, NoServerError
from mocapella.live.due_frame import DueFrame
from mocapella.live.thread_deaths import StopEvent
from mocapella.live.wall_clock import WallClock
from mocapella.wire.node import NodeLink

ASK_AFTER_S: Final = 1.5
"""Time without a query of the server, which probes the clock each second, until the node queries the server [s]."""
ANSWER_S: Final = 0.8
"""Longest wait for the reply to that query; without one, the server is reported as hanging [s]."""
_LOOK_EVERY_S: Final = 0.5
_TRIES_BEFORE_NOTICE = 5
"""Failed attempts to join before the user is notified; the first fail while the connection is being made."""


@dataclass(frozen=True)
class NodeSummary:
    """Counts of a node.

    Attributes:
        sensor, node_id: its identity on the bus; the id as 16 hex digits.
        served: whether a server ever accepted the node.
        published: number of published frames.
        late: number of frames published more than 10 ms after they were due.
        worst_delay: largest delay of a frame [s].
        seconds: from the start of the run to the end [s].
        errors: number of unexpected errors, by reason.
    """

    sensor: str
    node_id: str
    served: bool
    published: int
    late: int
    worst_delay: float
    seconds: float
    errors: dict[str, int] = field(default_factory=dict)


class Membership:
    """Claims the sensor's name until a server accepts the node, and again when a server comes back.

    A thread, which the constructor starts, does so until ``stop`` is set. A server that hangs, or whose network is
    down, is reported within 3 s.

    Args:
        link: the sensor's end of the bus; stays open.
        stop: ends the thread; the thread sets it if a server refuses the name. If it is a `StopEvent`, its event
            ``died`` replaces ``link.hurry``: once a thread of the process has died, `NodeLink.close` no longer waits
            until the node's frames are acknowledged.
        say: receives messages about the server.
        clock: the monotonic clock, in seconds.

    Attributes:
        served: set once a server has accepted the node, and from then on.
        refusal: the error if a server has refused the name; else None.
        errors: unexpected errors of the thread and of the link.
    """

    def __init__(
        self,
        link: NodeLink,
        stop: threading.Event,
        say: Callable[[str], None],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link, self._clock = link, clock
        self._stop = stop
        self._say = say
        self.served = threading.Event()
        self.refusal: NameTakenError | None = None
        self.errors = link.errors
        if isinstance(stop, StopEvent):
            link.hurry = stop.died
        self._joined, self._still, self._tries = False, False, 0
        self._wall_clock = WallClock()
        self._thread = threading.Thread(target=self._run, name="membership")
        self._thread.start()

    def wait_for_server(self) -> None:
        """Wait until a server has accepted or refused the node, or the stop event is set."""
        while not self.served.is_set() and not self._stop.wait(0.02):
            pass

    def wait(self) -> None:
        """Wait until the thread has ended; it ends only after the stop event was set."""
        self._thread.join()

    def close(self) -> None:
        """Wait as `wait` does, then raise ``refusal``, if any.

        Raises:
            NameTakenError: a server refused the name.
        """
        self.wait()
        if self.refusal is not None:
            raise self.refusal

    def _run(self) -> None:
        while not self._stop.is_set():
            self.errors.run("server", self._look)
            step = self._wall_clock.step()
            if step:
                self._say(f"{self._link.node.sensor}: {step}")
            self._stop.wait(_LOOK_EVERY_S if self._joined or self._link.put_off else 0.2)

    def _look(self) -> None:
        sensor, address = self._link.node.sensor, self._link.address
        try:
            there = self._link.server_is_there() if self._joined else self._link.join()
            if there and self._joined:
                self._hear()
        except NameTakenError as refusal:
            self.refusal = refusal
            self._stop.set()
            return
        self._tries += 1
        if self._tries == _TRIES_BEFORE_NOTICE and not self.served.is_set() and not there:
            waiting = f"waiting for a server at {address} (mocapella serve starts one)"
            self._say(f"{sensor}: {self._link.why_not_admitted() or waiting}")
        if there and not self._joined:
            self.served.set()
            self._say(f"{sensor}: serving {address}")
        if self._joined and not there:
            self._still = False
            self._say(f"{sensor}: the server at {address} is gone; frames are kept for it, looking again …")
        self._joined = there

    def _hear(self) -> None:
        """Query a connected server that has sent no query for a while, and report whether it answers."""
        sensor, address, silent_s = self._link.node.sensor, self._link.address, self._clock() - self._link.heard_s
        if silent_s > ASK_AFTER_S and not self._link.join(ANSWER_S):
            if not self._still:
                why = "it stands still, or the link is down"
                self._say(f"{sensor}: the server at {address} does not answer ({why}); frames are kept for it")
            self._still = True
        elif self._still:
            self._still = False
            self._say(f"{sensor}: the server at {address} answers again")


def nowhere(link: NodeLink) -> str:
    """Return why no server ever accepted a node whose source has ended, with the remedy."""
    why = link.why_not_admitted() or f"no server was at {link.address}; start it first (mocapella serve)"
    return f"{link.node.sensor}: {link.published} frames went nowhere: {why}"


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
    """Publish every frame when it is due, until they end or ``stop`` is set; ``stop`` is set when the run ends.

    Args:
        link: the sensor's end of the bus; stays open.
        frames: called when the run begins; returns the frames in the order of their times.
        epoch: the Unix time [s] at which the source's time is 0, which synchronises nodes of one epoch; the start of
            the run if None.
        stop: ends the run.
        wait: whether to wait for a server before the run begins.
        say: receives messages about the run.
        linger_s: how long to stay after the last frame, so that a recording server can fetch missed frames [s].

    Returns:
        The node's identity, and the counts of published frames, late frames and errors.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the frames have ended, and no server ever accepted the node.
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
        raise NoServerError(nowhere(link))
    return NodeSummary(
        sensor=link.node.sensor,
        node_id=f"{link.node.node_id:016x}",
        served=membership.served.is_set(),
        published=link.published,
        late=late,
        worst_delay=round(worst, 4),
        seconds=round(time.monotonic() - began, 3),
        errors=membership.errors.counts,
    )
