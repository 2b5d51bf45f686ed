"""Tests of the thesis' hypotheses: views within 5 cm, consistent over placements and time, occluded joints filled.

Every table has the number of participants, the statistic, p, p after Holm's correction, an effect size and an interval.
A participant who lacks a placement is left out only of the tests that need it, and named there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.studies.inference import (
    NAN,
    EffectTest,
    MeanTest,
    bootstrap_interval,
    friedman,
    holm,
    mean_test,
    mixed_effects,
    repeated_measures,
    residual_normality,
)
from mocapella.studies.pooled_tasks import (
    PooledTask,
    StudyComparison,
    participants_of,
    placement_rank,
    placements_of,
    pooled_tasks,
    task_rank,
    tasks_of,
)
from mocapella.studies.results import MeasuredFigure, StudyOrder, StudyResults
from mocapella.studies.tables import StudyTable, TableColumn

Float64 = NDArray[np.float64]
Cell = str | float | int | None
Pooled = dict[StudyComparison, tuple[PooledTask, ...]]

LIMIT_CM: Final = 5.0
"""The thesis' limit for the distance between two views [cm]."""
ALPHA: Final = 0.05
"""Level of significance."""
FILLED: Final = "filled"
"""Name of the measure of occluded joints."""
FILLED_ERROR: Final = "hidden joints"
"""Quantity of that measure that decides H3: mean error of joints hidden from a sensor [cm]."""
NOT_FILLED: Final = "hidden joints not filled"
"""Quantity that the sentence about H3 adds: share of the hidden joints without a prediction [%]."""
EFFECTS: Final = ("placement", "task", "placement × task")
FEWEST: Final = 3
"""Smallest number of participants of a test that decides about a hypothesis."""
_WHERE = (TableColumn("method"), TableColumn("views"), TableColumn("task"), TableColumn("placement"))
_INTERVAL = (TableColumn("95 % from", "cm"), TableColumn("95 % to", "cm"))
_P = (TableColumn("p (t)", digits=4), TableColumn("p (Wilcoxon)", digits=4), TableColumn("decides"))
_CORRECTED = (TableColumn("p, Holm", digits=4), TableColumn("g"))
_TESTS = (
    "t: Student's test of the participants' means. Wilcoxon's signed-rank test decides where Shapiro and Wilk's test "
    f"rejects a normal distribution (p < {ALPHA:g})."
)
_HOLM = "Holm's correction is over all rows of one method and views. g is Hedges' g."


class HypothesisVerdict(msgspec.Struct, frozen=True):
    """What the recordings say about one hypothesis.

    Attributes:
        hypothesis: `H1`, `H2` or `H3`.
        about: the tested method and its views; empty if nothing was measured.
        text: one or a few plain sentences.
    """

    hypothesis: str
    about: str
    text: str


class StudyStatistics(msgspec.Struct, frozen=True):
    """Tables and verdicts of a study's tests.

    Attributes:
        tables: intervals, then the tests of H1, H2 and H3.
        verdicts: for each hypothesis and comparison.
    """

    tables: tuple[StudyTable, ...]
    verdicts: tuple[HypothesisVerdict, ...]


def study_statistics(results: StudyResults) -> StudyStatistics:
    """Compute the intervals over participants, and test the three hypotheses.

    Raises:
        SettingsError: statsmodels is not installed; names the extra.
    """
    pooled = pooled_tasks(results)
    parts = [within_limit(pooled), over_placements(pooled), over_time(pooled), filled(results.measured, results.order)]
    verdicts = [verdict for part in parts for verdict in part.verdicts]
    return StudyStatistics(
        (interval_table(pooled), *(table for part in parts for table in part.tables)),
        tuple(sorted(verdicts, key=lambda one: one.hypothesis)),
    )


def cells_of(tasks: Iterable[PooledTask]) -> dict[tuple[str, str], list[PooledTask]]:
    """Group pooled tasks by (task, placement); leave out tasks without a joint that is ever in both views."""
    cells: dict[tuple[str, str], list[PooledTask]] = {}
    for one in tasks:
        if math.isfinite(one.dd_cm):
            cells.setdefault((one.task, one.placement), []).append(one)
    return cells


