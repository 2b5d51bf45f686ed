"""Mappings become settings once, at the door, and a misspelt key is never ignored."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from mocapella.errors import SettingsError
from mocapella.settings import check, parse


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
