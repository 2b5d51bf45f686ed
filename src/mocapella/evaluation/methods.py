"""Which methods can be scored, and how each is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.protocol import ScoredTracker
from mocapella.tracker import METHODS, make_tracker

AS_LOGGED: Final = "stand-still"
"""The thesis' own method: the logged rows are its output, and are scored as they are."""


def scored_tracker(method: str, settings: Mapping[str, Any] | None = None) -> Callable[[int], ScoredTracker]:
    """How to make a new tracker of that method for so many sensors.

    Raises:
        SettingsError: no such method or setting, or it does not say what a scoring needs.
    """

    def make(sensors: int) -> ScoredTracker:
        tracker = make_tracker(method, sensors_expected=sensors, settings=settings)
        if not isinstance(tracker, ScoredTracker):
            raise SettingsError(f"method {method!r} cannot be scored: its tracker has no sensor_views")
        return tracker

    make(2)
    return make


def check_methods(methods: Sequence[str], *, some: bool = False) -> None:
    """Refuse a method that is unknown or cannot be scored; nothing has been read then.

    Args:
        methods: by name.
        some: whether there are others to score, so that these may be none.

    Raises:
        SettingsError: says which can.
    """
    for method in methods:
        if method not in METHODS:
            raise SettingsError(f"unknown tracking method {method!r}; known: {one_of(method, METHODS)}")
        if method != AS_LOGGED:
            scored_tracker(method)
    if not methods and not some:
        raise SettingsError(f"no method to score; known: {', '.join(METHODS)}")
