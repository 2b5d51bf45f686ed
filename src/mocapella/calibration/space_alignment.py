"""Align another tracker's space with the cameras' world, from one object that both track in motion.

A marker that the cameras see is fixed on the body that the other tracker follows, at an unknown position, and the two
clocks differ. At the times t of the cameras

    p(t) = T_world_space (b(t + δ) + R(t + δ) l) + noise

with b and R the body's pose in the space, l the marker's position on it (the lever arm), δ the delay of the poses.

Initial values: solved for b, R_space_world p + t_space_world − R l = b is linear in the twelve numbers of the motion
and in l (the robot-world and hand-eye problem with points instead of a second pose: H. Zhuang, Z. Roth, R. Sudhakar,
IEEE Trans. Robotics and Automation 10(4) (1994) 549; R. Tsai, R. Lenz, ibid. 5(3) (1989) 345); the motion is brought
back to a rotation as in S. Umeyama (1991). It is solved for equally spaced delays; the one with the least error is the
start. Then Gauss–Newton over everything together, with Huber's weights. Standard deviations are from the scatter of
half-second blocks (K.-Y. Liang, S. Zeger, Biometrika 73 (1986) 13), as errors of neighbouring frames are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import CalibrationError
from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.settings import check

Float64 = NDArray[np.float64]

_BLOCK_S: Final = 0.5
_LEAST_BLOCKS: Final = 8
_DELAY_STEP_S: Final = 0.02
_ROUNDS: Final = 30
_MEDIAN_OF_CHI: Final = 1.5382
"""Median length of a vector of three standard normal numbers."""


@dataclass(frozen=True)
class SpaceAlignmentSettings:
    """Parameters of the estimation, and required accuracy.

    Attributes:
        vertical: both spaces have y up, which leaves one angle of rotation.
        delay_within_s: largest delay in either direction [s].
        longest_gap_s: largest gap between poses that is interpolated [s].
        least_instants: least number of simultaneous observations.
        least_space_m: least motion of the marker: standard deviation along its second principal axis [m].
        least_turn_rad: least rotation of the body about two axes, as a standard deviation [rad].
        largest_residual_m: above this residual it is not the same rigid object [m].
        largest_sd_m: largest standard deviation of a point, and of the lever arm [m].
        largest_sd_rad: largest standard deviation of the rotation [rad].
        largest_delay_sd_s: largest standard deviation of the delay [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    vertical: bool = False
    delay_within_s: float = 0.3
    longest_gap_s: float = 0.1
    least_instants: int = 60
    least_space_m: float = 0.04
    least_turn_rad: float = 0.15
    largest_residual_m: float = 0.02
    largest_sd_m: float = 0.01
    largest_sd_rad: float = 0.03
    largest_delay_sd_s: float = 0.015

    def __post_init__(self) -> None:
        check(0 <= self.delay_within_s <= 5, "delay_within_s", self.delay_within_s, "from 0 to 5 s")
        check(self.least_instants >= 10, "least_instants", self.least_instants, "10 or more")
        above = (
            *("longest_gap_s", "least_space_m", "least_turn_rad", "largest_residual_m", "largest_sd_m"),
            *("largest_sd_rad", "largest_delay_sd_s"),
        )
        for name in above:
            check(0 < getattr(self, name) < 1e3, name, getattr(self, name), "above 0")


class SpaceFit(msgspec.Struct, frozen=True, eq=False):
    """An alignment and its quality.

    Attributes:
        T_world_space: (4, 4) from the other tracker's space to the cameras' world.
        lever_m: (points, 3) the markers in the body's frame [m].
        delay_s: delay δ of the poses [s].
        position_sd_m: standard deviation of a point in the region where the object was moved [m].
        rotation_sd_rad: standard deviation of the rotation about an axis [rad].
        lever_sd_m: largest standard deviation of a marker's coordinate in the body's frame [m].
        delay_sd_s: standard deviation of the delay [s].
        residual_m: standard deviation of an inlier's coordinate [m].
        instants: number of simultaneous observations.
        left_out: number of outliers among them.
        turn_rad, space_m: rotation and motion of the object, as in `SpaceAlignmentSettings` [rad], [m].
    """

    T_world_space: Float64
    lever_m: Float64
    delay_s: float
    position_sd_m: float
    rotation_sd_rad: float
    lever_sd_m: float
    delay_sd_s: float
    residual_m: float
    instants: int
    left_out: int
    turn_rad: float
    space_m: float


class Shortfall(NamedTuple):
    """A missing requirement of an alignment: the problem, measured and required amount, and advice to the user."""

    problem: str
    measured: str
    advice: str

    def __str__(self) -> str:
        return f"{self.problem}: {self.measured}: {self.advice}"


def align_space(
    at_s: Any, points: Any, poses_s: Any, T_space_body: Any, settings: SpaceAlignmentSettings | None = None
) -> SpaceFit:
    """Estimate the pose of another tracker's space in the cameras' world.

    Args:
        at_s: (instants,) capture times of the cameras [s].
        points: (instants, points, 3) of one or more markers on the object, world [m]; NaN where not known.
        poses_s: (poses,) increasing times of the other tracker's poses, on the same clock except for the delay [s].
        T_space_body: (poses, 4, 4) the object's body in that space.
        settings: parameters and required accuracy; None for the defaults.

    Returns:
        The alignment, which fulfils all requirements.

    Raises:
        CalibrationError: too few simultaneous observations, too little motion or rotation, not one rigid object, or too
            uncertain; says what to do.
    """
    fit, missing = try_to_align(at_s, points, poses_s, T_space_body, settings)
    if missing:
        raise CalibrationError(str(missing[0]))
    assert fit is not None
    return fit


def try_to_align(
    at_s: Any, points: Any, poses_s: Any, T_space_body: Any, settings: SpaceAlignmentSettings | None = None
) -> tuple[SpaceFit | None, tuple[Shortfall, ...]]:
    """Estimate the alignment as far as possible, and list its shortfalls, for guidance while the object is moved.

    Args:
        at_s, points, poses_s, T_space_body, settings: (instants,) [s], (instants, points, 3) [m], (poses,) [s] and
            (poses, 4, 4), as in `align_space`.

    Returns:
        The alignment, None if the observations do not suffice for one; and the requirements that are not met. If there
        are none of these, the alignment is accurate enough.
    """
    s = settings or SpaceAlignmentSettings()
    t, p = np.asarray(at_s, dtype=np.float64), np.asarray(points, dtype=np.float64)
    track = _Track(np.asarray(poses_s, dtype=np.float64), np.asarray(T_space_body, dtype=np.float64), s.longest_gap_s)
    known = np.isfinite(p).all(axis=(1, 2)) & np.isfinite(t)
    t, p = t[known], p[known]
    shared = track.at(t)[3] if len(t) else np.zeros(0, dtype=np.bool_)
    missing = []
    blocks = len(np.unique(np.floor(t[shared] / _BLOCK_S)))
    if shared.sum() < s.least_instants or blocks < _LEAST_BLOCKS:
        missing.append(
            Shortfall(
                "too few shared instants",
                f"at {int(shared.sum())}, in {blocks * _BLOCK_S:g} s, both trackers know where it is; "
                f"{s.least_instants} in {_LEAST_BLOCKS * _BLOCK_S:g} s are wanted",
                "move it for 20 s where the cameras and the other tracker see it",
            )
        )
    if shared.sum() < 2:
        return None, tuple(missing)
    space_m = _spread(p[shared, 0], s.vertical)
    if space_m < s.least_space_m:
        missing.append(
            Shortfall(
                "too small a space",
                f"it was moved by {100 * space_m:.1f} cm across its main direction, {100 * s.least_space_m:.0f} cm are "
                "wanted",
                "move it through all of the space that the cameras see",
            )
        )
    turn_rad, other_rad, axis = _turning(track.at(t[shared])[0])
    if turn_rad < s.least_turn_rad:
        about = f"[{', '.join(f'{x:.1f}' for x in np.round(axis, 1) + 0.0)}]"
        only = f", mostly about the body's axis {about}" if other_rad >= s.least_turn_rad else ""
        missing.append(
            Shortfall(
                "too little rotation to know the lever arm",
                f"it was turned by {math.degrees(turn_rad):.1f}° about its second axis{only}, "
                f"{math.degrees(s.least_turn_rad):.0f}° are wanted (as standard deviations)",
                "tilt and turn it about two axes at least while you move it",
            )
        )
    if missing:
        return None, tuple(missing)
    start = _start(t, p, track, s)
    if start is None:
        return None, (Shortfall("too few shared instants", "at every delay", "move it for 20 s without hiding it"),)
    fit = _refined(t, p, track, start, s, moved=(turn_rad, space_m))
    return fit, tuple(_shortfalls(fit, s))


class _Track:
    """Poses with interpolation."""

    def __init__(self, times: Float64, T: Float64, longest_gap_s: float) -> None:
        self.times, self.T, self._gap = times, T, longest_gap_s
        if len(times) > 1:
            between = T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], -1, -2)
            self.turns = log_motion(rigid(between, np.zeros(3)))[:, 3:]
            self.spans = np.maximum(np.diff(times), 1e-9)

    def at(self, t: Float64) -> tuple[Float64, Float64, Float64, NDArray[np.bool_], Float64]:
        """Return R, b, velocity, whether known, and angular velocity, at times (n,)."""
        if len(self.times) < 2:
            zero = np.zeros((len(t), 3))
            return np.zeros((len(t), 3, 3)), zero, zero, np.zeros(len(t), dtype=np.bool_), zero
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        part = (t - self.times[i]) / self.spans[i]
        known = (part >= 0) & (part <= 1) & (self.spans[i] <= self._gap)
        part = np.clip(part, 0, 1)[:, None]
        R = exp_twist(np.concatenate([np.zeros((len(t), 3)), part * self.turns[i]], axis=1))[:, :3, :3]
        step = self.T[i + 1, :3, 3] - self.T[i, :3, 3]
        return (
            R @ self.T[i, :3, :3], self.T[i, :3, 3] + part * step, step / self.spans[i, None], known,
            self.turns[i] / self.spans[i, None],
        )  # fmt: skip


