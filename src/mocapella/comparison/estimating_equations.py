"""Estimating equations of the time map and the rigid motion: residuals, weights, and derivatives of the model.

`motion_fit` explains the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.comparison.smooth_paths import SmoothPaths
from mocapella.geometry.alignment import robust_weights
from mocapella.geometry.rigid import apply

Float64 = NDArray[np.float64]

SCALE: Final = 3.0
"""Scale of the robust loss, in robust standard deviations of a joint's residuals; larger: fewer outliers left out."""
LEAST_SCALE_M: Final = 5e-4
"""Least robust standard deviation of a joint's residuals [m]; larger: fewer outliers left out."""
MEDIAN_OF_CHI: Final = 1.5382
"""Median of the length of a vector of three standard normal numbers."""
_ROWS: Final = 256
"""Number of times whose derivatives are computed at once, so that memory stays small."""
FEWEST: Final = 8
"""Least number of common times of a fit."""
PIECES: Final = 12
"""Number of pieces of the common time whose estimates are compared."""


class Sides(NamedTuple):
    """Both sides: times, positions and velocities of the recording at them, the reference, and which is less noisy."""

    at: Float64
    ours: tuple[Float64, Float64]
    theirs: SmoothPaths
    ours_quieter: bool


@dataclass(eq=False)
class State:
    """A time map and rigid motion during the iteration."""

    middle: float
    at: float
    ratio: float
    T: Float64


@dataclass(frozen=True, eq=False)
class Equations:
    """The estimating equations at a state.

    Attributes:
        e: (times, joints, 3) residuals; 0 where unknown [m].
        weight: (times, joints) weights; 0 where unknown.
        terms: (times, 8) Zᵀ W e at each time.
        sums: (joints, 3, 8) Zᵀ W of each joint.
        H: (8, 8) derivative of Zᵀ W e.
        pieces: (times,) number of the piece of the common time, 0 to `PIECES` − 1; −1 outside.
        H_pieces: (pieces, 8, 8) derivative of each piece's terms.
        step: (8,) Newton's step.
        centre: (3,) weighted centre [m].
        y: (times, joints, 3) the reference's positions about the centre, 0 where unknown [m].
        quiet, mean: (times, joints, 3) the velocities of the less noisy side, and (joints, 3, 2) the mean of their
            columns of time.
        dt: (times,) times about the middle [s].
        common: sum of the products of the two velocities, in standard deviations that it would have if they were
            unlike and random.
    """

    e: Float64
    weight: Float64
    terms: Float64
    sums: Float64
    H: Float64
    pieces: NDArray[np.int64]
    H_pieces: Float64
    step: Float64
    centre: Float64
    y: Float64
    quiet: Float64
    mean: Float64
    dt: Float64
    common: float

    def columns_of(self, joint: int) -> Float64:
        """Return Z of a joint (times, 3, 8); 0 where it is unknown."""
        one = [joint]
        time = _flat(_time_columns(self.dt, self.quiet[:, one]) - self.mean[one])
        Z = np.hstack([time, _motion_columns(self.y[:, one])]).reshape(-1, 3, 8)
        return np.where((self.weight[:, joint] > 0)[:, None, None], Z, 0.0)


