"""The folder of a study: its protocol, a folder for each participant, and the manifest of all files.

protocol.toml                        the protocol, as copied when the study began
manifest.json                        every other file, with its checksum and who added it, when and with what
participants/CODE/participant.json   consent and retention
participants/CODE/session.json       state and events of the session
participants/CODE/…                  takes and logs
results/…                            what analyses wrote
purged.json                          removed participants
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella import __version__
from mocapella.errors import InputError, MocapellaError, RecordingError, SettingsError, TakeExistsError, one_of
from mocapella.model.whole_file import write_whole
from mocapella.studies.byte_search import files_of
from mocapella.studies.file_values import read_json
from mocapella.studies.participants import check_code
from mocapella.studies.progress import ENDED
from mocapella.studies.protocol import StudyProtocol, load_protocol, protocol_from_toml
from mocapella.studies.state_file import load_session

PROTOCOL: Final = "protocol.toml"
MANIFEST: Final = "manifest.json"
PURGED: Final = "purged.json"
PURGING: Final = ".purge.json"
"""Journal of a purge that has begun."""
PARTICIPANTS: Final = "participants"
RESULTS: Final = "results"
CONSENT: Final = "participant.json"
SESSION: Final = "session.json"
LOGS: Final = "logs"
"""Folder of the logs of tasks, beside the takes that they were cut out of."""
_CHANGING: Final = (PROTOCOL, PURGED, CONSENT, SESSION)
"""Names of files that change as the study goes on."""
_FIX: Final = "restore it from a copy"


class ManifestFile(msgspec.Struct, frozen=True, omit_defaults=True):
    """A file of a study.

    Attributes:
        path: its path in the study's folder, with ``/``.
        sha256: checksum, in hexadecimal digits.
        size_bytes: its size.
        by: code of the operator who added it.
        at: when it was added, such as ``2026-11-30T09:00:00Z``.
        version: version of Mocapella that added it.
        settings: settings that it was made with.
    """

    path: str
    sha256: str
    size_bytes: int
    by: str
    at: str
    version: str = __version__
    settings: dict[str, Any] = {}


class StudyManifest(msgspec.Struct, frozen=True):
    """The files of a study, sorted by their paths."""

    files: tuple[ManifestFile, ...] = ()


class ConsentRecord(msgspec.Struct, frozen=True):
    """A participant's consent.

    Attributes:
        participant: the participant's code.
        given: date of the consent, such as ``2026-11-30``.
        consent_sha256: checksum of the text that the participant agreed to.
        retain_until: last day on which the data may be kept; empty without limit.
    """

    participant: str
    given: str
    consent_sha256: str
    retain_until: str = ""


class Purged(msgspec.Struct, frozen=True):
    """A removed participant.

    Attributes:
        code_sha256: checksum of ``salt`` and the code. Who knows the code can check it; who guesses it, too.
        salt: random hexadecimal digits.
        at: when.
        files, size_bytes: number and size of the removed files of the participant.
        results: number of removed files of results.
    """

    code_sha256: str
    salt: str
    at: str
    files: int
    size_bytes: int
    results: int


class FolderCheck(msgspec.Struct, frozen=True):
    """Result of `verify_study`: paths in the folder.

    Attributes:
        files: number of files in the manifest.
        missing: files of the manifest that are not there.
        changed: files whose bytes are others than in the manifest.
        unknown: files that are not in the manifest.
        ongoing: sessions that have not ended. These files change each second, and are in no other list; the manifest
            gets their checksums when the sessions end.
        purging: whether a purge was interrupted.
    """

    files: int
    missing: tuple[str, ...]
    changed: tuple[str, ...]
    unknown: tuple[str, ...]
    purging: bool
    ongoing: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether every file is as in the manifest, and no other is there."""
        return not (self.missing or self.changed or self.unknown or self.purging)


@dataclass(frozen=True)
class StudyFolder:
    """A study on the disk; `open_study` opens it.

    Attributes:
        path: its folder.
        protocol: its protocol.
    """

    path: Path
    protocol: StudyProtocol

    def participant(self, code: str) -> Path:
        """Return the folder of a participant, which need not exist.

        Raises:
            SettingsError: the protocol has no such participant, or the participant was purged.
        """
        if code not in self.protocol.codes:
            known = one_of(check_code(code), self.protocol.codes)
            raise SettingsError(f"{self.path}: the study has no participant {code!r}; it has {known}")
        if was_purged(self.path, code):
            raise SettingsError(f"{self.path}: participant {code!r} was purged; a new participant needs another code")
        return self.path / PARTICIPANTS / code

    def make_participant(self, code: str) -> Path:
        """Return the folder of a participant, made if it does not exist, readable by its owner only.

        Raises:
            SettingsError: as in `participant`.
            InputError: it cannot be made.
        """
        folder = self.participant(code)
        _make_folder(folder.parent)
        _make_folder(folder)
        return folder


