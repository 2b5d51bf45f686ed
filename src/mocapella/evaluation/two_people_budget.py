"""Budget of Δd of two people near each other: what remains if one cause of the views' distance were known.

Each figure is the median over pairs of views, as in `mocapella.evaluation.interactions`. A figure of *the other half*
learns from the other half of the session, so it bounds what an estimate from past frames could gain. All others use the
scored pairs themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.interactions import distance_figures
from mocapella.evaluation.scored_views import TOPOLOGY, asked_about, known_before, seen_views, views_of
from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry.alignment import robust_align
from mocapella.geometry.rigid import apply, rotation_about_y

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

_MIRROR = list(TOPOLOGY.mirror)
_ITERATIONS = 8


class NearViews(msgspec.Struct, frozen=True, eq=False):
    """Both views of the pairs of a session, aligned and with the joint bias subtracted.

    Attributes:
        positions: (pairs, 2, joints, 3) the reference sensor's view first, in its space [m]; NaN where missing.
        yaw: (pairs,) yaw of the fused person in the same space [rad].
        person: (pairs,) Person_Id.
        at_s: (pairs,) time of the later view [s].
    """

    positions: Float64
    yaw: Float64
    person: NDArray[np.int64]
    at_s: Float64

    def apart(self) -> Float64:
        """Difference of both views (pairs, joints, 3) along the body's axes: left, up, ahead [m]."""
        return (self.positions[:, 0] - self.positions[:, 1]) @ rotation_about_y(self.yaw)


class TwoPeopleBudget(msgspec.Struct, frozen=True):
    """Median Δd of pairs of views, as scored and with one cause removed [m].

    Attributes:
        scored: with the method's estimates.
        labels: with left and right exchanged in the pairs that are then nearer.
        motion: with the rigid motion between the sensors that fits the pairs best.
        motion_of_other_half: with the rigid motion that fits the other half of the session best.
        own_motion: with the rigid motion that fits each person's pairs best.
        each_motion: with the rigid motion that fits each pair best: what remains is a difference of shape.
        constant: without each joint's median difference along the body's axes.
        constant_of_other_half: the same, with the medians of the other half.
        own_constant: without each joint's median difference of the person.
        own_constant_of_other_half: the same, with the person's medians in the other half.
        constant_of_other_person: without each joint's median difference of the other people.
    """

    scored: float
    labels: float
    motion: float
    motion_of_other_half: float
    own_motion: float
    each_motion: float
    constant: float
    constant_of_other_half: float
    own_constant: float
    own_constant_of_other_half: float
    constant_of_other_person: float


def near_views(session: StudySession, run: CausalRun) -> NearViews:
    """Return the views of all pairs of a session under a method's estimates.

    Args:
        session: the study log, of two sensors.
        run: the method's estimates over it.
    """
    pairs = session.pairs.where(session.sensor[session.pairs.rows].sum(axis=1) == 1)
    known = known_before(session.frames, pairs)
    order = session.sensor[pairs.rows].argsort(axis=1)
    each = np.arange(len(pairs))[:, None]
    views = views_of(session, run, pairs, known, known).repaired[each, order]
    asked = asked_about(session, pairs, seen_views(session, run, pairs, known, known))
    position, facing = asked.position[each, order][:, 0], asked.facing[each, order][:, 0]
    yaw = facing + np.arctan2(-position[:, 0], -position[:, 2])
    return NearViews(views, yaw, pairs.person, session.at_s[pairs.rows].max(axis=1))


def two_people_budget(views: NearViews) -> TwoPeopleBudget:
    """Compute the budget of a session; pairs without a pair to learn from do not count, and without any, it is NaN.

    Args:
        views: the session's views.
    """
    first, second = views.positions[:, 0], views.positions[:, 1]
    apart, late = views.apart(), views.at_s > np.median(views.at_s)
    all_of = np.zeros(len(late), dtype=np.int64)
    half, half_of_person = late.astype(np.int64), 2 * _numbered(views.person) + late
    other_half, person = half ^ 1, _numbered(views.person)
    nearer = np.fmin(_of_pairs(first - second), _of_pairs(first - second[:, _MIRROR]))

    def moved(scored: NDArray[np.int64], learnt: NDArray[np.int64]) -> float:
        return _median(_each_group(first, second, scored, learnt, _moved))

    def without(scored: NDArray[np.int64], learnt: NDArray[np.int64]) -> float:
        return _median(_each_group(apart, np.zeros_like(apart), scored, learnt, _without_constant))

    return TwoPeopleBudget(
        scored=_median(apart),
        labels=float(np.nanmedian(nearer)),
        motion=moved(all_of, all_of),
        motion_of_other_half=moved(half, other_half),
        own_motion=moved(person, person),
        each_motion=_median(first - apply(robust_align(first, second, iterations=_ITERATIONS), second)),
        constant=without(all_of, all_of),
        constant_of_other_half=without(half, other_half),
        own_constant=without(person, person),
        own_constant_of_other_half=without(half_of_person, half_of_person ^ 1),
        constant_of_other_person=without(person, _next_of(person)),
    )


def _numbered(person: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(np.unique(person, return_inverse=True)[1], dtype=np.int64).reshape(-1)


def _next_of(person: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((person + 1) % (person.max(initial=0) + 1))


def _each_group(
    first: Float64,
    second: Float64,
    scored: NDArray[np.int64],
    learnt: NDArray[np.int64],
    remains: Callable[[Float64, Float64, Bool, Bool], Float64],
) -> Float64:
    """Return what remains (pairs, joints, 3) of each group of pairs by what is learnt of another group [m].

    Args:
        first, second: (pairs, joints, 3) views, or differences of views [m].
        scored: (pairs,) group in which each pair is scored.
        learnt: (pairs,) group for which each pair is learnt from.
        remains: function of ``first``, ``second`` and the masks (pairs,) of scored and learnt pairs; returns the
            difference that remains (scored pairs, joints, 3).
    """
    out = np.full_like(first, np.nan)
    for group in np.unique(scored).tolist():
        of_group, of_others = scored == group, learnt == group
        if of_others.any():
            out[of_group] = remains(first, second, of_group, of_others)
    return out


def _moved(first: Float64, second: Float64, scored: Bool, learnt: Bool) -> Float64:
    T = robust_align(first[learnt].reshape(-1, 3), second[learnt].reshape(-1, 3))
    return np.asarray(first[scored] - apply(T, second[scored]))


def _without_constant(first: Float64, second: Float64, scored: Bool, learnt: Bool) -> Float64:
    apart = first - second
    known = np.isfinite(apart[learnt]).any(axis=(0, 2))
    out = np.full_like(apart[scored], np.nan)
    out[:, known] = apart[scored][:, known] - np.nanmedian(apart[learnt][:, known], axis=0)
    return out


def _of_pairs(apart: Float64) -> Float64:
    """Return the mean length over the joints (pairs,) [m]; NaN without a joint."""
    length = np.linalg.norm(apart, axis=-1)
    known = np.isfinite(length)
    return np.asarray(np.where(known, length, 0.0).sum(axis=1) / np.where(known.any(axis=1), known.sum(axis=1), np.nan))


def _median(apart: Float64) -> float:
    return distance_figures(np.linalg.norm(apart, axis=-1))["median_cm"] / 100
