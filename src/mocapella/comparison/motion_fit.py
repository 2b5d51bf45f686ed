"""Estimate the time map and the rigid motion between two recordings of one motion, jointly, with their uncertainty.

A joint of the recording at time t, x(t), and of the reference at time s, y(s), agree where

    s = s₀ + δ + r (1 + ρ) (t − t₀)        x(t) = R y(s) + p + noise

The unknowns are the offset δ at the middle t₀ of the common time, the drift ρ, and the rigid motion (R, p). They are
found by Newton's method on estimating equations Zᵀ W e = 0 with the residuals e. Z has the derivatives of the model,
but for the two columns of time:

* Velocities are noisy, which would make their squares, and so the information, too large. Those of the less noisy side
  stand in Z, the other side's in the model's derivatives: their noises are independent (J. Durbin, Rev. Int. Stat.
  Inst. 22, 1954). The less noisy side is chosen because position and velocity
  of one side, from samples at uneven times, have correlated noises, which shift the time by their product.
* Each joint's mean velocity is subtracted, so a constant distance between a marker and a joint centre, whatever its
  size, does not move the time.

Weights W are robust (S. Geman, D. McClure, 1987), with a scale for each joint. The covariance is that of estimating
equations (P. Huber, *Robust Statistics*, 1981, section 6.3), with the residuals' autocorrelation: once with joints
independent of each other, which needs little motion, and once from the sums over all joints by the kernel of W.
Newey and K. West (Econometrica 55, 1987, 703); the larger counts. Constant distances of joints count as errors of the
rigid motion that do not average out over time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.comparison.lag_search import RoughTime
from mocapella.comparison.smooth_paths import SmoothPaths
from mocapella.geometry.alignment import robust_align, robust_weights
from mocapella.geometry.rigid import apply

Float64 = NDArray[np.float64]

ROUNDS: Final = 30
QUICK_ROUNDS: Final = 6
QUICK_TIMES: Final = 300
SCALE: Final = 3.0
"""Scale of the robust loss, in robust standard deviations of a joint's residuals; larger: fewer outliers left out."""
_LEAST_SCALE_M: Final = 5e-4
LONGEST_CORRELATION_S: Final = 2.0
"""Longest time over which residuals are taken for correlated [s]; larger: uncertainties of short recordings scatter."""
UNCORRELATED: Final = 0.05
"""Correlation below which residuals are taken for uncorrelated."""
REACH: Final = 3
"""Reach of the kernel in times of that lag."""
DRIFT_KNOWN: Final = 5e-3
"""Two clocks that are stated differ by less than this; an estimate that is less certain is not made."""
OFFSET_KNOWN_S: Final = 0.25
"""Standard deviation beyond which an offset is not observable [s]."""
LEAST_COMMON: Final = 6.0
"""Least agreement of the velocities for an observable time, in standard deviations of random velocities."""
MEDIAN_OF_CHI: Final = 1.5382
"""Median of the length of a vector of three standard normal numbers."""
_ROWS: Final = 256
"""Number of times whose derivatives are computed at once, so that memory stays small."""
_FEWEST: Final = 8
"""Least number of common times of a fit."""


@dataclass(frozen=True, eq=False)
class TimeAndMotion:
    """Time map and rigid motion from the reference to the recording.

    Attributes:
        middle_s: middle of the common time, t₀, on the recording's clock [s].
        reference_middle_s: the reference's time at it, s₀ + δ [s].
        ratio: seconds of the reference in a second of the recording, r (1 + ρ).
        T: (4, 4) rigid motion from the reference's coordinates to the recording's [m].
        offset_sd_s: standard deviation of ``reference_middle_s``; infinite if not observable [s].
        ratio_sd: relative standard deviation of the ratio; infinite if not observable.
        rotation_sd: (3,) standard deviations of the rotation about the recording's axes [rad].
        translation_sd_m: (3,) standard deviations of the position of the motion's centre [m].
        centre_m: (3,) the centre, in the recording's coordinates [m].
        drift_estimated: whether the clocks' ratio is estimated, and not taken as stated.
        common_s: length of the common time [s].
        explained: share of the joints' motion that the fit explains, 1 for all of it.
    """

    middle_s: float
    reference_middle_s: float
    ratio: float
    T: Float64
    offset_sd_s: float
    ratio_sd: float
    rotation_sd: Float64
    translation_sd_m: Float64
    centre_m: Float64
    drift_estimated: bool
    common_s: float
    explained: float

    def reference_s(self, times_s: Float64) -> Float64:
        """Return the reference's times at times of the recording [s]."""
        return np.asarray(self.reference_middle_s + self.ratio * (times_s - self.middle_s))

    @property
    def shift_s(self) -> float:
        """Time of the reference at the recording's time 0 [s]."""
        return self.reference_middle_s - self.ratio * self.middle_s

    @property
    def time_observable(self) -> bool:
        """Whether the motion determines the offset of the clocks."""
        return math.isfinite(self.offset_sd_s)


