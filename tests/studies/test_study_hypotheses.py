"""The three hypotheses of made-up studies whose truth is known: they hold, fail, or are not decided, and say why."""

from __future__ import annotations

import math
import re
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.study_results import MEANS_CM, figures, gathered, study

from mocapella.studies.hypotheses import StudyStatistics, filled, study_statistics
from mocapella.studies.pooled_tasks import (
    BETWEEN_SENSORS,
    TO_FUSED,
    PooledTask,
    StudyComparison,
    added,
    natural_order,
    participants_of,
    placements_of,
    pooled_tasks,
    tasks_of,
)
from mocapella.studies.results import StudyResults

ALIKE = dict.fromkeys(MEANS_CM, 3.0)
SMALL = {key: mean for key, mean in MEANS_CM.items() if key[0] != "walk"}


def rows_of(found: StudyStatistics, name: str) -> list[dict[str, Any]]:
    (table,) = (table for table in found.tables if table.name == name)
    return [dict(zip((column.title for column in table.columns), row, strict=True)) for row in table.rows]


def verdicts_of(found: StudyStatistics, hypothesis: str) -> list[str]:
    return [one.text for one in found.verdicts if one.hypothesis == hypothesis]


def p_values(found: StudyStatistics) -> list[float]:
    cells = [
        cell
        for table in found.tables
        for row in table.rows
        for cell, column in zip(row, table.columns, strict=True)
        if column.title.startswith("p")
    ]
    return [cell for cell in cells if isinstance(cell, float)]


def changed(results: StudyResults, key: Any = None, sums: Any = None) -> StudyResults:
    """The results with each key, or the sums of each key, replaced by a function of it."""
    replaced = [
        msgspec.structs.replace(one, key=key(one.key) if key else one.key, **(sums(one) if sums else {}))
        for one in results.summaries
    ]
    return gathered(tuple(replaced), results.joints)


@pytest.fixture(scope="module")
def known() -> StudyStatistics:
    return study_statistics(study(1, slope_cm_per_min=20.0, missing=[("3", "parallel")]))


def test_h1_holds_and_fails_where_it_does(known: StudyStatistics) -> None:
    words = {(row["task"], row["placement"]): row["H1"] for row in rows_of(known, "h1-within-limit")}
    assert words == {
        key: "holds" if mean < 4 else "fails" if mean > 6 else "undecided" for key, mean in MEANS_CM.items()
    } | {("walk", "parallel"): words["walk", "parallel"]}
    (text,) = verdicts_of(known, "H1")
    assert text.startswith("H1 holds for stationary at parallel (")
    assert "It fails for" in text
    assert "The data do not decide for" in text


def test_h2_fails_over_placements_and_time_and_names_who_is_left_out(known: StudyStatistics) -> None:
    over, time = verdicts_of(known, "H2")
    assert over.startswith("H2 fails: Δd depends on the placement (ANOVA, p < 0.0001; Shapiro–Wilk of its residuals")
    assert "Left out: participants 3 (no parallel)." in over
    assert "Δd drifts in" in time
    assert {row["drift"] for row in rows_of(known, "h2-drift")} == {"drift"}
    slopes = [row["mean slope"] for row in rows_of(known, "h2-drift")]
    assert slopes == pytest.approx([20.0] * 9, abs=2.0)


def test_the_tests_of_placements_name_their_participants(known: StudyStatistics) -> None:
    rows = rows_of(known, "h2-placements")
    assert {row["test"]: row["n"] for row in rows} == {"ANOVA": 9, "Friedman": 9, "mixed model": 10}
    assert {row["n"] for row in rows_of(known, "h2-pairs")} == {9, 10}
    assert all(0 < row["ε"] <= 1 for row in rows if row["test"] == "ANOVA")


def test_intervals_contain_the_mean_and_name_the_worst(known: StudyStatistics) -> None:
    for row in rows_of(known, "intervals"):
        assert row["95 % from"] < row["mean Δd"] < row["95 % to"]
        assert row["BCa from"] < row["mean Δd"] < row["BCa to"]
        assert row["best"] <= row["median"] <= row["worst"]
        assert row["who is worst"] in map(str, range(10))
        assert row["n"] == (9 if row["placement"] == "parallel" else 10)


