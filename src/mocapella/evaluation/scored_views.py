"""Transform the two views of every pair by a method's estimates, which are one rigid motion for each sensor.

A method estimates motions, clock offsets and label swaps before the pair's frames arrive. They are applied to the raw
joints here.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.fused_metrics import facing_yaw
from mocapella.evaluation.protocol import JointBias
from mocapella.evaluation.study_pairs import Pairs, StudyFrames, StudySession
from mocapella.geometry import angles, rigid
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

LONGEST_GAP: Final = 0.12
"""Largest interval between two frames for interpolation [s]."""
VELOCITY_OVER: Final = 0.2
"""Interval into the past over which the fused person's velocity is measured [s]."""
TOPOLOGY: Final = topology("kinect_v2")
_ROOT = TOPOLOGY.parts["root"]


class ScoredViews(msgspec.Struct, frozen=True, eq=False):
    """Both views of every pair in the reference sensor's camera space.

    Attributes:
        raw_labels: (pairs, 2, joints, 3) with the sensors' labels [m]; NaN where missing or unknown.
        repaired: (pairs, 2, joints, 3) with left and right as the method decided before the pair arrived [m].
        swaps_per_min: number of changes of that decision per minute, summed over both sensors.
    """

    raw_labels: Float64
    repaired: Float64
    swaps_per_min: float = 0.0


def logged_views(session: StudySession, pairs: Pairs) -> ScoredViews:
    """Return both views of each pair as logged in 2015: the output of the thesis' own method.

    Args:
        session: the study log.
        pairs: the pairs of rows to return.

    Returns:
        Positions in the reference sensor's camera space [m], as logged. ``raw_labels`` and ``repaired`` are one array
        (pairs, 2, joints, 3), because that method swaps no labels; ``swaps_per_min`` is 0.
    """
    rows = session.log.positions[pairs.rows].astype(np.float64)
    return ScoredViews(rows, rows)


def known_before(frames: StudyFrames, pairs: Pairs, *, frozen: bool = False) -> Int64:
    """Return for each pair the index (pairs,) of the last `CausalRun` entry before either frame of the pair arrives.

    Args:
        frames: input frames of the run.
        pairs: pairs whose frames are all in ``frames``.
        frozen: use the entry before the first of these pairs for all of them.
    """
    first = frames.of_row[pairs.rows].min(axis=1)
    return np.full(len(first), first.min(initial=len(frames.arrivals))) if frozen else first


def views_of(session: StudySession, run: CausalRun, pairs: Pairs, known: Int64, labels: Int64) -> ScoredViews:
    """Return both views of each pair under the method's estimates.

    Args:
        session: the recorded session.
        run: the method's estimates over the session.
        pairs: the pairs to score.
        known: (pairs,) index of the run's entry whose motions and clock offsets are applied.
        labels: (pairs,) index of the entry whose label swaps are applied.
    """
    seen = seen_views(session, run, pairs, known, labels)
    joints = seen.joints
    if run.joint_bias is not None:
        names = np.array(run.sensors)[session.sensor[pairs.rows]]
        joints = joints + _bias(run.joint_bias, names, seen, asked_about(session, pairs, seen))
    views = rigid.apply(seen.T, joints)
    mirrored = views[:, :, TOPOLOGY.mirror]
    minutes = max(float(np.ptp(session.at_s[pairs.rows])) / 60, 1e-9)
    return ScoredViews(
        views,
        np.where(seen.swapped[..., None, None], mirrored, views),
        swaps_per_min=_changes(seen.swapped, pairs.person) / minutes,
    )


def seen_views(session: StudySession, run: CausalRun, pairs: Pairs, known: Int64, labels: Int64) -> SeenViews:
    """Interpolate the later view of each pair to the earlier one's instant, and select the motions and label swaps.

    They are not applied yet, and the joint bias is not added: `views_of` does both. The views are unchanged where a
    clock offset is not known (NaN), or frames for the interpolation are missing.

    Args:
        session: the recorded session.
        run: the method's estimates over the session.
        pairs: the pairs to score.
        known: (pairs,) index of the run's entry that gives motions and clock offsets.
        labels: (pairs,) index of the entry that gives label swaps.
    """
    sensor = session.sensor[pairs.rows]
    swapped = np.array(
        [
            [(run.sensors[s], person) in run.swapped[k] for s in both]
            for k, both, person in zip(labels.tolist(), sensor.tolist(), pairs.person.tolist(), strict=True)
        ]
    ).reshape(-1, 2)
    joints = _at_one_instant(session, pairs, run.time_offset_s[known[:, None], sensor])
    return SeenViews(joints, run.T_reference_sensor[known[:, None], sensor], swapped)


def _changes(swapped: Bool, person: Int64) -> int:
    """Count the changes of label swaps (pairs, 2) from one pair of a person to the next, over both sensors."""
    return sum(int(np.diff(swapped[person == one], axis=0).sum()) for one in np.unique(person))


