"""Write files atomically."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from mocapella.errors import InputError


def usual_mode() -> int:
    """Return the mode of a file that this user makes: readable by others only if the user's umask lets them."""
    umask = os.umask(0o077)  # to ask for it is to set it; meanwhile, new files are private
    os.umask(umask)
    return 0o666 & ~umask


def write_whole(path: Path | str, data: bytes) -> None:
    """Write a file atomically: readers, also after a crash, see the old or the new contents.

    An existing file is replaced. The folder must exist. The file has the `usual_mode`.

    Raises:
        InputError: it cannot be written there.
    """
    path = Path(path)
    try:
        fd, name = tempfile.mkstemp(prefix=f".{path.stem}.", dir=path.parent)
        try:
            with os.fdopen(fd, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(name).chmod(usual_mode())
            Path(name).replace(path)
        finally:
            Path(name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path, fix="choose another folder") from error