@pytest.mark.slow
@settings(deadline=None, max_examples=3)
@given(order=st.permutations(range(6)))
def test_who_is_who_changes_no_p(order: list[int]) -> None:
    results = study(2, participants=6, means_cm=SMALL, missing=[("1", "45")])
    other = changed(results, key=lambda key: msgspec.structs.replace(key, participant=str(order[int(key.participant)])))
    assert p_values(study_statistics(other)) == pytest.approx(p_values(study_statistics(results)), abs=1e-6)


def test_a_constant_added_everywhere_changes_nothing_of_h2() -> None:
    results = study(3, participants=6, means_cm=SMALL)

    def more(one: Any) -> dict[str, Any]:
        return {
            "sums": one.sums + 0.02 * one.counts[:, None],
            "timeline_sums": one.timeline_sums + 0.02 * one.timeline_counts,
        }

    own, other = (study_statistics(each) for each in (results, changed(results, sums=more)))
    for name in ("h2-placements", "h2-pairs", "h2-drift"):
        for a, b in zip(rows_of(own, name), rows_of(other, name), strict=True):
            numbers = [(x, y) for x, y in zip(a.values(), b.values(), strict=True) if isinstance(x, float)]
            assert [y for _, y in numbers] == pytest.approx([x for x, _ in numbers], rel=1e-6, abs=1e-8, nan_ok=True)


def test_no_effect_is_not_called_proof() -> None:
    over, time = verdicts_of(study_statistics(study(5, means_cm=ALIKE)), "H2")
    assert over.startswith("No effect of the placement is found (")
    assert "This does not prove that there is none" in over
    assert time.startswith("No drift of Δd over time is found; ")


def test_residuals_that_are_not_normal_are_tested_by_ranks() -> None:
    results = study(6, participants=9)
    wild = changed(
        results,
        sums=lambda one: {"sums": one.sums * (9.0 if one.key.participant == "4" and one.key.task == "walk" else 1.0)},
    )
    (text, _) = verdicts_of(study_statistics(wild), "H2")
    assert text.startswith("H2 fails: Δd depends on the placement (Friedman, p ")
    assert "the residuals of the ANOVA are not normal" in text
    row = next(one for one in rows_of(study_statistics(wild), "h1-within-limit") if one["task"] == "walk")
    assert row["decides"] == "Wilcoxon"


def test_too_few_with_all_placements_are_tested_by_the_mixed_model() -> None:
    missing = [(str(who), ("parallel", "45", "90")[who % 3]) for who in range(7)]
    (text, _) = verdicts_of(study_statistics(study(7, participants=9, missing=missing)), "H2")
    assert text.startswith("H2 fails: Δd depends on the placement (mixed model, p < 0.0001; only 2 of 9 participants")


@pytest.mark.parametrize("participants", [0, 1, 2])
def test_too_few_participants_are_not_tested(participants: int) -> None:
    found = study_statistics(study(8, participants=participants))
    assert {row["H1"] for row in rows_of(found, "h1-within-limit")} <= {"not tested"}
    assert {row["drift"] for row in rows_of(found, "h2-drift")} <= {"not tested"}
    assert rows_of(found, "h2-placements") == []
    texts = " ".join(one.text for one in found.verdicts)
    assert "holds for" not in texts
    assert "H2 fails" not in texts


def test_one_placement_is_not_compared() -> None:
    only = {key: mean for key, mean in MEANS_CM.items() if key[1] == "90"}
    (text, _) = verdicts_of(study_statistics(study(9, means_cm=only)), "H2")
    assert text.startswith("H2 is not tested over placements: there is only one")


