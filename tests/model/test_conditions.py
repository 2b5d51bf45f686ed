"""A reason in few words: nothing is left out, nothing is said twice."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.conditions import conditions, trouble

SENSORS = ["front", "left", "right"]
WORDS = st.sampled_from(["walk a few steps", "its clock jumped back", "it was moved: walk where both see you"])


@given(st.dictionaries(st.sampled_from(SENSORS), WORDS), st.lists(WORDS.map(lambda words: f"a hand: {words}")))
def test_every_sensor_with_a_trouble_is_named_once_and_no_trouble_is_left_out(
    of: dict[str, str], others: list[str]
) -> None:
    reason = "; ".join([*(f"{name}: {words}" for name, words in of.items()), *others])
    said = conditions(reason, SENSORS)
    assert len(said) == len(set(of.values())) + len(set(others))
    for name, words in of.items():
        (line,) = (line for line in said if line.endswith(f": {words}") and not line.startswith("a hand"))
        assert name in line.split(": ", maxsplit=1)[0] or line.startswith("all sensors: ")
    assert set(others) <= set(said)


@pytest.mark.parametrize(
    ("reason", "said"),
    [
        ("", []),
        ("front: with left: walk; left: with front: walk", ["front, left: walk"]),
        ("front: with left: walk; left: with front: walk; right: with left: walk", ["all sensors: walk"]),
        ("left: silent", ["left: silent"]),
        ("asked for", ["asked for"]),
    ],
)
def test_sensors_with_one_trouble_are_named_together(reason: str, said: list[str]) -> None:
    assert conditions(reason, SENSORS) == said


def test_a_session_of_one_sensor_names_it() -> None:
    assert conditions("front: walk", ["front"]) == ["front: walk"]


def test_the_other_sensor_of_the_pair_is_left_out_and_nothing_else() -> None:
    assert trouble("with left: walk") == "walk"
    assert trouble("it was moved: walk") == "it was moved: walk"
    assert trouble("with care") == "with care"
