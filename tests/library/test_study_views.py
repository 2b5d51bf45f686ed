"""Study logs as motion: nothing is lost or moved, and labels that change within a log stay with their rows."""

from __future__ import annotations

import gzip
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.study_examples import FRONT, NOON_MS, Rows, study_rows

import mocapella
from mocapella.errors import InputError, SettingsError
from mocapella.library.study_views import study_views
from mocapella.model.study_log import StudyLog, StudyRow
from mocapella.recording.study_log import read_study_log, write_study_log


@given(frames=st.integers(1, 6), seed=st.integers(0, 99), data=st.data())
def test_every_row_is_at_its_place_and_the_labels_are_of_its_time(frames: int, seed: int, data: st.DataObject) -> None:
    rows = Rows(frames, seed)
    scenarios = data.draw(st.lists(st.sampled_from([-9999, 1, 3]), min_size=2 * frames, max_size=2 * frames))
    rows["scenario_id"] = np.array(scenarios)
    order = data.draw(st.permutations(range(2 * frames)))
    log = rows.log()
    found = study_views(rows.take(order).log())
    assert set(found.individuals) == {"person_0@front", "person_0@side"}
    for i in range(len(log)):
        name = "person_0@front" if log.kinect_id[i] == FRONT else "person_0@side"
        own = found.positions[:, found.individuals.index(name)]
        frame = int(np.nanargmin(np.abs(own - log.positions[i]).sum(axis=(1, 2))))
        np.testing.assert_array_equal(own[frame], log.positions[i].astype(np.float64))
        scenario = {-9999: "", 1: "stationary", 3: "walk"}[scenarios[i]]
        assert found.labels[int(found.runs[frame])]["scenario"] == scenario
    assert len(found) == len(log)
    assert (np.diff(found.times_s) > 0).all()


@given(st.lists(study_rows(), min_size=1, max_size=4), st.booleans())
def test_any_log_gives_motion_or_one_of_our_errors(rows: list[StudyRow], possible: bool) -> None:
    if possible:  # random times are hardly ever
        times: dict[str, int] = {"tracker_time_ms": NOON_MS, "skeleton_time_ticks": 5, "person_id": 3}
        rows = [msgspec.structs.replace(row, **times) for row in rows]
    columns = {name: np.array([getattr(row, name) for row in rows]) for name in StudyRow.__struct_fields__}
    try:
        found = study_views(StudyLog(source="log.csv", **columns))
    except (InputError, SettingsError):
        return
    assert len(found) == 1
    assert set(found.runs.tolist()) == {0}


def test_the_times_are_of_one_clock_and_of_its_date() -> None:
    found = study_views(Rows(4).log())
    front = found.times_s[found.present[:, found.individuals.index("person_0@front")]]
    np.testing.assert_allclose(np.diff(front), 1 / 30, atol=2e-3)
    assert 2.0e17 < found.began_unix_ns < 2.0e18


def test_of_rows_that_repeat_a_view_the_first_counts() -> None:
    rows = Rows(3)
    first = rows["positions"][0].copy()
    rows.take([0, 0, 1, 2, 3, 4, 5])
    rows["positions"][1] += 1
    found = study_views(rows.log())
    np.testing.assert_array_equal(found.positions[0, found.individuals.index("person_0@front")], first)


def test_missing_joints_are_unknown_and_impossible_times_are_refused() -> None:
    rows = Rows(3)
    rows["positions"][0, 5] = np.nan
    found = study_views(rows.log())
    assert not found.states[0, found.individuals.index("person_0@front"), 5]
    with pytest.raises(InputError, match="Tracker_Time"):
        study_views(Rows(3).set("tracker_time_ms", 2, 7).log())


def test_a_log_is_loaded_with_its_labels_and_can_be_tracked(tmp_path: Path) -> None:
    rows = Rows(60)
    rows["scenario_id"][40:] = 4
    rows["kinect_config"][80:] = 1
    write_study_log(tmp_path / "walk.csv", rows.log().rows())
    recording = mocapella.load(tmp_path / "walk.csv")
    assert recording.views is not None
    assert recording.people is None
    assert recording.labels == {
        0: {"participant": 7, "placement": "right-90", "scenario": "walk"},
        1: {"participant": 7, "placement": "right-90", "scenario": "around-first"},
        2: {"participant": 7, "placement": "right-45", "scenario": "around-first"},
    }
    assert set(recording.views.to_pandas()["scenario"]) == {"walk", "around-first"}
    assert ".views: <views: person_0@front, person_0@side; 25 keypoints, 120 frames" in repr(recording)
    assert "no world" in recording.problems[0]
    assert recording.seconds == pytest.approx(59 / 30, abs=0.1)
    with pytest.raises(SettingsError, match="only a take has"):
        recording.seen_from("front")
    with pytest.raises(InputError, match="several placements"):
        mocapella.track(recording, "stand-still", frames=10)
    again = mocapella.track(recording, "stand-still", placement="right-90", frames=10)
    assert again.sensors == ("front", "side")
    assert len(list(again.scenes())) == 80


def test_a_table_that_is_no_study_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(b"a,b\n1,2\n"))
    for name in ("a.csv", "b.csv.gz"):
        with pytest.raises(InputError, match=name):
            mocapella.load(tmp_path / name)


@pytest.mark.slow
def test_a_real_log_keeps_every_joint_of_every_row(study_logs: Path) -> None:
    path = study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
    log, views = read_study_log(path), mocapella.load(path).views
    assert views is not None
    repeated = 197  # as `mocapella replay` says
    assert views.present.sum() == len(log) - repeated
    known = np.sort(views.positions[np.isfinite(views.positions)])
    assert np.isin(known[::97], log.positions.astype(np.float64)).all()
