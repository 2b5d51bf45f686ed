"""Encode and decode depth images without loss; invalid messages are refused.

A pixel is written as its residual to a prediction from its left, upper, and upper left neighbours (the planar
predictor, the fourth of the lossless mode of ITU-T T.81, table H.1), modulo 2^16, which is small on smooth surfaces.
Residuals of both signs become small numbers, all low bytes precede the high ones, and Zstandard (RFC 8878) compresses
them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.depth import DepthFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F8, array, identity, identity_of

UInt16 = NDArray[np.uint16]
Float64 = NDArray[np.float64]

MAX_DEPTH_SIDE_PX: Final = 4096
MAX_DEPTH_PX: Final = 1 << 22
"""Largest number of pixels of an image; the unpacked size of a message is checked before unpacking."""
UNITS_M: Final = (1e-6, 0.1)
"""Smallest and largest size of a unit of depth [m]."""
_LEVEL: Final = 1
_MAX_LENS: Final = 1e6


def encode_depth_frame(frame: DepthFrame) -> bytes:
    """Encode a depth frame as a protobuf message; equal frames give equal bytes with the same version of Zstandard."""
    return pb.DepthFrame(
        **identity(frame),
        width_px=frame.size_px[0],
        height_px=frame.size_px[1],
        unit_m=frame.unit_m,
        lens=frame.lens.astype(F8, copy=False).tobytes(),
        depth=pack_depth(frame.depth),
    ).SerializeToString()


def depth_frame_of(m: pb.DepthFrame) -> DepthFrame:
    """Decode a depth frame from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    size = image_size(m.width_px, m.height_px, "DepthFrame")
    if not UNITS_M[0] <= m.unit_m <= UNITS_M[1]:  # NaN compares false
        raise WireError(
            f"DepthFrame.unit_m is {m.unit_m:g}; metres a unit, {UNITS_M[0]:g} to {UNITS_M[1]:g}, are wanted"
        )
    return DepthFrame(
        *identity_of(m),
        unpack_depth(m.depth, size, "DepthFrame.depth"),
        m.unit_m,
        lens_of(m.lens, "DepthFrame.lens"),
    )


def pack_depth(depth: UInt16) -> bytes:
    """Compress a depth image (height, width) uint16 without loss; `unpack_depth` restores it."""
    along = depth.copy()
    along[:, 1:] -= depth[:, :-1]
    both = along.copy()
    both[1:] -= along[:-1]
    signed = both.view(np.int16)
    small = ((signed << 1) ^ (signed >> 15)).astype("<u2", copy=False)
    planes = np.ascontiguousarray(small.view(np.uint8).reshape(-1, 2).T)
    return zstandard.ZstdCompressor(level=_LEVEL).compress(planes.data)


def unpack_depth(data: bytes, size_px: tuple[int, int], field: str) -> UInt16:
    """Return the depth image (height, width) uint16 that `pack_depth` compressed, as a new array.

    Args:
        data: the compressed image.
        size_px: (width, height) of the image.
        field: the message's field, for errors.

    Raises:
        WireError: the data are invalid, or the image has another size.
    """
    width, height = size_px
    wanted = 2 * width * height
    try:
        stated = zstandard.frame_content_size(data)
        # Checked first: the library trusts this number when it makes room, and refuses what unpacks to another.
        if stated != wanted:
            fault = "has no unpacked size" if stated < 0 else f"unpacks to {stated} bytes"
            raise WireError(f"{field} {fault}; {width} × {height} uint16 want {wanted}")
        planes = zstandard.ZstdDecompressor().decompress(data, max_output_size=wanted, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise WireError(f"{field} cannot be unpacked ({error}); one Zstandard frame is wanted") from None
    halves = np.frombuffer(planes, np.uint8).reshape(2, -1)
    small = halves[1].astype(np.uint16)
    small <<= 8
    small |= halves[0]
    both: UInt16 = ((small >> 1) ^ -(small & 1)).reshape(height, width)
    np.add.accumulate(both, axis=0, out=both)
    np.add.accumulate(both, axis=1, out=both)
    return both


def image_size(width: int, height: int, message: str) -> tuple[int, int]:
    """Check an image's size; return (width, height) [px].

    Args:
        width, height: as in the message [px].
        message: the message's name, for errors.

    Raises:
        WireError: the size is invalid; names the valid sizes.
    """
    sides = 0 < width <= MAX_DEPTH_SIDE_PX and 0 < height <= MAX_DEPTH_SIDE_PX
    if not (sides and width * height <= MAX_DEPTH_PX):
        wanted = f"1 to {MAX_DEPTH_SIDE_PX} pixels each, and at most {MAX_DEPTH_PX} in all"
        raise WireError(f"{message}.width_px and height_px are {width} and {height}; they want {wanted}")
    return width, height


def lens_of(data: bytes, field: str) -> Float64:
    """Decode a camera's intrinsics (9,), as in `mocapella.geometry.lens`, from packed float64.

    Raises:
        WireError: the length is wrong, a value is too large, or a focal length is not above 0; names ``field``.
    """
    lens = array(data, F8, (9,), field)
    if not ((np.abs(lens) <= _MAX_LENS).all() and (lens[:2] > 0).all()):  # NaN compares false
        wanted = f"nine numbers within ±{_MAX_LENS:g}, of which the first two, fx and fy, are above 0, are wanted"
        raise WireError(f"{field} is {', '.join(f'{value:g}' for value in lens)}; {wanted}")
    return lens
