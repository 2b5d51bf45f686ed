"""Frame types: a descriptor for each type of frame that sensors send, found by name, class or encoding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.model.sensor_frame import SensorFrame
from mocapella.registry import Table

ENVELOPE_FIELD: Final = 100
"""Number of a protobuf field that only ``OtherFrame`` has, the message of plug-ins' frames."""
HISTORY_FRAMES: Final = 18_000
"""Default number of frames that a node keeps, to send them again to a server that missed them."""


@dataclass(frozen=True)
class MessageFormat:
    """The encoding of a take's channel, in MCAP's terms.

    Attributes:
        encoding: encoding of the messages, such as ``protobuf``.
        schema_name: name of the schema, such as ``mocapella.MarkerFrame``.
        schema_encoding: encoding of the schema, such as ``protobuf``.
        schema: the encoded schema.
    """

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True)
class FrameType:
    """The descriptor of a frame type.

    Attributes:
        interface: version of the descriptor's interface, see `mocapella.registry`.
        name: plural noun for such a sensor's output: ``skeletons``, ``markers``.
        type: class of the frames.
        encode: function that encodes a frame as a message.
        decode: function that decodes and validates a message; raises `WireError`.
        format: encoding in a take.
        field: number of a protobuf field that each message has and no other type's; plug-ins use `ENVELOPE_FIELD`.
        counted: singular and plural noun for a frame's items; None where nothing is counted.
        shown: text of the sensor table where nothing is counted; the name if omitted.
        hint: other uses of the frames, for the message about frames that no tracking method accepts.
        lane: ``module:name`` of a `mocapella.viewer.lanes.Lane`, which draws a frame in the sensors' view, or empty.
        resolver: ``module:name`` of a class whose ``resolve`` loads data that a take only references, such as an image
            in a video file; may be empty.
        pictures: whether a node of this type answers requests for its camera's image.
        depth_images: whether a frame is a depth image: it has ``depth``, ``size_px``, ``unit_m`` and ``lens``, like
            `mocapella.model.depth.DepthFrame`, so that readers of depth images accept it in takes.
        history_frames: number of frames that a node keeps, to send them again to a server that missed them.
    """

    interface: int
    name: str
    type: type[SensorFrame]
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    format: MessageFormat
    field: int = ENVELOPE_FIELD
    counted: tuple[str, str] | None = None
    shown: str = ""
    hint: str = ""
    lane: str = ""
    resolver: str = ""
    pictures: bool = False
    depth_images: bool = False
    history_frames: int = HISTORY_FRAMES


FRAME_TYPES: Final = Table("mocapella.frame_types", FrameType, "frame type")
"""Frame types by name."""


def frame_type_of(frame: SensorFrame) -> FrameType | None:
    """Return the type of a frame; None if no installed package registers it."""
    return by_class().get(type(frame))


def by_class() -> dict[type[SensorFrame], FrameType]:
    """Return the frame types by the class of their frames: one dictionary, made on the first call; do not change it."""
    if not _BY_CLASS:
        _BY_CLASS.update({one.type: one for one in FRAME_TYPES.values()})
    return _BY_CLASS


def what_it_sends(frame: SensorFrame) -> str:
    """Return the name of a frame's type, such as ``skeletons``; its ``kind`` or class's name if not registered."""
    known = frame_type_of(frame)
    return known.name if known is not None else str(getattr(frame, "kind", type(frame).__name__))


_BY_CLASS: dict[type[SensorFrame], FrameType] = {}
