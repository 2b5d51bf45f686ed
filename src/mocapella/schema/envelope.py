"""Envelope of plug-ins' frames: the common fields, the type's name, and the content encoded by the plug-in."""

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
    """Return the format of a protobuf message for a take, which Foxglove and other MCAP tools can read."""
    file = FileDescriptorProto()
    pb.DESCRIPTOR.CopyToProto(file)
    schema = FileDescriptorSet(file=[file]).SerializeToString()
    return MessageFormat("protobuf", f"mocapella.{message}", "protobuf", schema)


ENVELOPE: Final = protobuf_format("OtherFrame")
"""Format of all plug-ins' frames."""


def seal(frame: SensorFrame, kind: str, content: bytes) -> bytes:
    """Encode a plug-in's frame as a message.

    Args:
        frame: with the sensor, sequence number and times of the message.
        kind: name of its type.
        content: the other fields, encoded by the plug-in.
    """
    return pb.OtherFrame(**identity(frame), kind=kind, content=content).SerializeToString()


def unseal(data: bytes) -> tuple[tuple[str, int, int, int, int], bytes]:
    """Return the first fields of a `SensorFrame`, and the content, of a message made by `seal`.

    Raises:
        SchemaVersionError, WireError: as in `mocapella.schema.decode_frame`.
    """
    message = _parsed(data)
    return identity_of(message), message.content


def kind_of(data: bytes) -> str:
    """Return the frame type's name of a message made by `seal`.

    Raises:
        WireError: the name is invalid.
    """
    return str(_parsed(data).kind)


def open_unknown(data: bytes) -> UnknownFrame:
    """Decode a frame whose type no installed package has."""
    message = _parsed(data)
    return UnknownFrame(*identity_of(message), message.kind, message.content)


def _parsed(data: bytes) -> Any:
    message = parse(pb.OtherFrame, data, MAX_MESSAGE_BYTES)
    if not 0 < len(message.kind) <= MAX_NAME:
        raise WireError(f"OtherFrame.kind is {message.kind[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    return message
