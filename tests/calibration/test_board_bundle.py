"""The cost of a bundle adjustment, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocapella.calibration.board_bundle import (
    CAMERA,
    POSE,
    Bundle,
    Corners,
    LensPrior,
    _cost,
    _normal_equations,
    _Problem,
    _residual,
    _sigma,
    adjust,
)
from mocapella.calibration.board_bundle import LENS as LENS_PART
from mocapella.geometry.twists import exp_twist

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


def test_the_right_sides_are_half_the_descent_of_the_cost_along_what_is_free_and_0_along_what_is_fixed() -> None:
    rng, grid = np.random.default_rng(0), np.array([[x, y, 0.0] for x in (-0.2, 0.0, 0.2) for y in (-0.1, 0.1)])
    unseen = Corners(np.repeat([0, 0, 1, 1], 6), np.repeat([0, 1, 0, 1], 6), np.tile(grid, (4, 1)), np.zeros((24, 2)))
    bundle = Bundle(
        exp_twist([[0.1, 0, 0, 0, 0.1, 0], [-0.1, 0, 0, 0, -0.1, 0.1]]),
        LENS + np.array([[20.0], [-10.0]]) * [1, 1, 1, 1, 0.001, 0.001, 0.0001, 0.0001, 0.001],
        exp_twist([[0, 0, 1.2, 0.3, 0, 0], [0, 0.1, 1.5, 0, -0.3, 0]]),
    )
    off = rng.normal(0, 3.0, (24, 2))  # as much as the loss's scale, so that its weights differ
    corners = replace(unseen, pixel=off - _residual(unseen, bundle))
    free = np.ones((2, CAMERA), np.bool_)
    free[0, [0, 3, 6, 10]] = False
    prior = LensPrior(np.stack([LENS, LENS]), np.stack([np.diag([0.01] * 4 + [1e4] * 5)] * 2))
    problem = _Problem(corners, free, np.array([True, False]), prior, 1.0)
    normal = _normal_equations(problem, bundle)

    def cost(unknown: int, by: float) -> float:
        step = by * np.eye(2 * CAMERA + 12)[unknown]
        of_cameras, of_boards = step[: 2 * CAMERA].reshape(2, CAMERA), step[2 * CAMERA :].reshape(2, 6)
        return _cost(
            problem,
            Bundle(
                exp_twist(of_cameras[:, POSE]) @ bundle.T_camera_world,
                bundle.lenses + of_cameras[:, LENS_PART],
                bundle.T_world_board @ exp_twist(of_boards),
            ),
        )

    estimated = np.r_[free.ravel(), [True] * 6, [False] * 6]
    for unknown, right in enumerate(np.r_[normal.of_cameras, normal.of_boards.ravel()]):
        if not estimated[unknown]:
            assert right == 0.0
        else:
            descent = (cost(unknown, -1e-6) - cost(unknown, 1e-6)) / 2e-6
            assert right == pytest.approx(descent / 2, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("unknowns", [0, 300, 600])
def test_the_noise_is_found_however_much_of_it_the_unknowns_absorb(unknowns: int) -> None:
    """The residuals of a linear fit lack the part of the noise that lies in the space of its unknowns."""
    rng, coordinates, sd_px = np.random.default_rng(unknowns), 1200, 0.7
    noise = rng.normal(0, sd_px, coordinates)
    space, _ = np.linalg.qr(rng.normal(size=(coordinates, unknowns)))
    residual = noise - space @ (space.T @ noise)
    assert _sigma(residual.reshape(-1, 2), unknowns / coordinates) == pytest.approx(sd_px, rel=0.15)


def test_corners_that_are_given_several_times_make_nobody_surer() -> None:
    """The errors of a view's corners are one error then: the views disagree by that much more than corners do."""
    rng, times, boards = np.random.default_rng(1), 6, 25
    grid = np.array([[x, y, 0.0] for x in np.linspace(-0.2, 0.2, 5) for y in np.linspace(-0.1, 0.1, 4)])
    count = len(grid)
    unseen = Corners(
        np.repeat([0, 1], boards * count), np.tile(np.repeat(np.arange(boards), count), 2),
        np.tile(grid, (2 * boards, 1)), np.zeros((2 * boards * count, 2)),
    )  # fmt: skip
    turned = rng.uniform([-0.3, -0.3, 1.2, -0.5, -0.5, -0.5], [0.3, 0.3, 1.8, 0.5, 0.5, 0.5], (boards, 6))
    start = Bundle(
        exp_twist([[0.1, 0, 0, 0, 0.1, 0], [-0.1, 0, 0, 0, -0.1, 0]]), np.stack([LENS, LENS]), exp_twist(turned)
    )
    once = replace(unseen, pixel=rng.normal(0, 0.2, unseen.pixel.shape) - _residual(unseen, start))
    # All copies of a view's corners follow each other, because they are of one view.
    order = np.arange(len(once.board)).reshape(-1, count).repeat(times, axis=0).ravel()
    often = Corners(once.camera[order], once.board[order], once.corner_m[order], once.pixel[order])
    free = np.zeros((2, CAMERA), np.bool_)
    free[1, POSE] = True
    prior = LensPrior(start.lenses, np.zeros((2, 9, 9)))
    one, same = (adjust(corners, start, free, np.ones(boards, np.bool_), prior) for corners in (once, often))
    assert one.dispersion == pytest.approx(1.0, abs=0.2)
    assert same.dispersion == pytest.approx(times, rel=0.2)
    sd, again = (np.sqrt(np.diagonal(found.covariance[1, :, 1])[POSE]) for found in (one, same))
    np.testing.assert_allclose(again, sd, rtol=0.2)
