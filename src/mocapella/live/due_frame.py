"""A frame that a node publishes, with its time."""

from __future__ import annotations

from typing import NamedTuple

from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.truth import Truth


class DueFrame(NamedTuple):
    """A frame to publish, and the time at which to publish it.

    Attributes:
        due_s: when the frame is to be published, since the source's time 0 [s].
        frame: the frame; its number and node are set when it is published.
        truth: ground truth of a simulated frame; else None.
    """

    due_s: float
    frame: SensorFrame
    truth: Truth | None = None
