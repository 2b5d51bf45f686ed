"""What a simulated room tells the filter of the people's motion."""

from __future__ import annotations

from collections import deque

import numpy as np

from mocapella.evaluation.facing_simulation import VELOCITY_OVER_S, _velocity


def test_a_velocity_is_a_mean_of_the_past_and_known_once_half_of_it_is_past() -> None:
    """Somebody falls from rest at 1 m/s²: the mean velocity [m/s] is the time [s] at the middle of the past."""
    places: deque[tuple[float, np.ndarray]] = deque()
    for sixteenths in range(20):
        at_s = sixteenths / 16  # exact, as are the limits
        found = _velocity(places, at_s, np.array([0.0, -0.5 * at_s**2, 0.0]))
        if at_s < 0.5 * VELOCITY_OVER_S:
            assert np.isnan(found).all()
        else:
            np.testing.assert_allclose(found, [0, -(at_s - 0.5 * min(at_s, VELOCITY_OVER_S)), 0], atol=1e-12)
