"""A session in the study's folder: consent, going on, and what is never overwritten."""

from __future__ import annotations

from datetime import UTC, date, datetime
from pathlib import Path

import msgspec
import pytest
from support.programs import free_port

from mocapella.errors import InputError, NotNowError, RecordingError, SettingsError
from mocapella.live.server import Server, ServerSettings
from mocapella.live.study_store import FolderStore
from mocapella.model.session import Setup
from mocapella.studies.progress import NOTHING_TRACKED, StudyAction, StudyEvent, StudyState, advance, begin
from mocapella.studies.protocol import plan
from mocapella.studies.study_folder import give_consent, new_study, read_manifest, verify_study
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)
TOML = b"""
title = "Standing"
participants = { codes = ["P01", "P02"] }
consent = "Two sensors record your joints."
[[placements]]
name = "right-45"
number = 1
[[tasks]]
name = "stand"
scenario = 1
steps = [{ text = "Stand." }]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    study = new_study(tmp_path / "study", TOML, by="op-1", at=NOW)
    give_consent(study, "P01", date(2026, 11, 30), by="op-1", at=NOW)
    return study.path


def store(folder: Path) -> FolderStore:
    return FolderStore(folder, "op-1")


def begun(one: FolderStore, code: str = "P01") -> tuple[StudyState, tuple[StudyEvent, ...]]:
    return begin(code, plan(one.protocol, code), 1)


def test_what_is_kept_goes_on_where_it_was(folder: Path) -> None:
    first = store(folder)
    assert first.load() is None
    first.begin("P01")
    state, events = begun(first)
    first.save(state, events)
    for action in ("next", "next"):
        state, events = advance(state, StudyAction(action), state.at_ns + 5)  # type: ignore[arg-type]
        first.save(state, events)
    second = store(folder)
    assert second.load() == state
    assert second.notes == ()
    again, events = advance(state, StudyAction("abort"), 100)
    second.save(again, events)
    assert store(folder).load() is None
    with pytest.raises(NotNowError, match="has taken part, and a session is never overwritten; move"):
        store(folder).begin("P01")


def test_an_edited_protocol_is_said_and_the_stored_plan_goes_on(folder: Path) -> None:
    first = store(folder)
    state, events = begun(first)
    first.save(state, events)
    protocol = folder / "protocol.toml"
    protocol.write_bytes(TOML.replace(b"Stand.", b"Sit."))
    second = store(folder)
    assert second.load() == state
    assert [note for note in second.notes if "edited after the session began (tasks)" in note]
    assert state.plan[0].task.steps[0].text == "Stand."


def test_without_consent_to_the_present_text_nobody_begins(folder: Path) -> None:
    with pytest.raises(NotNowError, match=r"P02 has not consented; after the consent: mocapella study consent .* P02"):
        store(folder).begin("P02")
    (folder / "protocol.toml").write_bytes(TOML.replace(b"joints", b"pictures"))
    with pytest.raises(NotNowError, match="another text"):
        store(folder).begin("P01")
    with pytest.raises(SettingsError, match="P01, P02"):
        store(folder).begin("P03")


def test_takes_of_a_placement_have_names_of_their_own_and_come_into_the_manifest(folder: Path) -> None:
    one = store(folder)
    state, events = begun(one)
    first = one.take(state)
    assert first == folder / "participants" / "P01" / "right-45.mcap"
    assert one.take(state, again=True).name == "right-45-again-1.mcap"
    first.write_bytes(b"take")
    (first.parent / "right-45-again-1.mcap").write_bytes(b"take")
    assert one.take(state, again=True).name == "right-45-again-2.mcap"
    one.save(state, events)
    with pytest.raises(RecordingError, match=r"no logs of tasks were written \(.*; try again: mocapella study logs"):
        one.keep(first)  # it is no take, but nobody loses it
    names = [Path(row.path).name for row in read_manifest(folder).files]
    assert sorted(names) == [
        "participant.json", "protocol.toml", "right-45.mcap", "session.json",
    ]  # fmt: skip
    assert verify_study(folder).unknown == ("participants/P01/right-45-again-1.mcap",)


def test_a_session_is_in_progress_until_it_ends_and_then_in_the_manifest(folder: Path) -> None:
    one = store(folder)
    state, events = begun(one)
    for action in ("next", "mark", "abort"):
        one.save(state, events)
        check = verify_study(folder)
        assert (check.whole, check.ongoing) == (True, ("participants/P01/session.json",))
        state, events = advance(state, StudyAction(action), state.at_ns + 5)  # type: ignore[arg-type]
    one.save(state, events)
    check = verify_study(folder)
    assert (check.whole, check.ongoing) == (True, ())
    (folder / "participants/P01/session.json").write_text("{}")
    assert verify_study(folder).changed == ("participants/P01/session.json",)


def test_the_researcher_is_told_of_a_task_without_anybody_until_it_is_repeated(folder: Path) -> None:
    one = store(folder)
    state, events = begun(one)
    one.save(state, events)
    for action in ("next", "next", "next"):
        state, events = advance(state, StudyAction(action), state.at_ns + 5)  # type: ignore[arg-type]
        events = tuple(
            msgspec.structs.replace(event, note=NOTHING_TRACKED) if event.what == "finished" else event
            for event in events
        )
        one.save(state, events)
    (note,) = one.notes
    assert note.startswith("nobody was tracked in stand (right-45, repetition 1)")
    other = store(folder)
    other.load()
    assert other.notes == one.notes
    one.save(*advance(state, StudyAction("repeat"), state.at_ns + 5))
    assert one.notes == ()


def test_a_take_that_ctrl_c_ends_is_in_the_manifest_when_the_server_has_ended(folder: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    server = Server(ServerSettings(address, takes=folder, setup=Setup("stand-still"), study=store(folder)))
    reader = open_reader(address)
    try:
        for verb, arguments in (("begin", {"participant": "P01"}), ("next", {})):
            assert send_command(reader, f"study-{verb}", arguments, 20.0).ok
    finally:
        reader.close()  # type: ignore[no-untyped-call]
        health = server.close()
    assert health.path.endswith("right-45.mcap")
    check = verify_study(folder)
    assert (check.unknown, check.changed, check.whole) == ((), (), True)
    assert "participants/P01/right-45.mcap" in [row.path for row in read_manifest(folder).files]


def test_a_study_takes_no_names_of_people(folder: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    server = Server(ServerSettings(address, takes=folder, setup=Setup("stand-still"), study=store(folder)))
    reader = open_reader(address)
    try:
        reply = send_command(reader, "name", {"person": 0, "name": "Ada"}, 20.0)
        assert not reply.ok
        assert "people of a study have codes" in reply.message
        assert send_command(reader, "study-begin", {"participant": "P01"}, 20.0).ok
    finally:
        reader.close()  # type: ignore[no-untyped-call]
        server.close()


def test_a_damaged_session_and_a_wrong_operator_are_refused(folder: Path) -> None:
    one = store(folder)
    one.save(*begun(one))
    (folder / "participants" / "P01" / "session.json").write_bytes(b"{")
    with pytest.raises(InputError, match=r"session\.json"):
        store(folder).load()
    with pytest.raises(SettingsError, match="e-mail"):
        FolderStore(folder, "ada@example.org")
    with pytest.raises(InputError, match="mocapella study new"):
        store(folder.parent)
    assert msgspec.json.decode((folder / "manifest.json").read_bytes())
