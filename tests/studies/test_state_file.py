"""A session survives a restart, and an edited protocol is named while the session goes on with its own plan."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from support.study_protocols import protocols

from mocapella.errors import InputError, RecordingError
from mocapella.studies.progress import WAIT, StudyAction, advance, begin
from mocapella.studies.protocol import Participants, StudyProtocol, load_protocol, plan
from mocapella.studies.state_file import SavedSession, load_session, new_session, reopen_session, save_session

S = 1_000_000_000


def running() -> SavedSession:
    founding = load_protocol("kinectmultitrack")
    session = new_session(founding, begin("P07", plan(founding, "P07"), 0))
    for at_ns, do in ((S, "next"), (2 * S, "next")):
        session = session.after(advance(session.state, StudyAction(do), at_ns))  # type: ignore[arg-type]
    return session


@settings(max_examples=15)
@given(protocols())
def test_a_session_is_read_back_as_it_was_saved(
    tmp_path_factory: pytest.TempPathFactory, protocol: StudyProtocol
) -> None:
    planned = plan(protocol, protocol.codes[0])
    if planned:
        session = new_session(protocol, begin(protocol.codes[0], planned, 5))
        path = tmp_path_factory.mktemp("session") / "session.json"
        save_session(path, session)
        assert load_session(path) == session
        assert reopen_session(path, protocol).edited == ""


def test_a_restart_pauses_a_running_task(tmp_path: Path) -> None:
    save_session(tmp_path / "s.json", running())
    again = reopen_session(tmp_path / "s.json", load_protocol("kinectmultitrack"))
    assert (again.session.state.phase, again.session.events[-1].what, again.edited) == ("paused", "interrupted", "")
    assert advance(again.session.state, WAIT, 99 * S)[0].phase == "paused"


def test_an_edited_protocol_is_named_and_the_stored_plan_goes_on(tmp_path: Path) -> None:
    session, founding = running(), load_protocol("kinectmultitrack")
    save_session(tmp_path / "s.json", session)
    edited = msgspec.structs.replace(founding, tasks=founding.tasks[:2], consent="new")
    again = reopen_session(tmp_path / "s.json", edited)
    assert "edited after the session began (tasks, consent)" in again.edited
    assert again.session.state.plan == session.state.plan
    assert again.session.protocol.tasks == founding.tasks
    assert again.session.protocol.codes == ("P07",)
    assert again.session.checksum == founding.checksum


def test_codes_in_another_order_are_an_edit_if_they_change_the_plan(tmp_path: Path) -> None:
    session, founding = running(), load_protocol("kinectmultitrack")
    save_session(tmp_path / "s.json", session)
    group = founding.participants.groups[0]
    swapped = msgspec.structs.replace(group, codes=("P07", *(code for code in group.codes if code != "P07")))
    other = msgspec.structs.replace(
        founding, participants=Participants(groups=(swapped, founding.participants.groups[1]))
    )
    assert "(participants)" in reopen_session(tmp_path / "s.json", other).edited


@pytest.mark.parametrize(
    ("old", "new"), [('"index":0', '"index":99'), ('"index":0', '"index":-1'), ('"step":0', '"step":-1')]
)
def test_a_state_that_does_not_fit_its_plan_is_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "s.json"
    save_session(path, running())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(RecordingError, match="does not belong to its plan; restore it"):
        load_session(path)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"protokol": 1}'])
def test_what_is_no_session_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(InputError, match=r"s\.json"):
        load_session(tmp_path / "s.json")
