"""A camera's node: pictures → markers → the bus, with questions answered meanwhile (`live/camera_service.py`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocapella.geometry.lens import undistort
from mocapella.live.camera_node import CameraNodeSettings, run_camera_node
from mocapella.live.camera_service import CameraService
from mocapella.live.marker_work import MarkerWork
from mocapella.live.stage_times import StageTimes
from mocapella.model.camera import Camera
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.node import NodeLink


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
    service: CameraService,
    settings: CameraNodeSettings | None = None,
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
        service: what answers questions.
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
    s = settings or CameraNodeSettings()

    def look(picture: Picture) -> None:
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

    run = run_camera_node(
        link, acquisition, work, look, s, epoch=epoch, stop=stop, wait=wait, say=say, clock=clock,
        begun=lambda: link.answer(service.ask), full=None if times is None else lambda: times.full,
    )  # fmt: skip
    return MarkerNodeSummary(
        sensor=link.node.sensor,
        node_id=f"{link.node.node_id:016x}",
        served=run.served,
        published=link.published,
        seconds=run.seconds,
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
