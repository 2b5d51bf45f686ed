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

Weights W are robust (S. Geman, D. McClure, 1987), with a scale for each joint, whose least value shrinks from round to
round (A. Blake, A. Zisserman, *Visual Reconstruction*, 1987): what rests most of the time and then moves would
be left out as an outlier while the time is rough.

The variance has four parts, which add up:

* noise: that of estimating equations (P. Huber, *Robust Statistics*, 1981, section 6.3) with joints independent of each
  other and the residuals' autocorrelation, which needs little motion; or that of the jackknife over pieces of the
  common time (H. Künsch, Ann. Stat. 17, 1989, 1217), which sees slow and common errors. The larger counts.
* constant distances of joints, as errors of the rigid motion that do not average out over time.
* sensors: each sensor's results alone give another time and motion, by its own lag and bias. An export of a take
  at a constant rate may have been made of one sensor's results, so their variance counts whole.
* interpolation between samples, as an error of the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.comparison.estimating_equations import FEWEST, LEAST_SCALE_M, Equations, Sides, State, equations
from mocapella.comparison.fit_uncertainty import Deviations, standard_deviations
from mocapella.comparison.lag_search import RoughTime
from mocapella.comparison.smooth_paths import SensorPaths, SmoothPaths
from mocapella.geometry.alignment import robust_align

Float64 = NDArray[np.float64]

ROUNDS: Final = 30
QUICK_ROUNDS: Final = 6
QUICK_TIMES: Final = 300
FIRST_SCALE_M: Final = 0.03
"""Least scale of residuals in the first round; larger: rougher times are corrected [m]."""
SHRINKS: Final = 0.7
"""Factor of the least scale from round to round; larger: more rounds."""
CONVERGED: Final = 1e-7
"""Largest last step of the iteration: nothing is known better [s, rad, m]."""
INTERPOLATED: Final = 0.006
"""Error of the time by interpolation between samples, in steps of the smooth paths; it does not average out."""
SHORTEST_COMMON_S: Final = 0.1
DRIFT_KNOWN: Final = 5e-3
"""Two clocks that are stated differ by less than this; an estimate that is less certain is not made."""
OFFSET_KNOWN_S: Final = 0.25
"""Standard deviation beyond which an offset is not observable [s]."""
LEAST_COMMON: Final = 6.0
"""Least agreement of the velocities for an observable time, in standard deviations of random velocities."""


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
        clock_held, space_held: whether the time map, or the rigid motion, was held and not estimated.
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
    clock_held: bool = False
    space_held: bool = False

    def reference_s(self, times_s: Float64) -> Float64:
        """Return the reference's times at times of the recording [s]."""
        return np.asarray(self.ratio * times_s + self.shift_s)

    @property
    def shift_s(self) -> float:
        """Time of the reference at the recording's time 0 [s]."""
        return self.reference_middle_s - self.ratio * self.middle_s

    @property
    def time_observable(self) -> bool:
        """Whether the motion determines the offset of the clocks."""
        return math.isfinite(self.offset_sd_s)


