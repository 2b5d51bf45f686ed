"""Origin of a take whose results were tracked again from the raw frames of an earlier recording."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mocapella.errors import InputError

_PIECE: Final = 1 << 20


@dataclass(frozen=True)
class TakeOrigin:
    """The recording whose raw frames a take contains, and the changes of the tracking.

    Attributes:
        file: name of the recording's file, without its folder.
        sha256: SHA-256 of the recording's files, in their order, in hexadecimal digits.
        take_id: identity of the take; empty for a recording of another type, and for older takes.
        version: version of Mocapella that recorded it; empty for a recording of another type.
        changes: differences from the recording, by name, such as ``method``, ``settings`` or ``placement``.
    """

    file: str
    sha256: str
    take_id: str = ""
    version: str = ""
    changes: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the origin as one line for users."""
        changed = "; ".join(_texts(self.changes)) or "nothing changed"
        known = f"take {self.take_id[:8]}, " if self.take_id else ""
        return f"tracked again from {self.file} ({known}SHA-256 {self.sha256[:16]}…): {changed}"


def _texts(changes: Mapping[str, Any], within: str = "") -> list[str]:
    found: list[str] = []
    for name, value in changes.items():
        if isinstance(value, Mapping) and value:
            found += _texts(value, "" if name == "settings" else f"{within}{name}.")
        else:
            text = str(value)
            shown = f"of {text.count(chr(10))} lines" if "\n" in text else text  # the text of a file
            found.append(f"{within}{name} {shown if len(shown) <= 40 else shown[:39] + '…'}")
    return found


def sha256_of(files: Sequence[Path]) -> str:
    """Return the SHA-256 of several files, one after the other, in hexadecimal digits.

    Raises:
        InputError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for path in files:
        try:
            with path.open("rb") as file:
                while piece := file.read(_PIECE):
                    digest.update(piece)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    return digest.hexdigest()