def _spread(p: Float64, vertical: bool) -> float:
    """Return the standard deviation of positions (n, 3) along principal axis 2; if ``vertical``, horizontal axis 1."""
    centred = (p - p.mean(axis=0))[:, [0, 2] if vertical else [0, 1, 2]]
    return float(np.linalg.svd(centred, compute_uv=False)[0 if vertical else 1] / math.sqrt(len(p)))


def _turning(R: Float64) -> tuple[float, float, Float64]:
    """Return the motion of the direction that rotations (n, 3, 3) move least [rad], of the next, and that direction."""
    off = R - R.mean(axis=0)
    squares, axes = np.linalg.eigh(np.einsum("kij,kil->jl", off, off) / len(R))
    least, next_ = np.sqrt(np.maximum(squares[:2], 0.0))
    axis = axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0])
    return float(least), float(next_), axis


def _start(t: Float64, p: Float64, track: _Track, s: SpaceAlignmentSettings) -> tuple[Float64, Float64, float] | None:
    """Return T_world_space, lever arms and delay by linear least squares at each delay; None without observations."""
    best: tuple[float, Float64, Float64, float] | None = None
    for delay in np.arange(-s.delay_within_s, s.delay_within_s + 0.5 * _DELAY_STEP_S, _DELAY_STEP_S):
        R, b, _, known, _ = track.at(t + delay)
        if known.sum() < s.least_instants:
            continue
        error, T, lever = _linear(p[known], R[known], b[known])
        if best is None or error < best[0]:
            best = error, T, lever, float(delay)
    return None if best is None else best[1:]


