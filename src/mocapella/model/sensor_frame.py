"""What identifies a frame, of whatever a sensor sees."""

from __future__ import annotations

import msgspec


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
    def key(self) -> tuple[str, int, int]:
        """What identifies the frame: (sensor, node_id, sequence)."""
        return self.sensor, self.node_id, self.sequence