def equations(
    sides: Sides, state: State, free: NDArray[np.bool_], scales: Float64 | None, least_m: float
) -> tuple[Equations | None, Float64]:
    """Return the equations, None if too little is known, and the scale of each joint's residuals (joints,) [m].

    Args:
        sides: both sides.
        state: where the equations are made.
        free: (8,) whether each parameter is estimated.
        scales: (joints,) the scales of the round before; None in the first one [m].
        least_m: least scale; large while the time may be wrong, or what moves would be left out as outliers [m].
    """
    at, (x, v_x) = sides.at, sides.ours
    y, v_y = sides.theirs.at(state.at + state.ratio * (at - state.middle))
    y, v_y = apply(state.T, y), state.ratio * (v_y @ state.T[:3, :3].T)
    known = np.all(np.isfinite(x), axis=2) & np.all(np.isfinite(y), axis=2)
    if known.any(axis=1).sum() < FEWEST:
        return None, np.ones(x.shape[1])
    y, v_x, v_y, e = (np.where(known[..., None], one, 0.0) for one in (y, v_x, v_y, x - y))
    size = np.linalg.norm(e, axis=2)
    found = np.array([np.median(one[k]) / MEDIAN_OF_CHI if k.any() else 1.0
                      for one, k in zip(size.T, known.T, strict=True)])  # fmt: skip
    found = np.maximum(found, least_m)
    scales = found if scales is None else 0.5 * (scales + found)  # damped: scales and weights would chase each other
    robust = robust_weights(size / scales, "geman-mcclure", SCALE * math.sqrt(3.0))
    weight = np.where(known, robust / scales**2, 0.0)
    slope = weight * np.maximum(0.0, 1.0 - 4.0 / 3.0 * (1.0 - np.sqrt(robust)))  # of w e, over all directions of e
    centre = np.einsum("tj,tjc->c", weight, y) / weight.sum()
    dt = at - state.middle
    quiet, other = (v_x, v_y) if sides.ours_quieter else (v_y, v_x)
    mean = np.stack([np.einsum("t,tj,tjc->jc", dt**power, weight, quiet) for power in (0, 1)], axis=-1)
    mean /= np.maximum(weight.sum(axis=0), 1e-30)[:, None, None]
    H, sums = np.zeros((PIECES, 8, 8)), np.zeros((x.shape[1], 3, 8))
    terms, common = np.zeros((len(at), 8)), 0.0
    pieces = _pieces(known.any(axis=1))
    for rows in _chunks(pieces):
        w, dw = (np.repeat(one[rows].reshape(-1), 3) for one in (weight, slope))
        B = _motion_columns(y[rows] - centre)
        Z = np.hstack([_flat(_time_columns(dt[rows], quiet[rows]) - mean), B])
        J = np.hstack([_flat(_time_columns(dt[rows], other[rows])), B])
        H[pieces[rows.start]] += (Z * dw[:, None]).T @ J
        Z *= w[:, None]
        common += float(Z[:, 0] @ J[:, 0])
        terms[rows] = (Z * e[rows].reshape(-1, 1)).reshape(len(w) // (3 * e.shape[1]), -1, 8).sum(axis=1)
        sums += Z.reshape(-1, *e.shape[1:], 8).sum(axis=0)
    unlike = math.sqrt(2.0 / 3.0 * float(np.einsum("tj,tjc,tjd->", weight**2, v_x**2, v_y**2)))
    step, inner = np.zeros(8), np.ix_(free, free)
    whole = H.sum(axis=0)
    if free.any():
        step[free] = np.linalg.lstsq(whole[inner], terms.sum(axis=0)[free], rcond=1e-12)[0]
    return Equations(
        e, weight, terms, sums, whole, pieces, H, step, centre, y - centre, quiet, mean, dt, common / max(unlike, 1e-30)
    ), scales


def _pieces(used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number of each time's piece, from the first used time to the last one; −1 outside."""
    first, last = np.flatnonzero(used)[[0, -1]]
    out = np.full(len(used), -1)
    out[first : last + 1] = np.arange(last + 1 - first) * PIECES // (last + 1 - first)
    return out


def _chunks(pieces: NDArray[np.int64]) -> Iterator[slice]:
    """Return slices of at most `_ROWS` times, each in one piece."""
    for piece in np.unique(pieces[pieces >= 0]).tolist():
        first, last = np.flatnonzero(pieces == piece)[[0, -1]].tolist()
        for begin in range(first, last + 1, _ROWS):
            yield slice(begin, min(begin + _ROWS, last + 1))


def _time_columns(dt: Float64, v: Float64) -> Float64:
    """Return the derivatives (times, joints, 3, 2) of R y(s) + p for the offset and the drift."""
    return np.stack([v, v * dt[:, None, None]], axis=-1)


def _motion_columns(y: Float64) -> Float64:
    """Return its derivatives (times · joints · 3, 6) for the turn about the three axes and the shift."""
    B = np.zeros((*y.shape, 6))
    x, y_, z = np.moveaxis(y, -1, 0)
    B[..., 1, 0], B[..., 2, 0] = -z, y_
    B[..., 0, 1], B[..., 2, 1] = z, -x
    B[..., 0, 2], B[..., 1, 2] = -y_, x
    B[..., range(3), range(3, 6)] = 1.0
    return _flat(B)


def _flat(columns: Float64) -> Float64:
    return columns.reshape(-1, columns.shape[-1])
