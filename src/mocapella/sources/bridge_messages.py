"""Messages at the bridge besides frames: a program that keeps its frames until they are acknowledged.

They are JSON objects, length-delimited as the frames are. Their first byte ``{`` is never that of a frame. The bridge's
answers are lines of text.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError, WireError
from mocapella.model.observations import BodyFrame, check_sensor_name
from mocapella.model.sensor_frame import SensorFrame
from mocapella.schema import decode_frame

_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


class BridgeStart(msgspec.Struct, frozen=True, tag="start", tag_field="say"):
    """A program asks for acknowledgements of one sensor's frames; the connection's first message.

    Attributes:
        sensor: name of the sensor.
        node_id: random id of the program's run, which the frames have, too.
        first: number of the next frame that the program sends.
        lost: number of frames directly before ``first`` that it has lost.
        next: number of the next frame that the sensor makes: those before are older, and are recorded but not tracked.
        now_ns: the present time on the clock of the frames' ``sent_ns`` [ns].
    """

    sensor: str
    node_id: Annotated[int, msgspec.Meta(ge=1, le=2**63 - 1)]
    first: _Number
    lost: _Number
    next: _Number
    now_ns: _Number


class BridgeEnd(msgspec.Struct, frozen=True, tag="end", tag_field="say"):
    """The program sends no further frame: the sensor leaves once all frames are stored."""


class BridgeHere(msgspec.Struct, frozen=True, tag="here", tag_field="say"):
    """The program is there, without a frame to send; the bridge answers with the last acknowledgement."""


class Relay(Protocol):
    """Interface of the part that serves the sensors of programs with acknowledgements.

    The methods return at once, and are called on the bridge's thread. They may refuse by a `MocapellaError`.
    """

    def start(self, start: BridgeStart) -> int:
        """Begin to serve a sensor; return how many frames may be sent before they are acknowledged."""
        ...

    def frame(self, frame: BodyFrame) -> None:
        """Take the sensor's next frame."""
        ...

    def acknowledged(self, sensor: str) -> int:
        """Return the number below which the program need not keep the sensor's frames."""
        ...

    def end(self, sensor: str) -> None:
        """Begin to leave: the sensor has no further frame."""
        ...

    def ended(self, sensor: str) -> str | None:
        """Return None until the sensor has left, then an empty text, or why its frames are not stored."""
        ...

    def gone(self, sensor: str) -> None:
        """Note that the program's connection has ended."""
        ...


def read_message(data: bytes) -> SensorFrame | BridgeStart | BridgeEnd | BridgeHere:
    """Decode a message that a program sends to the bridge: a frame, or a JSON object about acknowledgements.

    Raises:
        SchemaVersionError: a frame has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
    """
    if data[:1] != b"{":
        frame: SensorFrame = decode_frame(data)
        return frame
    what, fix = "message about acknowledgements", "docs/wire.md has its fields"
    try:
        message = decode_json(data, BridgeStart | BridgeEnd | BridgeHere, what=what, fix=fix)
    except InputError as error:
        raise WireError(str(error)) from None
    if isinstance(message, BridgeEnd | BridgeHere):
        return message
    start: BridgeStart = message
    check_sensor_name(start.sensor)
    if start.lost > start.first or start.next < start.first:
        raise WireError(
            f"start has first {start.first}, lost {start.lost} and next {start.next}; "
            "lost is at most first, and next at least"
        )
    return start
