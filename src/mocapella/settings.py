"""Convert mappings of files and messages to frozen settings values, once, on input.

A settings value is a frozen dataclass whose ``__post_init__`` checks its ranges. An unknown key is an error with a
suggestion, because a misspelt setting that is silently ignored costs a study.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError, SettingsError, one_of

T = TypeVar("T")
_NUMBER = re.compile(r"-?(NaN|Infinity|(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d+)?)")


def parse(kind: type[T], data: Mapping[str, Any], *, where: str = "settings") -> T:
    """Convert a mapping to a settings value.

    Args:
        kind: the value's class, a dataclass; keys that are left out take its defaults.
        data: values by field name; nested mappings become nested settings. Types must fit: a text is no number.
        where: the mapping's name in errors.

    Raises:
        SettingsError: an unknown key at any depth (with a suggestion), a missing key or a wrong type, with ``where``
            in the text; or a value out of range, with the text of the class's own check.
    """
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for key in data:
        if key not in names:
            raise SettingsError(f"{where}: unknown key {key!r}; known: {one_of(str(key), names)}")
    try:
        value = msgspec.convert(data, kind, strict=True)
    except (msgspec.ValidationError, OverflowError, RecursionError) as error:
        raise SettingsError(f"{where}: {error}") from error
    _refuse_ignored(data, dataclasses.asdict(value), where)  # type: ignore[call-overload]
    return value


def check(condition: bool, name: str, value: object, wanted: str) -> None:
    """Check one setting, in the ``__post_init__`` of a settings class.

    Args:
        condition: whether the value is valid.
        name: name of the setting.
        value: its value.
        wanted: the valid values in words, such as ``above 0``.

    Raises:
        SettingsError: ``condition`` is False; the text is "name is value; it must be wanted".
    """
    if not condition:
        raise SettingsError(f"{name} is {value!r}; it must be {wanted}")


def _refuse_ignored(given: Any, taken: Any, where: str) -> None:
    """Refuse a key, at any depth, that is not part of the value."""
    if isinstance(given, Mapping) and isinstance(taken, Mapping):
        for key, inner in given.items():
            if key not in taken:
                raise SettingsError(f"{where}: unknown key {key!r}; known: {one_of(str(key), map(str, taken))}")
            _refuse_ignored(inner, taken[key], f"{where}: {key}")
    elif isinstance(given, list | tuple) and isinstance(taken, list | tuple):
        for inner, value in zip(given, taken, strict=True):
            _refuse_ignored(inner, value, where)


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return two mappings merged recursively, such as the settings of a file and of the command line.

    Where a key is in both, two mappings are merged, and otherwise the value of ``other`` is taken. Neither is changed.
    """
    out = dict(one)
    for key, value in other.items():
        mine = out.get(key)
        out[key] = merged(mine, value) if isinstance(mine, Mapping) and isinstance(value, Mapping) else value
    return out


def settings_of_pairs(pairs: Sequence[str] | None) -> dict[str, Any]:
    """Convert ``["frames=60", "people.smoothing=kalman"]`` to ``{"frames": 60, "people": {"smoothing": "kalman"}}``.

    A value is decoded as JSON, or is a text if it is no JSON. Of equal names, the last counts. Names and ranges are not
    checked here but by `parse`. None or no pairs give an empty mapping.

    Raises:
        SettingsError: a pair is not of the form NAME=VALUE, has a number that a take cannot store, or sets a name that
            is also the group of another setting, such as ``people=1`` beside ``people.smoothing=kalman``.
    """
    found: dict[str, Any] = {}
    grouped: set[str] = set()
    for pair in pairs or []:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise SettingsError(f"setting {pair!r} cannot be used; write it as NAME=VALUE, such as frames=60")
        *groups, last = name.split(".")
        where = found
        for group in groups:
            where = where.setdefault(group, {})
            if not isinstance(where, dict):
                raise SettingsError(
                    f"setting {pair!r} cannot be used: {group} has a value already; leave one of them out"
                )
        if name in grouped:
            raise SettingsError(
                f"setting {pair!r} cannot be used: a setting of {name} has a value already; leave one of them out"
            )
        grouped.update(".".join(groups[: k + 1]) for k in range(len(groups)))
        where[last] = _of_text(text)
    return found


def _of_text(text: str) -> Any:
    """Return a setting's value: JSON, or else the text itself."""
    try:
        return decode_json(text)
    except InputError:
        if not _NUMBER.fullmatch(text):
            return text
    raise SettingsError(f"setting: {text[:40]} cannot be stored in a take; leave the setting out if it has no limit")
