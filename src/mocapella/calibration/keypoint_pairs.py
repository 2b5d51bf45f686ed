"""Find the relative pose of two cameras, and the identities of people, from tracks of people's keypoints.

The tracks are compared in short passages of time. Five keypoints of one track in each camera give a hypothesis
(`geometry.essential`), which is scored by all passages: in each, the tracks of both cameras are matched so that most
keypoints agree. A hypothesis of two different people scores low, because their joints move differently.

Source: M. Fischler, R. Bolles, "Random sample consensus", Comm. ACM 24 (1981) 381; P. Torr, A. Zisserman, "MLESAC",
CVIU 78 (2000) 138, for the truncated score; K. Takahashi et al., "Human pose as calibration pattern", CVPR Workshops
(2018), for joints as points of a calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.stepwise import Steps
from mocapella.geometry.essential import (
    POINTS,
    angles_between,
    best_pose,
    essential_of,
    five_point,
    refine_pose,
    sampson_distance,
    triangulate_pair,
)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Matches = dict[int, list[tuple[int, int]]]
"""Matched tracks of two cameras, by passage."""

SCALE: Final = 0.015
"""Distance from the epipolar line beyond which a keypoint does not agree, in units of the focal length."""
CHANCE: Final = 0.35
"""Score of a keypoint that two different people reach by chance, which is taken off."""
_HYPOTHESES: Final = 1500
"""Number of hypotheses of a pair of cameras, over all pairs of tracks."""
_TRACK_PAIRS: Final = 40
"""Most pairs of tracks that give hypotheses: the longest ones."""
_TRIED: Final = 150
"""Number of points that rank the hypotheses of one pair of tracks."""
_KEPT: Final = 4
"""Number of hypotheses of a pair of tracks that are scored by all passages."""
_REFINED: Final = 6
"""Number of hypotheses of a pair of cameras that are refined: the best ones."""
_QUICK_AT_ONCE: Final = 20
"""Number of hypotheses that are scored in one step."""
_FEWEST: Final = 40
"""Least number of common points of two tracks, or of a matched passage."""


class SampledTracks(msgspec.Struct, frozen=True, eq=False):
    """The tracks of one camera at common instants.

    Attributes:
        pixels: (tracks, instants, 26, 2) keypoints [px]; NaN where not seen.
        velocities: (tracks, instants, 26, 2) [px/s].
        sizes_px: (tracks, instants) sizes of the people in the image [px].
    """

    pixels: Float64
    velocities: Float64
    sizes_px: Float64


class CameraPair(msgspec.Struct, frozen=True, eq=False):
    """The relative pose of two cameras.

    Attributes:
        T_b_a: (4, 4), with a translation of length 1.
        score: number of keypoints that agree, above the number by chance.
        share: share of the matched keypoints that agree.
        angle_rad: median angle at which the rays of agreeing keypoints meet [rad].
        matches: pairs of tracks of one person.
    """

    T_b_a: Float64
    score: float
    share: float
    angle_rad: float
    matches: Matches


@dataclass(frozen=True)
class _Common:
    """All pairs of directions of all tracks that overlap, sorted by passage and track of the first camera.

    Attributes:
        a, b: (n, 2) directions.
        begins: (groups,) index of the first point of each group, which is a passage and two tracks.
        counts: (groups,) points of each group.
        groups: (groups, 3) passage, track of the first camera, track of the second.
    """

    a: Float64
    b: Float64
    begins: Int64
    counts: Int64
    groups: Int64


def finding_pair(a: Float64, b: Float64, passages: Int64, rng: np.random.Generator) -> Steps[CameraPair | None]:
    """Return the steps that find the relative pose of two cameras; None if they have too few common people.

    Args:
        a: (tracks, instants, 26, 2) directions of the keypoints of the first camera; NaN where not seen.
        b: (tracks, instants, 26, 2) of the second camera, at the same instants.
        passages: (instants,) number of the passage of each instant.
        rng: random numbers of the samples.
    """
    common = _common(a, b, passages)
    if common is None:
        return None
    candidates = list[Float64]()
    for pair in _track_pairs(common):
        yield
        candidates += _hypotheses(common, pair, rng)
    if not candidates:
        return None
    scores = np.zeros(len(candidates))
    for k, E in enumerate(candidates):
        if k % _QUICK_AT_ONCE == 0:
            yield
        scores[k] = _quick(common, E)
    found = list[CameraPair]()
    for k in np.argsort(-scores, kind="stable")[:_REFINED]:
        yield
        found.append((yield from _refined(common, candidates[k])))
    best = max(found, key=lambda pair: pair.score)
    return best if best.score > 0 else None


def rescored(T_b_a: Float64, a: Float64, b: Float64, passages: Int64) -> CameraPair | None:
    """Return a given relative pose with its score and matches for directions as of `finding_pair`."""
    common = _common(a, b, passages)
    if common is None:
        return None
    T = T_b_a.copy()
    T[:3, 3] /= max(float(np.linalg.norm(T[:3, 3])), 1e-12)
    return _judged(common, T)


def _common(a: Float64, b: Float64, passages: Int64) -> _Common | None:
    rows_a, rows_b, groups = [], [], []
    for passage in np.unique(passages):
        at = passages == passage
        pa, pb = a[:, at], b[:, at]
        for i in np.flatnonzero(np.isfinite(pa).any(axis=(1, 2, 3))):
            for j in np.flatnonzero(np.isfinite(pb).any(axis=(1, 2, 3))):
                seen = np.isfinite(pa[i] + pb[j]).all(axis=-1)
                if seen.sum() >= _FEWEST:
                    rows_a.append(pa[i][seen])
                    rows_b.append(pb[j][seen])
                    groups.append((int(passage), int(i), int(j)))
    if not groups:
        return None
    counts = np.array([len(rows) for rows in rows_a])
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return _Common(np.concatenate(rows_a), np.concatenate(rows_b), begins, counts, np.array(groups))


def _track_pairs(common: _Common) -> list[Int64]:
    """Return the points of each pair of tracks, those with most points first."""
    pairs: dict[tuple[int, int], list[int]] = {}
    for k, (_, i, j) in enumerate(common.groups.tolist()):
        pairs.setdefault((i, j), []).append(k)
    of = [_points_of(common, groups) for groups in pairs.values()]
    return sorted(of, key=lambda points: -len(points))[:_TRACK_PAIRS]


def _hypotheses(common: _Common, points: Int64, rng: np.random.Generator) -> list[Float64]:
    """Return the essential matrices that most points of one pair of tracks agree with."""
    samples = max(50, _HYPOTHESES // _TRACK_PAIRS)
    chosen = points[rng.integers(0, len(points), (samples, POINTS))]
    E, _ = five_point(common.a[chosen], common.b[chosen])
    if not len(E):
        return []
    tried = points[rng.integers(0, len(points), _TRIED)]
    gains = _gain(sampson_distance(E, common.a[tried], common.b[tried])).sum(axis=1)
    return list(E[np.argsort(-gains, kind="stable")[:_KEPT]])


def _gain(distance: Float64) -> Float64:
    return np.asarray(np.clip(1.0 - (distance / SCALE) ** 2, 0.0, None) - CHANCE)


def _group_scores(common: _Common, E: Float64) -> Float64:
    """Return the score (groups,) of each passage of two tracks; 0 if they agree no better than by chance."""
    gains = np.add.reduceat(_gain(sampson_distance(E, common.a, common.b)), common.begins)
    return np.maximum(gains, 0.0)


def _quick(common: _Common, E: Float64) -> float:
    """Return an upper bound of the score: each track of the first camera takes its best match."""
    scores = _group_scores(common, E)
    key = common.groups[:, 0] * 10_000 + common.groups[:, 1]
    begins = np.flatnonzero(np.r_[True, np.diff(key) != 0])
    return float(np.maximum.reduceat(scores, begins).sum())


def _matched(common: _Common, E: Float64) -> tuple[float, list[int]]:
    """Match the tracks of each passage one to one; return the score and the matched groups."""
    from scipy.optimize import linear_sum_assignment

    scores, kept, total = _group_scores(common, E), list[int](), 0.0
    for passage in np.unique(common.groups[:, 0]):
        here = np.flatnonzero((common.groups[:, 0] == passage) & (scores > 0))
        rows, at_row = np.unique(common.groups[here, 1], return_inverse=True)
        columns, at_column = np.unique(common.groups[here, 2], return_inverse=True)
        table = np.zeros((len(rows), len(columns)))
        table[at_row, at_column] = scores[here]
        chosen = set(zip(*(x.tolist() for x in linear_sum_assignment(table, maximize=True)), strict=True))
        kept += [int(k) for k, r, c in zip(here, at_row, at_column, strict=True) if (r, c) in chosen]
        total += float(sum(table[r, c] for r, c in chosen))
    return total, kept


def _points_of(common: _Common, groups: list[int]) -> Int64:
    if not groups:
        return np.zeros(0, np.int64)
    return np.concatenate([np.arange(common.begins[k], common.begins[k] + common.counts[k]) for k in groups])


def _refined(common: _Common, E: Float64) -> Steps[CameraPair]:
    _, groups = _matched(common, E)
    points = _points_of(common, groups)
    if len(points) < _FEWEST:
        return CameraPair(np.eye(4), 0.0, 0.0, 0.0, {})
    T = best_pose(E, common.a[points], common.b[points])[0]
    for _ in range(2):
        yield
        T = refine_pose(T, common.a[points], common.b[points], SCALE / 2)
        points = _points_of(common, _matched(common, essential_of(T))[1])
        if len(points) < _FEWEST:
            return CameraPair(np.eye(4), 0.0, 0.0, 0.0, {})
        T = best_pose(essential_of(T), common.a[points], common.b[points])[0]
    return _judged(common, T)


def _judged(common: _Common, T_b_a: Float64) -> CameraPair:
    score, groups = _matched(common, essential_of(T_b_a))
    points, matches = _points_of(common, groups), Matches()
    for k in groups:
        passage, i, j = common.groups[k].tolist()
        matches.setdefault(passage, []).append((i, j))
    if not len(points):
        return CameraPair(T_b_a, 0.0, 0.0, 0.0, {})
    a, b = common.a[points], common.b[points]
    near = np.abs(sampson_distance(essential_of(T_b_a), a, b)) < SCALE
    where, depths = triangulate_pair(T_b_a, a[near], b[near])
    front = np.asarray((depths > 0).all(axis=1))
    angle = float(np.median(angles_between(T_b_a, where[front]))) if front.any() else 0.0
    return CameraPair(T_b_a, score * float(front.mean() if len(front) else 0.0), float(near.mean()), angle, matches)
