"""Bundle adjustment of cameras and boards: all lenses, places and board poses at once, from all corners.

Source: B. Triggs et al., *Bundle Adjustment – A Modern Synthesis* (2000): Levenberg–Marquardt steps (section 4), boards
eliminated first (6.1, Schur complement), outer robust loss (3.3: Cauchy), gauge by holding one space still (9.1).
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
"""Parameters of a camera: a small motion in its own space (translation, rotation), then the lens."""
POSE: Final = slice(0, 6)
LENS: Final = slice(6, 15)
CAUCHY: Final = 3.0
"""A corner that is off by so many standard deviations counts half."""
LEAST_SIGMA_PX: Final = 1e-4
"""Exact corners, of a simulation, would have priors count for nothing and sums overflow."""
STEPS: Final = 60
"""Levenberg–Marquardt steps for one noise level; about ten are needed."""
ROUNDS: Final = 12
"""Estimates of the noise level; about four are needed."""


@dataclass(frozen=True)
class Corners:
    """All corners of all views, those of one view side by side.

    Attributes:
        camera: (n,) index.
        board: (n,) index of the board's pose.
        corner_m: (n, 3) in the board's space.
        pixel: (n, 2).
    """

    camera: Int64
    board: Int64
    corner_m: Float64
    pixel: Float64


@dataclass(frozen=True)
class Bundle:
    """Cameras and boards.

    Attributes:
        T_camera_world: (cameras, 4, 4).
        lenses: (cameras, 9).
        T_world_board: (boards, 4, 4).
    """

    T_camera_world: Float64
    lenses: Float64
    T_world_board: Float64


@dataclass(frozen=True)
class LensPrior:
    """What is known of lenses before any picture; what pictures do not determine stays there.

    Attributes:
        mean: (cameras, 9).
        precision: (cameras, 9, 9).
    """

    mean: Float64
    precision: Float64


@dataclass(frozen=True)
class Adjusted:
    """The least cost.

    Attributes:
        bundle: see there.
        residual_px: (n, 2) seen minus expected.
        sigma_px: standard deviation of a coordinate, robust.
        covariance: (cameras, 15, 15) of each camera's parameters; 0 of those that were held.
    """

    bundle: Bundle
    residual_px: Float64
    sigma_px: float
    covariance: Float64


def adjust(corners: Corners, start: Bundle, free: Bool, free_boards: Bool, prior: LensPrior) -> Adjusted:
    """Search from ``start``; in turns with the noise level, which says what an outlier is.

    Args:
        corners: n of them.
        start: not far from the least cost.
        free: (cameras, 15) the parameters that are searched for.
        free_boards: (boards,) those whose pose is.
        prior: of the lenses.

    Returns:
        the least cost that was found. Its residuals say whether it is any good.
    """
    bundle = start
    residual = _residual(corners, bundle)
    sigma = _sigma(residual, 0.0)
    unknown = int(free.sum() + 6 * free_boards.sum())
    spare = min(0.9, unknown / residual.size)
    for _ in range(ROUNDS):
        bundle = _descend(corners, bundle, free, free_boards, prior, sigma)
        residual = _residual(corners, bundle)
        before, sigma = sigma, _sigma(residual, spare)
        if abs(sigma - before) <= 0.01 * sigma:
            break
    covariance = _covariance(corners, bundle, free, free_boards, prior, sigma, spare)
    return Adjusted(bundle, residual, sigma, covariance)


def _sigma(residual: Float64, spare: float) -> float:
    """Of a coordinate, by the median of the distances (of χ² with two degrees of freedom: 2 ln 2).

    ``spare`` is the share of the residuals that the unknowns have swallowed.
    """
    r2 = (residual**2).sum(axis=1)
    return max(LEAST_SIGMA_PX, float(np.sqrt(np.median(r2) / (2 * np.log(2)) / (1 - spare))))


def _expected(corners: Corners, bundle: Bundle) -> tuple[Float64, Float64, Float64, Float64]:
    """Points in the cameras' spaces, pixels, and both derivatives of these."""
    p_world = _move(bundle.T_world_board[corners.board], corners.corner_m)
    p_camera = _move(bundle.T_camera_world[corners.camera], p_world)
    return p_camera, *project_with_jacobian(p_camera, bundle.lenses[corners.camera])


