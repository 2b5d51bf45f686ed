"""Bundle adjustment of cameras and boards: all lenses, camera poses and board poses together, from all corners.

Source: B. Triggs et al., *Bundle Adjustment – A Modern Synthesis* (2000): Levenberg–Marquardt steps (section 4), boards
eliminated first (6.1, Schur complement), outer robust loss (3.3: Cauchy), gauge fixed by holding one frame (9.1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.lens_jacobian import project_with_jacobian
from mocapella.geometry.twists import exp_twist

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

CAMERA: Final = 15
"""Number of parameters of a camera: a small motion in its own frame (translation, rotation), then the lens."""
POSE: Final = slice(0, 6)
LENS: Final = slice(6, 15)
CAUCHY: Final = 3.0
"""Scale of the Cauchy loss, in standard deviations: a corner this far off counts half."""
LEAST_SIGMA_PX: Final = 1e-4
"""Lower bound of the noise level; for exact simulated corners sums would overflow without it."""
SETTLED: Final = 1e-4
"""Decrease of the cost, in squared standard deviations of the noise, at or below which the search ends."""
STEPS: Final = 60
"""Most Levenberg–Marquardt steps at one noise level; about ten are needed."""
ROUNDS: Final = 12
"""Most estimates of the noise level; about four are needed."""


@dataclass(frozen=True)
class Corners:
    """The corners of all views; the corners of one view are consecutive.

    Attributes:
        camera: (n,) index of the camera.
        board: (n,) index of the board pose.
        corner_m: (n, 3) corners in the board's frame [m].
        pixel: (n, 2) detected corners [px].
    """

    camera: Int64
    board: Int64
    corner_m: Float64
    pixel: Float64


@dataclass(frozen=True)
class Bundle:
    """Parameters of the bundle adjustment: cameras and boards.

    Attributes:
        T_camera_world: (cameras, 4, 4).
        lenses: (cameras, 9) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_world_board: (boards, 4, 4).
    """

    T_camera_world: Float64
    lenses: Float64
    T_world_board: Float64


@dataclass(frozen=True)
class LensPrior:
    """Prior of the lenses; coefficients that the images do not determine stay near it.

    Attributes:
        mean: (cameras, 9) typical coefficients.
        precision: (cameras, 9, 9) inverse covariances.
    """

    mean: Float64
    precision: Float64


@dataclass(frozen=True)
class Adjusted:
    """Result of the adjustment.

    Attributes:
        bundle: adjusted cameras and boards.
        residual_px: (n, 2) measured minus projected corners [px].
        sigma_px: robust standard deviation of a corner's coordinate [px].
        dispersion: variance of whole views' errors relative to that of single corners; 1 or more.
        covariance: (cameras, 15, cameras, 15) covariance of all cameras' parameters, as `CAMERA` describes;
            0 for fixed ones.
    """

    bundle: Bundle
    residual_px: Float64
    sigma_px: float
    dispersion: float
    covariance: Float64


@dataclass(frozen=True)
class _Problem:
    """The constants of one minimisation."""

    corners: Corners
    free: Bool
    free_boards: Bool
    prior: LensPrior
    sigma: float


def adjust(corners: Corners, start: Bundle, free: Bool, free_boards: Bool, prior: LensPrior) -> Adjusted:
    """Minimise the reprojection error from ``start``, alternating with estimates of the noise level.

    A camera's or a board's pose must be fixed, because a motion of everything does not change the error.

    Args:
        corners: the n corners of all views.
        start: initial parameters, near the minimum.
        free: (cameras, 15) whether each parameter is estimated.
        free_boards: (boards,) whether each board pose is estimated.
        prior: prior of the lenses.

    Returns:
        The minimum that was found; its residuals show whether it is good.
    """
    unknown = int(free.sum() + 6 * free_boards.sum())
    spare = min(0.9, unknown / corners.pixel.size)
    problem = _Problem(corners, free, free_boards, prior, _sigma(_residual(corners, start), 0.0))
    bundle = start
    for _ in range(ROUNDS):
        bundle = _descend(problem, bundle)
        sigma = _sigma(_residual(corners, bundle), spare)
        settled = abs(sigma - problem.sigma) <= 0.01 * sigma
        problem = replace(problem, sigma=sigma)
        if settled:
            break
    return Adjusted(bundle, _residual(corners, bundle), problem.sigma, *_covariance(problem, bundle, spare))


def _sigma(residual: Float64, spare: float) -> float:
    """Return the noise of a coordinate from the median distance (of χ² with two degrees of freedom: 2 ln 2).

    ``spare`` is the fraction of the residuals that the unknowns absorb.
    """
    r2 = (residual**2).sum(axis=1)
    return max(LEAST_SIGMA_PX, float(np.sqrt(np.median(r2) / (2 * np.log(2)) / (1 - spare))))


def _expected(corners: Corners, bundle: Bundle) -> tuple[Float64, Float64, Float64, Float64, Float64]:
    """Return points in the cameras' frames, pixels, both derivatives of these, and ``R_camera_board``."""
    first = _begins(corners)
    T = bundle.T_camera_world[corners.camera[first]] @ bundle.T_world_board[corners.board[first]]
    T = np.repeat(T, np.diff(np.r_[first, len(corners.board)]), axis=0)
    p_camera = (T[:, :3, :3] @ corners.corner_m[:, :, None])[:, :, 0] + T[:, :3, 3]
    return p_camera, *project_with_jacobian(p_camera, bundle.lenses[corners.camera]), T[:, :3, :3]


