"""Views are aligned by what a method knew before; pairs it could not align are counted; joints are hidden in turns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.engine_items import measured_files
from support.evaluation_sessions import log_of, session_of
from support.reference_methods import BatchFit, Method

from mocapella.errors import EvaluationError, SettingsError
from mocapella.evaluation.methods import settings_used
from mocapella.evaluation.study_tables import differences
from mocapella.geometry import rigid
from mocapella.recording.study_log import read_study_log
from mocapella.studies import method_views
from mocapella.studies.engines import run_each
from mocapella.studies.hidden_joints import HIDDEN_S, PARTS, PERIOD_S, hidden_joints, without_joints
from mocapella.studies.method_results import results_of_methods
from mocapella.studies.method_views import TrackedRecording, views_of_methods

WRONG = rigid.rigid(rigid.rotation_about_y(0.1), np.array([0.05, 0.0, 0.02]))
"""What the calibration of the day did."""


class WithoutMotion(Method):
    """A method that never knows the second sensor's pose."""

    def start_from(self, T_world_sensor: Any) -> None:
        super().start_from(T_world_sensor)
        self.T = {self.reference: self.T[self.reference]}


class LeavesOut(BatchFit):
    """A method that remembers which participant it left out."""

    left_out: list[int] = []  # noqa: RUF012 - of all of them

    def leave_out(self, participant: int) -> None:
        self.left_out.append(participant)


class Fails(Method):
    """A method whose motions are not rigid."""

    def start_from(self, T_world_sensor: Any) -> None:
        super().start_from({name: 2 * T for name, T in T_world_sensor.items()})