def interval_table(pooled: Pooled) -> StudyTable:
    """Return the means over participants with their intervals, spread and worst participant, by task and placement."""
    rows: list[tuple[Cell, ...]] = []
    for comparison, tasks in pooled.items():
        for (task, placement), cell in cells_of(tasks).items():
            values = [one.dd_cm for one in cell]
            test = mean_test(values)
            worst = max(cell, key=lambda one: one.dd_cm)
            rows.append((
                comparison.method, comparison.views, task, placement, len(cell), sum(one.pairs for one in cell),
                test.mean, test.sd, test.low, test.high, *bootstrap_interval(values), float(np.median(values)),
                min(values), worst.dd_cm, worst.participant,
            ))  # fmt: skip
    columns = (
        *_WHERE, TableColumn("n"), TableColumn("pairs"), TableColumn("mean Δd", "cm"),
        TableColumn("SD", "cm"), *_INTERVAL, TableColumn("BCa from", "cm"), TableColumn("BCa to", "cm"),
        TableColumn("median", "cm"), TableColumn("best", "cm"), TableColumn("worst", "cm"),
        TableColumn("who is worst"),
    )  # fmt: skip
    notes = (
        "Each participant has one value: the mean of Δd over all pairs of the task, then over the joints.",
        "SD (N − 1), median, best and worst are over participants. 95 %: Student's t. BCa: bootstrap, 95 %.",
    )
    return StudyTable("intervals", "Δd by task and placement, over participants", columns, tuple(rows), notes)


def within_limit(pooled: Pooled) -> StudyStatistics:
    """Test H1 for each task and placement: the mean Δd over participants is below `LIMIT_CM`."""
    rows: list[tuple[Cell, ...]] = []
    verdicts = []
    for comparison, tasks in pooled.items():
        cells = cells_of(tasks)
        tests = [mean_test([one.dd_cm for one in cell], LIMIT_CM) for cell in cells.values()]
        below = holm([p_of(test, "below") for test in tests])
        above = holm([p_of(test, "above") for test in tests])
        found: dict[str, list[str]] = {}
        for (task, placement), test, low_p, high_p in zip(cells, tests, below, above, strict=True):
            word = judged(test, low_p, high_p)
            found.setdefault(word, []).append(f"{task} at {placement} ({test.mean:.1f} cm)")
            rows.append((
                comparison.method, comparison.views, task, placement, test.n, test.mean, test.low, test.high, test.t,
                test.p_below, test.w_below, decider(test), low_p, test.g, word,
            ))  # fmt: skip
        words = {
            "holds": "H1 holds for",
            "fails": "It fails for",
            "undecided": "The data do not decide for",
            "not tested": "Too few participants or no spread for",
        }
        text = ". ".join(f"{words[word]} {listed(found[word])}" for word in words if word in found)
        text = text if "holds" in found or not text else f"H1 holds nowhere. {text}"
        verdicts.append(HypothesisVerdict("H1", comparison.title, f"{text or 'H1 is not tested: there is no pair'}."))
    columns = (
        *_WHERE, TableColumn("n"), TableColumn("mean Δd", "cm"), *_INTERVAL, TableColumn("t"), *_P, *_CORRECTED,
        TableColumn("H1"),
    )  # fmt: skip
    notes = (
        f"Hypothesis: the mean over participants is below {LIMIT_CM:g} cm. p is of the test that it is not.",
        f"It holds if p after Holm's correction is below {ALPHA:g}, and fails if the opposite test's p is.",
        _TESTS,
        _HOLM,
    )
    title = f"H1: views lie within {LIMIT_CM:g} cm of one another"
    return StudyStatistics((StudyTable("h1-within-limit", title, columns, tuple(rows), notes),), tuple(verdicts))


def decider(test: MeanTest) -> str:
    """Return the name of the test that decides: `t`, or `Wilcoxon` where the values are not normal."""
    return "Wilcoxon" if test.normal_p < ALPHA else "t"


