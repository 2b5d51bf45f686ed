"""Marker frames, and the hands, points and objects of a scene: there and back, and what is refused."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.messages import hands_scene, marker_frames, plain_frame

from mocapella.errors import SettingsError, WireError
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene, format_of
from mocapella.schema import mocapella_pb2 as pb

NAN = float("nan")


def same(one: Any, other: Any) -> bool:
    """Whether two structs have the same values, NaN included."""
    for name in one.__struct_fields__:
        a, b = getattr(one, name), getattr(other, name)
        alike = np.array_equal(a, b, equal_nan=a.dtype.kind == "f") if isinstance(a, np.ndarray) else a == b
        if not alike:
            return False
    return True


@given(marker_frames())
def test_a_marker_frame_comes_back_as_it_was(frame: MarkerFrame) -> None:
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, MarkerFrame)
    assert same(back, frame)
    assert encode_frame(back) == data
    assert format_of(data).schema_name == "mocapella.MarkerFrame"


@given(st.binary(max_size=80))
def test_no_bytes_do_anything_but_give_a_frame_or_an_error_of_ours(data: bytes) -> None:
    head = pb.MarkerFrame(schema_version=1, sensor="left", width_px=640, height_px=480).SerializeToString()
    for message in (data, head + data):
        with contextlib.suppress(WireError):
            decode_frame(message)


def test_a_body_frame_is_still_one() -> None:
    data = encode_frame(plain_frame())
    assert format_of(data).schema_name == "mocapella.BodyFrame"
    assert encode_frame(decode_frame(data)) == data


def message(**changed: Any) -> bytes:
    frame = marker_frame("left", ["red", "blue"], time_ns=1, size_px=(640, 480), positions_px=[[1, 2], [NAN, NAN]])
    made = pb.MarkerFrame.FromString(encode_frame(frame))
    for name, value in changed.items():
        if name == "names":
            del made.names[:]
            made.names.extend(value)
        else:
            setattr(made, name, value)
    return bytes(made.SerializeToString())


def floats(*values: float) -> bytes:
    return np.array(values, "<f4").tobytes()


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"names": ["red"]}, "positions_px"),
        ({"names": ["red", "red"]}, "twice"),
        ({"names": ["red", ""]}, "names"),
        ({"names": ["red", "x" * 81]}, "names"),
        ({"names": [str(i) for i in range(1025)]}, "1025 names"),
        ({"height_px": 0}, "height_px"),
        ({"width_px": 70_000}, "width_px"),
        ({"positions_px": floats(640, 2, NAN, NAN)}, "640"),
        ({"positions_px": floats(1, np.inf, NAN, NAN)}, "inf"),
        ({"positions_px": floats(1, NAN, NAN, NAN)}, "one coordinate"),
        ({"sd_px": floats(-1, NAN)}, "sd_px"),
        ({"areas_px": floats(1e9, 0)}, "areas_px"),
        ({"confidences": floats(NAN, 0)}, "confidences"),
        ({"confidences": floats(0.5)}, "confidences"),
        ({"sensor": "-"}, "sensor name"),
        ({"schema_version": 2}, "version 2"),
    ],
)
def test_what_is_refused_is_named(changed: dict[str, Any], named: str) -> None:
    with pytest.raises(WireError, match=named):
        decode_frame(message(**changed))


def test_what_a_small_program_leaves_out_is_filled_in() -> None:
    frame = decode_frame(message(sd_px=b"", areas_px=b"", confidences=b""))
    assert isinstance(frame, MarkerFrame)
    assert np.isnan(frame.sd_px).all()
    assert frame.areas_px.tolist() == [0, 0]
    assert frame.confidences.tolist() == [1, 0]


def test_markers_of_a_wrong_shape_are_refused() -> None:
    for names in (["red", "red"], ["red", ""]):
        with pytest.raises(SettingsError, match="a name of its own"):
            marker_frame("left", names, time_ns=0, size_px=(2, 2), positions_px=np.zeros((2, 2)))
    with pytest.raises(SettingsError, match="positions_px"):
        marker_frame("left", ["red"], time_ns=0, size_px=(2, 2), positions_px=np.zeros((2, 2)))
    with pytest.raises(SettingsError, match="sd_px"):
        marker_frame("left", ["red"], time_ns=0, size_px=(2, 2), positions_px=np.zeros((1, 2)), sd_px=[1, 2])


def test_a_scene_with_hands_comes_back_as_it_was() -> None:
    scene = hands_scene()
    back = decode_scene(encode_scene(scene))
    assert all(same(one, other) for one, other in zip(back.hands, scene.hands, strict=True))
    assert all(same(one, other) for one, other in zip(back.objects, scene.objects, strict=True))
    assert back.points is not None
    assert scene.points is not None
    assert same(back.points, scene.points)
    assert encode_scene(back) == encode_scene(scene)


@pytest.mark.parametrize(
    ("part", "field", "value", "named"),
    [
        ("hands", "landmarks_m", b"1234", "Hand.landmarks_m"),
        ("hands", "landmark_states", bytes([3] * 21), "Hand.landmark_states"),
        ("hands", "landmark_sd_m", floats(*[-1] * 21), "Hand.landmark_sd_m"),
        ("hands", "angles_rad", np.full(21, 4.0).tobytes(), "Hand.angles_rad"),
        ("hands", "T_world_palm", np.ones(12).tobytes(), "Hand.T_world_palm"),
        ("hands", "holds", "x" * 81, "Hand.holds"),
        ("objects", "name", "", "Object.name"),
        ("objects", "state", 3, "Object.state"),
        ("objects", "outline_m", np.full(3, 1e9).tobytes(), "Object.outline_m"),
        ("objects", "outline_m", np.zeros(3 * 1025).tobytes(), "1025 points"),
        ("points", "cameras", b"1", "Points.cameras"),
        ("points", "positions_m", b"1", "Points.positions_m"),
    ],
)
def test_a_scene_whose_hands_cannot_be_is_refused(part: str, field: str, value: Any, named: str) -> None:
    made = pb.Scene.FromString(encode_scene(hands_scene()))
    one = getattr(made, part)
    setattr(one if part == "points" else one[0], field, value)
    with pytest.raises(WireError, match=named):
        decode_scene(made.SerializeToString())


def test_a_marker_frame_says_how_many_markers_are_seen() -> None:
    frame = marker_frame("left", ["red", "blue"], time_ns=1, size_px=(640, 480), positions_px=[[1, 2], [NAN, 3]])
    assert frame.bodies == 1
    assert frame.found.tolist() == [True, False]
    assert np.isnan(frame.positions_px[1]).all()
    assert msgspec.structs.replace(frame, sequence=3).key == ("left", 0, 3)
