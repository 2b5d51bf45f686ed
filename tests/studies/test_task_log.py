"""Logs of tasks are cut to their running parts, and say what the take says."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support import take_making

from mocapella.errors import InputError, RecordingError, TakeExistsError
from mocapella.exports.trajectory_tables import long_columns
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase, TrackerState
from mocapella.recording.study_log import read_study_log
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_trajectories import take_trajectories
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene
from mocapella.studies.progress import StudyAction, advance, begin
from mocapella.studies.protocol import plan, protocol_bytes
from mocapella.studies.state_file import SavedSession, load_session, new_session, save_session
from mocapella.studies.study_folder import StudyFolder, new_study, verify_study
from mocapella.studies.task_log import task_scenes, write_logs
from mocapella.studies.task_runs import TaskRun, valid_runs

polars = pytest.importorskip("polars")
NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
START = 1_700_000_000 * take_making.SECOND
STEP = take_making.STEP
FRAMES = 60


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    """A study with one take of two tasks, the first of them paused in its middle."""
    study = new_study(tmp_path / "study", protocol_bytes("kinectmultitrack"), by="Op1", at=NOW)
    folder = study.make_participant("P07")
    take_making.small_take(folder / "parallel.mcap", FRAMES)
    session = new_session(study.protocol, begin("P07", plan(study.protocol, "P07"), START - 5))
    save_session(folder / "session.json", session)
    return study


def act(study: StudyFolder, *actions: tuple[str, int]) -> SavedSession:
    """Do things at times in steps of the take after its beginning, and save the session."""
    file = study.path / "participants" / "P07" / "session.json"
    session = load_session(file)
    for do, steps in actions:
        action = StudyAction(do, forced=True)  # type: ignore[arg-type]
        session = session.after(advance(session.state, action, START + steps * STEP))
    save_session(file, session)
    return session


def write_take(study: StudyFolder, name: str = "", phase: Phase = Phase.TRACKING) -> None:
    """Replace the take by another one."""
    file = study.path / "participants" / "P07" / "parallel.mcap"
    file.unlink()
    writer = TakeWriter.create(file, info=take_making.info(), reserve_bytes=0)
    for step in range(FRAMES):
        scene = take_making.scene(step, "front", step)
        people = tuple(msgspec.structs.replace(person, name=name) for person in scene.people)
        changed = msgspec.structs.replace(scene, parts={"people": people}, state=TrackerState(phase))
        writer.write_scene(encode_scene(changed), step * STEP)
    writer.close()


TWO_TASKS = (
    ("next", 0),
    ("next", 10),
    ("pause", 20),
    ("resume", 25),
    ("mark", 26),
    ("next", 30),
    ("next", 31),
    ("next", 35),
    *[("next", 36 + number) for number in range(8)],
)


def write(study: StudyFolder) -> Any:
    return write_logs(study, "P07", by="Op1", at=NOW)


def test_a_log_has_the_running_parts_of_its_task_only(study: StudyFolder) -> None:
    session = act(study, *TWO_TASKS)
    logs = write(study)
    assert [log.files[0].name for log in logs] == ["001-right-45-stationary-1.csv.gz", "002-right-45-steps-1.csv.gz"]
    take = read_take(study.path / "participants" / "P07" / "parallel.mcap")
    for log, run in zip(logs, valid_runs(session.events), strict=True):
        times = [unix_ns for _, unix_ns, _, _ in task_scenes(take, run)]
        everything = [
            scene.at_ns + START for _, scene in take.scenes() if any(a <= scene.at_ns + START < b for a, b in run.spans)
        ]
        assert times == everything
        assert log.rows == len(times)
        assert len(read_study_log(log.files[0]).study_id) == len(times)
    assert len(valid_runs(session.events)[0].spans) == 2


def test_the_study_log_has_the_numbers_of_the_protocol(study: StudyFolder) -> None:
    act(study, *TWO_TASKS)
    log = read_study_log(write(study)[1].files[0])
    assert {*log.study_id.tolist()} == {7}
    assert {*log.kinect_config.tolist()} == {1}
    assert {*log.scenario_id.tolist()} == {2}


def test_the_people_are_those_of_the_take_with_states_and_deviations(study: StudyFolder) -> None:
    session = act(study, *TWO_TASKS)
    log = write(study)[0]
    table = polars.read_parquet(log.files[1])
    take = read_take(study.path / "participants" / "P07" / "parallel.mcap")
    whole = take_trajectories(take, ("people",))["people"]
    run = valid_runs(session.events)[0]
    unix_ns = np.round(whole.times_s * 1e9).astype(np.int64) + whole.began_unix_ns
    kept = whole.at(np.array([run.has(one) for one in unix_ns.tolist()]))
    wanted = long_columns(kept)
    assert table["keypoint"].cast(str).to_list() == wanted["keypoint"].texts()  # type: ignore[union-attr]
    assert table["state"].cast(str).to_list() == wanted["state"].texts()  # type: ignore[union-attr]
    for axis in ("x_m", "y_m", "z_m", "sd_m"):
        np.testing.assert_array_equal(table[axis].fill_null(np.nan).to_numpy(), wanted[axis])
    assert set(table["participant"].cast(str)) == {"P07"}
    assert set(table["scenario"].cast(str)) == {"stationary"}
    assert JointState.TRACKED in kept.states


def test_events_are_read_back_as_they_were(study: StudyFolder) -> None:
    session = act(study, *TWO_TASKS)
    rows = polars.read_parquet(write(study)[0].files[2]).to_dicts()
    assert rows == [msgspec.to_builtins(event) for event in session.events if event.index == 0]
    assert "mark" in [row["what"] for row in rows]


def test_logs_are_in_the_manifest_and_are_not_written_twice(study: StudyFolder) -> None:
    act(study, *TWO_TASKS)
    first = write(study)
    assert verify_study(study.path).whole
    before = [file.stat().st_mtime_ns for log in first for file in log.files]
    assert [log.files for log in write(study)] == [(), ()]
    assert [file.stat().st_mtime_ns for log in first for file in log.files] == before


def test_a_log_whose_writing_was_interrupted_is_written_anew(study: StudyFolder) -> None:
    act(study, *TWO_TASKS)
    logs = study.path / "participants" / "P07" / "logs"
    logs.mkdir()
    (logs / "001-right-45-stationary-1.people.parquet").write_bytes(b"half")
    assert len(write(study)[0].files) == 3
    assert verify_study(study.path).whole


def test_a_span_has_its_first_time_and_not_its_last(study: StudyFolder) -> None:
    take = read_take(study.path / "participants" / "P07" / "parallel.mcap")
    times = [scene.at_ns + START for _, scene in take.scenes()]
    run = TaskRun("P07", 0, "right-45", "walk", 3, 1, 1, ((times[5], times[9]),), finished=True)
    assert [unix_ns for _, unix_ns, _, _ in task_scenes(take, run)] == times[5:9]


def test_a_later_file_of_an_interrupted_take_is_not_a_take_of_its_own(study: StudyFolder) -> None:
    folder = study.path / "participants" / "P07"
    (folder / "parallel.part2.mcap").write_bytes((folder / "parallel.mcap").read_bytes())
    act(study, *TWO_TASKS)
    assert len(write(study)) == 2
    assert verify_study(study.path).whole


def test_an_attempt_that_was_repeated_is_not_logged(study: StudyFolder) -> None:
    act(study, ("next", 0), ("next", 1), ("repeat", 10), ("next", 12), ("next", 20))
    (log,) = write(study)
    assert log.run.attempt == 2
    assert log.run.spans == ((START + 12 * STEP, START + 20 * STEP),)


def test_a_task_without_results_is_named(study: StudyFolder) -> None:
    act(study, ("next", 200), ("next", 210), ("next", 220))
    (log,) = write(study)
    assert (log.take, log.rows, log.empty) == ("", 0, True)
    assert [file.name for file in log.files] == ["001-right-45-stationary-1.events.parquet"]
    assert polars.read_parquet(log.files[0])["what"].to_list()[-2:] == ["started", "finished"]
    assert write(study)[0].files == ()


def test_a_task_during_which_the_tracker_was_calibrating_has_its_events_only(study: StudyFolder) -> None:
    write_take(study, phase=Phase.CALIBRATING)
    act(study, *TWO_TASKS)
    assert [(log.take, log.rows, log.empty) for log in write(study)] == [("parallel.mcap", 0, True)] * 2
    files = (study.path / "participants" / "P07" / "logs").iterdir()
    assert {file.name.partition(".")[2] for file in files} == {"events.parquet"}


def test_a_name_that_was_given_in_the_view_does_not_reach_a_log(study: StudyFolder) -> None:
    write_take(study, name="Anna")
    act(study, *TWO_TASKS)
    log = write(study)[0]
    assert set(polars.read_parquet(log.files[1])["individual"].cast(str)) == {"person_0"}


def test_a_take_that_was_overwritten_is_refused(study: StudyFolder) -> None:
    act(study, *TWO_TASKS)
    write(study)
    file = study.path / "participants" / "P07" / "parallel.mcap"
    file.unlink()
    take_making.small_take(file, FRAMES + 4)
    with pytest.raises(TakeExistsError, match="is not the file that is in the manifest"):
        write(study)


def test_without_a_session_or_with_anothers_nothing_is_written(study: StudyFolder) -> None:
    folder = study.path / "participants" / "P07"
    session = act(study)
    save_session(
        folder / "session.json",
        msgspec.structs.replace(session, state=msgspec.structs.replace(session.state, participant="P08")),
    )
    with pytest.raises(RecordingError, match="is of another participant"):
        write(study)
    (folder / "session.json").unlink()
    with pytest.raises(InputError, match=r"session\.json"):
        write(study)
    assert not (folder / "logs").exists()
