"""The cost of a bundle adjustment."""

from __future__ import annotations

import numpy as np

from mocapella.calibration.board_bundle import Bundle, Corners, LensPrior, _cost, _Problem

LENS = np.array([600.0, 600.0, 320.0, 240.0, 0.1, -0.05, 0.001, 0.001, 0.0])


def test_a_lens_costs_by_its_distance_from_the_prior_and_nothing_at_its_mean() -> None:
    corners = Corners(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros((1, 3)), np.full((1, 2), 250.0))
    board = np.eye(4)[None].copy()
    board[0, 2, 3] = 1.5

    def prior_cost(lens: np.ndarray) -> float:
        bundle = Bundle(np.eye(4)[None], lens[None], board)
        with_prior, without = (
            _cost(
                _Problem(corners, np.ones((1, 9), np.bool_), np.ones(1, np.bool_), LensPrior(LENS[None], P), 1.0),
                bundle,
            )
            for P in (np.diag(np.arange(1.0, 10.0))[None], np.zeros((1, 9, 9)))
        )
        return with_prior - without

    assert prior_cost(LENS) == 0.0
    for axis in range(9):
        lens = LENS.copy()
        lens[axis] += 2.0
        np.testing.assert_allclose(prior_cost(lens), 4.0 * (axis + 1), rtol=1e-9)
