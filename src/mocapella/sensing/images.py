"""Decode and encode images."""

from __future__ import annotations

from typing import Any, Final, Literal

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.images import ImageFrame
from mocapella.sensing.image_headers import PNG, encoded_size, png_end

UInt8 = NDArray[np.uint8]

QUALITY: Final = 85
"""Default quality of a JPEG, 0 to 100."""
MOST_PX: Final = 1 << 25
"""Largest image that is decoded; 8K video has 33.2 million pixels."""


def decode_image(frame: ImageFrame) -> UInt8:
    """Return the pixels (height, width, 3) uint8 BGR of a frame, a contiguous and writable array.

    For a ``raw`` frame it is the frame's own array or, if that is read-only as in a decoded message, a copy: kernels
    are compiled for writable arrays, and would be compiled again, for seconds, for others.

    Raises:
        InputError: the frame has no image or is a reference (format ``file``), its image is damaged, truncated or above
            `MOST_PX`, or the image's size is not the frame's ``size_px``.
    """
    if isinstance(frame.data, np.ndarray):
        image: UInt8 | None = frame.data
        whole = frame.data.dtype == np.uint8 and frame.data.ndim == 3 and frame.data.shape[2] == 3
    else:
        # The header's size is checked first, so that an image that claims to be enormous is not decoded.
        whole = _whole_size(frame.data, frame.format) == frame.size_px
        # EXIF's orientation is ignored: the lens is calibrated for the stored pixels.
        image = decode_pixels(frame.data, as_stored=True) if whole else None
    if image is None or not whole or image.shape[:2] != frame.size_px[::-1]:
        raise InputError(
            f"its image is damaged, or not of {frame.size_px[0]} × {frame.size_px[1]} px", field="data",
            fix="send jpeg or png of the size that the frame says",
        )  # fmt: skip
    return np.require(image, requirements=["C", "W"])


def encode_image(image: UInt8, format: Literal["jpeg", "png"] = "jpeg", quality: int = QUALITY) -> bytes:
    """Return the encoded bytes of an image.

    Args:
        image: (height, width, 3) uint8 BGR.
        format: PNG is lossless.
        quality: quality of a JPEG, 0 to 100.

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


def decode_pixels(data: bytes, *, unchanged: bool = False, as_stored: bool = False) -> NDArray[Any] | None:
    """Return the pixels of an encoded image; None if it is damaged, or has more than `MOST_PX` pixels.

    Args:
        data: PNG, JPEG, TIFF, WebP or BMP.
        unchanged: whether channels and depth are those of the file (gray, BGR or BGRA; 8 or 16 bits), instead of
            (height, width, 3) uint8 BGR.
        as_stored: whether EXIF's orientation is ignored, as it always is with ``unchanged``.
    """
    width, height = encoded_size(data) or (0, 0)
    if not 0 < width * height <= MOST_PX:
        return None
    flags = cv2.IMREAD_UNCHANGED if unchanged else cv2.IMREAD_COLOR | (as_stored and cv2.IMREAD_IGNORE_ORIENTATION)
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def _whole_size(data: bytes, format: str) -> tuple[int, int] | None:
    """Return (width, height) from an encoded image's header; None if it is not a complete image of that format."""
    if format == "png":
        return encoded_size(data) if data.startswith(PNG) and png_end(data) == len(data) else None
    # Some cameras fill a JPEG up with zeros.
    if format != "jpeg" or not data.startswith(b"\xff\xd8") or not data.rstrip(b"\0").endswith(b"\xff\xd9"):
        return None
    return encoded_size(data)
