"""The state of a study session on the disk, so that it survives a restart of the server or an edit of the protocol."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from mocapella.errors import RecordingError
from mocapella.model.whole_file import write_whole
from mocapella.studies.file_values import read_json
from mocapella.studies.progress import Advanced, StudyEvent, StudyState, interrupted
from mocapella.studies.protocol import ParticipantGroup, Participants, StudyProtocol, plan

_FIX: Final = "restore it from a copy, or move it away to begin the participant's session again"


class SavedSession(msgspec.Struct, frozen=True):
    """A stored session.

    Attributes:
        protocol: the protocol at the session's beginning, without the other participants' codes.
        checksum: `StudyProtocol.checksum` of the whole protocol.
        state: the state after the last event.
        events: all events so far, in their order.
    """

    protocol: StudyProtocol
    checksum: str
    state: StudyState
    events: tuple[StudyEvent, ...]

    def after(self, advanced: Advanced) -> SavedSession:
        """Return the session after a result of `mocapella.studies.progress.advance`."""
        return msgspec.structs.replace(self, state=advanced[0], events=self.events + advanced[1])


class ReopenedSession(msgspec.Struct, frozen=True):
    """A session that goes on.

    Attributes:
        session: the session; a task that was running is paused.
        edited: differences from the study's present protocol, in one line; empty if none. The session goes on with its
            own plan.
    """

    session: SavedSession
    edited: str = ""


def new_session(protocol: StudyProtocol, begun: Advanced) -> SavedSession:
    """Return the session of a participant who begins, of the result of `mocapella.studies.progress.begin`."""
    code = begun[0].participant
    own = tuple(ParticipantGroup(one.name, (code,)) for one in protocol.participants.groups if code in one.codes)
    participants = Participants(groups=own) if own else Participants(codes=(code,))
    return SavedSession(msgspec.structs.replace(protocol, participants=participants), protocol.checksum, *begun)


def save_session(path: Path, session: SavedSession) -> None:
    """Write a session atomically: after a crash, the file has the old state or the new one.

    Raises:
        InputError: the file cannot be written.
    """
    write_whole(path, msgspec.json.encode(session))


def load_session(path: Path) -> SavedSession:
    """Read a session.

    Raises:
        InputError: the file cannot be read, is no session, or its state is not one of its plan.
    """
    session = read_json(path, SavedSession, what="study session", fix=_FIX)
    state = session.state
    steps = len(state.plan[state.index].task.steps) if 0 <= state.index < len(state.plan) else 0
    if not 0 <= state.step < steps:
        raise RecordingError(f"{path}: the session's state does not belong to its plan; {_FIX}")
    return session


def reopen_session(path: Path, protocol: StudyProtocol) -> ReopenedSession:
    """Read a session to go on with it, and compare its protocol with the study's present one.

    Args:
        path: the file.
        protocol: the study's present protocol.

    Raises:
        InputError, RecordingError: as in `load_session`.
    """
    saved = load_session(path)
    session = saved.after(interrupted(saved.state))
    return ReopenedSession(session, edits_of(saved, protocol))


def edits_of(saved: SavedSession, protocol: StudyProtocol) -> str:
    """Return how a session's protocol differs from the study's present one, in one line; empty if it does not."""
    code = saved.state.participant
    changed = [
        field.name
        for field in msgspec.structs.fields(StudyProtocol)
        if field.name != "participants" and getattr(saved.protocol, field.name) != getattr(protocol, field.name)
    ]
    if not changed and (code not in protocol.codes or plan(protocol, code) != saved.state.plan):
        changed = ["participants"]
    if not changed:
        return ""
    parts = ", ".join(changed)
    return f"the protocol was edited after the session began ({parts}); the session goes on with its own plan"