def p_of(test: MeanTest, side: str) -> float:
    """Return p of the test that decides, for the mean being ``below``, ``above`` or ``other``; NaN for too few."""
    if test.n < FEWEST:
        return NAN
    by_t, by_ranks = {
        "below": (test.p_below, test.w_below),
        "above": (test.p_above, test.w_above),
        "other": (test.p, test.w),
    }[side]
    return by_ranks if decider(test) == "Wilcoxon" else by_t


def judged(test: MeanTest, below: float, above: float) -> str:
    """Return `holds`, `fails`, `undecided` or `not tested`, from corrected p values."""
    if not math.isfinite(p_of(test, "below")):
        return "not tested"
    return "holds" if below < ALPHA else "fails" if above < ALPHA else "undecided"


def listed(names: Sequence[str]) -> str:
    """Join names as in a sentence."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


class CompleteDesign(msgspec.Struct, frozen=True, eq=False):
    """The participants who have all combinations of placement and task.

    Attributes:
        participants: their codes.
        placements, tasks: levels; a task that fewer than two participants have in some placement is no level.
        values: (participants, placements, tasks) mean Δd [cm].
        left_out: text that names missing participants and tasks; empty if none is missing.
        available: pooled tasks of these levels, of all participants.
    """

    participants: tuple[str, ...]
    placements: tuple[str, ...]
    tasks: tuple[str, ...]
    values: Float64
    left_out: str
    available: tuple[PooledTask, ...]


def complete_design(tasks: Sequence[PooledTask]) -> CompleteDesign:
    """Return the complete combinations of a comparison's pooled tasks."""
    cells = cells_of(tasks)
    placements, every = placements_of(tasks), tasks_of(tasks)
    kept = tuple(task for task in every if all(len(cells.get((task, place), ())) >= 2 for place in placements))
    value = {(one.participant, one.placement, one.task): one for cell in cells.values() for one in cell}
    available = tuple(one for one in value.values() if one.task in kept)
    people = participants_of(available)
    lacking = {
        who: [place for place in placements if any((who, place, task) not in value for task in kept)] for who in people
    }
    missing = [f"{who} (no {listed(places)})" for who, places in lacking.items() if places]
    whole = tuple(who for who, places in lacking.items() if not places)
    texts = [f"left out: participants {listed(missing)}"] if missing else []
    if others := [task for task in every if task not in kept]:
        texts.append(f"tasks that fewer than two participants did in each placement: {listed(others)}")
    values = np.array([[[value[who, place, task].dd_cm for task in kept] for place in placements] for who in whole])
    shape = (len(whole), len(placements), len(kept))
    return CompleteDesign(whole, placements, kept, values.reshape(shape), "; ".join(texts), available)


def over_placements(pooled: Pooled) -> StudyStatistics:
    """Test H2's first part: Δd does not depend on the placement; and compare the placements in pairs."""
    rows: list[tuple[Cell, ...]] = []
    pair_rows: list[tuple[Cell, ...]] = []
    verdicts, notes = [], []
    for comparison, tasks in pooled.items():
        design = complete_design(tasks)
        about = (comparison.method, comparison.views)
        named = [(name, test) for name, tests in tested_designs(design) for test in tests]
        rows += [(*about, name, *_effect_cells(test)) for name, test in named]
        pairs, widest = _pairs_of_placements(tasks)
        pair_rows += [(*about, *cells) for cells in pairs]
        name, why = deciding_design(design)
        effects = {test.effect: test.p_corrected for its, test in named if its == name}
        verdicts.append(HypothesisVerdict("H2", comparison.title, _placement_text(design, name, why, effects, widest)))
        notes += [f"{comparison.title}: {design.left_out}."] if design.left_out else []
    columns = (
        TableColumn("method"), TableColumn("views"), TableColumn("test"), TableColumn("effect"), TableColumn("n"),
        TableColumn("statistic"), TableColumn("value"), TableColumn("df"), TableColumn("error df"),
        TableColumn("p", digits=4), TableColumn("ε", digits=3), TableColumn("p, corrected", digits=4),
        TableColumn("effect size"), TableColumn("size", digits=3), TableColumn("95 % from", digits=3),
        TableColumn("95 % to", digits=3),
    )  # fmt: skip
    explained = (
        "ANOVA: repeated measures of the participants with all combinations; p is corrected by Greenhouse and "
        "Geisser's ε. Friedman: of the same participants, averaged over the other factor. Mixed model: of all "
        "participants, with one intercept for each one; likelihood ratios.",
        *notes,
    )
    pair_columns = (
        *_WHERE[:3], TableColumn("placements"), TableColumn("n"), TableColumn("difference", "cm"), *_INTERVAL,
        TableColumn("t"), *_P, *_CORRECTED,
    )  # fmt: skip
    title = "H2: Δd by placement and task"
    tables = (
        StudyTable("h2-placements", title, columns, tuple(rows), explained),
        StudyTable(
            "h2-pairs", "H2: placements in pairs", pair_columns, tuple(pair_rows),
            ("Difference: first minus second placement, of the participants who have both.", _TESTS, _HOLM),
        ),
    )  # fmt: skip
    return StudyStatistics(tables, tuple(verdicts))


