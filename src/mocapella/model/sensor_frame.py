"""What identifies a frame, of whatever a sensor sees."""

from __future__ import annotations

import msgspec

from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG


class SensorFrame(msgspec.Struct, frozen=True, eq=False):
    """What one sensor saw at one instant.

    A frame is identified by (sensor, node_id, sequence): the node's process numbers its frames from 0, so that a gap
    is a loss and a second arrival is a duplicate.

    Attributes:
        sensor: the sensor's name.
        node_id: random number of the process that serves the sensor, new at each start.
        sequence: 0, 1, 2, … of that process.
        time_ns: when the sensor captured it, on the *sensor's own* clock.
        sent_ns: when the node published it, on the node's monotonic clock; 0 where there was no node.
    """

    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int

    @property
    def bodies(self) -> int:
        """How many things the frame has: what a table of sensors shows."""
        return 0

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Of the sensor, across and high [°]."""
        return UNKNOWN_FIELD_OF_VIEW_DEG

    @property
    def for_the_take(self) -> bool:
        """Whether a node sends it for takes only: no method has to use it."""
        return False

    @property
    def key(self) -> tuple[str, int, int]:
        """What identifies the frame: (sensor, node_id, sequence)."""
        return self.sensor, self.node_id, self.sequence


class UnknownFrame(SensorFrame, frozen=True, eq=False):
    """A frame of a type that no installed package reads; it is stored as it came.

    Attributes:
        kind: name of its type.
        content: as the plug-in wrote it.
    """

    kind: str
    content: bytes
