"""A node of an Azure Kinect or Orbbec Femto: publishes the bodies as they come."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from mocapella.live.node import Membership
from mocapella.sources.azure_kinect import AzureKinect
from mocapella.supervision import Boundary
from mocapella.wire.node import NodeLink


def run_azure_kinect(
    link: NodeLink, source: AzureKinect, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Publish the camera's bodies until ``stop`` is set; return counts in the form of ``--json``.

    Args:
        link: the sensor's end of the bus; stays open.
        source: the open camera; stays open.
        stop: ends the run.
        say: receives messages about the run.

    Raises:
        InputError: the camera was unplugged, its images have no time, or the tracker failed.
        NameTakenError: another node serves a sensor of this name.
    """
    membership = Membership(link, stop, say)
    errors = Boundary(say)
    try:
        while (frame := source.read(stop)) is not None:
            errors.run("bodies", lambda frame=frame: link.publish(frame))  # type: ignore[misc]
    finally:
        stop.set()
        membership.close()
    return {
        "sensor": link.node.sensor, "serial": source.serial, "published": link.published, **asdict(source.report),
        "errors": errors.counts,
    }  # fmt: skip
