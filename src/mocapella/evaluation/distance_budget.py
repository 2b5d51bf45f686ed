"""Budget of Δd: how far two sensors' views of a person would be apart if one cause of their distance were known.

Each figure uses information that no method has, such as the rigid motion that fits the scored pairs themselves. So it
bounds what a better estimate of that cause could gain.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.scored_views import TOPOLOGY, asked_about, known_before, seen_views, views_of
from mocapella.evaluation.study_pairs import Pairs, StudySession
from mocapella.fusion.joint_bias import JointBiasModel, body_view
from mocapella.fusion.joint_bias_training import ViewPairs, second_to_first, train
from mocapella.geometry.alignment import robust_align
from mocapella.geometry.rigid import apply

Float64 = NDArray[np.float64]

LASTING_S: Final = 0.5
"""Duration of the moving mean of the difference of two views; slower differences remain [s]."""
OFFSETS_S: Final = np.arange(-0.06, 0.0601, 0.01)
"""Clock offsets that are tried, beyond the estimated one [s]."""
FASTEST_M_S: Final = 3.0
"""Bound of a joint's speed in the shift of views by a clock offset [m/s]."""
_MIRROR: Final = list(TOPOLOGY.mirror)
_ITERATIONS: Final = 8


class DistanceBudget(msgspec.Struct, frozen=True):
    """Mean Δd of pairs of views, as scored and with one cause removed [m].

    Attributes:
        scored: with the method's estimates.
        labels: with left and right exchanged in the pairs that are then nearer.
        offset: with the clock offset of `OFFSETS_S` that fits the pairs best.
        motion: with the rigid motion between the sensors that fits the pairs best.
        each_motion: with the rigid motion that fits each pair best: what remains is a difference of shape.
        own_bias: with a joint bias and a motion that were fitted to these pairs.
        earlier_bias: of the second half of the pairs, with a joint bias that was fitted to the first half.
        second_half: of the second half of the pairs, with the method's estimates: what ``earlier_bias`` compares with.
        lasting: length of the difference's moving mean over `LASTING_S`.
        fast: distance of the difference from that mean: noise that a smoother could remove.
    """

    scored: float
    labels: float
    offset: float
    motion: float
    each_motion: float
    own_bias: float
    earlier_bias: float
    second_half: float
    lasting: float
    fast: float


def distance_budget(session: StudySession, run: CausalRun, pairs: Pairs) -> DistanceBudget:
    """Compute the budget of pairs of one person before two sensors.

    Args:
        session: the study log.
        run: a method's estimates over the session.
        pairs: the pairs to score, in the order of time.

    Raises:
        InputError: fewer than two pairs, or several people.
    """
    if len(pairs) < 2 or len(np.unique(pairs.person)) > 1:
        raise InputError("has no budget of Δd", file=session.log.source, fix="it wants two pairs of one person or more")
    known = known_before(session.frames, pairs)
    order = session.sensor[pairs.rows].argsort(axis=1)
    views = views_of(session, run, pairs, known, known).repaired
    first, second = np.moveaxis(np.take_along_axis(views, order[..., None, None], axis=1), 1, 0)
    own, earlier = _bias_budget(session, run, pairs, order)
    half = len(pairs) // 2
    return DistanceBudget(
        second_half=mean_distance(first[half:], second[half:]),
        own_bias=own,
        earlier_bias=earlier,
        **views_budget(first, second, session.at_s[pairs.rows].max(axis=1)),
    )


def views_budget(first: Float64, second: Float64, at_s: Float64) -> dict[str, float]:
    """Compute the figures of `DistanceBudget` that need the aligned views alone, by their names [m].

    Args:
        first, second: (pairs, joints, 3) views of the reference sensor and the other one, in one space [m].
        at_s: (pairs,) times, which do not fall [s].
    """
    nearer = np.fmin(_of_each(first, second), _of_each(first, second[:, _MIRROR]))
    T = robust_align(first.reshape(-1, 3), second.reshape(-1, 3))
    each = robust_align(first, second, iterations=_ITERATIONS)
    apart = first - second
    velocity = _velocity((first + second) / 2, at_s)
    lasting = moving_mean(apart, at_s)
    return {
        "scored": mean_distance(first, second),
        "labels": float(np.nanmean(nearer)),
        "offset": min(mean_distance(apart, offset_s * velocity) for offset_s in OFFSETS_S.tolist()),
        "motion": mean_distance(first, apply(T, second)),
        "each_motion": mean_distance(first, apply(each, second)),
        "lasting": float(np.nanmean(np.linalg.norm(lasting, axis=-1))),
        "fast": mean_distance(apart, lasting),
    }


