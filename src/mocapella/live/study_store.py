"""Keep a study's session in the study's folder (`mocapella.studies.study_folder`)."""

from __future__ import annotations

import subprocess
import sys
import threading
from datetime import UTC, date, datetime
from pathlib import Path

from mocapella.errors import NotNowError, RecordingError
from mocapella.recording.disk import free_name
from mocapella.studies.participants import check_code
from mocapella.studies.progress import ENDED, StudyEvent, StudyState
from mocapella.studies.protocol import StudyProtocol
from mocapella.studies.state_file import SavedSession, load_session, new_session, reopen_session, save_session
from mocapella.studies.study_folder import (
    CONSENT,
    PARTICIPANTS,
    SESSION,
    StudyFolder,
    add_files,
    open_study,
    read_consent,
)
from mocapella.studies.task_runs import empty_runs


class FolderStore:
    """The folder of a study, for `mocapella.live.study_service.StudyService`.

    Args:
        path: the folder.
        operator: code of who runs the session, for the manifest.

    Attributes:
        notes: what the researcher must know: an edited protocol, and tasks without a tracked person.

    Raises:
        InputError: it is no study's folder, or cannot be read.
        SettingsError: the operator's code is refused.
    """

    def __init__(self, path: Path, operator: str) -> None:
        self._study: StudyFolder = open_study(path)
        self._operator = check_code(operator)
        self._session: SavedSession | None = None
        self._edited = ""
        self._changing = threading.Lock()  # of the manifest, which `study logs` changes, too
        self.notes: tuple[str, ...] = ()

    @property
    def protocol(self) -> StudyProtocol:
        """The study's present protocol."""
        return self._study.protocol

    def load(self) -> StudyState | None:
        """Return the state of the newest session that has not ended; None if there is none.

        Raises:
            InputError, RecordingError: a session cannot be read.
        """
        files = sorted((self._study.path / PARTICIPANTS).glob(f"*/{SESSION}"))
        open_ones = [(session.state.at_ns, file, session) for file in files
                     if (session := load_session(file)).state.phase not in ENDED]  # fmt: skip
        if not open_ones:
            return None
        _, file, self._session = max(open_ones, key=lambda one: one[0])
        self._edited = reopen_session(file, self.protocol).edited
        self._note()
        return self._session.state

    def begin(self, participant: str) -> None:
        """Check that a participant may begin.

        Raises:
            SettingsError: the participant is unknown, or was purged.
            NotNowError: the participant has not consented to the text of the protocol, or has taken part.
            InputError: the consent cannot be read.
        """
        folder = self._study.participant(participant)
        if self.protocol.consent:
            self._check_consent(participant, folder / CONSENT)
        if (folder / SESSION).exists():
            fix = f"move {folder} out of the study to begin anew"
            raise NotNowError(f"{participant} has taken part, and a session is never overwritten; {fix}")
        self._session, self._edited, self.notes = None, "", ()

    def save(self, state: StudyState, events: tuple[StudyEvent, ...]) -> None:
        """Keep a state, with the events since the last one; a session that ends comes into the manifest.

        Raises:
            InputError, SettingsError: it cannot be written.
        """
        file = self._study.make_participant(state.participant) / SESSION
        advanced = state, events
        self._session = new_session(self.protocol, advanced) if self._session is None else self._session.after(advanced)
        save_session(file, self._session)
        if events:
            self._note()
        if state.phase in ENDED:
            with self._changing:
                add_files(self._study, [file], by=self._operator, at=datetime.now(UTC))

    def take(self, state: StudyState, *, again: bool = False) -> Path:
        """Return the path of the take of the present placement; with ``again`` of a further one.

        Raises:
            InputError, SettingsError: the participant's folder cannot be made.
        """
        folder, name = self._study.make_participant(state.participant), state.planned.placement.name
        return folder / f"{free_name(folder, f'{name}-again-1') if again else name}.mcap"

    def keep(self, take: Path) -> None:
        """Put a finished take and its session into the manifest, and write the logs of the tasks that are finished.

        A process of its own writes the logs, so that the next participant's results do not wait for it.

        Raises:
            MocapellaError: it cannot be written.
        """
        if not take.is_relative_to(self._study.path):
            return  # it was recorded beside the study
        with self._changing:
            files = [take, take.parent / SESSION]
            add_files(self._study, [file for file in files if file.exists()], by=self._operator, at=datetime.now(UTC))
            self._write_logs()

    def _write_logs(self) -> None:
        words = ["study", "logs", str(self._study.path.absolute()), "--by", self._operator]
        done = subprocess.run(
            [sys.executable, "-m", "mocapella", *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            start_new_session=True,  # Ctrl-C ends the server, and not this
        )
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise RecordingError(
                f"no logs of tasks were written ({''.join(last)}); try again: mocapella {' '.join(words)}"
            )

    def _note(self) -> None:
        runs = empty_runs(self._session.events) if self._session is not None else ()
        self.notes = (
            *filter(None, [self._edited]),
            *(
                f"nobody was tracked in {run.task} ({run.placement}, repetition {run.repetition}): "
                "repeat it before the participant leaves"
                for run in runs
            ),
        )

    def _check_consent(self, participant: str, file: Path) -> None:
        how = f"mocapella study consent {self._study.path} {participant} --given {date.today().isoformat()}"
        if not file.exists():
            raise NotNowError(f"{participant} has not consented; after the consent: {how}")
        if read_consent(file).consent_sha256 != self.protocol.consent_checksum:
            raise NotNowError(
                f"{participant} consented to another text than the protocol's; ask again, and then: {how}"
            )
