"""Images, frames of plug-ins, and fitted bodies: there and back, and what is refused."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.model.images import ImageFrame, image_frame
from mocapella.model.scene import Phase, Scene, TrackedBody, TrackedBodyView, TrackerState, UnknownPart
from mocapella.model.sensor_frame import UnknownFrame
from mocapella.model.topology import topology
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene, format_of
from mocapella.schema import mocapella_pb2 as pb

KIND = topology("kinect_v2")


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.booleans())
def test_raw_pixels_come_back_as_they_were(seed: int, width: int, height: int, empty_room: bool) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    frame = image_frame("left", pixels, time_ns=seed, empty_room=empty_room, sequence=3)
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, ImageFrame)
    assert (back.size_px, back.format, back.empty_room, back.key) == ((width, height), "raw", empty_room, frame.key)
    np.testing.assert_array_equal(back.data, pixels)
    assert encode_frame(back) == data
    assert format_of(data).schema_name == "mocapella.ImageFrame"


@given(st.sampled_from(["jpeg", "png"]), st.binary(min_size=1, max_size=50))
def test_encoded_images_and_none_come_back_as_they_were(kind: Any, content: bytes) -> None:
    for frame in (
        image_frame("left", content, time_ns=7, format=kind, size_px=(4, 3)),
        image_frame("left", None, time_ns=7, size_px=(4, 3)),
    ):
        data = encode_frame(frame)
        assert decode_frame(data) == frame or msgspec.structs.astuple(decode_frame(data)) == msgspec.structs.astuple(
            frame
        )
        assert encode_frame(decode_frame(data)) == data


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"width_px": 5000}, "width_px"),
        ({"format": "gif"}, "format is 'gif'; raw, jpeg, png, file are read"),
        ({"format": ""}, "image has 36 bytes and no format"),
        ({"image": b""}, "image is empty, and the format is raw"),
        ({"image": bytes(35)}, "image has 35 bytes; 3 × 4 × 3 are wanted"),
    ],
)
def test_an_image_that_does_not_fit_is_refused_with_the_field(changed: dict[str, Any], named: str) -> None:
    made = pb.ImageFrame.FromString(encode_frame(image_frame("left", np.zeros((3, 4, 3), np.uint8), time_ns=1)))
    for name, value in changed.items():
        setattr(made, name, value)
    with pytest.raises(WireError, match=named):
        decode_frame(made.SerializeToString())


@given(st.text(min_size=1, max_size=80), st.binary(max_size=60), st.integers(0, 2**62))
def test_a_frame_that_no_installed_package_reads_is_kept_as_it_came(kind: str, content: bytes, sequence: int) -> None:
    frame = UnknownFrame("left", 1, sequence, 3, 4, kind, content)
    data = encode_frame(frame)
    assert msgspec.structs.astuple(decode_frame(data)) == msgspec.structs.astuple(frame)
    assert encode_frame(decode_frame(data)) == data
    assert format_of(data).schema_name == "mocapella.OtherFrame"


def test_a_plug_ins_frame_without_a_usable_name_is_refused() -> None:
    for kind in ("", "x" * 81):
        with pytest.raises(WireError, match=r"OtherFrame\.kind|topology"):
            decode_frame(pb.OtherFrame(schema_version=1, sensor="a", kind=kind, content=b"1").SerializeToString())


@given(st.sampled_from([pb.ImageFrame, pb.OtherFrame]), st.binary(max_size=80))
def test_no_bytes_do_anything_but_give_a_frame_or_an_error_of_ours(message: Any, tail: bytes) -> None:
    field = {"width_px": 4, "height_px": 3} if message is pb.ImageFrame else {"kind": "thermal"}
    with contextlib.suppress(WireError):
        decode_frame(message(schema_version=1, sensor="a", **field).SerializeToString() + tail)


def body(**changed: Any) -> TrackedBody:
    line = np.array([[1, 2], [3, 4], [np.nan, np.nan], [5, 6]], np.float32)
    views = (
        TrackedBodyView("left", 0.875, "", line, line[:2]),
        TrackedBodyView("right", float("nan"), "its image is black", line[:0], line[:0]),
    )
    places = np.array([[0.5, 1.0, 2.0], [np.nan] * 3])
    made = TrackedBody(
        3, "anna", '{"model":"female"}', np.eye(4), np.array([0.25, -0.5]), ("hip", "knee"), ("left hip", "left knee"),
        places, np.array([2, 0], np.uint8), lost=False, views=views, person=7,
    )  # fmt: skip
    return msgspec.structs.replace(made, **changed)


def scene_of(**parts: tuple[Any, ...]) -> Scene:
    return Scene(1, 2, "left", 3, 4, KIND, TrackerState(Phase.TRACKING), parts)


@pytest.mark.parametrize("person", [-1, 0, 7])
def test_bodies_come_back_as_they_were(person: int) -> None:
    data = encode_scene(scene_of(bodies=(body(person=person), body(id=4, lost=True, views=()))))
    one, other = decode_scene(data).bodies
    assert (one.id, one.name, one.build, one.person, one.lost) == (3, "anna", '{"model":"female"}', person, False)
    assert (one.joint_names, one.landmark_names) == (("hip", "knee"), ("left hip", "left knee"))
    assert (other.id, other.lost, other.views) == (4, True, ())
    for name in ("T_world_model", "angles", "landmarks", "states"):
        np.testing.assert_array_equal(getattr(one, name), getattr(body(), name))
    for back, view in zip(one.views, body().views, strict=True):
        assert (back.camera, back.left_out) == (view.camera, view.left_out)
        np.testing.assert_array_equal([back.overlap], [view.overlap])
        np.testing.assert_array_equal(back.outline_px, view.outline_px)
        np.testing.assert_array_equal(back.contour_px, view.contour_px)
    assert encode_scene(decode_scene(data)) == data


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"name": "x" * 81}, "Body.name"),
        ({"build": "x" * 8193}, "Body.build"),
        ({"angles_rad": bytes(8)}, "Body.angles_rad has 8 bytes"),
        ({"angles_rad": np.array([np.nan, 0.0]).tobytes()}, "Body.angles_rad has a value"),
        ({"landmark_states": bytes((2, 3))}, "Body.landmark_states has a 3"),
        ({"landmarks_m": bytes(24)}, "Body.landmarks_m has 24 bytes"),
        ({"T_world_model": bytes(96)}, "Body.T_world_model is no rigid motion"),
    ],
)
def test_a_body_that_does_not_fit_is_refused_with_the_field(changed: dict[str, Any], named: str) -> None:
    made = pb.Scene.FromString(encode_scene(scene_of(bodies=(body(),))))
    for name, value in changed.items():
        setattr(made.bodies[0], name, value)
    with pytest.raises(WireError, match=named):
        decode_scene(made.SerializeToString())


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"overlap": 1.5}, "BodyView.overlap is 1.5"),
        ({"left_out": "x" * 1001}, "BodyView.left_out"),
        ({"outline_px": bytes(9)}, "BodyView.outline_px has 9 bytes"),
        ({"contour_px": np.array([np.inf, 0], np.float32).tobytes()}, "BodyView.contour_px has an infinite value"),
        ({"contour_px": bytes(8 * 8193)}, "BodyView.contour_px has 8193 points"),
        ({"camera": "../x"}, "sensor name"),
    ],
)
def test_a_bodys_view_that_does_not_fit_is_refused_with_the_field(changed: dict[str, Any], named: str) -> None:
    made = pb.Scene.FromString(encode_scene(scene_of(bodies=(body(),))))
    for name, value in changed.items():
        setattr(made.bodies[0].views[0], name, value)
    with pytest.raises(WireError, match=named):
        decode_scene(made.SerializeToString())


@given(st.lists(st.tuples(st.sampled_from(["spots", "wires"]), st.binary(max_size=20)), max_size=5))
def test_parts_that_no_installed_package_reads_are_kept_as_they_came(given: list[tuple[str, bytes]]) -> None:
    parts: dict[str, tuple[UnknownPart, ...]] = {}
    for kind, content in given:
        parts[kind] = (*parts.get(kind, ()), UnknownPart(kind, content))
    data = encode_scene(scene_of(bodies=(body(),), **parts))
    back = decode_scene(data)
    assert {name: back.of(name) for name in parts} == parts
    assert encode_scene(back) == data


def test_a_part_that_is_no_plug_ins_is_refused_where_plug_ins_parts_are() -> None:
    made = pb.Scene.FromString(encode_scene(scene_of()))
    made.parts.add(kind="people", content=b"")
    with pytest.raises(WireError, match=r"'people', which travels in Scene\.people"):
        decode_scene(made.SerializeToString())
    made = pb.Scene.FromString(encode_scene(scene_of()))
    made.parts.add(kind="", content=b"")
    with pytest.raises(WireError, match=r"OtherPart\.kind"):
        decode_scene(made.SerializeToString())
