"""Check names that become files, escape texts from outside for terminals and tables, and count with nouns."""

from __future__ import annotations

import re
from typing import Final

_DEVICES: Final = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]|conin\$|conout\$) *(\..*)?", re.IGNORECASE)
_FORMULA: Final = "=+-@"
"""First characters of texts that a spreadsheet evaluates."""


def is_device(name: str) -> bool:
    """Whether Windows opens a device, such as ``NUL`` or ``com1.txt``, instead of a file of this name."""
    return _DEVICES.fullmatch(name) is not None


def visible(text: str, keep: str = "") -> str:
    """Return the text with control and direction characters as escapes, such as ``\\x1b``, except those in ``keep``.

    A terminal would carry out an escape sequence, and show a name with a direction character in another order.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)


def as_cell(text: str) -> str:
    """Return a text as a table cell: an apostrophe before initial ``=+-@'`` keeps spreadsheets from evaluating it."""
    return "'" + text if text[:1] and text[0] in _FORMULA + "'" else text


def of_cell(text: str) -> str:
    """Invert `as_cell`: return a table cell's text without the apostrophe that `as_cell` puts before it."""
    return text[1:] if len(text) > 1 and text[0] == "'" and text[1] in _FORMULA + "'" else text


def plural(count: int, one: str, many: str) -> str:
    """Return a number with the noun ``one`` for 1, else ``many``."""
    return f"{count} {one if count == 1 else many}"