@pytest.fixture
def methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of small methods, beside the registered ones."""
    known = {"fit": BatchFit, "blind": WithoutMotion, "leaves": LeavesOut, "fails": Fails}
    real = method_views.scored_tracker
    monkeypatch.setattr(method_views, "scored_tracker", lambda name: known.get(name) or real(name))


def test_stand_still_is_the_logged_rows() -> None:
    log = log_of(frames=60)
    (views,) = views_of_methods(log, ["stand-still"])
    np.testing.assert_array_equal(views.views, log.positions[views.rows].astype(float))
    np.testing.assert_allclose(views.fused, views.views.mean(axis=1))
    assert (views.method, views.placement, views.participant, views.problems) == ("stand-still", "90", "7", {})
    assert views.sensor.tolist() == [[0, 1]] * 60
    assert sorted(set(views.task.tolist())) == ["stationary", "steps", "walk"]


@pytest.mark.usefixtures("methods")
def test_a_method_that_finds_the_motion_is_nearer_than_the_log() -> None:
    logged, fitted = views_of_methods(log_of(wrong=WRONG), ["stand-still", "fit"])
    walk = logged.task == "walk"
    apart = [np.nanmean(differences(one.views[walk])[..., 3]) for one in (logged, fitted)]
    assert apart[1] < apart[0] / 2
    assert not fitted.unaligned.any()
    assert fitted.rows.tolist() == logged.rows.tolist()


@pytest.mark.usefixtures("methods")
def test_a_pair_without_a_motion_in_time_is_counted_and_its_task_has_a_problem() -> None:
    results = results_of_methods(log_of(frames=60), ["stand-still", "blind"])
    logged, blind = results.views
    assert len(blind.views) == len(logged.views)
    assert blind.unaligned.all()
    assert set(blind.problems) == {"stationary", "steps", "walk"}
    assert blind.problems["walk"] == "20 of 20 pairs: a motion was not known in time"
    assert sum(finding.rows for finding in results.findings) == 60
    assert all("method blind" in finding.what for finding in results.findings)


@pytest.mark.usefixtures("methods")
def test_a_method_that_fails_is_named_and_the_others_go_on() -> None:
    results = results_of_methods(log_of(frames=30), ["fails", "unheard", "stand-still"])
    assert [one.method for one in results.views] == ["stand-still"]
    assert "no rigid motion" in results.findings[0].what
    assert "unknown tracking method 'unheard'" in results.findings[1].what
    with pytest.raises(EvaluationError, match="no rigid motion"):
        views_of_methods(log_of(frames=30), ["fails"])
    with pytest.raises(SettingsError, match="unknown tracking method"):
        views_of_methods(log_of(frames=30), ["unheard"])
    with pytest.raises(SettingsError, match=r"unknown measure 'lots'; known: .*lost"):
        results_of_methods(log_of(frames=30), [], ["lots"])


@pytest.mark.usefixtures("methods")
def test_every_run_leaves_the_participant_out() -> None:
    LeavesOut.left_out.clear()
    recording = TrackedRecording(session_of(frames=30), "leaves")
    recording.pairs()
    list(recording.tasks(hide=True))
    assert LeavesOut.left_out == [7, 7]  # one run for pairs and tasks, and one with hidden joints


@pytest.mark.usefixtures("methods")
def test_a_method_runs_once_for_pairs_and_tasks_and_once_more_with_hidden_joints_if_a_measure_needs_it() -> None:
    for measures, runs in ((["lost"], 1), (["lost", "filled"], 2)):
        LeavesOut.left_out.clear()
        results_of_methods(log_of(frames=30), ["leaves"], measures)
        assert len(LeavesOut.left_out) == runs


def test_hidden_joints_are_those_of_one_sensor_and_part_in_each_stretch() -> None:
    session = session_of(frames=900)
    hidden = hidden_joints(session)
    seen = set()
    for task in np.unique(session.log.scenario_id):
        of_task = session.log.scenario_id == task
        since_s = session.at_s - session.at_s[of_task].min()
        for stretch in range(int(since_s[of_task].max() // PERIOD_S)):
            rows = of_task & (since_s // PERIOD_S == stretch)
            masked = rows & hidden.any(axis=1)
            assert len(np.unique(session.sensor[masked])) == 1
            assert np.ptp(since_s[masked]) <= HIDDEN_S
            parts = {tuple(np.flatnonzero(hidden[row]).tolist()) for row in np.flatnonzero(masked)}
            assert len(parts) == 1
            assert parts <= {tuple(sorted(part)) for part in PARTS}
            seen |= {(int(session.sensor[masked][0]), *parts)}
    assert len(seen) >= 4


def test_only_the_hidden_joints_are_taken_from_the_frames() -> None:
    session = session_of(frames=150)
    hidden = hidden_joints(session)
    frames = without_joints(session, hidden)
    again = session_of(frames=150)
    again.frames = frames
    raw = np.stack([again._raw(row) for row in range(len(session.log))])
    np.testing.assert_array_equal(np.isnan(raw).all(axis=-1), hidden | np.isnan(session.raw).all(axis=-1))
    np.testing.assert_array_equal(raw[~hidden], session.raw[~hidden])
    assert all(
        (a is b) == (a.at_ns == b.at_ns and a.frame is b.frame)
        for a, b in zip(frames.arrivals, session.frames.arrivals, strict=True)
    )


@pytest.mark.usefixtures("methods")
def test_a_hidden_joint_is_predicted_from_the_other_sensor() -> None:
    log = log_of(frames=240, wrong=WRONG)
    log = msgspec.structs.replace(log, scenario_id=np.where(log.scenario_id == 3, 6, log.scenario_id))
    results = results_of_methods(log, ["fit", "stand-still"])
    found = {(one.method, one.quantity, one.subject): one.value for one in results.measured if one.measure == "filled"}
    # The small method takes a sensor's newest body as it is: with the hidden joints it lacks the fused ones, too.
    assert found["fit", "hidden joints not filled", "front"] == 100
    assert found["stand-still", "hidden joints not filled", "front"] == 0
    other = found["stand-still", "same joints, other sensor", "front"]
    assert found["stand-still", "hidden joints", "front"] == pytest.approx(other)
    assert found["stand-still", "same joints, not hidden", "front"] == pytest.approx(other / 2, rel=1e-6)


def test_a_view_that_the_program_went_on_drawing_is_none() -> None:
    log = log_of(frames=90)
    second, step = log.skeleton_id == 1, np.arange(len(log)) // 2
    stopped = int(log.skeleton_time_ticks[second & (step == 40)][0])
    ticks = np.where(second & (step > 40) & (step < 60), stopped, log.skeleton_time_ticks)
    log = msgspec.structs.replace(log, skeleton_time_ticks=ticks, scenario_id=np.full(len(log), 6))
    results = results_of_methods(log, ["stand-still"], ["lost"])
    found = {(one.quantity, one.subject): one.value for one in results.measured}
    assert found["losses", "side"] == 1
    assert found["longest loss", "side"] == pytest.approx(20 / 30 - 0.3, abs=0.07)
    assert found["losses", "front"] == found["losses", "fused"] == 0


@pytest.mark.slow
def test_default_fills_hidden_joints_better_than_the_thesis_and_keeps_identities(study_logs: Path) -> None:
    log = read_study_log(study_logs / "Study_20_Kinect_1_Time_1_30_34_PM.csv.gz")
    results = results_of_methods(log, ["stand-still", "default"])
    hidden, switches = {}, {}
    for method in ("stand-still", "default"):
        rows = [one for one in results.measured if one.method == method]
        hidden[method] = np.mean([one.value for one in rows if one.quantity == "hidden joints"])
        switches[method] = sum(one.value for one in rows if one.quantity == "switches against labels")
    assert hidden["default"] < hidden["stand-still"]
    assert switches == {"stand-still": 0, "default": 0}
    assert results.findings == ()
    assert {strip.task for strip in results.strips} == {"around-first", "around-second", "exchange"}


@pytest.mark.slow
def test_real_logs_give_the_same_on_every_engine(study_logs: Path) -> None:
    files = [str(path) for path in sorted(study_logs.glob("Study_[2345]_Kinect_2*.csv.gz"))][1::2]
    here = run_each(measured_files, files)
    assert run_each(measured_files, files, "dask:2") == here
    assert run_each(measured_files, files, "local:2") == here
    assert len(here) == 4


def test_all_settings_of_a_method_are_stated_also_the_defaults() -> None:
    assert settings_used("stand-still") == "the rows as they were logged"
    stated = [msgspec.json.decode(settings_used(name)) for name in ("default", "default:people.least_worth=0.3")]
    assert stated[1]["people"].pop("least_worth") == 0.3
    assert stated[0]["people"].pop("least_worth") == 0.2
    assert stated[0] == stated[1]
    with pytest.raises(SettingsError, match="smoothin"):
        settings_used("default:people.smoothin=kalman")
