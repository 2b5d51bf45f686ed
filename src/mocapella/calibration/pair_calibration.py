"""Estimate the relative pose of two sensors from skeletons of people that both see, from the first frames on.

A pair of frames of the same body, interpolated to one time, adds to moments that fade (`geometry.alignment`); the rigid
motion that fits them best is `PairCalibration.T_a_b`. A joint is weighted by 1/residual under the previous estimate,
which minimises the sum of distances, not of squares. A body that stands still repeats the same observation with the
same errors: so time is counted by motion, in the fading and in the uncertainty.

The covariance is the sandwich H⁻¹ B H⁻¹ of a robust estimate (P. Huber, 1967; with sums over blocks, as H. White and
I. Domowitz, 1984, for correlated errors). H is the normal matrix. B is the scatter of the gradient, summed over
*blocks* of frames: a block ends when the body is `independent_after_m` away from where it began. So the 25 joints of a
frame or the 30 frames of a second do not count as as many samples, and standing people add none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_memory import BodyTrack, PairArrays, PairLimits, PairParameters, new_body
from mocapella.calibration.time_offset import OFFSET_PRIOR_SD, TimeOffset, moved_clock
from mocapella.geometry.alignment import MOMENTS, moments, shifted
from mocapella.geometry.rigid import apply
from mocapella.model import condition_texts as texts
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class PairSettings:
    """Parameters of the calibration of a pair; docs/methods/people-calibration.md explains the values.

    Attributes:
        memory_s: time constant of fading, in shared motion; larger: more accurate, but slower after a change [s].
        first_memory_s: time constant of fading at the beginning, when the weights come from a poor estimate; larger:
            early errors last longer [s].
        memory_growth: growth of the time constant of fading, from ``first_memory_s`` to ``memory_s``, per second of
            shared motion; larger: more of the first seconds is kept [s/s].
        residual_floor_m: residuals below this have equal weights; larger: nearer to least squares, and less robust [m].
        label_hysteresis_m: mean improvement of the joints' fit at which left and right are swapped; larger: labels
            change more rarely, and wrong ones last longer [m].
        mirrored_weight: weight of a view with swapped labels, relative to one without [0 to 1].
        inferred_weight: weight of a joint that a sensor only infers, relative to a tracked one [0 to 1].
        full_speed_m_s: least speed of a body for its frame to count by its full time; larger: slow motion counts less
            [m/s].
        still_fraction: fraction of the time that counts for a standing person; it decreases while they stand; larger:
            standing people contribute more [0 to 1].
        velocity_window_s: a joint's velocity is measured from this time before to this time after a frame; larger: less
            noise, but each frame is used later [s].
        independent_after_m: distance that a body moves until a sensor's errors are taken as independent; larger: fewer
            samples, so people must walk farther [m].
        samples_wanted: least number of independent samples of an estimate that does not rest on single postures; with
            fewer, the fit must be clearer, and contradictions do not mean that a sensor was moved [samples].
        position_sd_wanted_m: largest standard deviation of a trusted estimate's position, at the people; smaller:
            people must walk farther [m].
        rotation_sd_wanted: largest standard deviation of a trusted estimate's rotation; smaller: people must walk
            farther [rad].
        residual_allowed_m: largest mean distance between the two views' joints in a trusted estimate [m].
        offset_bound_wanted_s: bound, of two standard deviations, within which a clock offset counts as known [s].
        offset_expected_s: prior standard deviation of the offset between synchronised clocks; larger: the offset that
            the motion shows counts more [s].
        moved_factor: frames whose two centres are farther apart than ``moved_least_m``, and than this factor times
            their usual distance, are left out; if that lasts, a sensor was moved; larger: only larger moves are noticed
            [ratio].
        moved_least_m: least distance of the two views' centres for a frame to be left out, see ``moved_factor`` [m].
        every_s: least interval between used frames of one body; sensor errors last longer than a frame, so more frames
            add little [s].
        told_s: weight of a given initial estimate, as a duration of shared motion; larger: observations outweigh it
            later [s].
        turned_weight: weight of shoulders, elbows and hips of a person who stays in place, relative to one who walks:
            sensors turn them towards themselves, which averages out only when people turn; larger: less noise, and a
            larger error of the rotation [0 to 1].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    memory_s: float = 15.0
    first_memory_s: float = 1.0
    memory_growth: float = 0.5
    residual_floor_m: float = 0.02
    label_hysteresis_m: float = 0.02
    mirrored_weight: float = 0.3
    inferred_weight: float = 0.2
    full_speed_m_s: float = 0.3
    still_fraction: float = 0.8
    velocity_window_s: float = 0.067
    independent_after_m: float = 0.3
    samples_wanted: int = 3
    position_sd_wanted_m: float = 0.08
    rotation_sd_wanted: float = 0.09
    residual_allowed_m: float = 0.25
    offset_bound_wanted_s: float = 0.02
    offset_expected_s: float = 0.05
    moved_factor: float = 3.5
    moved_least_m: float = 0.1
    every_s: float = 0.05
    told_s: float = 0.03
    turned_weight: float = 0.05

    def __post_init__(self) -> None:
        for name in (
            "memory_s", "first_memory_s", "residual_floor_m", "full_speed_m_s", "velocity_window_s",
            "independent_after_m", "position_sd_wanted_m", "rotation_sd_wanted", "residual_allowed_m",
            "offset_bound_wanted_s", "moved_least_m", "told_s", "offset_expected_s",
        ):  # fmt: skip
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "greater than 0")
        for name in ("mirrored_weight", "inferred_weight", "still_fraction", "turned_weight"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")
        check(self.memory_growth >= 0, "memory_growth", self.memory_growth, "0 or more")
        hysteresis = self.label_hysteresis_m
        check(hysteresis >= 0.02, "label_hysteresis_m", hysteresis, "0.02 m or more, or labels flatter the fit")
        check(0 <= self.every_s <= 0.2, "every_s", self.every_s, "from 0 to 0.2 s")
        check(self.velocity_window_s < 0.3, "velocity_window_s", self.velocity_window_s, "less than 0.3 s")
        check(self.samples_wanted >= 1, "samples_wanted", self.samples_wanted, "1 or more")
        check(self.moved_factor >= 1, "moved_factor", self.moved_factor, "1 or more")

    @cached_property
    def parameters(self) -> PairParameters:
        """The settings as a named tuple of floats, for the kernels."""
        return PairParameters(*(float(getattr(self, name)) for name in PairParameters._fields))

    @cached_property
    def limits(self) -> PairLimits:
        """The settings that judge an estimate, as a named tuple of floats, for the kernels."""
        return PairLimits(*(float(getattr(self, name)) for name in PairLimits._fields))


class PairEstimate(msgspec.Struct, frozen=True, eq=False):
    """Result for a pair of sensors, a and b.

    Attributes:
        T_a_b: (4, 4), from b's camera space to a's; NaN before both saw a person.
        covariance: (6, 6) of a small motion d in a's frame (translation [m], rotation [rad]) that corrects the pose to
            exp(d) T_a_b.
        position_sd: standard deviation of a point at the people's positions, all directions together [m].
        rotation_sd: standard deviation of the angle [rad].
        motion_s: duration of shared motion so far [s].
        samples: number of independent samples in memory.
        residual: mean distance between the two views' joints [m].
        offset: offset of b's clock against a's, with its standard deviation [s]; 0 while it is not known.
        offset_now: most likely value of that offset, known or not.
        problem: why the estimate is not trusted yet, and its remedy; empty if it is trusted.
    """

    T_a_b: Float64
    covariance: Float64
    position_sd: float
    rotation_sd: float
    motion_s: float
    samples: float
    residual: float
    offset: TimeOffset
    offset_now: TimeOffset
    problem: str

    @property
    def trusted(self) -> bool:
        """Whether the estimate has no problem."""
        return not self.problem


NO_PERSON: Final = texts.NO_PERSON
WALK: Final = texts.WALK
WALK_ACROSS: Final = texts.WALK_ACROSS
ON_A_LINE: Final = texts.ON_A_LINE
NOT_ONE_BODY: Final = texts.NOT_ONE_BODY
MIRRORED_STREAM: Final = texts.MIRRORED_STREAM
PROBLEMS: Final = ("", ON_A_LINE, MIRRORED_STREAM, NOT_ONE_BODY, WALK, WALK_ACROSS)
"""Texts of an estimate's problems, by the index that `pair_estimate_kernels.problem_of` returns."""


@dataclass
class PairCalibration:
    """Estimator of one pair of sensors, a and b. All state is in arrays of fixed size.

    Attributes:
        settings: the settings.
        T_a_b: (4, 4) the present estimate; NaN before there is one.
        moments, scatter: weighted sums over joint correspondences, from which the pose (`geometry.alignment`) and its
            covariance follow.
        scalars, clock: other state, and the sums for the clock offset, by the indices of `pair_memory`.
        bodies: state of each pair of bodies, see `pair_memory`, by the key given to `update`.
        mirrored_at_first: whether b's left and right start swapped for a new pair of bodies.
    """

    settings: PairSettings = field(default_factory=PairSettings)
    T_a_b: Float64 = field(default_factory=lambda: np.full((4, 4), np.nan))
    moments: Float64 = field(default_factory=lambda: np.zeros(MOMENTS))
    scatter: Float64 = field(default_factory=lambda: np.zeros((7, 7)))
    scalars: Float64 = field(default_factory=lambda: np.zeros(at.PAIR_SCALARS))
    clock: Float64 = field(default_factory=lambda: np.zeros(at.CLOCK_SUMS))
    bodies: dict[Any, Float64] = field(default_factory=dict)
    mirrored_at_first: bool = False

    @classmethod
    def begun_from(cls, T_a_b: Float64, settings: PairSettings, offset: float = 0.0) -> PairCalibration:
        """Return an estimator that starts from a given pose ``T_a_b`` (4, 4), copied, and offset of b's clock [s].

        The start counts as `PairSettings.told_s` seconds of a person who moves in the usual area, so observations soon
        outweigh it.
        """
        (pair,) = cls.each_begun_from(np.asarray(T_a_b, dtype=np.float64)[None], settings)
        pair.scalars[at.REFERENCE_OFFSET] = offset
        return pair

    @classmethod
    def each_begun_from(cls, T_a_b: Float64, settings: PairSettings) -> list[PairCalibration]:
        """Return the estimator of `begun_from` for each pose of ``T_a_b`` (pairs, 4, 4); clocks have no offset."""
        q = TOLD_CENTRE + TOLD_REACH * (np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3))
        p, seconds = apply(T_a_b, q), settings.told_s
        sums = moments(p, q, np.full(len(q), TOLD_JOINTS / len(q) * seconds / TOLD_RESIDUAL_M))
        scalars = np.zeros((len(T_a_b), at.PAIR_SCALARS))
        scalars[:, [at.COST_WEIGHT, at.COST]] = seconds, seconds * TOLD_RESIDUAL_M
        scalars[:, at.APART_SQ] = seconds * TOLD_APART_M**2
        scalars[:, list(CENTRES)] = seconds * p.mean(axis=1)
        return [
            cls(settings, T.copy(), moments=own.copy(), scalars=numbers.copy())
            for T, own, numbers in zip(T_a_b, sums, scalars, strict=True)
        ]

    def update(
        self, who: Any, a: BodyTrack, b: BodyTrack, mirror: NDArray[np.int64], turned: NDArray[np.bool_] | None = None
    ) -> bool:
        """Update the estimate with the newest frame of a body.

        Args:
            who: key of the pair of bodies, such as the tracking ids in a and b.
            a, b: the body's newest frames in each sensor.
            mirror: (joints,) index of each joint's counterpart on the other side, of the topology.
            turned: (joints,) whether sensors turn the joint towards themselves, see `pair_memory.turned_joints`; None
                for no joint.

        Returns:
            Whether a frame of a was compared: the newest one that b's frames surround by at least
            `velocity_window_s`. A frame in a gap of b's longer than 0.2 s, or with fewer than four joints, is left out.
        """
        body = self.bodies.get(who)
        if body is None:
            body = self.bodies[who] = new_body(mirrored=self.mirrored_at_first)
        pair = PairArrays(self.moments, self.scatter, self.T_a_b, self.scalars, self.clock, body)
        if turned is None:
            turned = np.zeros(len(mirror), dtype=np.bool_)
        return bool(_take_newest()(pair, a.arrays, b.arrays, mirror, turned, self.settings.parameters))

    def is_copy_of(self, other: PairCalibration) -> bool:
        """Return whether all state is equal to another estimator's."""
        parts = ("moments", "scatter", "T_a_b", "scalars", "clock")
        return all(np.array_equal(getattr(self, part), getattr(other, part)) for part in parts)

    def trust(self, estimate: PairEstimate) -> None:
        """From now on, leave out frames that disagree with this estimate by more than usual, if it is trusted.

        If it is not trusted, no frame is left out. Call it with the result of `estimate` at each refresh.
        """
        reach = estimate.position_sd + REACH_M * estimate.rotation_sd
        self.scalars[at.OWN_SD] = reach if estimate.trusted else 0.0

    def forget_bodies(self, keep: Any) -> None:
        """Drop the state of each pair of bodies for whose key, as given to `update`, ``keep`` returns False.

        `bodies` stays the same object unless one is dropped.
        """
        if not all(map(keep, self.bodies)):
            self.bodies = {who: body for who, body in self.bodies.items() if keep(who)}

    def estimate(self) -> PairEstimate:
        """Return the present relative pose and clock offset, with covariance and the reason for distrust.

        It is computed from the moments; the state does not change. `estimates` does so for many pairs at once.
        """
        return estimates([self])[0]

    @property
    def samples_closed(self) -> int:
        """Number of completed independent samples so far, including faded ones."""
        return int(self.scalars[at.BLOCKS_CLOSED])

    @property
    def walked(self) -> bool:
        """Whether a person has walked so far that the pose does not rest on single postures."""
        return self.samples_closed >= self.settings.samples_wanted

    @property
    def residual(self) -> float:
        """Mean distance between the two views' joints [m]; NaN before there was one."""
        weight = self.scalars[at.COST_WEIGHT]
        return float(self.scalars[at.COST] / weight) if weight > 0 else np.nan

    def follow_clock(self, estimate: PairEstimate) -> None:
        """Replace the assumed offset of b's clock, used by `update`, by its most likely value; its prior is 0.

        Nothing happens before another independent sample is complete. A large change reduces the earlier sums.

        Args:
            estimate: the present result.
        """
        closed = self.scalars[at.BLOCKS_CLOSED]
        if closed == self.scalars[at.FOLLOWED]:
            return
        self.scalars[at.FOLLOWED] = closed
        if estimate.offset_now.sd >= OFFSET_PRIOR_SD:  # too few frames since a large change
            return
        prior, seen = self.settings.offset_expected_s**2, estimate.offset_now.sd**2
        offset = estimate.offset_now.seconds * prior / (prior + seen) - self.scalars[at.REFERENCE_OFFSET]
        if abs(offset) > RESAMPLE_BEYOND:
            # The shift is exact for constant velocities, so moments count less after a large one.
            fade = np.exp(-abs(offset) / SHIFT_TRUSTED)
            self.moments[:] = fade * shifted(self.moments, offset)
            self.scatter *= fade * fade
            self.scalars[[at.BLOCKS, at.COST, at.COST_WEIGHT, at.APART_SQ, *CENTRES]] *= fade
            self.scalars[at.BLOCKS_SQ] *= fade * fade
            self.clock[:] = moved_clock(self.clock, offset)
            self.scalars[at.REFERENCE_OFFSET] += offset
            offset = 0.0
        self.scalars[at.OFFSET] = offset


