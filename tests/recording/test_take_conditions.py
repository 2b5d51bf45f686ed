"""When sensors of a take had problems."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from mocapella.conventions import NS_PER_S
from mocapella.recording.take_conditions import LONGEST_GAP_S, condition_intervals

PROBLEMS = ("it was moved: walk", "its clock jumped back")


def status(at_s: float, reason: str, *names: str, people: object = ()) -> tuple[int, dict[str, Any]]:
    return round(at_s * NS_PER_S), {
        "reason": reason,
        "sensors": [{"name": name} for name in names or ("front", "side")],
        "people_conditions": people,
    }


def rows(statuses: Sequence[tuple[int, dict[str, Any]]], began_ns: int = 0) -> list[tuple[str, str, float, float]]:
    found = condition_intervals(statuses, began_ns)
    return [(one.sensor, one.condition, one.from_s, one.to_s) for one in found]


def test_a_moved_sensor_has_an_interval_and_what_lasts_ends_with_the_take() -> None:
    moved, late = "side: it was moved: walk", "front: its clock jumped back"
    statuses = [
        status(10, "walk for 3 s"),
        status(11, moved),
        status(12, f"{moved}; {late}"),
        status(13, late),
        status(14, late),
    ]
    assert rows(statuses, 10 * NS_PER_S) == [
        ("side", "it was moved: walk", 1.0, 3.0),
        ("front", "its clock jumped back", 2.0, 4.0),
    ]


def test_a_person_has_an_interval_too() -> None:
    knee = [{"person": 2, "condition": "left knee: sensors and body model disagree by 50°"}]
    statuses = [status(0, ""), status(1, "side: lost", people=knee), status(3, "side: lost", people=[])]
    assert rows(statuses) == [
        ("", "person 2: left knee: sensors and body model disagree by 50°", 1.0, 3.0),
        ("side", "lost", 1.0, 3.0),
    ]


def test_a_pair_is_one_problem_whoever_the_other_is() -> None:
    statuses = [status(0, "side: with front: walk"), status(1, "side: with left: walk"), status(2, "")]
    assert rows(statuses) == [("side", "walk", 0.0, 2.0)]


def test_an_interruption_and_a_clock_that_begins_anew_end_an_interval() -> None:
    statuses = [status(at, "side: lost") for at in (0, LONGEST_GAP_S, 2 * LONGEST_GAP_S + 1, 3)]
    assert rows(statuses) == [
        ("side", "lost", 0.0, LONGEST_GAP_S),
        ("side", "lost", 3.0, 3.0),
        ("side", "lost", 2 * LONGEST_GAP_S + 1, 2 * LONGEST_GAP_S + 1),
    ]


def test_what_is_no_status_of_ours_has_no_problems() -> None:
    others = [
        {"reason": None, "sensors": ["front"]},
        {"sensors": 5, "people_conditions": {"person": 1}},
        {"sensors": {}},
    ]
    assert rows([*enumerate([{}, *others]), status(0, "front", "front", people=["knee"])]) == []


@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), max_size=12))
def test_every_second_is_in_an_interval_or_not_as_its_status_says(table: list[list[bool]]) -> None:
    keys = [(name, problem) for name in ("front", "side") for problem in PROBLEMS]
    reasons = ["; ".join(f"{n}: {p}" for (n, p), there in zip(keys, row, strict=True) if there) for row in table]
    found = rows([status(at, reason) for at, reason in enumerate(reasons)])
    for at, row in enumerate(table):
        last = at == len(table) - 1
        covered = [any((n, p) == key and a <= at and (at < b or last) for n, p, a, b in found) for key in keys]
        assert covered == row or (last and all(c >= r for c, r in zip(covered, row, strict=True)))