def _begins(corners: Corners) -> Int64:
    """Return the index of each view's first corner."""
    changes = (np.diff(corners.camera) != 0) | (np.diff(corners.board) != 0)
    return np.flatnonzero(np.r_[True, changes])


def _residual(corners: Corners, bundle: Bundle) -> Float64:
    """Return measured minus projected pixels; a corner behind a camera gets a huge residual."""
    return np.nan_to_num(corners.pixel - _expected(corners, bundle)[1], nan=1e6)


def _cost(problem: _Problem, bundle: Bundle) -> float:
    r2 = (_residual(problem.corners, bundle) ** 2).sum(axis=1) / problem.sigma**2
    off = bundle.lenses - problem.prior.mean
    prior = np.einsum("ci,cij,cj", off, problem.prior.precision, off)
    return float(CAUCHY**2 * np.log1p(r2 / CAUCHY**2).sum() + prior)


def _descend(problem: _Problem, bundle: Bundle) -> Bundle:
    """Run Levenberg–Marquardt at one noise level."""
    damping = 1e-4
    cost = _cost(problem, bundle)
    for _ in range(STEPS):
        normal = _normal_equations(problem, bundle)
        while damping < 1e8:
            tried = _step(problem, bundle, normal, damping)
            tried_cost = _cost(problem, tried)
            if tried_cost <= cost:
                break
            damping *= 10
        else:
            return bundle
        bundle, gain, cost = tried, cost - tried_cost, tried_cost
        damping = max(damping / 10, 1e-12)
        if gain <= SETTLED:
            return bundle
    return bundle


@dataclass(frozen=True)
class _Normal:
    """JᵀWJ and JᵀWr in blocks; fixed parameters have rows of the identity.

    Attributes:
        cameras: (15 cameras, 15 cameras).
        boards: (boards, 6, 6).
        mixed: (15 cameras, boards, 6).
        of_cameras, of_boards: right-hand sides.
        pulls: (views, 6), (views, 6, 6) right-hand side and matrix of each single view, for its board.
    """

    cameras: Float64
    boards: Float64
    mixed: Float64
    of_cameras: Float64
    of_boards: Float64
    pulls: tuple[Float64, Float64]


def _normal_equations(problem: _Problem, bundle: Bundle) -> _Normal:
    corners, free, free_boards = problem.corners, problem.free, problem.free_boards
    cameras, boards = len(bundle.lenses), len(bundle.T_world_board)
    p_camera, pixel, by_point, by_lens, R = _expected(corners, bundle)
    residual = corners.pixel - pixel
    weight = 1.0 / (1.0 + (residual**2).sum(axis=1) / (CAUCHY * problem.sigma) ** 2)
    by_board = by_point @ R
    J = np.concatenate(
        [by_point, -by_point @ cross_matrix(p_camera), by_lens, by_board, -by_board @ cross_matrix(corners.corner_m)],
        axis=-1,
    )  # the motions are exp(x) T_camera_world and T_world_board exp(x)
    J /= problem.sigma
    Hcc, Hcb = np.zeros((cameras, CAMERA, CAMERA)), np.zeros((cameras, CAMERA, boards, 6))
    Hbb, gc, gb = np.zeros((boards, 6, 6)), np.zeros((cameras, CAMERA)), np.zeros((boards, 6))
    begins = _begins(corners)
    pulls = np.zeros((len(begins), 6)), np.zeros((len(begins), 6, 6))
    for view, (begin, end) in enumerate(zip(begins, np.r_[begins[1:], len(pixel)], strict=True)):
        c, b, some = corners.camera[begin], corners.board[begin], slice(begin, end)
        j = J[some].reshape(-1, CAMERA + 6)
        jw = j * np.repeat(weight[some], 2)[:, None]
        H, g = jw.T @ j, jw.T @ (residual[some].ravel() / problem.sigma)
        pulls[0][view], pulls[1][view] = g[CAMERA:], H[CAMERA:, CAMERA:]
        mine, theirs = free[c], np.repeat(free_boards[b], 6)
        Hcc[c] += H[:CAMERA, :CAMERA] * np.outer(mine, mine)
        Hcb[c, :, b] += H[:CAMERA, CAMERA:] * np.outer(mine, theirs)
        Hbb[b] += H[CAMERA:, CAMERA:] * np.outer(theirs, theirs)
        gc[c] += g[:CAMERA] * mine
        gb[b] += g[CAMERA:] * theirs
    lens_free, prior = free[:, LENS], problem.prior
    Hcc[:, LENS, LENS] += np.where(lens_free[:, :, None] & lens_free[:, None, :], prior.precision, 0.0)
    gc[:, LENS] -= np.where(lens_free, np.einsum("cij,cj->ci", prior.precision, bundle.lenses - prior.mean), 0.0)
    Hcc += np.einsum("ci,ij->cij", ~free, np.eye(CAMERA))
    Hbb += np.einsum("b,ij->bij", ~free_boards, np.eye(6))
    whole = np.zeros((cameras, CAMERA, cameras, CAMERA))
    whole[np.arange(cameras), :, np.arange(cameras)] = Hcc
    size = cameras * CAMERA
    return _Normal(whole.reshape(size, size), Hbb, Hcb.reshape(size, boards, 6), gc.ravel(), gb, pulls)


