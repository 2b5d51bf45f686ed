"""Former names of commands and options, with the present ones.

A command line that uses a former name ends with exit status 2 and one line that quotes the present name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

COMMANDS: Final[Mapping[str, str]] = {
    "align": "calibrate space",
    "arm": "track arm",
    "board": "calibrate board",
    "calibrate": "calibrate cameras",
    "colours": "calibrate colours",
    "depth": "lab depth",
    "evaluate": "lab evaluate",
    "hand": "calibrate hand",
    "hand measure": "calibrate hand",
    "silhouettes": "track silhouettes",
    "train": "lab train",
    "triangulate": "track points",
    "tune": "lab tune",
}
"""The present path of each command or group, by former path."""
CALIBRATIONS: Final = frozenset({"board", "cameras", "colours", "hand", "space"})
"""Verbs of the group `calibrate`, whose name was a command's."""

OPTIONS: Final[Mapping[str, Mapping[str, str]]] = {}
"""What to write for each former option, by present command and option; ``{}`` stands for the option's value."""


def moved(arguments: Sequence[str]) -> str:
    """Explain what a command line must say instead; empty if it uses no former name.

    Args:
        arguments: the command line after the program's name.
    """
    path, rest = _former_path(arguments)
    now = COMMANDS.get(path, "")
    notes = [f"`mocapella {path}` is now `mocapella {now}`"] if now else []
    if not now:
        now, rest = _present_path(arguments)
    notes += _moved_options(OPTIONS.get(now, {}), rest)
    return "; ".join(notes)


def _former_path(arguments: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the longest former path that the command line begins with (empty if none), and the rest."""
    for length in (2, 1):
        path, rest = " ".join(arguments[:length]), arguments[length:]
        if path not in COMMANDS or len(arguments) < length:
            continue
        if path == "calibrate" and (not rest or rest[0] in CALIBRATIONS or rest[0] == "--help"):
            continue
        return path, rest
    return "", arguments


def _present_path(arguments: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the longest path in `OPTIONS` that the command line begins with (empty if none), and the rest."""
    for length in (3, 2, 1):
        path = " ".join(arguments[:length])
        if path in OPTIONS:
            return path, arguments[length:]
    return "", ()


def _moved_options(table: Mapping[str, str], words: Sequence[str]) -> list[str]:
    notes = []
    for k, word in enumerate(words):
        if word == "--":
            break
        option, equals, value = word.partition("=")
        if option not in table:
            continue
        now = table[option]
        if "{}" not in now:
            notes.append(f"`{option}` is now `{now}`")
            continue
        value = value if equals else "".join(words[k + 1 : k + 2])
        notes.append(f"`{option} {value}` is now `{now.format(value)}`")
    return notes
