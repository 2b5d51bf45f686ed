"""Laws of the tests, textbook examples, and how often they reject where there is no effect."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.studies.inference import (
    EffectTest,
    bootstrap_interval,
    contrasts,
    friedman,
    hedges,
    holm,
    mean_test,
    mixed_effects,
    repeated_measures,
    residual_normality,
)

EFFECTS = ("placement", "task", "placement × task")
BUSHTUCKER = np.array(
    [[8, 7, 1, 6], [9, 5, 2, 5], [6, 2, 3, 8], [5, 3, 1, 9], [8, 4, 5, 8], [7, 5, 6, 7], [10, 2, 7, 2], [12, 6, 8, 1]],
    dtype=float,
)
"""Seconds until eight people retch, by what they ate (Field, Discovering Statistics, 3rd ed. 2009, table 13.2)."""
SEEDS = st.integers(0, 2**32 - 1)


def drawn(seed: int, n: int = 7, first: int = 3, second: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 5.0 + rng.normal(0, 1, (n, 1, 1)) + rng.normal(0, 1, (n, first, second))


def same(one: list[EffectTest], other: list[EffectTest]) -> None:
    for a, b in zip(one, other, strict=True):
        assert (a.effect, a.n, a.df) == (b.effect, b.n, b.df)
        got, wanted = ([x.statistic, x.p, x.p_corrected, x.size] for x in (a, b))
        assert got == pytest.approx(wanted, rel=1e-6, abs=1e-9, nan_ok=True)


def test_a_textbook_example_of_repeated_measures() -> None:
    (found,) = repeated_measures(BUSHTUCKER[:, :, None], ("food", "", ""))
    assert (found.df, found.error_df, found.n) == (3, 21, 8)
    assert found.statistic == pytest.approx(3.79, abs=0.005)
    assert found.p == pytest.approx(0.026, abs=0.0005)
    assert found.epsilon == pytest.approx(0.533, abs=0.0005)
    assert found.p_corrected == pytest.approx(0.063, abs=0.0005)
    assert found.size == pytest.approx(83.125 / (83.125 + 153.375), abs=1e-4)
    assert 0 <= found.size_low < found.size < found.size_high < 1


@settings(deadline=None, max_examples=15)
@given(seed=SEEDS, n=st.integers(3, 9), first=st.integers(2, 4), second=st.integers(2, 3))
def test_it_is_the_analysis_of_statsmodels(seed: int, n: int, first: int, second: int) -> None:
    pandas = pytest.importorskip("pandas")
    anova = pytest.importorskip("statsmodels.stats.anova")
    values = drawn(seed, n, first, second)
    rows = [{"who": who, "a": f"a{i}", "b": f"b{j}", "y": values[who, i, j]} for who, i, j in np.ndindex(*values.shape)]
    table = anova.AnovaRM(pandas.DataFrame(rows), "y", "who", within=["a", "b"]).fit().anova_table
    found = repeated_measures(values, EFFECTS)
    assert [one.statistic for one in found] == pytest.approx(table["F Value"].tolist(), rel=1e-6)
    assert [one.p for one in found] == pytest.approx(table["Pr > F"].tolist(), rel=1e-6)


@given(seed=SEEDS, order=st.permutations(range(7)), constant=st.floats(-50, 50), scale=st.floats(0.1, 30))
def test_order_constants_and_units_change_no_p(seed: int, order: list[int], constant: float, scale: float) -> None:
    values = drawn(seed)
    other = (values[order] + constant) * scale
    same(repeated_measures(values, EFFECTS), repeated_measures(other, EFFECTS))
    same([friedman("placement", values[:, :, 0])], [friedman("placement", other[:, :, 0])])
    assert residual_normality(other) == pytest.approx(residual_normality(values), rel=1e-4, abs=1e-9)
    one, two = mean_test(values[:, 0, 0], 5.0), mean_test(other[:, 0, 0], (5.0 + constant) * scale)
    got, wanted = ([x.t, x.p_below, x.p_above, x.p, x.g, x.normal_p] for x in (one, two))
    assert got == pytest.approx(wanted, rel=1e-4, abs=1e-7)


@given(seed=SEEDS, order=st.permutations(range(7)))
def test_the_order_changes_no_interval_at_all(seed: int, order: list[int]) -> None:
    values = drawn(seed)[:, 0, 0]
    assert mean_test(values, 4.0) == mean_test(values[order], 4.0)


def test_the_bootstrap_is_always_the_same_and_near_students_interval() -> None:
    values = np.random.default_rng(3).normal(5, 1, 40)
    low, high = bootstrap_interval(values)
    assert (low, high) == bootstrap_interval(values[::-1])
    test = mean_test(values)
    assert (low, high) == pytest.approx((test.low, test.high), abs=0.1)


@given(levels=st.integers(1, 7))
def test_contrasts_are_orthonormal_and_sum_to_zero(levels: int) -> None:
    rows = contrasts(levels)
    assert rows.shape == (levels - 1, levels)
    np.testing.assert_allclose(rows @ rows.T, np.eye(levels - 1), atol=1e-12)
    np.testing.assert_allclose(rows.sum(axis=1), 0.0, atol=1e-12)


def test_hedges_factor_is_that_of_the_table() -> None:
    """Hedges (1981), table 1: 0.7979 … for few degrees of freedom, and 1 − 3 ÷ (4 df − 1) for many."""
    assert hedges(4) == pytest.approx(0.7979, abs=1e-4)
    assert hedges(50) == pytest.approx(1 - 3 / (4 * 50 - 1), abs=1e-4)
    assert math.isnan(hedges(1))


@given(p_values=st.lists(st.floats(0, 1), min_size=1, max_size=12), gaps=st.sets(st.integers(0, 11)))
def test_holm_is_never_below_p_keeps_the_order_and_passes_gaps(p_values: list[float], gaps: set[int]) -> None:
    own = [math.nan if k in gaps else p for k, p in enumerate(p_values)]
    found = holm(own)
    known = [(p, corrected) for p, corrected in zip(own, found, strict=True) if not math.isnan(p)]
    assert [math.isnan(p) for p in own] == [math.isnan(p) for p in found]
    assert all(p <= corrected <= 1 for p, corrected in known)
    assert [p for p, _ in sorted(known)] == [p for p, _ in sorted(known, key=lambda one: (one[1], one[0]))]
    if known:
        smallest = min(known)
        assert smallest[1] == pytest.approx(min(1.0, smallest[0] * len(known)))


def test_two_sides_of_a_mean() -> None:
    test = mean_test([1.0, 2.0, 3.0, 2.5, 1.5], 5.0)
    assert test.p_below < 0.01
    assert test.p_above == pytest.approx(1 - test.p_below)
    assert test.w_below == pytest.approx(1 / 32)
    assert test.low < test.mean < test.high < 5.0
    assert test.g < 0


@pytest.mark.parametrize("values", [[], [3.0], [3.0, 3.0, 3.0], [3.0, 3.0 + 1e-12, 3.0]])
def test_what_has_no_spread_is_not_tested(values: list[float]) -> None:
    test = mean_test(values, 5.0)
    assert test.n == len(values)
    assert math.isnan(test.p_below)
    assert math.isnan(test.w)
    assert all(map(math.isnan, bootstrap_interval(values or [1.0])))


def test_equal_participants_are_not_tested() -> None:
    flat = np.tile(np.array([[1.0, 2.0, 3.0]]), (5, 1))[:, :, None]
    (found,) = repeated_measures(flat, EFFECTS)
    assert math.isnan(found.p_corrected)
    assert math.isnan(residual_normality(flat))


def test_friedman_of_the_textbook_example_and_of_two_levels() -> None:
    from scipy import stats

    found = friedman("food", BUSHTUCKER)
    assert (found.statistic, found.p) == pytest.approx(stats.friedmanchisquare(*BUSHTUCKER.T))
    assert found.size == pytest.approx(found.statistic / (8 * 3))
    assert math.isnan(friedman("food", BUSHTUCKER[:, :2]).p)


def long_form(values: np.ndarray, left_out: float = 0.0, seed: int = 0) -> tuple[list[float], list, list[str]]:
    rng = np.random.default_rng(seed)
    kept = [at for at in np.ndindex(*values.shape) if rng.random() >= left_out]
    return [float(values[at]) for at in kept], [(f"p{at[1]}", f"t{at[2]}") for at in kept], [str(at[0]) for at in kept]


def test_a_mixed_model_finds_effects_with_gaps_and_no_constant_changes_it() -> None:
    values = drawn(4, n=9) + np.array([0.0, 3.0, 6.0])[None, :, None]
    y, factors, groups = long_form(values, left_out=0.2)
    found = mixed_effects(y, factors, groups, EFFECTS)
    assert [one.df for one in found] == [2, 2, 4]
    assert found[0].p < 1e-4 < found[1].p
    moved = mixed_effects([one + 7.0 for one in y], factors, groups, EFFECTS)
    assert [one.p for one in moved] == pytest.approx([one.p for one in found], abs=1e-3)
    order = np.random.default_rng(1).permutation(len(y))
    mixed = mixed_effects([y[k] for k in order], [factors[k] for k in order], [groups[k] for k in order], EFFECTS)
    assert [one.p for one in mixed] == pytest.approx([one.p for one in found], abs=1e-6)


def test_a_missing_combination_has_no_interaction_of_its_own() -> None:
    values = drawn(5, n=9)
    y, factors, groups = long_form(values)
    kept = [k for k, pair in enumerate(factors) if pair != ("p0", "t0")]
    found = mixed_effects([y[k] for k in kept], [factors[k] for k in kept], [groups[k] for k in kept], EFFECTS)
    assert [one.df for one in found] == [2, 2, 3]


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(sys.modules):
        if name.partition(".")[0] == "statsmodels":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "statsmodels", None)
    with pytest.raises(SettingsError, match=r"statsmodels.*mocapella\[studies\]|statsmodels"):
        holm([0.1])


@pytest.mark.slow
def test_without_an_effect_one_test_in_twenty_rejects() -> None:
    """600 seeds, whose standard error is 0.9 %; ε is too small for few participants, and ranks are discrete."""
    rejected = np.zeros(4)
    for seed in range(600):
        values = drawn(seed, n=8)
        placement, _, mixed = repeated_measures(values, EFFECTS)
        tests = [mean_test(values[:, 0, 0], 5.0).p_below, placement.p_corrected, mixed.p_corrected]
        rejected += np.array([*tests, friedman("placement", values.mean(axis=2)).p]) < 0.05
    share = rejected / 600
    assert share[0] == pytest.approx(0.05, abs=0.03)
    assert ((share[1:] > 0.005) & (share[1:] < 0.08)).all()
