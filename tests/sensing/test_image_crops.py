"""Crops at a network's size, and the way back: laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.image_crops import GREY, PADDING, letterbox, person_crop, to_image, to_rgb


@given(st.floats(-20, 60), st.floats(-20, 60), st.floats(1, 90), st.floats(1, 90))
def test_the_middle_of_a_crop_is_the_middle_of_the_box(left: float, top: float, wide: float, high: float) -> None:
    box = np.array([left, top, left + wide, top + high], np.float32)
    crop, T = person_crop(np.zeros((50, 70, 3), np.uint8), box, (48, 64))
    assert crop.shape == (64, 48, 3)
    middle = to_image(np.array([[23.5, 31.5]], np.float32), T)[0]
    np.testing.assert_allclose(middle, (box[:2] + box[2:]) / 2, atol=1e-3)
    sides = T[0, 0] * np.array([48, 64])
    assert (sides >= PADDING * np.array([wide, high]) - 1e-3).all()
    assert T[0, 0] == T[1, 1]


@pytest.mark.parametrize("scale", [1, 4])
def test_a_bright_pixel_is_found_again_where_it_was(scale: int) -> None:
    image = np.zeros((60 * scale, 80 * scale, 3), np.uint8)
    image[30 * scale : 31 * scale, 50 * scale : 51 * scale] = 255
    at = np.array([50 * scale, 30 * scale]) + (scale - 1) / 2
    box = np.array([20, 10, 70, 50], np.float32) * scale
    for crop, T in (person_crop(image, box, (96, 128)), letterbox(image, (96, 96))):
        weights = crop[..., 0].astype(float) * (crop[..., 0] > GREY)
        y, x = (float((weights * grid).sum() / weights.sum()) for grid in np.mgrid[: crop.shape[0], : crop.shape[1]])
        assert np.abs(to_image(np.array([x, y], np.float32), T) - at).max() < 0.6 * scale


def test_a_letterboxed_image_keeps_its_corners() -> None:
    image = np.full((30, 60, 3), 200, np.uint8)
    canvas, T = letterbox(image, (40, 40))
    assert (canvas[5:15, 5:35] == 200).all()
    assert (canvas[22:] == GREY).all()
    np.testing.assert_allclose(to_image(np.array([-0.5, -0.5], np.float32), T), [-0.5, -0.5], atol=1e-5)
    np.testing.assert_allclose(to_image(np.array([39.5, 19.5], np.float32), T), [59.5, 29.5], atol=1e-4)


def test_red_and_blue_change_places() -> None:
    assert to_rgb(np.array([[[1, 2, 3]]], np.uint8)).tolist() == [[[3, 2, 1]]]
