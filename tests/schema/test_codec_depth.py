"""Depth images and arms: there and back, and what is refused."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from support.messages import arm_frames, depth_frames, plain_frame, some_arm

from mocapella.errors import SettingsError, WireError
from mocapella.model.arms import ARM_POINTS, ArmFrame
from mocapella.model.depth import DepthFrame, depth_frame
from mocapella.model.hand import ANGLES
from mocapella.schema import MAX_MESSAGE_BYTES, decode_frame, encode_frame, format_of
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.arms import MAX_ARMS
from mocapella.schema.depth import MAX_DEPTH_PX, pack_depth, unpack_depth

NAN = float("nan")
LENS = np.array([476.0, 476.0, 3.5, 2.5, 0, 0, 0, 0, 0])


@given(depth_frames())
def test_a_depth_frame_comes_back_as_it_was(frame: DepthFrame) -> None:
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, DepthFrame)
    assert format_of(data).schema_name == "mocapella.DepthFrame"
    for name in frame.__struct_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    assert back.depth.dtype == np.uint16
    assert encode_frame(back) == data


@given(arm_frames())
def test_an_arm_frame_comes_back_as_it_was(frame: ArmFrame) -> None:
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, ArmFrame)
    assert format_of(data).schema_name == "mocapella.ArmFrame"
    assert encode_frame(back) == data
    for name in set(frame.__struct_fields__) - {"arms"}:
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    for one, other in zip(back.arms, frame.arms, strict=True):
        for name in other.__struct_fields__:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@given(st.binary(max_size=80), st.integers(0, 2**32 - 1))
def test_damaged_bytes_give_a_frame_or_an_error_of_ours(tail: bytes, seed: int) -> None:
    rng = np.random.default_rng(seed)
    heads = (
        pb.DepthFrame(schema_version=1, sensor="a", width_px=4, height_px=3, unit_m=0.001, lens=LENS.tobytes()),
        pb.ArmFrame(schema_version=1, sensor="a", width_px=4, height_px=3, method="m", lens=LENS.tobytes()),
    )
    depth = depth_frame("a", rng.integers(0, 9, (3, 4)).astype(np.uint16), unit_m=0.001, lens=LENS, time_ns=1)
    arms = ArmFrame("a", 1, 2, 3, 4, (4, 3), LENS, "m", (some_arm(1, rng),))
    whole = [bytearray(encode_frame(frame)) for frame in (depth, arms)]
    for data in whole:
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    for data in (*(head.SerializeToString() + tail for head in heads), *map(bytes, whole)):
        with contextlib.suppress(WireError):
            decode_frame(data)


@given(st.binary(max_size=200))
def test_bytes_that_unpack_to_something_else_are_refused(data: bytes) -> None:
    with contextlib.suppress(WireError):
        assert unpack_depth(data, (5, 4), "depth").shape == (4, 5)


def test_a_text_of_another_message_is_no_crash() -> None:
    """Field 22 is a text in a marker frame, and anything at all in a depth frame."""
    data = depth_message() + bytes([22 << 3 & 0x7F | 0x82, 0x01, 1, 0xFF])
    assert isinstance(decode_frame(data), DepthFrame)
    assert format_of(data).schema_name == "mocapella.DepthFrame"


def depth_message(**changed: Any) -> bytes:
    frame = depth_frame("depth", np.full((3, 4), 700, np.uint16), unit_m=0.001, lens=LENS, time_ns=1)
    made = pb.DepthFrame.FromString(encode_frame(frame))
    for name, value in changed.items():
        setattr(made, name, value)
    return bytes(made.SerializeToString())


def packed(size: int, *, told: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=told).compress(bytes(size))


def forged(size: int) -> bytes:
    """A frame that says that it unpacks to 24 bytes, and unpacks to so many."""
    data = bytearray(packed(size))
    assert data[5] == size
    data[5] = 24
    return bytes(data)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"width_px": 5}, "unpacks to 24 bytes; 5 × 3 uint16 want 30"),
        ({"width_px": 5000}, "5000 and 3"),
        ({"width_px": 4096, "height_px": 1025}, str(MAX_DEPTH_PX)),
        ({"height_px": 0}, "height_px"),
        ({"unit_m": 0.0}, "unit_m is 0"),
        ({"unit_m": NAN}, "unit_m is nan"),
        ({"unit_m": 1.0}, "unit_m is 1"),
        ({"lens": b"123"}, "lens"),
        ({"lens": (LENS * -1).tobytes()}, "fx and fy"),
        ({"lens": (LENS * np.nan).tobytes()}, "nan"),
        ({"depth": b""}, "cannot be unpacked"),
        ({"depth": b"not packed"}, "cannot be unpacked"),
        ({"depth": packed(24)[:-3]}, "cannot be unpacked"),
        ({"depth": packed(24) + b"x"}, "cannot be unpacked"),
        ({"depth": packed(24, told=False)}, "has no unpacked size"),
        ({"depth": packed(0)}, "unpacks to 0 bytes"),
        ({"depth": forged(20)}, "cannot be unpacked"),
        ({"depth": forged(30)}, "cannot be unpacked"),
        ({"sensor": "-"}, "sensor name"),
        ({"schema_version": 2}, "version 2"),
    ],
)
def test_a_depth_frame_that_cannot_be_is_refused(changed: dict[str, Any], named: str) -> None:
    with pytest.raises(WireError, match=named):
        decode_frame(depth_message(**changed))


def test_a_small_message_that_unpacks_to_a_large_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is unpacked."""
    bomb = packed(1 << 30)
    assert len(bomb) < 100_000
    monkeypatch.setattr(zstandard, "ZstdDecompressor", None)  # nobody is asked to unpack it
    with pytest.raises(WireError, match="unpacks to 1073741824 bytes"):
        decode_frame(depth_message(depth=bomb))


