"""A webcam's node: detects people's keypoints in images, publishes them, and answers queries."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from mocapella.live.camera_node import CameraNodeSettings, CameraNodeSummary, run_camera_node, summary
from mocapella.live.camera_service import CameraService
from mocapella.live.keypoint_work import KeypointWork
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.node import NodeLink


def run_keypoint_node(
    link: NodeLink,
    acquisition: Acquisition,
    work: KeypointWork,
    service: CameraService,
    settings: CameraNodeSettings | None = None,
    *,
    epoch: float | None = None,
    stop: threading.Event,
    wait: bool = True,
    say: Callable[[str], None] = lambda text: None,
    linger_s: float = 0.0,
    clock: Callable[[], float] = time.monotonic,
) -> CameraNodeSummary:
    """Detect people in the newest image and publish them, until the source ends or ``stop`` is set.

    Images that arrive during a detection are skipped but for the newest; results of an image older than
    ``settings.drop_after_s`` are counted, but not published. An unexpected error, which is no `MocapellaError`, costs
    its image only; the report counts it. ``stop`` is set when the run ends.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: source of the images, not started yet; stays open.
        work: detects people.
        service: answers queries to the node.
        settings: settings of the node; the defaults if None.
        epoch: the Unix time [s] at which the source's time is 0; the start of the run if None.
        stop: ends the run.
        wait: whether to wait for a server before the run begins.
        say: receives messages about the run.
        linger_s: how long to stay after the last image, so that a recording server can fetch missed frames [s].
        clock: the monotonic clock, in seconds.

    Returns:
        The node's identity, and the counts of images and of errors.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: the source has ended, and no server ever accepted the node.
        SettingsError: an image is no colour image.
        InputError: an image file of the source cannot be read.
    """
    s = settings or CameraNodeSettings()

    def look(picture: Picture) -> None:
        begin_s = clock()
        frame = work.frame(picture)
        found_s = clock()
        if work.in_time(found_s - begin_s, found_s - picture.ready_s, s.drop_after_s):
            link.publish(frame)

    def begun() -> None:
        link.answer(service.ask)
        link.expect(work.expect)

    run = run_camera_node(
        link, acquisition, work, look, s, epoch=epoch, stop=stop, wait=wait, say=say, clock=clock,
        begun=begun, linger_s=linger_s,
    )  # fmt: skip
    return summary(link, run, work.report())
