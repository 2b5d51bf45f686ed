"""The folder of a study: nothing is overwritten, every change is named, and consent has its end."""

from __future__ import annotations

import json
import os
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella import __version__
from mocapella.errors import InputError, RecordingError, SettingsError, TakeExistsError
from mocapella.studies.protocol import protocol_bytes
from mocapella.studies.study_folder import (
    StudyFolder,
    add_files,
    due_participants,
    give_consent,
    new_study,
    open_study,
    participants_without_consent,
    read_consent,
    read_manifest,
    verify_study,
)

NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
FOUNDING = protocol_bytes("kinectmultitrack")


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    return new_study(tmp_path / "study", FOUNDING, by="Op1", at=NOW)


def take_of(study: StudyFolder, code: str = "P07", name: str = "walk.mcap", data: bytes = b"take") -> Path:
    file = study.make_participant(code) / name
    file.write_bytes(data)
    return file


def test_a_new_study_has_its_protocol_and_is_whole(study: StudyFolder) -> None:
    assert (study.path / "protocol.toml").read_bytes() == FOUNDING
    assert verify_study(study.path).whole
    assert open_study(study.path) == study
    assert study.path.stat().st_mode & 0o777 == 0o700


def test_the_manifest_says_who_when_and_with_what(study: StudyFolder) -> None:
    add_files(study, [take_of(study)], by="Op2", at=NOW, settings={"method": "default"})
    row = read_manifest(study.path).files[0]
    assert (row.path, row.by, row.at, row.version, row.settings) == (
        "participants/P07/walk.mcap",
        "Op2",
        "2026-11-30T09:00:00Z",
        __version__,
        {"method": "default"},
    )


def test_a_study_is_never_overwritten(study: StudyFolder) -> None:
    with pytest.raises(TakeExistsError, match="has files, and a study is never overwritten"):
        new_study(study.path, FOUNDING, by="Op1", at=NOW)


def test_a_take_that_was_overwritten_is_refused(study: StudyFolder) -> None:
    file = take_of(study)
    add_files(study, [file], by="Op1", at=NOW)
    assert add_files(study, [file], by="Op2", at=NOW)[0].by == "Op1"
    file.write_bytes(b"other")
    with pytest.raises(TakeExistsError, match="is not the file that is in the manifest"):
        add_files(study, [file], by="Op1", at=NOW)


def test_each_kind_of_fault_is_named(study: StudyFolder) -> None:
    files = [take_of(study, name=name) for name in ("a.mcap", "b.mcap", "c.mcap")]
    add_files(study, files, by="Op1", at=NOW)
    files[0].unlink()
    files[1].write_bytes(b"tale")
    files[2].unlink()
    files[2].symlink_to("/etc/hostname")
    take_of(study, "P08", "new.mcap")
    check = verify_study(study.path)
    assert check.missing == ("participants/P07/a.mcap",)
    assert check.changed == ("participants/P07/b.mcap", "participants/P07/c.mcap")
    assert check.unknown == ("participants/P08/new.mcap",)
    assert not check.whole


def test_a_link_to_equal_bytes_and_what_is_no_file_are_changes(study: StudyFolder, tmp_path: Path) -> None:
    files = [take_of(study, name=name) for name in ("a.mcap", "b.mcap")]
    add_files(study, files, by="Op1", at=NOW)
    (tmp_path / "equal").write_bytes(b"take")
    for file in files:
        file.unlink()
    files[0].symlink_to(tmp_path / "equal")
    os.mkfifo(files[1])
    assert verify_study(study.path).changed == ("participants/P07/a.mcap", "participants/P07/b.mcap")


@given(data=st.binary(min_size=1, max_size=50), place=st.integers(0, 49), bit=st.integers(0, 7))
def test_any_changed_bit_is_found(tmp_path_factory: pytest.TempPathFactory, data: bytes, place: int, bit: int) -> None:
    study = new_study(tmp_path_factory.mktemp("study"), FOUNDING, by="Op1", at=NOW)
    file = take_of(study, data=data)
    add_files(study, [file], by="Op1", at=NOW)
    changed = bytearray(data)
    changed[place % len(data)] ^= 1 << bit
    file.write_bytes(changed)
    assert verify_study(study.path).changed == ("participants/P07/walk.mcap",)


def test_consent_has_its_text_and_its_end(study: StudyFolder) -> None:
    record = give_consent(study, "P07", date(2026, 1, 31), by="Op1", at=NOW)
    assert record.consent_sha256 == study.protocol.consent_checksum
    assert record.retain_until == "2036-01-29"
    assert verify_study(study.path).whole
    assert due_participants(study, date(2036, 1, 29)) == ()
    assert due_participants(study, date(2036, 1, 30)) == (record,)
    assert give_consent(study, "P07", date(2026, 1, 31), by="Op1", at=NOW) == record
    with pytest.raises(RecordingError, match="has another consent, of 2026-01-31; it is never overwritten"):
        give_consent(study, "P07", date(2026, 2, 1), by="Op1", at=NOW)


def test_who_has_files_and_no_consent_is_named(study: StudyFolder) -> None:
    take_of(study, "P08")
    give_consent(study, "P07", date(2026, 1, 31), by="Op1", at=NOW)
    assert participants_without_consent(study) == ("P08",)


def test_no_text_of_consent_and_no_such_day_are_refused(tmp_path: Path) -> None:
    plain = FOUNDING.replace(b"consent = ", b"title2 = ").split(b"title2")[0]
    text = plain + FOUNDING[FOUNDING.index(b"[[participants.groups]]") :]
    study = new_study(tmp_path / "a", text, by="Op1", at=NOW)
    with pytest.raises(SettingsError, match="has no text of consent; add `consent`"):
        give_consent(study, "P07", date(2026, 1, 31), by="Op1", at=NOW)
    study = new_study(tmp_path / "b", FOUNDING, by="Op1", at=NOW)
    with pytest.raises(SettingsError, match="cannot be a date of consent"):
        give_consent(study, "P07", date(9999, 1, 1), by="Op1", at=NOW)


@pytest.mark.parametrize("code", ["anna", "anna1@mail.org", "../P07", "P99"])
def test_a_name_or_an_unknown_code_gets_no_folder(study: StudyFolder, code: str) -> None:
    with pytest.raises(SettingsError):
        study.make_participant(code)
    assert list((study.path / "participants").iterdir()) == []


def test_an_operator_has_a_code_too(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="'anna': it has no digit"):
        new_study(tmp_path / "study", FOUNDING, by="anna", at=NOW)
    assert not (tmp_path / "study").exists()


def test_a_folder_without_a_protocol_is_no_study(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is no study: it has no protocol.toml; make one with"):
        open_study(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", '{"files": [{"pth": 1}]}', '{"files": [{"path": 1}]}'])
def test_a_damaged_manifest_is_refused(study: StudyFolder, text: str) -> None:
    (study.path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=r"manifest\.json"):
        verify_study(study.path)


def test_a_consent_without_a_date_is_refused(study: StudyFolder) -> None:
    give_consent(study, "P07", date(2026, 1, 31), by="Op1", at=NOW)
    file = study.path / "participants" / "P07" / "participant.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"retain_until": "soon"}))
    with pytest.raises(InputError, match=r"field retain_until: 'soon': is no date"):
        read_consent(file)
