"""Encode and decode frames of skeletons; invalid messages are refused.

Frames are on the hot path of every process, so the checks of valid frames are cheap: one dot product shows whether an
array is finite and in range, and only otherwise the invalid value is searched (vdot, because dot warns of overflow,
which is a valid answer here).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy import frombuffer, logical_not, vdot
from numpy.typing import NDArray

from mocapella.conventions import SCHEMA_VERSION
from mocapella.errors import WireError
from mocapella.model.limits import FRAME_HEIGHT, TILT
from mocapella.model.observations import BodyFrame
from mocapella.model.topology import Topology
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    FLAGS,
    MAX_BODIES,
    MAX_COORDINATE,
    MAX_MESSAGE_BYTES,
    STATES,
    U1,
    U8,
    known_topology,
    parse,
    sensor_name,
    sensor_pose,
)

_BOOL: Final = np.dtype("?")
_EDGES: Final = bytes(range(16))
_FLOATS: Final = {"positions_m": 3, "depth_px": 2, "orientations": 4}
_JOINT: Final = {width: np.dtype(("V", 4 * width)) for width in _FLOATS.values()}
"""A joint's floats as one item, which is written several times faster than a row."""
_ZERO: Final = {width: np.zeros(width, F4).view(item) for width, item in _JOINT.items()}
_NAN: Final = {width: np.full(width, np.nan, F4).view(item) for width, item in _JOINT.items()}
_FURTHEST: Final = MAX_COORDINATE**2
_INFINITE: Final = math.inf
_LEAST_TILT, _MOST_TILT = TILT.low, TILT.high  # compared here, because a call costs more than the comparison
_LEAST_HEIGHT, _MOST_HEIGHT = FRAME_HEIGHT.low, FRAME_HEIGHT.high
_MESSAGE: Final = pb.BodyFrame


def encode_body_frame(frame: BodyFrame) -> bytes:
    """Encode a frame of skeletons as a protobuf message.

    Joints that are not tracked are written as 0, and are NaN again after decoding.
    """
    states = frame.states.tobytes()
    gone = logical_not(frame.states.reshape(-1)).nonzero()[0] if 0 in states else None
    message = _MESSAGE(
        schema_version=SCHEMA_VERSION,
        sensor=frame.sensor,
        node_id=frame.node_id,
        sequence=frame.sequence,
        time_ns=frame.time_ns,
        sent_ns=frame.sent_ns,
        topology=frame.topology.name,
        depth_width_px=frame.depth_size_px[0],
        depth_height_px=frame.depth_size_px[1],
        tilt_rad=frame.tilt,
        height_m=frame.height,
        tracking_ids=frame.tracking_ids.astype(U8, copy=False).tobytes(),
        tracked=frame.tracked.tobytes(),
        clipped_edges=frame.clipped_edges.tobytes(),
        joint_states=states,
        positions_m=_packed(frame.positions, 3, gone),
        depth_px=_packed(frame.depth_px, 2, gone),
        orientations=_packed(frame.orientations, 4, gone),
    )
    return message.SerializeToString()


def decode_body_frame(data: bytes) -> BodyFrame:
    """Decode and check a frame of skeletons from a protobuf message's bytes.

    Its arrays are read-only views of the bytes where nothing had to be changed. Joints that are not tracked have NaN
    coordinates; a missing optional field is None.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
    """
    return body_frame_of(parse(_MESSAGE, data, MAX_MESSAGE_BYTES))


