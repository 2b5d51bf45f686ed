"""Encode and decode marker frames; invalid messages are refused."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.markers import MarkerFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F4, array, deviations, identity, identity_of, names

MAX_SIDE_PX: Final = 65_536


def encode_marker_frame(frame: MarkerFrame) -> bytes:
    """Encode a marker frame as a protobuf message; equal frames give equal bytes.

    ``elongations`` and ``candidates`` are not part of the message.
    """
    return pb.MarkerFrame(
        **identity(frame),
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        names=frame.names,
        positions_px=_packed(frame.positions_px),
        sd_px=_packed(frame.sd_px),
        areas_px=_packed(frame.areas_px),
        confidences=_packed(frame.confidences),
    ).SerializeToString()


def marker_frame_of(m: pb.MarkerFrame) -> MarkerFrame:
    """Decode a marker frame from a parsed protobuf message, and check its values.

    If the message lacks standard deviations, areas or confidences, these are NaN, 0 and 1 for visible markers.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    markers = names(m.names, "MarkerFrame.names")
    n, size = len(markers), (m.width_px, m.height_px)
    if not (0 < size[0] <= MAX_SIDE_PX and 0 < size[1] <= MAX_SIDE_PX):
        wanted = f"1 to {MAX_SIDE_PX} pixels each"
        raise WireError(f"MarkerFrame.width_px and height_px are {size[0]} and {size[1]}; they want {wanted}")
    positions = array(m.positions_px, F4, (n, 2), "MarkerFrame.positions_px")
    outside = (positions < -0.5) | (positions > np.array(size) - 0.5)
    if outside.any() or np.isinf(positions).any():
        x, y = positions[np.flatnonzero((outside | np.isinf(positions)).any(axis=1))[0]]
        raise WireError(
            f"MarkerFrame.positions_px has ({x:g}, {y:g}), which is not in an image of {size[0]} × {size[1]}; "
            "write NaN where a marker is not seen"
        )
    seen = np.isfinite(positions).all(axis=-1)
    if not np.array_equal(seen, np.isfinite(positions).any(axis=-1)):
        raise WireError("MarkerFrame.positions_px has a point with one coordinate; write NaN for both, or neither")
    return MarkerFrame(
        *identity_of(m),
        size,
        markers,
        positions,
        deviations(m.sd_px, n, "MarkerFrame.sd_px") if m.sd_px else _filled(seen, np.nan, np.nan),
        _within(m.areas_px, seen, float(size[0] * size[1]), 0.0, "areas_px"),
        _within(m.confidences, seen, 1.0, 1.0, "confidences"),
    )


def _packed(values: NDArray[np.float32]) -> bytes:
    return values.astype(F4, copy=False).tobytes()


def _filled(seen: NDArray[np.bool_], value: float, else_value: float) -> NDArray[np.float32]:
    return np.where(seen, np.float32(value), np.float32(else_value))


def _within(data: bytes, seen: NDArray[np.bool_], most: float, default: float, field: str) -> NDArray[np.float32]:
    if not data:
        return _filled(seen, default, 0.0)
    values = array(data, F4, seen.shape, f"MarkerFrame.{field}")
    if not ((values >= 0) & (values <= most)).all():  # NaN compares false
        raise WireError(f"MarkerFrame.{field} has a value that is not from 0 to {most:g}")
    return values