def mean_distance(first: Float64, second: Float64) -> float:
    """Return the mean distance of the finite points of (..., 3) [m]."""
    return float(np.nanmean(np.linalg.norm(first - second, axis=-1)))


def moving_mean(values: Float64, at_s: Float64) -> Float64:
    """Return the mean of ``values`` (n, …) over the interval of `LASTING_S` about each time; NaN where no value is.

    Args:
        values: (n, …); NaN counts for nothing.
        at_s: (n,) times, which do not fall [s].
    """
    begin = np.searchsorted(at_s, at_s - LASTING_S / 2, side="left")
    end = np.searchsorted(at_s, at_s + LASTING_S / 2, side="right")
    return np.stack([_mean(values[i:k]) for i, k in zip(begin.tolist(), end.tolist(), strict=True)])


def _mean(values: Float64) -> Float64:
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


def _velocity(positions: Float64, at_s: Float64) -> Float64:
    """Return velocities (pairs, joints, 3) [m/s], bounded by `FASTEST_M_S` along each axis; 0 where unknown."""
    span_s = at_s[2:] - at_s[:-2]
    inner = (positions[2:] - positions[:-2]) / np.where(span_s > 0, span_s, np.inf)[:, None, None]
    velocity = np.zeros_like(positions)
    velocity[1:-1] = inner
    return np.clip(np.nan_to_num(velocity), -FASTEST_M_S, FASTEST_M_S)


def _of_each(first: Float64, second: Float64) -> Float64:
    """Return the mean distance of the joints of each pair (pairs,) [m]; NaN without a joint in both views."""
    return _mean(np.linalg.norm(first - second, axis=-1).T)


def _bias_budget(session: StudySession, run: CausalRun, pairs: Pairs, order: NDArray[np.int64]) -> tuple[float, float]:
    """Return `DistanceBudget.own_bias` and `DistanceBudget.earlier_bias` [m]."""
    known = known_before(session.frames, pairs)
    seen = seen_views(session, run, pairs, known, known)
    asked = asked_about(session, pairs, seen)
    agreed = np.where(seen.swapped[..., None, None], seen.joints[:, :, _MIRROR], seen.joints)
    each = np.arange(len(pairs))[:, None]
    facing, position, velocity = (values[each, order] for values in (asked.facing, asked.position, asked.velocity))
    views = ViewPairs(agreed[each, order], facing, position, velocity, np.ones(len(pairs)))
    half = len(pairs) // 2
    first, second = (
        ViewPairs(*(getattr(views, name)[part] for name in ViewPairs.__struct_fields__))
        for part in (slice(None, half), slice(half, None))
    )
    return fitted_distance(views, views), fitted_distance(first, second)


def fitted_distance(learnt_on: ViewPairs, scored: ViewPairs) -> float:
    """Return the mean Δd of pairs with a joint bias that was fitted to others, and their own best rigid motion [m].

    Args:
        learnt_on: pairs that the bias is fitted to.
        scored: pairs to score; they may be the same.

    Raises:
        InputError: no pair to learn from has a known facing.
    """
    model = JointBiasModel(TOPOLOGY.name, train([learnt_on], TOPOLOGY))
    of_view, R = body_view(scored.facing, scored.position, scored.velocity)
    T = second_to_first(scored, of_view, R, model.weights)
    bias = np.tensordot(of_view, model.weights, axes=1) @ np.swapaxes(R, -1, -2)
    views = scored.positions - np.where(np.isfinite(bias), bias, 0.0)
    return mean_distance(views[:, 0], apply(T, views[:, 1]))
