"""Sums of differences: exact, so that no order and no division changes a bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.evaluation.study_tables import differences
from mocapella.studies.differences import MOST_TIMELINE_BINS, STEP, AlignedPairs, added, by_key, difference_sums
from mocapella.studies.results import BIN_M, BINS, ComparedViews, DifferenceSums

KEY = ComparedViews("stand-still", "90", "walk", "7", "front", "side")


def views_of(seed: int, pairs: int = 40) -> AlignedPairs:
    """Two views whose coordinates are multiples of 1/1024 m, some joints missing."""
    random = np.random.default_rng(seed)
    views = np.rint(random.normal(size=(pairs, 2, 25, 3)) * 1024) / 1024
    views[random.random((pairs, 2, 25)) < 0.05] = np.nan
    return AlignedPairs(KEY, views, np.arange(pairs) * 0.035)


def chosen(views: AlignedPairs, rows: Any) -> AlignedPairs:
    return AlignedPairs(views.key, views.views[rows], views.at_s[rows])


def same(a: DifferenceSums, b: DifferenceSums) -> bool:
    names = [name for name in DifferenceSums.__struct_fields__ if name not in ("key", "pairs")]
    equal = (np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True) for name in names)
    return (a.key, a.pairs) == (b.key, b.pairs) and all(equal)


@settings(deadline=None)
@given(seed=st.integers(0, 99), cuts=st.lists(st.integers(0, 40), max_size=5), shuffle=st.integers(0, 99))
def test_pieces_in_any_order_give_the_whole_to_the_bit(seed: int, cuts: list[int], shuffle: int) -> None:
    views = views_of(seed)
    random = np.random.default_rng(shuffle)
    pieces = np.split(random.permutation(40), sorted(cuts))
    parts = [difference_sums(chosen(views, piece)) for piece in pieces]
    whole = difference_sums(views)
    assert same(added(parts), whole)
    assert same(added([*parts[:1], added(parts[1:])]) if len(parts) > 1 else parts[0], whole)


@settings(deadline=None)
@given(seed=st.integers(0, 99), moved=st.tuples(*[st.integers(-4096, 4096)] * 3))
def test_a_constant_added_to_all_rows_and_exchanged_views_change_nothing(seed: int, moved: Any) -> None:
    views = views_of(seed)
    whole = difference_sums(views)
    assert same(difference_sums(AlignedPairs(KEY, views.views + np.array(moved) / 1024, views.at_s)), whole)
    assert same(difference_sums(AlignedPairs(KEY, views.views[:, ::-1], views.at_s)), whole)


def test_means_are_those_of_the_pairs_to_a_nanometre() -> None:
    views = views_of(3)
    apart = differences(views.views)
    np.testing.assert_allclose(difference_sums(views).means, np.nanmean(apart, axis=0), atol=STEP)
    np.testing.assert_allclose(difference_sums(views).squares, np.nansum(apart**2, axis=0), atol=40 * STEP * 10)


def test_bins_worst_and_timeline() -> None:
    views = np.zeros((3, 2, 25, 3))
    views[:, 1, :, 0] = np.array([0.0005, 0.0025, 9.0])[:, None]
    views[1, 0, 4] = np.nan
    sums = difference_sums(AlignedPairs(KEY, views, np.array([-1.0, 0.3, 0.31])))
    assert sums.histogram[0, [0, 2, BINS - 1]].tolist() == [1, 1, 1]
    assert sums.histogram.sum(axis=1).tolist() == sums.counts.tolist()
    assert sums.worst[0] == pytest.approx(9.0, abs=STEP)
    assert sums.timeline_counts[:, 0].tolist() == [1, 0, 0, 2]
    assert sums.timeline_counts[:, 4].tolist() == [1, 0, 0, 1]
    assert sums.timeline_sums[0, 0] == pytest.approx(BIN_M / 2, abs=STEP)


def test_a_joint_that_nobody_has_and_a_time_beyond_the_timeline() -> None:
    views = np.zeros((2, 2, 25, 3))
    views[:, 0, 3] = np.nan
    sums = difference_sums(AlignedPairs(KEY, views, np.array([0.0, 1e9])))
    assert np.isnan(sums.worst[3])
    assert np.isnan(sums.means[3]).all()
    assert sums.counts[[0, 3]].tolist() == [2, 0]
    assert len(sums.timeline_counts) == 1 < MOST_TIMELINE_BINS
    empty = difference_sums(chosen(AlignedPairs(KEY, views, np.zeros(2)), slice(0, 0)))
    assert (empty.pairs, len(empty.timeline_sums)) == (0, 0)
    assert same(added([empty, sums]), sums)


def test_sums_of_different_keys_are_kept_apart() -> None:
    other = AlignedPairs(ComparedViews("a", "45", "walk", "7", "front", "side"), views_of(2).views, views_of(2).at_s)
    parts = [difference_sums(views_of(1)), difference_sums(other), difference_sums(views_of(2))]
    assert [part.pairs for part in by_key(parts)] == [40, 80]
    with pytest.raises(ValueError, match="different keys"):
        added(parts)