def body_frame_of(m: Any) -> BodyFrame:
    """Decode a frame of skeletons from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is missing, too long, of the wrong length, not finite or out of range; names it.
    """
    kind = known_topology(m.topology)
    joints = len(kind.joints)
    ids, tracked, edges, states = m.tracking_ids, m.tracked, m.clipped_edges, m.joint_states
    p, d, q = m.positions_m, m.depth_px, m.orientations
    tilt, height = m.tilt_rad, m.height_m
    bodies = len(tracked)
    points = bodies * joints
    if not (
        bodies <= MAX_BODIES
        and len(ids) == 8 * bodies
        and len(edges) == bodies
        and len(states) == points
        and len(p) == 12 * points
        and (len(d) == 8 * points or not d)
        and (len(q) == 16 * points or not q)
        and not tracked.translate(None, FLAGS)
        and not edges.translate(None, _EDGES)
        and not states.translate(None, STATES)
        and _LEAST_TILT <= tilt <= _MOST_TILT
        and _LEAST_HEIGHT <= height <= _MOST_HEIGHT
    ):
        _refuse_misfit(m, kind)
    state_array = frombuffer(states, U1)
    gone = logical_not(state_array).nonzero()[0] if 0 in states else None
    positions = frombuffer(p, F4)
    if not float(vdot(positions, positions)) <= _FURTHEST:  # NaN compares false
        _refuse_bad_positions(positions, kind)
    if gone is not None:
        positions = _blanked(positions, 3, gone)
    return BodyFrame(
        sensor_name(m.sensor),
        m.node_id,
        m.sequence,
        m.time_ns,
        m.sent_ns,
        kind,
        (m.depth_width_px, m.depth_height_px),
        tilt,
        height,
        frombuffer(ids, U8),
        frombuffer(tracked, _BOOL),
        frombuffer(edges, U1),
        state_array.reshape(bodies, joints),
        positions.reshape(bodies, joints, 3),
        _optional(d, "depth_px", gone).reshape(bodies, joints, 2) if d else None,
        _optional(q, "orientations", gone).reshape(bodies, joints, 4) if q else None,
    )


def _packed(values: NDArray[np.float32] | None, width: int, gone: NDArray[np.intp] | None) -> bytes:
    """Return the floats for the message, with 0 for the untracked joints ``gone``."""
    if values is None:
        return b""
    packed = values.astype(F4, copy=False).tobytes()
    if gone is None:
        return packed
    writable = bytearray(packed)
    frombuffer(writable, _JOINT[width]).put(gone, _ZERO[width])
    return bytes(writable)


def _blanked(values: NDArray[np.float32], width: int, gone: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the flat floats, with NaN for the untracked joints ``gone``."""
    values = values.copy()
    values.view(_JOINT[width]).put(gone, _NAN[width])
    return values


def _optional(data: bytes, field: str, gone: NDArray[np.intp] | None) -> NDArray[np.float32]:
    """Return the floats of an optional field; NaN for joints without a value."""
    values = frombuffer(data, F4)
    if not float(vdot(values, values)) < _INFINITE and np.isinf(values).any():
        raise WireError(f"BodyFrame.{field} has an infinite value; write NaN where a joint has none")
    return values if gone is None else _blanked(values, _FLOATS[field], gone)


def _refuse_bad_positions(values: NDArray[np.float32], kind: Topology) -> None:
    """Refuse the first coordinate that is not finite or out of range; many bodies alone are no fault."""
    positions = values.reshape(-1, len(kind), 3)
    bad = np.argwhere(~(np.abs(positions) <= MAX_COORDINATE))
    if len(bad):
        body, joint, axis = bad[0]
        raise WireError(
            f"BodyFrame.positions_m: {kind.joints[joint]} {'xyz'[axis]} of body {body} is "
            f"{positions[body, joint, axis]:g}; it must be finite and within ±{MAX_COORDINATE:g} m "
            "(write 0 and state 0 where a joint is not tracked)"
        )


def _refuse_misfit(m: Any, kind: Topology) -> None:
    """Raise `WireError` for the first field of a frame that does not fit the others, with the expected value."""
    length = len(m.tracking_ids)
    bodies = length // 8
    if length % 8 or bodies > MAX_BODIES:
        raise WireError(
            f"BodyFrame.tracking_ids has {length} bytes; it wants 8 for each body, and at most {MAX_BODIES} bodies"
        )
    wanted = {
        "tracked": (1, "0 or 1", FLAGS),
        "clipped_edges": (1, "0 to 15", _EDGES),
        "joint_states": (len(kind), "0, 1 or 2", STATES),
    }
    for field, (width, text, allowed) in wanted.items():
        value = getattr(m, field)
        if len(value) != bodies * width:
            problem = f"has {len(value)} bytes; {bodies} × {width} of {text} are wanted ({kind.name})"
            raise WireError(f"BodyFrame.{field} {problem}")
        strange = value.translate(None, allowed)
        if strange:
            raise WireError(f"BodyFrame.{field} has a {strange[0]}; it wants {text}")
    for field, width in _FLOATS.items():
        length, right = len(getattr(m, field)), 4 * width * bodies * len(kind)
        if length != right and (length or field == "positions_m"):
            shape = f"{bodies} × {len(kind)} × {width} float32 ({kind.name})"
            raise WireError(f"BodyFrame.{field} has {length} bytes; {shape} want {right}")
    sensor_pose(m.tilt_rad, m.height_m, "BodyFrame")
