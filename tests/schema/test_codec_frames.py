"""The frame's codec: what goes in comes out, and whatever is not ours is refused with the reason."""

from __future__ import annotations

import math
import pickle
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.messages import frames, message, plain_frame

from mocapella.errors import SchemaVersionError, WireError
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.topology import topology
from mocapella.schema import MAX_BODIES, MAX_MESSAGE_BYTES, SCHEMA_VERSION, decode_frame, encode_frame


def assert_same(a: BodyFrame, b: BodyFrame) -> None:
    for name in BodyFrame.__struct_fields__:
        left, right = getattr(a, name), getattr(b, name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right, err_msg=name, strict=True)
        else:
            assert left == right, name


def refused(data: bytes, *parts: str, error: type[WireError] = WireError) -> None:
    with pytest.raises(error) as caught:
        decode_frame(data)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 400
    for part in parts:
        assert part in text


@given(frames())
@settings(max_examples=60)
def test_a_frame_comes_back_as_it_was(frame: BodyFrame) -> None:
    data = encode_frame(frame)
    back = decode_frame(data)
    assert_same(frame, back)
    assert encode_frame(back) == data


def test_the_bits_of_a_float_survive() -> None:
    positions = np.full((1, 25, 3), -0.0, np.float32)
    positions[0, 1] = np.nextafter(np.float32(0), np.float32(1))  # the smallest subnormal number
    states = np.full((1, 25), 1)
    states[0, 2] = 0
    back = decode_frame(
        encode_frame(body_frame("a", topology("kinect_v2"), time_ns=0, positions=positions, states=states))
    )
    assert back.positions[0, :2].tobytes() == positions[0, :2].tobytes()
    assert np.isnan(back.positions[0, 2]).all()


def test_what_is_not_tracked_travels_as_zero() -> None:
    states = np.full((2, 25), 2)
    states[1, 4] = 0
    shape = (2, 25)
    frame = body_frame(
        "front",
        topology("kinect_v2"),
        time_ns=0,
        positions=np.ones((*shape, 3)),
        states=states,
        depth_px=np.ones((*shape, 2)),
        orientations=np.ones((*shape, 4)),
    )
    sent = message().FromString(encode_frame(frame))
    for packed, width in ((sent.positions_m, 3), (sent.depth_px, 2), (sent.orientations, 4)):
        values = np.frombuffer(packed, "<f4").reshape(*shape, width)
        assert (values[1, 4] == 0).all()
        assert np.count_nonzero(values == 0) == width


def test_values_at_joints_that_are_not_tracked_are_ignored() -> None:
    states = bytearray([2] * 50)
    states[7] = 0
    back = decode_frame(message(joint_states=bytes(states)).SerializeToString())
    for values in (back.positions, back.depth_px, back.orientations):
        assert values is not None
        assert np.isnan(values[0, 7]).all()
        assert np.isfinite(np.delete(values.reshape(50, -1), 7, axis=0)).all()


def test_arrays_of_another_layout_are_written_right() -> None:
    frame = plain_frame()
    turned = np.arange(150, dtype=np.float64).reshape(3, 25, 2).T  # not contiguous, and float64
    states = np.full((2, 25), 2, np.uint8)
    states[0, 0] = 0
    odd = body_frame("front", frame.topology, time_ns=0, positions=turned, states=states)
    assert_same(odd, decode_frame(encode_frame(odd)))


def test_a_newer_minor_version_may_add_fields() -> None:
    data = encode_frame(plain_frame())
    added = data + b"\xa2\x06\x05hello" + b"\xa8\x06\x07"  # field 100, bytes; field 101, varint
    assert_same(decode_frame(data), decode_frame(added))


def test_twenty_thousand_joints_are_no_problem_and_one_body_too_many_is() -> None:
    kind = topology("kinect_v2")
    most = plain_frame(MAX_BODIES)
    assert decode_frame(encode_frame(most)).bodies == MAX_BODIES
    refused(encode_frame(plain_frame(MAX_BODIES + 1)), "BodyFrame.tracking_ids", f"at most {MAX_BODIES} bodies")
    assert kind is most.topology


def test_many_bodies_far_away_are_accepted_after_a_closer_look() -> None:
    positions = np.full((20, 25, 3), 900.0)
    frame = body_frame("front", topology("kinect_v2"), time_ns=0, positions=positions)
    assert_same(frame, decode_frame(encode_frame(frame)))


def test_too_long_a_message_is_refused_before_it_is_read() -> None:
    refused(b"\0" * (MAX_MESSAGE_BYTES + 1), f"{MAX_MESSAGE_BYTES + 1} bytes", f"at most {MAX_MESSAGE_BYTES}")


@pytest.mark.parametrize("version", [0, 2, 2**32 - 1])
def test_another_version_is_named_beside_ours(version: int) -> None:
    said = f"version {version}" if version else "does not say its schema version"
    data = message(schema_version=version).SerializeToString()
    refused(data, said, f"reads version {SCHEMA_VERSION}", error=SchemaVersionError)


def test_nothing_at_all_is_refused_for_its_version() -> None:
    refused(b"", "BodyFrame does not say its schema version", error=SchemaVersionError)


LONG = "x" * 100_000


