from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.angles import circular_mean, wrap

narrow = st.lists(st.floats(-1, 1), min_size=1, max_size=8)


@given(st.floats(-100, 100), st.integers(-5, 5))
def test_wrapping_forgets_whole_turns_and_nothing_else(angle: float, turns: int) -> None:
    wrapped = wrap(angle + 2 * np.pi * turns)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-12)


@given(narrow, st.floats(-10, 10))
def test_turning_all_angles_turns_their_mean(angles: list[float], by: float) -> None:
    turned = circular_mean(np.array(angles) + by)
    assert wrap(turned - circular_mean(angles) - by) == pytest.approx(0, abs=1e-9)


@given(narrow)
def test_the_mean_does_not_depend_on_the_order(angles: list[float]) -> None:
    assert circular_mean(angles) == pytest.approx(circular_mean(angles[::-1]), abs=1e-12)


def test_the_mean_is_right_across_the_seam_where_the_plain_mean_is_half_a_turn_off() -> None:
    assert abs(circular_mean([np.pi - 0.1, -np.pi + 0.1])) == pytest.approx(np.pi)
    np.testing.assert_allclose(circular_mean([[0.1, 0.3], [-0.1, -0.3]], axis=0), [0, 0], atol=1e-15)
