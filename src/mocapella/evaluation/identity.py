"""Identity metrics against ground truth: HOTA, IDF1 and identity switches.

Ground truth and result are sequences of frames; each has the ids and positions of people. A true and a detected person
have a similarity within 0 … 1; `similarity` computes it from the distance between two skeletons.

Sources: Luiten et al., *HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking*, IJCV 2021, sections 5 and 6
(α from 0.05 to 0.95); Ristani et al., *Performance Measures and a Data Set for Multi-Target, Multi-Camera Tracking*,
ECCV workshops 2016, section 3 (IDF1); Bernardin and Stiefelhagen, *Evaluating Multiple Object Tracking Performance:
The CLEAR MOT Metrics*, 2008, section 2.1 (identity switches).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Float64 = NDArray[np.float64]

ALPHAS: Final = tuple(round(0.05 * i, 2) for i in range(1, 20))
ZERO_AT: Final = 1.0
"""Distance of two skeletons with similarity 0 [m]; half of it is a similarity of one half."""
_EPSILON = float(np.finfo(np.float64).eps)


class IdentityFrame(msgspec.Struct, frozen=True, eq=False):
    """True and found people of one frame.

    Attributes:
        true_ids: (true people,) ids of the true people.
        found_ids: (found people,) ids that the tracker gave.
        similarity: (true people, found people) similarity of each pair, from 0 to 1.
    """

    true_ids: tuple[int, ...]
    found_ids: tuple[int, ...]
    similarity: Float64


class Hota(msgspec.Struct, frozen=True):
    """Means over `ALPHAS`, each from 0 to 1.

    Attributes:
        hota: HOTA.
        detection: detection accuracy, DetA.
        association: association accuracy, AssA.
    """

    hota: float
    detection: float
    association: float


def similarity(true: Float64, found: Float64, zero_at: float = ZERO_AT) -> Float64:
    """Return max(0, 1 − d / zero_at), d the mean distance of the joints that both have; 0 if there are none.

    Args:
        true: (true people, joints, 3) [m]; NaN where a joint is not known.
        found: (found people, joints, 3) [m]; NaN where not tracked.
        zero_at: distance of similarity 0 [m].

    Returns:
        (true people, found people) similarities, 0 to 1.
    """
    apart = np.linalg.norm(true[:, None] - found[None], axis=-1)
    both = np.isfinite(apart)
    mean = np.where(both, apart, 0.0).sum(axis=-1) / np.maximum(both.sum(axis=-1), 1)
    return np.where(both.any(axis=-1), np.maximum(0.0, 1 - mean / zero_at), 0.0)


def hota(frames: Sequence[IdentityFrame], alphas: Sequence[float] = ALPHAS) -> Hota:
    """Compute HOTA over all frames; it is 1 if there are neither true nor found people.

    In each frame true and found people are matched one to one so that similarity times the global alignment of their
    ids is greatest; a match counts at α if its similarity is at least α.

    Args:
        frames: all frames of the sequence.
        alphas: the values of α, over which the result is averaged.
    """
    true, found = _index([f.true_ids for f in frames]), _index([f.found_ids for f in frames])
    if not true and not found:
        return Hota(1.0, 1.0, 1.0)
    potential, true_count, found_count = np.zeros((len(true), len(found))), np.zeros(len(true)), np.zeros(len(found))
    places = [([true[i] for i in f.true_ids], [found[i] for i in f.found_ids]) for f in frames]
    for frame, (rows, columns) in zip(frames, places, strict=True):
        s = frame.similarity
        union = s.sum(axis=0)[None] + s.sum(axis=1)[:, None] - s
        potential[np.ix_(rows, columns)] += np.where(union > _EPSILON, s / np.where(union > _EPSILON, union, 1), 0.0)
        true_count[rows] += 1
        found_count[columns] += 1
    alignment = potential / np.maximum(true_count[:, None] + found_count[None] - potential, _EPSILON)
    matches = np.zeros((len(alphas), len(true), len(found)))
    for frame, (rows, columns) in zip(frames, places, strict=True):
        i, j = linear_sum_assignment(alignment[np.ix_(rows, columns)] * frame.similarity, maximize=True)
        for k, alpha in enumerate(alphas):
            good = frame.similarity[i, j] >= alpha - _EPSILON
            matches[k, np.array(rows, dtype=int)[i[good]], np.array(columns, dtype=int)[j[good]]] += 1
    hits = matches.sum(axis=(1, 2))
    jaccard = matches / np.maximum(true_count[:, None] + found_count[None] - matches, 1)
    association = (matches * jaccard).sum(axis=(1, 2)) / np.maximum(hits, 1)
    detection = hits / (true_count.sum() + found_count.sum() - hits)
    return Hota(float(np.sqrt(detection * association).mean()), float(detection.mean()), float(association.mean()))


def idf1(frames: Sequence[IdentityFrame], at_least: float = 0.5) -> float:
    """Compute IDF1: the largest F1 score over all assignments of found ids to true ids, for all frames at once.

    The score is 1 if there are neither true nor found people.

    Args:
        frames: all frames of the sequence.
        at_least: smallest similarity of a match.
    """
    true, found = _index([f.true_ids for f in frames]), _index([f.found_ids for f in frames])
    overlap = np.zeros((len(true), len(found)))
    total = 0
    for frame in frames:
        rows, columns = [true[i] for i in frame.true_ids], [found[i] for i in frame.found_ids]
        overlap[np.ix_(rows, columns)] += frame.similarity >= at_least
        total += len(rows) + len(columns)
    i, j = linear_sum_assignment(overlap, maximize=True)
    return float(2 * overlap[i, j].sum() / total) if total else 1.0


def identity_switches(frames: Sequence[IdentityFrame], at_least: float = 0.5) -> int:
    """Count identity switches: matches of a true person to another id than at the last match (IDSW of CLEAR MOT).

    A person's last match is kept if it is similar enough; the other people are matched in the largest possible number,
    with the greatest sum of similarities.

    Args:
        frames: all frames of the sequence, in order.
        at_least: smallest similarity of a match.
    """
    last: dict[int, int] = {}
    switches = 0
    for frame in frames:
        s = np.where(frame.similarity >= at_least, frame.similarity, 0.0)
        kept = [
            (row, frame.found_ids.index(last[person]))
            for row, person in enumerate(frame.true_ids)
            if last.get(person) in frame.found_ids
        ]
        weight = np.where(s > 0, 10.0 + s, 0.0)
        for row, column in kept:
            weight[row, column] += 1000.0 * (s[row, column] > 0)
        i, j = linear_sum_assignment(weight, maximize=True)
        matched = {
            frame.true_ids[row]: frame.found_ids[column]
            for row, column in zip(i, j, strict=True)
            if weight[row, column]
        }
        switches += sum(last.get(person, found) != found for person, found in matched.items())
        last |= matched
    return switches


def _index(ids: Sequence[Sequence[int]]) -> dict[int, int]:
    return {person: place for place, person in enumerate(sorted({person for frame in ids for person in frame}))}