def _reduced(normal: _Normal, damping: float) -> tuple[Float64, Float64, Float64, Float64]:
    """Eliminate the boards, damped by the diagonal (Marquardt).

    Returns:
        The cameras' equations, scaled, because squares of pixels and radians differ by 10⁶; the scale; the inverse of
        the boards' equations; and (boards, 6, 15 cameras) their product with the mixed block.
    """
    size = len(normal.cameras)
    boards = np.asarray(np.linalg.inv(normal.boards * (1 + damping * np.eye(6))), dtype=np.float64)
    solved = boards @ np.moveaxis(normal.mixed, 0, -1)
    S = normal.cameras * (1 + damping * np.eye(size)) - normal.mixed.reshape(size, -1) @ solved.reshape(-1, size)
    scale = 1.0 / np.sqrt(np.diag(normal.cameras))
    return np.asarray(S * np.outer(scale, scale)), scale, boards, solved


def _step(problem: _Problem, bundle: Bundle, normal: _Normal, damping: float) -> Bundle:
    S, scale, boards, solved = _reduced(normal, damping)
    of_boards = (boards @ normal.of_boards[..., None])[..., 0]
    right = normal.of_cameras - normal.mixed.reshape(len(S), -1) @ of_boards.ravel()
    x = scale * np.linalg.lstsq(S, scale * right, rcond=1e-14)[0]
    y = of_boards - solved @ x
    x = np.where(problem.free, x.reshape(-1, CAMERA), 0.0)
    return Bundle(
        exp_twist(x[:, POSE]) @ bundle.T_camera_world,
        bundle.lenses + x[:, LENS],
        bundle.T_world_board @ exp_twist(y),
    )


def _covariance(problem: _Problem, bundle: Bundle, spare: float) -> tuple[float, Float64]:
    """Return the dispersion, and the covariance of an M-estimator: E[ψ²]/E[ψ']² (JᵀJ)⁻¹ (Huber 1981, 7.6).

    Cameras that are not triggered together see a moving board at slightly different times, so the errors of a view's
    corners are correlated. The views' disagreement about their board's pose gives the dispersion.
    """
    cameras = len(bundle.lenses)
    normal = _normal_equations(problem, bundle)
    S, scale, _, _ = _reduced(normal, 0.0)
    inverse_S = np.linalg.pinv(S, rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    r2 = (_residual(problem.corners, bundle) ** 2).sum(axis=1) / problem.sigma**2
    weight = 1.0 / (1.0 + r2 / CAUCHY**2)
    slope = weight - r2 / CAUCHY**2 * weight**2  # the mean of ψ' along and across the residual
    of_corner = 0.5 * (weight**2 * r2).mean() / (1 - spare)  # E[ψ²] of a coordinate
    of_view, H_view = normal.pulls
    # Disagreement of each view about its board's pose: 6 per view if all were free and errors independent.
    pull = float(np.einsum("vi,vij,vj", of_view, np.linalg.pinv(H_view, hermitian=True), of_view))
    free_views = 6 * len(of_view) - 6 * int(problem.free_boards.sum()) - int(problem.free[:, POSE].sum())
    dispersion = 1.0
    if free_views > 0:
        dispersion = max(1.0, pull / free_views * weight.mean() / of_corner)
    free = problem.free.ravel()
    variance = of_corner / slope.mean() ** 2 * weight.mean() * dispersion
    covariance = np.where(free[:, None] & free, variance * inverse_S, 0.0)
    return float(dispersion), covariance.reshape(cameras, CAMERA, cameras, CAMERA)
