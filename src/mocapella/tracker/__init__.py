"""The tracker: a frame in, a scene out. No clock, thread, file or socket, so a replay gives the same scenes to the bit.

A method is a name in `METHODS`: ``default``, and the KinectMultiTrack thesis' own, ``stand-still``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from mocapella.errors import SettingsError, one_of
from mocapella.model.session import SensorPose
from mocapella.settings import check, parse
from mocapella.tracker.default import DefaultSettings, DefaultTracker
from mocapella.tracker.protocol import Tracker, TrackerReport
from mocapella.tracker.ready import make_ready
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings

__all__ = [
    "METHODS",
    "DefaultSettings",
    "DefaultTracker",
    "StandStillTracker",
    "StandStillTrackerSettings",
    "Tracker",
    "TrackerReport",
    "make_ready",
    "make_tracker",
]


def _stand_still(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = parse(StandStillTrackerSettings, settings, where="settings of stand-still")
    return StandStillTracker(values, sensors_expected=sensors_expected, sensors=sensors)


def _default(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = parse(DefaultSettings, settings, where="settings of default")
    return DefaultTracker(values, sensors_expected=sensors_expected, sensors=sensors)


METHODS: Final[Mapping[str, Callable[[Mapping[str, Any], int, Mapping[str, SensorPose]], Tracker]]] = {
    "default": _default,
    "stand-still": _stand_still,
}
"""How to make a tracker, by the method's name: of settings, sensors expected, and sensors' poses."""


def make_tracker(
    method: str,
    *,
    sensors_expected: int = 1,
    settings: Mapping[str, Any] | None = None,
    sensors: Mapping[str, SensorPose] | None = None,
) -> Tracker:
    """A new tracker.

    Args:
        method: key of `METHODS`.
        sensors_expected: how many sensors to wait for before calibrating; more may join.
        settings: the method's own, by name; the rest are its defaults.
        sensors: pose by sensor name; overrides what the frames say.

    Raises:
        SettingsError: no such method, an unknown setting, or one out of range; says what would work.
    """
    if method not in METHODS:
        raise SettingsError(f"unknown tracking method {method!r}; known: {one_of(method, METHODS)}")
    check(sensors_expected >= 1, "sensors_expected", sensors_expected, "1 or more")
    return METHODS[method](settings or {}, sensors_expected, sensors or {})
