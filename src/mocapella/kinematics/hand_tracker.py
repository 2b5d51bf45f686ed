"""Track a hand from markers on the five fingertips and on its base, with tracking states and uncertainties.

The *base* is the back of the hand with the wrist; its markers move with the palm. Three or more of them measure the
palm's pose; with fewer it comes from the fit. A prior supplies what markers do not determine: the posture at rest,
fingers that follow their neighbours, and the motion so far. `hand_fit_kernels` describes the cost function. A solver of
`hand_solvers` can take the place of the fit for the digits whose tips are seen; the palm is always that of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, one_of
from mocapella.geometry.alignment import align, moments
from mocapella.geometry.rigid import apply, inverse
from mocapella.kinematics.hand_chain import hand_chain, palm_landmarks
from mocapella.kinematics.hand_settings import HandReport, HandSettings
from mocapella.kinematics.hand_solvers import MAP, SOLVER_NAMES, ClosedForm, Fingers, hand_solver
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, DIGITS, LANDMARKS, TIPS, Hand, HandModel, HandShape
from mocapella.model.observations import JointState
from mocapella.settings import check

Float64 = NDArray[np.float64]

_JOINTS: Final = (2, 3, 6, 7, 10, 11, 14, 15, 18, 19)
"""Landmarks of each digit's second and third joint, in the order of measured joints."""
_DOUBTFUL_SD: Final = 4.0
"""Distance of a marker from the fit above which another start is tried, too [standard deviations].

With measured joints, a finger has no other posture: another start is tried only where a marker would be rejected.
"""
_POSES_DEG: Final = ((0.0, 0.0), (25.0, 35.0), (45.0, 70.0), (75.0, 90.0))
"""Flexion of the fingers' first and second joints in the initial postures of an acquisition [°]."""


@dataclass(frozen=True, eq=False)
class _State:
    """Pose, angles, their covariance and velocities of the hand at an instant.

    A prediction also has its inverse covariance, `certainty`, and the share of the information of the posture at rest
    that counts beside it: in `posture_every_s` it counts once, however many frames there are.
    """

    at_s: float
    seen_s: float
    T: Float64
    z: Float64
    covariance: Float64
    velocity: Float64
    certainty: Float64 | None = None
    share: float = 1.0


