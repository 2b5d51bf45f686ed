"""Boxes around people, and images in which some regions are blank: laws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mocapella.sensing.person_regions import FEWEST, SEEN, alike, box_of, covered, only, overlap, without

POINTS = arrays.arrays(np.float32, (9, 2), elements=st.floats(0, 500, width=32))
SIDES = st.tuples(st.floats(1, 100), st.floats(1, 100), st.floats(0, 100), st.floats(0, 100))


def box(sides: tuple[float, float, float, float]) -> Any:
    wide, high, left, top = sides
    return np.array([left, top, left + wide, top + high], np.float32)


@given(POINTS, st.floats(0, 0.5))
def test_a_box_holds_all_sure_keypoints(points: Any, margin: float) -> None:
    sure = np.linspace(0, 1, 9).astype(np.float32)
    found = box_of(points, sure, margin)
    assert found is not None
    there = points[sure >= SEEN]
    assert (there >= found[:2] - 1e-3).all()
    assert (there <= found[2:] + 1e-3).all()


def test_too_few_keypoints_have_no_box() -> None:
    points, sure = np.zeros((FEWEST, 2), np.float32), np.ones(FEWEST, np.float32)
    assert box_of(points, sure) is not None
    assert box_of(points[1:], sure[1:]) is None
    points[0] = np.nan
    assert box_of(points, sure) is None


@given(SIDES, SIDES)
def test_overlap_is_symmetric_and_at_most_1(one: Any, other: Any) -> None:
    a, b = box(one), box(other)
    assert overlap(a, b) == pytest.approx(overlap(b, a))
    assert 0 <= overlap(a, b) <= 1 + 1e-6
    assert overlap(a, a) == pytest.approx(1, abs=1e-5)
    assert overlap(a, b) <= covered(a, [b]) + 1e-6
    assert covered(a, []) == 0


@given(POINTS, st.floats(-1, 1))
def test_a_detection_is_alike_to_itself_shifted_a_little(points: Any, part: float) -> None:
    sure, size = np.ones(9, np.float32), float(np.ptp(points, axis=0).max())
    shifted = points + np.float32([0.09 * part * size, 0])
    assert alike(points, shifted, sure) or size < 1
    assert not alike(points, points + np.float32([0.2 * size + 1, 0]), sure)
    assert not alike(points, points, 0 * sure)


def test_a_blank_box_hides_what_is_in_it_alone() -> None:
    image = np.random.default_rng(1).integers(0, 255, (40, 60, 3)).astype(np.uint8)
    before, region = image.copy(), np.array([10.0, 5.0, 20.0, 15.0], np.float32)
    blank, rest = without(image, [region]), only(image, region)
    inside = np.zeros((40, 60), bool)
    inside[5:16, 10:21] = True
    np.testing.assert_array_equal(blank[~inside], image[~inside])
    np.testing.assert_array_equal(rest[inside], image[inside])
    assert (np.ptp(blank[inside].reshape(-1, 3), axis=0) == 0).all()
    assert (np.ptp(rest[~inside].reshape(-1, 3), axis=0) == 0).all()
    np.testing.assert_array_equal(image, before)
    assert without(image, []) is image


def test_a_box_outside_of_the_image_changes_nothing() -> None:
    image = np.arange(300, dtype=np.uint8).reshape(10, 10, 3)
    for region in ([-50.0, -50.0, -20.0, -20.0], [100.0, 2.0, 120.0, 5.0]):
        np.testing.assert_array_equal(without(image, [np.array(region, np.float32)]), image)
