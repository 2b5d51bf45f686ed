"""Encode and decode arms: in the frames of a depth camera, and in scenes. Invalid messages are refused."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.arms import ARM_POINTS, ArmFrame, SeenArm
from mocapella.model.hand import ANGLES
from mocapella.model.limits import COORDINATE, SCENE_COORDINATE, Range
from mocapella.model.scene import TrackedArm
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    F8,
    MAX_NAME,
    STATES,
    array,
    choices,
    deviations,
    identity,
    identity_of,
    points,
    sensor_name,
    transform,
)
from mocapella.schema.depth import image_size, lens_of

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

MAX_ARMS: Final = 64
MAX_CAMERAS: Final = 64
MAX_REASON: Final = 1000
"""Longest `ArmFrame.reason`, in characters."""


def encode_arm_frame(frame: ArmFrame) -> bytes:
    """Encode a frame of arms as a protobuf message; equal frames give equal bytes.

    A reason longer than `MAX_REASON` is cut.
    """
    return pb.ArmFrame(
        **identity(frame),
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        lens=frame.lens.astype(F8, copy=False).tobytes(),
        method=frame.method,
        arms=[_encode_arm(arm) for arm in frame.arms],
        reason=frame.reason[:MAX_REASON],
    ).SerializeToString()


def arm_frame_of(m: pb.ArmFrame) -> ArmFrame:
    """Decode a frame of arms from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    size = image_size(m.width_px, m.height_px, "ArmFrame")
    if not 0 < len(m.method) <= MAX_NAME:
        raise WireError(f"ArmFrame.method is {m.method[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    if len(m.reason) > MAX_REASON:
        raise WireError(f"ArmFrame.reason has {len(m.reason)} characters; at most {MAX_REASON} are read")
    if len(m.arms) > MAX_ARMS:
        raise WireError(f"ArmFrame.arms has {len(m.arms)} arms; at most {MAX_ARMS} are read")
    arms = tuple(map(_decode_arm, m.arms))
    if len({arm.id for arm in arms}) != len(arms):
        raise WireError("ArmFrame.arms has an id twice; each arm wants its own")
    return ArmFrame(
        *identity_of(m),
        size,
        lens_of(m.lens, "ArmFrame.lens"),
        m.method,
        arms,
        m.reason,
    )


def _encode_arm(arm: SeenArm) -> pb.SeenArm:
    T = arm.T_camera_palm
    return pb.SeenArm(
        id=arm.id,
        left=arm.left,
        left_sure=arm.left_sure,
        points_m=arm.points.astype(F8, copy=False).tobytes(),
        point_states=arm.states.tobytes(),
        point_sd_m=arm.sd.astype(F4, copy=False).tobytes(),
        angles_rad=arm.angles.astype(F8, copy=False).tobytes(),
        T_camera_palm=b"" if T is None else T[:3].astype(F8, copy=False).tobytes(),
        gesture=arm.gesture,
        gesture_sure=arm.gesture_sure,
        grabbing=arm.grabbing,
    )


def _decode_arm(m: pb.SeenArm) -> SeenArm:
    places, states, sd, angles = _points_of(m, "SeenArm", COORDINATE)
    _check_share(m.left_sure, 0.5, "SeenArm.left_sure")
    return SeenArm(
        m.id,
        m.left,
        m.left_sure,
        places,
        states,
        sd,
        angles,
        transform(m.T_camera_palm, "SeenArm.T_camera_palm", COORDINATE) if m.T_camera_palm else None,
        *_gesture_of(m, "SeenArm"),
    )


def encode_arm(arm: TrackedArm) -> pb.Arm:
    """Encode an arm of a scene as a protobuf message; a missing ``T_world_palm`` becomes an empty field."""
    T = arm.T_world_palm
    return pb.Arm(
        id=arm.id,
        left=arm.left,
        points_m=arm.points.astype(F8, copy=False).tobytes(),
        point_states=arm.states.tobytes(),
        point_sd_m=arm.sd.astype(F4, copy=False).tobytes(),
        angles_rad=arm.angles.astype(F8, copy=False).tobytes(),
        T_world_palm=b"" if T is None else T[:3].astype(F8, copy=False).tobytes(),
        gesture=arm.gesture,
        gesture_sure=arm.gesture_sure,
        grabbing=arm.grabbing,
        person=None if arm.person < 0 else arm.person,
        cameras=arm.cameras,
    )


def decode_arm(m: pb.Arm) -> TrackedArm:
    """Decode an arm of a scene from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    places, states, sd, angles = _points_of(m, "Arm", SCENE_COORDINATE)
    if len(m.cameras) > MAX_CAMERAS:
        raise WireError(f"Arm.cameras has {len(m.cameras)} names; at most {MAX_CAMERAS} are read")
    cameras = tuple(map(sensor_name, m.cameras))
    if len(set(cameras)) != len(cameras):
        raise WireError("Arm.cameras has a name twice; each is wanted once")
    gesture, gesture_sure, grabbing = _gesture_of(m, "Arm")
    return TrackedArm(
        m.id,
        m.left,
        places,
        states,
        sd,
        angles,
        transform(m.T_world_palm, "Arm.T_world_palm") if m.T_world_palm else None,
        gesture,
        gesture_sure,
        grabbing,
        m.person if m.HasField("person") else -1,
        cameras,
    )


def _points_of(m: pb.SeenArm | pb.Arm, kind: str, limit: Range) -> tuple[Float64, UInt8, Float32, Float64]:
    """Decode points, states, standard deviations and angles of an arm; ``kind`` is the message's name for errors."""
    n = len(ARM_POINTS)
    places = points(m.points_m, (n, 3), f"{kind}.points_m", limit)
    states = choices(m.point_states, STATES, n, f"{kind}.point_states")
    there = np.isfinite(places)
    if not (there.all(axis=1) | ~there.any(axis=1)).all():
        raise WireError(f"{kind}.points_m has a point with a part of its coordinates; write NaN for all, or none")
    if not np.array_equal(states > 0, there.all(axis=1)):
        raise WireError(f"{kind}.point_states has a point known without a place, or one with a place that is not")
    angles = array(m.angles_rad, F8, (len(ANGLES),), f"{kind}.angles_rad")
    if (np.abs(angles) > math.pi).any():
        raise WireError(f"{kind}.angles_rad has a value beyond ±π; radians are wanted, or NaN")
    return places, states, deviations(m.point_sd_m, n, f"{kind}.point_sd_m"), angles


def _gesture_of(m: pb.SeenArm | pb.Arm, kind: str) -> tuple[str, float, bool]:
    _check_share(m.gesture_sure, 0.0, f"{kind}.gesture_sure")
    if len(m.gesture) > MAX_NAME:
        raise WireError(f"{kind}.gesture has {len(m.gesture)} characters; at most {MAX_NAME} are read")
    return m.gesture, m.gesture_sure, m.grabbing


def _check_share(value: float, least: float, field: str) -> None:
    if not least <= value <= 1:  # NaN compares false
        raise WireError(f"{field} is {value:g}; it wants {least:g} to 1")
