"""What sensors send: a descriptor for each type of frame, looked up by name, by class, or by how it is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.model.sensor_frame import SensorFrame
from mocapella.registry import Table

ENVELOPE_FIELD: Final = 100
"""The protobuf field of an `OtherFrame`, which carries plug-ins' frames."""
HISTORY_FRAMES: Final = 18_000
"""So many frames a node keeps for a server that missed them."""


@dataclass(frozen=True)
class MessageFormat:
    """How a take's channel says that its messages are written; MCAP's own terms.

    Attributes:
        encoding: of messages, such as ``protobuf``.
        schema_name: such as ``mocapella.MarkerFrame``.
        schema_encoding: such as ``protobuf``.
        schema: its bytes.
    """

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True)
class FrameType:
    """A type of frame.

    Attributes:
        interface: of `mocapella.registry`.
        name: what such a sensor sends, in the plural: ``skeletons``, ``markers``.
        type: class of the frames.
        encode: a frame as the bytes of a message.
        decode: the bytes as a frame, checked; raises `WireError`.
        format: how a take says that they are written.
        field: number of a protobuf field that each message has and no other type's; plug-ins use `ENVELOPE_FIELD`.
        counted: singular and plural noun for a frame's items; None where nothing is counted.
        shown: what the table of sensors shows where nothing is counted; the name where left out.
        hint: what else can be done with such frames, where no method takes them.
        lane: ``module:name`` of a `mocapella.viewer.lanes.Lane`, which draws a frame in the sensors' view, or empty.
        resolver: ``module:name`` of a class whose ``resolve`` brings what a frame in a take refers to; may be empty.
        pictures: whether a node of this type answers questions for its camera's picture.
        depth_images: whether a frame is a depth image: it has ``depth``, ``size_px``, ``unit_m`` and ``lens``, as a
            `mocapella.model.depth.DepthFrame`, and what reads depth images reads it out of takes.
        history_frames: how many frames a node keeps for a server that missed them.
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
"""By name."""


def frame_type_of(frame: SensorFrame) -> FrameType | None:
    """The type of a frame; None where no package that is installed has it."""
    return by_class().get(type(frame))


def by_class() -> dict[type[SensorFrame], FrameType]:
    """The frame types by the class of their frames."""
    if not _BY_CLASS:
        _BY_CLASS.update({one.type: one for one in FRAME_TYPES.values()})
    return _BY_CLASS


def what_it_sends(frame: SensorFrame) -> str:
    """In a word: the name of its type."""
    known = frame_type_of(frame)
    return known.name if known is not None else str(getattr(frame, "kind", type(frame).__name__))


_BY_CLASS: dict[type[SensorFrame], FrameType] = {}