def estimates(pairs: Sequence[PairCalibration]) -> list[PairEstimate]:
    """Compute pose, clock offset and covariance of each pair, with the settings of the first.

    A pair that has compared no joints, and was given no pose, has the problem `NO_PERSON`. The pairs are not changed,
    and the results are copies.
    """
    begun = [pair for pair in pairs if pair.moments[0] > 0]
    found = iter(_estimates(begun) if begun else ())
    return [next(found) if pair.moments[0] > 0 else _nothing(pair) for pair in pairs]


def _nothing(pair: PairCalibration) -> PairEstimate:
    big = np.diag([1e6] * 3 + [np.pi**2] * 3)
    unknown = TimeOffset(0.0, OFFSET_PRIOR_SD, False)
    return PairEstimate(pair.T_a_b.copy(), big, 1e3, np.pi, 0.0, 0.0, np.nan, unknown, unknown, NO_PERSON)


def _estimates(pairs: Sequence[PairCalibration]) -> list[PairEstimate]:
    settings, n = pairs[0].settings, len(pairs)
    M, T, S, B, K = (
        np.array(arrays)
        for arrays in zip(
            *((pair.moments, pair.T_a_b, pair.scalars, pair.scatter, pair.clock) for pair in pairs), strict=True
        )
    )
    C, figures = np.empty((n, 6, 6)), np.empty((n, 7))
    _estimate_each()(M, T, S, B, K, settings.limits, C, figures)
    found = []
    for i, (scalars, own) in enumerate(zip(S.tolist(), figures.tolist(), strict=True)):
        position_sd, rotation_sd, samples, residual, seconds, offset_sd, problem = own
        known = 2 * offset_sd <= settings.offset_bound_wanted_s and samples >= settings.samples_wanted
        now = TimeOffset(seconds + scalars[at.REFERENCE_OFFSET], offset_sd, known)
        offset = now if known else TimeOffset(0.0, offset_sd, False)
        motion_s, text = scalars[at.MOTION], PROBLEMS[int(problem)]
        found.append(PairEstimate(T[i], C[i], position_sd, rotation_sd, motion_s, samples, residual, offset, now, text))
    return found


