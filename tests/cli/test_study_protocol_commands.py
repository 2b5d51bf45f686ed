"""``mocapella study``: a study from its protocol to the purge of a participant."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support import take_making
from support.programs import result_here, run_here

from mocapella.studies.progress import StudyAction, advance, begin
from mocapella.studies.protocol import plan, protocol_bytes
from mocapella.studies.state_file import load_session, new_session, save_session
from mocapella.studies.study_folder import open_study, read_manifest

START = 1_700_000_000 * take_making.SECOND
BY = ("--by", "OP1")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    result_here(tmp_path, "study", "new", "s", *BY)
    return tmp_path


def begin_session(folder: Path, code: str = "P07") -> None:
    """Have a participant finish the first task, and keep its take."""
    study = open_study(folder / "s")
    own = study.make_participant(code)
    take_making.small_take(own / "first.mcap", 60)
    session = new_session(study.protocol, begin(code, plan(study.protocol, code), START))
    for step, do in enumerate(("next", "next", "next")):
        action = StudyAction(do, forced=True)  # type: ignore[arg-type]
        session = session.after(advance(session.state, action, START + 10 * step * take_making.STEP))
    save_session(own / "session.json", session)


def test_a_new_study_is_made_once(folder: Path) -> None:
    assert (folder / "s" / "protocol.toml").read_bytes() == protocol_bytes("kinectmultitrack")
    again = run_here(folder, "study", "new", "s", *BY)
    assert (again.returncode, "never overwritten" in again.stderr) == (1, True)


def test_the_operators_code_may_be_a_variable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOCAPELLA_OPERATOR", "OP7")
    result_here(tmp_path, "study", "new", "s")
    assert json.loads((tmp_path / "s" / "manifest.json").read_text())["files"][0]["by"] == "OP7"


def test_check_prints_the_plan_with_its_least_times(tmp_path: Path) -> None:
    done = run_here(tmp_path, "study", "check", "kinectmultitrack", "--json", "plan.json")
    assert "stationary" in done.stderr
    rows = json.loads((tmp_path / "plan.json").read_text())["plan"]
    assert [(row["task"], row["from_s"], row["at_least_s"]) for row in rows[:3]] == [
        ("stationary", 0, 5),
        ("steps", 5, 21),
        ("walk", 26, 20),
    ]


def test_check_names_file_field_value_and_remedy(tmp_path: Path) -> None:
    text = protocol_bytes("kinectmultitrack").decode().replace("minimum_s = 5", "minimum_s = -5", 1)
    (tmp_path / "mine.toml").write_text(text)
    done = run_here(tmp_path, "study", "check", "mine.toml")
    assert done.returncode == 1
    assert "mine.toml: field tasks[0].minimum_s: -5: is no study protocol" in done.stderr
    assert "docs/studies-protocol.md" in done.stderr
    missing = run_here(tmp_path, "study", "check", "kinectmultitrak")
    assert "did you mean kinectmultitrack?" in missing.stderr


def test_tasks_are_those_of_the_session_once_it_has_begun(folder: Path) -> None:
    planned = result_here(folder, "study", "tasks", "s", "P07")["plan"]
    assert planned == result_here(folder, "study", "tasks", "s/protocol.toml", "P07")["plan"]
    begin_session(folder)
    file = folder / "s" / "protocol.toml"
    file.write_text(file.read_text().replace('task_order = "fixed"', 'task_order = "random"'))
    done = run_here(folder, "study", "tasks", "s", "P07", "--json", "-")
    assert json.loads(done.stdout)["plan"] == planned
    assert "the protocol was edited after the session began (task_order)" in done.stderr


def act(folder: Path, action: StudyAction) -> None:
    """Go on with the participant's session."""
    file = folder / "s/participants/P07/session.json"
    session = load_session(file)
    save_session(file, session.after(advance(session.state, action, START * 2)))


def test_verify_names_what_is_not_as_in_the_manifest_and_adds_it(folder: Path) -> None:
    begin_session(folder)
    done = run_here(folder, "study", "verify", "s")
    assert done.returncode == 1
    assert "not in the manifest: participants/P07/first.mcap" in done.stderr
    assert result_here(folder, "study", "verify", "s", "--add", "OP2")["whole"]
    act(folder, StudyAction("mark", "a"))
    done = run_here(folder, "study", "verify", "s")
    assert (done.returncode, "in progress: participants/P07/session.json" in done.stderr) == (0, True)
    act(folder, StudyAction("abort"))
    assert run_here(folder, "study", "verify", "s").returncode == 1
    assert result_here(folder, "study", "verify", "s", "--add", "OP2")["whole"]
    (folder / "s/participants/P07/first.mcap").write_bytes(b"other")
    done = run_here(folder, "study", "verify", "s", "--add", "OP2")
    assert (done.returncode, "changed: participants/P07/first.mcap" in done.stderr) == (1, True)


