"""Values around a session that users give."""

from __future__ import annotations

import pytest

from mocapella.errors import SettingsError
from mocapella.model.session import LONGEST_NAME, PersonName


@pytest.mark.parametrize("name", ["", "A", "Ada Lovelace", "Jörg", "x" * LONGEST_NAME])
def test_a_name_of_a_person_may_be_as_long_as_the_limit(name: str) -> None:
    assert PersonName(3, name).name == name


@pytest.mark.parametrize("name", ["x" * (LONGEST_NAME + 1), " Ada", "Ada ", " ", "Ada\n", "A\nB", "A\x1b[2J"])
def test_a_name_that_is_too_long_or_not_on_one_line_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=f"name is .*up to {LONGEST_NAME} characters on one line"):
        PersonName(3, name)


def test_a_refused_name_is_quoted_up_to_a_line() -> None:
    with pytest.raises(SettingsError) as caught:
        PersonName(3, "x" * 79 + "yz")
    assert "x" * 79 + "y" in str(caught.value)
    assert "z" not in str(caught.value).split(";")[0]


def test_the_number_of_a_person_has_64_bits() -> None:
    for number in (0, 2**64 - 1):
        assert PersonName(number, "").person == number
    for number in (-1, 2**64):
        with pytest.raises(SettingsError, match="person is"):
            PersonName(number, "")
