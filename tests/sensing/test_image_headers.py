"""The size of an image is read from its header, and no decoder sees one that claims too much."""

from __future__ import annotations

import random
import struct
import zlib
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.sensing.image_headers import encoded_size, png_end
from mocapella.sensing.images import MOST_PX, decode_pixels
from mocapella.sources.depth_files import read_depth_png
from mocapella.sources.video import IMAGES, read_image

OPTIONS = {
    ".webp": [cv2.IMWRITE_WEBP_QUALITY, 101],  # without loss
    ".jpg": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
}


def encoded(kind: str, width: int, height: int, options: list[int] | None = None) -> bytes:
    image = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(kind, image, options or [])[1].tobytes()


@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize("special", [False, True])
def test_the_size_in_the_header_is_that_of_the_pixels(kind: str, special: bool) -> None:
    for width, height in ((1, 1), (17, 5), (300, 2)):
        data = encoded(kind, width, height, OPTIONS.get(kind) if special else None)
        assert encoded_size(data) == (width, height)
        pixels = decode_pixels(data)
        assert pixels is not None
        assert pixels.shape == (height, width, 3)


@pytest.mark.parametrize("kind", IMAGES)
def test_a_header_that_is_cut_off_or_damaged_has_some_size_or_none(kind: str) -> None:
    data, rng = encoded(kind, 9, 7), random.Random(3)
    for length in range(min(len(data), 80)):
        encoded_size(data[:length])
    for _ in range(200):
        damaged = bytearray(data)
        damaged[rng.randrange(min(len(data), 60))] = rng.randrange(256)
        assert encoded_size(bytes(damaged)) is None or min(encoded_size(bytes(damaged)) or ()) >= 0


def png(width: int, height: int, data: bytes = b"", bits: int = 8, colour: int = 2) -> bytes:
    """Return a PNG whose header claims a size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def test_an_image_that_claims_too_many_pixels_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    with patch("cv2.imdecode", side_effect=AssertionError("it was decoded")):
        for width, height in ((30_000, 30_000), (60_000, 60_000), (2**31 - 1, 2**31 - 1), (0, 5)):
            path.write_bytes(png(width, height))
            with pytest.raises(InputError, match="no image that can be read"):
                read_image(path)
        path.write_bytes(png(MOST_PX // 1024 + 1, 1024, bits=16, colour=0))
        with pytest.raises(InputError, match="pixels are read"):
            read_depth_png(path)
        assert decode_pixels(png(5, 5)[:40]) is None
        assert decode_pixels(b"GIF89a" + bytes(50)) is None


def test_what_the_decoder_refuses_is_no_image(tmp_path: Path) -> None:
    path = tmp_path / "shot.png"
    path.write_bytes(png(5, 5))
    with patch("cv2.imdecode", side_effect=cv2.error("refused")), pytest.raises(InputError, match="no image"):
        read_image(path)


def test_a_chunk_that_is_longer_than_the_file_is_no_end() -> None:
    whole = png(5, 5)
    assert png_end(whole) == len(whole)
    assert png_end(whole + b"more") == len(whole)
    assert png_end(whole[:-1]) == 0
    assert png_end(whole[:8] + b"\xff\xff\xff\xffIHDR" + whole[16:]) == 0