def _move(T: Float64, points: Float64) -> Float64:
    return np.asarray((T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3])


def _residual(corners: Corners, bundle: Bundle) -> Float64:
    """A corner behind a camera is as far off as could be."""
    return np.nan_to_num(corners.pixel - _expected(corners, bundle)[1], nan=1e6)


def _cost(residual: Float64, bundle: Bundle, prior: LensPrior, sigma: float) -> float:
    r2 = (residual**2).sum(axis=1) / sigma**2
    off = bundle.lenses - prior.mean
    return float(CAUCHY**2 * np.log1p(r2 / CAUCHY**2).sum() + np.einsum("ci,cij,cj", off, prior.precision, off))


def _descend(
    corners: Corners, bundle: Bundle, free: Bool, free_boards: Bool, prior: LensPrior, sigma: float
) -> Bundle:
    """Levenberg–Marquardt with one noise level."""
    damping = 1e-4
    cost = _cost(_residual(corners, bundle), bundle, prior, sigma)
    for _ in range(STEPS):
        normal = _normal_equations(corners, bundle, free, free_boards, prior, sigma)
        while damping < 1e8:
            tried = _step(bundle, normal, free, damping)
            tried_cost = _cost(_residual(corners, tried), tried, prior, sigma)
            if tried_cost <= cost:
                break
            damping *= 10
        else:
            return bundle
        bundle, gain, cost = tried, cost - tried_cost, tried_cost
        damping = max(damping / 10, 1e-12)
        if gain <= 1e-10 * cost + 1e-12:
            return bundle
    return bundle


@dataclass(frozen=True)
class _Normal:
    """JᵀWJ and JᵀWr in blocks; the rows of what is held are those of the unit matrix.

    Attributes:
        cameras: (15 cameras, 15 cameras).
        boards: (boards, 6, 6).
        mixed: (15 cameras, boards, 6).
        of_cameras, of_boards: the right sides.
    """

    cameras: Float64
    boards: Float64
    mixed: Float64
    of_cameras: Float64
    of_boards: Float64


def _normal_equations(
    corners: Corners, bundle: Bundle, free: Bool, free_boards: Bool, prior: LensPrior, sigma: float
) -> _Normal:
    cameras, boards = len(bundle.lenses), len(bundle.T_world_board)
    p_camera, pixel, by_point, by_lens = _expected(corners, bundle)
    residual = corners.pixel - pixel
    weight = 1.0 / (1.0 + (residual**2).sum(axis=1) / (CAUCHY * sigma) ** 2)
    R = (bundle.T_camera_world[corners.camera] @ bundle.T_world_board[corners.board])[:, :3, :3]
    by_board = by_point @ R
    J = np.concatenate(
        [by_point, -by_point @ cross_matrix(p_camera), by_lens, by_board, -by_board @ cross_matrix(corners.corner_m)],
        axis=-1,
    )  # the motions are exp(x) T_camera_world and T_world_board exp(x)
    held = np.concatenate(
        [~free[corners.camera], np.repeat(~free_boards[corners.board], 6).reshape(-1, 6)], axis=1
    )  # fmt: skip
    J = np.where(held[:, None], 0.0, J) / sigma
    Hcc, Hcb = np.zeros((cameras, CAMERA, CAMERA)), np.zeros((cameras, CAMERA, boards, 6))
    Hbb, gc, gb = np.zeros((boards, 6, 6)), np.zeros((cameras, CAMERA)), np.zeros((boards, 6))
    begins = np.flatnonzero(np.r_[True, np.diff(corners.camera * boards + corners.board) != 0])
    for begin, end in zip(begins, np.r_[begins[1:], len(pixel)], strict=True):
        c, b, some = corners.camera[begin], corners.board[begin], slice(begin, end)
        j = J[some].reshape(-1, CAMERA + 6)
        jw = j * np.repeat(weight[some], 2)[:, None]
        H, g = jw.T @ j, jw.T @ (residual[some].ravel() / sigma)
        Hcc[c] += H[:CAMERA, :CAMERA]
        Hcb[c, :, b] += H[:CAMERA, CAMERA:]
        Hbb[b] += H[CAMERA:, CAMERA:]
        gc[c] += g[:CAMERA]
        gb[b] += g[CAMERA:]
    lens_free = free[:, LENS]
    Hcc[:, LENS, LENS] += np.where(lens_free[:, :, None] & lens_free[:, None, :], prior.precision, 0.0)
    gc[:, LENS] -= np.where(lens_free, np.einsum("cij,cj->ci", prior.precision, bundle.lenses - prior.mean), 0.0)
    Hcc += np.einsum("ci,ij->cij", ~free, np.eye(CAMERA))
    Hbb += np.einsum("b,ij->bij", ~free_boards, np.eye(6))
    whole = np.zeros((cameras, CAMERA, cameras, CAMERA))
    whole[np.arange(cameras), :, np.arange(cameras)] = Hcc
    size = cameras * CAMERA
    return _Normal(whole.reshape(size, size), Hbb, Hcb.reshape(size, boards, 6), gc.ravel(), gb)


