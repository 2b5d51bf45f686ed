"""Headers of images byte by byte, up to their last byte, and which images are decoded and encoded."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.model.images import image_frame
from mocapella.sensing.image_headers import encoded_size, png_end
from mocapella.sensing.images import decode_image, decode_pixels, encode_image

sizes = st.integers(1, 16383)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@given(sizes, sizes, st.binary(max_size=9))
def test_a_png_ends_with_its_last_chunk_and_not_before(width: int, height: int, content: bytes) -> None:
    head = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    whole = head + chunk(b"tEXt", content) + chunk(b"IEND", b"")
    assert encoded_size(whole) == (width, height)
    assert png_end(whole) == len(whole)
    assert png_end(whole + content) == len(whole)
    for less in range(1, 14):
        assert png_end(whole[:-less]) == 0
        assert encoded_size(whole[:-less]) is None
    long = head + struct.pack(">I", 5) + b"IEND" + bytes(4)  # a last chunk that claims five bytes more than there are
    assert png_end(long) == 0
    assert encoded_size(b"\x89PNG\r\n\x1a\n" + chunk(b"IDAT", b"") + whole[8:]) is None


def jpeg(*segments: bytes, width: int = 300, height: int = 17, frame: int = 0xC0) -> bytes:
    return b"\xff\xd8" + b"".join(segments) + b"\xff" + bytes([frame]) + struct.pack(">HBHH", 17, 8, height, width)


@given(sizes, sizes, st.sampled_from([0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xCF]), st.binary(max_size=40))
def test_a_jpegs_size_is_in_the_first_header_of_a_frame(width: int, height: int, frame: int, text: bytes) -> None:
    comment = b"\xff\xfe" + struct.pack(">H", 2 + len(text)) + text
    tables = b"\xff\xc4" + struct.pack(">H", 9) + bytes(range(7))  # they are no frame's
    for before in ((), (comment,), (comment, tables, comment), (b"\xff\xff\xff",), (b"\xff\x01", comment, b"\xff\xd3")):
        data = jpeg(*before, width=width, height=height, frame=frame)
        assert encoded_size(data) == (width, height)
        assert all(encoded_size(data[:cut]) is None for cut in range(len(data)))


def test_a_jpeg_without_a_marker_where_one_must_be_has_no_size() -> None:
    assert encoded_size(jpeg(b"\x00")) is None
    assert encoded_size(b"\xff\xd8" + bytes(40)) is None
    assert encoded_size(jpeg(b"\xff\xe0\xff\xff")) is None


def tiff(order: str, *entries: tuple[int, int, int], at: int = 8) -> bytes:
    """With tags as tag, kind (3 for 16 bits, 4 for 32) and value."""
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", at) + bytes(at - 8)
    rows = [
        struct.pack(f"{order}HHI", tag, kind, 1)
        + (struct.pack(f"{order}HH", value, 0) if kind == 3 else struct.pack(f"{order}I", value))
        for tag, kind, value in entries
    ]
    return start + struct.pack(f"{order}H", len(rows)) + b"".join(rows)


@given(st.sampled_from("<>"), st.sampled_from([3, 4]), sizes, sizes, st.sampled_from([8, 20]))
def test_a_tiffs_size_is_that_of_its_image_or_of_its_tile_if_that_is_larger(
    order: str, kind: int, width: int, height: int, at: int
) -> None:
    other = (254, 4, 1)
    image = (256, kind, width), (257, kind, height)
    assert encoded_size(tiff(order, other, *image, at=at)) == (width, height)
    assert encoded_size(tiff(order, *image, other)[:-12]) is None  # the third tag is cut off
    tile = (322, kind, width + 5), (323, kind, height + 7)
    assert encoded_size(tiff(order, *image, *tile)) == (width + 5, height + 7)
    assert encoded_size(tiff(order, *image, (322, kind, 1), (323, kind, 1))) == (width, height)
    for missing in ((image[0],), (image[1],), (other,), (image[0], (257, 5, height))):
        assert encoded_size(tiff(order, *missing)) is None


@given(sizes, sizes)
def test_a_webps_size_is_in_each_of_its_three_headers(width: int, height: int) -> None:
    start = b"RIFF" + bytes(4) + b"WEBP"
    lossy = start + b"VP8 " + bytes(10) + struct.pack("<HH", width | 0x4000, height | 0x8000)
    bits = (width - 1) | (height - 1) << 14 | 1 << 28
    lossless = start + b"VP8L" + bytes(5) + struct.pack("<I", bits)
    extended = start + b"VP8X" + bytes(8) + (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    for data in (lossy, lossless, extended):
        assert encoded_size(data) == (width, height)
        assert encoded_size(data[:-1]) is None
    assert encoded_size(start + b"VP9 " + bytes(40)) is None


@given(sizes, sizes, st.booleans())
def test_a_bitmap_may_be_stored_from_its_upper_row_on(width: int, height: int, upper_first: bool) -> None:
    data = b"BM" + bytes(16) + struct.pack("<ii", width, -height if upper_first else height)
    assert encoded_size(data) == (width, height)
    assert encoded_size(data[:-1]) is None


IMAGE = np.ascontiguousarray(np.arange(6 * 9 * 3).reshape(6, 9, 3) % 256).astype(np.uint8)


def frame(format: str, data: Any = None) -> Any:
    data = encode_image(IMAGE, format) if data is None else data  # type: ignore[arg-type]
    return image_frame("left", data, time_ns=5, format=format, size_px=(9, 6))


def test_a_png_with_anything_after_its_end_is_refused_and_a_jpeg_with_zeros_is_not() -> None:
    png, jpg = encode_image(IMAGE, "png"), encode_image(IMAGE, "jpeg")
    np.testing.assert_array_equal(decode_image(frame("png", png)), IMAGE)
    assert decode_image(frame("jpeg", jpg + bytes(7))).shape == IMAGE.shape
    for format, data in (("png", png + b"\0"), ("jpeg", jpg + b"x"), ("jpeg", b"\0" + jpg), ("jpeg", jpg[:-2])):
        with pytest.raises(InputError, match="its image is damaged"):
            decode_image(frame(format, data))
    for format, data in (("png", jpg), ("jpeg", png)):
        with pytest.raises(InputError, match="its image is damaged"):
            decode_image(frame(format, data))


@pytest.mark.parametrize(
    "data",
    [IMAGE.astype(np.float32), IMAGE[..., 0], IMAGE[..., :2], np.zeros((6, 9, 3, 1), np.uint8),
     np.zeros((9, 6, 3), np.uint8)],
)  # fmt: skip
def test_a_raw_frame_that_is_no_image_of_its_size_is_refused(data: Any) -> None:
    raw = msgspec.structs.replace(image_frame("left", IMAGE, time_ns=5), data=data)
    with pytest.raises(InputError, match="its image is damaged"):
        decode_image(raw)


@pytest.mark.parametrize("shape", [(6, 9), (6, 9, 4), (6, 9, 1), (0, 9, 3), (6, 0, 3), (6, 9, 3, 3)])
def test_what_is_no_image_is_not_encoded(shape: tuple[int, ...]) -> None:
    for format in ("png", "jpeg"):
        with pytest.raises(SettingsError, match="is wanted"):
            encode_image(np.zeros(shape, np.uint8), format)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="image is float64"):
        encode_image(np.zeros((6, 9, 3)))


def turned_jpeg() -> bytes:
    """A JPEG whose EXIF data say that it is to be shown turned by a quarter."""
    data = encode_image(IMAGE, "jpeg")
    exif = b"Exif\0\0" + b"II*\0" + struct.pack("<IH", 8, 1) + struct.pack("<HHIHH", 0x0112, 3, 1, 6, 0) + bytes(4)
    return data[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif + data[2:]


def test_an_image_is_turned_as_exif_says_unless_it_is_wanted_as_it_is_stored() -> None:
    """A lens is calibrated for the stored pixels."""
    data = turned_jpeg()
    shown, stored, unchanged = (
        decode_pixels(data),
        decode_pixels(data, as_stored=True),
        decode_pixels(data, unchanged=True),
    )
    assert shown is not None
    assert stored is not None
    assert unchanged is not None
    assert (shown.shape, stored.shape, unchanged.shape) == ((9, 6, 3), (6, 9, 3), (6, 9, 3))
    np.testing.assert_array_equal(decode_image(frame("jpeg", data)), stored)


def test_channels_and_depth_are_those_of_the_file_if_it_is_unchanged() -> None:
    deep = np.arange(54, dtype=np.uint16).reshape(6, 9) * 1000
    data = cv2.imencode(".png", deep)[1].tobytes()
    np.testing.assert_array_equal(decode_pixels(data, unchanged=True), deep)
    shown = decode_pixels(data)
    assert shown is not None
    assert (shown.shape, shown.dtype) == ((6, 9, 3), np.dtype(np.uint8))


def test_a_whole_jpeg_of_no_known_format_is_refused() -> None:
    for format in ("", "gif", "raw"):
        with pytest.raises(InputError, match="its image is damaged"):
            decode_image(msgspec.structs.replace(frame("jpeg"), format=format))