class _Sides(NamedTuple):
    """Both sides: times, positions and velocities of the recording at them, the reference, and which is less noisy."""

    at: Float64
    ours: tuple[Float64, Float64]
    theirs: SmoothPaths
    ours_quieter: bool


@dataclass(eq=False)
class _State:
    """A time map and rigid motion during the iteration."""

    middle: float
    at: float
    ratio: float
    T: Float64


@dataclass(frozen=True, eq=False)
class _Equations:
    """The estimating equations at a state.

    Attributes:
        e: (times, joints, 3) residuals; 0 where unknown [m].
        weight: (times, joints) weights; 0 where unknown.
        terms: (times, 8) Zᵀ W e at each time.
        sums: (joints, 3, 8) Zᵀ W of each joint.
        H: (8, 8) derivative of Zᵀ W e.
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


def fit(
    ours: SmoothPaths, theirs: SmoothPaths, rough: RoughTime, *, drift: bool, time: bool = True, quick: bool = False
) -> TimeAndMotion | None:
    """Estimate the time map and the rigid motion from a rough time; None if too little is common there.

    Args:
        ours, theirs: paths of the same joints, each on its own clock.
        rough: where to begin.
        drift: whether the ratio of the clocks is estimated; otherwise it is ``rough.ratio``.
        time: whether the offset is estimated, too; otherwise it is that of ``rough``.
        quick: whether some times and few rounds suffice, to choose between rough times.
    """
    at = ours.times_s[:: 2 if len(ours.times_s) > 64 else 1]
    at = at[:: max(1, len(at) // QUICK_TIMES)] if quick else at
    sides = _Sides(at, ours.at(at), theirs, ours.noise_m < theirs.noise_m)
    state = _begin(sides, rough)
    if state is None:
        return None
    scales: Float64 | None = None
    equations = None
    free = np.array([time, time and drift, *[True] * 6])
    for turn in range(QUICK_ROUNDS if quick else ROUNDS):
        equations, scales = _equations(sides, state, free, scales)
        if equations is None:
            return None
        step = equations.step
        step[:2] = np.clip(step[:2], [-0.1, -0.02], [0.1, 0.02])
        state = _State(
            state.middle, state.at + step[0] * state.ratio, state.ratio * (1 + step[1]),
            _turned(state.T, step[2:5], step[5:], equations.centre),
        )  # fmt: skip
        if turn > 3 and abs(step[0]) < 1e-7 and np.abs(step[1:]).max() < 1e-8:
            break
    assert equations is not None
    return _result(sides, state, equations, free)


def _begin(sides: _Sides, rough: RoughTime) -> _State | None:
    at, x = sides.at, sides.ours[0]
    y, _ = sides.theirs.at(rough.ratio * at + rough.shift_s)
    common = np.all(np.isfinite(x) & np.isfinite(y), axis=2)
    frames = np.flatnonzero(common.any(axis=1))
    if len(frames) < _FEWEST:
        return None
    middle = float(at[frames[[0, -1]]].mean())
    some = frames[:: max(1, len(frames) // 200)]
    T = robust_align(x[some].reshape(-1, 3), y[some].reshape(-1, 3), scale=0.02, iterations=10)
    if not np.isfinite(T).all():
        return None
    return _State(middle, rough.ratio * middle + rough.shift_s, rough.ratio, T)


def _turned(T: Float64, turn: Float64, shift: Float64, centre: Float64) -> Float64:
    R = Rotation.from_rotvec(turn).as_matrix()
    out = np.eye(4)
    out[:3, :3] = R @ T[:3, :3]
    out[:3, 3] = R @ (T[:3, 3] - centre) + centre + shift
    return out


def _equations(
    sides: _Sides, state: _State, free: NDArray[np.bool_], scales: Float64 | None
) -> tuple[_Equations | None, Float64]:
    """Return the equations, None if too little is known, and the scale of each joint's residuals (joints,) [m]."""
    at, (x, v_x) = sides.at, sides.ours
    y, v_y = sides.theirs.at(state.at + state.ratio * (at - state.middle))
    y, v_y = apply(state.T, y), state.ratio * (v_y @ state.T[:3, :3].T)
    known = np.all(np.isfinite(x), axis=2) & np.all(np.isfinite(y), axis=2)
    if known.any(axis=1).sum() < _FEWEST:
        return None, np.ones(x.shape[1])
    y, v_x, v_y, e = (np.where(known[..., None], one, 0.0) for one in (y, v_x, v_y, x - y))
    size = np.linalg.norm(e, axis=2)
    found = np.array([np.median(one[k]) / MEDIAN_OF_CHI if k.any() else 1.0
                      for one, k in zip(size.T, known.T, strict=True)])  # fmt: skip
    found = np.maximum(found, _LEAST_SCALE_M)
    scales = found if scales is None else 0.5 * (scales + found)  # damped: scales and weights would chase each other
    robust = robust_weights(size / scales, "geman-mcclure", SCALE * math.sqrt(3.0))
    weight = np.where(known, robust / scales**2, 0.0)
    slope = weight * np.maximum(0.0, 1.0 - 4.0 / 3.0 * (1.0 - np.sqrt(robust)))  # of w e, over all directions of e
    centre = np.einsum("tj,tjc->c", weight, y) / weight.sum()
    dt = at - state.middle
    quiet, other = (v_x, v_y) if sides.ours_quieter else (v_y, v_x)
    mean = np.stack([np.einsum("t,tj,tjc->jc", dt**power, weight, quiet) for power in (0, 1)], axis=-1)
    mean /= np.maximum(weight.sum(axis=0), 1e-30)[:, None, None]
    H, sums = np.zeros((8, 8)), np.zeros((x.shape[1], 3, 8))
    terms, common = np.empty((len(at), 8)), 0.0
    for begin in range(0, len(at), _ROWS):
        rows = slice(begin, begin + _ROWS)
        w, dw = (np.repeat(one[rows].reshape(-1), 3) for one in (weight, slope))
        B = _motion_columns(y[rows] - centre)
        Z = np.hstack([_flat(_time_columns(dt[rows], quiet[rows]) - mean), B])
        J = np.hstack([_flat(_time_columns(dt[rows], other[rows])), B])
        H += (Z * dw[:, None]).T @ J
        Z *= w[:, None]
        common += float(Z[:, 0] @ J[:, 0])
        terms[rows] = (Z * e[rows].reshape(-1, 1)).reshape(len(w) // (3 * e.shape[1]), -1, 8).sum(axis=1)
        sums += Z.reshape(-1, *e.shape[1:], 8).sum(axis=0)
    unlike = math.sqrt(2.0 / 3.0 * float(np.einsum("tj,tjc,tjd->", weight**2, v_x**2, v_y**2)))
    step, inner = np.zeros(8), np.ix_(free, free)
    step[free] = np.linalg.lstsq(H[inner], terms.sum(axis=0)[free], rcond=1e-12)[0]
    return _Equations(
        e, weight, terms, sums, H, step, centre, y - centre, quiet, mean, dt, common / max(unlike, 1e-30)
    ), scales


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


def _covariance_of_sum(g: Float64, lags: int) -> Float64:
    """Return the covariance of a sum of correlated terms (times, n) about their mean, by Bartlett's kernel."""
    own = g - g.mean(axis=0)
    out = own.T @ own
    for lag in range(1, min(len(g) // 4, lags) + 1):
        cross = own[lag:].T @ own[:-lag]
        out += (1.0 - lag / (lags + 1)) * (cross + cross.T)
    return np.asarray(out)


def _autocorrelation(found: _Equations, step_s: float) -> Float64:
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


def _covariance_by_joints(found: _Equations, correlation: Float64) -> Float64:
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


def _result(sides: _Sides, state: _State, found: _Equations, free: NDArray[np.bool_]) -> TimeAndMotion:
    at, x = sides.at, sides.ours[0]
    used = found.weight > 0
    frames = np.flatnonzero(used.any(axis=1))
    common_s = float(at[frames[-1]] - at[frames[0]])
    inner = np.ix_(free, free)
    inverse = np.zeros((8, 8))
    inverse[inner] = np.linalg.pinv(found.H[inner])
    rows = slice(frames[0], frames[-1] + 1)
    correlation = _autocorrelation(found, float(at[1] - at[0]))
    lags = REACH * (len(correlation) - 1)
    biases = _of_biases(found, lags)
    both = [
        inverse @ (S + biases) @ inverse.T
        for S in (_covariance_of_sum(found.terms[rows], lags), _covariance_by_joints(found, correlation))
    ]
    sd = np.sqrt(np.maximum(np.maximum(*(np.diag(one) for one in both)), 0.0))
    offset_sd, ratio_sd = (float(sd[k]) if free[k] else math.inf for k in range(2))
    if found.common < LEAST_COMMON or not offset_sd <= OFFSET_KNOWN_S:
        offset_sd = ratio_sd = math.inf
    moving = np.where(used[..., None], x, np.nan)
    mass = np.maximum(found.weight.sum(axis=0), 1e-30)[:, None]
    parts = [np.nan_to_num(one - np.einsum("tj,tjc->jc", found.weight, np.nan_to_num(one)) / mass)
             for one in (moving, np.where(used[..., None], found.e, np.nan))]  # fmt: skip
    squares = [np.einsum("tj,tjc,tjc->", found.weight, one, one) for one in parts]
    return TimeAndMotion(
        state.middle, state.at, state.ratio, state.T, offset_sd, ratio_sd, sd[2:5], sd[5:], found.centre,
        bool(free[1]), common_s, float(1.0 - squares[1] / max(squares[0], 1e-30)),
    )  # fmt: skip


def _of_biases(found: _Equations, lags: int) -> Float64:
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


def without_time(found: TimeAndMotion) -> TimeAndMotion:
    """Return a result whose time is marked as not observable."""
    return replace(found, offset_sd_s=math.inf, ratio_sd=math.inf)