def _step(bundle: Bundle, normal: _Normal, free: Bool, damping: float) -> Bundle:
    """Marquardt's damping by the diagonal, the boards eliminated."""
    cameras = len(bundle.lenses)
    boards = normal.boards * (1 + damping * np.eye(6))
    size = len(normal.cameras)
    solved = np.linalg.solve(boards, np.moveaxis(normal.mixed, 0, -1))  # (boards, 6, size)
    S = normal.cameras * (1 + damping * np.eye(size))
    S -= normal.mixed.reshape(size, -1) @ solved.reshape(-1, size)
    of_boards = np.linalg.solve(boards, normal.of_boards[..., None])[..., 0]
    right = normal.of_cameras - normal.mixed.reshape(size, -1) @ of_boards.ravel()
    scale = 1.0 / np.sqrt(np.diag(normal.cameras))  # px and rad differ by 10⁶ in their squares
    x = scale * np.linalg.lstsq(S * np.outer(scale, scale), scale * right, rcond=1e-14)[0]
    y = of_boards - solved @ x
    x = np.where(free, x.reshape(cameras, CAMERA), 0.0)
    return replace(
        bundle,
        T_camera_world=exp_twist(x[:, POSE]) @ bundle.T_camera_world,
        lenses=bundle.lenses + x[:, LENS],
        T_world_board=bundle.T_world_board @ exp_twist(y),
    )


def _covariance(
    corners: Corners, bundle: Bundle, free: Bool, free_boards: Bool, prior: LensPrior, sigma: float, spare: float
) -> Float64:
    """Of an M-estimator with independent, equal errors: E[ψ²]/E[ψ']² (JᵀJ)⁻¹ (Huber 1981, 7.6), marginal per camera."""
    cameras = len(bundle.lenses)
    normal = _normal_equations(corners, bundle, free, free_boards, prior, sigma)
    size = len(normal.cameras)
    solved = np.linalg.solve(normal.boards, np.moveaxis(normal.mixed, 0, -1))
    S = normal.cameras - normal.mixed.reshape(size, -1) @ solved.reshape(-1, size)
    scale = 1.0 / np.sqrt(np.diag(normal.cameras))
    inverse = np.linalg.pinv(S * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    r2 = (_residual(corners, bundle) ** 2).sum(axis=1) / sigma**2
    weight = 1.0 / (1.0 + r2 / CAUCHY**2)
    slope = weight - r2 / CAUCHY**2 * weight**2  # the mean of ψ' along and across the residual
    factor = 0.5 * (weight**2 * r2).mean() * weight.mean() / slope.mean() ** 2 / (1 - spare)
    blocks = inverse.reshape(cameras, CAMERA, cameras, CAMERA)[np.arange(cameras), :, np.arange(cameras)]
    return np.where(free[:, :, None] & free[:, None, :], factor * blocks, 0.0)
