"""Each message that the kernels vouch for is parsed by protobuf, with equal values; they vouch for usual ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.wire_kernels import DEPTH, FIELDS, is_text, read_message, read_varint
from mocapella.schema.wire_shapes import shapes_of

google = pytest.importorskip("google.protobuf.message")
EDGES = [0x00, 0x41, 0x7F, 0x80, 0x8F, 0x90, 0x9F, 0xA0, 0xBF, 0xC0, 0xC1, 0xC2, 0xDF, 0xE0, 0xE1, 0xEC, 0xED, 0xEE,
         0xEF, 0xF0, 0xF1, 0xF3, 0xF4, 0xF5, 0xFF]  # fmt: skip
"""First and last bytes of each class in UTF-8."""
KINDS = (pb.BodyFrame, pb.Scene)
SHAPES = shapes_of(*KINDS)
texts = st.text(max_size=6)
VALUES = {"string": texts, "bytes": st.binary(max_size=9), "bool": st.booleans(), "float": st.floats(width=32)}


def numbers(field: Any) -> Any:
    signed, bits = field.type == field.TYPE_INT64, 32 if field.type == field.TYPE_UINT32 else 64
    return st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else st.integers(0, 2**bits - 1)


def values_of(field: Any) -> Any:
    if field.type == field.TYPE_MESSAGE:
        return messages(field.message_type._concrete_class)
    by_type = {field.TYPE_STRING: "string", field.TYPE_BYTES: "bytes", field.TYPE_BOOL: "bool",
               field.TYPE_FLOAT: "float", field.TYPE_DOUBLE: "float"}  # fmt: skip
    return VALUES[by_type[field.type]] if field.type in by_type else numbers(field)


@st.composite
def messages(draw: Any, kind: Any) -> Any:
    fields = draw(st.lists(st.sampled_from(list(kind.DESCRIPTOR.fields)), max_size=5, unique_by=lambda one: one.number))
    content = {
        field.name: draw(
            st.lists(values_of(field), max_size=2) if field.label == field.LABEL_REPEATED else values_of(field)
        )
        for field in fields
    }
    return kind(**content)


def read(data: bytes, kind: int) -> np.ndarray | None:
    fields = np.empty((FIELDS, 3), np.int64)
    inside = b"\xff" + data + b"\x01" * 12  # bytes before and after it that must not be read
    scratch = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64)
    usual = read_message(np.frombuffer(inside, np.uint8), 1, 1 + len(data), SHAPES, kind, fields, *scratch)
    fields[:, 1] -= fields[:, 2] > 0
    return fields if usual else None


def check(data: bytes, kind: int) -> bool:
    """Compare the kernel with protobuf; return whether it vouches for the message."""
    fields = read(data, kind)
    try:
        parsed = KINDS[kind].FromString(data)
    except google.DecodeError:
        assert fields is None, "invalid, and vouched for"
        return False
    if fields is None:
        return False
    for field in parsed.DESCRIPTOR.fields:
        count, value, size = fields[field.number].tolist()
        own = getattr(parsed, field.name)
        if field.label == field.LABEL_REPEATED:
            assert count == len(own)
        elif field.type == field.TYPE_MESSAGE:
            assert (count > 0) == parsed.HasField(field.name)
        elif field.type in {field.TYPE_STRING, field.TYPE_BYTES}:
            raw = own.encode() if isinstance(own, str) else own
            assert data[value : value + size] == raw
        elif field.type in {field.TYPE_UINT64, field.TYPE_FIXED64}:
            assert value % 2**64 == own
        elif field.type == field.TYPE_INT64:
            assert value == own
    return True


@settings(deadline=None)
@given(st.integers(0, 1).flatmap(lambda kind: st.tuples(st.just(kind), messages(KINDS[kind]))))
def test_a_usual_message_is_read_as_protobuf_reads_it(given_: tuple[int, Any]) -> None:
    kind, message = given_
    data = message.SerializeToString()
    assert check(data, kind)


@settings(deadline=None, max_examples=300)
@given(
    st.integers(0, 1).flatmap(lambda kind: st.tuples(st.just(kind), messages(KINDS[kind]))),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4),
    st.integers(0, 40),
)
def test_a_damaged_message_is_never_vouched_for_unless_protobuf_parses_it(
    given_: tuple[int, Any], changes: list[tuple[int, int]], cut: int
) -> None:
    kind, message = given_
    data = bytearray(message.SerializeToString())
    for at, value in changes if data else []:
        data[at % len(data)] = value
    check(bytes(data), kind)
    check(bytes(data[: max(0, len(data) - cut)]), kind)


@settings(deadline=None, max_examples=300)
@given(st.binary(max_size=24), st.integers(0, 1))
@example(b"\x80\x00", 0)  # field 0
@example(b"\x0b\x0c", 0)  # a group
@example(b"\x08" + b"\xff" * 9 + b"\x01", 0)
@example(b"\x08" + b"\xff" * 9 + b"\x02", 0)  # more than 64 bits
@example(b"\xfa\xff\xff\xff\x7f\x00", 0)  # a key of more than 32 bits
@example(b"\x12\x02\xc3\x28", 0)  # a text that is no UTF-8
@example(b"\x12\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01", 0)  # a size of −1
@example(b"\x6a\x04\x22\x02\x08", 1)  # a message within a message that is cut off
def test_any_bytes_are_read_as_protobuf_reads_them_or_left_to_it(data: bytes, kind: int) -> None:
    check(data, kind)


@settings(deadline=None, max_examples=500)
@given(
    st.one_of(st.binary(max_size=6), st.lists(st.sampled_from(EDGES), max_size=5).map(bytes), st.text().map(str.encode))
)
def test_bytes_are_text_as_python_decodes_them(data: bytes) -> None:
    try:
        data.decode()
    except UnicodeDecodeError:
        valid = False
    else:
        valid = True
    assert is_text(np.frombuffer(b"\x80" + data + b"\x80", np.uint8), 1, 1 + len(data)) == valid


@given(st.integers(0, 2**64 - 1))
def test_a_whole_number_comes_back_with_its_end(value: int) -> None:
    data, rest = bytearray(), value
    while True:
        data.append((rest & 0x7F) | (0x80 if rest > 0x7F else 0))
        rest >>= 7
        if not rest:
            break
    array = np.frombuffer(bytes(data), np.uint8)
    assert tuple(map(int, read_varint(array, 0, len(data)))) == (value, len(data))
    assert read_varint(array, 0, len(data) - 1)[1] == -1
