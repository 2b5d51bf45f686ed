"""The limits that an error of a setting names are the limits: each end is valid or not, as the words say."""

from __future__ import annotations

import dataclasses
import importlib
import math
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import mocapella
from mocapella.errors import SettingsError

ROOT = Path(mocapella.__file__).parent
FAR = 1e12
NUMBER = r"(-?\d{1,3}(?:,\d{3})+|-?\d+(?:\.\d+)?(?:e\d+)?)"
RELATIVE = re.compile(r"\w_\w|times|samples|keep|either")
"""In words of a limit that depends on another setting."""
ROUNDED = 1e-5
"""Messages show six digits of a limit."""


class Limit(NamedTuple):
    """A limit that a message names: its value, whether it is the lower one, and whether it is itself valid."""

    value: float
    lower: bool
    valid: bool


WORDS = (
    (rf"above {NUMBER}", True, False),
    (rf"{NUMBER}\D{{0,6}} or more", True, True),
    (rf"(?:from |^){NUMBER}\D{{0,6}} (?:up )?to ", True, True),
    (rf"below {NUMBER}", False, False),
    (rf"(?:at most|up to|(?<!up )to) {NUMBER}", False, True),
)


def limits_of(wanted: str) -> Iterator[Limit]:
    """The limits that words such as ``from 0 to below 1 s`` name; none of words that name another setting."""
    for pattern, lower, valid in WORDS:
        for found in re.finditer(pattern, "" if RELATIVE.search(wanted) else wanted):
            yield Limit(float(found[1].replace(",", "")), lower, valid)


@pytest.mark.parametrize(
    ("wanted", "limits"),
    [
        ("above 0 px", [Limit(0, True, False)]),
        ("1 or more", [Limit(1, True, True)]),
        ("0 m/s or more", [Limit(0, True, True)]),
        ("from 0.5 to below 1", [Limit(0.5, True, True), Limit(1, False, False)]),
        ("1 to 1000", [Limit(1, True, True), Limit(1000, False, True)]),
        ("above 0, at most 1 m", [Limit(0, True, False), Limit(1, False, True)]),
        ("from 10 to 100,000 px", [Limit(10, True, True), Limit(100000, False, True)]),
        ("from 0 to 1e9 Hz", [Limit(0, True, True), Limit(1e9, False, True)]),
        ("one of ray and sum", []),
        ("from 2 to 200 times mesh_m", []),
    ],
)
def test_limits_are_read_from_words(wanted: str, limits: list[Limit]) -> None:
    assert list(limits_of(wanted)) == limits


def settings_classes() -> Iterator[type]:
    """The dataclasses of the package whose ``__post_init__`` checks settings, and that have defaults for all."""
    for path in sorted(ROOT.rglob("*.py")):
        if "    check(" in path.read_text(encoding="utf-8") or "        check(" in path.read_text(encoding="utf-8"):
            name = ".".join(("mocapella", *path.relative_to(ROOT).with_suffix("").parts))
            module = importlib.import_module(name)
            for kind in vars(module).values():
                if isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind.__module__ == name:
                    yield kind


def outcome(kind: type, name: str, value: float) -> str | None:
    """What is wanted of a setting that is refused; None if the value is accepted or another one is refused for it."""
    try:
        kind(**{name: value})
    except SettingsError as error:
        found = re.match(rf"{name} is .*?; it must be (.*)", str(error), re.DOTALL)
        return found[1] if found else None
    return None


def numbers() -> Iterator[tuple[type, str, type]]:
    """Each numeric field of each settings class that can be made without arguments."""
    for kind in settings_classes():
        try:
            kind()
        except TypeError:  # a field has no default
            continue
        hints: dict[str, Any] = typing.get_type_hints(kind)
        for field in dataclasses.fields(kind):
            hint = hints[field.name]
            parts = {hint} | (set(typing.get_args(hint)) if isinstance(hint, types.UnionType) else set())
            if parts & {int, float} and field.init:
                yield kind, field.name, int if int in parts else float


def beside(limit: Limit, of: type) -> tuple[float, float]:
    """A valid value at a limit, and one that is not."""
    inwards = math.inf if limit.lower else -math.inf
    if of is int:
        step = 1 if limit.lower else -1
        at = int(limit.value)
        return (at, at - step) if limit.valid else (at + step, at)
    at = limit.value
    if limit.valid:
        return at, at - math.copysign(max(abs(at), 1.0) * ROUNDED, inwards)
    return math.nextafter(at, inwards), at


def test_each_limit_that_an_error_names_is_the_limit() -> None:
    wrong, checked = [], 0
    for kind, name, of in numbers():
        for far in (-FAR, FAR):
            wanted = outcome(kind, name, of(far))
            for limit in limits_of(wanted or ""):
                if limit.lower != (far < 0):
                    continue
                checked += 1
                last, first = beside(limit, of)
                if outcome(kind, name, last) == wanted:
                    wrong.append(f"{kind.__name__}.{name} = {last!r} is refused, but {wanted} is wanted")
                if outcome(kind, name, first) is None:
                    wrong.append(f"{kind.__name__}.{name} = {first!r} is accepted, but {wanted} is wanted")
    assert not wrong, "\n".join(wrong)
    assert checked > 100
