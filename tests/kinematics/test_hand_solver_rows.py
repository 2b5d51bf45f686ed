"""What the solvers of hands are given of a finger, without their kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.kinematic_hands import LEFT, RIGHT, THESIS

from mocapella.kinematics.hand_solvers import _Solver, _squared_distance
from mocapella.model.hand import DIGIT_ANGLES

lengths = st.tuples(*[st.floats(0.01, 0.08)] * 3)


@pytest.mark.parametrize("thirds", [0, 1, 2, 3, 4])
@given(lengths, st.floats(0, np.pi))
def test_the_polynomial_is_the_squared_distance_of_the_tip_whose_last_joints_bend_together(
    thirds: int, bones: tuple[float, float, float], middle: float
) -> None:
    """The second joint bends by an angle, the third by so many thirds of it."""
    coefficients = _squared_distance(np.array(bones), thirds)
    assert coefficients.shape == (8,)
    directions = np.cumsum([0.0, middle, thirds * middle / 3])
    tip = np.sum(np.multiply(bones, np.exp(1j * directions)))
    found = np.polynomial.polynomial.polyval(np.cos(middle / 3), coefficients)
    assert found == pytest.approx(abs(tip) ** 2, abs=1e-9)


class Noting(_Solver):
    """Notes the targets and the angles to begin with, and leaves the angles."""

    def _solve(self, targets: Any, angles: Any, errors: Any, iterations: Any) -> None:
        self.targets, self.angles = targets.copy(), angles.copy()
        errors[:], iterations[:] = targets[:, 2], 7


def test_a_left_hand_is_solved_as_the_mirrored_right_one() -> None:
    """The kernels get a right hand's targets as they are, and a left hand's across the plane x = 0."""
    targets = np.random.default_rng(0).normal(0, 0.1, (5, 3))
    right, left = Noting(THESIS, RIGHT), Noting(THESIS, LEFT)
    one, other = right.solve(targets), left.solve(targets * [-1, 1, 1])
    for made in (right, left):
        np.testing.assert_array_equal(made.targets, targets)
        np.testing.assert_allclose(made.angles, THESIS.natural[DIGIT_ANGLES[:, :4]], atol=1e-12)
    np.testing.assert_array_equal(one.errors_m, targets[:, 2])
    np.testing.assert_array_equal(other.angles, one.angles)


def test_a_solver_begins_where_it_is_told_and_keeps_what_has_no_target() -> None:
    """The thumb's second joint does not abduct if the thumb has a target."""
    made, start = Noting(THESIS, RIGHT), THESIS.limited(np.full(21, 0.1))
    targets = np.full((2, 5, 3), 0.1)
    targets[1, 0] = np.nan
    found = made.solve(targets, start)
    np.testing.assert_allclose(made.angles, start[DIGIT_ANGLES[:, :4]], atol=1e-12)
    assert found.measured.tolist() == [[True] * 5, [False, True, True, True, True]]
    assert found.angles[:, DIGIT_ANGLES[0, 4]].tolist() == [0.0, start[DIGIT_ANGLES[0, 4]]]
