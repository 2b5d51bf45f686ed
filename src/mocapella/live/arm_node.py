"""A depth camera's node: detects arms in images and publishes them, optionally with the images."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mocapella.live.arm_work import ArmWork
from mocapella.live.camera_node import CameraNodeSettings, run_camera_node
from mocapella.live.node import Membership
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.node import NodeLink


@dataclass(frozen=True)
class ArmNodeSummary:
    """Counts of a depth camera's node.

    Attributes:
        sensor, node_id: its identity on the bus; the id as 16 hex digits.
        served: whether a server ever accepted the node.
        published: number of published frames of arms.
        images_published: number of published depth images; 0 without ``depth_link``.
        seconds: from the start of acquisition to the end [s].
        report: as `ArmWork.report`.
    """

    sensor: str
    node_id: str
    served: bool
    published: int
    images_published: int
    seconds: float
    report: dict[str, Any]


def run_arm_node(
    link: NodeLink,
    acquisition: Acquisition,
    work: ArmWork,
    settings: CameraNodeSettings | None = None,
    *,
    depth_link: NodeLink | None = None,
    epoch: float | None = None,
    stop: threading.Event,
    wait: bool = True,
    say: Callable[[str], None] = lambda text: None,
    clock: Callable[[], float] = time.monotonic,
) -> ArmNodeSummary:
    """Detect arms in the newest image and publish them, until the source ends or ``stop`` is set.

    Arms of an image older than ``settings.drop_after_s`` are counted, but not published; its depth image is. ``stop``
    is set when the run ends. An unexpected error, which is no `MocapellaError`, costs its image only; the report counts
    it.

    Args:
        link: the sensor's end of the bus; stays open.
        acquisition: source of the images, not started yet; stays open.
        work: detects arms.
        settings: settings of the node; the defaults if None.
        depth_link: link of a second sensor that publishes the depth images; None to publish no images.
        epoch, stop, wait, say, clock: as in `mocapella.live.camera_node.run_camera_node`.

    Returns:
        The node's identity, and the counts of frames of arms, of depth images and of errors.

    Raises:
        NameTakenError: another node serves a sensor of either name.
        NoServerError: the source has ended, and no server ever accepted the node.
        InputError: a depth image cannot be read, the depth unit is implausible, or images of another size, lens or unit
            arrive.
    """
    s = settings or CameraNodeSettings()
    images = None if depth_link is None else Membership(depth_link, stop, say)

    def look(picture: Picture) -> None:
        if depth_link is not None:
            depth_link.publish(work.depth(picture))
        begin_s = clock()
        frame = work.look(picture)
        found_s = clock()
        if work.in_time(found_s - begin_s, found_s - picture.ready_s, s.drop_after_s):
            link.publish(frame)

    try:
        run = run_camera_node(
            link, acquisition, work, look, s, epoch=epoch, stop=stop, wait=wait, say=say, clock=clock
        )  # fmt: skip
    finally:
        stop.set()
        if images is not None:
            images.close()
    return ArmNodeSummary(
        sensor=link.node.sensor,
        node_id=f"{link.node.node_id:016x}",
        served=run.served,
        published=link.published,
        images_published=0 if depth_link is None else depth_link.published,
        seconds=run.seconds,
        report=work.report() | {"errors": run.errors},
    )