def new_study(path: Path, protocol: bytes, *, by: str, at: datetime) -> StudyFolder:
    """Make the folder of a new study.

    Args:
        path: the folder, which must not exist or be empty.
        protocol: the protocol's TOML text, which is copied.
        by: code of the operator.
        at: time of now.

    Raises:
        TakeExistsError: the folder has files.
        SettingsError, InputError: the operator's code or the protocol is refused, or the folder cannot be made.
    """
    check_code(by)
    found = protocol_from_toml(protocol, file=PROTOCOL)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise TakeExistsError(f"{path} has files, and a study is never overwritten; name another folder")
    _make_folder(path)
    _make_folder(path / PARTICIPANTS)
    write_whole(path / PROTOCOL, protocol)
    study = StudyFolder(path, found)
    add_files(study, [path / PROTOCOL], by=by, at=at)
    return study


def open_study(path: Path) -> StudyFolder:
    """Open a study's folder.

    Raises:
        InputError: it is no study's folder, or its protocol or manifest is refused.
    """
    if not (path / PROTOCOL).is_file():
        raise InputError(f"is no study: it has no {PROTOCOL}", file=path, fix="make one with `mocapella study new`")
    return StudyFolder(path, load_protocol(path / PROTOCOL))


def read_manifest(path: Path) -> StudyManifest:
    """Return the manifest of a study's folder; an empty one if it has none.

    Raises:
        InputError: the file cannot be read, or is no manifest.
    """
    file = path / MANIFEST
    if not os.path.lexists(file):
        return StudyManifest()
    return read_json(file, StudyManifest, what="manifest", fix=_FIX)


def add_files(
    study: StudyFolder, files: Iterable[Path], *, by: str, at: datetime, settings: Mapping[str, Any] | None = None
) -> tuple[ManifestFile, ...]:
    """Add files of the folder to the manifest, and return their rows.

    A file that is there with the same checksum keeps its row; sessions, consents and the protocol get a new one.

    Args:
        study: the study.
        files: paths of files within its folder.
        by: code of the operator.
        at: time of now.
        settings: settings that the files were made with.

    Raises:
        TakeExistsError: a take or log is in the manifest with another checksum: it was overwritten.
        SettingsError, InputError: the operator's code is refused, or a file cannot be read.
    """
    check_code(by)
    rows = {row.path: row for row in read_manifest(study.path).files}
    added = []
    for file in files:
        name = file.relative_to(study.path).as_posix()
        row = ManifestFile(name, checksum_of(file), file.stat().st_size, by, stamp(at), settings=dict(settings or {}))
        known = rows.get(name)
        if known is not None and known.sha256 == row.sha256:
            added.append(known)
            continue
        if known is not None and not may_change(name):
            raise TakeExistsError(f"{file} is not the file that is in the manifest since {known.at}; {_FIX}")
        rows[name] = row
        added.append(row)
    write_manifest(study.path, rows.values())
    return tuple(added)


def may_change(name: str) -> bool:
    """Whether a file, by its path in the study's folder, changes as the study goes on; takes and logs never do."""
    return name.rpartition("/")[2] in _CHANGING or name.startswith(f"{RESULTS}/")


def write_manifest(path: Path, rows: Iterable[ManifestFile]) -> None:
    """Write the manifest of a study's folder atomically.

    Raises:
        InputError: it cannot be written.
    """
    manifest = StudyManifest(tuple(sorted(rows, key=lambda row: row.path)))
    write_whole(path / MANIFEST, as_json(manifest))


