"""Read files of learnt models."""

from __future__ import annotations

from pathlib import Path

from mocapella.errors import InputError


def model_bytes(path: Path) -> bytes:
    """Return the contents of a file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, fix="check the name and the folder") from error
