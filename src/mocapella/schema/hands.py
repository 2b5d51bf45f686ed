"""Encode and decode hands, named points and objects of a scene; invalid messages are refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.hand import ANGLES, LANDMARKS
from mocapella.model.scene import TrackedHand, TrackedObject, TrackedPoints
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    F8,
    MAX_NAME,
    MAX_POINTS,
    STATES,
    U1,
    array,
    choices,
    deviations,
    names,
    points,
    transform,
)


def encode_hand(hand: TrackedHand) -> Any:
    """Encode a hand as a protobuf message; a missing ``T_world_palm`` becomes an empty field."""
    return pb.Hand(
        id=hand.id,
        left=hand.left,
        landmarks_m=hand.landmarks.astype(F8, copy=False).tobytes(),
        landmark_states=hand.states.tobytes(),
        landmark_sd_m=hand.sd.astype(F4, copy=False).tobytes(),
        angles_rad=hand.angles.astype(F8, copy=False).tobytes(),
        T_world_palm=_upper_rows(hand.T_world_palm),
        holds=hand.holds,
    )


def decode_hand(m: Any) -> TrackedHand:
    """Decode a hand from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field has the wrong length or an impossible value; names the field.
    """
    n = len(LANDMARKS)
    angles = array(m.angles_rad, F8, (len(ANGLES),), "Hand.angles_rad")
    if (np.abs(angles) > math.pi).any():
        raise WireError("Hand.angles_rad has a value beyond ±π; radians are wanted, or NaN")
    return TrackedHand(
        m.id,
        m.left,
        points(m.landmarks_m, (n, 3), "Hand.landmarks_m"),
        choices(m.landmark_states, STATES, n, "Hand.landmark_states"),
        deviations(m.landmark_sd_m, n, "Hand.landmark_sd_m"),
        angles,
        transform(m.T_world_palm, "Hand.T_world_palm") if m.T_world_palm else None,
        _name(m.holds, "Hand.holds"),
    )


def encode_points(found: TrackedPoints) -> Any:
    """Encode a scene's named, triangulated points as a protobuf message."""
    return pb.Points(
        names=found.names,
        positions_m=found.positions.astype(F8, copy=False).tobytes(),
        sd_m=found.sd.astype(F4, copy=False).tobytes(),
        cameras=found.cameras.tobytes(),
    )


def decode_points(m: Any) -> TrackedPoints:
    """Decode a scene's named points from a parsed protobuf message, and check their values.

    Raises:
        WireError: a field has the wrong length or an impossible value; names the field.
    """
    point_names = names(m.names, "Points.names")
    return TrackedPoints(
        point_names,
        points(m.positions_m, (len(point_names), 3), "Points.positions_m"),
        deviations(m.sd_m, len(point_names), "Points.sd_m"),
        array(m.cameras, U1, (len(point_names),), "Points.cameras"),
    )


def encode_object(tracked: TrackedObject) -> Any:
    """Encode a rigid object as a protobuf message; a missing ``T_world_object`` becomes an empty field."""
    return pb.Object(
        name=tracked.name,
        T_world_object=_upper_rows(tracked.T_world_object),
        outline_m=tracked.outline.astype(F8, copy=False).tobytes(),
        state=tracked.state,
    )


def decode_object(m: Any) -> TrackedObject:
    """Decode a rigid object from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field has the wrong length or an impossible value; names the field.
    """
    corners = len(m.outline_m) // (3 * F8.itemsize)
    if corners > MAX_POINTS:
        raise WireError(f"Object.outline_m has {corners} points; at most {MAX_POINTS} are read")
    if m.state not in STATES:
        raise WireError(f"Object.state is {m.state}; it wants 0, 1 or 2")
    if not m.name:
        raise WireError("Object.name is empty; an object wants a name")
    return TrackedObject(
        _name(m.name, "Object.name"),
        transform(m.T_world_object, "Object.T_world_object") if m.T_world_object else None,
        points(m.outline_m, (corners, 3), "Object.outline_m"),
        m.state,
    )


def _upper_rows(T: NDArray[np.float64] | None) -> bytes:
    return b"" if T is None else T[:3].astype(F8, copy=False).tobytes()


def _name(name: str, field: str) -> str:
    if len(name) > MAX_NAME:
        raise WireError(f"{field} has {len(name)} characters; at most {MAX_NAME} are read")
    return name