def tested_designs(design: CompleteDesign) -> list[tuple[str, list[EffectTest]]]:
    """Return the name and effects of every test that the data allow."""
    found: list[tuple[str, list[EffectTest]]] = []
    if len(design.placements) * len(design.tasks) < 2:
        return found
    if len(design.participants) >= FEWEST:
        found.append(("ANOVA", repeated_measures(design.values, EFFECTS)))
        averages = (design.values.mean(axis=2), design.values.mean(axis=1))
        ranked = [friedman(effect, values) for effect, values in zip(EFFECTS[:2], averages, strict=True)]
        found.append(("Friedman", [test for test in ranked if math.isfinite(test.p)]))
    one_by_one = design.available
    if len(participants_of(one_by_one)) > len(design.participants) and len(participants_of(one_by_one)) >= FEWEST:
        values = [one.dd_cm for one in one_by_one]
        factors = [(one.placement, one.task) for one in one_by_one]
        groups = [one.participant for one in one_by_one]
        found.append(("mixed model", mixed_effects(values, factors, groups, EFFECTS)))
    return found


def deciding_design(design: CompleteDesign) -> tuple[str, str]:
    """Return the name of the test that decides about placements, and the reason."""
    n, available = len(design.participants), len(participants_of(design.available))
    if n < FEWEST:
        reason = f"only {n} of {available} participants have all combinations"
        return ("mixed model", reason) if available > n and available >= FEWEST else ("", reason)
    normality = residual_normality(design.values)
    if normality < ALPHA and len(design.placements) > 2:
        return "Friedman", f"the residuals of the ANOVA are not normal (Shapiro–Wilk p {p_text(normality)})"
    return "ANOVA", f"Shapiro–Wilk of its residuals: p {p_text(normality)}"


def p_text(p: float) -> str:
    """Return a p value for a sentence, such as `= 0.012` or `< 0.0001`."""
    return "unknown" if not math.isfinite(p) else "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


def _effect_cells(test: EffectTest) -> tuple[Cell, ...]:
    return (
        test.effect, test.n, test.symbol, test.statistic, test.df, test.error_df, test.p, test.epsilon,
        test.p_corrected, test.size_symbol, test.size, test.size_low, test.size_high,
    )  # fmt: skip


