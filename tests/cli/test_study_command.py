"""``mocapella study analyze``: its folder, its numbers, its exit status, and what it refuses before any work."""

from __future__ import annotations

import html
import re
import shlex
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support import study_examples as examples
from support.evaluation_sessions import log_of
from support.programs import result_here, run_here

from mocapella.recording.study_log import write_study_log


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    write_study_log(tmp_path / "data" / "first.csv", log_of(frames=12).rows())
    return tmp_path


def test_tables_are_in_a_new_folder_and_in_the_json(study: Path) -> None:
    found = result_here(study, "study", "analyze", "data", "--out", "out", "--tables-only", "--json", "-")
    assert (found["rows"], found["used"], found["participants"], found["findings"]) == (24, 24, ["7"], [])
    assert [row[0] for row in found["tables"]["overall"]["rows"]] == ["Stationary", "Steps", "Walk", "Average"]
    assert not (study / "out" / "report.html").exists()
    names = sorted(path.name for path in (study / "out" / "tables").iterdir())
    assert names == sorted(f"{name}.{end}" for name in found["tables"] for end in ("csv", "md", "tex"))


def test_what_is_printed_and_that_a_report_is_written(study: Path) -> None:
    done = run_here(study, "study", "analyze", "data", "--out", "out")
    assert done.returncode == 0
    assert (study / "out" / "report.html").is_file()
    tables = {path.stem for path in (study / "out" / "tables").iterdir()}
    assert {"overall", "intervals", "h1-within-limit"} <= tables
    assert "1 recordings of 1 participants, 24 rows, 24 of them in pairs" in done.stdout
    assert "Δd by task and placement" in done.stdout
    assert "tables in out/tables" in done.stderr


@pytest.mark.slow
def test_the_report_has_the_settings_and_the_command_that_makes_it_again(study: Path) -> None:
    (study / "data").rename(study / "my data")
    words = ["study", "analyze", "my data", "--out", "out", "--participants", "7"]
    methods = "stand-still,default:people.smoothing=kalman"
    assert run_here(study, *words, "--methods", methods).returncode == 0
    page = html.unescape((study / "out" / "report.html").read_text(encoding="utf-8"))
    (command,) = re.findall(r"<code>mocapella (study analyze .*?)</code>", page)
    assert '"smoothing":"kalman"' in page
    assert "the rows as they were logged" in page
    again = shlex.split(command)
    again[again.index("out")] = "again"
    assert run_here(study, *again).returncode == 0
    tables = {path.name: path.read_bytes() for path in (study / "out" / "tables").iterdir()}
    assert tables == {path.name: path.read_bytes() for path in (study / "again" / "tables").iterdir()}


def test_a_damaged_recording_is_named_and_the_rest_is_analysed(study: Path) -> None:
    text = (study / "data" / "first.csv").read_text()
    examples.saved(study / "data", text[:-300], "cut.csv")
    examples.saved(study / "data", "no gzip", "broken.csv.gz")
    done = run_here(study, "study", "analyze", "data", "--out", "out", "--tables-only")
    assert done.returncode == 3
    assert "broken.csv.gz: is not gzip-compressed: the file is left out" in done.stdout
    assert "cut.csv: row 25: the row has" in done.stdout
    assert (study / "out" / "tables" / "overall.csv").is_file()


def test_a_study_without_any_pair_ends_with_its_findings(study: Path) -> None:
    alone = [row for row in log_of(frames=12).rows() if row.skeleton_id == 0]
    (study / "data" / "first.csv").unlink()
    write_study_log(study / "data" / "alone.csv", alone)
    done = run_here(study, "study", "analyze", "data", "--out", "out")
    assert done.returncode == 1
    assert "no two views of a person at one time" in done.stderr
    assert "no row of participant 7, walk, 90 has a partner" in (study / "out" / "tables" / "findings.csv").read_text()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["data", "--out", "data"], "it exists, and nothing is overwritten"),
        (["data", "--out", "no/out"], "there is no folder no"),
        (["nowhere", "--out", "out"], "there is no such folder"),
        (["data", "--out", "out", "--participants", "5"], "no pair of views of participant '5'"),
    ],
)
def test_what_is_refused(study: Path, words: list[str], problem: str) -> None:
    done = run_here(study, "study", "analyze", *words)
    assert done.returncode == 1
    assert problem in done.stderr
    assert not (study / "out").exists()


def test_only_chosen_participants(study: Path) -> None:
    second = msgspec.structs.replace(log_of(frames=12), study_id=np.full(24, 8))
    write_study_log(study / "data" / "second.csv", second.rows())
    words = ("--participants", "8", "--tables-only", "--json", "-")
    found = result_here(study, "study", "analyze", "data", "--out", "out", *words)
    assert found["participants"] == ["8"]