def test_the_largest_image_fits_into_a_message() -> None:
    """Also where it cannot be made smaller at all."""
    noise = np.random.default_rng(1).integers(0, 65_536, MAX_DEPTH_PX, np.uint16)
    assert len(pack_depth(noise.reshape(2048, -1))) < MAX_MESSAGE_BYTES - 1000


def arm_message(*arms: Any, **changed: Any) -> bytes:
    frame = ArmFrame("arm", 1, 2, 3, 4, (640, 480), LENS, "m", (some_arm(1, np.random.default_rng(3)),))
    made = pb.ArmFrame.FromString(encode_frame(frame))
    for name, value in changed.items():
        setattr(made.arms[0] if name in pb.SeenArm.DESCRIPTOR.fields_by_name else made, name, value)
    made.arms.extend(arms)
    return bytes(made.SerializeToString())


def points(**rows: Any) -> bytes:
    values = np.ones((len(ARM_POINTS), 3))
    for name, row in rows.items():
        values[ARM_POINTS.index(name)] = row
    return values.tobytes()


def known() -> dict[str, Any]:
    return {"points_m": points(), "point_states": bytes([2] * len(ARM_POINTS))}


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"method": ""}, "method"),
        ({"method": "m" * 81}, "method"),
        ({"reason": "r" * 1001}, "1001 characters"),
        ({"width_px": 9999}, "9999"),
        ({"lens": b""}, "lens"),
        ({"points_m": b"123"}, "points_m"),
        (known() | {"points_m": points(palm=[1, NAN, 1])}, "part of its coordinates"),
        (known() | {"points_m": points(palm=[1, 2000, 1])}, "2000"),
        (known() | {"points_m": points(palm=[1, np.inf, 1])}, "inf"),
        (known() | {"points_m": points(palm=[NAN] * 3)}, "known without a place"),
        (known() | {"point_states": bytes(len(ARM_POINTS))}, "with a place that is not"),
        (known() | {"point_states": bytes([3] * len(ARM_POINTS))}, "has a 3"),
        ({"point_sd_m": np.full(len(ARM_POINTS), -1, "<f4").tobytes()}, "point_sd_m"),
        ({"angles_rad": np.full(len(ANGLES), 4.0).tobytes()}, "angles_rad"),
        ({"T_camera_palm": np.ones(12).tobytes()}, "T_camera_palm"),
        ({"left_sure": 0.25}, "left_sure"),
        ({"gesture_sure": NAN}, "gesture_sure"),
        ({"gesture": "g" * 81}, "gesture"),
        ({"sensor": "-"}, "sensor name"),
    ],
)
def test_an_arm_frame_that_cannot_be_is_refused(changed: dict[str, Any], named: str) -> None:
    with pytest.raises(WireError, match=named):
        decode_frame(arm_message(**changed))


def test_too_many_arms_and_two_of_one_id_are_refused() -> None:
    again = pb.ArmFrame.FromString(arm_message()).arms[0]
    with pytest.raises(WireError, match="id twice"):
        decode_frame(arm_message(again))
    with pytest.raises(WireError, match=f"at most {MAX_ARMS}"):
        decode_frame(arm_message(*[again] * MAX_ARMS))


def test_what_a_table_of_sensors_shows() -> None:
    rng = np.random.default_rng(3)
    arms = ArmFrame("arm", 1, 2, 3, 4, (640, 480), LENS, "m", tuple(some_arm(k, rng) for k in range(3)))
    depth = depth_frame("depth", np.full((3, 4), 700, np.uint16), unit_m=0.001, lens=LENS, time_ns=1, sequence=7)
    assert (arms.bodies, depth.bodies) == (3, 0)
    assert (arms.key, depth.key) == (("arm", 1, 2), ("depth", 0, 7))
    assert depth.size_px == (4, 3)
    np.testing.assert_allclose(depth.metres, 0.7, rtol=1e-6)
    assert depth.metres.dtype == np.float32
    assert format_of(encode_frame(plain_frame())).schema_name == "mocapella.BodyFrame"
    assert msgspec.structs.replace(arms, arms=()).bodies == 0


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"depth": np.ones((3, 4))}, "float64"),
        ({"depth": np.ones((3, 4, 1), np.uint16)}, r"\(3, 4, 1\)"),
        ({"depth": np.ones((0, 4), np.uint16)}, r"\(0, 4\)"),
        ({"unit_m": 1.0}, "unit_m"),
        ({"lens": [476, 476, 3]}, "lens"),
        ({"lens": [476, 0, 3, 2]}, "lens"),
        ({"lens": [476, NAN, 3, 2]}, "lens"),
    ],
)
def test_an_image_that_cannot_be_is_refused(changed: dict[str, Any], named: str) -> None:
    good: dict[str, Any] = {"depth": np.ones((3, 4), np.uint16), "unit_m": 0.001, "lens": LENS[:4]}
    depth_frame("depth", **good, time_ns=0)
    with pytest.raises(SettingsError, match=named):
        depth_frame("depth", **(good | changed), time_ns=0)
