"""The errors that Mocapella raises on purpose, as one family of exceptions.

MocapellaError                base class; the message says what would have worked
├── InputError                a file's content: names file, row, field, value and the fix
│   └── DamagedTakeError      a recording that ends early or has a bad part
├── SettingsError             a setting out of range, unknown, or of the wrong type
├── PluginError               a registered descriptor that cannot be used
├── WireError                 bytes that are no valid message
│   └── SchemaVersionError    a message of an unsupported schema version
├── BusError                  an operation of the bus failed
│   ├── AddressInUseError     another program listens at the address
│   ├── NameTakenError        another node serves a sensor of this name
│   ├── KeyFileError          a session's key that cannot be read, kept or used
│   └── NoServerError         no server answers at that address
│       └── NotAdmittedError  the server there does not admit this program
├── RecordingError            a take or a file of results could not be written
│   ├── TakeExistsError       the name is in use; takes are never overwritten
│   ├── DiskFullError         too little free disk space, or a full spool
│   └── UnstoredFramesError   a node ended before all its frames were stored
├── CalibrationError          observations do not determine the poses, lenses or corners that are sought
├── EngineError               an engine that cannot process a study's recordings
├── EvaluationError           a method's result cannot be scored
└── NotNowError               a command that cannot be used in the present state
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Final


def visible(text: str, keep: str = "") -> str:
    """Return the text with control and direction characters as escapes, such as ``\\x1b``, except those in ``keep``.

    A terminal would carry out an escape sequence, and show a name with a direction character in another order.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)


class MocapellaError(Exception):
    """Base class of all errors raised on purpose. The message is one line, and says what to do."""


class InputError(MocapellaError):
    """A file that cannot be used.

    The message is one line with the known parts: ``file: row 12: field Head_X: 'abc': <problem>; <fix>``. Control
    characters in it, such as from a field's name in a damaged file, are escaped.

    Args:
        problem: the fault, as a predicate of the file, such as ``cannot be read``.
        file: the file's path or name.
        row: number of the row; the header is row 1.
        field: name of the column or field.
        value: the faulty value; its ``repr`` is shown, cut to 60 characters.
        fix: the remedy, as an instruction to the user.

    Attributes:
        problem, file, row, field, value, fix: the arguments; None for those not given.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        row: int | None = None,
        field: str | None = None,
        value: object = None,
        fix: str | None = None,
    ) -> None:
        self.problem, self.file, self.row, self.field, self.value, self.fix = problem, file, row, field, value, fix
        parts = [] if file is None else [str(file)]
        parts += [] if row is None else [f"row {row}"]
        parts += [] if field is None else [f"field {field}"]
        parts += [] if value is None else [_shorten(repr(value))]
        super().__init__(visible(": ".join([*parts, problem]) + (f"; {fix}" if fix else "")))


class DamagedTakeError(InputError):
    """A recording that ends early or has a part that cannot be read."""


class SettingsError(MocapellaError):
    """A setting that is unknown, of the wrong type, or out of range."""


class PluginError(MocapellaError):
    """A registered descriptor that cannot be used; names it, its package and the fault."""


class WireError(MocapellaError):
    """Bytes that are not a valid message.

    Args:
        text: names the fault; control characters in it, which come from the bytes, are escaped.
    """

    def __init__(self, text: str) -> None:
        super().__init__(visible(text))


class SchemaVersionError(WireError):
    """A message of an unsupported schema version; names both versions."""


class BusError(MocapellaError):
    """An operation of the bus failed."""


class AddressInUseError(BusError):
    """Another program listens at the address."""


class NameTakenError(BusError):
    """Another node serves a sensor of this name."""


class KeyFileError(BusError):
    """A session's key that cannot be read, kept or used; names the file and the remedy."""


class NoServerError(BusError):
    """No server answers at the address."""


class NotAdmittedError(NoServerError):
    """The server at the address does not admit this program; says which key is wanted, and how to get it."""


class RecordingError(MocapellaError):
    """A take, or another file of results, cannot be written, merged or read back, or a recording had to stop."""


class TakeExistsError(RecordingError):
    """The file name of a new take or study log is in use; neither is ever overwritten."""


class DiskFullError(RecordingError):
    """The disk is full, or too little is free: less than the reserve or than a copy needs; or a spool is full."""


class UnstoredFramesError(RecordingError):
    """A node ended before all frames of an open take were acknowledged; says how many, and where they are kept."""


class CalibrationError(MocapellaError):
    """Observations do not determine the poses, lenses or corners that are sought; the message says what to film."""


class EngineError(MocapellaError):
    """An engine that cannot process a study's recordings; the message says how to start one that can."""


class EvaluationError(MocapellaError):
    """A method's result cannot be scored; the message says what can."""


class NotNowError(MocapellaError):
    """A command that cannot be used in the present state; names the states that allow it."""


def one_of(value: str, choices: Iterable[str]) -> str:
    """Return ``'kinect_v2, kinect_v1 (did you mean kinect_v2?)'``: the valid values, for an error's message.

    Args:
        value: the invalid value; the question is left out if no choice resembles it.
        choices: the valid values, listed in their order; the text is empty if there are none.
    """
    names = list(choices)
    near = _nearest(value, names)
    return ", ".join(names) + (f" (did you mean {' or '.join(near)}?)" if near else "")


def _nearest(value: str, names: list[str]) -> list[str]:
    """Return the names that a value may stand for, never one of the other side: ``KneeLeft`` is ``LKnee``.

    Of a value without a side, a name with a side is returned beside its mirror name.
    """
    words = {name: _words(name) for name in names}
    own = _words(value)
    if own and (equal := [name for name in names if words[name] == own]):
        return equal[:1]
    side = own & _SIDES
    able = [name for name in names if not side or not words[name] & _SIDES or words[name] & _SIDES == side]
    close = difflib.get_close_matches(value, able, n=1)
    if not close or side:
        return close
    rest = words[close[0]] - _SIDES
    if not rest:
        return close
    both = [name for name in names if words[name] & _SIDES and words[name] - _SIDES == rest]
    return both if close[0] in both else close


_SIDES: Final = frozenset({"left", "right"})
_SHORT: Final = {"l": "left", "r": "right"}
_WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def _words(name: str) -> frozenset[str]:
    """Return the words of a joint's or angle's name in lower case, without their order; ``l`` and ``r`` are sides."""
    found = (word.lower() for word in _WORD.findall(name))
    return frozenset(_SHORT.get(word, word) for word in found)


def _shorten(text: str, limit: int = 60) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"
