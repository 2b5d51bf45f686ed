"""Trackers: a frame in, a scene out. They use no clock, thread, file or socket, so a replay is identical to the bit.

A method is a descriptor in `METHODS`: ``default``, ``stand-still`` (the KinectMultiTrack thesis), ``hands``, ``arms``,
``silhouettes``, or a plug-in's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mocapella.model.part_types import PART_TYPES
from mocapella.model.session import SensorPose
from mocapella.settings import check
from mocapella.tracker.method import METHODS, Method, methods_making
from mocapella.tracker.protocol import Tracker, TrackerReport
from mocapella.tracker.warmup import is_compiled, warm_up

__all__ = ["METHODS", "Method", "Tracker", "TrackerReport", "is_compiled", "make_tracker", "methods_making", "warm_up"]


def make_tracker(
    method: str,
    *,
    sensors_expected: int = 1,
    settings: Mapping[str, Any] | None = None,
    sensors: Mapping[str, SensorPose] | None = None,
) -> Tracker:
    """Create a tracker of a method, without any frame yet.

    Args:
        method: key of `METHODS`.
        sensors_expected: number of sensors to wait for before calibrating; more may join.
        settings: the method's settings, by name, nested as in its settings class; the others, or all if None, have
            their defaults.
        sensors: tilt and height by sensor name, instead of those in the sensor's frames; None for no sensor.

    Raises:
        SettingsError: unknown method or setting, or a value out of range; names valid ones.
        PluginError: the method is registered but cannot be used.
    """
    found = METHODS.find(method)
    for part in found.parts:
        PART_TYPES.find(part)
    check(sensors_expected >= 1, "sensors_expected", sensors_expected, "1 or more")
    return found.make(settings or {}, sensors_expected, sensors or {})
