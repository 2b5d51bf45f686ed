"""Encode and decode frames of all registered types (`mocapella.model.frame_types`)."""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.unknown_fields import UnknownFieldSet

from mocapella.errors import WireError
from mocapella.model.frame_types import ENVELOPE_FIELD, FRAME_TYPES, FrameType, MessageFormat, by_class
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.body_frames import body_frame_of
from mocapella.schema.checks import MAX_MESSAGE_BYTES, parse
from mocapella.schema.envelope import ENVELOPE, kind_of, open_unknown, seal


def encode_frame(frame: SensorFrame) -> bytes:
    """Encode a frame of any registered type as a protobuf message; equal frames give equal bytes.

    An `UnknownFrame` is sealed with its content unchanged.

    Raises:
        KeyError: no installed package registers the frame's class.
    """
    if isinstance(frame, UnknownFrame):
        return seal(frame, frame.kind, frame.content)
    return by_class()[type(frame)].encode(frame)


def decode_frame(data: bytes) -> Any:
    """Decode and check a frame of any type; return an `UnknownFrame` if no installed package has its type.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are no frame, or a field is missing, too long, of the wrong length, not finite or out of
            range; names the field and the expected value.
    """
    message = parse(
        pb.BodyFrame, data, MAX_MESSAGE_BYTES
    )  # most frames are; of another type's it has the unknown fields
    if message.topology:
        return body_frame_of(message)
    other = _other_type(message, data)
    if other is not None:
        return other.decode(data)
    return open_unknown(data) if _has(message, ENVELOPE_FIELD) else body_frame_of(message)


def format_of(data: bytes) -> MessageFormat:
    """Return the MCAP format of an encoded frame, for its channel in a take; plug-ins' frames share `ENVELOPE`.

    Raises:
        WireError: the bytes are no frame.
    """
    message = parse(pb.BodyFrame, data, MAX_MESSAGE_BYTES)
    if not message.topology:
        other = _other_type(message, data)
        if other is not None:
            return other.format
        if _has(message, ENVELOPE_FIELD):
            return ENVELOPE
    return FRAME_TYPES["skeletons"].format


def _other_type(message: Any, data: bytes) -> FrameType | None:
    """Return the frame type of a message other than skeletons; None if no installed package has it."""
    for number in _numbers(message):
        if number == ENVELOPE_FIELD:
            return FRAME_TYPES.get(kind_of(data))
        if number in _by_field():
            return _by_field()[number]
    return None


def _has(message: Any, number: int) -> bool:
    return number in _numbers(message)


def _numbers(message: Any) -> list[int]:
    try:
        unknown: Any = UnknownFieldSet(message)
        return [field.field_number for field in unknown]
    except NotImplementedError as error:
        raise WireError(f"the protobuf library cannot say which message this is ({error}); install another") from error


@cache
def _by_field() -> dict[int, FrameType]:
    return {one.field: one for one in FRAME_TYPES.values() if one.field != ENVELOPE_FIELD}
