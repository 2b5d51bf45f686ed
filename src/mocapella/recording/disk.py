"""Disk access of recordings: safe names, free space, new files, and durable writes."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mocapella.errors import DiskFullError, RecordingError, TakeExistsError
from mocapella.model.names import is_device

try:
    import fcntl
except ImportError:  # pragma: no cover  Windows, where the exclusive creation alone protects a take
    fcntl = None  # type: ignore[assignment]

GIB: Final = 1 << 30
TAKES: Final = Path("takes")
"""Folder of takes that are named without a folder."""
SUFFIX: Final = ".mcap"
MAX_NAME_BYTES: Final = 200
"""Longest name of a take, in bytes; file systems allow 255, and a suffix such as ``.merging.mcap`` is appended."""

_RESERVED = re.compile(r"\.(part\d+|merging)$", re.IGNORECASE)
_PART_OR_TAKE = re.compile(r"(\.(part\d+|merging))?\.mcap$", re.IGNORECASE)
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f/\\<>:"|?*]')
PRIVATE: Final = 0o600
"""File mode of recordings: only the user may read them, because they show people."""
_PRIVATE_FOLDER: Final = 0o700
_FULL: Final = (errno.ENOSPC, errno.EDQUOT)
_data_sync = getattr(os, "fdatasync", os.fsync)  # not on every system


def take_path(folder: Path | str, name: str) -> Path:
    """Return the path of a take, ``folder/name.mcap``, after checking the untrusted name.

    Raises:
        RecordingError: the name is empty, too long, leads out of the folder, or is reserved; names the valid ones.
    """
    stem = name[: -len(SUFFIX)] if name.lower().endswith(SUFFIX) else name
    problem = ""
    if not stem.strip():
        problem = "is empty"
    elif not stem.isprintable() or stem.startswith("-"):
        problem = "begins with '-' or has a character that cannot be printed"
    elif is_device(stem):
        problem = "is a device of Windows"
    elif _FORBIDDEN.search(stem) or stem.startswith(".") or ".." in stem:
        problem = "has a character or a dot that a name may not have"
    elif stem != stem.strip() or stem.endswith("."):
        problem = "begins or ends with a space or a dot"
    elif len(stem.encode("utf-8", "replace")) > MAX_NAME_BYTES:
        problem = f"is longer than {MAX_NAME_BYTES} bytes"
    elif _RESERVED.search(stem):
        problem = "ends like the parts of an interrupted take"
    if problem:
        shown = name if len(name) <= 60 else name[:59] + "…"
        raise RecordingError(
            f"take name {shown!r} {problem}; use letters, digits, spaces, '-' and '_', such as participant-7-walk"
        )
    return Path(folder) / (stem + SUFFIX)


def next_name(take: str) -> str:
    """Return the name of the take after ``take``: the number at its end plus one, or ``-2`` appended to it."""
    match = re.fullmatch(r"(.*?)(\d+)", take)
    if match is None:
        return f"{take}-2"
    digits = match.group(2)
    return f"{match.group(1)}{int(digits) + 1:0{len(digits)}d}"


def free_name(folder: Path, name: str) -> str:
    """Return ``name`` if no take or part in the folder has it, else the first free one that `next_name` gives."""
    try:
        taken = {_PART_OR_TAKE.sub("", entry.name).lower() for entry in folder.iterdir()}
    except OSError:  # missing or unreadable: recording into it reports that
        taken = set()
    while name.lower() in taken:
        name = next_name(name)
    return name


def ensure_folder(folder: Path) -> None:
    """Make a folder that only this user can read, with its missing parents, unless it exists.

    Raises:
        RecordingError: the folder cannot be made, or its path is a file.
    """
    try:
        make_private(folder)
    except OSError as error:
        raise RecordingError(f"{folder} cannot be the folder of takes ({error.strerror}); name another") from error


def folder_problem(folder: Path) -> str:
    """Return why no take can be recorded into a folder, which may not exist yet; empty if one can."""
    there = next((path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path)), folder)
    if not os.path.isdir(there):  # noqa: PTH112, for Path.is_dir raises an error where it may not look
        return f"{there} is no folder"
    return "" if os.access(there, os.W_OK | os.X_OK) else f"{there} cannot be written to"


def make_private(folder: Path) -> None:
    """Make a folder and its missing parents, accessible to this user only; existing folders are unchanged.

    Raises:
        OSError: the folder cannot be made, or its path is a file.
    """
    for one in (*reversed(folder.parents), folder):
        if not one.is_dir():
            one.mkdir(mode=_PRIVATE_FOLDER, exist_ok=True)


def part_path(path: Path, number: int) -> Path:
    """Return the path of a file of an interrupted take ``path``: for part 1 the take, then ``NAME.part2.mcap``, …"""
    return path if number == 1 else path.with_name(f"{path.stem}.part{number}{SUFFIX}")


def merging_path(path: Path) -> Path:
    """Return the path of the temporary file into which a take's parts are merged, before it replaces the take."""
    return path.with_name(f"{path.stem}.merging{SUFFIX}")


