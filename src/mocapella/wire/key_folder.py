"""The folder of keys, of sessions and from pairing codes: private files of one account of the operating system.

``MOCAPELLA_SESSIONS`` names it, else it is ``mocapella/sessions`` in ``$XDG_CONFIG_HOME`` or ``~/.config``. It has mode
0700 and its files have mode 0600; a key that other users can read is refused.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from mocapella.errors import KeyFileError

MOST_KEY_BYTES: Final = 1 << 16
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


def key_folder() -> Path:
    """Return the folder of this user's keys, which may not exist yet.

    Raises:
        KeyFileError: the user has no home folder.
    """
    named = os.environ.get("MOCAPELLA_SESSIONS")
    if named:
        return Path(named)
    config = os.environ.get("XDG_CONFIG_HOME")
    try:
        return (Path(config) if config else Path.home() / ".config") / "mocapella" / "sessions"
    except RuntimeError as error:  # an account without a home
        raise KeyFileError("this user has no home folder for keys; name a folder in MOCAPELLA_SESSIONS") from error


def read_private(path: Path) -> str | None:
    """Return the text of a key file; None if there is none.

    Raises:
        KeyFileError: it cannot be read, belongs to another user, or other users can read or change it.
    """
    try:
        with path.open(encoding="ascii") as file:
            _check_private(path, os.fstat(file.fileno()))
            return file.read(MOST_KEY_BYTES)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read ({error.strerror}); it must be a file of yours") from error
    except UnicodeDecodeError as error:
        raise KeyFileError(f"{path}: is no key; remove it and pair again") from error


def write_private(path: Path, text: str, *, replace: bool = True) -> bool:
    """Write a key file with mode 0600, atomically; return False if it exists and ``replace`` is False, else True.

    Raises:
        KeyFileError: it cannot be written.
    """
    try:
        if path.parent == key_folder():
            _ensure_private(path.parent)
        with _scratch_file(path.parent, text) as new:
            if replace:
                new.replace(path)
                return True
            os.link(new, path)
            return True
    except FileExistsError:
        return False
    except OSError as error:
        raise KeyFileError(
            f"{path}: cannot be written ({error.strerror}); name another folder in MOCAPELLA_SESSIONS"
        ) from error


@contextmanager
def _scratch_file(folder: Path, text: str) -> Iterator[Path]:
    """Yield a file of mode 0600 with this text; delete it at the end of the context, unless it was renamed.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / f".{secrets.token_hex(8)}"
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(fd, "w", encoding="ascii") as file:
            file.write(text)
        yield path
    finally:
        with suppress(FileNotFoundError):
            path.unlink()


def _ensure_private(folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    _check_private(folder, folder.stat())


def _check_private(path: Path, found: os.stat_result) -> None:
    if not hasattr(os, "getuid"):  # Windows: the user's profile is private by its access list
        return
    if found.st_uid != os.getuid():
        raise KeyFileError(f"{path}: belongs to another user; use a folder of your own (MOCAPELLA_SESSIONS)")
    if found.st_mode & _OTHERS:
        mode = "700" if stat.S_ISDIR(found.st_mode) else "600"
        raise KeyFileError(f"{path}: other users of this machine can open it; type: chmod {mode} {path}")