TOLD_CENTRE: Final = np.array([0.0, 0.0, 2.5])
"""Centre of the usual area of people, in camera space [m]."""
TOLD_REACH: Final = np.array([0.6, 0.6, 0.6])
"""Half the extent of the usual area of people, along each axis [m]."""
TOLD_JOINTS: Final = 25
TOLD_RESIDUAL_M: Final = 0.1
"""Expected distance between two views of a joint, before it is known [m]."""
TOLD_APART_M: Final = 0.3
"""Expected distance between the centres of two views of a person, before it is known [m]."""
SHIFT_TRUSTED: Final = 0.1
"""Change of the assumed clock offset that reduces the weight of earlier moments to 1/e [s]."""
CENTRES: Final = (at.CENTRE, at.CENTRE + 1, at.CENTRE + 2)
REACH_M: Final = 1.0
"""Distance from people's positions so far within which they are expected next [m]."""
RESAMPLE_BEYOND: Final = 0.01
"""Change of the clock offset beyond which frames are interpolated anew instead of moved along their velocity [s]."""


@cache
def _take_newest() -> Callable[..., bool]:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import pair_kernels

    return cast(Callable[..., bool], pair_kernels.take_newest)


@cache
def _estimate_each() -> Callable[..., None]:
    """Import the compiled judgement on first use."""
    from mocapella.calibration import pair_estimate_kernels

    return cast(Callable[..., None], pair_estimate_kernels.estimate_each)
