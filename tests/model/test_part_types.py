"""Numbers of parts, in words."""

from __future__ import annotations

import pytest

from mocapella.model.part_types import PART_TYPES, counted


@pytest.mark.parametrize("name", PART_TYPES)
def test_a_part_type_is_counted_with_its_noun_and_one_without_a_noun_with_its_name(name: str) -> None:
    one, many = PART_TYPES[name].counted or (name, name)
    assert [counted(count, name) for count in (0, 1, 2)] == [f"0 {many}", f"1 {one}", f"2 {many}"]


def test_a_type_that_nobody_registered_is_counted_with_its_name() -> None:
    assert "of another version" not in PART_TYPES
    assert counted(1, "of another version") == "1 of another version"


def test_one_is_a_person_and_two_are_people() -> None:
    assert (counted(1, "people"), counted(2, "people")) == ("1 person", "2 people")
