"""Methods that can be scored.

A method is a key of `mocapella.tracker.METHODS` whose tracker has the interface
`mocapella.evaluation.protocol.ScoredTracker`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final

import msgspec

from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.protocol import ScoredTracker
from mocapella.settings import parse, settings_of_pairs
from mocapella.tracker import METHODS, make_tracker, methods_making

AS_LOGGED: Final = "stand-still"
"""The thesis' own method: the logged rows are its output, and are scored unchanged."""


def method_with_settings(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``default:people.smoothing=kalman:keep_root_s=2`` into the method's name and its settings.

    Returns:
        ``"default", {"people": {"smoothing": "kalman"}, "keep_root_s": 2}``; the settings' names and ranges are not
        checked. See `mocapella.settings.settings_of_pairs`.

    Raises:
        SettingsError: no such method of tracking people, or a setting is not NAME=VALUE; says what would work.
    """
    method, *pairs = text.split(":")
    known = methods_making("people")
    if method not in known:
        raise SettingsError(f"unknown tracking method {method!r}; known: {one_of(method, known)}")
    return method, settings_of_pairs(pairs)


def scored_tracker(text: str) -> Callable[[int], ScoredTracker]:
    """Return a factory of a method's tracker, with optional settings, for a number of sensors.

    One tracker is made and discarded, to check the method.

    Args:
        text: ``METHOD``, or the method with settings, as `method_with_settings` reads it.

    Raises:
        SettingsError: no such method or setting, or its tracker lacks what scoring needs.
    """
    method, settings = method_with_settings(text)

    def make(sensors: int) -> ScoredTracker:
        tracker = make_tracker(method, sensors_expected=sensors, settings=settings)
        if not isinstance(tracker, ScoredTracker):
            raise SettingsError(f"method {method!r} cannot be scored: its tracker has no sensor_views")
        return tracker

    make(2)
    return make


def settings_used(text: str) -> str:
    """Return all settings of a scored method, also the defaults, as JSON; words for the logged rows.

    Args:
        text: as in `scored_tracker`.

    Raises:
        SettingsError: no such method or setting.
    """
    if text == AS_LOGGED:
        return "the rows as they were logged"
    method, settings = method_with_settings(text)
    used: Any = parse(METHODS.find(method).settings, settings, where=f"settings of {method}")
    # Encoded as a dictionary: msgspec leaves out the class defaults of a parsed dataclass.
    return msgspec.json.encode(dataclasses.asdict(used), order="sorted").decode()


def check_methods(methods: Sequence[str], *, some: bool = False) -> None:
    """Check that all methods are known and can be scored, before any file is read.

    Args:
        methods: names, optionally with settings, see `method_with_settings`.
        some: whether the list may be empty, because other methods are scored.

    Raises:
        SettingsError: a method is unknown or cannot be scored, or there is none; names valid ones.
    """
    for method in methods:
        if method != AS_LOGGED:
            scored_tracker(method)
    if not methods and not some:
        raise SettingsError(f"no method to score; known: {', '.join(methods_making('people'))}")
