"""Mappings become settings once, at the door, and a misspelt key is never ignored."""

from __future__ import annotations

import dataclasses
import importlib
import re
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pytest

import mocapella.cli
from mocapella.cli.command_settings import KeyRow, KeySpec, rows_of_dataclass, rows_of_keys
from mocapella.detectors import DETECTORS
from mocapella.errors import SettingsError
from mocapella.kinematics.gestures import GestureSettings
from mocapella.settings import check, parse
from mocapella.tracker import METHODS


@dataclass(frozen=True)
class Inner:
    height: float = 0.0


@dataclass(frozen=True)
class Filter:
    cutoff_hz: float = 1.0
    window: int = 5
    inner: Inner = field(default_factory=Inner)
    by_name: dict[str, Inner] = field(default_factory=dict)
    in_order: tuple[Inner, ...] = ()

    def __post_init__(self) -> None:
        check(self.cutoff_hz > 0, "cutoff_hz", self.cutoff_hz, "above 0 Hz")


def test_what_is_given_is_taken_and_the_rest_keeps_its_default() -> None:
    assert parse(Filter, {"cutoff_hz": 2, "inner": {"height": 1.5}}) == Filter(2.0, 5, Inner(1.5))
    assert parse(Filter, {}) == Filter()


def test_an_unknown_key_is_refused_with_a_suggestion() -> None:
    with pytest.raises(
        SettingsError, match=r"take\.toml: unknown key 'cutof_hz'; known: .* \(did you mean cutoff_hz\?\)"
    ):
        parse(Filter, {"cutof_hz": 2}, where="take.toml")


@pytest.mark.parametrize("value", ["2", None, [1]])
def test_a_wrong_type_is_refused(value: object) -> None:
    with pytest.raises(SettingsError, match=r"settings: Expected `float`, got .* at `\$\.cutoff_hz`"):
        parse(Filter, {"cutoff_hz": value})


def test_a_fraction_is_no_count() -> None:
    with pytest.raises(SettingsError, match="Expected `int`, got `float`"):
        parse(Filter, {"window": 2.5})


def test_a_range_is_checked_whoever_makes_the_value() -> None:
    message = r"cutoff_hz is 0(\.0)?; it must be above 0 Hz"
    with pytest.raises(SettingsError, match=message):
        Filter(cutoff_hz=0)
    with pytest.raises(SettingsError, match=message):
        parse(Filter, {"cutoff_hz": 0})


@pytest.mark.parametrize(
    "data",
    [
        {"inner": {"hieght": 1}},
        {"by_name": {"left": {"hieght": 1}}},
        {"in_order": [{}, {"hieght": 1}]},
    ],
)
def test_an_unknown_key_is_refused_at_any_depth(data: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=r"unknown key 'hieght'; known: height \(did you mean height\?\)"):
        parse(Filter, data)


def test_any_name_may_be_a_key_where_names_are_keys() -> None:
    assert parse(Filter, {"by_name": {"whoever": {"height": 2}}}).by_name == {"whoever": Inner(2.0)}


def parts(hint: Any) -> set[Any]:
    """The innermost parts of an annotation: of ``tuple[int, float] | None``, int, float and None's type."""
    inner = typing.get_args(hint)
    return set().union(*map(parts, inner)) if inner else {hint}


def number_keys(kind: type, prefix: str = "") -> set[str]:
    """The dotted names of the fields that hold numbers, also within tuples and nested dataclasses."""
    found = set()
    for name, hint in typing.get_type_hints(kind).items():
        for part in parts(hint):
            if part in (int, float) or type(part) in (int, float):  # the second is of a Literal
                found.add(prefix + name)
            elif dataclasses.is_dataclass(part):
                found |= number_keys(typing.cast(type, part), f"{prefix}{name}.")
    return found


def undescribed(rows: list[KeyRow], numbers: set[str]) -> list[str]:
    """The keys that `--set help` does not explain: without a meaning, or numbers without a unit."""
    return [row.name for row in rows if not row.meaning or (row.name in numbers and not row.unit)]


def test_help_explains_every_setting_of_methods_and_detectors() -> None:
    kinds: dict[str, type] = {name: method.settings for name, method in METHODS.items()}
    kinds |= {name: detector.settings() for name, detector in DETECTORS.items()} | {"gestures": GestureSettings}
    assert len(kinds) >= 8
    gaps = {name: undescribed(rows_of_dataclass(kind), number_keys(kind)) for name, kind in kinds.items()}
    assert gaps == {name: [] for name in kinds}


def test_help_explains_every_setting_of_commands() -> None:
    gaps = {}
    for file in sorted(Path(mocapella.cli.__file__).parent.glob("*.py")):
        for name in re.findall(r"set_option\(\s*(\w+)\s*[,)]", file.read_text(encoding="utf-8")):
            kind = getattr(importlib.import_module(f"mocapella.cli.{file.stem}"), name)
            gaps[name] = undescribed(rows_of_keys(kind), number_keys(kind))
    assert len(gaps) >= 10
    assert gaps == {name: [] for name in gaps}


@dataclass(frozen=True)
class Described:
    """A base class.

    Attributes:
        gain: factor of the error [ratio].
    """

    gain: float = 0.0


@dataclass(frozen=True)
class Settings(Described):
    """Settings with and without descriptions.

    Attributes:
        cutoff_hz: cutoff at rest; larger: less lag
            [Hz].
        window: number of frames.
        sizes: sizes of the masks.
        low, high: thresholds [px].
        name: name of the filter.
    """

    cutoff_hz: float = 1.0
    window: int = 5
    sizes: tuple[int, ...] | None = None
    odd: typing.Literal[1, 3] = 1
    low: float = 0.0
    high: float = 1.0
    name: str = ""
    inner: Described = field(default_factory=lambda: Described(2.5))


def test_a_setting_that_help_does_not_explain_is_found() -> None:
    rows = rows_of_dataclass(Settings)
    # Without a unit; without a description; described together with another one.
    assert undescribed(rows, number_keys(Settings)) == ["window", "sizes", "odd", "low", "high"]


def test_help_has_what_base_classes_describe_and_the_defaults_of_the_outer_class() -> None:
    rows = {row.name: row for row in rows_of_dataclass(Settings, "of.")}
    assert rows["of.gain"] == KeyRow("of.gain", "ratio", "0.0", "factor of the error.")
    assert rows["of.inner.gain"].default == "2.5"
    assert rows["of.cutoff_hz"] == KeyRow("of.cutoff_hz", "Hz", "1.0", "cutoff at rest; larger: less lag.")


@dataclass(frozen=True)
class CommandKeys:
    every: Annotated[float | None, KeySpec("Interval.")] = None
    report: Annotated[float, KeySpec("", "s")] = 1.0
    loop: Annotated[bool, KeySpec("Restart.")] = False


def test_a_key_of_a_command_that_help_does_not_explain_is_found() -> None:
    assert undescribed(rows_of_keys(CommandKeys), number_keys(CommandKeys)) == ["every", "report"]
