"""The common fields of all frames, which identify a frame."""

from __future__ import annotations

import msgspec

from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG


class SensorFrame(msgspec.Struct, frozen=True, eq=False):
    """Base class of frames: the data of one sensor at one instant.

    A frame is identified by (sensor, node_id, sequence): the node's process numbers its frames from 0, so that a gap
    is a loss and a second arrival is a duplicate.

    Attributes:
        sensor: the sensor's name.
        node_id: random number of the process that serves the sensor, new at each start.
        sequence: number of the frame since that process started, from 0.
        time_ns: capture time, on the *sensor's own* clock.
        sent_ns: time of publication, on the node's monotonic clock; 0 without a node.
    """

    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int

    @property
    def bodies(self) -> int:
        """Number of items in the frame, such as bodies, for the table of sensors."""
        return 0

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Horizontal and vertical field of view of the sensor, for drawings only [°].

        Here a placeholder, `UNKNOWN_FIELD_OF_VIEW_DEG`: types of frames that know better override it.
        """
        return UNKNOWN_FIELD_OF_VIEW_DEG

    @property
    def for_the_take(self) -> bool:
        """Whether the frame is only for recording in a take, so that no tracking method needs to accept it."""
        return False

    @property
    def key(self) -> tuple[str, int, int]:
        """Identity of the frame: (sensor, node_id, sequence)."""
        return self.sensor, self.node_id, self.sequence


class UnknownFrame(SensorFrame, frozen=True, eq=False):
    """A frame of a type that no installed package decodes; it is stored unchanged.

    Attributes:
        kind: name of its type.
        content: bytes encoded by the plug-in.
    """

    kind: str
    content: bytes