def test_h3_is_not_measured_without_figures_and_tested_with_them() -> None:
    assert [one.text for one in filled(()).verdicts] == ["H3 is not measured."]
    assert filled(()).tables == ()
    good, bad = (filled(figures(value)) for value in (3.0, 8.0))
    assert [row["H3"] for row in rows_of(good, "h3-filled")] == ["holds", "described"]
    assert good.verdicts[0].text.startswith("H3 holds for obstacle at 90 (")
    assert re.search(r"not filled: obstacle at 90 \([89]\.\d %\)\.$", good.verdicts[0].text)
    assert bad.verdicts[0].text.startswith("H3 holds nowhere. It fails for obstacle at 90 (")


def test_only_the_mean_error_of_hidden_joints_decides_h3() -> None:
    tail = [msgspec.structs.replace(one, quantity="hidden joints, 95th percentile") for one in figures(3.0)[::2]]
    found = filled(tail)
    assert [(row["H3"], row["p, Holm"]) for row in rows_of(found, "h3-filled")] == [("described", None)]
    assert found.verdicts[0].text == "H3 is measured and not tested: see the table."


def test_figures_count_by_their_samples_and_other_measures_not_at_all() -> None:
    one, *rest = figures()
    heavy = msgspec.structs.replace(one, value=100.0, samples=0)
    other = msgspec.structs.replace(one, measure="lost", value=50.0)
    unknown = msgspec.structs.replace(one, value=math.nan)
    assert rows_of(filled((one, *rest, heavy, other, unknown)), "h3-filled") == rows_of(
        filled((one, *rest)), "h3-filled"
    )


def test_all_pairs_of_sensors_are_one_comparison_and_those_with_the_fused_person_another() -> None:
    results = study(10, participants=2)
    more = []
    for first, second in (("front", "side"), ("front", "back"), ("front", "fused")):
        renamed = changed(results, key=lambda key, a=first, b=second: msgspec.structs.replace(key, first=a, second=b))
        more += renamed.summaries
    pooled = pooled_tasks(gathered(tuple(more), results.joints))
    assert list(pooled) == [StudyComparison("stand-still", BETWEEN_SENSORS), StudyComparison("stand-still", TO_FUSED)]
    between, fused = pooled.values()
    assert [one.pairs for one in between] == [2 * one.pairs for one in fused]
    assert [one.dd_cm for one in between] == pytest.approx([one.dd_cm for one in fused])


def test_the_order_is_that_of_the_study() -> None:
    (tasks,) = pooled_tasks(study(11, participants=11)).values()
    assert tasks_of(tasks) == ("stationary", "steps", "walk")
    assert placements_of(tasks) == ("parallel", "45", "90")
    assert participants_of(tasks) == tuple(map(str, range(11)))


@given(names=st.lists(st.text(max_size=6), unique=True))
def test_natural_order_tells_all_names_apart(names: list[str]) -> None:
    assert len({natural_order(name) for name in names}) == len(names)
    sorted(names, key=natural_order)


@given(lengths=st.tuples(st.integers(0, 4), st.integers(0, 4)))
def test_timelines_of_any_lengths_are_added(lengths: tuple[int, int]) -> None:
    one, other = (np.ones((length, 2)) for length in lengths)
    total = added(one, other)
    assert total.sum() == one.sum() + other.sum()
    assert len(total) == max(lengths)
    assert one.sum() == 2 * lengths[0]


def test_a_joint_that_is_never_in_both_views_is_in_no_mean() -> None:
    counts = np.array([2, 0])
    one = PooledTask(
        "90", "walk", "1", 2, np.array([0.1, 0.0]), counts, np.zeros((2, 3), int), np.zeros((0, 2)), counts[:0, None]
    )
    assert one.joints_cm[0] == pytest.approx(5.0)
    assert math.isnan(one.joints_cm[1])
    assert one.dd_cm == pytest.approx(5.0)
    assert math.isnan(one.slope_cm_per_min)


@pytest.mark.slow
def test_studies_without_drift_or_difference_are_rarely_rejected() -> None:
    """After Holm's correction, at most about one study in twenty has any significant row."""
    drift = placements = 0
    for seed in range(60):
        over, time = verdicts_of(study_statistics(study(1000 + seed, participants=7, means_cm=ALIKE)), "H2")
        placements += over.startswith("H2 fails")
        drift += time.startswith("Δd drifts")
    assert placements <= 8
    assert drift <= 8
