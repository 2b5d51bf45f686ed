"""The tracker: a frame in, a scene out. No clock, thread, file or socket, so a replay gives the same scenes to the bit.

A method is a name in `METHODS`: ``default``, the KinectMultiTrack thesis' own, ``stand-still``, ``hands`` and ``arms``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from mocapella.errors import SettingsError, one_of
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.hand_file import decode_hand_shape
from mocapella.model.session import SensorPose
from mocapella.settings import check, parse
from mocapella.tracker.arms import ArmsSettings, ArmsTracker
from mocapella.tracker.default import DefaultSettings, DefaultTracker
from mocapella.tracker.hands import HandsSettings, HandsTracker
from mocapella.tracker.protocol import Tracker, TrackerReport
from mocapella.tracker.ready import make_ready
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings

__all__ = [
    "METHODS",
    "PEOPLE_METHODS",
    "ArmsSettings",
    "ArmsTracker",
    "DefaultSettings",
    "DefaultTracker",
    "HandsSettings",
    "HandsTracker",
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


def _hands(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig, hand = values.pop("rig", None), values.pop("hand", None)
    if rig is None:
        fix = "mocapella serve --method hands --rig RIG.toml, or mocapella serve, and calibrate in the view"
        raise SettingsError(f"the method hands wants to know where the cameras are: {fix}")
    return HandsTracker(
        decode_camera_rig(str(rig)),
        parse(HandsSettings, values, where="settings of hands"),
        shape=None if hand is None else decode_hand_shape(str(hand).encode()),
        sensors_expected=max(sensors_expected, 2),
    )


def _arms(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig = values.pop("rig", None)
    return ArmsTracker(
        parse(ArmsSettings, values, where="settings of arms"),
        rig=None if rig is None else decode_camera_rig(str(rig)),
        sensors_expected=sensors_expected,
        sensors=sensors,
    )


Make = Callable[[Mapping[str, Any], int, Mapping[str, SensorPose]], Tracker]
"""How to make a tracker of settings, sensors expected, and sensors' poses."""
PEOPLE_METHODS: Final[Mapping[str, Make]] = {"default": _default, "stand-still": _stand_still}
METHODS: Final[Mapping[str, Make]] = {**PEOPLE_METHODS, "hands": _hands, "arms": _arms}
"""By name. `hands` has two settings more than `HandsSettings`: ``rig``, the text of a camera rig's file, which it must
have, and ``hand``, that of a person's hand. `arms` has ``rig``, too, which it need not have."""


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
