"""Signed distances to outlines, beside what every crossing says by itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.signed_distance import signed_distance

Float64 = NDArray[np.float64]


def crossings(field: Float64) -> Float64:
    """(n, 2) where the outline crosses the lines from a sample to the next, (row, column)."""
    found = []
    rows, columns = field.shape
    for i in range(rows):
        for j in range(columns):
            for a, b in ((i + 1, j), (i, j + 1)):
                if a < rows and b < columns and (field[i, j] > 0) != (field[a, b] > 0):
                    t = field[i, j] / (field[i, j] - field[a, b])
                    found.append((i + t * (a - i), j + t * (b - j)))
    return np.array(found).reshape(-1, 2)


@pytest.mark.slow
@settings(max_examples=20)
@given(
    st.tuples(st.integers(2, 14), st.integers(2, 14)),
    st.integers(1, 6),
    st.integers(1, 3),
    st.integers(0, 10_000),
    st.booleans(),
)
def test_it_is_the_distance_to_the_nearest_crossing_or_the_chord_beside_it(
    size: tuple[int, int], reach: int, step: int, seed: int, mask: bool
) -> None:
    rows, columns = size
    rng = np.random.default_rng(seed)
    field = rng.normal(rng.normal(), 1, (rows, columns)).astype(np.float32)
    given_field = np.where(field > 0, 1.0, -1.0) if mask else field.astype(float)
    phi = signed_distance(field > 0 if mask else field, reach * step, step)
    assert phi.dtype == np.float32
    np.testing.assert_array_equal(phi > 0, (field > 0) & (phi != 0))
    points = crossings(given_field)
    for i in range(rows):
        for j in range(columns):
            away = np.hypot(points[:, 0] - i, points[:, 1] - j) if len(points) else np.array([np.inf])
            nearest = min(float(away.min()), float(reach))
            size = abs(float(phi[i, j])) / step
            assert size <= nearest + 1e-5
            own = [math.hypot(*(p - (i, j))) for p in points if p[0] == i or p[1] == j]
            if not own or min(own) > 1.5:  # no chord
                assert size == pytest.approx(nearest, abs=1e-5)
            else:
                assert size >= nearest / math.sqrt(2) - 1e-5


@pytest.mark.parametrize("step", [1, 2])
def test_a_circle_given_by_its_distances_has_them_again(step: int) -> None:
    y, x = np.mgrid[:240:step, :240:step].astype(float)
    true = 80.3 - np.hypot(x - 118.4, y - 121.7)
    phi = signed_distance(true, 24, step)
    error = phi - np.clip(true, -24, 24)
    assert abs(error).max() < 0.12 * step
    assert abs(error[abs(true) < step]).mean() < 0.01 * step


def test_a_mask_turned_over_has_distances_of_the_other_sign() -> None:
    mask = np.random.default_rng(3).random((20, 30)) > 0.7
    np.testing.assert_array_equal(signed_distance(mask, 9), -signed_distance(~mask, 9))


def test_a_mask_mirrored_or_transposed_has_its_distances_so() -> None:
    mask = np.random.default_rng(4).random((21, 30)) > 0.6
    phi = signed_distance(mask, 7)
    np.testing.assert_array_equal(signed_distance(mask[:, ::-1], 7), phi[:, ::-1])
    np.testing.assert_array_equal(signed_distance(mask[::-1], 7), phi[::-1])
    np.testing.assert_allclose(signed_distance(mask.T, 7), phi.T, atol=1e-6)


@pytest.mark.parametrize(("inside", "sign"), [(np.ones((4, 5), dtype=bool), 1), (np.zeros((4, 5), dtype=bool), -1)])
def test_without_an_outline_everything_is_out_of_reach(inside: NDArray[np.bool_], sign: int) -> None:
    np.testing.assert_array_equal(signed_distance(inside, 6, 2), sign * np.full((4, 5), 6, dtype=np.float32))


@pytest.mark.parametrize(
    ("inside", "reach", "step", "says"),
    [
        (np.zeros(3, dtype=bool), 4, 1, "inside"),
        (np.zeros((0, 3), dtype=bool), 4, 1, "inside"),
        (np.zeros((2, 3), dtype=bool), 0, 1, "reach_px"),
        (np.zeros((2, 3), dtype=bool), math.nan, 1, "reach_px"),
        (np.zeros((2, 3), dtype=bool), 256, 1, "reach_px"),
        (np.zeros((2, 3), dtype=bool), 4, 0, "step_px"),
    ],
)
def test_what_has_no_distances_is_refused(inside: NDArray[np.bool_], reach: float, step: int, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        signed_distance(inside, reach, step)
