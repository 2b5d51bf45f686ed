"""What every camera's node does: look at the newest picture, again and again, and say how it goes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from mocapella.errors import NoServerError
from mocapella.live.node import Membership
from mocapella.settings import check
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.node import NodeLink

WARN_AFTER_S: Final = 3.0
"""Between two looks at what might be wrong."""
STEADY_S: Final = 60.0
"""A problem that came back so soon after its end is over only when it has been away for so long."""
_POLL_S: Final = 0.1
"""So soon Ctrl-C is seen while no picture comes."""


@dataclass(frozen=True)
class CameraNodeSettings:
    """How a camera's node works.

    Attributes:
        drop_after_s: what was found so long after the picture was there is not sent.
        report_s: so often it says how it goes; 0 is only at the end.
    """

    drop_after_s: float = 0.1
    report_s: float = 10.0

    def __post_init__(self) -> None:
        check(0 < self.drop_after_s <= 3600, "drop_after_s", self.drop_after_s, "above 0, at most 3600 s")
        check(0 <= self.report_s <= 3600, "report_s", self.report_s, "from 0 to 3600 s")


class CameraWork(Protocol):
    """What is done with the pictures, as far as the node says how it goes."""

    def words(self) -> str:
        """Counts in a line."""
        ...

    def warnings(self, now_s: float) -> Iterator[str]:
        """What has become wrong since the last look, now and then; and what is right again."""
        ...


@dataclass(frozen=True)
class CameraRun:
    """How a node's run went: whether a server was ever there, and how long it took [s]."""

    served: bool
    seconds: float


def run_camera_node(
    link: NodeLink,
    acquisition: Acquisition,
    work: CameraWork,
    on_picture: Callable[[Picture], None],
    settings: CameraNodeSettings,
    *,
    epoch: float | None,
    stop: threading.Event,
    wait: bool,
    say: Callable[[str], None],
    begun: Callable[[], None] = lambda: None,
    full: Callable[[], bool] | None = None,
    linger_s: float = 0.0,
    clock: Callable[[], float] = time.monotonic,
) -> CameraRun:
    """Hand on the newest picture, again and again, until the source ends or ``stop`` is set.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: of the pictures, not started yet; stays open.
        work: says how it goes.
        on_picture: looks at a picture, and publishes what it finds.
        settings: see there.
        epoch: the Unix time [s] at which the source's time is 0; None is when the run begins.
        stop: ends the run.
        wait: whether the run begins when a server is there, or at once.
        say: is told in words what happens.
        begun: is called when the source has been started.
        full: whether enough has been measured; a run with it needs no server.
        linger_s: how long to stay after the source has ended, so that a recording server can fetch what it missed.
        clock: the monotonic clock, in seconds.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the source has ended, and no server was ever there to receive anything.
        MocapellaError: of the source, or of ``on_picture``.
    """
    sensor = link.node.sensor
    membership = Membership(link, stop, say)
    ended_by_itself = False
    try:
        if wait:
            membership.wait_for_server()
        began = clock()
        acquisition.start(began if epoch is None else began + (epoch - time.time()))
        begun()
        next_report = began + (settings.report_s or float("inf"))
        while not (stop.is_set() or (full is not None and full())):
            picture = acquisition.take(_POLL_S)
            if picture is not None:
                on_picture(picture)
            elif acquisition.ended:
                ended_by_itself = not stop.wait(linger_s)
                break
            if clock() >= next_report:
                next_report = clock() + settings.report_s
                say(f"{sensor}: {work.words()}")
            for warning in work.warnings(clock()):
                say(f"{sensor}: {warning}")
    finally:
        stop.set()
        membership.close()
    if ended_by_itself and full is None and not membership.served.is_set():
        raise NoServerError(
            f"{sensor}: {link.published} frames went nowhere: no server was at {link.address}; "
            "start it first (mocapella serve)"
        )
    return CameraRun(membership.served.is_set(), round(clock() - began, 3))


class Warned:
    """Says each problem when it begins and when it is over, and looks for them now and then.

    Of what comes and goes nothing more is said until it has been away for `STEADY_S`.
    """

    def __init__(self) -> None:
        self._next_s = -np.inf
        self._said: set[str] = set()
        self._there_s: dict[str, float] = {}
        self._over_s: dict[str, float] = {}
        self._returned: set[str] = set()

    def due(self, now_s: float) -> bool:
        """Whether it is time to look; the first time, nothing can be wrong yet."""
        if now_s < self._next_s:
            return False
        first, self._next_s = self._next_s == -np.inf, now_s + WARN_AFTER_S
        return not first

    def update(self, problems: Mapping[str, str], now_s: float) -> Iterator[str]:
        """What is to be said of the problems that there are now, by kind."""
        for kind, text in problems.items():
            begins = kind not in self._said
            if begins and now_s < self._over_s.get(kind, -np.inf) + STEADY_S:
                self._returned.add(kind)
            self._said.add(kind)
            self._there_s[kind] = now_s
            if begins:
                yield text
        for kind in sorted(self._said - set(problems)):
            if kind not in self._returned or now_s >= self._there_s[kind] + STEADY_S:
                self._said.remove(kind)
                self._returned.discard(kind)
                self._over_s[kind] = now_s
                yield f"{kind}: well again"
