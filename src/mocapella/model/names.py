"""Check names that become files, escape texts from outside for tables, and count with nouns."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

_DEVICES: Final = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]|conin\$|conout\$) *(\..*)?", re.IGNORECASE)
_FORMULA: Final = "=+-@"
"""First characters of texts that a spreadsheet evaluates."""


def is_device(name: str) -> bool:
    """Whether Windows opens a device, such as ``NUL`` or ``com1.txt``, instead of a file of this name."""
    return _DEVICES.fullmatch(name) is not None


def as_cell(text: str) -> str:
    """Return a text as a table cell: an apostrophe before initial ``=+-@'`` keeps spreadsheets from evaluating it."""
    return "'" + text if text[:1] and text[0] in _FORMULA + "'" else text


def of_cell(text: str) -> str:
    """Invert `as_cell`: return a table cell's text without the apostrophe that `as_cell` puts before it."""
    return text[1:] if len(text) > 1 and text[0] == "'" and text[1] in _FORMULA + "'" else text


def distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names without repetition: a repeated one gets a number, such as ``head (2)``."""
    found: dict[str, None] = {}
    for name in names:
        own, number = name, 1
        while own in found:
            number += 1
            own = f"{name} ({number})"
        found[own] = None
    return tuple(found)


def plural(count: int, one: str, many: str) -> str:
    """Return a number with the noun ``one`` for 1, else ``many``."""
    return f"{count} {one if count == 1 else many}"
