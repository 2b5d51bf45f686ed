"""Read the size of an encoded image from its header, before a decoder allocates memory for it.

W3C, *Portable Network Graphics* (2003), 5.3 and 11.2.2; ITU-T T.81, B.2.2 (JPEG); Adobe, *TIFF* 6.0 (1992), 2;
Google, *WebP Container Specification*; Microsoft, ``BITMAPINFOHEADER``.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8"
_START_OF_FRAME: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""JPEG's markers of segments that hold the image's size."""
_ALONE: Final = frozenset((0x01, *range(0xD0, 0xD9)))
"""JPEG's markers without a segment."""
_TIFF_NUMBERS: Final = {3: "H", 4: "I"}
"""Formats of TIFF's unsigned numbers of 16 and 32 bits."""
_TIFF_TAGS: Final = ((256, 322), (257, 323))
"""TIFF's tags of the width, of image and tile, and of the height, of image and tile."""


def encoded_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) of an encoded image; None if it is no PNG, JPEG, TIFF, WebP or BMP with a whole header.

    None also for a PNG that is cut off. A TIFF image in tiles larger than the image has the tiles' size.
    """
    read = next((reader for start, reader in _READERS.items() if data.startswith(start)), None)
    try:
        return None if read is None else read(data)
    except struct.error:
        return None


def png_end(data: bytes) -> int:
    """Return the offset of the first byte after a PNG's last chunk, IEND; 0 if the data end before that.

    Check this before decoding: a decoder allocates as much memory as a chunk's header states.
    """
    at = len(PNG)
    while at + 12 <= len(data):
        kind, at = data[at + 4 : at + 8], at + 12 + int.from_bytes(data[at : at + 4], "big")
        if kind == b"IEND":
            return at if at <= len(data) else 0
    return 0


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 1 if marker == 0xFF else 2 if marker in _ALONE else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    order = "<" if data.startswith(b"I") else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    found: dict[int, int] = {}
    for k in range(count):
        tag, kind, _, raw = struct.unpack_from(f"{order}HHI4s", data, at + 2 + 12 * k)
        if kind in _TIFF_NUMBERS:
            found[tag] = struct.unpack_from(order + _TIFF_NUMBERS[kind], raw)[0]
    width, height = (max(found.get(tag, 0) for tag in tags) for tags in _TIFF_TAGS)
    return (width, height) if width and height else None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    kind = data[8:16].removeprefix(b"WEBP")
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    return None


def _png_size(data: bytes) -> tuple[int, int] | None:
    return struct.unpack(">II", data[16:24]) if data[12:16] == b"IHDR" and png_end(data) else None


def _bmp_size(data: bytes) -> tuple[int, int] | None:
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height)


_READERS: Final[dict[bytes, Callable[[bytes], tuple[int, int] | None]]] = {
    PNG: _png_size,
    _JPEG: _jpeg_size,
    b"II*\0": _tiff_size,
    b"MM\0*": _tiff_size,
    b"RIFF": _webp_size,
    b"BM": _bmp_size,
}
