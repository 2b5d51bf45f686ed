"""Outputs of pose networks: bins are decoded to where they were encoded, and each person counts once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.person_regions import overlap
from mocapella.sensing.simcc import MOST_OVERLAP, decode_people, decode_simcc


@given(st.lists(st.tuples(st.floats(0, 191), st.floats(0, 255), st.floats(0.01, 1.5)), min_size=1, max_size=5))
def test_a_coordinate_comes_back_within_half_a_bin(points: list[tuple[float, float, float]]) -> None:
    x, y = np.zeros((len(points), 384), np.float32), np.zeros((len(points), 512), np.float32)
    for k, (px, py, sure) in enumerate(points):
        x[k, round(2 * px)], y[k, round(2 * py)] = sure, sure + 0.1
    found = decode_simcc(x, y, (192, 256))
    np.testing.assert_allclose(found.points_px, [point[:2] for point in points], atol=0.2501)
    np.testing.assert_allclose(found.confidences, [min(point[2], 1) for point in points], rtol=1e-6)


def test_people_that_overlap_are_one() -> None:
    boxes = np.array([[0, 0, 10, 20, 0.6], [0, 1, 10, 21, 0.9], [30, 0, 40, 20, 0.5], [60, 0, 70, 20, 0.1]], np.float32)
    keypoints = np.arange(4 * 2 * 3, dtype=np.float32).reshape(4, 2, 3) / 24
    found = decode_people(boxes, keypoints, 0.3)
    np.testing.assert_array_equal(found.points_px, keypoints[[1, 2], :, :2])
    np.testing.assert_array_equal(found.confidences, keypoints[[1, 2], :, 2])
    assert len(decode_people(boxes, keypoints, 0.95).points_px) == 0
    assert len(decode_people(boxes[:0], keypoints[:0], 0.3).points_px) == 0


@pytest.mark.parametrize(("shift", "count"), [(2.1, 1), (2.2, 2)])
def test_two_boxes_are_one_person_only_beyond_the_limit(shift: float, count: int) -> None:
    boxes = np.array([[0, 0, 10, 20, 0.9], [shift, 0, 10 + shift, 20, 0.8]], np.float32)
    assert (overlap(*boxes[:, :4]) > MOST_OVERLAP) == (count == 1)
    assert len(decode_people(boxes, np.zeros((2, 1, 3), np.float32), 0.3).points_px) == count
