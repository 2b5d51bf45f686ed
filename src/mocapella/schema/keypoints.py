"""Encode and decode keypoint frames; invalid messages are refused."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.errors import WireError
from mocapella.model.keypoints import KeypointFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F4, I8, MAX_BODIES, MAX_COORDINATE, array, identity, identity_of, known_topology
from mocapella.schema.markers import MAX_SIDE_PX

MAX_PX: Final = 2.0 * MAX_SIDE_PX
"""Largest absolute coordinate of a keypoint, which may be outside the image [px]."""


def encode_keypoint_frame(frame: KeypointFrame) -> bytes:
    """Encode a keypoint frame as a protobuf message; equal frames give equal bytes."""
    return pb.KeypointFrame(
        **identity(frame),
        topology=frame.topology.name,
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        ids=frame.ids.astype(I8, copy=False).tobytes(),
        positions_px=_packed(frame.positions_px),
        confidences=_packed(frame.confidences),
        relative_m=b"" if frame.relative is None else _packed(frame.relative),
    ).SerializeToString()


def keypoint_frame_of(m: pb.KeypointFrame) -> KeypointFrame:
    """Decode a keypoint frame from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    topology, size = known_topology(m.topology), (m.width_px, m.height_px)
    if not (0 < size[0] <= MAX_SIDE_PX and 0 < size[1] <= MAX_SIDE_PX):
        wanted = f"1 to {MAX_SIDE_PX} pixels each"
        raise WireError(f"KeypointFrame.width_px and height_px are {size[0]} and {size[1]}; they want {wanted}")
    count, joints = len(m.ids) // I8.itemsize, len(topology)
    if count > MAX_BODIES:
        raise WireError(f"KeypointFrame.ids has {count} people; at most {MAX_BODIES} are read")
    ids = array(m.ids, I8, (count,), "KeypointFrame.ids")
    positions = array(m.positions_px, F4, (count, joints, 2), "KeypointFrame.positions_px")
    if (np.abs(positions) > MAX_PX).any():
        raise WireError(f"KeypointFrame.positions_px has a value beyond ±{MAX_PX:g}; write NaN where not seen")
    seen = np.isfinite(positions).all(axis=-1)
    if not np.array_equal(seen, np.isfinite(positions).any(axis=-1)):
        raise WireError("KeypointFrame.positions_px has a point with one coordinate; write NaN for both, or neither")
    confidences = array(m.confidences, F4, (count, joints), "KeypointFrame.confidences")
    if not ((confidences >= 0) & (confidences <= 1)).all():  # NaN compares false
        raise WireError("KeypointFrame.confidences has a value that is not from 0 to 1")
    if not np.array_equal(seen, confidences > 0):
        raise WireError("KeypointFrame.confidences is above 0 where positions_px is NaN, or 0 where it is not")
    relative = None
    if m.relative_m:
        relative = array(m.relative_m, F4, (count, joints, 3), "KeypointFrame.relative_m")
        if (np.abs(relative) > MAX_COORDINATE).any():
            raise WireError(f"KeypointFrame.relative_m has a value beyond ±{MAX_COORDINATE:g} m")
    return KeypointFrame(*identity_of(m), size, topology, ids, positions, confidences, relative)


def _packed(values: Any) -> bytes:
    return bytes(values.astype(F4, copy=False).tobytes())
