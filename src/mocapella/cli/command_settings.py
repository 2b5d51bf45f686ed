"""Rarely used options of a command: keys of a settings file (``--settings FILE``) or of ``--set KEY=VALUE``.

A command declares its keys as a frozen dataclass whose fields are annotated with `KeySpec`. `read_settings` parses the
file and the pairs into that dataclass once; keys of the tracking method or detector pass through.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import typer

from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import SettingsError, one_of
from mocapella.settings import merged, settings_of_pairs

K = TypeVar("K")

SET_HELP: Final = "Change a setting; `--set help` lists the keys. Repeatable; overrides --settings."
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="Read settings from a TOML file, keys as of --set.")
]


@dataclasses.dataclass(frozen=True)
class KeySpec:
    """Annotation of a settings field.

    Attributes:
        meaning: description for `--set help`, a sentence.
        unit: unit of a number, or form of a text, such as ``NAME=MS``.
        least, most: smallest and largest value; None for no limit.
        above: exclusive lower limit; None for none.
        choices: the valid values of a text, if there are few.
    """

    meaning: str
    unit: str = ""
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    above: float | None = None


@dataclasses.dataclass(frozen=True)
class NoKeys:
    """A command without settings of its own."""


@dataclasses.dataclass(frozen=True)
class KeyRow:
    """A line of `--set help`.

    Attributes:
        name: name of the key.
        unit: unit or form of the value, or the choices with ``|`` between them.
        default: default as text; empty for none.
        meaning: description.
    """

    name: str
    unit: str
    default: str
    meaning: str


@dataclasses.dataclass(frozen=True)
class _Field:
    name: str
    type: Any
    key: KeySpec
    default: Any

    @property
    def wanted(self) -> str:
        """What a value may be, in words."""
        if self.key.choices:
            return f"one of {', '.join(self.key.choices)}"
        kind = {bool: "true or false", int: "a whole number", float: "a number"}.get(self.type, "text")
        unit = f" [{self.key.unit}]" if self.key.unit else ""
        limits = (("above", self.key.above), ("at least", self.key.least), ("at most", self.key.most))
        return kind + unit + "".join(f", {words} {limit:g}" for words, limit in limits if limit is not None)


def _fields(kind: type) -> dict[str, _Field]:
    hints = typing.get_type_hints(kind, include_extras=True)
    found = {}
    for field in dataclasses.fields(kind):
        hint, key = typing.get_args(hints[field.name])[:2]
        if isinstance(hint, types.UnionType):
            (hint,) = (one for one in hint.__args__ if one is not types.NoneType)
        found[field.name] = _Field(field.name, hint, key, field.default)
    return found


def set_option(kind: type, more: Callable[[typer.Context], Iterator[str]] | None = None, detail: str = "") -> Any:
    """Return the typer option ``--set`` of a command; ``--set help`` prints the keys and exits.

    Args:
        kind: dataclass of the command's keys.
        more: yields further lines of ``--set help``, such as the keys of the tracking method.
        detail: end of the option's help.
    """

    def list_keys(context: typer.Context, value: list[str] | None) -> list[str] | None:
        if value and "help" in value:
            for line in _lines(rows_of_keys(kind)):
                typer.echo(line)
            for line in more(context) if more is not None else ():
                typer.echo(line)
            raise typer.Exit
        return value

    return typer.Option("--set", metavar="KEY=VALUE", help=f"{SET_HELP} {detail}".rstrip(), callback=list_keys)


def rows_of_keys(kind: type) -> list[KeyRow]:
    """Return the keys of a command, as `--set help` prints them."""
    return [
        KeyRow(name, "|".join(one.key.choices) or one.key.unit, _default(one.default), one.key.meaning)
        for name, one in _fields(kind).items()
    ]


def _default(value: object) -> str:
    text = "" if value is None or value == () else str(value).lower() if isinstance(value, bool) else str(value)
    return text if len(text) <= 32 else text[:31] + "…"


def _lines(rows: Sequence[KeyRow]) -> Iterator[str]:
    if not rows:
        return
    table = [("KEY", "UNIT", "DEFAULT", "MEANING"), *(dataclasses.astuple(row) for row in rows)]
    widths = [max(len(row[k]) for row in table) for k in range(3)]
    for row in table:
        yield "  ".join([*(f"{cell:<{width}}" for cell, width in zip(row[:3], widths, strict=True)), row[3]]).rstrip()


def lines_of_dataclass(kind: type, title: str, prefix: str = "") -> Iterator[str]:
    """Yield a title and the fields of a settings dataclass as lines of `--set help`.

    Args:
        kind: the dataclass, see `rows_of_dataclass`.
        title: line above the table.
        prefix: put before each key, such as ``gestures.``.
    """
    yield ""
    yield title
    yield from _lines(rows_of_dataclass(kind, prefix))


def rows_of_dataclass(kind: type, prefix: str = "") -> list[KeyRow]:
    """Return the fields of a settings dataclass as rows of `--set help`, nested dataclasses with dotted keys.

    The meaning is the field's description in the docstring of the class, or of a base class; a unit in brackets at its
    end becomes the row's unit. Each field needs a description of its own: ``a, b: …`` describes none.

    Args:
        kind: the dataclass.
        prefix: put before each key.
    """
    return list(_rows_of(kind, None, prefix))


def _rows_of(kind: type, of: Any, prefix: str) -> Iterator[KeyRow]:
    """Yield the rows of a dataclass; ``of`` is its value where it is the default of another one's field."""
    meanings = _attributes(kind)
    for field in dataclasses.fields(kind):
        default = _default_of(field) if of is None else getattr(of, field.name)
        name = prefix + field.name
        if dataclasses.is_dataclass(default):
            yield from _rows_of(type(default), default, f"{name}.")
        else:
            shown = "" if default is dataclasses.MISSING else _default(default)
            meaning = meanings.get(field.name, "")
            unit = re.search(r" ?\[([^\]]+)\](?=\W*$)", meaning)
            if unit is not None:
                meaning = meaning[: unit.start()] + meaning[unit.end() :]
            yield KeyRow(name, "" if unit is None else unit[1], shown, meaning)


