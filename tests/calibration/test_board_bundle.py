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
    _Normal,
    _normal_equations,
    _Problem,
    _residual,
    _sigma,
    _step,
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


GRID = np.array([[x, y, 0.0] for x in (-0.2, 0.0, 0.2) for y in (-0.1, 0.1)])


def scene(boards: int, cameras: int = 2, grid: np.ndarray = GRID, seed: int = 2) -> tuple[Corners, Bundle]:
    """Exact corners of boards that all cameras see, and where all of them are."""
    rng, count = np.random.default_rng(seed), len(grid)
    turned = rng.uniform([-0.3, -0.3, 1.2, -0.5, -0.5, -0.5], [0.3, 0.3, 1.8, 0.5, 0.5, 0.5], (boards, 6))
    truth = Bundle(
        exp_twist([[0.1 - 0.2 * k, 0.05 * k, 0, 0, 0.1 - 0.2 * k, 0] for k in range(cameras)]),
        np.stack([LENS] * cameras), exp_twist(turned),
    )  # fmt: skip
    views = cameras * boards
    unseen = Corners(
        np.repeat(np.arange(cameras), boards * count), np.tile(np.repeat(np.arange(boards), count), cameras),
        np.tile(grid, (views, 1)), np.zeros((views * count, 2)),
    )  # fmt: skip
    return replace(unseen, pixel=-_residual(unseen, truth)), truth


def poses_free(cameras: int = 2) -> np.ndarray:
    """All cameras' poses but that of the first."""
    free = np.zeros((cameras, CAMERA), np.bool_)
    free[1:, POSE] = True
    return free


def no_prior(cameras: int = 2) -> LensPrior:
    return LensPrior(np.stack([LENS] * cameras), np.zeros((cameras, 9, 9)))


def moved(bundle: Bundle, step: np.ndarray) -> Bundle:
    cameras = len(bundle.lenses)
    of_cameras, of_boards = step[: cameras * CAMERA].reshape(-1, CAMERA), step[cameras * CAMERA :].reshape(-1, 6)
    return Bundle(
        exp_twist(of_cameras[:, POSE]) @ bundle.T_camera_world,
        bundle.lenses + of_cameras[:, LENS_PART],
        bundle.T_world_board @ exp_twist(of_boards),
    )