def _pairs_of_placements(tasks: Sequence[PooledTask]) -> tuple[list[tuple[Cell, ...]], str]:
    """Return the rows of the table of pairs, and the largest difference as a text."""
    values = {
        (one.task, one.placement, one.participant): one.dd_cm for cell in cells_of(tasks).values() for one in cell
    }
    tests: list[tuple[str, str, MeanTest]] = []
    for task in tasks_of(tasks):
        for first, second in combinations(placements_of(tasks), 2):
            both = [
                values[task, first, who] - values[task, second, who]
                for who in participants_of(tasks)
                if (task, first, who) in values and (task, second, who) in values
            ]
            if both:
                tests.append((task, f"{first} − {second}", mean_test(both)))
    corrected = holm([p_of(test, "other") for *_, test in tests])
    rows: list[tuple[Cell, ...]] = [
        (task, pair, test.n, test.mean, test.low, test.high, test.t, test.p, test.w, decider(test), p, test.g)
        for (task, pair, test), p in zip(tests, corrected, strict=True)
    ]
    if not (judgeable := [one for one in tests if math.isfinite(one[2].low)]):
        return rows, ""
    task, pair, test = max(judgeable, key=lambda one: abs(one[2].mean))
    return rows, (
        f"The largest difference is {pair} in {task}: {test.mean:.1f} cm (95 % {test.low:.1f} to {test.high:.1f}, "
        f"n = {test.n})"
    )


def _placement_text(design: CompleteDesign, name: str, why: str, effects: dict[str, float], widest: str) -> str:
    """Return the sentences about H2's placements."""
    p = effects.get("placement", NAN)
    if len(design.placements) < 2:
        text = "H2 is not tested over placements: there is only one"
    elif not math.isfinite(p):
        text = f"H2 is not tested over placements: {why}"
    else:
        by = f"{name}, p {p_text(p)}; {why}"
        depends = p < ALPHA
        text = (
            f"H2 fails: Δd depends on the placement ({by})"
            if depends
            else f"No effect of the placement is found ({by})"
        )
        mixed = effects.get("placement × task", NAN)
        text += f". The effect differs between tasks (p {p_text(mixed)})" if mixed < ALPHA else ""
        text += "" if depends else ". This does not prove that there is none: see the intervals of the pairs"
    return ". ".join(part for part in (text, widest, _sentence(design.left_out)) if part) + "."


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def over_time(pooled: Pooled) -> StudyStatistics:
    """Test H2's second part: the participants' slopes of Δd over a task's time are zero in the mean."""
    rows: list[tuple[Cell, ...]] = []
    verdicts = []
    for comparison, tasks in pooled.items():
        slopes: dict[tuple[str, str], list[float]] = {}
        for one in tasks:
            if math.isfinite(one.slope_cm_per_min):
                slopes.setdefault((one.task, one.placement), []).append(one.slope_cm_per_min)
        tests = [mean_test(values) for values in slopes.values()]
        corrected = holm([p_of(test, "other") for test in tests])
        drifts, quiet = [], 0
        for (task, placement), test, p in zip(slopes, tests, corrected, strict=True):
            word = "not tested" if not math.isfinite(p) else "drift" if p < ALPHA else "no drift found"
            quiet += word == "no drift found"
            drifts += [f"{task} at {placement} ({test.mean:+.1f} cm/min)"] if word == "drift" else []
            rows.append((
                comparison.method, comparison.views, task, placement, test.n, test.mean, test.low, test.high, test.t,
                test.p, test.w, decider(test), p, test.g, word,
            ))  # fmt: skip
        found = f"Δd drifts in {listed(drifts)}" if drifts else "No drift of Δd over time is found"
        text = f"{found}; {quiet} of {len(tests)} tasks and placements show none." if quiet or drifts else ""
        verdicts.append(
            HypothesisVerdict("H2", comparison.title, text or "H2 is not tested over time: no task is long enough.")
        )
    columns = (
        *_WHERE, TableColumn("n"), TableColumn("mean slope", "cm/min"), TableColumn("95 % from", "cm/min"),
        TableColumn("95 % to", "cm/min"), TableColumn("t"), *_P, *_CORRECTED, TableColumn("drift"),
    )  # fmt: skip
    notes = (
        "Slope: least squares of the mean Δd in bins of 0.1 s, from the task's first frame, for each participant.",
        "In a task with a route, time and place change together: a slope may be of either.",
        _TESTS,
        _HOLM,
    )
    return StudyStatistics((StudyTable("h2-drift", "H2: Δd over time", columns, tuple(rows), notes),), tuple(verdicts))


