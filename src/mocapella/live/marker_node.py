"""A camera's node: pictures → markers → the bus, with questions answered meanwhile (`live/camera_desk.py`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mocapella.errors import NoServerError
from mocapella.geometry.lens import undistort
from mocapella.live.camera_desk import CameraDesk
from mocapella.live.marker_work import MarkerWork
from mocapella.live.node import Membership
from mocapella.live.stage_times import StageTimes
from mocapella.model.camera import Camera
from mocapella.settings import check
from mocapella.sources.acquisition import Acquisition
from mocapella.wire.node import NodeLink

_POLL_S: Final = 0.1
"""So soon Ctrl-C is seen while no picture comes."""


@dataclass(frozen=True)
class MarkerNodeSettings:
    """How a camera's node works.

    Attributes:
        drop_after_s: markers that were found so long after the picture was there are not sent.
        report_s: so often it says how it goes; 0 is only at the end.
    """

    drop_after_s: float = 0.1
    report_s: float = 10.0

    def __post_init__(self) -> None:
        check(0 < self.drop_after_s <= 3600, "drop_after_s", self.drop_after_s, "above 0, at most 3600 s")
        check(0 <= self.report_s <= 3600, "report_s", self.report_s, "from 0 to 3600 s")


@dataclass(frozen=True)
class MarkerNodeSummary:
    """What a camera's node did.

    Attributes:
        sensor, node_id: who it was on the bus; the id as 16 hex digits.
        served: whether a server was there at any time, and gave the node its sensor's name.
        published: frames.
        seconds: from the first picture's turn to the end [s].
        report: as `MarkerWork.report`.
        stages, jitter: of `StageTimes`, where times were taken.
    """

    sensor: str
    node_id: str
    served: bool
    published: int
    seconds: float
    report: dict[str, Any]
    stages: dict[str, dict[str, float]] | None = None
    jitter: dict[str, dict[str, float]] | None = None


def run_marker_node(
    link: NodeLink,
    acquisition: Acquisition,
    work: MarkerWork,
    desk: CameraDesk,
    settings: MarkerNodeSettings | None = None,
    *,
    epoch: float | None = None,
    stop: threading.Event,
    wait: bool = True,
    say: Callable[[str], None] = lambda text: None,
    times: StageTimes | None = None,
    camera: Camera | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> MarkerNodeSummary:
    """Find markers in the newest picture, again and again, and publish them; until the source ends or ``stop`` is set.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: of the pictures, not started yet; stays open.
        work: what finds markers.
        desk: what answers questions.
        settings: see there.
        epoch: the Unix time [s] at which the source's time is 0; None is when the run begins.
        stop: ends the run.
        wait: whether the run begins when a server is there, or at once.
        say: is told in words what happens.
        times: takes each frame's stages; the run ends when it is full, and no server is needed.
        camera: of the rig; where there is one, the time to undistort the points is taken, too.
        clock: the monotonic clock, in seconds.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the source has ended, and no server was ever there to receive anything.
        MocapellaError: the source gives something else than before.
    """
    s, sensor = settings or MarkerNodeSettings(), link.node.sensor
    membership = Membership(link, stop, say)
    ended_by_itself = False
    try:
        if wait:
            membership.wait_for_server()
        began = clock()
        acquisition.start(began if epoch is None else began + (epoch - time.time()))
        link.answer(desk.ask)
        next_report = began + (s.report_s or float("inf"))
        while not (stop.is_set() or (times is not None and times.full)):
            picture = acquisition.take(_POLL_S)
            if picture is not None:
                begin_s = clock()
                frame = work.look(picture)
                found_s = clock()
                if work.in_time(found_s - begin_s, found_s - picture.ready_s, s.drop_after_s):
                    link.publish(frame)
                if times is not None:
                    sent_s = clock()
                    stages = {
                        "retrieval": picture.retrieval_s,
                        "detection": found_s - begin_s,
                        "sending": sent_s - found_s,
                        **_rectification(frame.positions_px, camera, clock),
                    }
                    found = frame.positions_px[: len(work.names)]  # tags come after the colours
                    times.add({**stages, "all": sum(stages.values())}, found)
            elif acquisition.ended:
                ended_by_itself = True
                break
            if clock() >= next_report:
                next_report = clock() + s.report_s
                say(f"{sensor}: {work.words()}")
            for warning in work.warnings(clock()):
                say(f"{sensor}: {warning}")
    finally:
        stop.set()
        membership.close()
    if ended_by_itself and times is None and not membership.served.is_set():
        raise NoServerError(
            f"{sensor}: {link.published} frames went nowhere: no server was at {link.address}; "
            "start it first (mocapella serve)"
        )
    return MarkerNodeSummary(
        sensor=sensor,
        node_id=f"{link.node.node_id:016x}",
        served=membership.served.is_set(),
        published=link.published,
        seconds=round(clock() - began, 3),
        report=work.report(),
        stages=None if times is None else times.table(),
        jitter=None if times is None else times.jitter(work.names),
    )


def _rectification(positions_px: Any, camera: Camera | None, clock: Callable[[], float]) -> dict[str, float]:
    """How long the points take to undistort; that is done where the hand is made, and is counted here for the sum."""
    if camera is None:
        return {}
    begin_s = clock()
    undistort(np.asarray(positions_px, np.float64), camera.lens)
    return {"rectification": clock() - begin_s}
