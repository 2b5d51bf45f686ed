"""One family of errors, so that a user's program can catch the house or a room of it.

MocapellaError                what we raise on purpose; the message says what would have worked
├── InputError                a file's content: names file, row, field, value and the fix
│   └── DamagedTakeError      a recording that ends early or has a bad part
├── SettingsError             a setting out of range, unknown, or of the wrong type
├── PluginError               a registered descriptor that cannot be used
├── WireError                 bytes that are not a message of ours
│   └── SchemaVersionError    a message of a schema version that this program does not speak
├── BusError                  the bus could not do it
│   ├── AddressInUseError     another program listens there
│   ├── NameTakenError        another node serves a sensor of this name
│   └── NoServerError         no server answers at that address
├── RecordingError            a take could not be started or went wrong
│   ├── TakeExistsError       the name is taken; nothing is ever overwritten
│   └── DiskFullError         less room than the reserve
├── CalibrationError          observations do not determine the cameras' poses or lenses
├── EvaluationError           a method's result cannot be scored
└── NotNowError               a command that cannot be used in the present state
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MocapellaError(Exception):
    """Base of everything raised on purpose. One line, and it says what to do."""


class InputError(MocapellaError):
    """A file that cannot be used.

    The message is one line of the parts that are known: ``file: row 12: field Head_X: 'abc': <problem>; <fix>``.
    Rows count from 1 and the header is row 1, as a text editor counts lines.
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
        super().__init__(": ".join([*parts, problem]) + (f"; {fix}" if fix else ""))


class DamagedTakeError(InputError):
    """A recording that ends early or has a part that cannot be read."""


class SettingsError(MocapellaError):
    """A setting that is unknown, of the wrong type, or out of range."""


class PluginError(MocapellaError):
    """A registered descriptor that cannot be used; names it, its package and the fault."""


class WireError(MocapellaError):
    """Bytes that are not a valid message; the text names the fault."""


class SchemaVersionError(WireError):
    """A message of a schema version that this program does not speak; names both versions."""


class BusError(MocapellaError):
    """The bus could not do what was asked."""


class AddressInUseError(BusError):
    """Another program already listens at the address that is named."""


class NameTakenError(BusError):
    """Another node already serves a sensor of this name."""


class NoServerError(BusError):
    """Nobody answers at the address that is named."""


class RecordingError(MocapellaError):
    """A take could not be started, or had to stop."""


class TakeExistsError(RecordingError):
    """The take's name is in use; nothing is ever overwritten."""


class DiskFullError(RecordingError):
    """There is less free space than the reserve."""


class CalibrationError(MocapellaError):
    """What was seen does not say where cameras are or how they see; the message says what to film."""


class EvaluationError(MocapellaError):
    """What a tracking method says cannot be scored; the message says what can."""


class NotNowError(MocapellaError):
    """A command that cannot be used in the present state; names the states that allow it."""


def one_of(value: str, choices: Iterable[str]) -> str:
    """``'kinect_v2, kinect_v1 (did you mean kinect_v2?)'``: what would have worked, for an error's message."""
    names = list(choices)
    close = difflib.get_close_matches(value, names, n=1)
    return ", ".join(names) + (f" (did you mean {close[0]}?)" if close else "")


def _shorten(text: str, limit: int = 60) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"