def filled(measured: Iterable[MeasuredFigure], order: StudyOrder | None = None) -> StudyStatistics:
    """Describe H3's figures over participants, and test `FILLED_ERROR` against `LIMIT_CM`, as in H1.

    A participant's value is the mean of the figures, weighted by their samples. Without figures, H3 is not measured.
    """
    groups: dict[tuple[str, str, str, str, str], dict[str, list[MeasuredFigure]]] = {}
    for one in measured:
        if one.measure == FILLED and math.isfinite(one.value) and one.samples > 0:
            key = (one.method, one.quantity, one.unit, one.task, one.placement)
            groups.setdefault(key, {}).setdefault(one.participant, []).append(one)
    named = order or StudyOrder()
    keys = sorted(groups, key=lambda key: (*key[:3], task_rank(named, key[3]), placement_rank(named, key[4])))
    tests = [mean_test([_weighted(own) for own in groups[key].values()], LIMIT_CM) for key in keys]
    corrected: list[tuple[float, float]] = [(NAN, NAN)] * len(keys)
    for method in {key[0] for key in keys}:
        own = [k for k, key in enumerate(keys) if key[0] == method and _decides(key[1], key[2])]
        sides = [holm([p_of(tests[k], side) for k in own]) for side in ("below", "above")]
        for k, low_p, high_p in zip(own, *sides, strict=True):
            corrected[k] = (low_p, high_p)
    rows: list[tuple[Cell, ...]] = []
    found: dict[str, dict[str, list[str]]] = {}
    for (method, quantity, unit, task, placement), test, (low_p, high_p) in zip(keys, tests, corrected, strict=True):
        decides = _decides(quantity, unit)
        word = judged(test, low_p, high_p) if decides else "described"
        kind = NOT_FILLED if quantity == NOT_FILLED else word
        found.setdefault(method, {}).setdefault(kind, []).append(f"{task} at {placement} ({test.mean:.1f} {unit})")
        rows.append((
            method, quantity, unit, task, placement, test.n, test.mean, test.low, test.high,
            *((test.t, test.p_below, test.w_below, decider(test), low_p, test.g) if decides else (None,) * 6), word,
        ))  # fmt: skip
    columns = (
        TableColumn("method"), TableColumn("quantity"), TableColumn("unit"), TableColumn("task"),
        TableColumn("placement"), TableColumn("n"), TableColumn("mean"), TableColumn("95 % from"),
        TableColumn("95 % to"), TableColumn("t"), *_P, *_CORRECTED, TableColumn("H3"),
    )  # fmt: skip
    notes = (
        f"“{FILLED_ERROR}”, the mean error of those that are filled, is tested as in H1: below {LIMIT_CM:g} cm.",
        "The other quantities are described.",
        _TESTS,
        "Holm's correction is over all rows of one method. g is Hedges' g.",
    )
    table = StudyTable("h3-filled", "H3: occluded joints are filled", columns, tuple(rows), notes)
    verdicts = tuple(HypothesisVerdict("H3", method, _filled_text(found[method])) for method in sorted(found))
    return StudyStatistics((table,) if rows else (), verdicts or (HypothesisVerdict("H3", "", "H3 is not measured."),))


def _weighted(figures: Sequence[MeasuredFigure]) -> float:
    weights = np.array([one.samples for one in figures], dtype=np.float64)
    return float(np.array([one.value for one in figures]) @ weights / weights.sum())


def _decides(quantity: str, unit: str) -> bool:
    return (quantity, unit) == (FILLED_ERROR, "cm")


def _filled_text(found: dict[str, list[str]]) -> str:
    words = {"holds": "H3 holds for", "fails": "It fails for", "undecided": "The data do not decide for"}
    parts = [f"{words[word]} {listed(found[word])}" for word in words if word in found]
    if not parts:
        return "H3 is measured and not tested: see the table."
    parts += [f"Share of hidden joints that are not filled: {listed(found[NOT_FILLED])}"] if NOT_FILLED in found else []
    return ". ".join(parts if "holds" in found else ["H3 holds nowhere", *parts]) + "."
