"""Remove one participant from a study's folder, everywhere, and prove it by a search of all bytes.

A journal, ``.purge.json``, lists the data to remove before any is removed. An interrupted purge goes on from it;
every step can be done again.
"""

from __future__ import annotations

import re
import shutil
from datetime import datetime
from pathlib import Path
from typing import Final

import msgspec

from mocapella.errors import NotNowError, RecordingError, SettingsError
from mocapella.model.whole_file import write_whole
from mocapella.studies.byte_search import SearchReport, files_of, search
from mocapella.studies.file_values import read_json
from mocapella.studies.participants import check_code, number_of
from mocapella.studies.protocol import load_protocol, protocol_bytes
from mocapella.studies.study_folder import (
    PARTICIPANTS,
    PROTOCOL,
    PURGED,
    PURGING,
    RESULTS,
    ManifestFile,
    Purged,
    as_json,
    checksum_of,
    read_manifest,
    read_purged,
    salted,
    stamp,
    was_purged,
    write_manifest,
)

OUT_OF_REACH: Final = (
    "copies of the folder elsewhere: backups, snapshots, other machines",
    "reports, tables and pictures that were made before and are outside of the folder",
    "the free blocks of the disk, which may hold deleted bytes until they are used again",
)
"""What a purge cannot reach."""
_HALF_WRITTEN: Final = (".manifest.*", ".protocol.*", ".purged.*", "..purge.*")
"""Files that `write_whole` leaves behind when the power fails."""


class PurgeJournal(msgspec.Struct, frozen=True):
    """What a purge that has begun will remove.

    Attributes:
        code: the participant's code.
        salt: as in `Purged`.
        at: when it began.
        checksums: of the participant's files.
        files, size_bytes, results: as in `Purged`.
        by: code of the operator.
    """

    code: str
    salt: str
    at: str
    checksums: tuple[str, ...]
    files: int
    size_bytes: int
    results: int
    by: str


class PurgeReport(msgspec.Struct, frozen=True):
    """What a purge removed, and the proof.

    Attributes:
        files, size_bytes, results: as in `Purged`.
        search: the search of the folder afterwards, for the code and the checksums.
        out_of_reach: places out of a purge's reach.
    """

    files: int
    size_bytes: int
    results: int
    search: SearchReport
    out_of_reach: tuple[str, ...] = OUT_OF_REACH

    @property
    def proven(self) -> bool:
        """Whether the search found nothing, and could search everything."""
        return not (self.search.traces or self.search.unsearched)


def purge(path: Path, code: str, *, by: str, at: datetime, salt: str) -> PurgeReport:
    """Remove a participant from a study's folder; go on if this purge was interrupted.

    It removes the participant's folder (takes, logs, consent, session), the rows of the manifest, the code in the
    protocol, and all results, because they are made from all participants.

    Args:
        path: the study's folder.
        code: the participant's code.
        by: code of the operator.
        at: time of now.
        salt: random hexadecimal digits, for `Purged`.

    Raises:
        NotNowError: the purge of another participant was interrupted, and must be finished first.
        SettingsError: a code is refused, or the folder has nothing of such a participant.
        InputError, RecordingError: a file cannot be read, written or removed.
    """
    journal = _begin(path, check_code(code), by=check_code(by), at=at, salt=salt)
    _remove(path / PARTICIPANTS / code)
    _remove(path / RESULTS)
    for name in _HALF_WRITTEN:
        for half in path.glob(name):
            _remove(half)
    _rename_in_protocol(path, journal)
    _note(path, journal)
    gone = (f"{PARTICIPANTS}/{code}/", f"{RESULTS}/")
    rows = [row for row in read_manifest(path).files if not row.path.startswith(gone)]
    write_manifest(path, [*(row for row in rows if row.path not in (PROTOCOL, PURGED)), *_own_rows(path, journal)])
    others = set(load_protocol(path / PROTOCOL).codes)
    found = search(path, code, journal.checksums, others=others, leave_out=PURGING)
    _remove(path / PURGING)
    return PurgeReport(journal.files, journal.size_bytes, journal.results, found)


def _begin(path: Path, code: str, *, by: str, at: datetime, salt: str) -> PurgeJournal:
    file = path / PURGING
    if file.exists():
        journal = read_json(file, PurgeJournal, what="journal of a purge", fix="restore it from a copy")
        if journal.code != code:
            raise NotNowError(f"the purge of {journal.code!r} was interrupted; finish it first, by the same command")
        return journal
    folder = path / PARTICIPANTS / code
    protocol = load_protocol(path / PROTOCOL)
    listed = code in protocol.codes and not was_purged(path, code)
    if not (listed or folder.exists() or any(code in row.path.split("/") for row in read_manifest(path).files)):
        raise SettingsError(f"{path}: there is nothing of participant {code!r}; check the code")
    files = [one for one in files_of(folder) if one.is_file() and not one.is_symlink()]
    known = (row.sha256 for row in read_manifest(path).files if row.path.startswith(f"{PARTICIPANTS}/{code}/"))
    checksums = sorted({*map(checksum_of, files), *known})
    size = sum(one.stat().st_size for one in files)
    results = len(files_of(path / RESULTS))
    journal = PurgeJournal(code, salt, stamp(at), tuple(checksums), len(files), size, results, by)
    write_whole(file, as_json(journal))
    return journal


def _rename_in_protocol(path: Path, journal: PurgeJournal) -> None:
    """Replace the code in the protocol's text by another one, so that the others' orders do not change."""
    file = path / PROTOCOL
    protocol = load_protocol(file)
    named = protocol.participants.codes or protocol.participants.groups
    if not named or journal.code not in protocol.codes:
        return
    numbers = {number_of(code) for code in protocol.codes}
    number = int(journal.salt[:12], 16) % 900_000_000 + 100_000_000
    while number in numbers:
        number += 1
    text = protocol_bytes(file).decode()
    quoted = rf"(?<=[\"']){re.escape(journal.code)}(?=[\"'])"
    write_whole(file, re.sub(quoted, f"X{number}", text).encode())


def _note(path: Path, journal: PurgeJournal) -> None:
    rows = read_purged(path)
    code_sha256 = salted(journal.code, journal.salt)
    if not any(row.code_sha256 == code_sha256 for row in rows):
        row = Purged(code_sha256, journal.salt, journal.at, journal.files, journal.size_bytes, journal.results)
        write_whole(path / PURGED, as_json((*rows, row)))


def _own_rows(path: Path, journal: PurgeJournal) -> list[ManifestFile]:
    files = [path / name for name in (PROTOCOL, PURGED)]
    return [ManifestFile(file.name, checksum_of(file), file.stat().st_size, journal.by, journal.at) for file in files]


def _remove(path: Path) -> None:
    try:
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.exists():
            shutil.rmtree(path)
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be removed ({error.strerror}); the purge goes on when it is called again"
        ) from error


def purging_code(path: Path) -> str:
    """Return the code whose purge was interrupted in a study's folder; empty if none was.

    Raises:
        InputError: the journal cannot be read.
    """
    file = path / PURGING
    if not file.exists():
        return ""
    return read_json(file, PurgeJournal, what="journal of a purge", fix="restore it from a copy").code
