"""Uncertainty of an estimated time map and rigid motion.

`motion_fit` explains the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.comparison.estimating_equations import PIECES, Equations

Float64 = NDArray[np.float64]


class Deviations(NamedTuple):
    """Deviations of each sensor's results from all sensors' results.

    Attributes:
        shares: each sensor's share of the results.
        positions: (times, joints, 3) of each sensor, in the recording's axes; NaN where unknown [m].
    """

    shares: tuple[float, ...]
    positions: tuple[Float64, ...]


LONGEST_CORRELATION_S: Final = 2.0
"""Longest time over which residuals are taken for correlated [s]; larger: uncertainties of short recordings scatter."""
UNCORRELATED: Final = 0.05
"""Correlation below which residuals are taken for uncorrelated."""
REACH: Final = 3
"""Reach of the kernel in times of that lag."""


def standard_deviations(
    found: Equations, free: NDArray[np.bool_], sensors: Sequence[Deviations], step_s: float
) -> Float64:
    """Return the standard deviations (8,) of the offset, the drift, the rotation and the centre's position.

    Args:
        found: the equations at the estimate.
        free: (8,) which are estimated.
        sensors: deviations of each side whose results are of several sensors.
        step_s: step of the equations' times [s].
    """
    inner = np.ix_(free, free)
    inverse = np.zeros((8, 8))
    inverse[inner] = np.linalg.pinv(found.H[inner])
    correlation = _autocorrelation(found, step_s)
    by_joints = inverse @ _covariance_by_joints(found, correlation) @ inverse.T
    biases = inverse @ _of_biases(found, REACH * (len(correlation) - 1)) @ inverse.T
    variance = np.maximum(np.diag(by_joints), _by_pieces(found, free)) + np.diag(biases)
    of_sensors = sum((_of_sensors(found, free, one) for one in sensors), np.zeros(8))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + of_sensors))


def _by_pieces(found: Equations, free: NDArray[np.bool_]) -> Float64:
    """Return the variances (8,) by the jackknife: the estimate without each piece of the common time."""
    inner = np.ix_(free, free)
    out = np.zeros(8)
    numbers = np.unique(found.pieces[found.pieces >= 0])
    for piece in numbers.tolist():
        terms = found.terms[found.pieces == piece].sum(axis=0)[free]
        out[free] += np.linalg.lstsq((found.H - found.H_pieces[piece])[inner], terms, rcond=1e-12)[0] ** 2
    return out * (len(numbers) - 1) / len(numbers)


def _of_sensors(found: Equations, free: NDArray[np.bool_], sensors: Deviations) -> Float64:
    """Return the variances (8,) between the estimates that each sensor's results alone would give.

    The mean over the sensors stands for all; what the scatter of the pieces explains is noise, and does not count.
    """
    estimates, noise = [], []
    inner = np.ix_(free, free)
    for deviations in sensors.positions:
        A, g = np.zeros((PIECES, 8, 8)), np.zeros((PIECES, 8))
        for joint in np.flatnonzero(found.weight.any(axis=0)).tolist():
            known = np.isfinite(deviations[:, joint]).all(axis=1) & (found.weight[:, joint] > 0)
            Z, w = found.columns_of(joint)[known], found.weight[known, joint, None, None]
            at = found.pieces[known]
            np.add.at(A, at, np.swapaxes(w * Z, 1, 2) @ Z)
            np.add.at(g, at, np.einsum("tca,tc->ta", w * Z, deviations[known, joint]))
        inverse = np.zeros((8, 8))
        inverse[inner] = np.linalg.pinv(A.sum(axis=0)[inner])
        estimate = inverse @ g.sum(axis=0)
        rest = (g - A @ estimate) @ inverse.T
        estimates.append(estimate)
        noise.append((rest**2).sum(axis=0) * PIECES / (PIECES - 1))
    share = np.array(sensors.shares)[:, None]
    mean = (share * estimates).sum(axis=0) / share.sum()
    between = (share * (estimates - mean) ** 2).sum(axis=0)
    return np.asarray(np.maximum(0.0, between - (share * (1.0 - share) * noise).sum(axis=0)))


def _covariance_of_sum(g: Float64, lags: int) -> Float64:
    """Return the covariance of a sum of correlated terms (times, n) about their mean, by Bartlett's kernel."""
    own = g - g.mean(axis=0)
    out = own.T @ own
    for lag in range(1, min(len(g) // 4, lags) + 1):
        cross = own[lag:].T @ own[:-lag]
        out += (1.0 - lag / (lags + 1)) * (cross + cross.T)
    return np.asarray(out)


def _autocorrelation(found: Equations, step_s: float) -> Float64:
    """Return the autocorrelation of all residuals about each joint's mean, from lag 0 until it is nearly 0."""
    mass = np.maximum(found.weight.sum(axis=0), 1e-30)[:, None]
    mean = np.einsum("tj,tjc->jc", found.weight, found.e) / mass
    own = np.sqrt(found.weight)[..., None] * np.where((found.weight > 0)[..., None], found.e - mean, 0.0)
    own = own.reshape(len(own), -1)
    variance = max(float(np.einsum("ta,ta->", own, own)), 1e-30)
    out = [1.0]
    for lag in range(1, max(1, min(len(own) // 4, round(LONGEST_CORRELATION_S / step_s))) + 1):
        out.append(float(np.einsum("ta,ta->", own[lag:], own[:-lag])) / variance)
        if out[-1] < UNCORRELATED:
            break
    return np.array(out)


def _covariance_by_joints(found: Equations, correlation: Float64) -> Float64:
    """Return the covariance of Zᵀ W e (8, 8) if residuals of two joints are independent, and correlated over time."""
    out = np.zeros((8, 8))
    for joint in np.flatnonzero(found.weight.any(axis=0)).tolist():
        known = found.weight[:, joint] > 0
        scores = found.weight[known, joint, None] * found.e[known, joint]
        variance = float(np.mean((scores - scores.mean(axis=0)) ** 2))
        Z = found.columns_of(joint).reshape(len(known), -1)
        shape = (len(known), 3, 8)
        summed = correlation[0] * Z
        for lag in range(1, min(len(correlation), len(Z))):
            summed[lag:] += correlation[lag] * Z[:-lag]
            summed[:-lag] += correlation[lag] * Z[lag:]
        out += variance * np.einsum("tca,tcb->ab", Z.reshape(shape), summed.reshape(shape), optimize=True)
    return out


def _of_biases(found: Equations, lags: int) -> Float64:
    """Return the covariance of the estimating equations by constant distances between the two's joints."""
    mass = found.weight.sum(axis=0)
    seen = np.flatnonzero(mass > 0)
    freedoms = 3 * len(seen) - 6
    if freedoms <= 0:
        return np.zeros((8, 8))
    mean = np.einsum("tj,tjc->jc", found.weight[:, seen], found.e[:, seen]) / mass[seen, None]
    noise = [
        np.trace(_covariance_of_sum(found.weight[:, j, None] * (found.e[:, j] - own), lags)) / mass[j] ** 2
        for j, own in zip(seen, mean, strict=True)
    ]
    variance = max(0.0, float((mean**2).sum() / freedoms - np.mean(noise) / 3))
    return np.asarray(variance * np.einsum("jca,jcb->ab", found.sums, found.sums))
