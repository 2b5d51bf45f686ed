"""Encode and decode camera images; invalid messages are refused."""

from __future__ import annotations

from typing import Final

import numpy as np

from mocapella.errors import WireError
from mocapella.model.images import IMAGE_FORMATS, ImageFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import identity, identity_of
from mocapella.schema.depth import image_size

_KNOWN: Final = frozenset(IMAGE_FORMATS)


def encode_image_frame(frame: ImageFrame) -> bytes:
    """Encode an image frame as a protobuf message; equal frames give equal bytes."""
    data = frame.data
    return pb.ImageFrame(
        **identity(frame),
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        format=frame.format,
        image=np.ascontiguousarray(data).tobytes() if isinstance(data, np.ndarray) else data,
        empty_room=frame.empty_room,
    ).SerializeToString()


def image_frame_of(m: pb.ImageFrame) -> ImageFrame:
    """Decode an image frame from a parsed protobuf message, and check its fields; a compressed image stays compressed.

    Raw pixels become a read-only (height, width, 3) uint8 array in BGR order.

    Raises:
        WireError: a field has the wrong length or an impossible value; names the field and the expected value.
    """
    width, height = image_size(m.width_px, m.height_px, "ImageFrame")
    if m.format not in _KNOWN:
        known = ", ".join(name for name in IMAGE_FORMATS if name)
        raise WireError(
            f"ImageFrame.format is {m.format[:80]!r}; {known} are read, or nothing where there is no picture"
        )
    if not m.format and m.image:
        raise WireError(f"ImageFrame.image has {len(m.image)} bytes and no format; say which format they are of")
    if m.format and not m.image:
        raise WireError(f"ImageFrame.image is empty, and the format is {m.format}; leave both out without a picture")
    if m.format != "raw":
        return ImageFrame(*identity_of(m), (width, height), m.format, m.image, m.empty_room)
    if len(m.image) != 3 * width * height:
        raise WireError(f"ImageFrame.image has {len(m.image)} bytes; {height} × {width} × 3 are wanted")
    pixels = np.frombuffer(m.image, np.uint8).reshape(height, width, 3)
    return ImageFrame(*identity_of(m), (width, height), m.format, pixels, m.empty_room)
