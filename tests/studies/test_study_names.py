"""A study's own tasks, placements and codes have their names everywhere, in the order of its protocol."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support import study_examples as examples
from support import take_making
from support.programs import run_here
from support.reference_methods import BatchFit

from mocapella.model.scene import Person
from mocapella.recording.study_log import read_study_log, write_study_log
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene
from mocapella.studies import method_views
from mocapella.studies.analysis import merge
from mocapella.studies.naming import RecordingNames, names_of_study
from mocapella.studies.pooled_tasks import BETWEEN_SENSORS, TO_FUSED, placements_of, pooled_tasks, tasks_of
from mocapella.studies.progress import NOTHING_TRACKED, StudyAction, advance, begin
from mocapella.studies.protocol import plan
from mocapella.studies.recordings import find_recordings
from mocapella.studies.results import FileResults, StudyResults
from mocapella.studies.state_file import load_session, new_session, save_session
from mocapella.studies.study_folder import PROTOCOL, StudyFolder, new_study
from mocapella.studies.study_tables import compared_of, tables_of
from mocapella.studies.task_log import write_logs
from mocapella.studies.whole_analysis import analyze_recordings

polars = pytest.importorskip("polars")
NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
START = 1_700_000_000 * take_making.SECOND
STEP = take_making.STEP
TOML = b"""
title = "Throwing"
participants = { codes = ["P01", "P02"] }
[[placements]]
name = "wide"
number = 7
[[placements]]
name = "narrow"
number = 6
[[tasks]]
name = "throw"
scenario = 22
steps = [{ text = "Throw." }]
[[tasks]]
name = "catch"
scenario = 21
repetitions = 2
steps = [{ text = "Catch." }]
"""


def two_views(step: int, apart_m: float) -> bytes:
    """A result with two views of a person, at a distance, and the fused person between them."""
    scene = take_making.scene(step, "front", step)
    front = scene.people[0].views[0]
    shift = np.array([apart_m, 0.0, 0.0])
    side = msgspec.structs.replace(front, sensor="side", positions=front.positions + shift)
    person = Person(0, front.positions + shift / 2, scene.people[0].states, (front, side))
    return encode_scene(msgspec.structs.replace(scene, parts={"people": (person,)}))


def write_take(path: Path, frames: int = 90, label: str = "") -> None:
    setup = take_making.info()
    if label:
        setup = msgspec_replace_setup(setup, label)
    writer = TakeWriter.create(path, info=setup, reserve_bytes=0)
    for step in range(frames):
        take_making.write_frame(writer, "front", step, step * STEP)
        take_making.write_frame(writer, "side", step, step * STEP)
        writer.write_scene(two_views(step, 0.04 if step < 30 else 0.08), step * STEP)
    writer.close()


def msgspec_replace_setup(info: Any, label: str) -> Any:
    from dataclasses import replace

    return replace(info, setup=replace(info.setup, scenario=label, placement="wide"))


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    """A study with a participant who threw once and caught twice, in one placement."""
    study = new_study(tmp_path / "study", TOML, by="Op1", at=NOW)
    own = study.make_participant("P01")
    write_take(own / "wide.mcap")
    session = new_session(study.protocol, begin("P01", plan(study.protocol, "P01"), START))
    for do, at in (
        ("next", 0), ("next", 1), ("next", 29), ("next", 30), ("next", 31), ("next", 50), ("next", 51), ("next", 52),
        ("next", 80), ("abort", 81),
    ):  # fmt: skip
        action = StudyAction(do, forced=True)  # type: ignore[arg-type]
        session = session.after(advance(session.state, action, START + at * STEP))
    save_session(own / "session.json", session)
    return study


def analyzed(folder: Path, **options: Any) -> StudyResults:
    found, names = find_recordings(folder), names_of_study(folder)
    assert names is not None
    files = analyze_recordings(found.paths, names=names, **options)
    return merge(files, (*found.findings, *names.findings), names.order)


def keys_of(results: StudyResults | FileResults) -> set[tuple[str, ...]]:
    return {msgspec.structs.astuple(one.key) for one in results.summaries}


def test_logs_and_takes_of_a_study_have_its_names_and_fused_people_are_compared(study: StudyFolder) -> None:
    write_logs(study, "P01", by="Op1", at=NOW)
    results = analyzed(study.path)
    method = "stand-still"  # that of the take
    assert keys_of(results) == {
        (method, "wide", task, "P01", *views)
        for task in ("throw", "catch")
        for views in (("front", "side"), ("front", "fused"), ("side", "fused"))
    }
    pairs = {(one.key.task, one.key.second): one.pairs for one in results.summaries}
    assert pairs["throw", "side"] == pairs["throw", "fused"] == 28  # each result is compared once
    assert pairs["catch", "side"] == pairs["catch", "fused"] == 19 + 28  # both repetitions
    for one in results.summaries:
        apart = 0.04 if one.key.task == "throw" else 0.08
        wanted = apart / 2 if one.key.second == "fused" else apart
        assert float(np.nanmean(one.means[:, 3])) == pytest.approx(wanted, rel=0.1)
    assert any("has logs of their tasks" in one.what for one in results.findings)


def test_a_take_without_logs_is_named_by_its_session(study: StudyFolder) -> None:
    pairs = {msgspec.structs.astuple(one.key)[2:]: one.pairs for one in analyzed(study.path).summaries}
    assert pairs["throw", "P01", "front", "side"] == 28
    assert pairs["catch", "P01", "side", "fused"] == 19 + 28


def test_the_order_is_the_protocols_in_tables_pictures_and_report(study: StudyFolder) -> None:
    results = analyzed(study.path)
    assert results.order.tasks == ("throw", "catch")
    assert results.order.placements == ("wide", "narrow")
    for name, file in (("b.csv", 7), ("a.csv", 6)):
        rows = examples.Rows(frames=3)
        rows["kinect_config"], rows["study_id"] = np.full(6, file), np.full(6, 2)
        rows["scenario_id"] = np.array([21, 21, 21, 21, 22, 22])
        rows["tracker_time_ms"] = rows["tracker_time_ms"] // 10  # of both sensors at once
        write_study_log(study.path / name, rows.log().rows())
    results = analyzed(study.path)
    (sensors,) = (one for one in compared_of(results) if one.second == "side")
    assert sensors.tasks == ("throw", "catch")
    assert sensors.placements() == ("wide", "narrow")
    (pooled,) = (tasks for views, tasks in pooled_tasks(results).items() if views.views == BETWEEN_SENSORS)
    assert (tasks_of(pooled), placements_of(pooled)) == (("throw", "catch"), ("wide", "narrow"))
    assert any(views.views == TO_FUSED for views in pooled_tasks(results))
    text = repr(tables_of(results))
    assert not re.search(r"(scenario|placement)-\d", text)


def test_an_edited_protocol_is_named_and_each_session_has_its_own_names(study: StudyFolder) -> None:
    write_logs(study, "P01", by="Op1", at=NOW)
    before = keys_of(analyzed(study.path))
    edited = TOML.replace(b'"throw"', b'"hurl"').replace(b"scenario = 22", b"scenario = 21", 1)
    edited = edited.replace(b'"catch"\nscenario = 21', b'"catch"\nscenario = 22')
    (study.path / PROTOCOL).write_bytes(edited)
    results = analyzed(study.path)
    assert keys_of(results) == before
    assert results.order.tasks == ("hurl", "catch", "throw")
    (finding,) = (one for one in results.findings if "edited" in one.what)
    assert finding.what == "participant P01: the protocol was edited after the session began (tasks)"


def test_a_task_without_anybody_is_a_finding(study: StudyFolder) -> None:
    file = study.path / "participants" / "P01" / "session.json"
    session = load_session(file)
    last = max(place for place, event in enumerate(session.events) if event.what == "finished")
    events = [
        msgspec.structs.replace(event, note=NOTHING_TRACKED) if place == last else event
        for place, event in enumerate(session.events)
    ]
    save_session(file, msgspec.structs.replace(session, events=tuple(events)))
    (finding,) = (one for one in analyzed(study.path).findings if "nobody" in one.what)
    assert finding.what == "participant P01: nobody was tracked in catch (wide, repetition 2)"


def test_tasks_of_one_number_are_told_apart_by_the_session(study: StudyFolder) -> None:
    same = TOML.replace(b"scenario = 22", b"scenario = 21")
    (study.path / PROTOCOL).write_bytes(same)
    file = study.path / "participants" / "P01" / "session.json"
    session = load_session(file)
    changed = tuple(
        msgspec.structs.replace(one, task=msgspec.structs.replace(one.task, scenario=21)) for one in session.state.plan
    )
    events = tuple(msgspec.structs.replace(event, scenario=21) for event in session.events)
    state = msgspec.structs.replace(session.state, plan=changed)
    save_session(file, msgspec.structs.replace(session, state=state, events=events))
    write_logs(study, "P01", by="Op1", at=NOW)
    assert {key[2] for key in keys_of(analyzed(study.path))} == {"throw", "catch"}
    names = names_of_study(study.path)
    assert names is not None
    assert names.general.task(21) == "scenario-21"  # which of the two is unknown


def test_a_damaged_session_and_a_damaged_protocol_are_findings(study: StudyFolder) -> None:
    write_logs(study, "P01", by="Op1", at=NOW)
    (study.path / "participants" / "P01" / "session.json").write_text("{")
    results = analyzed(study.path)
    assert any("the session of P01 cannot be read" in one.what for one in results.findings)
    assert {key[2] for key in keys_of(results) if key[5] != "fused"} == {"throw", "catch"}
    (study.path / PROTOCOL).write_text("title = 1")
    results = analyzed(study.path)
    assert any("the protocol cannot be read" in one.what for one in results.findings)
    assert "scenario-22" in {key[2] for key in keys_of(results)}


def test_a_take_has_the_names_of_its_labels(tmp_path: Path) -> None:
    write_take(tmp_path / "any.mcap", label="throw")
    results = merge(analyze_recordings([tmp_path / "any.mcap"]))
    assert {(key[1], key[2]) for key in keys_of(results)} == {("wide", "throw")}


def test_a_study_log_alone_has_the_thesis_names(tmp_path: Path) -> None:
    names = RecordingNames()
    assert (names.task(3), names.task(40), names.placement(3), names.placement(9), names.placement(-9999)) == (
        "walk", "scenario-40", "45", "placement-9", "not said",
    )  # fmt: skip
    assert names_of_study(tmp_path) is None


def test_views_recorded_by_a_method_and_tracked_again_by_it_are_apart(
    study: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_logs(study, "P01", by="Op1", at=NOW)
    names = names_of_study(study.path)
    assert names is not None
    monkeypatch.setattr(method_views, "scored_tracker", lambda name: BatchFit)
    other = msgspec.structs.replace(names, methods=dict.fromkeys(names.methods, "fit"))
    log = next(path for path in find_recordings(study.path).paths if path.name.endswith(".csv.gz"))
    (result,) = analyze_recordings([log], names=other, methods=["fit"])
    assert {key[0] for key in keys_of(result)} == {"recorded-fit", "fit"}


def test_rows_of_a_task_are_in_one_space_also_where_the_first_sensor_sees_nobody(study: StudyFolder) -> None:
    log = write_logs(study, "P01", by="Op1", at=NOW)[0]
    rows = read_study_log(log.files[0])
    assert set(zip(rows.kinect_id.tolist(), rows.skeleton_id.tolist(), strict=True)) == {("front", 0), ("side", 1)}


def test_the_command_takes_codes_and_numbers_and_writes_the_names(study: StudyFolder) -> None:
    write_logs(study, "P01", by="Op1", at=NOW)
    for number, code in enumerate(("P01", "1")):
        words = ("study", "analyze", str(study.path), "--out", f"out-{number}", "--participants", code, "--tables-only")
        done = run_here(study.path.parent, *words)
        assert done.returncode == 0, done.stderr
        tables = {path.name for path in (study.path.parent / f"out-{number}" / "tables").iterdir()}
        assert {"throw-by-placement-stand-still-front-side.csv", "catch-spread-stand-still-front-fused.md"} <= tables
