"""The thesis' tables on the real logs, and the laws of how they are made."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import study_examples as examples
from support.evaluation_sessions import log_of
from support.reference_methods import Repaired

from mocapella.errors import InputError, SettingsError
from mocapella.evaluation.kinectmultitrack import evaluate
from mocapella.evaluation.study_pairs import StudySession, corrected_tasks, pairs_of, study_sessions
from mocapella.evaluation.study_tables import (
    MAX_WANDER,
    TORSO,
    Count,
    Scored,
    differences,
    figures,
    joint_means,
    problem,
    rounded,
)
from mocapella.recording.study_log import write_study_log
from mocapella.sources.study_replay import StudyReplay

CM = 0.005
"""How near to the expected tables [cm]."""


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_the_rows_as_logged_give_the_expected_tables(study_logs: Path, as_logged: dict[str, Any]) -> None:
    tasks = as_logged["methods"]["stand-still"]["tasks"]
    expected = table(study_logs / "expected_tables_participants_0_9.csv")
    assert len(expected) == 9
    for wanted in expected:
        row = tasks[wanted["task"].lower()][wanted["placement"]]
        assert (row["participants"], row["pairs"]) == (int(wanted["participants"]), int(wanted["pairs"]))
        assert row["finite_joints"] == 25 * row["pairs"]
        for name in ("dx", "dy", "dz", "dd"):
            assert row[f"{name}_cm"]["mean"] == pytest.approx(float(wanted[f"avg_{name}"]), abs=CM)
            assert row[f"{name}_cm"]["std"] == pytest.approx(float(wanted[f"std_{name}"]), abs=CM)
        assert row["raw_labels"]["dd_cm"] == row["dd_cm"]


@pytest.mark.slow
def test_joint_by_joint_too(study_logs: Path) -> None:
    scored: dict[tuple[int, str], list[Scored]] = {}
    for session in study_sessions(study_logs, range(10)):
        for task in (1, 2, 3):
            pairs = session.pairs.where(session.pairs.task == task)
            if len(pairs):
                delta = differences(session.log.positions[pairs.rows].astype(np.float64))
                of_task = scored.setdefault((task, session.placement), [])
                of_task.append(Scored(session.participant, delta, delta))
    joints = StudyReplay(session.log).arrivals().__next__().frame.topology
    numbers = {"Stationary": 1, "Steps": 2, "Walk": 3}
    for wanted in table(study_logs / "expected_joint_dd_participants_0_9.csv"):
        for placement in ("45", "90", "parallel"):
            _, means = joint_means(scored[numbers[wanted["task"]], placement], repaired=False)
            found = 100 * means[:, joints.index(wanted["joint"]), 3].mean()
            assert found == pytest.approx(float(wanted[placement]), abs=CM)


@pytest.mark.slow
def test_the_yaw_of_the_shoulder_angles_scatters_as_the_readme_says(as_logged: dict[str, Any]) -> None:
    yaw = as_logged["methods"]["stand-still"]["yaw_deg"]
    assert yaw["parallel"]["sd"] == pytest.approx(1.8, abs=0.3)
    assert 25 < yaw["45"]["mean"] < 45 < yaw["90"]["mean"] < 80


@pytest.mark.slow
def test_a_plain_robust_fit_scores_what_such_fits_are_known_to_score(study_logs: Path) -> None:
    # Walk, participant 4, calibrated on Stationary and Steps: below what was logged, by about what the data's README
    # has for all people (8.9/16.9/30.3 → 5.3/8.5/12.8 with raw labels and a time offset).
    result = evaluate(study_logs, ["stand-still"], [4], makers={"fit": Repaired})
    logged, fit = (result["methods"][name]["tasks"] for name in ("stand-still", "fit"))
    for placement, at_most in (("parallel", 4.5), ("45", 6.0), ("90", 14.5)):
        frozen, row = fit["walk-frozen"][placement], fit["walk"][placement]
        assert frozen["problem"] == row["problem"] == ""
        assert frozen["pairs"] == logged["walk"][placement]["pairs"]
        assert frozen["raw_labels"]["dd_cm"]["mean"] < at_most < logged["walk"][placement]["dd_cm"]["mean"]
        assert frozen["dd_cm"]["mean"] <= frozen["raw_labels"]["dd_cm"]["mean"] + 0.02
    yaw = result["methods"]["fit"]["yaw_deg"]
    assert yaw["parallel"]["mean"] == pytest.approx(0, abs=2.5)
    assert yaw["45"]["mean"] == pytest.approx(45.5, abs=1.5)
    assert yaw["90"]["mean"] == pytest.approx(87.3, abs=2.0)


# How they are made


def scored(participant: int, dd: Any) -> Scored:
    """Of (pairs, 25) Δd."""
    delta = np.repeat(np.asarray(dd, dtype=np.float64)[..., None], 4, axis=-1)
    return Scored(participant, delta, delta)


def test_participants_count_alike_however_many_pairs_and_files_they_have() -> None:
    files = [scored(1, np.full((10, 25), 0.01)), scored(1, np.full((30, 25), 0.03)), scored(2, np.full((1, 25), 0.10))]
    row = figures(files, repaired=True)["dd_cm"]
    assert row["mean"] == pytest.approx((2.5 + 10) / 2)
    assert row["worst_participant"] == pytest.approx(10)
    assert row["std"] == pytest.approx(0)


def test_a_joint_that_is_never_seen_has_no_mean_and_another_that_of_its_pairs() -> None:
    apart = np.full((2, 25), 0.02)
    apart[:, 7] = apart[1, 9] = np.nan
    _, means = joint_means([scored(1, apart)], repaired=True)
    np.testing.assert_allclose(means[0, :, 3], np.where(np.arange(25) == 7, np.nan, 0.02))


def test_differences_are_those_of_two_views_wherever_both_are() -> None:
    one = np.random.default_rng(0).normal(size=(4, 25, 3))
    for shift in (0.0, 5.0):
        found = differences(np.stack([one, one + np.array([0.03, -0.04, 0.12])], axis=1) + shift)
        np.testing.assert_allclose(found, np.tile([0.03, 0.04, 0.12, 0.13], (4, 25, 1)))


def test_times_begin_with_the_files_first_frame() -> None:
    at_s = StudySession(log_of(frames=12)).at_s
    assert at_s.min() == 0
    assert 0.3 < at_s.max() < 0.5


def test_std_is_over_the_joints_of_the_mean_over_people() -> None:
    by_joint = np.arange(25) / 100
    row = figures([scored(1, [by_joint]), scored(2, [by_joint[::-1]])], repaired=True)
    assert row["dd_cm"]["std"] == pytest.approx(0)
    row = figures([scored(1, [by_joint]), scored(2, [by_joint])], repaired=True)
    assert row["dd_cm"]["std"] == pytest.approx(np.std(np.arange(25), ddof=1))
    assert row["torso_dd_cm"]["mean"] == pytest.approx(np.mean(TORSO))


@given(st.lists(st.tuples(st.integers(1, 2), st.integers(0, 3), st.integers(0, 1)), min_size=1, max_size=30))
def test_a_pair_is_the_first_two_rows_of_a_result_and_person(keys: list[tuple[int, int, int]]) -> None:
    rows = examples.Rows(frames=(len(keys) + 1) // 2)
    rows.take(range(len(keys)))
    for name, values in zip(("scenario_id", "tracker_time_ms", "person_id"), zip(*keys, strict=True), strict=True):
        rows[name] = np.array(values)
    by_key: dict[tuple[int, int, int], list[int]] = {}
    for i, key in enumerate(keys):
        by_key.setdefault(key, []).append(i)
    expected = {tuple(found[:2]) for found in by_key.values() if len(found) > 1}
    pairs = pairs_of(rows.log())
    assert {tuple(pair) for pair in pairs.rows.tolist()} == expected
    assert len(pairs) == len(expected)
    times = rows["tracker_time_ms"][pairs.rows[:, 0]]
    assert (np.diff(times) >= 0).all()


def test_a_four_after_the_first_eight_is_an_eight() -> None:
    rows = examples.Rows(frames=3)
    rows["scenario_id"] = np.array([4, 4, 8, 4, 5, 4])
    assert corrected_tasks(rows.log()).tolist() == [4, 4, 8, 8, 5, 8]


def test_a_row_fails_for_one_pair_or_joint_less_and_for_a_motion_that_wanders() -> None:
    whole = Count(10, 250)
    assert problem(whole, whole, MAX_WANDER) == ""
    assert "9 pairs" in problem(Count(9, 225), whole, 0)
    assert "249" in problem(Count(10, 249), whole, 0)
    assert "wanders" in problem(whole, whole, MAX_WANDER + 0.1)


def test_json_has_no_nan() -> None:
    assert rounded({"a": [np.nan, 1.00001, "x"], "b": float("inf")}) == {"a": [None, 1.0, "x"], "b": None}


def test_a_folder_without_logs_and_people_who_are_not_in_it_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        list(study_sessions(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="has no study logs"):
        list(study_sessions(tmp_path))
    write_study_log(tmp_path / "Study_7_Kinect_2_Time_1.csv", log_of(frames=12).rows())
    (tmp_path / "Study_8_Kinect_2_Time_1.csv").write_text(", ".join(examples.HEADER) + "\n")
    with pytest.raises(SettingsError, match="has no participant 5; it has 7, 8"):
        list(study_sessions(tmp_path, [5]))
    assert [session.participant for session in study_sessions(tmp_path)] == [7]


def test_logs_of_one_sensor_have_nothing_to_score(tmp_path: Path) -> None:
    alone = [row for row in log_of(frames=12).rows() if row.skeleton_id == 0]
    write_study_log(tmp_path / "Study_7_Kinect_2_Time_1.csv", alone)
    with pytest.raises(InputError, match="no log has a person whom two sensors saw"):
        evaluate(tmp_path, ["stand-still"])


def test_a_file_of_two_participants_is_refused() -> None:
    log = log_of(frames=12)
    mixed = msgspec.structs.replace(log, study_id=np.where(np.arange(24) < 12, 7, 8))
    with pytest.raises(InputError, match="several participants"):
        StudySession(mixed)
