"""``mocapella lab train bias``, and that nobody is scored with what was learnt from them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from support.evaluation_sessions import KINECT, log_of, session_of
from support.programs import result_here, run_here
from support.reference_methods import Method

from mocapella.errors import InputError
from mocapella.evaluation import bias_sessions as sessions_module
from mocapella.evaluation.bias_sessions import (
    EVERY,
    NEAR_OTHERS,
    ROWS,
    _kept,
    bias_session,
    bias_sessions,
    learn,
    left_out,
    make_tracker,
    trained_on,
)
from mocapella.evaluation.fused_metrics import facing_yaw
from mocapella.evaluation.kinectmultitrack import AsLogged, AsRun
from mocapella.evaluation.study_pairs import Pairs, StudySession
from mocapella.fusion.joint_bias import TERMS, JointBiasModel, LeftOut, read_model, symmetric
from mocapella.geometry.angles import wrap
from mocapella.model.session import SCENARIOS
from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import write_study_log


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder in which `mocapella lab train bias` was run on logs of two people, and what it said."""
    folder = tmp_path_factory.mktemp("bias")
    (folder / "logs").mkdir()
    for participant in (7, 8):
        log = log_of(frames=150, seed=participant)
        log = msgspec.structs.replace(log, study_id=np.full_like(log.study_id, participant))
        write_study_log(folder / "logs" / f"Study_{participant}_Kinect_2_Time_1.csv.gz", log.rows())
    return folder, result_here(folder, "lab", "train", "bias", "logs", "--out", "model.json", "--folds", "2")


@pytest.mark.slow
def test_the_file_says_what_it_learnt_from_and_has_what_is_learnt_without_each(
    trained: tuple[Path, dict[str, Any]],
) -> None:
    folder, said = trained
    model = read_model(folder / "model.json")
    assert model.trained_on == said["trained_on"] == json.loads((folder / "model.json").read_text())["trained_on"]
    assert model.trained_on["participants"] == [7, 8]
    assert model.trained_on["command"] == "mocapella lab train bias DIR --folds 2"
    assert [fold.participants for fold in model.left_out] == [(7,), (8,)]


@pytest.mark.slow
def test_it_prints_rows_of_people_left_out_with_and_without(trained: tuple[Path, dict[str, Any]]) -> None:
    _, said = trained
    for which in ("with", "without"):
        for row in ROWS:
            scored = said["left_out"][which][row]["90"]
            assert scored["participants"] == 2
            assert not scored["problem"]
        assert said["left_out"][which]["fused"]["sessions"] == 2
    dd = {which: said["left_out"][which]["walk"]["90"]["dd_cm"]["mean"] for which in ("with", "without")}
    assert dd["with"] != dd["without"]
    assert dd["with"] < dd["without"] + 0.3  # these sensors have no bias


def test_where_the_model_cannot_be_written_is_said_before_the_work(tmp_path: Path) -> None:
    done = run_here(tmp_path, "lab", "train", "bias", "logs", "--out", "no/m.json")
    assert done.returncode == 1
    assert "--out no/m.json: no folder no; name a file in a folder that exists" in done.stderr


def test_a_folder_without_two_sensors_teaches_no_bias(tmp_path: Path) -> None:
    log = only_one_sensor(log_of(frames=30))
    write_study_log(tmp_path / "Study_7_Kinect_2_Time_1.csv.gz", log.rows())
    with pytest.raises(InputError, match="nothing to learn a joint bias from"):
        bias_sessions(tmp_path)


@pytest.mark.slow
def test_two_people_near_each_other_teach_a_bias_each_as_much_as_the_other(study_logs: Path) -> None:
    (session,) = bias_sessions(study_logs, {22})
    study, views = session.study, session.views
    assert study.two_people
    assert views.weight.sum() == pytest.approx(NEAR_OTHERS / EVERY, rel=0.01)
    assert len(set(views.weight.tolist())) == 1
    used = [int(np.ceil((study.pairs.person == person).sum() / EVERY)) for person in np.unique(study.pairs.person)]
    assert len(views.weight) == sum(used)
    assert trained_on([session])["sessions_of_two_people"] == 1