def test_consent_and_its_end(folder: Path) -> None:
    record = result_here(folder, "study", "consent", "s", "P07", "--given", "2016-01-01", *BY)
    assert record["retain_until"] == "2025-12-29"
    begin_session(folder, "P08")
    found = result_here(folder, "study", "due", "s", "--on", "2025-12-30")
    assert [row["participant"] for row in found["due"]] == ["P07"]
    assert found["without_consent"] == ["P08"]
    assert result_here(folder, "study", "due", "s", "--on", "2025-12-29")["due"] == []


def test_logs_are_written_once(folder: Path) -> None:
    pytest.importorskip("polars")
    begin_session(folder)
    (log,) = result_here(folder, "study", "logs", "s", *BY)["P07"]
    assert [Path(file).name for file in log["files"]] == [
        "001-right-45-stationary-1.csv.gz",
        "001-right-45-stationary-1.people.parquet",
        "001-right-45-stationary-1.events.parquet",
    ]
    assert result_here(folder, "study", "verify", "s")["whole"]
    assert result_here(folder, "study", "logs", "s", *BY)["P07"] == []


def test_a_task_without_anybody_is_named_and_the_manifest_says_so(folder: Path) -> None:
    pytest.importorskip("polars")
    begin_session(folder)
    (folder / "s/participants/P07/first.mcap").unlink()
    done = run_here(folder, "study", "logs", "s", *BY)
    assert "P07: nobody was tracked in stationary (right-45, repetition 1); it has no log" in done.stderr
    (row,) = (row for row in read_manifest(folder / "s").files if "/logs/" in row.path)
    assert row.path.endswith("001-right-45-stationary-1.events.parquet")
    assert row.settings["problem"] == "no person was tracked"
    assert result_here(folder, "study", "verify", "s")["whole"]
    assert result_here(folder, "study", "logs", "s", *BY)["P07"] == []


def test_a_purge_wants_the_code_or_yes_and_proves_itself(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begin_session(folder)
    monkeypatch.setattr("typer.prompt", lambda *_, **__: "P08")
    refused = run_here(folder, "study", "purge", "s", "P07", *BY)
    assert (refused.returncode, "nothing was removed; type 'P07'" in refused.stderr) == (1, True)
    assert (folder / "s/participants/P07").exists()
    monkeypatch.setattr("typer.prompt", lambda *_, **__: "P07")
    assert result_here(folder, "study", "purge", "s", "P07", *BY)["proven"]
    assert not (folder / "s/participants/P07").exists()
    assert result_here(folder, "study", "verify", "s")["whole"]
    done = run_here(folder, "study", "purge", "s", "P07", "--yes", *BY)
    assert (done.returncode, "nothing of participant 'P07'" in done.stderr) == (1, True)


def test_a_purge_says_what_is_left_and_what_it_cannot_reach(folder: Path) -> None:
    begin_session(folder)
    (folder / "s" / "notes.txt").write_text("P07 came late\n")
    done = run_here(folder, "study", "purge", "s", "P07", "--yes", *BY)
    assert done.returncode == 1
    assert "left: code in notes.txt, byte 0" in done.stderr
    assert "out of reach: copies of the folder elsewhere" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("new", "t", "--by", "anna"), "'anna': it has no digit"),
        (("new", "t", "--protocol", "none.toml", *BY), "none.toml: cannot be read"),
        (("tasks", "s", "P77"), "no participant 'P77'; it has P00"),
        (("tasks", "s", "P7"), "'P7': it is no code; a code has"),
        (("consent", "s", "anna@mail.org", *BY), "an e-mail address is no code"),
        (("consent", "s", "P07", "--given", "tomorrow", *BY), "'tomorrow' is no date; write it as YEAR-MONTH-DAY"),
        (("due", "s", "--on", "1.2.3"), "'1.2.3' is no date"),
        (("verify", "."), "is no study: it has no protocol.toml"),
        (("purge", "s", "P99", "--yes", *BY), "nothing of participant 'P99'"),
        (("logs", ".", *BY), "is no study"),
    ],
)
def test_bad_input_is_one_line(folder: Path, arguments: tuple[str, ...], says: str) -> None:
    done = run_here(folder, "study", *arguments)
    assert done.returncode == 1
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("command", ["new", "check", "tasks", "verify", "consent", "due", "purge", "logs"])
def test_each_help_has_an_example(tmp_path: Path, command: str) -> None:
    assert f"mocapella study {command}" in run_here(tmp_path, "study", command, "--help").stdout
