"""The protocol of a study: its file and the plans that follow from it."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.study_protocols import protocols

from mocapella.errors import InputError, SettingsError
from mocapella.model.session import PLACEMENTS, SCENARIOS
from mocapella.studies.founding import STEPS_M, WALK_M
from mocapella.studies.protocol import (
    SHIPPED,
    PlannedTask,
    StudyProtocol,
    load_protocol,
    plan,
    protocol_bytes,
    protocol_from_toml,
    to_toml,
)

SMALL = """
title = "small"
participants = { count = 2 }
placements = [{ name = "parallel", number = 0 }]
[block]
width_m = 2
depth_m = 2
points = [{ name = "start", x_m = 0, y_m = 0 }]
[[tasks]]
name = "walk"
scenario = 3
steps = [{ text = "Walk.", seconds = 3, stand = ["start"] }]
"""


def key_of(planned: PlannedTask) -> tuple[str, str, int]:
    return planned.placement.name, planned.task.name, planned.repetition


@given(protocols())
def test_a_protocol_becomes_toml_and_an_equal_protocol_again(protocol: StudyProtocol) -> None:
    assert protocol_from_toml(to_toml(protocol)) == protocol


@given(protocols())
def test_all_participants_of_a_group_do_the_same_tasks(protocol: StudyProtocol) -> None:
    for group in protocol.participants.all:
        plans = [sorted(map(key_of, plan(protocol, code))) for code in group.codes]
        assert all(one == plans[0] for one in plans)
        wanted = [
            (placement.name, task.name, repetition + 1)
            for placement in protocol.placements
            for task in protocol.tasks
            for repetition in range(task.repetitions)
            if (not task.placements or placement.name in task.placements)
            and (not task.groups or group.name in task.groups)
        ]
        assert plans[0] == sorted(wanted)


@given(protocols())
def test_a_placement_is_not_left_before_its_tasks_are_done_and_repetitions_are_in_order(
    protocol: StudyProtocol,
) -> None:
    for code in protocol.codes:
        planned = plan(protocol, code)
        names = [one.placement.name for one in planned]
        assert len(dict.fromkeys(names)) == 1 + sum(a != b for a, b in pairwise(names)) or not names
        for before, after in pairwise(planned):
            same = (before.placement, before.task) == (after.placement, after.task)
            assert after.repetition == (before.repetition + 1 if same else 1)


@given(protocols())
def test_a_plan_depends_on_the_protocol_and_the_code_only(protocol: StudyProtocol) -> None:
    again = protocol_from_toml(to_toml(protocol))
    assert [plan(protocol, code) for code in protocol.codes] == [plan(again, code) for code in again.codes]


def test_another_seed_gives_another_random_order() -> None:
    founding = msgspec.structs.replace(load_protocol("kinectmultitrack"), task_order="random")
    orders = {
        tuple(one.task.name for one in plan(msgspec.structs.replace(founding, seed=seed), "P07")) for seed in range(20)
    }
    assert len(orders) > 10


def test_counterbalanced_placements_are_each_equally_often_at_each_place() -> None:
    founding = load_protocol("kinectmultitrack")
    group = founding.participants.groups[0].codes[:18]
    orders = [tuple(dict.fromkeys(one.placement.name for one in plan(founding, code))) for code in group]
    assert Counter(orders).most_common()[0][1] == 3
    for place in range(3):
        assert set(Counter(order[place] for order in orders).values()) == {6}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_protocol_is_read(name: str) -> None:
    assert protocol_from_toml(to_toml(load_protocol(name))) == load_protocol(name)


def test_the_founding_study_has_its_block_its_numbers_and_its_route() -> None:
    founding = load_protocol("kinectmultitrack")
    assert {task.name: task.scenario for task in founding.tasks} == SCENARIOS
    assert all(PLACEMENTS[placement.name] == placement.number for placement in founding.placements)
    assert founding.block is not None
    assert (founding.block.width_m, founding.block.depth_m, founding.block.start) == (1.925, 1.87, "start")
    for name, stops in (("steps", STEPS_M), ("walk", WALK_M)):
        points = {point.name: (point.x_m, point.y_m) for point in founding.block.points}
        task = next(task for task in founding.tasks if task.name == name)
        route = [task.steps[0].stand[0], *(step.foot[0] for step in task.steps)]
        assert len(route) == len(stops)  # as the participants went in 2015, which the simulation follows, too
        away = np.array([points[name] for name in route]) - points["start"] - np.array(stops)[:, :2]
        assert np.abs(away).max() < 0.35  # people cut the corners
    for task in founding.tasks:
        for before, after in pairwise(task.steps):
            moved = [foot or stand for foot, stand in zip([*before.foot, "", ""], before.stand, strict=False)]
            if "return" not in before.text:
                assert list(after.stand) == moved, task.name


def test_each_participant_of_the_founding_study_has_the_number_of_its_logs() -> None:
    founding = load_protocol("kinectmultitrack")
    assert founding.codes == tuple(f"P{number:02}" for number in range(23))
    assert {one.placement.number for one in plan(founding, "P20")} == {1}


def test_the_protocol_in_the_document_is_one() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "studies-protocol.md").read_text(encoding="utf-8")
    found = protocol_from_toml(text.split("```toml\n")[1].split("```")[0])
    assert len(plan(found, "P12")) == 3


def test_a_count_gives_codes() -> None:
    assert protocol_from_toml(SMALL).codes == ("P01", "P02")
    assert protocol_from_toml(SMALL.replace("count = 2", "count = 100")).codes[98:] == ("P099", "P100")


def test_an_unknown_participant_is_named_with_a_suggestion() -> None:
    with pytest.raises(SettingsError, match=r"no participant 'P1'; it has P01, P02 \(did you mean"):
        plan(protocol_from_toml(SMALL), "P1")


def test_comments_and_codes_do_not_change_the_checksum_and_texts_do() -> None:
    small = protocol_from_toml(SMALL)
    assert protocol_from_toml(SMALL + "# more\n").checksum == small.checksum
    assert protocol_from_toml(SMALL.replace("count = 2", 'codes = ["A-1", "B-2"]')).checksum == small.checksum
    assert protocol_from_toml(SMALL.replace("Walk.", "Go.")).checksum != small.checksum
    assert protocol_from_toml(SMALL.replace("count = 2", "count = 3")).checksum != small.checksum


BAD: list[tuple[str, str, str]] = [
    ("title =", "titel =", r"field titel: this key is unknown; known keys: title, .*did you mean title\?"),
    ("seconds = 3", "second = 3", r"field tasks\[0\]\.steps\[0\]\.second: this key is unknown; .*mean seconds\?"),
    ("seconds = 3", "seconds = -3", r"field tasks\[0\]\.steps\[0\]\.seconds: -3: is no study protocol: Expected"),
    ("seconds = 3", 'seconds = "3"', r"field tasks\[0\]\.steps\[0\]\.seconds: '3': is no study protocol: Expected"),
    ("scenario = 3", "", r"field tasks\[0\]: is no study protocol: Object missing required field `scenario`"),
    ('stand = ["start"]', 'stand = ["stat"]', r"steps\[0\]\.stand: 'stat': it is not in block\.points; known: start"),
    ('stand = ["start"]', 'foot = ["a"]', r"steps\[0\]\.foot: 'a': it is not in block\.points"),
    (
        '["start"]',
        '["start", "start"]',
        r"stand: \['start', 'start'\]: it names more points than people; name at most 1",
    ),
    ("scenario = 3", 'scenario = 3\nplacements = ["90"]', r"tasks\[0\]\.placements: '90': it is not in placements"),
    ("scenario = 3", 'scenario = 3\ngroups = ["b"]', r"tasks\[0\]\.groups: 'b': it is not in participants\.groups"),
    ("{ count = 2 }", '{ codes = ["anna"] }', r"participants\.codes\[0\]: 'anna': it has no digit.*a code has letters"),
    (
        "{ count = 2 }",
        '{ codes = ["P01", "Q01"] }',
        r"codes\[1\]: 'Q01': 'P01' has the same number in the study log, 1",
    ),
    ("{ count = 2 }", '{ codes = ["P9999999999"] }', r"codes\[0\]: .*too large a number"),
    ("{ count = 2 }", "{ count = 0 }", r"field participants: it must have one of count, codes and groups"),
    ("{ count = 2 }", '{ count = 2, codes = ["P01"] }', r"field participants: it must have one of"),
    (
        "number = 0 }",
        'number = 0 }, { name = "b", number = 0 }',
        r"placements\[1\]\.number: 0: placements\[0\] has the",
    ),
    ("number = 0 }", 'number = 0 }, { name = "PARALLEL", number = 1 }', r"placements\[1\]\.name: .* has the same name"),
    ('name = "walk"', 'name = "a/b"', r"field tasks\[0\]\.name: 'a/b': is no study protocol: Expected"),
    ('name = "walk"', 'name = "nul"', r"field tasks\[0\]\.name: 'nul': Windows has a device"),
    ('"Walk."', '"\\u001b[2J"', r"steps\[0\]\.text: .*cannot be shown"),
    ("depth_m = 2", 'depth_m = 2\nstart = "green"', r"block\.start: 'green': it is not in block\.points"),
    ("title =", "= ", r"is no TOML"),
]


@pytest.mark.parametrize(("old", "new", "says"), BAD)
def test_a_wrong_protocol_is_refused_by_file_field_value_and_remedy(old: str, new: str, says: str) -> None:
    assert old in SMALL
    with pytest.raises(InputError, match=rf"^study\.toml: .*{says}") as caught:
        protocol_from_toml(SMALL.replace(old, new, 1), file="study.toml")
    assert caught.value.fix


def test_a_protocol_that_is_not_there_is_refused_with_those_that_ship(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one that ships: kinectmultitrack"):
        load_protocol(tmp_path / "none.toml")
    assert b"title" in protocol_bytes("kinectmultitrack")


@given(
    st.recursive(
        st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
    )
)
def test_any_tables_are_a_protocol_or_our_error(data: Any) -> None:
    from mocapella.studies.file_values import of_tables

    with pytest.raises(InputError):
        of_tables(data, StudyProtocol, what="study protocol", file="a", fix="b")
