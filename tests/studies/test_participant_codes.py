"""Participants have codes, and what looks like a name is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.studies.participants import check_code, code_problem, number_of


@given(st.from_regex(r"[A-Za-z0-9-]{0,5}[0-9][A-Za-z0-9-]{0,5}", fullmatch=True))
def test_a_code_of_the_rule_is_accepted_unless_it_begins_or_ends_with_a_hyphen(code: str) -> None:
    device = code.lower().startswith(("com", "lpt")) and len(code) == 4
    bare = not any(letter.isalpha() for letter in code) or len(code) < 3
    assert bool(code_problem(code)) == (code.startswith("-") or code.endswith("-") or device or bare)


@given(st.text(max_size=14))
def test_a_code_has_ascii_letters_digits_and_hyphens_and_a_digit(text: str) -> None:
    if not code_problem(text):
        assert text.isascii()
        assert text.replace("-", "").isalnum()
        assert any(letter.isdigit() for letter in text)
        assert any(letter.isalpha() for letter in text)
        assert 3 <= len(text) <= 12


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("anna", "no digit, as a name"),
        ("Anna-Lena", "no digit, as a name"),
        ("anna7@mail.org", "e-mail address"),
        ("participant007", "is no code"),
        ("P 7", "is no code"),
        ("../P7", "is no code"),
        ("P٧", "is no code"),
        ("com1", "Windows has a device"),
        ("P7", "is no code"),
        ("007", "is no code"),
        ("", "is no code"),
    ],
)
def test_a_name_or_an_address_is_refused(code: str, says: str) -> None:
    with pytest.raises(SettingsError, match=rf"{says}.*; a code has letters"):
        check_code(code)


def test_a_number_is_the_digits_of_the_code() -> None:
    assert [number_of(code) for code in ("P07", "7th", "A1-2", "P00")] == [7, 7, 12, 0]
