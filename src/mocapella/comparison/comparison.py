"""Compare a recording with a reference, such as a marker system: clocks, rigid motion, joints and angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.comparison.agreement import LimitsOfAgreement, agreement
from mocapella.comparison.estimate import EstimatedMotion, estimate
from mocapella.comparison.flexions import flexions, hinges
from mocapella.comparison.joint_names import MatchedJoint, Terms, weighted
from mocapella.comparison.motion_fit import TimeAndMotion
from mocapella.comparison.pairing import chosen_kinds, matched_people, near_people, paths_of, sampled
from mocapella.conventions import NS_PER_S
from mocapella.errors import EvaluationError, SettingsError
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply
from mocapella.model.joint_angles import JointAngles
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

STATES: Final = {"measured": JointState.TRACKED, "inferred": JointState.INFERRED}
"""States of the recording's joints that are scored apart."""


@dataclass(frozen=True, eq=False)
class Compared:
    """A recording compared with a reference.

    Attributes:
        kind: kind of the recording's results, such as ``people``.
        people: individual of the reference by individual of the recording.
        joints: the compared joints.
        motion: time map and rigid motion from the reference to the recording, with their uncertainty.
        clock: whether the reference has times; otherwise ``motion.ratio`` is its rate in frames a second.
        notes: sentences about what could not be determined.
        times_s: (frames,) times of the recording in the common time [s].
        reference_s: (frames,) the reference's times, or numbers of frames without a clock.
        states: (frames, individuals, joints) `JointState`, the less certain one of recording and reference.
        uncorrected: (frames, individuals, joints, 3) recording minus reference, with the time corrected alone [m].
        errors: the same after the rigid motion, and, if ``bias_removed``, without each joint's mean [m].
        biases: (individuals, joints, 3) each joint's mean difference after the rigid motion [m].
        bias_removed: whether the biases were subtracted from ``errors``.
        angle_names: names of the compared angles.
        angles, reference_angles: (frames, individuals, angles) [rad].
        angle_states: (frames, individuals, angles) the least certain state of an angle's joints.
    """

    kind: str
    people: Mapping[str, str]
    joints: tuple[MatchedJoint, ...]
    motion: TimeAndMotion
    clock: bool
    notes: tuple[str, ...]
    times_s: Float64
    reference_s: Float64
    states: NDArray[np.uint8]
    uncorrected: Float64
    errors: Float64
    biases: Float64
    bias_removed: bool
    angle_names: tuple[str, ...]
    angles: Float64
    reference_angles: Float64
    angle_states: NDArray[np.uint8]

    @property
    def angle_errors(self) -> Float64:
        """(frames, individuals, angles) recording minus reference [rad]."""
        return wrap(self.angles - self.reference_angles)

    @property
    def corrections(self) -> tuple[str, ...]:
        """The corrections that saw the reference, in words, in their order."""
        motion = self.motion
        made = []
        if motion.time_observable and not motion.clock_held:
            made.append("the time offset was estimated")
        if not self.clock:
            made.append("the rate of the reference, which has no times, was estimated")
        elif motion.drift_estimated:
            made.append("the rate of the clocks was estimated")
        if not motion.space_held:
            made.append("the rigid motion was estimated")
        if self.bias_removed:
            made.append("the mean difference of each joint was removed (--remove-bias)")
        return tuple(made)

    def positions(self, state: str | None = None, *, rigid: bool = True) -> dict[str, LimitsOfAgreement]:
        """Return the agreement of each joint's position [m], by name; joints of several people by ``person: joint``.

        Args:
            state: samples of the recording to count, ``measured`` or ``inferred``; None for both.
            rigid: whether the rigid motion is corrected; with time alone, the files' own coordinates are compared.
        """
        chosen = self.errors if rigid else self.uncorrected
        names = [joint.name for joint in self.joints]
        return self._agreements(names, chosen, self._mask(self.states, state))

    def angle_agreement(self, state: str | None = None) -> dict[str, LimitsOfAgreement]:
        """Return the agreement of each angle [rad], by name; ``state`` as in `positions`."""
        return self._agreements(self.angle_names, self.angle_errors[..., None], self._mask(self.angle_states, state))

    def all_positions(self, state: str | None = None, *, rigid: bool = True) -> LimitsOfAgreement | None:
        """Return the agreement of all joints together [m]; None without a sample. Arguments as in `positions`."""
        chosen = self.errors if rigid else self.uncorrected
        return agreement(chosen[self._mask(self.states, state)])

    def all_angles(self, state: str | None = None) -> LimitsOfAgreement | None:
        """Return the agreement of all angles together [rad]; None without a sample."""
        return agreement(self.angle_errors[self._mask(self.angle_states, state)][:, None])

    def _mask(self, states: NDArray[np.uint8], state: str | None) -> NDArray[np.bool_]:
        return states > 0 if state is None else states == STATES[state]

    def _agreements(
        self, names: Sequence[str], errors: Float64, counted: NDArray[np.bool_]
    ) -> dict[str, LimitsOfAgreement]:
        found: dict[str, LimitsOfAgreement] = {}
        for i, person in enumerate(self.people):
            for k, name in enumerate(names):
                one = agreement(errors[counted[:, i, k], i, k])
                if one is not None:
                    found[f"{person}: {name}" if len(self.people) > 1 else name] = one
        return found


