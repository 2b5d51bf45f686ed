"""Images encoded and decoded: laws, and what is damaged is refused in words."""

from __future__ import annotations

from contextlib import suppress
from unittest.mock import patch

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.model.images import image_frame
from mocapella.schema import decode_frame, encode_frame
from mocapella.sensing.images import decode_image, encode_image


def picture(width=40, height=30, seed=0):
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height // 10 + 1, width // 10 + 1, 3))
    return np.ascontiguousarray(np.kron(coarse, np.ones((10, 10, 1)))[:height, :width].astype(np.uint8))


def encoded(image, format):
    size = (image.shape[1], image.shape[0])
    return image_frame("left", encode_image(image, format), time_ns=5, format=format, size_px=size)


@given(st.integers(1, 70), st.integers(1, 70), st.integers(0, 9))
def test_a_png_comes_back_as_it_was_and_a_jpeg_nearly(width, height, seed):
    image = picture(width, height, seed)
    np.testing.assert_array_equal(decode_image(encoded(image, "png")), image)
    near = decode_image(encoded(image, "jpeg"))
    assert near.shape == image.shape
    assert np.abs(near.astype(int) - image).mean() < 20


@pytest.mark.parametrize("format", ["raw", "jpeg", "png"])
def test_an_image_of_a_message_is_an_array_for_which_kernels_are_compiled(format):
    """Read-only arrays would be another type: all kernels would be compiled again in the middle of a session."""
    image = picture()
    frame = image_frame("left", image, time_ns=5) if format == "raw" else encoded(image, format)
    flags = decode_image(decode_frame(encode_frame(frame))).flags
    assert flags.c_contiguous
    assert flags.writeable


def test_a_raw_image_is_not_copied():
    image = picture()
    frame = image_frame("left", image, time_ns=5)
    assert frame.size_px == (40, 30)
    assert decode_image(frame) is image


def test_quality_is_that_of_a_jpeg():
    rough, fine = (encode_image(picture(200, 150), "jpeg", quality) for quality in (10, 95))
    assert len(rough) < len(fine)


@pytest.mark.parametrize("format", ["jpeg", "png"])
@given(cut=st.floats(0, 0.999))
def test_what_is_cut_short_is_refused(format, cut):
    frame = encoded(picture(), format)
    less = msgspec.structs.replace(frame, data=frame.data[: int(cut * len(frame.data))])
    with pytest.raises(InputError, match="its image is damaged, or not of 40 × 30 px"):
        decode_image(less)


@pytest.mark.parametrize("format", ["jpeg", "png"])
@given(at=st.integers(0, 10_000), value=st.integers(0, 255))
def test_a_wrong_byte_is_lived_through(format, at, value):
    frame = encoded(picture(), format)
    data = bytearray(frame.data)
    data[at % len(data)] = value
    with suppress(InputError):
        assert decode_image(msgspec.structs.replace(frame, data=bytes(data))).shape == (30, 40, 3)


@pytest.mark.parametrize("chunk", [8, 33])
@given(claimed=st.integers(1000, 2**32 - 1))
def test_a_chunk_that_claims_to_be_enormous_is_never_decoded(chunk, claimed):
    frame = encoded(picture(), "png")
    data = bytearray(frame.data)
    data[chunk : chunk + 4] = claimed.to_bytes(4, "big")
    with pytest.raises(InputError), patch("cv2.imdecode", side_effect=AssertionError("it was decoded")):
        decode_image(msgspec.structs.replace(frame, data=bytes(data)))


@given(st.binary(max_size=200), st.sampled_from(["jpeg", "png"]))
def test_bytes_of_anything_are_refused(data, format):
    with pytest.raises(InputError):
        decode_image(image_frame("left", data, time_ns=5, format=format, size_px=(40, 30)))


def test_an_image_of_another_size_or_format_than_it_says_is_refused():
    frame = encoded(picture(), "png")
    for wrong in ({"size_px": (40, 31)}, {"format": "jpeg"}, {"format": ""}, {"data": picture(50, 30)}):
        with pytest.raises(InputError):
            decode_image(msgspec.structs.replace(frame, **wrong))


def test_frames_and_formats_that_cannot_be_are_refused():
    with pytest.raises(SettingsError, match="image format 'gif'; it must be one of jpeg, png"):
        encode_image(picture(), "gif")
    with pytest.raises(SettingsError, match="is wanted"):
        encode_image(picture()[..., 0])
    for image, how in (
        (picture().astype(np.float32), {}), (picture()[..., 0], {}), (picture(), {"format": "png"}),
        (b"abc", {}), (b"abc", {"format": "png"}), (b"abc", {"format": "bmp", "size_px": (1, 1)}),
    ):  # fmt: skip
        with pytest.raises(SettingsError):
            image_frame("left", image, time_ns=5, **how)
    nothing = image_frame("left", None, time_ns=5)
    assert (nothing.format, nothing.data, nothing.size_px, nothing.bodies) == ("", b"", (0, 0), 0)
