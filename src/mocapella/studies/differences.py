"""Turn two aligned views of each pair into sums of differences that add up to the same in any order.

Every addend is rounded to a multiple of `STEP`. Sums of such numbers are exact in double precision up to 8.4 million
metres (28 million pairs that are 0.3 m apart), so that neither the order of the pairs nor the division into files,
blocks and processes changes a bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.study_tables import differences
from mocapella.studies.results import BIN_M, BINS, TIMELINE_S, ComparedViews, DifferenceSums

Float64 = NDArray[np.float64]

STEP: Final = 2.0**-30
"""Every addend is a multiple of this [m, m²]; a nanometre."""
MOST_TIMELINE_BINS: Final = 36_000
"""Longest timeline, an hour of bins of `TIMELINE_S`; later pairs are in no timeline."""


class AlignedPairs(msgspec.Struct, frozen=True, eq=False):
    """Pairs of views of one person at nearly one time, aligned by a method.

    Attributes:
        key: the pairs' method, placement, task, participant and views.
        views: (pairs, 2, joints, 3) both views in one space [m], floats of any precision; NaN where a joint is missing.
        at_s: (pairs,) time since the first frame of the task [s].
    """

    key: ComparedViews
    views: NDArray[np.floating]
    at_s: Float64


ViewsOfMethods = Callable[[Path], Iterable[AlignedPairs]]
"""Returns a recording's pairs as other methods align them. The pairs are the logged rows' pairs, with the same
placement, task, participant and names, and another ``key.method``. One key may come in several parts."""


def no_other_methods(path: Path) -> Iterable[AlignedPairs]:
    """Return no views: the `ViewsOfMethods` of an analysis of the logged rows alone."""
    return ()


def difference_sums(views: AlignedPairs) -> DifferenceSums:
    """Return the sums of |Δx|, |Δy|, |Δz| and Δd between two views of each pair."""
    apart = np.moveaxis(differences(np.asarray(views.views, dtype=np.float64)), -1, 0)
    _, pairs, joints = apart.shape
    seen = np.isfinite(apart[3])
    apart = _rounded(np.where(seen, apart, 0.0))
    distance = apart[3]
    bins = np.minimum(distance / BIN_M, BINS - 1).astype(np.int64) + BINS * np.arange(joints)
    highest = np.where(seen, distance, -np.inf).max(axis=0, initial=-np.inf)
    sums, numbers = _timeline(distance, seen, np.asarray(views.at_s, dtype=np.float64))
    return DifferenceSums(
        key=views.key,
        pairs=pairs,
        sums=apart.sum(axis=1).T.copy(),
        squares=_rounded(apart * apart).sum(axis=1).T.copy(),
        counts=seen.sum(axis=0),
        histogram=np.bincount(bins[seen], minlength=joints * BINS).reshape(joints, BINS),
        worst=np.where(np.isfinite(highest), highest, np.nan),
        timeline_sums=sums,
        timeline_counts=numbers,
    )


def _rounded(values: Float64) -> Float64:
    """Round the values in place to multiples of `STEP`, and return them."""
    values *= 1 / STEP
    np.rint(values, out=values)
    values *= STEP
    return values


def _timeline(distance: Float64, seen: NDArray[np.bool_], at_s: Float64) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return sums of Δd and their numbers, (bins, joints) each."""
    joints = distance.shape[1]
    # A hundredth of a bin: times are whole milliseconds, and 0.3 s / 0.1 s is below 3.
    bins = np.maximum(np.floor(at_s / TIMELINE_S + 0.01), 0.0)
    kept = seen & (bins < MOST_TIMELINE_BINS)[:, None]
    places = np.where(bins < MOST_TIMELINE_BINS, bins, 0).astype(np.int64)[:, None] * joints + np.arange(joints)
    length = int(places[kept].max(initial=-1)) // joints + 1
    sums = np.bincount(places[kept], weights=distance[kept], minlength=length * joints)
    numbers = np.bincount(places[kept], minlength=length * joints)
    return sums.reshape(length, joints), numbers.reshape(length, joints)


def added(parts: Sequence[DifferenceSums]) -> DifferenceSums:
    """Add sums of one key, at least one, in any order.

    Raises:
        ValueError: the keys differ.
    """
    if len(parts) == 1:
        return parts[0]
    if any(part.key != parts[0].key for part in parts):
        raise ValueError("sums of different keys are not added")
    length = max(len(part.timeline_sums) for part in parts)
    return DifferenceSums(
        key=parts[0].key,
        pairs=sum(part.pairs for part in parts),
        sums=_sum([part.sums for part in parts]),
        squares=_sum([part.squares for part in parts]),
        counts=_sum([part.counts for part in parts]),
        histogram=_sum([part.histogram for part in parts]),
        worst=np.fmax.reduce([part.worst for part in parts]),
        timeline_sums=_sum([_longer(part.timeline_sums, length) for part in parts]),
        timeline_counts=_sum([_longer(part.timeline_counts, length) for part in parts]),
    )


def _sum(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    total: NDArray[Any] = np.sum(arrays, axis=0)
    return total


def _longer(timeline: NDArray[Any], length: int) -> NDArray[Any]:
    return timeline if len(timeline) == length else np.pad(timeline, ((0, length - len(timeline)), (0, 0)))


def by_key(parts: Iterable[DifferenceSums]) -> tuple[DifferenceSums, ...]:
    """Add the sums of each key; the result is sorted by it."""
    found: dict[ComparedViews, list[DifferenceSums]] = {}
    for part in parts:
        found.setdefault(part.key, []).append(part)
    return tuple(added(found[key]) for key in sorted(found))
