"""Thinning and the skeleton's stages: laws, and OpenCV's own functions as the reference, pixel for pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

cv2 = pytest.importorskip("cv2")

from mocapella.sensing.line_skeleton_thinning import skeleton, thin  # noqa: E402 - only where there is OpenCV

UInt8 = NDArray[np.uint8]


@st.composite
def masks(draw: Any, widest: int = 140) -> UInt8:
    """Specks, blocks and thick strokes, of every size around that of a word of 64 pixels; they may touch the border."""
    height, width = draw(st.integers(1, 40)), draw(st.integers(1, widest))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mask = (rng.random((height, width)) < draw(st.sampled_from([0.02, 0.3, 0.6, 0.95]))).astype(np.uint8)
    grown = draw(st.integers(0, 4))
    if grown:
        mask = cv2.dilate(mask * (rng.random(mask.shape) < 0.2), np.ones((grown + 1, grown + 1), dtype=np.uint8))
    return np.asarray(255 * mask, dtype=np.uint8)


def chain(mask: UInt8, ridge_least: int) -> tuple[UInt8, ...]:
    """The same stages by OpenCV alone, on whole images."""
    thinned = cv2.ximgproc.thinning(mask, thinningType=cv2.ximgproc.THINNING_ZHANGSUEN)
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    ridges = cv2.normalize(cv2.Laplacian(distance, cv2.CV_32F, scale=-1), None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    dilated = cv2.dilate(ridges, np.ones((3, 3), dtype=np.uint8))
    return thinned, distance, ridges, dilated, thinned * (dilated >= ridge_least)


def components(mask: UInt8) -> Any:
    """How many 8-connected pieces there are, the background being one, and whose a pixel is."""
    return cv2.connectedComponents((mask > 0).astype(np.uint8), connectivity=8)


@given(masks())
@settings(max_examples=150)
def test_it_thins_as_opencv_does_pixel_for_pixel(mask: UInt8) -> None:
    np.testing.assert_array_equal(thin(mask), cv2.ximgproc.thinning(mask))


@given(arrays(np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.sampled_from([0, 255])))
def test_the_smallest_pictures_are_thinned_as_opencv_does(mask: UInt8) -> None:
    np.testing.assert_array_equal(thin(mask), cv2.ximgproc.thinning(mask))


@pytest.mark.parametrize("width", [62, 63, 64, 65, 127, 128, 129])
def test_rows_as_long_as_words_do_not_touch_at_their_ends(width: int) -> None:
    mask = np.zeros((40, width + 4), dtype=np.uint8)
    mask[3:37, 2 : width + 2] = 255
    np.testing.assert_array_equal(thin(mask), cv2.ximgproc.thinning(mask))
    np.testing.assert_array_equal(thin(mask[:, 2:-2]), cv2.ximgproc.thinning(np.ascontiguousarray(mask[:, 2:-2])))


@given(masks())
def test_what_is_thin_stays_as_it_is_and_nothing_is_added(mask: UInt8) -> None:
    once = thin(mask)
    np.testing.assert_array_equal(thin(once), once)
    assert not (once[mask == 0]).any()
    assert set(np.unique(once)) <= {0, 255}


@given(masks(widest=60))
def test_no_piece_falls_apart_and_none_grow_together(mask: UInt8) -> None:
    """Zhang and Suen's conditions keep what is connected, but a piece may vanish: a square of four pixels does."""
    _, before = components(mask)
    _, after = components(thin(mask))
    pairs = np.unique(np.stack([before[after > 0], after[after > 0]]), axis=1)
    for side in pairs:
        assert len(side) == len(np.unique(side))
    assert thin(np.pad(np.full((2, 2), 255, dtype=np.uint8), 2)).sum() == 0


@given(st.lists(st.tuples(st.integers(15, 185), st.integers(15, 105)), min_size=2, max_size=5), st.integers(3, 20))
def test_a_stroke_stays_as_many_pieces_as_it_was(corners: list[tuple[int, int]], thick: int) -> None:
    mask = np.zeros((120, 200), dtype=np.uint8)
    ends = np.array([(x, y) for x, y in corners] + [(corners[0][0] ^ 8, corners[0][1] ^ 4)], dtype=np.int32)
    cv2.polylines(mask, [ends[:, None]], False, (255,), 2 * (thick // 2) + 1)
    cv2.line(mask, (10, 115), (190, 115), (255,), 3)
    assert components(thin(mask))[0] == components(mask)[0]


@given(masks(), st.integers(0, 255))
@example(np.array([[0, 255, 255, 255, 0, 0, 0]], dtype=np.uint8).T, 128)  # beside one border, far from the other
def test_the_stages_are_those_of_opencv_to_the_bit(mask: UInt8, ridge_least: int) -> None:
    mask[0, 0] = 0  # a distance to nowhere is as large as the build of OpenCV says
    made = skeleton(mask, ridge_least)
    got = made.thinned, made.distance, made.ridges, made.dilated, made.lines
    for ours, reference in zip(got, chain(mask, ridge_least), strict=True):
        np.testing.assert_array_equal(ours, reference)


@pytest.mark.parametrize(
    "where",
    [
        np.s_[100:300, 40:90],
        np.s_[0:70, 600:640],
        np.s_[470:480, 0:640],
        np.s_[5:6, 5:6],
        np.s_[1:9, 1:9],
        np.s_[471:479, 631:639],
        np.s_[0:480, 600:640],  # along a whole side, so that only the other end of a row or column is flat
        np.s_[0:480, 0:40],
        np.s_[0:40, 0:640],
        np.s_[440:480, 0:640],
        np.s_[100:300, 400:417],  # ends just behind a multiple of 32, from which on OpenCV processes pixels together
        np.s_[100:300, 287:330],
    ],
)
def test_the_stages_of_a_part_of_a_large_picture_are_those_of_the_whole(where: Any) -> None:
    mask = np.zeros((480, 640), dtype=np.uint8)
    mask[where] = 255
    mask[120:130, 300:330] = 255
    made = skeleton(mask)
    got = made.thinned, made.distance, made.ridges, made.dilated, made.lines
    for ours, reference in zip(got, chain(mask, 128), strict=True):
        np.testing.assert_array_equal(ours, reference)


def test_of_nothing_comes_nothing() -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    made = skeleton(mask)
    for picture in (thin(mask), made.thinned, made.distance, made.ridges, made.dilated, made.lines):
        assert picture.shape == mask.shape
        assert not picture.any()
