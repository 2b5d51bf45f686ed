"""Both sides of each bound of the decoders: the last value that is read, and the first that is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from schema.test_codec_images import body, scene_of
from support.messages import arms_scene, frames, hands_scene, message, plain_frame, small_scene, some_arm

from mocapella.errors import WireError
from mocapella.model.arms import ARM_POINTS, ArmFrame
from mocapella.model.depth import depth_frame
from mocapella.model.hand import ANGLES
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.markers import marker_frame
from mocapella.model.observations import BodyFrame
from mocapella.model.poses import pose_frame
from mocapella.model.topology import topology
from mocapella.schema import body_frames, decode_frame, decode_scene, encode_frame, encode_scene
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.arms import MAX_ARMS, MAX_CAMERAS
from mocapella.schema.bodies import MAX_BUILD, MAX_LINE, MAX_VIEWS
from mocapella.schema.checks import MAX_BODIES, MAX_NAME, MAX_POINTS, parse
from mocapella.schema.depth import MAX_DEPTH_PX, MAX_DEPTH_SIDE_PX, UNITS_M, image_size
from mocapella.schema.keypoints import MAX_PX
from mocapella.schema.markers import MAX_SIDE_PX

LENS = np.array([476.0, 476.0, 3.5, 2.5, 0, 0, 0, 0, 0])
SIZE = (640, 480)


def after(value: float, kind: type[np.floating[Any]] = np.float64) -> Any:
    """The number that follows ``value``, away from 0."""
    return np.nextafter(kind(value), kind(math.copysign(math.inf, value)))


def doubles(*values: float, length: int = 0) -> bytes:
    """Packed float64, with 0 up to ``length``."""
    return np.array([*values, *[0.0] * (length - len(values))], "<f8").tobytes()


def singles(*values: float) -> bytes:
    return np.array(values, "<f4").tobytes()


def named(count: int) -> list[str]:
    return [f"n{k}" for k in range(count)]


def moved(x: float) -> bytes:
    """A motion without a turn, along x."""
    return doubles(1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0)


def arms() -> ArmFrame:
    return ArmFrame("arm", 1, 2, 3, 4, SIZE, LENS, "m", (some_arm(1, np.random.default_rng(3)),))


FRAMES: dict[str, Callable[[], Any]] = {
    "BodyFrame": lambda: message(1),
    "DepthFrame": lambda: pb.DepthFrame.FromString(
        encode_frame(depth_frame("depth", np.full((3, 4), 700, np.uint16), unit_m=0.001, lens=LENS, time_ns=1))
    ),
    "MarkerFrame": lambda: pb.MarkerFrame.FromString(
        encode_frame(marker_frame("left", ["red"], time_ns=1, size_px=SIZE, positions_px=[[1, 2]]))
    ),
    "PoseFrame": lambda: pb.PoseFrame.FromString(
        encode_frame(pose_frame("vive", "vr", ["cup"], time_ns=1, positions=[[1, 2, 3]], orientations=[[1, 0, 0, 0]]))
    ),
    "ArmFrame": lambda: pb.ArmFrame.FromString(encode_frame(arms())),
    "KeypointFrame": lambda: pb.KeypointFrame.FromString(
        encode_frame(
            keypoint_frame("left", topology("coco_17"), time_ns=1, size_px=SIZE, positions_px=np.ones((1, 17, 2)))
        )
    ),
    "OtherFrame": lambda: pb.OtherFrame(schema_version=1, sensor="roof", kind="radar"),
}
SCENES: dict[str, Callable[[], Any]] = {
    "people": small_scene,
    "hands": hands_scene,
    "arms": arms_scene,
    "bodies": lambda: scene_of(bodies=(body(),)),
}


def read(kind: str, path: str, value: Any) -> Any:
    """Decode a message of a kind with one field changed, given as such as ``arms.0.angles_rad``."""
    made: Any = FRAMES[kind]() if kind in FRAMES else pb.Scene.FromString(encode_scene(SCENES[kind]()))
    *above, last = path.split(".")
    one = made
    for part in above:
        one = one[int(part)] if part.isdigit() else getattr(one, part)
    if isinstance(value, list):
        one.ClearField(last)
        getattr(one, last).extend(value)
    else:
        setattr(one, last, value)
    return (decode_frame if kind in FRAMES else decode_scene)(made.SerializeToString())


N_ANGLES, N_POINTS = len(ANGLES), len(ARM_POINTS)
PI = math.pi
FAR_32 = after(1000.0, np.float32)
BOUNDS: list[tuple[str, str, Any, Any]] = [
    # kind, field, the last value that is read, the first that is refused
    ("BodyFrame", "tilt_rad", float(np.float32(3.1415925)), float(np.float32(3.1415928))),
    ("BodyFrame", "tilt_rad", -float(np.float32(3.1415925)), -float(np.float32(3.1415928))),
    ("BodyFrame", "height_m", 1000.0, float(FAR_32)),
    ("BodyFrame", "height_m", -1000.0, -float(FAR_32)),
    ("BodyFrame", "positions_m", singles(1000.0, *[0.0] * 74), singles(FAR_32, *[0.0] * 74)),
    ("DepthFrame", "unit_m", UNITS_M[0], float(np.nextafter(UNITS_M[0], 0.0))),
    ("DepthFrame", "unit_m", UNITS_M[1], float(after(UNITS_M[1]))),
    ("DepthFrame", "lens", doubles(1, 1, 1e6, length=9), doubles(1, 1, after(1e6), length=9)),
    ("DepthFrame", "lens", doubles(1, 1, -1e6, length=9), doubles(1, 1, after(-1e6), length=9)),
    ("DepthFrame", "lens", doubles(1, 5e-324, length=9), doubles(1, 0, length=9)),
    ("MarkerFrame", "positions_px", singles(-0.5, 0), singles(after(-0.5, np.float32), 0)),
    ("MarkerFrame", "positions_px", singles(0, -0.5), singles(0, after(-0.5, np.float32))),
    ("MarkerFrame", "positions_px", singles(639.5, 0), singles(after(639.5, np.float32), 0)),
    ("MarkerFrame", "positions_px", singles(0, 479.5), singles(0, after(479.5, np.float32))),
    ("MarkerFrame", "width_px", MAX_SIDE_PX, MAX_SIDE_PX + 1),
    ("MarkerFrame", "height_px", MAX_SIDE_PX, MAX_SIDE_PX + 1),
    ("MarkerFrame", "areas_px", singles(640 * 480), singles(after(640 * 480, np.float32))),
    ("MarkerFrame", "areas_px", singles(0), singles(-1e-45)),
    ("MarkerFrame", "confidences", singles(1), singles(after(1, np.float32))),
    ("MarkerFrame", "sd_px", singles(0), singles(-1e-45)),
    ("MarkerFrame", "names", ["x" * MAX_NAME], ["x" * (MAX_NAME + 1)]),
    ("MarkerFrame", "names", ["x"], [""]),
    ("PoseFrame", "space", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("PoseFrame", "space", "x", ""),
    ("PoseFrame", "positions_m", singles(0, -1000, 0), singles(0, -FAR_32, 0)),
    ("PoseFrame", "positions_m", singles(0, 0, 1000), singles(0, 0, FAR_32)),
    ("PoseFrame", "orientations", singles(1.0009, 0, 0, 0), singles(1.0011, 0, 0, 0)),
    ("PoseFrame", "orientations", singles(0, 0.9991, 0, 0), singles(0, 0.9989, 0, 0)),
    ("PoseFrame", "states", b"\1", b"\0"),
    ("ArmFrame", "method", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("ArmFrame", "method", "x", ""),
    ("ArmFrame", "reason", "x" * 1000, "x" * 1001),
    ("ArmFrame", "arms.0.left_sure", 0.5, float(np.nextafter(np.float32(0.5), np.float32(0)))),
    ("ArmFrame", "arms.0.left_sure", 1.0, float(after(1, np.float32))),
    ("ArmFrame", "arms.0.gesture_sure", 0.0, -1e-45),
    ("ArmFrame", "arms.0.gesture_sure", 1.0, float(after(1, np.float32))),
    ("ArmFrame", "arms.0.gesture", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("ArmFrame", "arms.0.angles_rad", doubles(PI, length=N_ANGLES), doubles(after(PI), length=N_ANGLES)),
    ("ArmFrame", "arms.0.angles_rad", doubles(-PI, length=N_ANGLES), doubles(after(-PI), length=N_ANGLES)),
    ("ArmFrame", "arms.0.T_camera_palm", moved(1000.0), moved(float(after(1000.0)))),
    ("ArmFrame", "arms.0.T_camera_palm", moved(-1000.0), moved(float(after(-1000.0)))),
    ("KeypointFrame", "width_px", MAX_SIDE_PX, MAX_SIDE_PX + 1),
    ("KeypointFrame", "height_px", 1, 0),
    ("KeypointFrame", "positions_px", singles(*[MAX_PX] * 34), singles(after(MAX_PX, np.float32), *[1.0] * 33)),
    ("KeypointFrame", "positions_px", singles(*[-MAX_PX] * 34), singles(after(-MAX_PX, np.float32), *[1.0] * 33)),
    ("KeypointFrame", "confidences", singles(*[1.0] * 17), singles(after(1, np.float32), *[1.0] * 16)),
    ("KeypointFrame", "confidences", singles(*[1e-45] * 17), singles(-1e-45, *[1.0] * 16)),
    ("KeypointFrame", "relative_m", singles(*[1000.0] * 51), singles(FAR_32, *[0.0] * 50)),
    ("KeypointFrame", "relative_m", singles(*[-1000.0] * 51), singles(-FAR_32, *[0.0] * 50)),
    ("OtherFrame", "kind", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("people", "people.0.positions_m", doubles(1e6, length=75), doubles(after(1e6), length=75)),
    ("people", "people.0.positions_m", doubles(-1e6, length=75), doubles(after(-1e6), length=75)),
    ("people", "people.0.joint_sd_m", singles(*[0.0] * 25), singles(*[0.0] * 24, -1e-45)),
    ("people", "people.0.views.0.height_m", 1000.0, float(FAR_32)),
    ("people", "people.0.views.0.T_world_sensor", moved(1e6), moved(float(after(1e6)))),
    ("people", "sensors.0.position_sd_m", 0.0, -5e-324),
    ("people", "sensors.0.rotation_sd_rad", 1e300, math.inf),
    ("hands", "hands.0.angles_rad", doubles(PI, length=N_ANGLES), doubles(after(PI), length=N_ANGLES)),
    ("hands", "hands.0.angles_rad", doubles(-PI, length=N_ANGLES), doubles(after(-PI), length=N_ANGLES)),
    ("hands", "hands.0.holds", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("hands", "objects.0.name", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("hands", "objects.0.outline_m", doubles(length=3 * MAX_POINTS), doubles(length=3 * (MAX_POINTS + 1))),
    ("hands", "objects.0.state", 2, 3),
    ("arms", "arms.0.cameras", named(MAX_CAMERAS), named(MAX_CAMERAS + 1)),
    ("arms", "arms.0.gesture", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("arms", "arms.0.angles_rad", doubles(PI, length=N_ANGLES), doubles(after(PI), length=N_ANGLES)),
    ("bodies", "bodies.0.name", "x" * MAX_NAME, "x" * (MAX_NAME + 1)),
    ("bodies", "bodies.0.build", "x" * MAX_BUILD, "x" * (MAX_BUILD + 1)),
    ("bodies", "bodies.0.angles_rad", doubles(100, -100), doubles(after(100), 0)),
    ("bodies", "bodies.0.angles_rad", doubles(100, -100), doubles(0, after(-100))),
    ("bodies", "bodies.0.views.0.overlap", 0.0, -5e-324),
    ("bodies", "bodies.0.views.0.overlap", 1.0, float(after(1.0))),
    ("bodies", "bodies.0.views.0.left_out", "x" * 1000, "x" * 1001),
    ("bodies", "bodies.0.views.0.outline_px", bytes(8 * MAX_LINE), bytes(8 * (MAX_LINE + 1))),
]


@pytest.mark.parametrize(("kind", "path", "last", "beyond"), BOUNDS)
def test_the_last_value_is_read_and_the_next_is_refused(kind: str, path: str, last: Any, beyond: Any) -> None:
    read(kind, path, last)
    with pytest.raises(WireError):
        read(kind, path, beyond)


@pytest.mark.parametrize(
    ("kind", "path", "most"), [("ArmFrame", "arms", MAX_ARMS), ("bodies", "bodies.0.views", MAX_VIEWS)]
)
def test_as_many_parts_are_read_as_the_limit_says(kind: str, path: str, most: int) -> None:
    empty = {"ArmFrame": arms_of, "bodies": views_of}[kind]
    read(kind, path, empty(most))
    with pytest.raises(WireError, match=f"at most {most}"):
        read(kind, path, empty(most + 1))


def arms_of(count: int) -> list[Any]:
    rng = np.random.default_rng(1)
    frame = ArmFrame("arm", 1, 2, 3, 4, SIZE, LENS, "m", tuple(some_arm(k, rng) for k in range(count)))
    return list(pb.ArmFrame.FromString(encode_frame(frame)).arms)


def views_of(count: int) -> list[Any]:
    return [pb.BodyView(camera=f"c{k}", overlap=math.nan) for k in range(count)]


def test_as_many_markers_are_read_as_the_limit_says() -> None:
    for count in (MAX_POINTS, MAX_POINTS + 1):
        made = pb.MarkerFrame(schema_version=1, sensor="left", width_px=2, height_px=2, names=named(count))
        made.positions_px = singles(*[math.nan] * 2 * count)
        if count == MAX_POINTS:
            assert len(decode_frame(made.SerializeToString()).names) == MAX_POINTS
        else:
            with pytest.raises(WireError, match=f"at most {MAX_POINTS}"):
                decode_frame(made.SerializeToString())


@pytest.mark.parametrize(
    ("width", "height", "fits"),
    [
        (1, 1, True),
        (0, 1, False),
        (1, 0, False),
        (MAX_DEPTH_SIDE_PX, 1, True),
        (1, MAX_DEPTH_SIDE_PX, True),
        (MAX_DEPTH_SIDE_PX + 1, 1, False),
        (1, MAX_DEPTH_SIDE_PX + 1, False),
        (MAX_DEPTH_SIDE_PX, MAX_DEPTH_PX // MAX_DEPTH_SIDE_PX, True),
        (MAX_DEPTH_SIDE_PX, MAX_DEPTH_PX // MAX_DEPTH_SIDE_PX + 1, False),
    ],
)
def test_an_image_has_sides_and_an_area_within_limits(width: int, height: int, fits: bool) -> None:
    if fits:
        assert image_size(width, height, "DepthFrame") == (width, height)
    else:
        with pytest.raises(WireError, match="they want 1 to"):
            image_size(width, height, "DepthFrame")


def test_scenes_of_three_megabytes_are_read() -> None:
    assert len(read("people", "reason", "x" * 3_000_000).state.reason) == 3_000_000


def test_a_message_may_be_as_long_as_the_limit() -> None:
    data = encode_frame(plain_frame(1))
    assert parse(pb.BodyFrame, data, len(data)).sensor == "front"
    with pytest.raises(WireError, match=f"at most {len(data) - 1}"):
        parse(pb.BodyFrame, data, len(data) - 1)


@given(frames())
@settings(max_examples=15)
def test_a_valid_frame_is_not_examined_field_by_field(frame: BodyFrame) -> None:
    data = encode_frame(frame)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(body_frames, "_refuse_misfit", lambda *_: pytest.fail("examined"))
        decode_frame(data)


def test_as_many_bodies_and_as_far_as_allowed_are_not_examined_closely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_frames, "_refuse_misfit", lambda *_: pytest.fail("examined"))
    monkeypatch.setattr(body_frames, "_refuse_bad_positions", lambda *_: pytest.fail("searched"))
    read("BodyFrame", "positions_m", singles(-1000.0, *[0.0] * 74))
    decode_frame(encode_frame(plain_frame(MAX_BODIES, topology("hand"))))


@pytest.mark.parametrize(
    ("field", "right"), [("joint_states", 50), ("positions_m", 600), ("depth_px", 400), ("orientations", 800)]
)
@pytest.mark.parametrize(
    "length", sorted({27, 54, 2 + 50, 12 * 27, 12 + 50, 8 * 27, 8 + 50, 16 * 27, 16 + 50, 599, 601})
)
def test_only_the_product_of_bodies_joints_and_values_is_a_fields_length(field: str, right: int, length: int) -> None:
    assert length != right
    with pytest.raises(WireError, match=f"BodyFrame.{field} has {length} bytes"):
        decode_frame(message(**{field: bytes(length)}).SerializeToString())


def test_lengths_that_fit_each_other_must_fit_the_bodies() -> None:
    """27 joints are two bodies and 25 joints, not two bodies of 25 joints."""
    parts = {"joint_states": 27, "positions_m": 12 * 27, "depth_px": 8 * 27, "orientations": 16 * 27}
    with pytest.raises(WireError, match="joint_states has 27 bytes"):
        decode_frame(message(**{field: bytes(length) for field, length in parts.items()}).SerializeToString())