def verify_study(path: Path) -> FolderCheck:
    """Compare every file of a study's folder with its manifest.

    Raises:
        InputError: the manifest is refused, or a file cannot be read.
    """
    rows = {row.path: row for row in read_manifest(path).files}
    there = {file.relative_to(path).as_posix(): file for file in files_of(path)}
    purging = there.pop(PURGING, None) is not None
    there.pop(MANIFEST, None)
    ongoing = tuple(name for name, file in there.items() if file.name == SESSION and _goes_on(file))
    changed = [
        name
        for name, file in there.items()
        if name in rows and name not in ongoing and (not _is_file(file) or checksum_of(file) != rows[name].sha256)
    ]
    return FolderCheck(
        len(rows),
        tuple(name for name in rows if name not in there),
        tuple(changed),
        tuple(name for name in there if name not in rows and name not in ongoing),
        purging,
        ongoing,
    )


def _is_file(file: Path) -> bool:
    return file.is_file() and not file.is_symlink()


def _goes_on(file: Path) -> bool:
    """Whether a file is a session that has not ended."""
    try:
        return _is_file(file) and load_session(file).state.phase not in ENDED
    except MocapellaError:
        return False


def give_consent(study: StudyFolder, code: str, given: date, *, by: str, at: datetime) -> ConsentRecord:
    """Store that a participant agreed to the protocol's text of consent on a day, and until when the data may be kept.

    Raises:
        SettingsError: as in `StudyFolder.participant`, or the protocol has no text of consent.
        RecordingError: another consent is stored.
        InputError: the file cannot be written.
    """
    folder = study.make_participant(code)
    if not study.protocol.consent:
        raise SettingsError(f"{study.path / PROTOCOL} has no text of consent; add `consent`")
    days = study.protocol.retention_days
    try:
        until = (given + timedelta(days=days)).isoformat() if days else ""
    except OverflowError:
        raise SettingsError(f"{given} cannot be a date of consent; give the day on which it was given") from None
    record = ConsentRecord(code, given.isoformat(), study.protocol.consent_checksum, until)
    file = folder / CONSENT
    if file.exists() and read_consent(file) != record:
        raise RecordingError(f"{file} has another consent, of {read_consent(file).given}; it is never overwritten")
    write_whole(file, as_json(record))
    add_files(study, [file], by=by, at=at)
    return record


def read_consent(file: Path) -> ConsentRecord:
    """Read a participant's consent.

    Raises:
        InputError: the file cannot be read, is no consent, or has an invalid date.
    """
    record = read_json(file, ConsentRecord, what="consent", fix=_FIX)
    for field, text in (("given", record.given), ("retain_until", record.retain_until)):
        try:
            if text:
                date.fromisoformat(text)
        except ValueError:
            raise InputError("is no date", file=file, field=field, value=text, fix=_FIX) from None
    return record


def due_participants(study: StudyFolder, today: date) -> tuple[ConsentRecord, ...]:
    """Return the consents whose retention ended before a day, the oldest first.

    Raises:
        InputError: a consent cannot be read.
    """
    records = map(read_consent, sorted((study.path / PARTICIPANTS).glob(f"*/{CONSENT}")))
    due = (one for one in records if one.retain_until and date.fromisoformat(one.retain_until) < today)
    return tuple(sorted(due, key=lambda one: (one.retain_until, one.participant)))


def participants_without_consent(study: StudyFolder) -> tuple[str, ...]:
    """Return the codes of the participants who have files and no consent."""
    folders = sorted(path for path in (study.path / PARTICIPANTS).iterdir() if path.is_dir())
    return tuple(path.name for path in folders if not (path / CONSENT).exists() and files_of(path))


def read_purged(path: Path) -> tuple[Purged, ...]:
    """Return the participants removed from a study's folder.

    Raises:
        InputError: the file cannot be read, or is no list of removed participants.
    """
    file = path / PURGED
    if not os.path.lexists(file):
        return ()
    return read_json(file, tuple[Purged, ...], what="list of purged participants", fix=_FIX)


def was_purged(path: Path, code: str) -> bool:
    """Whether a participant was removed from a study's folder."""
    return any(row.code_sha256 == salted(code, row.salt) for row in read_purged(path))


def salted(code: str, salt: str) -> str:
    """Return the checksum of a salt and a code, in hexadecimal digits."""
    return hashlib.sha256(f"{salt}/{code}".encode()).hexdigest()


def checksum_of(file: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with file.open("rb") as data:
            return hashlib.file_digest(data, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file, fix="check its permissions") from error


def stamp(at: datetime) -> str:
    """Return a time as the manifest has it, such as ``2026-11-30T09:00:00Z``."""
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def as_json(value: Any) -> bytes:
    """Return a value as JSON that people can read, a field a line."""
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", file=path, fix="choose another folder") from error