def fit(
    ours: SmoothPaths,
    theirs: SmoothPaths,
    rough: RoughTime,
    *,
    drift: bool,
    time: bool = True,
    space: bool = True,
    quick: bool = False,
    sensors: Sequence[Sequence[SensorPaths]] = (),
) -> TimeAndMotion | None:
    """Estimate the time map and the rigid motion from a rough time; None if too little is common there.

    Args:
        ours, theirs: paths of the same joints, each on its own clock.
        rough: where to begin.
        drift: whether the ratio of the clocks is estimated; otherwise it is ``rough.ratio``.
        time: whether the offset is estimated, too; otherwise it is that of ``rough``.
        space: whether the rigid motion is estimated; otherwise both are in the same coordinates.
        quick: whether some times and few rounds suffice, to choose between rough times.
        sensors: paths by each sensor's results of the recording, and of the reference; empty if unknown.
    """
    at = ours.times_s[:: 2 if len(ours.times_s) > 64 else 1]
    at = at[:: max(1, len(at) // QUICK_TIMES)] if quick else at
    sides = Sides(at, ours.at(at), theirs, ours.noise_m < theirs.noise_m)
    state = _begin(sides, rough, space)
    if state is None:
        return None
    scales: Float64 | None = None
    at_state = None
    free = np.array([time, time and drift, *[space] * 6])
    for turn in range(QUICK_ROUNDS if quick else ROUNDS):
        least_m = max(LEAST_SCALE_M, FIRST_SCALE_M * SHRINKS**turn)
        at_state, scales = equations(sides, state, free, scales, least_m)
        if at_state is None:
            return None
        step = at_state.step
        step[:2] = np.clip(step[:2], [-0.1, -0.02], [0.1, 0.02])
        state = State(
            state.middle, state.at + step[0] * state.ratio, state.ratio * (1 + step[1]),
            _turned(state.T, step[2:5], step[5:], at_state.centre),
        )  # fmt: skip
        if least_m == LEAST_SCALE_M and np.abs(step).max() < CONVERGED:
            break
    assert at_state is not None
    return _result(sides, state, at_state, free, _deviations(sides, state, sensors))


def _deviations(sides: Sides, state: State, sensors: Sequence[Sequence[SensorPaths]]) -> list[Deviations]:
    """Return the deviations of each side's sensors in the recording's axes, of sides that have several."""
    times = sides.at, state.at + state.ratio * (sides.at - state.middle)
    turns = np.eye(3), state.T[:3, :3]
    return [
        Deviations(tuple(path.share for path in own), tuple(path.deviations(at) @ R.T for path in own))
        for own, at, R in zip(sensors, times, turns, strict=False) if own
    ]  # fmt: skip


def _begin(sides: Sides, rough: RoughTime, space: bool) -> State | None:
    at, x = sides.at, sides.ours[0]
    y, _ = sides.theirs.at(rough.ratio * at + rough.shift_s)
    common = np.all(np.isfinite(x) & np.isfinite(y), axis=2)
    frames = np.flatnonzero(common.any(axis=1))
    if len(frames) < FEWEST:
        return None
    middle = float(at[frames[[0, -1]]].mean())
    if not space:
        return State(middle, rough.ratio * middle + rough.shift_s, rough.ratio, np.eye(4))
    some = frames[:: max(1, len(frames) // 200)]
    T = robust_align(x[some].reshape(-1, 3), y[some].reshape(-1, 3), scale=0.02, iterations=10)
    if not np.isfinite(T).all():
        return None
    return State(middle, rough.ratio * middle + rough.shift_s, rough.ratio, T)


def _turned(T: Float64, turn: Float64, shift: Float64, centre: Float64) -> Float64:
    R = Rotation.from_rotvec(turn).as_matrix()
    out = np.eye(4)
    out[:3, :3] = R @ T[:3, :3]
    out[:3, 3] = R @ (T[:3, 3] - centre) + centre + shift
    return out


def _result(
    sides: Sides, state: State, found: Equations, free: NDArray[np.bool_], sensors: Sequence[Deviations]
) -> TimeAndMotion:
    at, x = sides.at, sides.ours[0]
    used = found.weight > 0
    frames = np.flatnonzero(used.any(axis=1))
    common_s = float(at[frames[-1]] - at[frames[0]])
    sd = np.hypot(standard_deviations(found, free, sensors, float(at[1] - at[0])), CONVERGED)
    between_s = INTERPOLATED * sides.theirs.step_s
    sd[:2] = np.hypot(sd[:2], [between_s, math.sqrt(12.0) * between_s / max(common_s, SHORTEST_COMMON_S)])
    sd[2:] *= free[2:]
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
        bool(free[1]), common_s, float(1.0 - squares[1] / max(squares[0], 1e-30)), space_held=not free[2:].any(),
    )  # fmt: skip


def without_time(found: TimeAndMotion) -> TimeAndMotion:
    """Return a result whose time is marked as not observable."""
    return replace(found, offset_sd_s=math.inf, ratio_sd=math.inf)
