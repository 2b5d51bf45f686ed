"""A camera's node: detects markers in images, publishes them, and answers queries (`live/camera_service.py`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocapella.geometry.lens import undistort
from mocapella.live.camera_node import CameraNodeSettings, CameraNodeSummary, run_camera_node, summary
from mocapella.live.camera_service import CameraService
from mocapella.live.marker_work import MarkerWork
from mocapella.live.stage_times import StageTimes
from mocapella.model.camera import Camera
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.node import NodeLink


@dataclass(frozen=True)
class MarkerNodeSummary(CameraNodeSummary):
    """Counts of a camera's node that detects markers.

    Attributes:
        stages, jitter: `StageTimes.table` and `StageTimes.jitter`; None if no times were measured.
        processor_ms: processor time of an image, in all threads of the process, also the camera's [ms]; None if no
            times were measured.
    """

    stages: dict[str, dict[str, float]] | None = None
    jitter: dict[str, dict[str, float]] | None = None
    processor_ms: float | None = None


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
    processor_clock: Callable[[], float] = time.process_time,
) -> MarkerNodeSummary:
    """Detect markers in the newest image and publish them, until the source ends or ``stop`` is set.

    Markers of an image older than ``settings.drop_after_s`` are counted, but not published. An unexpected error, which
    is no `MocapellaError`, costs its image only; the report counts it. ``stop`` is set when the run ends.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: source of the images, not started yet; stays open.
        work: detects markers.
        service: answers queries to the node.
        settings: settings of the node; the defaults if None.
        epoch: the Unix time [s] at which the source's time is 0; the start of the run if None.
        stop: ends the run.
        wait: whether to wait for a server before the run begins.
        say: receives messages about the run.
        times: receives each frame's stage times; the run ends when it is full, and needs no server. None measures
            no times.
        camera: the calibrated camera; then the time to undistort the points is measured, too. None if unknown.
        clock: the monotonic clock, in seconds.
        processor_clock: processor time of the process, in seconds.

    Returns:
        The node's identity and counts; with ``times``, also the durations of the stages and the markers' jitter.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the source has ended, no server ever accepted the node, and ``times`` is not given.
        SettingsError: an image has another size than those in which the colours were learnt, or is no colour image.
        InputError: an image file of the source cannot be read.
    """
    s = settings or CameraNodeSettings()
    spent_s: list[float] = []

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
            spent_s[1:] = [processor_clock()]

    run = run_camera_node(
        link, acquisition, work, look, s, epoch=epoch, stop=stop, wait=wait, say=say, clock=clock,
        begun=lambda: link.answer(service.ask), full=None if times is None else lambda: times.full,
    )  # fmt: skip
    return MarkerNodeSummary(
        **vars(summary(link, run, work.report())),
        stages=None if times is None else times.table(),
        jitter=None if times is None else times.jitter(work.names),
        processor_ms=1e3 * (spent_s[1] - spent_s[0]) / (times.count - 1) if times and len(spent_s) > 1 else None,
    )


def _rectification(positions_px: Any, camera: Camera | None, clock: Callable[[], float]) -> dict[str, float]:
    """Measure the time to undistort the points, which the hand tracker does; the sum of the stages includes it."""
    if camera is None:
        return {}
    begin_s = clock()
    undistort(np.asarray(positions_px, np.float64), camera.lens)
    return {"rectification": clock() - begin_s}
