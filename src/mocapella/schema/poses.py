"""Encode and decode frames with poses of rigid bodies; invalid messages are refused."""

from __future__ import annotations

from typing import Final

import numpy as np

from mocapella.errors import WireError
from mocapella.model.poses import PoseFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    MAX_COORDINATE,
    MAX_NAME,
    STATES,
    array,
    choices,
    identity,
    identity_of,
    names,
)

_UNIT: Final = 1e-3
"""Tolerance of a quaternion's length."""


def encode_pose_frame(frame: PoseFrame) -> bytes:
    """Encode a pose frame as a protobuf message; equal frames give equal bytes."""
    return pb.PoseFrame(
        **identity(frame),
        space=frame.space,
        names=frame.names,
        positions_m=frame.positions.astype(F4, copy=False).tobytes(),
        orientations=frame.orientations.astype(F4, copy=False).tobytes(),
        states=frame.states.tobytes(),
    ).SerializeToString()


def pose_frame_of(m: pb.PoseFrame) -> PoseFrame:
    """Decode a pose frame from a parsed protobuf message, and check its values.

    Each body must have a complete pose, or only NaN. If the message has no states, bodies with a pose are tracked.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    if not 0 < len(m.space) <= MAX_NAME:
        raise WireError(f"PoseFrame.space is {m.space[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    bodies = names(m.names, "PoseFrame.names")
    n = len(bodies)
    positions = array(m.positions_m, F4, (n, 3), "PoseFrame.positions_m")
    orientations = array(m.orientations, F4, (n, 4), "PoseFrame.orientations")
    both = np.concatenate([positions, orientations], axis=1)
    there = np.isfinite(both).all(axis=1)
    if not (there | np.isnan(both).all(axis=1)).all():
        raise WireError("PoseFrame has a body with a part of a pose; write NaN for all of it, or for none")
    if (np.abs(positions[there]) > MAX_COORDINATE).any():
        far = positions[there].flat[np.abs(positions[there]).argmax()]
        raise WireError(f"PoseFrame.positions_m has a {far:g}; coordinates are within ±{MAX_COORDINATE:g} m, or NaN")
    length = np.linalg.norm(orientations[there].astype(np.float64), axis=1)
    if (np.abs(length - 1) > _UNIT).any():
        wrong = length[np.abs(length - 1).argmax()]
        raise WireError(f"PoseFrame.orientations has a quaternion of length {wrong:g}; unit quaternions are wanted")
    if m.states:
        states = choices(m.states, STATES, n, "PoseFrame.states")
        if not np.array_equal(states > 0, there):
            raise WireError(
                "PoseFrame.states has a body that is tracked without a pose, or one with a pose that is not"
            )
    else:
        states = np.where(there, 2, 0).astype(np.uint8)
    return PoseFrame(
        *identity_of(m), m.space, bodies, positions, orientations,
        states,
    )  # fmt: skip
