"""One folder with every fault of a study: each is named, counted and explained in the report, and the rest analysed."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.evaluation_sessions import log_of

from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import write_study_log
from mocapella.studies.analysis import merge
from mocapella.studies.cleaning import only
from mocapella.studies.hypotheses import StudyStatistics
from mocapella.studies.naming import names_of_study
from mocapella.studies.progress import begin
from mocapella.studies.protocol import plan, protocol_bytes
from mocapella.studies.recordings import find_recordings
from mocapella.studies.report import report_html
from mocapella.studies.results import StudyResults
from mocapella.studies.state_file import new_session, save_session
from mocapella.studies.study_folder import PROTOCOL, new_study
from mocapella.studies.study_tables import tables_of
from mocapella.studies.whole_analysis import analyze_recordings

NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
FRAMES = 30


def of(participant: int, placement: int = 2, **fields: Any) -> StudyLog:
    """The log of a participant with a placement, 0 parallel or 2 right-90; all do the same tasks."""
    log = log_of(frames=FRAMES)
    count = len(log)
    numbers = {"study_id": np.full(count, participant), "kinect_config": np.full(count, placement)}
    return msgspec.structs.replace(log, **numbers, **fields)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    folder = tmp_path_factory.mktemp("bad") / "study"
    study = new_study(folder, protocol_bytes("kinectmultitrack"), by="Op1", at=NOW)
    session = new_session(study.protocol, begin("P05", plan(study.protocol, "P05"), 1))
    save_session(study.make_participant("P05") / "session.json", session)
    edited = (folder / PROTOCOL).read_text().replace("Stand still, with", "Stand quietly, with")
    (folder / PROTOCOL).write_text(edited)

    for placement in (0, 2):
        write_study_log(folder / f"whole-{placement}.csv", of(1, placement).rows())
    log = of(2)
    write_study_log(folder / "cut.csv", log.rows())
    text = (folder / "cut.csv").read_text()
    (folder / "cut.csv").write_text(text[:-300])
    half = len(log) // 2
    for number, rows in enumerate((np.arange(half), np.arange(half, len(log)))):
        write_study_log(folder / f"part-{number}.csv", only(of(3, 0), rows).rows())
    write_study_log(folder / "cm.csv", of(3, 2, positions=log.positions * np.float32(100)).rows())
    write_study_log(folder / "alone.csv", only(of(4), np.flatnonzero(log.skeleton_id == 0)).rows())
    names = names_of_study(folder)
    assert names is not None
    found = find_recordings(folder)
    files = analyze_recordings(found.paths, names=names)
    return merge(files, (*found.findings, *names.findings), names.order)


FAULTS = {
    "a log that is cut in the middle": ("cut.csv", "row 61: the row has", "rows are left out", 1),
    "a missing condition": ("", "participant P02 has no", "means are those of the others", 0),
    "two files for one condition": ("", "in 2 files: part-0.csv, part-1.csv", "all pairs count alike", 0),
    "units in cm": ("cm.csv", "positions are in cm", "converted to m", 2 * FRAMES),
    "a participant without partner rows": ("alone.csv", "no row of participant P04", "this task is left out", None),
    "a protocol edited in the middle": ("", "participant P05: the protocol was edited", "the session's own plan", 0),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_counted_and_explained_in_the_report(results: StudyResults, fault: str) -> None:
    file, what, effect, rows = FAULTS[fault]
    found = [one for one in results.findings if what in one.what and one.file == file]
    assert found, [one.what for one in results.findings]
    assert all(effect in one.effect for one in found)
    assert rows is None or found[0].rows == rows
    page = report_html(results, tables_of(results), StudyStatistics((), ()), ())
    assert what in page
    assert effect.replace("'", "&#x27;") in page


def test_the_rest_is_analysed(results: StudyResults) -> None:
    people = {(one.key.participant, one.key.placement) for one in results.summaries}
    assert people == {("P01", "parallel"), ("P01", "90"), ("P02", "90"), ("P03", "parallel"), ("P03", "90")}
    by_person = {
        (one.key.participant, one.key.placement, one.key.task): one.means for one in results.summaries
    }  # fmt: skip
    whole = by_person["P01", "90", "walk"]
    np.testing.assert_allclose(by_person["P03", "90", "walk"], whole, atol=1e-6)  # cm and m give the same
    np.testing.assert_allclose(by_person["P03", "parallel", "walk"], by_person["P01", "parallel", "walk"], atol=1e-9)


def test_without_a_fault_there_is_no_finding(tmp_path: Path) -> None:
    write_study_log(tmp_path / "whole.csv", of(1).rows())
    assert merge(analyze_recordings([tmp_path / "whole.csv"])).findings == ()
