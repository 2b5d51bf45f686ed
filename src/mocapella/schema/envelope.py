"""Frames of types that plug-ins bring: the common fields, the type's name, and the content as the plug-in writes it."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

from mocapella.errors import WireError
from mocapella.model.frame_types import MessageFormat
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import MAX_MESSAGE_BYTES, MAX_NAME, identity, identity_of, parse


@cache
def protobuf_format(message: str) -> MessageFormat:
    """How a take says that a message of ours is written; Foxglove and other MCAP tools can read it then."""
    file = FileDescriptorProto()
    pb.DESCRIPTOR.CopyToProto(file)
    schema = FileDescriptorSet(file=[file]).SerializeToString()
    return MessageFormat("protobuf", f"mocapella.{message}", "protobuf", schema)


ENVELOPE: Final = protobuf_format("OtherFrame")
"""The format of all frames of plug-ins."""


def seal(frame: SensorFrame, kind: str, content: bytes) -> bytes:
    """A plug-in's frame as a message.

    Args:
        frame: whose sensor, number and times the message has.
        kind: name of its type.
        content: the rest, as the plug-in writes it.
    """
    return pb.OtherFrame(**identity(frame), kind=kind, content=content).SerializeToString()


def unseal(data: bytes) -> tuple[tuple[str, int, int, int, int], bytes]:
    """What a `SensorFrame` begins with, and the content, of a message that `seal` wrote.

    Raises:
        SchemaVersionError, WireError: as `mocapella.schema.decode_frame`.
    """
    message = _parsed(data)
    return identity_of(message), message.content


def kind_of(data: bytes) -> str:
    """Name of the frame type of a message that `seal` wrote.

    Raises:
        WireError: it has none that can be.
    """
    return str(_parsed(data).kind)


def open_unknown(data: bytes) -> UnknownFrame:
    """A frame whose type no installed package has."""
    message = _parsed(data)
    return UnknownFrame(*identity_of(message), message.kind, message.content)


def _parsed(data: bytes) -> Any:
    message = parse(pb.OtherFrame, data, MAX_MESSAGE_BYTES)
    if not 0 < len(message.kind) <= MAX_NAME:
        raise WireError(f"OtherFrame.kind is {message.kind[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    return message
