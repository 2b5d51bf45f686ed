"""Keypoint frames: there and back, and what is refused."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.messages import keypoint_frames

from mocapella.errors import SettingsError, WireError
from mocapella.model.keypoints import NO_ID, KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.schema import decode_frame, encode_frame, format_of
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import MAX_BODIES, MAX_COORDINATE
from mocapella.schema.keypoints import MAX_PX
from mocapella.schema.markers import MAX_SIDE_PX

COCO = topology("coco_17")
JOINTS = len(COCO)


def same(one: Any, other: Any) -> bool:
    """Whether two structs have the same values, NaN included."""
    for name in one.__struct_fields__:
        a, b = getattr(one, name), getattr(other, name)
        alike = np.array_equal(a, b, equal_nan=a.dtype.kind == "f") if isinstance(a, np.ndarray) else a == b
        if not alike:
            return False
    return True


@given(keypoint_frames())
def test_a_keypoint_frame_comes_back_as_it_was(frame: KeypointFrame) -> None:
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, KeypointFrame)
    assert same(back, frame)
    assert encode_frame(back) == data
    assert format_of(data).schema_name == "mocapella.KeypointFrame"


@given(st.binary(max_size=80))
def test_no_bytes_of_a_keypoint_frame_raise_another_error(data: bytes) -> None:
    head = pb.KeypointFrame(schema_version=1, sensor="left", topology="coco_17", width_px=640, height_px=480)
    for message in (data, head.SerializeToString() + data):
        with contextlib.suppress(WireError):
            decode_frame(message)


def keypoint_message(**changed: Any) -> bytes:
    frame = keypoint_frame(
        "left", COCO, time_ns=1, size_px=(640, 480), positions_px=np.full((1, JOINTS, 2), 5.0), confidences=0.5
    )
    made = pb.KeypointFrame.FromString(encode_frame(frame))
    for name, value in changed.items():
        setattr(made, name, value)
    return bytes(made.SerializeToString())


def one_of_all(value: float, others: float, count: int) -> bytes:
    """Packed float32: one value and then ``others``."""
    return np.array([value, *[others] * (count - 1)], "<f4").tobytes()


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"topology": "nobody"}, "nobody"),
        ({"width_px": 0}, "width_px"),
        ({"height_px": MAX_SIDE_PX + 1}, "height_px"),
        ({"ids": b"1234"}, "ids"),
        ({"ids": bytes(8 * (MAX_BODIES + 1))}, f"at most {MAX_BODIES}"),
        ({"ids": bytes(16)}, "positions_px"),
        ({"positions_px": one_of_all(2 * MAX_PX, 5, 2 * JOINTS)}, "positions_px"),
        ({"positions_px": one_of_all(np.inf, 5, 2 * JOINTS)}, "positions_px"),
        ({"positions_px": one_of_all(np.nan, 5, 2 * JOINTS)}, "one coordinate"),
        ({"confidences": b""}, "confidences"),
        ({"confidences": one_of_all(1.5, 0.5, JOINTS)}, "from 0 to 1"),
        ({"confidences": one_of_all(-0.5, 0.5, JOINTS)}, "from 0 to 1"),
        ({"confidences": one_of_all(np.nan, 0.5, JOINTS)}, "from 0 to 1"),
        ({"confidences": one_of_all(0.0, 0.5, JOINTS)}, "0 where it is not"),
        ({"relative_m": b"1234"}, "relative_m"),
        ({"relative_m": one_of_all(2 * MAX_COORDINATE, 0, 3 * JOINTS)}, "relative_m"),
        ({"sensor": "-"}, "sensor name"),
        ({"schema_version": 2}, "version 2"),
    ],
)
def test_a_wrong_keypoint_frame_is_refused_by_its_field(changed: dict[str, Any], named: str) -> None:
    with pytest.raises(WireError, match=named):
        decode_frame(keypoint_message(**changed))


@pytest.mark.parametrize(
    "changed",
    [
        {"width_px": MAX_SIDE_PX},
        {"positions_px": one_of_all(MAX_PX, -MAX_PX, 2 * JOINTS)},
        {"confidences": one_of_all(1.0, 1e-6, JOINTS)},
        {"relative_m": one_of_all(MAX_COORDINATE, -MAX_COORDINATE, 3 * JOINTS)},
        {"relative_m": one_of_all(np.nan, 0, 3 * JOINTS)},
    ],
)
def test_the_last_values_of_keypoints_are_read(changed: dict[str, Any]) -> None:
    assert isinstance(decode_frame(keypoint_message(**changed)), KeypointFrame)


def test_an_image_of_nobody_has_no_detection() -> None:
    frame = keypoint_frame("left", COCO, time_ns=1, size_px=(2, 2), positions_px=[])
    back = decode_frame(encode_frame(frame))
    assert isinstance(back, KeypointFrame)
    assert (back.bodies, back.positions_px.shape, back.relative) == (0, (0, JOINTS, 2), None)


def test_a_keypoint_without_confidence_or_coordinate_is_not_seen() -> None:
    positions = np.full((1, JOINTS, 2), 5.0)
    positions[0, 2, 1] = np.nan
    sure = np.full((1, JOINTS), 0.5)
    sure[0, 1] = 0
    frame = keypoint_frame("left", COCO, time_ns=1, size_px=(9, 9), positions_px=positions, confidences=sure)
    assert frame.found[0, :4].tolist() == [True, False, False, True]
    assert frame.confidences[0, :4].tolist() == [0.5, 0, 0, 0.5]
    assert frame.ids.tolist() == [NO_ID]


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"positions_px": np.zeros((1, 3, 2))}, "positions_px"),
        ({"confidences": np.ones((2, JOINTS))}, "confidences"),
        ({"ids": [1, 2]}, "ids"),
    ],
)
def test_keypoints_of_a_wrong_shape_are_refused(changed: dict[str, Any], named: str) -> None:
    right: dict[str, Any] = {"positions_px": np.zeros((1, JOINTS, 2))}
    with pytest.raises(SettingsError, match=named):
        keypoint_frame("left", COCO, time_ns=0, size_px=(2, 2), **(right | changed))