def parts_of(path: Path) -> tuple[Path, ...]:
    """Return the files of a take in order: ``path`` itself, then the parts that exist beside it."""
    pattern = re.compile(re.escape(path.stem) + r"\.part(\d+)\.mcap")
    found = [(int(m[1]), entry) for entry in path.parent.iterdir() if (m := pattern.fullmatch(entry.name))]
    return (path, *(entry for _, entry in sorted(found)))


def next_part(path: Path) -> int:
    """Return the number of the first unused part of the take ``path``, 2 or more."""
    last = re.search(r"\.part(\d+)\.mcap$", parts_of(path)[-1].name)
    return int(last[1]) + 1 if last else 2


def check_can_record(path: Path, reserve_bytes: int = GIB) -> None:
    """Check, before anything is created, that a take can be recorded to ``path``.

    Raises:
        RecordingError: the folder is missing, no folder, or cannot be written to.
        DiskFullError: the disk has fewer free bytes than ``reserve_bytes``; names both.
        TakeExistsError: the take or one of its parts exists.
    """
    check_folder(path.parent, reserve_bytes)
    taken = next((part for part in parts_of(path) if os.path.lexists(part)), None)
    if taken is not None:
        raise name_taken(taken)


def check_folder(folder: Path, reserve_bytes: int) -> None:
    """Check that a folder exists, can be written to, and has ``reserve_bytes`` of free space.

    Raises:
        RecordingError: the folder is missing, no folder, or cannot be written to.
        DiskFullError: the disk has fewer free bytes than ``reserve_bytes``; names both.
    """
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        raise RecordingError(f"cannot record into {folder}: it {what}; make the folder or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RecordingError(f"cannot record into {folder}: it cannot be written to; choose another folder")
    free = free_bytes(folder)
    if free < reserve_bytes:
        raise DiskFullError(f"cannot record into {folder}: {too_little(free, reserve_bytes)}")


def name_taken(path: Path, why: str = "it exists") -> TakeExistsError:
    """Return the error for a take whose file name is in use; ``why`` is the reason in its message."""
    return TakeExistsError(f"cannot record to {path}: {why}, and nothing is overwritten; choose another name")


def too_little(free: int, needed: int) -> str:
    """Return the text of an error about space, from bytes: ``0.40 GiB are free and 1.00 GiB are needed; …``."""
    return (
        f"{free / GIB:.2f} GiB are free and {needed / GIB:.2f} GiB are needed; free some space or choose another disk"
    )


def free_bytes(folder: Path) -> int:
    """Return the number of free bytes on the folder's disk for this user."""
    return shutil.disk_usage(folder).free


def is_full(error: OSError) -> bool:
    """Whether an error reports a full disk."""
    return error.errno in _FULL


def as_ours(error: OSError, what: str) -> RecordingError:
    """Return a `DiskFullError` or `RecordingError` to raise for an `OSError`; ``what`` begins its message."""
    if is_full(error):
        return DiskFullError(f"{what}: the disk is full ({error.strerror}); free some space or choose another disk")
    return RecordingError(f"{what}: the disk failed ({error.strerror}); look at the disk or choose another")


def create_new(path: Path) -> int:
    """Create a new file that only this user can read; return its open descriptor, for reading and writing.

    Raises:
        TakeExistsError: the file exists, also as a dangling link.
        DiskFullError, RecordingError: the file cannot be created.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        return os.open(path, flags, PRIVATE)
    except FileExistsError:
        raise name_taken(path) from None
    except OSError as error:
        kind = DiskFullError if is_full(error) else RecordingError
        raise kind(f"cannot record to {path}: {error.strerror}; choose another folder") from error


def lock(fd: int) -> bool:
    """Lock an open file until it is closed or the process ends; return False if another process has locked it.

    On systems without such locks, return True without an effect.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems have no locks: then as on Windows
        return True
    return True


def removed(fd: int) -> bool:
    """Whether the file of an open descriptor was removed, so that its content is lost when it is closed."""
    return os.fstat(fd).st_nlink == 0


def size(fd: int) -> int:
    """Return the size of an open file, in bytes."""
    return os.fstat(fd).st_size


def leads_to(path: Path, fd: int) -> bool:
    """Whether the path still names the open file; False if it was removed, moved or replaced."""
    try:
        return os.path.samestat(path.stat(), os.fstat(fd))
    except OSError:
        return False


def write_all(fd: int, data: bytes) -> None:
    """Write all bytes to an open file, in several system calls if necessary."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(fd, rest) :]


def sync(fd: int) -> None:
    """Flush an open file's content from the system's cache to the disk."""
    _data_sync(fd)


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries, such as new and renamed files, to the disk; no effect on Windows."""
    if os.name == "nt":  # pragma: no cover  folders cannot be opened there
        return
    with _descriptor(folder) as fd:
        os.fsync(fd)


@contextlib.contextmanager
def _descriptor(folder: Path) -> Iterator[int]:
    fd = os.open(folder, os.O_RDONLY)
    try:
        yield fd
    finally:
        os.close(fd)
