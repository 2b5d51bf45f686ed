"""Collect errors of plug-ins' drawings: each is reported once, and everything else is still drawn."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final, TypeVar

T = TypeVar("T")

MOST: Final = 20
"""Largest number of collected errors."""
_LONGEST: Final = 300
_LOG: Final = logging.getLogger("mocapella.viewer")


class PluginErrors:
    """Collects messages about failed drawings, so that one plug-in's fault does not end the view.

    Attributes:
        lines: the messages, oldest first: one for each drawing, at most `MOST`. A new message makes a new tuple.
    """

    def __init__(self) -> None:
        self.lines: tuple[str, ...] = ()
        self._told: set[str] = set()

    def tell(self, what: str, error: Exception) -> None:
        """Log and store the first error of a drawing; ignore its later ones, and all beyond `MOST` drawings.

        Args:
            what: noun for the drawing in the message, such as ``lane of markers``.
            error: the error.
        """
        if what in self._told or len(self._told) >= MOST:
            return
        self._told.add(what)
        said = f"{what} cannot be drawn: {type(error).__name__}: {error}"
        self.lines = (*self.lines, said if len(said) <= _LONGEST else said[: _LONGEST - 1] + "…")
        _LOG.warning("%s cannot be drawn", what, exc_info=error)

    def attempt(self, what: str, do: Callable[[], T], otherwise: T) -> T:
        """Return the result of ``do()``; if it raises an exception, report it and return ``otherwise``.

        Args:
            what: noun for the drawing in the message, such as ``lane of markers``.
            do: function that draws.
            otherwise: result after an error.
        """
        try:
            return do()
        except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
            self.tell(what, error)
            return otherwise
