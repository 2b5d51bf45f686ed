"""A purge removes one participant everywhere, proves it, and goes on after any interruption."""

from __future__ import annotations

import gzip
import shutil
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import pytest

import mocapella.studies.purge as purging
from mocapella.errors import NotNowError, RecordingError, SettingsError
from mocapella.studies.byte_search import search
from mocapella.studies.progress import begin
from mocapella.studies.protocol import load_protocol, plan, protocol_bytes
from mocapella.studies.purge import purge, purging_code
from mocapella.studies.state_file import new_session, save_session
from mocapella.studies.study_folder import (
    StudyFolder,
    add_files,
    checksum_of,
    give_consent,
    new_study,
    open_study,
    read_purged,
    verify_study,
    was_purged,
)

NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
SALT = "0123456789abcdef0123456789abcdef"


def make(path: Path, protocol: bytes = protocol_bytes("kinectmultitrack")) -> StudyFolder:
    """Make a study of two participants, each with all kinds of files, and results of both."""
    study = new_study(path, protocol, by="Op1", at=NOW)
    for code in ("P07", "P08"):
        give_consent(study, code, date(2026, 1, 31), by="Op1", at=NOW)
        folder = study.participant(code)
        save_session(folder / "session.json", new_session(study.protocol, begin(code, plan(study.protocol, code), 0)))
        (folder / "walk.mcap").write_bytes(b"take of " + code.encode())
        (folder / "logs").mkdir()
        (folder / "logs" / "walk-1.csv.gz").write_bytes(gzip.compress(b"log of " + code.encode()))
    (path / "results").mkdir()
    (path / "results" / "table.csv").write_text("participant,dd\nP07,1\nP08,2\n")
    files = [file for file in path.rglob("*") if file.is_file() and file.name != "manifest.json"]
    add_files(study, files, by="Op1", at=NOW)
    assert verify_study(path).whole
    return study


def remove(path: Path) -> purging.PurgeReport:
    return purge(path, "P07", by="Op1", at=NOW, salt=SALT)