def test_every_few_pairs_of_each_person_are_used_although_people_take_turns() -> None:
    person = np.tile([3, 8], 20)
    kept = _kept(Pairs(np.zeros((40, 2), dtype=np.int64), person, np.ones(40, dtype=np.int64)))
    assert [int(kept[person == one].sum()) for one in (3, 8)] == [20 // EVERY, 20 // EVERY]


def test_what_is_learnt_from_is_the_two_views_in_one_order_with_facings() -> None:
    session = bias_session(session_of(noise=0.005))
    assert session is not None
    views = session.views
    known = np.isfinite(views.facing).all(axis=1)
    assert known.mean() > 0.9
    assert views.weight.sum() == pytest.approx((1.0 + 0.5 + 0.2) / 4, rel=0.05)
    # Each view by itself says about the same as both together.
    sight = np.arctan2(-views.position[..., 0], -views.position[..., 2])
    alone = wrap(facing_yaw(views.positions) - sight)
    assert np.abs(wrap(alone - views.facing))[known].max() < 0.15


def rows_of(log: StudyLog, kept: Any) -> StudyLog:
    rows = {name: getattr(log, name)[kept] for name in log.__struct_fields__ if name != "source"}
    return msgspec.structs.replace(log, **rows)


def only_one_sensor(log: StudyLog) -> StudyLog:
    return rows_of(log, log.kinect_id == log.kinect_id[0])


def no_walk(log: StudyLog) -> StudyLog:
    return rows_of(log, log.scenario_id != SCENARIOS["walk"])


@pytest.mark.parametrize("change", [only_one_sensor, no_walk])
def test_nothing_is_learnt_from_a_log_without_two_views_of_one_person_who_walks(
    change: Callable[[StudyLog], StudyLog], monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(*_: object) -> None:
        raise AssertionError("it is tracked")

    study = StudySession(change(log_of(frames=60)))
    monkeypatch.setattr(sessions_module, "AsRun", run)
    assert bias_session(study) is None


class Taught(Method):
    """Says who was left out before its first frame."""

    left_out: list[int] = []  # noqa: RUF012

    def leave_out(self, participant: int) -> None:
        assert self.step == 0
        Taught.left_out.append(participant)


def test_a_method_is_told_who_is_scored_before_each_run() -> None:
    Taught.left_out = []
    AsRun(session_of(frames=30), Taught)
    assert Taught.left_out == [7, 7]  # all frames, and Walk's alone


def test_a_participant_is_scored_with_what_was_learnt_without() -> None:
    weights = symmetric(0.01 * np.random.default_rng(0).normal(size=(TERMS, 25, 3)), KINECT.mirror)
    folds = (LeftOut((6,), weights), LeftOut((7,), -weights))
    model = JointBiasModel("kinect_v2", weights, {"participants": [6, 7]}, folds)
    run_of_seven = AsRun(session_of(frames=30), make_tracker(model)).whole
    assert isinstance(run_of_seven.joint_bias, JointBiasModel)
    np.testing.assert_array_equal(run_of_seven.joint_bias.weights, -weights)


def test_weights_of_each_fold_are_learnt_from_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def teach(views: list[int], _: object) -> np.ndarray:
        return np.full((TERMS, 25, 3), float(sum(views)))

    monkeypatch.setattr(sessions_module, "train", teach)
    monkeypatch.setattr(sessions_module, "trained_on", lambda _: {"participants": [1, 2, 3]})
    sessions: Any = [SimpleNamespace(participant=n, views=10**n) for n in (1, 2, 3, 3)]
    model = learn(sessions, [{1}, {3, 2}])
    assert [(of.participants, of.weights.max()) for of in model.left_out] == [((1,), 2100), ((2, 3), 10)]
    assert model.weights.max() == 2110


def test_rows_that_show_a_bias_are_told_with_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    study = session_of(frames=60)
    monkeypatch.setattr(sessions_module, "AsRun", lambda study, _: AsLogged(study))
    sessions: Any = [SimpleNamespace(study=study, plain=AsLogged(study))]
    told = left_out(sessions, None)  # type: ignore[arg-type]
    assert {which: set(rows) for which, rows in told.items()} == {
        which: {*ROWS, "interactions", "fused"} for which in ("without", "with")
    }