class HandTracker:
    """Tracker of one hand. Equal inputs give equal outputs, to the bit.

    Args:
        model: the hand's joints, limits and couplings.
        shape: the person's bone lengths, and the hand's side.
        base_markers: (k, 3) positions of the base's markers in the palm's frame of a right hand, k ≥ 1; of a left hand,
            mirrored [m].
        settings: priors and thresholds; the defaults if None.
        joints: whether each digit's second and third joint are measured, too, after the tips and the base.
        solver: one of `SOLVER_NAMES`: ``map`` fits palm and angles together; another takes the palm of that fit, and
            solves the angles of the digits whose tips are seen. Standard deviations are always those of the fit.

    Attributes:
        report: counts since the tracker was made or reset, updated in place.
        fingers: what the solver found last; None for ``map``, and before the first hand.

    Raises:
        SettingsError: no base marker, or one farther than 0.5 m from the wrist along an axis; no such solver.
    """

    def __init__(
        self,
        model: HandModel,
        shape: HandShape,
        base_markers: Any,
        settings: HandSettings | None = None,
        solver: str = MAP,
        *,
        joints: bool = False,
    ) -> None:
        check(solver in SOLVER_NAMES, "solver", solver, f"one of {one_of(solver, SOLVER_NAMES)}")
        layout = np.ascontiguousarray(base_markers, dtype=np.float64)
        good = layout.ndim == 2 and layout.shape[1:] == (3,) and len(layout) >= 1 and (np.abs(layout) < 0.5).all()
        check(bool(good), "base_markers", np.shape(base_markers), "(k, 3), k ≥ 1, each within 0.5 m of the wrist")
        self.model, self.shape, self.layout = model, shape, layout
        self._base = slice(5, 5 + len(layout))
        self._markers_count = 5 + len(layout) + (len(_JOINTS) if joints else 0)
        self.settings = settings or HandSettings()
        self.solver = ClosedForm(model, shape)
        self.chain = hand_chain(model, shape)
        self.columns, self.gains, angle_of = free_angles(model)
        self._angle_of = angle_of
        follows = self.columns >= 0
        self._angles_at, self._columns_at = DIGIT_ANGLES[follows], self.columns[follows]
        self._gains_at = self.gains[follows]
        self._mean = model.natural[angle_of]
        self._prior = angle_prior(model, self.settings, self.columns)
        self._c_max = float(model.limits[DIGIT_ANGLES[0, 4], 1])
        self._mirror = float(shape.mirror[0])
        self._numbers = _following().HandNumbers(
            self.solver.digits, self._mirror, layout, self.columns, self.gains, self._c_max, self._mean, self._prior,
            _rates(self.settings, len(self._mean)), float(self.settings.velocity_memory_s),
            _DOUBTFUL_SD if not joints else max(_DOUBTFUL_SD, float(self.settings.outlier_sd)),
            float(self.settings.outlier_sd), int(self.settings.most_iterations),
        )  # fmt: skip
        self._templates = self._poses()
        self._inverse = None if solver == MAP else hand_solver(solver, model, shape)
        if self._inverse is not None:  # compiles its kernels before the first frame
            self._inverse.solve(palm_landmarks(self.chain, model.natural)[list(TIPS)])
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._state: _State | None = None
        self.fingers: Fingers | None = None
        markers = self._markers_count
        self.report = HandReport(rejected=[0] * markers, missing=[0] * markers)

    def update(self, points: Any, at_s: float, uncertainty: Any = None) -> Hand:
        """Update the hand with the markers of one instant.

        Args:
            points: (5 + k, 3) fingertips from the thumb to the little finger, then the base's markers, world [m]; NaN
                where one is not seen. With ``joints`` (15 + k, 3): then the second and third joint of each digit.
            at_s: capture time [s]; a time before the last update's counts as that of the last update.
            uncertainty: (…,) standard deviations of a coordinate [m] or (…, 3, 3) covariances [m²] of the points; the
                settings' if None. A marker whose uncertainty is not positive and finite is not used.

        Returns:
            The hand at that instant, with all landmarks. Acquisition needs at least three fingertips and a base marker.
            Without markers the hand is predicted, and lost after ``forget_after_s``: all NaN, and not tracked.

        Raises:
            InputError: arrays of another shape, or a time that is not finite.
        """
        points, clean, information, at_s = self._checked(points, at_s, uncertainty)
        seen = information[:, 0, 0] > 0
        self._count(seen)
        before = self._predicted(at_s)
        if before is None:
            fitted = self._found(clean, information, at_s)
        elif seen.any():
            fitted = self._followed(before, clean, information)
        else:
            fitted = None
        if fitted is None and before is None:
            self.report.lost += 1
            self._state = None
            return _nobody(at_s, self.shape, len(points))
        if fitted is None:
            assert before is not None
            self.report.predicted += 1
            self._state, information = before, np.zeros_like(information)
        else:
            self.report.fitted += 1
            self._state, information = fitted
        return self._described(self._state, before, points, information, bool(seen.any()))

    def predicted(self, at_s: float) -> Float64 | None:
        """Return the landmarks (21, 3) that are predicted for a time, world [m]; None without a hand. Nothing changes.

        Args:
            at_s: time, not before that of the last update [s].
        """
        last = self._state
        if last is None or at_s - last.seen_s > self.settings.forget_after_s:
            return None
        x = np.empty((len(LANDMARKS), 3))
        _following().predicted_landmarks(self._numbers, self._motion(last), float(at_s - last.at_s), x)
        return x

    @property
    def state(self) -> _State | None:
        """Pose, angles and velocities of the hand, for `recall`; None without a hand."""
        return self._state

    def recall(self, state: _State | None, report: HandReport) -> None:
        """Replace all state by a `state` and a `report` of a tracker of the same hand.

        Raises:
            InputError: they are of another hand.
        """
        n = 6 + len(self._mean)
        good = state is None or (state.z.shape == (n - 6,) and state.covariance.shape == (n, n))
        if not (good and len(report.missing) == self._markers_count):
            raise InputError("is no state of this hand", field="state", fix="take that of the same markers and model")
        self._state, self.report = state, report

    def resized(self, shape: HandShape, base_markers: Any) -> HandTracker:
        """Return a tracker of a hand of another size that continues this one: its pose, angles and counts.

        Args:
            shape: the new lengths, of the same side.
            base_markers: (k, 3) their base's markers, as many as before [m].
        """
        joints = self._markers_count > self._base.stop
        solver = MAP if self._inverse is None else self._inverse.name
        other = HandTracker(self.model, shape, base_markers, self.settings, solver, joints=joints)
        other._state, other.report = self._state, self.report
        return other

    def _checked(self, points: Any, at_s: float, uncertainty: Any) -> tuple[Float64, Float64, Float64, float]:
        """Check the measurements; return points, the same without NaN, inverse covariances and the time.

        The inverse covariance of a marker that is not used is 0.
        """
        n = self._markers_count
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.shape != (n, 3):
            joints = f", {len(_JOINTS)} joints" if n > self._base.stop else ""
            fix = f"give ({n}, 3): five fingertips and {len(self.layout)} of the base{joints}"
            raise InputError("are no markers of this hand", field="points", value=points.shape, fix=fix)
        if not np.isfinite(at_s):
            raise InputError("is no time", field="at_s", value=at_s, fix="give seconds")
        if uncertainty is None:
            uncertainty = np.full(n, self.settings.marker_sd_m)
        given = np.asarray(uncertainty, dtype=np.float64)
        if given.shape not in ((n,), (n, 3, 3)):
            fix = f"give ({n},) standard deviations or ({n}, 3, 3) covariances"
            raise InputError("are none of these markers", field="uncertainty", value=given.shape, fix=fix)
        if given.ndim == 1:
            with np.errstate(invalid="ignore"):
                given = np.where(given > 0, given**2, np.nan)[:, None, None] * np.eye(3)
        clean, information = np.empty((n, 3)), np.empty((n, 3, 3))
        _following().informed(points, np.ascontiguousarray(given), clean, information)
        last = self._state.at_s if self._state is not None else at_s
        return points, clean, information, max(float(at_s), last)

    def _count(self, seen: NDArray[np.bool_]) -> None:
        self.report.frames += 1
        self.report.markers += int(seen.sum())
        for i in np.flatnonzero(~seen):
            self.report.missing[i] += 1

    def _predicted(self, at_s: float) -> _State | None:
        """Predict the hand; None if there is none, or it was not seen for longer than ``forget_after_s``."""
        last, s = self._state, self.settings
        if last is None or at_s - last.seen_s > s.forget_after_s:
            return None
        dt, n = at_s - last.at_s, 6 + len(last.z)
        new = _following().MovingHand(np.empty((4, 4)), np.empty(n - 6), np.empty(n), np.empty((n, n)))
        certainty = np.empty((n, n))
        _following().predict(self._numbers, self._motion(last), float(dt), new, certainty)
        share = min(dt / s.posture_every_s, 1.0)
        return _State(at_s, last.seen_s, new.T, new.z, new.covariance, new.velocity, certainty, share)

    def _motion(self, state: _State) -> Any:
        """Return a state as the kernels take it."""
        return _following().MovingHand(state.T, state.z, state.velocity, state.covariance)

    def _followed(self, before: _State, points: Float64, information: Float64) -> tuple[_State, Float64] | None:
        """Fit the hand from its prediction; return it and the information used; None if all markers were rejected."""
        fitted, kept = self._without_outliers(before, points, information, [(before.T, before.z)])
        fitted = self._solved(fitted, before.z, points, kept)
        velocity, last = before.velocity, self._state
        if last is not None and before.at_s > last.at_s:
            velocity = np.empty_like(velocity)
            _following().move(self._numbers, self._motion(last), before.at_s - last.at_s, *fitted, velocity)
        if not kept[:, 0, 0].any():
            return None
        return _State(before.at_s, before.at_s, *fitted, before.covariance, velocity), kept

    def _found(self, points: Float64, information: Float64, at_s: float) -> tuple[_State, Float64] | None:
        """Acquire a hand, from several initial poses; None with fewer than three tips or without a base marker."""
        seen = information[:, 0, 0] > 0
        if seen[:5].sum() < 3 or not seen[self._base].any():
            return None
        starts = []
        for z, markers in self._templates:
            T = align(moments(points[seen], markers[seen], np.trace(information[seen], axis1=1, axis2=2)))
            if np.isfinite(T).all():
                starts.append((T, z))
        direct, z = np.empty((4, 4)), np.empty(len(self._mean))
        if _following().direct_start(self._numbers, points, information, self._mean, direct, z):
            starts.append((direct, z))
        n = 6 + len(self._mean)
        nothing = _State(at_s, at_s, np.eye(4), self._mean, np.zeros((n, n)), np.zeros(n))
        fitted, kept = self._without_outliers(nothing, points, information, starts)
        fitted = self._solved(fitted, self._mean, points, kept)
        self.report.found += 1
        return _State(at_s, at_s, *fitted, np.zeros((n, n)), np.zeros(n)), kept

    def _solved(
        self, fitted: tuple[Float64, Float64], start: Float64, points: Float64, kept: Float64
    ) -> tuple[Float64, Float64]:
        """Return a fitted hand with the solver's angles of the digits whose tips are used; unchanged for ``map``."""
        if self._inverse is None:
            return fitted
        T, z = fitted
        used = kept[:5, 0, 0] > 0
        angles, begin = self._angles(z), self._angles(start)
        for digit in np.flatnonzero(used):
            of = DIGIT_ANGLES[digit][DIGIT_ANGLES[digit] >= 0]
            angles[of] = begin[of]
        tips = np.where(used[:, None], points[:5], np.nan)
        self.fingers = self._inverse.solve(apply(inverse(T), tips), angles)
        return T, self.fingers.angles[self._angle_of]

    def _without_outliers(
        self, before: _State, points: Float64, information: Float64, starts: list[tuple[Float64, Float64]]
    ) -> tuple[tuple[Float64, Float64], Float64]:
        """Return the best fit, and the information without that of rejected markers."""
        n, kept = len(before.z), information.copy()
        certainty = np.zeros((6 + n, 6 + n)) if before.certainty is None else before.certainty
        T, z, rejected = np.empty((4, 4)), np.empty(n), np.zeros(len(points), dtype=np.int64)
        _following().follow(
            self._numbers, points, kept, self._motion(before), certainty, float(before.share),
            np.array([pose for pose, _ in starts]), np.array([angles for _, angles in starts]), T, z, rejected,
        )  # fmt: skip
        for i in np.flatnonzero(rejected).tolist():
            self.report.rejected[i] += int(rejected[i])
        return (T, z), kept

    def _markers(self, T: Float64, z: Float64) -> Float64:
        """Return the markers of a posed hand, in the order of `update` [m]."""
        x = palm_landmarks(self.chain, self._angles(z))
        joints = x[list(_JOINTS[: self._markers_count - self._base.stop])]
        return apply(T, np.concatenate([x[list(TIPS)], self.layout * self.shape.mirror, joints]))

    def _angles(self, z: Float64) -> Float64:
        """Return all angles (21,) for the free ones [rad]."""
        out = np.zeros(len(ANGLES))
        out[self._angles_at] = self._gains_at * z[self._columns_at]
        return out

    def _poses(self) -> list[tuple[Float64, Float64]]:
        """Return free angles and markers of the initial hands of an acquisition."""
        out = []
        for first, second in _POSES_DEG:
            angles = self.model.natural.copy()
            for row in DIGIT_ANGLES[1:]:
                angles[row[0]], angles[row[2]] = np.radians([first, second])
            z = self.model.limited(angles)[self._angle_of]
            out.append((z, self._markers(np.eye(4), z)))
        return out

    def _described(
        self, state: _State, before: _State | None, points: Float64, information: Float64, seen: bool
    ) -> Hand:
        x, sd, alone = np.empty((len(LANDMARKS), 3)), np.empty(len(LANDMARKS)), np.empty(len(LANDMARKS))
        n = 6 + len(state.z)
        covariance, residuals = np.empty((n, n)), np.empty(len(points))
        certainty = np.zeros((n, n)) if before is None or before.certainty is None else before.certainty
        R = np.ascontiguousarray(state.T[:3, :3]).reshape(9)
        t = np.ascontiguousarray(state.T[:3, 3])
        sure = _fitting().describe(
            self.solver.digits, self._mirror, self.layout, np.nan_to_num(points), information, self.columns, self.gains,
            self._prior, 1.0 if before is None else before.share, certainty, R, t, state.z, x, sd, alone, covariance,
            residuals,
        )  # fmt: skip
        assert sure, "information is bounded, and so is the prior"
        self._state = _State(state.at_s, state.seen_s, state.T, state.z, covariance, state.velocity)
        variances = np.diagonal(covariance)
        tracked = (alone <= self.settings.tracked_sd_m) & seen
        states = np.where(tracked, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
        angles_sd = np.zeros(len(ANGLES))
        angles_sd[self._angles_at] = self._gains_at * np.sqrt(variances[6 + self._columns_at])
        residuals[~np.isfinite(points).all(axis=-1)] = np.nan
        return Hand(
            state.at_s, self.shape.handedness, x, states, sd, self._angles(state.z), angles_sd, state.T, residuals
        )


def base_layout(shape: HandShape, markers: int, height_m: float = 0.0) -> Float64:
    """Return usual positions of the base's markers: wrist, then knuckles of index, little and middle finger.

    Args:
        shape: the hand.
        markers: number of markers, 1 to 4.
        height_m: height of the markers above the joints, on the back of the hand [m].

    Returns:
        (markers, 3) in the palm's frame of a right hand [m].

    Raises:
        SettingsError: another number of markers.
    """
    check(1 <= markers <= 4, "markers", markers, "1 to 4")
    order = [DIGITS.index(name) for name in ("index", "little", "middle")]
    places = np.concatenate([np.zeros((1, 3)), shape.bases[order]])[:markers]
    return np.asarray(places + np.array([0.0, height_m, 0.0]))


def free_angles(model: HandModel) -> tuple[NDArray[np.int64], Float64, NDArray[np.int64]]:
    """Return the linear map from a hand's free angles to its 21 angles, which couples joints and holds others at 0.

    Returns:
        (5, 5) index of the free angle that each of a digit's five angles follows, −1 for none; (5, 5) factors; and (n,)
        indices of the free angles in `ANGLES`.
    """
    columns, gains = np.full((5, 5), -1, dtype=np.int64), np.ones((5, 5))
    angle_of: list[int] = []
    for digit in range(5):
        for k in range(5):
            angle = int(DIGIT_ANGLES[digit, k])
            if angle < 0 or (k in (1, 4) and model.limits[angle, 0] == model.limits[angle, 1]):
                continue
            if k == 3 and model.coupled[digit]:
                columns[digit, k], gains[digit, k] = columns[digit, 2], model.coupling[digit]
                continue
            columns[digit, k] = len(angle_of)
            angle_of.append(angle)
    return columns, gains, np.array(angle_of, dtype=np.int64)


def angle_prior(model: HandModel, s: HandSettings, columns: NDArray[np.int64]) -> Float64:
    """Return the inverse covariance (n, n) of the free angles about the posture at rest [1/rad²].

    It is the inverse of a covariance in which the flexions of neighbouring fingers are correlated.

    Args:
        model: the hand's couplings.
        s: standard deviations.
        columns: (5, 5) the first result of `free_angles`.
    """
    n = int(columns.max()) + 1
    out = np.zeros((n, n))

    def expect(weights: dict[int, float], sd_deg: float) -> None:
        row = np.zeros(n)
        for column, weight in weights.items():
            row[column] = weight
        out[:] += np.outer(row, row) / np.radians(sd_deg) ** 2

    for digit in range(5):
        flexion, abduction, middle, last, second = columns[digit]
        around = (s.thumb_sd_deg, s.thumb_sd_deg) if digit == 0 else (s.flexion_sd_deg, s.abduction_sd_deg)
        expect({flexion: 1.0}, around[0])
        expect({middle: 1.0}, around[0])
        if abduction >= 0:
            expect({abduction: 1.0}, around[1])
        if second >= 0:
            expect({second: 1.0}, s.abduction_sd_deg)
        if not model.coupled[digit]:
            expect({last: 1.0, middle: -float(model.coupling[digit])}, s.coupling_sd_deg)
    for k, sd_deg in enumerate(model.neighbours_deg):
        for joint, factor in ((0, 1.0), (2, 1.5)):
            expect({columns[k + 1, joint]: 1.0, columns[k + 2, joint]: -1.0}, factor * sd_deg)
    return out


def _nobody(at_s: float, shape: HandShape, markers: int) -> Hand:
    nan = np.full
    return Hand(
        at_s, shape.handedness, nan((len(LANDMARKS), 3), np.nan),
        np.full(len(LANDMARKS), JointState.NOT_TRACKED, dtype=np.uint8), nan(len(LANDMARKS), np.nan),
        nan(len(ANGLES), np.nan), nan(len(ANGLES), np.nan), nan((4, 4), np.nan), nan(markers, np.nan),
    )  # fmt: skip


def _rates(s: HandSettings, angles: int) -> Float64:
    """Return the standard deviations (6 + angles,) of unpredicted speeds [m/s, rad/s]."""
    rates = np.full(6 + angles, np.radians(s.angle_rate_deg_s))
    rates[:3], rates[3:6] = s.palm_rate_m_s, np.radians(s.palm_rate_deg_s)
    return rates


@cache
def _following() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import hand_follow_kernels

    return hand_follow_kernels


@cache
def _fitting() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import hand_fit_kernels

    return hand_fit_kernels
