"""Decode and encode images."""

from __future__ import annotations

import struct
from typing import Final, Literal

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.images import ImageFrame

UInt8 = NDArray[np.uint8]

QUALITY: Final = 85
"""Default quality of a JPEG, 0 to 100."""
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_START_OF_FRAME: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""JPEG's markers of segments that hold the image's size."""
_ALONE: Final = frozenset((0x01, *range(0xD0, 0xD9)))
"""JPEG's markers without a segment."""


def decode_image(frame: ImageFrame) -> UInt8:
    """Return the pixels (height, width, 3) uint8 BGR of a frame; of a ``raw`` one its own array, not a copy.

    Raises:
        InputError: there is no image, its bytes are damaged or truncated, or its size is not the frame's.
    """
    if isinstance(frame.data, np.ndarray):
        image: UInt8 | None = frame.data
        whole = frame.data.dtype == np.uint8 and frame.data.ndim == 3 and frame.data.shape[2] == 3
    else:
        # The header's size is checked first, so that an image that claims to be enormous is not decoded.
        whole = _encoded_size(frame.data, frame.format) == frame.size_px
        image = _decoded(frame.data) if whole else None
    if image is None or not whole or image.shape[:2] != frame.size_px[::-1]:
        raise InputError(
            f"its image is damaged, or not of {frame.size_px[0]} × {frame.size_px[1]} px", field="data",
            fix="send jpeg or png of the size that the frame says",
        )  # fmt: skip
    return image


def encode_image(image: UInt8, format: Literal["jpeg", "png"] = "jpeg", quality: int = QUALITY) -> bytes:
    """Return the encoded bytes of an image.

    Args:
        image: (height, width, 3) uint8 BGR.
        format: PNG is lossless.
        quality: of a JPEG, 0 to 100.

    Raises:
        SettingsError: another format, or an array that is not an image.
    """
    known = {"jpeg": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality]), "png": (".png", [cv2.IMWRITE_PNG_COMPRESSION, 1])}
    if format not in known:
        raise SettingsError(f"image format {format!r}; it must be one of {one_of(format, known)}")
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise SettingsError(f"image is {image.dtype} {image.shape}; (height, width, 3) uint8 is wanted")
    suffix, options = known[format]
    return bytes(cv2.imencode(suffix, image, options)[1].tobytes())


def as_png(frame: ImageFrame) -> ImageFrame:
    """Encode an image as PNG, without loss; an encoded frame, or one without an image, is returned unchanged."""
    if not isinstance(frame.data, np.ndarray):
        return frame
    return msgspec.structs.replace(frame, format="png", data=encode_image(frame.data, "png"))


def _decoded(data: bytes) -> UInt8 | None:
    try:
        # EXIF orientation is ignored: the lens is calibrated for the stored pixels.
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)


def _chunks_fit(data: bytes) -> bool:
    """Return whether a PNG's chunks fill its bytes, up to IEND; a decoder allocates the size that a chunk claims."""
    at = len(_PNG)
    while at + 12 <= len(data):
        kind, at = data[at + 4 : at + 8], at + 12 + int.from_bytes(data[at : at + 4], "big")
        if kind == b"IEND":
            return at == len(data)
    return False


def _encoded_size(data: bytes, format: str) -> tuple[int, int] | None:
    """Return (width, height) from an encoded image's header; None if it is not a complete image of that format."""
    if format == "png":
        whole = data.startswith(_PNG) and len(data) > 24 and _chunks_fit(data)
        return struct.unpack(">II", data[16:24]) if whole else None
    # Some cameras fill a JPEG up with zeros.
    if format != "jpeg" or not data.startswith(b"\xff\xd8") or not data.rstrip(b"\0").endswith(b"\xff\xd9"):
        return None
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _START_OF_FRAME:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 1 if marker == 0xFF else 2 if marker in _ALONE else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