def _linear(p: Float64, R: Float64, b: Float64) -> tuple[float, Float64, Float64]:
    """Return error [m], T_world_space and lever arms."""
    n, m = p.shape[:2]
    step = max(1, n // 400)  # enough observations for initial values
    p, R, b = p[::step], R[::step], b[::step]
    n = len(p)
    rows = np.zeros((n, m, 3, 12 + 3 * m))
    for i in range(3):
        rows[:, :, i, 3 * i : 3 * i + 3] = p
        rows[:, :, i, 9 + i] = 1.0
    for j in range(m):
        rows[:, j, :, 12 + 3 * j : 15 + 3 * j] = -R
    A, y = rows.reshape(-1, 12 + 3 * m), np.repeat(b[:, None], m, axis=1).reshape(-1)
    weight = np.ones(len(y))
    for _ in range(4):
        x = np.linalg.lstsq(A * weight[:, None], y * weight, rcond=None)[0]
        off = np.linalg.norm((A @ x - y).reshape(-1, 3), axis=1)
        weight = np.repeat(1.0 / np.sqrt(np.maximum(off / max(float(np.median(off)), 1e-9), 1.0)), 3)
    U, _, Vt = np.linalg.svd(x[:9].reshape(3, 3))
    R_space_world = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    lever = np.asarray(x[12:].reshape(m, 3), dtype=np.float64)
    moved = b[:, None] + np.einsum("kij,mj->kmi", R, lever)
    R_world = R_space_world.T
    shift = np.median((p - moved @ R_world.T).reshape(-1, 3), axis=0)
    return float(np.median(off)), rigid(R_world, shift), lever


def _refined(
    t: Float64,
    p: Float64,
    track: _Track,
    start: tuple[Float64, Float64, float],
    s: SpaceAlignmentSettings,
    *,
    moved: tuple[float, float],
) -> SpaceFit:
    """Refine rotation, translation, delay and lever arms by Gauss–Newton."""
    T, lever, delay = start
    m, centre = p.shape[1], p.mean(axis=(0, 1))
    axes = np.array([[0.0, 1.0, 0.0]]) if s.vertical else np.eye(3)
    if s.vertical:
        T = _upright(T, centre)
    free = len(axes) + 4
    for _ in range(_ROUNDS):
        X, J, known = _expected(t, track, (T, lever, delay), centre, axes)
        r = p - X
        off = np.linalg.norm(r, axis=-1)
        weight, scale = _weights(off, known)
        flat = J.reshape(-1, free + 3 * m)
        W = np.repeat(weight.ravel(), 3)
        A = (flat.T * W) @ flat
        A[np.diag_indices_from(A)] *= 1.0 + 1e-10
        step = np.asarray(np.linalg.lstsq(A, flat.T @ (W * r.ravel()), rcond=1e-14)[0], dtype=np.float64)
        T, lever, delay = _stepped((T, lever, delay), step, centre, axes, s.delay_within_s)
        if np.abs(step).max() < 1e-7:
            break
    score = (flat * (W * r.ravel())[:, None]).reshape(len(t), -1, free + 3 * m).sum(axis=1)
    block = np.unique(np.floor(t / _BLOCK_S), return_inverse=True)[1]
    sums = np.zeros((block.max() + 1, free + 3 * m))
    np.add.at(sums, block, score)
    count = len(sums)
    back_A = np.linalg.pinv(A, rcond=1e-14)
    sd = np.sqrt(np.maximum(np.diag(back_A @ (sums.T @ sums) @ back_A), 0.0) * count / max(count - 1, 1))
    fits = (weight > 0).all(axis=1)
    return SpaceFit(
        T, lever, delay,
        position_sd_m=float(np.sqrt(np.mean(sd[len(axes) : len(axes) + 3] ** 2))),
        rotation_sd_rad=float(np.sqrt(np.mean(sd[: len(axes)] ** 2))),
        lever_sd_m=float(sd[free:].max()),
        delay_sd_s=float(sd[free - 1]),
        residual_m=scale,
        instants=int(known.sum()),
        left_out=int((known & ~fits).sum()),
        turn_rad=moved[0],
        space_m=moved[1],
    )  # fmt: skip


def _upright(T: Float64, centre: Float64) -> Float64:
    """Return the nearest motion that keeps y upright and brings the same point to ``centre``."""
    R = T[:3, :3]
    angle = math.atan2(R[0, 2] - R[2, 0], R[0, 0] + R[2, 2])
    back = R.T @ (centre - T[:3, 3])
    R = exp_twist([0, 0, 0, 0, angle, 0])[:3, :3]
    return np.asarray(rigid(R, centre - R @ back))


def _expected(
    t: Float64, track: _Track, found: tuple[Float64, Float64, float], centre: Float64, axes: Float64
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Return the points (n, m, 3) at times (n,), their derivative by the unknowns of `_stepped`, and which are known.

    ``found`` is T_world_space, lever arms and delay.
    """
    T, lever, delay = found
    free = len(axes) + 4
    R, b, v, known, w = track.at(t + delay)
    on = np.einsum("kij,mj->kmi", R, lever)
    X = (b[:, None] + on) @ T[:3, :3].T + T[:3, 3]
    J = np.zeros((*X.shape, free + 3 * len(lever)))
    J[..., : len(axes)] = -cross_matrix(X - centre) @ axes.T
    J[..., len(axes) : len(axes) + 3] = np.eye(3)
    J[..., free - 1] = (v[:, None] + np.cross(w[:, None], on)) @ T[:3, :3].T
    for j in range(len(lever)):
        J[:, j, :, free + 3 * j : free + 3 * j + 3] = T[:3, :3] @ R
    return X, J, known


def _stepped(
    found: tuple[Float64, Float64, float], step: Float64, centre: Float64, axes: Float64, delay_within_s: float
) -> tuple[Float64, Float64, float]:
    """Return T_world_space, lever arms and delay after a step.

    Its unknowns are a turn about the axes through ``centre``, a shift, the delay and the lever arms.
    """
    T, lever, delay = found
    turned, shifted, levers = step[: len(axes)], step[len(axes) : len(axes) + 3], step[len(axes) + 4 :]
    turn = exp_twist(np.r_[np.zeros(3), turned @ axes])[:3, :3]
    T = np.asarray(rigid(turn @ T[:3, :3], centre + turn @ (T[:3, 3] - centre) + shifted))
    farthest = 2 * delay_within_s + 0.1
    return T, lever + levers.reshape(lever.shape), float(np.clip(delay + step[len(axes) + 3], -farthest, farthest))


def _weights(off: Float64, known: NDArray[np.bool_]) -> tuple[Float64, float]:
    """Return Huber's weights of points ``off`` (n, m) [m] from where they should be, and an inlier's deviation [m].

    Points that are very far off, or at times (n,) that are not known, have none.
    """
    scale = max(float(np.median(off[known])) / _MEDIAN_OF_CHI, 1e-7)
    weight = np.minimum(1.0, 2.5 * scale / np.maximum(off, 1e-12)) * known[:, None] * (off < 12 * scale)
    return weight, scale


def _shortfalls(fit: SpaceFit, s: SpaceAlignmentSettings) -> Iterator[Shortfall]:
    if not fit.residual_m <= s.largest_residual_m or fit.left_out > 0.5 * fit.instants:
        yield Shortfall(
            "the two trackers do not follow one rigid thing",
            f"the residual is {1e3 * fit.residual_m:.0f} mm, at most {1e3 * s.largest_residual_m:.0f} mm are wanted",
            "fix the marker on the body, and name the right ones; where only one has y up, do without --vertical",
        )
    if abs(fit.delay_s) > s.delay_within_s:
        yield Shortfall(
            "the clocks differ too much, or nothing fits",
            f"by {fit.delay_s:.2f} s, at most {s.delay_within_s:g} s are looked at",
            "name the right marker and body",
        )
    if not fit.delay_sd_s <= s.largest_delay_sd_s:
        yield Shortfall(
            "too slow to know the delay",
            f"it is known to {1e3 * fit.delay_sd_s:.0f} ms, {1e3 * s.largest_delay_sd_s:.0f} ms are wanted",
            "move it faster, to and fro",
        )
    if not fit.lever_sd_m <= s.largest_sd_m:
        yield Shortfall(
            "too little rotation to know the lever arm",
            f"it is known to {1e3 * fit.lever_sd_m:.0f} mm, {1e3 * s.largest_sd_m:.0f} mm are wanted",
            "tilt and turn it more, and longer",
        )
    if not (fit.position_sd_m <= s.largest_sd_m and fit.rotation_sd_rad <= s.largest_sd_rad):
        yield Shortfall(
            "too uncertain",
            f"known to {1e3 * fit.position_sd_m:.0f} mm and {math.degrees(fit.rotation_sd_rad):.1f}°, "
            f"{1e3 * s.largest_sd_m:.0f} mm and {math.degrees(s.largest_sd_rad):.1f}° are wanted",
            "move it longer, through a larger space",
        )
