from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.parallel_pair import (
    DistanceTable,
    ParallelPair,
    PowerLaw,
    distance_table,
    fit,
    swapped,
    view_angle_of,
)

# Distances [cm] and disparities [px] that were measured with two cameras 7.5 cm apart, of 640 columns (table 10.1 of
# the thesis that described the system), its calculated distances, and those it corrected.
MEASURED = np.array([
    [100, 40], [95, 42], [90, 44], [85, 48], [80, 49], [75, 52], [70, 56], [65, 61], [60, 66], [55, 71], [50, 76],
    [45, 85], [40, 97], [35, 109], [30, 129], [25, 153], [20, 189],
])  # fmt: skip
CM, PX = MEASURED.T.astype(float)
PAIR = ParallelPair(0.075, 640, math.radians(62.2))


def mean_error(cm: np.ndarray) -> float:
    return float((np.abs(cm - CM) / CM).mean())


def test_the_line_in_logarithms_through_the_table() -> None:
    law = fit(CM / 100, PX)
    assert law.k_cm == pytest.approx(4543.3, abs=0.05)
    assert law.z == pytest.approx(-1.0354, abs=0.00005)
    np.testing.assert_allclose(100 * law.depth(PX), 4543.3201 * PX**-1.0354230, atol=0.001)
    assert mean_error(100 * law.depth(PX)) == pytest.approx(0.0094, abs=0.00005)
    first, last = 100 * law.depth(PX)[[0, -1]]
    assert (first, last) == (pytest.approx(99.670, abs=0.001), pytest.approx(19.965, abs=0.001))


def test_the_tables_distances_follow_from_the_angle_that_it_does_not_say() -> None:
    assert mean_error(100 * PAIR.depth(PX)) == pytest.approx(0.0230, abs=0.00005)
    assert mean_error(100 * ParallelPair(0.075, 640, math.radians(62.5)).depth(PX)) == pytest.approx(0.0196, abs=5e-5)
    assert 100 * PAIR.depth(40.0) == pytest.approx(99.463, abs=0.001)


def test_one_pixel_at_half_a_metre_is_six_millimetres() -> None:
    assert PAIR.expected_error(0.5) == pytest.approx(0.0057, abs=0.0001)


@given(st.floats(0.1, 5), st.floats(0.02, 0.5), st.floats(0.3, 2.0))
def test_depth_and_disparity_are_each_others_inverse(depth: float, baseline: float, angle: float) -> None:
    pair = ParallelPair(baseline, 640, angle)
    assert pair.depth(pair.disparity(depth)) == pytest.approx(depth)
    assert view_angle_of([depth] * 3, [float(pair.disparity(depth))] * 3, baseline, 640) == pytest.approx(angle)


@given(st.floats(1e2, 1e5), st.floats(-1.5, -0.5))
def test_a_law_comes_back_from_its_own_distances(k: float, z: float) -> None:
    law = PowerLaw(k, z)
    found = fit(law.depth(PX), PX)
    assert (found.k_cm, found.z) == (pytest.approx(k), pytest.approx(z))


def test_what_a_pixel_makes_of_a_fitted_depth() -> None:
    law = PowerLaw(4543.3, -1.0354)
    step = law.depth(PX - 0.5) - law.depth(PX + 0.5)
    np.testing.assert_allclose(law.expected_error(PX), step, rtol=1e-3)


@given(st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(0.3, 2))
def test_a_point_comes_back_from_both_pictures(x: float, y: float, z: float) -> None:
    f, c = PAIR.focal_px, np.array([319.5, 239.5])
    left, right = (np.array([x + side, y]) * f / z + c for side in (-0.0375, 0.0375))
    depth = PAIR.depth((right - left)[0])
    np.testing.assert_allclose(PAIR.points(left, right, depth, 480), [x, y, z], atol=1e-12)


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=9), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_distances_that_are_all_off_by_one_share_have_that_mean_error(
    distances: list[float], calculated: float, corrected: float
) -> None:
    m = np.array(distances)
    table = DistanceTable(PowerLaw(1.0, -1.0), m, 1 / m, (1 + calculated) * m, (1 + corrected) * m, 0 * m)
    assert table.mean_error == pytest.approx(abs(calculated), abs=1e-12)
    assert table.corrected_mean_error == pytest.approx(abs(corrected), abs=1e-12)


def test_the_tables_correction_more_than_halves_its_mean_error() -> None:
    table = distance_table(CM / 100, PX, PAIR)
    assert table.mean_error == pytest.approx(0.0230, abs=0.00005)
    assert table.corrected_mean_error == pytest.approx(0.0094, abs=0.00005)
    np.testing.assert_allclose(table.rows_cm()[:, :2], MEASURED)


@given(*3 * [st.integers(0, 4)])
def test_cameras_are_swapped_where_more_than_half_of_the_disparities_are_negative(
    negative: int, zero: int, positive: int
) -> None:
    disparities = [*negative * [-3.0], *zero * [0.0], *positive * [3.0], math.nan]
    assert swapped(disparities) == (negative > zero + positive)


def test_swapped_cameras_are_said() -> None:
    assert swapped(-PX)
    assert not swapped([*PX, -3.0, np.nan])
    assert not swapped([np.nan])
    assert np.isnan(PAIR.depth([-40.0, 0.0])).all()
    assert np.isnan(PowerLaw(4543.3, -1.0354).depth([-40.0, 0.0])).all()
    with pytest.raises(InputError, match="swapped"):
        fit(CM / 100, -PX)


@pytest.mark.parametrize(
    ("cm", "px", "said"),
    [
        ([100.0, 50.0], [40.0, 80.0], "2 rows"),
        ([100.0, 0.0, 20.0], [40.0, 76.0, 189.0], "row 2"),
        ([100.0, 50.0, 20.0], [40.0, 0.0, 189.0], "row 2"),
        ([100.0, 50.0, 20.0], [40.0, 40.0, 40.0], "alike"),
    ],
)
def test_measurements_of_no_use_are_refused(cm: list[float], px: list[float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        fit(np.array(cm) / 100, px)


@pytest.mark.parametrize("name", ["baseline_m", "width_px", "view_angle_rad"])
def test_a_pair_out_of_range_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        ParallelPair(**{"baseline_m": 0.1, "width_px": 640, "view_angle_rad": 1.0, name: 0.0})
