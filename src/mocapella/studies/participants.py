"""Participants' codes: a participant has a code, never a name.

A code is long enough to be searched for in all bytes of a study's folder (`mocapella.studies.purge`).
"""

from __future__ import annotations

import re
from typing import Final

from mocapella.errors import SettingsError
from mocapella.model.names import is_device

CODE_RULE: Final = "letters A–Z, digits and -, 3 to 12 characters, with at least one letter and one digit, such as P07"
_CODE: Final = re.compile(r"(?=.*[0-9])(?=.*[A-Za-z])[A-Za-z0-9][A-Za-z0-9-]{1,10}[A-Za-z0-9]")


def code_problem(code: str) -> str:
    """Return why a text cannot be a participant's code; empty if it can. `CODE_RULE` is the rule."""
    if "@" in code:
        return "an e-mail address is no code"
    if is_device(code):
        return "Windows has a device of this name"
    if _CODE.fullmatch(code):
        return ""
    if code and not any(letter.isdigit() for letter in code):
        return "it has no digit, as a name has none"
    return "it is no code"


def check_code(code: str) -> str:
    """Return a participant's code unchanged.

    Raises:
        SettingsError: it looks like a name or an e-mail address, or breaks `CODE_RULE`.
    """
    problem = code_problem(code)
    if problem:
        raise SettingsError(f"participant {code[:40]!r}: {problem}; a code has {CODE_RULE}")
    return code


def number_of(code: str) -> int:
    """Return a participant's number in the study log (``Study_Id``): the digits of the code, such as 7 for ``P07``."""
    return int("".join(letter for letter in code if letter.isdigit()))