def _at_one_instant(session: StudySession, pairs: Pairs, offset_s: Float64) -> Float64:
    """Interpolate the later of the two views to the instant of the earlier one: (pairs, 2, joints, 3).

    It is interpolated between that sensor's own frames, none of them newer than the pair's. Where an offset is not
    declared (NaN), or the frames around the instant are more than `LONGEST_GAP` apart, the view is unchanged. A
    joint is missing exactly where it is missing in the pair's own frame.
    """
    own = session.raw[pairs.rows]
    at_s = session.at_s[pairs.rows] + offset_s
    out = own.copy()
    later = at_s > at_s.min(axis=1, keepdims=True)
    for sensor in range(len(session.replay.sensors)):
        for person in np.unique(pairs.person).tolist():
            track = np.flatnonzero((session.sensor == sensor) & (session.log.person_id == person))
            times, first = np.unique(session.at_s[track], return_index=True)
            track = track[first]
            wanted = later & (session.sensor[pairs.rows] == sensor) & (pairs.person[:, None] == person)
            pair, which = np.nonzero(wanted)
            instant = at_s.min(axis=1)[pair] - offset_s[pair, which]
            after = np.minimum(np.searchsorted(times, instant), len(times) - 1)
            before = np.maximum(after - 1, 0)
            gap = times[after] - times[before]
            share = (instant - times[before]) / np.where(gap > 0, gap, 1)
            usable = (gap > 0) & (gap <= LONGEST_GAP) & (share >= 0) & (share <= 1)
            usable &= times[after] <= session.at_s[pairs.rows[pair, which]]
            pair, which, share = pair[usable], which[usable], share[usable, None, None]
            between = (1 - share) * session.raw[track[before[usable]]] + share * session.raw[track[after[usable]]]
            mine = own[pair, which]
            out[pair, which] = np.where(np.isfinite(mine) & np.isfinite(between), between, mine)
    return out


class SeenViews(msgspec.Struct, frozen=True, eq=False):
    """Both views of every pair in their own camera spaces, with the estimates that apply to them.

    Attributes:
        joints: (pairs, 2, joints, 3) with the sensors' labels, in each sensor's own camera space [m].
        T: (pairs, 2, 4, 4) from each sensor's camera space to the reference sensor's.
        swapped: (pairs, 2) whether the method swaps left and right.
    """

    joints: Float64
    T: Float64
    swapped: Bool


class Asked(msgspec.Struct, frozen=True, eq=False):
    """Inputs of the joint bias regression for each view of a pair: state of the fused person relative to the sensor.

    Attributes:
        facing: (pairs, 2) yaw of the fused person, from the direction towards each sensor [rad]; NaN without a fused
            person.
        position: (pairs, 2, 3) position of the fused SpineBase, in each sensor's camera space [m].
        velocity: (pairs, 2, 3) velocity of that joint, in the same space [m/s]; 0 if unknown.
    """

    facing: Float64
    position: Float64
    velocity: Float64


def asked_about(session: StudySession, pairs: Pairs, seen: SeenViews) -> Asked:
    """Compute the arguments of the joint bias from the fused person: the mean of both views, with corrected labels.

    Args:
        session: the recorded session.
        pairs: the pairs to score.
        seen: views and estimates of these pairs, by `seen_views`.
    """
    views = rigid.apply(seen.T, seen.joints)
    views = np.where(seen.swapped[..., None, None], views[:, :, TOPOLOGY.mirror], views)
    fused = views.mean(axis=1)
    at_s = session.at_s[pairs.rows].max(axis=1)
    velocity = np.zeros((len(pairs), 3))
    for person in np.unique(pairs.person).tolist():
        mine = np.flatnonzero(pairs.person == person)
        before = mine[np.maximum(np.searchsorted(at_s[mine], at_s[mine] - VELOCITY_OVER, side="right") - 1, 0)]
        step_s = at_s[mine] - at_s[before]
        moved = fused[mine, _ROOT] - fused[before, _ROOT]
        moving = (step_s > 0)[:, None] & np.isfinite(moved)
        velocity[mine] = np.where(moving, moved / np.where(step_s > 0, step_s, 1)[:, None], 0.0)
    T_sensor_reference = rigid.inverse(seen.T)
    person_there = rigid.apply(T_sensor_reference, fused[:, None])
    root = person_there[..., _ROOT, :]
    facing = angles.wrap(facing_yaw(person_there) - np.arctan2(-root[..., 0], -root[..., 2]))
    there = (T_sensor_reference[..., :3, :3] @ velocity[:, None, :, None])[..., 0]
    return Asked(facing, root, there)


def _bias(joint_bias: JointBias, names: NDArray[np.str_], seen: SeenViews, asked: Asked) -> Float64:
    """Return the declared bias (pairs, 2, joints, 3) of each view, in its labels; 0 without a fused person."""
    out = np.zeros_like(seen.joints)
    for view in zip(*np.nonzero(np.isfinite(asked.facing)), strict=True):
        name = str(names[view])
        added = np.asarray(
            joint_bias(name, float(asked.facing[view]), asked.position[view], asked.velocity[view]), dtype=np.float64
        )
        if added.shape != seen.joints.shape[2:] or not np.isfinite(added).all():
            raise EvaluationError(f"the joint bias of {name} is not (joints, 3) finite numbers")
        out[view] = added[list(TOPOLOGY.mirror)] if seen.swapped[view] else added
    return out
