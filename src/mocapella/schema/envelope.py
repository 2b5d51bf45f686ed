"""Envelope message for plug-ins' frames: the common fields, the type's name, and the content encoded by the plug-in."""

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
    """Return the MCAP format of a protobuf message, such as ``BodyFrame``, with the schema that MCAP tools need.

    The result is cached by name. The name is not checked.
    """
    file = FileDescriptorProto()
    pb.DESCRIPTOR.CopyToProto(file)
    schema = FileDescriptorSet(file=[file]).SerializeToString()
    return MessageFormat("protobuf", f"mocapella.{message}", "protobuf", schema)


ENVELOPE: Final = protobuf_format("OtherFrame")
"""MCAP format of all plug-ins' frames."""


def seal(frame: SensorFrame, kind: str, content: bytes) -> bytes:
    """Encode a plug-in's frame as an envelope message.

    Args:
        frame: gives the message's sensor, node, sequence number and times.
        kind: name of the frame's type.
        content: the frame's other fields, encoded by the plug-in.

    Returns:
        The message's bytes, which `unseal` opens.
    """
    return pb.OtherFrame(**identity(frame), kind=kind, content=content).SerializeToString()


def unseal(data: bytes) -> tuple[tuple[str, int, int, int, int], bytes]:
    """Return (sensor, node_id, sequence, time_ns, sent_ns) and the content of a message made by `seal`.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
    """
    message = _parsed(data)
    return identity_of(message), message.content


def kind_of(data: bytes) -> str:
    """Return the frame type's name of a message made by `seal`.

    Raises:
        SchemaVersionError, WireError: the message or the name is invalid.
    """
    return str(_parsed(data).kind)


def open_unknown(data: bytes) -> UnknownFrame:
    """Decode the envelope of a frame whose type no installed package can read; its content stays encoded.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
    """
    message = _parsed(data)
    return UnknownFrame(*identity_of(message), message.kind, message.content)


def _parsed(data: bytes) -> Any:
    message = parse(pb.OtherFrame, data, MAX_MESSAGE_BYTES)
    if not 0 < len(message.kind) <= MAX_NAME:
        raise WireError(f"OtherFrame.kind is {message.kind[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    return message