def compared(
    recording: Mapping[str, Trajectories],
    reference: Mapping[str, Trajectories],
    *,
    kind: str | None = None,
    people: Mapping[str, str] | None = None,
    joints: Mapping[str, Terms] | None = None,
    remove_bias: bool = False,
    same_clock: bool = False,
    same_space: bool = False,
) -> Compared:
    """Compare a recording with a reference.

    Args:
        recording, reference: trajectories by kind.
        kind: kind of the recording's results; None for the one with most joints in common.
        people: the reference's individual by the recording's; None to match them by their motion, or by their distance
            if clock and space are the same.
        joints: keypoints of the reference with weights, by joint of the recording; None to match them by name.
        remove_bias: whether each joint's mean difference is subtracted, such as between a marker and a joint centre.
        same_clock: whether both have one clock, and no time is estimated: the wall clock if both files state it, and
            the files' own times otherwise.
        same_space: whether both are in the same coordinates, and no rigid motion is estimated.

    Raises:
        SettingsError: a side is empty, a name is unknown, or no joints match.
        EvaluationError: a side is too short, the motions differ, or the match of individuals is ambiguous.
    """
    ours, theirs, found = chosen_kinds(recording, reference, kind, joints)
    if min(len(ours), len(theirs)) < 2:
        raise EvaluationError("a recording of fewer than two frames cannot be compared")
    if same_clock:
        theirs = _on_clock_of(ours, theirs)
    by_distance = same_clock and same_space and not people
    pairs = near_people(ours, theirs, found) if by_distance else matched_people(ours, theirs, found, people or {})
    own = paths_of(ours, list(pairs), [one.ours for one in found])
    if not own.clock:
        raise EvaluationError("the recording has no times; give it as the reference")
    other = paths_of(theirs, list(pairs.values()), [one.theirs for one in found])
    motion, notes = estimate(own, other, same_clock=same_clock, same_space=same_space)
    estimated = EstimatedMotion(motion, notes)
    return _scored(ours.of(list(pairs)), theirs.of(list(pairs.values())), found, estimated, remove_bias)


def _on_clock_of(ours: Trajectories, theirs: Trajectories) -> Trajectories:
    """Return the reference with its times since the recording's beginning, if both state the wall clock."""
    if not np.isfinite(theirs.rate_hz):
        raise SettingsError("the reference has no times; leave --same-clock out")
    if not (ours.began_unix_ns and theirs.began_unix_ns):
        return theirs
    later_s = (theirs.began_unix_ns - ours.began_unix_ns) / NS_PER_S
    return replace(theirs, times_s=theirs.times_s + later_s, began_unix_ns=ours.began_unix_ns)