def contents(path: Path) -> dict[str, bytes]:
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_a_participant_is_gone_and_the_others_are_as_they_were(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    before = contents(study.path)
    report = remove(study.path)
    after = contents(study.path)
    assert report.proven
    assert report.files == 4
    assert report.results == 1
    assert not [name for name, data in after.items() if b"P07" in name.encode() + data]
    assert {name: data for name, data in before.items() if "P08" in name}.items() <= after.items()
    assert verify_study(study.path).whole
    assert search(study.path, "P08").traces


def test_the_others_keep_their_plans(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    remove(study.path)
    after = open_study(study.path)
    for place, code in enumerate(study.protocol.codes):
        assert plan(after.protocol, after.protocol.codes[place]) == plan(study.protocol, code)
        assert (code in after.protocol.codes) == (code != "P07")


def test_what_was_removed_is_noted_without_the_code(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    remove(study.path)
    (row,) = read_purged(study.path)
    assert (row.files, row.at, row.salt) == (4, "2026-11-30T09:00:00Z", SALT)
    assert was_purged(study.path, "P07")
    assert not was_purged(study.path, "P08")


def test_a_code_of_a_count_cannot_be_used_again(tmp_path: Path) -> None:
    text = b"\n".join(
        line for line in protocol_bytes("kinectmultitrack").splitlines() if not line.startswith(b"groups")
    )
    first, last = text.index(b"[[participants.groups]]"), text.index(b"# x to the right")
    study = make(tmp_path / "s", text[:first] + b"participants = { count = 9 }\n" + text[last:])
    assert remove(study.path).proven
    with pytest.raises(SettingsError, match="was purged; a new participant needs another code"):
        open_study(study.path).make_participant("P07")
    with pytest.raises(SettingsError, match="nothing of participant 'P07'"):
        remove(study.path)


STEPS = ("write_whole", "write_manifest", "_remove", "search", "_rename_in_protocol", "_note")


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("number", range(10))
def test_an_interrupted_purge_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, after: bool
) -> None:
    make(tmp_path / "whole")
    shutil.copytree(tmp_path / "whole", tmp_path / "s")
    remove(tmp_path / "whole")
    calls = 0
    for name in STEPS:
        step = getattr(purging, name)

        def interrupt(*args: Any, step: Any = step, **options: Any) -> Any:
            nonlocal calls
            own, calls = calls, calls + 1
            if own == number and not after:
                raise KeyboardInterrupt
            found = step(*args, **options)
            if own == number and after:
                raise KeyboardInterrupt
            return found

        monkeypatch.setattr(purging, name, interrupt)
    with pytest.raises(KeyboardInterrupt):
        remove(tmp_path / "s")
    monkeypatch.undo()
    if (tmp_path / "s" / "participants" / "P07").exists() or purging_code(tmp_path / "s"):
        assert remove(tmp_path / "s").proven
    assert contents(tmp_path / "s") == contents(tmp_path / "whole")


def test_while_a_purge_is_interrupted_no_other_begins_and_verify_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = make(tmp_path / "s")

    def fail(path: Path) -> None:
        raise RecordingError("disk")

    monkeypatch.setattr(purging.shutil, "rmtree", fail)
    with pytest.raises(RecordingError):
        remove(study.path)
    monkeypatch.undo()
    assert purging_code(study.path) == "P07"
    assert verify_study(study.path).purging
    with pytest.raises(NotNowError, match="purge of 'P07' was interrupted; finish it first"):
        purge(study.path, "P08", by="Op1", at=NOW, salt=SALT)


def test_what_is_left_is_found_and_named(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    (study.path / "notes.txt.gz").write_bytes(gzip.compress(b"P07 was late"))
    (study.path / "copy-of-P07").touch()
    report = remove(study.path)
    assert not report.proven
    assert {(trace.file, trace.what) for trace in report.search.traces} == {
        ("notes.txt.gz", "code"),
        ("copy-of-P07", "code"),
    }


def test_a_picture_that_was_kept_outside_of_the_results_is_no_proof(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    (study.path / "figures").mkdir()
    (study.path / "figures" / "bars.pdf").write_bytes(b"%PDF-1.4 drawn")
    (study.path / "results" / "bars.pdf").write_bytes(b"%PDF-1.4 drawn")
    report = remove(study.path)
    assert not report.proven
    assert [one.split(" is ")[0] for one in report.search.unsearched] == ["figures/bars.pdf"]


def test_the_new_code_in_the_protocol_has_a_number_of_its_own(tmp_path: Path) -> None:
    taken = int(SALT[:12], 16) % 900_000_000 + 100_000_000
    study = make(tmp_path / "s", protocol_bytes("kinectmultitrack").replace(b'"P22"', f'"Y{taken}"'.encode()))
    remove(study.path)
    assert {f"X{taken + 1}", f"Y{taken}"} <= {*open_study(study.path).protocol.codes}


@pytest.mark.parametrize("where", ["manifest and disk", "manifest", "disk"])
def test_a_checksum_of_a_removed_take_is_found(tmp_path: Path, where: str) -> None:
    study = make(tmp_path / "s")
    take = study.path / "participants" / "P07" / ("new.mcap" if where == "disk" else "walk.mcap")
    if where == "disk":
        take.write_bytes(b"not in the manifest yet")
    checksum = checksum_of(take)
    if where == "manifest":
        take.unlink()
    (study.path / "list.txt").write_text(f"{checksum}  walk.mcap\n")
    assert [trace.what for trace in remove(study.path).search.traces] == ["checksum"]


def test_a_link_is_removed_and_what_it_leads_to_stays(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "take").write_bytes(b"far")
    (study.path / "participants" / "P07" / "far").symlink_to(tmp_path / "far")
    assert remove(study.path).proven
    assert (tmp_path / "far" / "take").exists()


def test_a_file_that_a_crash_left_half_written_is_removed(tmp_path: Path) -> None:
    study = make(tmp_path / "s")
    (study.path / ".manifest.abc123").write_text('{"path": "participants/P07/walk.mcap"')
    assert remove(study.path).proven


@pytest.mark.parametrize("code", ["P99", "anna"])
def test_a_code_that_is_not_there_is_refused(tmp_path: Path, code: str) -> None:
    study = make(tmp_path / "s")
    before = contents(study.path)
    with pytest.raises(SettingsError):
        purge(study.path, code, by="Op1", at=NOW, salt=SALT)
    assert contents(study.path) == before


def test_the_protocol_that_ships_is_not_changed() -> None:
    assert "P07" in load_protocol("kinectmultitrack").codes
