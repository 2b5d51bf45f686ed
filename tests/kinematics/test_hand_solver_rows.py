"""What the solvers of hands are given of a finger, without their kernels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.kinematics.hand_solvers import _squared_distance

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