def _scored(
    ours: Trajectories,
    theirs: Trajectories,
    joints: tuple[MatchedJoint, ...],
    estimated: EstimatedMotion,
    remove_bias: bool,
) -> Compared:
    motion, notes = estimated
    pairs = dict(zip(ours.individuals, theirs.individuals, strict=True))
    clock = bool(np.isfinite(theirs.rate_hz))
    at = motion.reference_s(ours.times_s)
    inside = (at >= theirs.times_s[0]) & (at <= theirs.times_s[-1])
    ours, at = ours.at(inside), at[inside]
    x, states = _joints(ours, [one.ours for one in joints])
    y_all, y_states = _joints(theirs, [one.theirs for one in joints])
    y = sampled(theirs.times_s, y_all, y_states > 0, at)
    sure = np.isfinite(sampled(theirs.times_s, np.where((y_states == JointState.TRACKED)[..., None], y_all, np.nan),
                                y_states == JointState.TRACKED, at)).all(axis=3)  # fmt: skip
    states = np.where(sure, states, np.minimum(states, np.uint8(JointState.INFERRED)))
    known = np.all(np.isfinite(x), axis=3) & np.all(np.isfinite(y), axis=3)
    if known.sum() < 2:
        raise EvaluationError("the recording and the reference have no known joints at a common time")
    states = np.where(known, states, np.uint8(JointState.NOT_TRACKED))
    y_moved = apply(motion.T, y)
    errors = np.where(known[..., None], x - y_moved, np.nan)
    count = known.sum(axis=0)[..., None]
    biases = np.where(count > 0, np.where(known[..., None], errors, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    names, angles, reference_angles, angle_states = _angles(ours, theirs, at, joints, (x, y, states))
    return Compared(
        ours.kind, pairs, joints, motion, clock, notes, ours.times_s, at, states,
        np.where(known[..., None], x - y, np.nan), errors - biases if remove_bias else errors, biases, remove_bias,
        names, angles, reference_angles, angle_states,
    )  # fmt: skip


def _joints(one: Trajectories, terms: Sequence[Terms]) -> tuple[Float64, NDArray[np.uint8]]:
    found = [weighted(one.positions, one.states, one.keypoints, each) for each in terms]
    return np.stack([point for point, _ in found], axis=2), np.stack([state for _, state in found], axis=2)


def _angles(
    ours: Trajectories, theirs: Trajectories, at: Float64, joints: tuple[MatchedJoint, ...], sides: tuple[Any, Any, Any]
) -> tuple[tuple[str, ...], Float64, Float64, NDArray[np.uint8]]:
    """Return names, angles of both sides and states: those both state by name, and flexions from positions."""
    x, y, states = sides
    own = hinges(joints, ours.keypoints, ours.bones)
    stated = [name for name in ours.angle_names if name in theirs.angle_names]
    first, second = flexions(x, own), flexions(y, own)
    of_joints = [states[..., [one.parent, one.joint, one.child]].min(axis=-1) for one in own]
    names = tuple(f"{one.name} (angle)" for one in own)
    known = np.isfinite(first) & np.isfinite(second)
    flexed = np.stack(of_joints, axis=-1) if own else np.empty(known.shape, np.uint8)
    flexed = np.where(known, flexed, np.uint8(0))
    if not stated:
        return names, first, second, flexed
    mine = ours.angles[..., [ours.angle_names.index(name) for name in stated]]
    other = theirs.angles[..., [theirs.angle_names.index(name) for name in stated]]
    circle = sampled(theirs.times_s, np.stack([np.cos(other), np.sin(other)], axis=-1), np.isfinite(other), at)
    other = np.arctan2(circle[..., 1], circle[..., 0])
    own_angles = JointAngles.of(ours, with_sd=False)
    sure = own_angles.states[..., [own_angles.names.index(name) for name in stated]]
    sure = np.where(np.isfinite(mine) & np.isfinite(other), sure, np.uint8(JointState.NOT_TRACKED))
    return (
        (*stated, *names), np.concatenate([mine, first], axis=-1), np.concatenate([other, second], axis=-1),
        np.concatenate([sure, flexed], axis=-1).astype(np.uint8),
    )  # fmt: skip
