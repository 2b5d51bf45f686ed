"""The tables of a study: the thesis' own on its data, and the laws of how they are made."""

from __future__ import annotations

import csv
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.recording.study_columns import TOPOLOGY
from mocapella.studies.analysis import analyze_file, merge
from mocapella.studies.differences import AlignedPairs, difference_sums
from mocapella.studies.recordings import find_recordings
from mocapella.studies.results import BINS, ComparedViews, FileResults, StudyResults
from mocapella.studies.study_tables import quantile_cm, tables_of
from mocapella.studies.tables import StudyTable

CM = 0.005
"""How near to the expected tables [cm]."""


@pytest.fixture(scope="module")
def real(study_logs: Path) -> StudyResults:
    found = find_recordings(study_logs)
    return merge(map(analyze_file, found.paths), found.findings)


def named(tables: tuple[StudyTable, ...], name: str) -> dict[str, dict[str, object]]:
    """A table's rows by their first cell, each by the columns' titles."""
    (table,) = [one for one in tables if one.name == name]
    titles = [column.title for column in table.columns]
    return {str(row[0]): dict(zip(titles, row, strict=True)) for row in table.rows}


def expected(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


DEGREES = {"parallel": "parallel", "45": "45°", "90": "90°"}


@pytest.mark.slow
def test_the_thesis_tables(study_logs: Path, real: StudyResults) -> None:
    tables = tables_of(real)
    rows = expected(study_logs / "expected_tables_participants_0_9.csv")
    assert len(rows) == 9
    for wanted in rows:
        row = named(tables, f"{wanted['task'].lower()}-by-placement")[DEGREES[wanted["placement"]]]
        assert (row["Participants"], row["Pairs"]) == (int(wanted["participants"]), int(wanted["pairs"]))
        for axis in ("x", "y", "z", "d"):
            assert row[f"Avg Δ{axis}"] == pytest.approx(float(wanted[f"avg_d{axis}"]), abs=CM)
            assert row[f"Std Δ{axis}"] == pytest.approx(float(wanted[f"std_d{axis}"]), abs=CM)
    for wanted in expected(study_logs / "expected_joint_dd_participants_0_9.csv"):
        row = named(tables, f"{wanted['task'].lower()}-by-joint")[wanted["joint"]]
        for placement, title in DEGREES.items():
            assert row[title] == pytest.approx(float(wanted[placement]), abs=CM)


@pytest.mark.slow
def test_what_the_real_logs_lack_is_said(real: StudyResults) -> None:
    whole = {one.step: one.rows for one in real.files[0].cleaning}
    for one in real.files[1:]:
        whole = {step.step: whole[step.step] + step.rows for step in one.cleaning}
    assert whole["scenario 4 after the first 8 read as 8"] == 2636
    lacking = [one.what for one in real.findings if "has no" in one.what]
    assert lacking == [
        "participant 0 has no stationary, steps, walk in placement 45",
        *(f"participant {k} has no stationary, steps, walk in placement parallel" for k in (1, 3, 6, 9)),
    ]
    used = named(tables_of(real), "recordings")["All"]
    assert used["Used"] == 2 * sum(one.pairs for one in real.summaries)


def study(*distances: tuple[str, str, str, float], views: tuple[str, str] = ("front", "side")) -> StudyResults:
    """Of (participant, placement, task, Δ along x of all joints [m])."""
    parts = []
    for participant, placement, task, apart in distances:
        both = np.zeros((1, 2, 25, 3))
        both[0, 1, :, 0] = apart
        key = ComparedViews("stand-still", placement, task, participant, *views)
        parts.append(difference_sums(AlignedPairs(key, both, np.zeros(1))))
    return merge([FileResults("a", 2, 2, TOPOLOGY.joints, (), (), tuple(parts))])


def test_participants_count_alike_and_the_average_is_of_the_placements() -> None:
    tables = tables_of(
        study(
            ("1", "45", "walk", 0.01),
            ("2", "45", "walk", 0.05),
            ("1", "parallel", "walk", 0.09),
            ("1", "90", "walk", 0.12),
        )
    )
    rows = named(tables, "walk-by-placement")
    assert list(rows) == ["parallel", "45°", "90°", "Average"]
    assert rows["45°"]["Avg Δd"] == pytest.approx(3.0, abs=1e-4)
    assert rows["45°"]["Std Δd"] == pytest.approx(0.0, abs=1e-4)
    assert rows["Average"]["Avg Δx"] == pytest.approx(8.0, abs=1e-4)
    assert rows["Average"]["Std Δx"] == pytest.approx(np.std([9, 3, 12], ddof=1), abs=1e-4)
    spread = named(tables, "walk-spread")["45°"]
    assert (spread["Least"], spread["Largest"]) == pytest.approx((1.0, 5.0), abs=1e-4)
    assert (spread["of participant"], spread["SD"]) == ("2", pytest.approx(np.sqrt(8), abs=1e-4))
    assert spread["Worst"] == pytest.approx(5.0, abs=1e-4)
    assert spread["at"] in TOPOLOGY.joints


def test_the_last_row_averages_tasks_of_all_placements() -> None:
    cells = [
        ("1", placement, task, 0.01 * k) for k, task in enumerate(("steps", "walk"), 1) for placement in ("45", "90")
    ]
    rows = named(tables_of(study(*cells, ("1", "90", "obstacle", 0.5))), "overall")
    assert list(rows) == ["Steps", "Walk", "Obstacle", "Average"]
    assert rows["Average"]["90°"] == pytest.approx(1.5, abs=1e-4)
    assert np.isnan(float(str(rows["Obstacle"]["45°"])))


def test_a_joint_that_nobody_has_is_in_no_mean() -> None:
    results = study(("1", "45", "walk", 0.02))
    (part,) = results.summaries
    counts, sums = part.counts.copy(), part.sums.copy()
    counts[TOPOLOGY.index("HandLeft")] = sums[TOPOLOGY.index("HandLeft")] = 0
    results = msgspec.structs.replace(results, summaries=(msgspec.structs.replace(part, counts=counts, sums=sums),))
    tables = tables_of(results)
    assert named(tables, "walk-by-placement")["45°"]["Avg Δd"] == pytest.approx(2.0, abs=1e-4)
    assert np.isnan(float(str(named(tables, "walk-by-joint")["HandLeft"]["45°"])))
    sides = named(tables, "left-against-right")["Walk"]
    assert sides["Left − Right"] == pytest.approx(0.0, abs=1e-4)


def test_wei_et_al_are_beside_ours() -> None:
    (table,) = [one for one in tables_of(study(("1", "45", "walk", 0.02))) if one.name == "beside-wei"]
    assert [round(float(str(row[5])), 2) for row in table.rows] == [2.24, 2.06, 2.0]


def test_several_views_have_tables_of_their_own_and_names_are_unique() -> None:
    one, other = study(("1", "45", "walk", 0.02)), study(("1", "45", "walk", 0.04), views=("front", "fused"))
    tables = tables_of(merge([*one.files, msgspec.structs.replace(other.files[0], file="b")]))
    names = [table.name for table in tables]
    assert len(set(names)) == len(names)
    assert named(tables, "walk-by-placement-stand-still-front-fused")["45°"]["Avg Δd"] == pytest.approx(4.0, abs=1e-4)


def test_a_study_without_a_pair_has_tables_of_its_recordings() -> None:
    assert [table.name for table in tables_of(merge([]))] == ["recordings", "cleaning", "findings"]


@settings(deadline=None)
@given(st.lists(st.integers(0, BINS + 50), min_size=1, max_size=200), st.sampled_from([0.05, 0.5, 0.95]))
def test_quantiles_are_within_a_bin_of_the_sorted_values(values: list[int], share: float) -> None:
    histogram = np.bincount(np.minimum(values, BINS - 1), minlength=BINS)
    found = quantile_cm(histogram, share)
    wanted = np.quantile(np.minimum(values, BINS - 1), share, method="inverted_cdf") / 10
    assert found is not None
    assert wanted - 1e-9 <= found <= wanted + 0.1 + 1e-9
    assert quantile_cm(np.zeros(BINS, dtype=np.int64), share) is None
