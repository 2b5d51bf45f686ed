"""Arms that one depth camera saw to bytes and back, with everything that is not ours refused at the door."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mocapella.errors import WireError
from mocapella.model.arms import ARM_POINTS, ArmFrame, SeenArm
from mocapella.model.hand import ANGLES
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    F8,
    MAX_NAME,
    SCHEMA_VERSION,
    STATES,
    array,
    choices,
    deviations,
    points,
    sensor_name,
    transform,
)
from mocapella.schema.depth import image_size, lens_of

MAX_ARMS: Final = 64
MAX_REASON: Final = 1000
"""Characters."""


def encode_arm_frame(frame: ArmFrame) -> bytes:
    """Write a frame; the same numbers give the same bytes."""
    return pb.ArmFrame(
        schema_version=SCHEMA_VERSION,
        sensor=frame.sensor,
        node_id=frame.node_id,
        sequence=frame.sequence,
        time_ns=frame.time_ns,
        sent_ns=frame.sent_ns,
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        lens=frame.lens.astype(F8, copy=False).tobytes(),
        method=frame.method,
        arms=[_encode_arm(arm) for arm in frame.arms],
        reason=frame.reason[:MAX_REASON],
    ).SerializeToString()


def arm_frame_of(m: pb.ArmFrame) -> ArmFrame:
    """Check a message and make a frame of it.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and what it wants.
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
        sensor_name(m.sensor),
        m.node_id,
        m.sequence,
        m.time_ns,
        m.sent_ns,
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
    n = len(ARM_POINTS)
    places = points(m.points_m, (n, 3), "SeenArm.points_m")
    states = choices(m.point_states, STATES, n, "SeenArm.point_states")
    there = np.isfinite(places)
    if not (there.all(axis=1) | ~there.any(axis=1)).all():
        raise WireError("SeenArm.points_m has a point with a part of its coordinates; write NaN for all, or none")
    if not np.array_equal(states > 0, there.all(axis=1)):
        raise WireError("SeenArm.point_states has a point known without a place, or one with a place that is not")
    angles = array(m.angles_rad, F8, (len(ANGLES),), "SeenArm.angles_rad")
    if (np.abs(angles) > math.pi).any():
        raise WireError("SeenArm.angles_rad has a value beyond ±π; radians are wanted, or NaN")
    for field, least in (("left_sure", 0.5), ("gesture_sure", 0.0)):
        if not least <= getattr(m, field) <= 1:  # NaN compares false
            raise WireError(f"SeenArm.{field} is {getattr(m, field):g}; it wants {least:g} to 1")
    if len(m.gesture) > MAX_NAME:
        raise WireError(f"SeenArm.gesture has {len(m.gesture)} characters; at most {MAX_NAME} are read")
    return SeenArm(
        m.id,
        m.left,
        m.left_sure,
        places,
        states,
        deviations(m.point_sd_m, n, "SeenArm.point_sd_m"),
        angles,
        transform(m.T_camera_palm, "SeenArm.T_camera_palm") if m.T_camera_palm else None,
        m.gesture,
        m.gesture_sure,
        m.grabbing,
    )
