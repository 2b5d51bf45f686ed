from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.fusion.facing_grid import (
    ANGLE_WITHIN,
    BIN,
    BINS,
    CLIMB_BINS,
    YAWS,
    circular_sd,
    most_likely,
    most_likely_angle,
    turned,
    turned_on,
    unknown,
)
from mocapella.geometry.angles import wrap

some = arrays(np.float64, BINS, elements=st.floats(1e-6, 1.0)).map(lambda p: p / p.sum())
whiles = st.floats(0, 50)


@given(some, whiles, whiles)
def test_two_whiles_in_turn_are_one_of_both(p: np.ndarray, first: float, then: float) -> None:
    np.testing.assert_allclose(turned_on(turned_on(p, first), then), turned_on(p, first + then), atol=1e-10)


@given(some, whiles)
def test_time_widens_and_keeps_the_sum(p: np.ndarray, steps: float) -> None:
    after = turned_on(p, steps)
    assert after.min() > 0
    assert after.sum() == pytest.approx(1.0, abs=1e-9)
    assert circular_sd(after) >= circular_sd(p) - 1e-6
    assert np.ptp(after) <= np.ptp(p) + 1e-12


def test_after_long_silence_every_direction_is_alike() -> None:
    np.testing.assert_allclose(turned_on(np.eye(BINS)[7], 5000.0), unknown(), atol=1e-9)


def test_no_time_changes_nothing_and_the_spread_of_a_turn_is_that_of_two_bins() -> None:
    """The share that leaks to every direction alike is left out."""
    sure = np.eye(BINS)[24]
    np.testing.assert_allclose(turned_on(sure, 0.0), sure, atol=1e-11)
    bins = np.arange(BINS) - 24
    for steps in (0.1, 1.0, 3.0):
        after = turned_on(sure, steps)
        turn = after - after.min()
        assert turn @ bins**2 / turn.sum() == pytest.approx(2 * steps, rel=0.01)


@given(some, st.integers(-60, 60), st.floats(-10, 10))
def test_turning_is_a_shift_and_can_be_undone(p: np.ndarray, bins: int, by: float) -> None:
    np.testing.assert_allclose(turned(p, bins * BIN), np.roll(p, bins), atol=1e-9)
    assert turned(p, by).sum() == pytest.approx(1.0)


@given(st.floats(-np.pi, np.pi), st.floats(5, 40), st.integers(-60, 60))
def test_a_hump_is_found_where_it_is(yaw: float, concentration: float, bins: int) -> None:
    p = np.exp(concentration * np.cos(YAWS - yaw))
    assert abs(wrap(most_likely(p) - yaw)) < BIN / 2
    assert wrap(most_likely(turned(p, bins * BIN)) - most_likely(p) - bins * BIN) == pytest.approx(0, abs=1e-6)
    assert circular_sd(p) == pytest.approx(concentration**-0.5, rel=0.15)


def test_of_two_opposite_humps_the_larger_one_is_taken_and_not_their_middle() -> None:
    p = np.exp(20 * np.cos(YAWS - 0.3)) + 0.9 * np.exp(20 * np.cos(YAWS - 0.3 - np.pi))
    assert most_likely(p) == pytest.approx(0.3, abs=0.02)


@given(some, some)
def test_the_angle_is_near_the_most_likely_yaw(p: np.ndarray, angle: np.ndarray) -> None:
    """Both are means over three bins on either side of a bin."""
    assert abs(wrap(most_likely_angle(p, angle) - most_likely(p))) <= (CLIMB_BINS + 6) * BIN + 1e-9


@given(st.floats(-np.pi, np.pi), st.floats(-0.4, 0.4), st.floats(5, 40))
def test_the_side_does_not_draw_the_angle(yaw: float, off: float, concentration: float) -> None:
    side, angle = np.exp(8 * np.cos(YAWS - yaw - off)), np.exp(concentration * np.cos(YAWS - yaw))
    assert most_likely_angle(side, angle) == pytest.approx(most_likely(angle), abs=1e-9)


@given(st.floats(-np.pi, np.pi), st.floats(-2.0, 2.0), st.integers(-60, 60))
def test_the_angle_turns_with_the_world(yaw: float, off: float, bins: int) -> None:
    side, angle = np.exp(8 * np.cos(YAWS - yaw - off)), np.exp(3 * np.cos(YAWS - yaw))
    turned_on_by = most_likely_angle(np.roll(side, bins), np.roll(angle, bins))
    assert abs(wrap(turned_on_by - most_likely_angle(side, angle) - bins * BIN)) < BIN / 2


def test_a_peak_beyond_a_valley_or_too_far_away_is_not_taken() -> None:
    side = np.exp(20 * np.cos(YAWS))
    near, far = np.exp(20 * np.cos(YAWS - 0.3)), np.exp(20 * np.cos(YAWS - 1.6))
    assert most_likely_angle(side, near + 0.05 * far) == pytest.approx(0.3, abs=BIN / 2)
    assert abs(most_likely_angle(side, near + 5 * far)) <= ANGLE_WITHIN
    assert abs(most_likely_angle(side, far)) <= ANGLE_WITHIN


def test_an_uncertain_peak_is_drawn_to_the_side_and_a_certain_one_is_not() -> None:
    side, hump = np.exp(20 * np.cos(YAWS)), np.exp(20 * np.cos(YAWS - 0.5))
    uncertain = hump + 0.2 * np.exp(20 * np.cos(YAWS - 0.5 - np.pi))
    assert most_likely_angle(side, hump) == pytest.approx(0.5, abs=BIN / 2)
    assert 0.2 < most_likely_angle(side, uncertain) < 0.45


@given(st.floats(-np.pi, np.pi), st.floats(-0.2, 0.2), st.floats(0.1, 0.9))
def test_the_side_is_of_one_distribution_and_the_angle_of_the_other(yaw: float, off: float, back: float) -> None:
    """The angle is as likely forwards as backwards, and the side is known with an error of up to 11°."""
    side = np.exp(8 * np.cos(YAWS - yaw - off))
    angle = (1 - back) * np.exp(20 * np.cos(YAWS - yaw)) + back * np.exp(20 * np.cos(YAWS - yaw - np.pi))
    assert wrap(most_likely_angle(side, angle) - yaw) == pytest.approx(0, abs=BIN / 2)
