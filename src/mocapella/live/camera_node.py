"""The loop of every camera node: process the newest image, report progress, and warn about faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from mocapella.errors import MocapellaError, NoServerError
from mocapella.live.node import Membership, nowhere
from mocapella.settings import check
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.supervision import Boundary
from mocapella.wire.node import NodeLink

WARN_AFTER_S: Final = 3.0
"""Time between two checks for faults [s]."""
STEADY_S: Final = 60.0
"""A fault that returns within this time of its end counts as over only after it is absent for as long [s]."""
_POLL_S: Final = 0.1
"""Longest delay of Ctrl-C while no image arrives [s]."""


@dataclass(frozen=True)
class CameraNodeSettings:
    """Settings of a camera's node.

    Attributes:
        drop_after_s: results older than this, since the image was available, are not sent [s].
        report_s: interval between progress reports [s]; 0 reports only at the end.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    drop_after_s: float = 0.1
    report_s: float = 10.0

    def __post_init__(self) -> None:
        check(0 < self.drop_after_s <= 3600, "drop_after_s", self.drop_after_s, "above 0, at most 3600 s")
        check(0 <= self.report_s <= 3600, "report_s", self.report_s, "from 0 to 3600 s")


class CameraWork(Protocol):
    """Processing of a camera's images, as far as `run_camera_node` needs it: reports on progress and faults."""

    def words(self) -> str:
        """Return the counts of images and results so far, as one line for the user."""
        ...

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield faults since the last check, at limited intervals, and recoveries.

        Args:
            now_s: the present time on a monotonic clock [s].
        """
        ...


@dataclass(frozen=True)
class CameraRun:
    """Result of a camera node's run.

    Attributes:
        served: whether a server ever accepted the node.
        seconds: time from the start of the source to the end [s].
        errors: number of unexpected errors, by reason.
    """

    served: bool
    seconds: float
    errors: dict[str, int]


@dataclass(frozen=True)
class CameraNodeSummary:
    """Counts of a camera's node.

    Attributes:
        sensor, node_id: its identity on the bus; the id as 16 hex digits.
        served: whether a server ever accepted the node.
        published: number of published frames.
        seconds: from the start of acquisition to the end [s].
        report: as the ``report`` of the node's work, with the run's errors.
    """

    sensor: str
    node_id: str
    served: bool
    published: int
    seconds: float
    report: dict[str, Any]


def summary(link: NodeLink, run: CameraRun, report: dict[str, Any]) -> CameraNodeSummary:
    """Return the counts of a node after its run.

    Args:
        link: the sensor's end of the bus.
        run: result of the run.
        report: the report of the node's work.
    """
    return CameraNodeSummary(
        sensor=link.node.sensor,
        node_id=f"{link.node.node_id:016x}",
        served=run.served,
        published=link.published,
        seconds=run.seconds,
        report=report | {"errors": run.errors},
    )


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
    """Process the newest image repeatedly, until the source ends or ``stop`` is set.

    ``stop`` is set when the run ends for any reason, because the thread that claims the sensor's name ends with it.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: source of the images, not started yet; stays open.
        work: reports progress and faults.
        on_picture: processes an image, and publishes the result.
        settings: settings of the node.
        epoch: the Unix time [s] at which the source's time is 0; the start of the run if None.
        stop: ends the run.
        wait: whether to wait for a server before the run begins.
        say: receives messages about the run.
        begun: called when the source has been started.
        full: returns whether enough is measured, which ends the run; a run with it needs no server. None: no such end.
        linger_s: how long to stay after the source has ended, so that a recording server can fetch missed frames [s].
        clock: the monotonic clock, in seconds.

    Returns:
        The run's duration, whether a server accepted the node, and the number of unexpected errors.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the source has ended, no server ever accepted the node, and ``full`` is not given.
        MocapellaError: raised by the source or by ``on_picture``; any other error of ``on_picture`` costs its image
            only, and is counted.
    """
    sensor = link.node.sensor
    process = _guarded(on_picture, link.errors)
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
                process(picture)
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
        raise NoServerError(nowhere(link))
    return CameraRun(membership.served.is_set(), round(clock() - began, 3), link.errors.counts)


def _guarded(on_picture: Callable[[Picture], None], errors: Boundary) -> Callable[[Picture], None]:
    """Return a function that raises only errors of Mocapella; others are counted and reported."""

    def process(picture: Picture) -> None:
        raised: list[MocapellaError] = []

        def attempt() -> None:
            try:
                on_picture(picture)
            except MocapellaError as error:
                raised.append(error)

        errors.run("image", attempt)
        if raised:
            raise raised[0]

    return process


class FaultReports:
    """Reports each fault once when it begins and once when it is over, at limited intervals.

    A fault that keeps returning is reported again only after it has been absent for `STEADY_S`.
    """

    def __init__(self) -> None:
        self._next_s = -np.inf
        self._reported: set[str] = set()
        self._present_s: dict[str, float] = {}
        self._over_s: dict[str, float] = {}
        self._returned: set[str] = set()

    def due(self, now_s: float) -> bool:
        """Whether a check is due, at most every `WARN_AFTER_S`; the first call only starts the interval."""
        if now_s < self._next_s:
            return False
        first, self._next_s = self._next_s == -np.inf, now_s + WARN_AFTER_S
        return not first

    def update(self, problems: Mapping[str, str], now_s: float) -> Iterator[str]:
        """Yield messages for faults that began and for faults that are over.

        The memory changes as the messages are read: read all of them.

        Args:
            problems: all present faults as sentences, by kind.
            now_s: the present time on a monotonic clock [s].
        """
        for kind, text in problems.items():
            begins = kind not in self._reported
            if begins and now_s < self._over_s.get(kind, -np.inf) + STEADY_S:
                self._returned.add(kind)
            self._reported.add(kind)
            self._present_s[kind] = now_s
            if begins:
                yield text
        for kind in sorted(self._reported - set(problems)):
            if kind not in self._returned or now_s >= self._present_s[kind] + STEADY_S:
                self._reported.remove(kind)
                self._returned.discard(kind)
                self._over_s[kind] = now_s
                yield f"{kind}: well again"