@pytest.mark.parametrize(
    ("changed", "parts"),
    [
        ({"topology": "kinect_v3"}, ["topology is 'kinect_v3'", "did you mean kinect_v"]),
        ({"topology": ""}, ["topology is ''", "known: arkit, azure_kinect, body_25"]),
        ({"topology": LONG}, ["topology is 'xxx", "known: arkit, azure_kinect, body_25"]),
        ({"sensor": ""}, ["sensor name ''", "such as front"]),
        ({"sensor": "a/b"}, ["sensor name 'a/b'"]),
        ({"sensor": "front\n"}, ["sensor name 'front\\n'"]),
        ({"sensor": LONG}, ["sensor name 'xxx", "1 to 64"]),
        ({"tracking_ids": b"\0" * 15}, ["tracking_ids has 15 bytes", "8 for each body"]),
        ({"tracking_ids": b"\0" * 24}, ["tracked has 2 bytes", "3 × 1"]),
        ({"tracking_ids": b""}, ["tracked has 2 bytes", "0 × 1"]),
        ({"tracked": b"\1"}, ["tracked has 1 bytes", "2 × 1"]),
        ({"tracked": b"\1\2"}, ["tracked has a 2", "0 or 1"]),
        ({"clipped_edges": b""}, ["clipped_edges has 0 bytes", "2 × 1"]),
        ({"clipped_edges": b"\0\x10"}, ["clipped_edges has a 16", "0 to 15"]),
        ({"joint_states": b"\2" * 49}, ["joint_states has 49 bytes", "2 × 25", "kinect_v2"]),
        ({"joint_states": b"\2" * 49 + b"\3"}, ["joint_states has a 3", "0, 1 or 2"]),
        ({"topology": "kinect_v1"}, ["joint_states has 50 bytes", "2 × 20", "kinect_v1"]),
        ({"positions_m": b""}, ["positions_m has 0 bytes", "2 × 25 × 3 float32", "want 600"]),
        ({"positions_m": b"\0" * 604}, ["positions_m has 604 bytes"]),
        ({"depth_px": b"\0" * 4}, ["depth_px has 4 bytes", "want 400"]),
        ({"orientations": b"\0" * 600}, ["orientations has 600 bytes", "want 800"]),
        ({"tilt_rad": 3.2}, ["BodyFrame.tilt_rad is 3.2", "±π"]),
        ({"tilt_rad": math.nan}, ["BodyFrame.tilt_rad is nan"]),
        ({"height_m": -1001}, ["height_m -1001", "±1000"]),
        ({"height_m": math.inf}, ["height_m inf"]),
    ],
)
def test_a_field_that_does_not_fit_is_named(changed: dict[str, object], parts: list[str]) -> None:
    refused(message(**changed).SerializeToString(), *parts)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1000.1, -1001.0, 3.4e38])
@pytest.mark.parametrize("bodies", [1, 20])
def test_a_coordinate_that_is_none_names_joint_axis_and_body(value: float, bodies: int) -> None:
    packed = bytearray(message(bodies).positions_m)
    packed[4 * (3 * 3 + 1) : 4 * (3 * 3 + 2)] = struct.pack("<f", value)
    data = message(bodies, positions_m=bytes(packed)).SerializeToString()
    refused(data, "Head y of body 0", "finite and within ±1000 m", f"is {value:g};")


def test_the_furthest_coordinate_that_is_allowed_is_allowed() -> None:
    packed = struct.pack("<f", -1000.0) + message(1).positions_m[4:]
    assert decode_frame(message(1, positions_m=packed).SerializeToString()).positions[0, 0, 0] == -1000.0


@pytest.mark.parametrize("field", ["depth_px", "orientations"])
@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_an_infinite_depth_point_or_orientation_is_refused(field: str, value: float) -> None:
    packed = struct.pack("<f", value) + getattr(message(), field)[4:]
    refused(message(**{field: packed}).SerializeToString(), f"BodyFrame.{field}", "infinite")


@pytest.mark.parametrize("field", ["depth_px", "orientations"])
def test_a_joint_may_have_no_depth_point_and_no_orientation(field: str) -> None:
    packed = struct.pack("<f", math.nan) + getattr(message(), field)[4:]
    back = decode_frame(message(**{field: packed}).SerializeToString())
    values = getattr(back, field)
    assert np.isnan(values[0, 0, 0])
    assert np.isfinite(back.positions).all()


@given(st.binary(max_size=400))
@example(b"\x0a\xff\xff\xff\xff\x7f")  # a field that claims 32 GiB
@example(b"\x62\xff\xff\xff\xff\x07\0")  # tracking_ids of 2 GiB
@example(pickle.dumps({"sensor": "front", "sequence": 1}))
@example(bytes.fromhex("0001000000ffffffff01000000000000000c02000000") + b"\x05Kinect")  # .NET's BinaryFormatter
@settings(max_examples=300)
def test_bytes_that_are_not_ours_are_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        decode_frame(data)


ONE_BODY = encode_frame(plain_frame(1))


@given(st.data())
@settings(max_examples=300)
def test_a_damaged_frame_is_refused_or_sound(data: st.DataObject) -> None:
    damaged = bytearray(ONE_BODY)
    for place in data.draw(st.lists(st.integers(0, len(damaged) - 1), min_size=1, max_size=4)):
        damaged[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)) | st.just(len(damaged)))
    try:
        frame = decode_frame(bytes(damaged[:cut]))
    except WireError:
        return
    seen = frame.states != 0
    assert (np.abs(frame.positions[seen]) <= 1000).all()
    assert np.isnan(frame.positions[~seen]).all()