def _default_of(field: dataclasses.Field[Any]) -> Any:
    """Return a field's default; ``MISSING`` if it has none."""
    factory = field.default_factory
    return field.default if isinstance(factory, dataclasses._MISSING_TYPE) else factory()


def _attributes(kind: type) -> dict[str, str]:
    """Return each attribute's description in the docstrings of a class and its bases, by name."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        _, _, text = inspect.cleandoc(one.__doc__ or "").partition("Attributes:\n")
        entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8,}.*)*)", text, flags=re.MULTILINE)
        found |= {name: " ".join(words.split()) for name, words in entries}
    return found


def read_settings(
    kind: type[K], file: Path | None, pairs: Sequence[str] | None, others: Sequence[str] = ()
) -> tuple[K, dict[str, Any]]:
    """Parse a settings file and ``--set`` pairs; a pair overrides the file.

    Args:
        kind: dataclass of the command's own keys.
        file: TOML, or None.
        pairs: ``KEY=VALUE`` each.
        others: known names of the remaining settings, such as a tracking method's; unknown ones pass, too.

    Returns:
        The command's settings, and the remaining ones by name.

    Raises:
        InputError: the file cannot be read, or is no TOML.
        SettingsError: a value out of range or of another type, a key given twice, or an unknown key that resembles one
            of the command.
    """
    fields = _fields(kind)
    given: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    for name, value in _read_toml(file).items():
        if name in fields:
            given[name] = _of_file(fields[name], value)
        else:
            rest[name] = value
    texts: dict[str, list[str]] = {}
    for pair in pairs or ():
        name, equals, text = pair.partition("=")
        if equals and name in fields:
            texts.setdefault(name, []).append(text)
    given |= {name: _of_texts(fields[name], values) for name, values in texts.items()}
    remaining = [pair for pair in pairs or () if pair.partition("=")[0] not in fields or "=" not in pair]
    rest = merged(rest, settings_of_pairs(remaining))
    for name in rest:
        if name not in others and difflib.get_close_matches(name, [*fields, *others], n=1, cutoff=0.7)[:1]:
            (close,) = difflib.get_close_matches(name, [*fields, *others], n=1, cutoff=0.7)
            if close in fields:
                raise SettingsError(f"unknown setting {name!r}; did you mean {close}? `--set help` lists the keys")
    return kind(**given), rest


def read_keys(kind: type[K], file: Path | None, pairs: Sequence[str] | None) -> K:
    """Parse a settings file and ``--set`` pairs of a command that has no other keys than its own.

    Args:
        kind: dataclass of the command's keys.
        file: TOML, or None.
        pairs: ``KEY=VALUE`` each; they override the file.

    Raises:
        InputError, SettingsError: as in `read_settings`; also for every unknown key.
    """
    settings, rest = read_settings(kind, file, pairs)
    for name in rest:
        known = one_of(name, _fields(kind))
        raise SettingsError(f"unknown setting {name!r}; known: {known}; `--set help` explains them")
    return settings


def _read_toml(file: Path | None) -> Mapping[str, Any]:
    if file is None:
        return {}
    data = read_whole(file, fix="name a TOML file of settings")
    return decode_toml(data, file=file, fix="write lines such as reserve_gib = 2.0")


def _of_texts(field: _Field, texts: Sequence[str]) -> Any:
    if typing.get_origin(field.type) is tuple:
        return tuple(texts)
    if len(texts) > 1:
        raise SettingsError(f"setting {field.name} is given twice: {texts[0]} and {texts[1]}")
    text = texts[0]
    try:
        value: Any = {"true": True, "false": False}[text.lower()] if field.type is bool else field.type(text)
    except (ValueError, KeyError):
        raise SettingsError(f"setting {field.name} is {text!r}; it must be {field.wanted}") from None
    return _checked(field, value)


def _of_file(field: _Field, value: Any) -> Any:
    if typing.get_origin(field.type) is tuple:
        texts = value if isinstance(value, list) else [value]
        return tuple(str(_checked_type(field, one, str)) for one in texts)
    kind = str if field.type is Path else field.type
    if kind is float and type(value) is int:
        value = float(value)
    return _checked(field, field.type(_checked_type(field, value, kind)))


def _checked_type(field: _Field, value: Any, kind: type) -> Any:
    if type(value) is not kind:
        raise SettingsError(f"setting {field.name} is {value!r}; it must be {field.wanted}")
    return value


def _checked(field: _Field, value: Any) -> Any:
    key = field.key
    known = not key.choices or value in key.choices
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = -math.inf if key.least is None else key.least, math.inf if key.most is None else key.most
        known = math.isfinite(value) and low <= value <= high and (key.above is None or value > key.above)
    if not known:
        hint = f"one of {one_of(value, key.choices)}" if key.choices else field.wanted
        raise SettingsError(f"setting {field.name} is {value!r}; it must be {hint}")
    return value