def whole(normal: _Normal, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The equations of cameras and boards together."""
    size, boards = len(normal.cameras), len(normal.boards)
    H = np.zeros((size + 6 * boards, size + 6 * boards))
    H[:size, :size] = normal.cameras
    H[:size, size:] = normal.mixed.reshape(size, -1)
    H[size:, :size] = H[:size, size:].T
    for k, block in enumerate(normal.boards):
        H[size + 6 * k : size + 6 * k + 6, size + 6 * k : size + 6 * k + 6] = block
    return H + damping * np.diag(np.diag(H)), np.r_[normal.of_cameras, normal.of_boards.ravel()]


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_the_matrix_is_the_change_of_the_right_sides_with_what_is_free_and_1_of_what_is_fixed(sigma: float) -> None:
    corners, truth = scene(2)
    free = np.ones((2, CAMERA), np.bool_)
    free[0, [0, 3, 6, 10]] = False
    prior = LensPrior(np.stack([LENS, LENS]), np.stack([np.diag([0.01] * 4 + [1e4] * 5)] * 2))
    problem = _Problem(corners, free, np.array([True, False]), prior, sigma)
    H, right = whole(_normal_equations(problem, truth))
    np.testing.assert_allclose(right, 0.0, atol=1e-9)
    scale = np.sqrt(np.diag(H))
    estimated = np.r_[free.ravel(), [True] * 6, [False] * 6]
    for unknown, by in enumerate(1e-5 * np.eye(len(H)) / scale):
        if not estimated[unknown]:
            np.testing.assert_array_equal(H[unknown], np.eye(len(H))[unknown])
            continue
        more, less = (whole(_normal_equations(problem, moved(truth, step)))[1] for step in (by, -by))
        change = (less - more) / 2e-5 * scale[unknown]
        np.testing.assert_allclose(change / scale, H[unknown] / scale, atol=1e-6 * scale[unknown])


@pytest.mark.parametrize("damping", [0.0, 0.1, 10.0])
def test_a_step_solves_the_damped_equations_of_cameras_and_boards_together(damping: float) -> None:
    corners, truth = scene(3)
    free = poses_free()
    free[:, [6, 7, 10]] = True  # and a part of the lenses
    corners = replace(corners, pixel=corners.pixel + np.random.default_rng(3).normal(0, 1.0, corners.pixel.shape))
    problem = _Problem(corners, free, np.array([True, False, True]), no_prior(), 0.5)
    normal = _normal_equations(problem, truth)
    H, right = whole(normal, damping)
    scale = 1 / np.sqrt(np.diag(H))
    expected = moved(truth, scale * np.linalg.solve(H * np.outer(scale, scale), scale * right))
    found = _step(problem, truth, normal, damping)
    for name in ("T_camera_world", "lenses", "T_world_board"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-8)


def test_a_cost_is_that_of_errors_in_units_of_the_noise() -> None:
    corners, truth = scene(2)
    off = np.random.default_rng(4).normal(0, 2.0, corners.pixel.shape)
    costs = [
        _cost(
            _Problem(
                replace(corners, pixel=corners.pixel + k * off), poses_free(), np.ones(2, np.bool_), no_prior(), k
            ),
            truth,
        )
        for k in (0.1, 1.0, 5.0)
    ]
    np.testing.assert_allclose(costs, costs[1], rtol=1e-9)


def test_exact_corners_give_exact_cameras_and_boards_from_a_start_that_is_far_off() -> None:
    corners, truth = scene(6)
    rng = np.random.default_rng(5)
    start = Bundle(
        np.stack([truth.T_camera_world[0], exp_twist(rng.uniform(-0.2, 0.2, 6)) @ truth.T_camera_world[1]]),
        truth.lenses, truth.T_world_board @ exp_twist(rng.uniform(-0.3, 0.3, (6, 6))),
    )  # fmt: skip
    found = adjust(corners, start, poses_free(), np.ones(6, np.bool_), no_prior())
    np.testing.assert_allclose(found.bundle.T_camera_world, truth.T_camera_world, atol=1e-7)
    np.testing.assert_allclose(found.bundle.T_world_board, truth.T_world_board, atol=1e-7)


def test_noise_and_uncertainty_are_right_though_the_unknowns_absorb_a_quarter_of_the_noise() -> None:
    """Errors are normal and of one size here: the covariance is nearly that of least squares, and views agree."""
    sd_px, boards = 0.3, 60
    corners, truth = scene(boards)
    noisy = replace(corners, pixel=corners.pixel + np.random.default_rng(6).normal(0, sd_px, corners.pixel.shape))
    found = adjust(noisy, truth, poses_free(), np.ones(boards, np.bool_), no_prior())
    assert found.sigma_px == pytest.approx(sd_px, rel=0.07)
    assert found.dispersion == pytest.approx(1.0, abs=0.15)
    H, _ = whole(
        _normal_equations(_Problem(corners, poses_free(), np.ones(boards, np.bool_), no_prior(), sd_px), truth)
    )
    best = np.diag(np.linalg.inv(H))[CAMERA : CAMERA + 6]
    ratio = np.diagonal(found.covariance[1, :, 1])[POSE] / best
    assert (ratio > 0.9).all()
    assert (ratio < 1.35).all()
    assert not found.covariance[0].any()


def test_one_camera_alone_disagrees_with_nobody() -> None:
    corners, truth = scene(5, cameras=1)
    noisy = replace(corners, pixel=corners.pixel + np.random.default_rng(7).normal(0, 0.3, corners.pixel.shape))
    free = np.zeros((1, CAMERA), np.bool_)
    free[0, 6:8] = True
    found = adjust(noisy, truth, free, np.ones(5, np.bool_), no_prior(1))
    assert found.dispersion == 1.0
    assert 0 < found.covariance[0, 6, 0, 6] < 100.0


def test_views_of_a_few_boards_disagree_by_as_much_as_those_of_many() -> None:
    """Per number of the views' poses that is left, which is a third of these with three boards.

    The copies are one error, of which the unknowns take a tenth. What is left of it is compared with what they do.
    """
    times, found = 10, []
    grid = np.array([[x, y, 0.0] for x in np.linspace(-0.2, 0.2, 5) for y in np.linspace(-0.1, 0.1, 4)])
    for seed in range(5):
        corners, truth = scene(3, grid=grid, seed=seed)
        off = np.random.default_rng(seed).normal(0, 0.2, corners.pixel.shape)
        order = np.arange(len(corners.board)).reshape(-1, len(grid)).repeat(times, axis=0).ravel()
        often = Corners(
            corners.camera[order], corners.board[order], corners.corner_m[order], (corners.pixel + off)[order]
        )
        found.append(adjust(often, truth, poses_free(), np.ones(3, np.bool_), no_prior()).dispersion)
    absorbed = 24 / (2 * len(corners.pixel))
    assert np.mean(found) == pytest.approx(times / (1 - absorbed), rel=0.3)
