"""Descriptor of the method ``stand-still`` of the KinectMultiTrack thesis (`mocapella.tracker.stand_still`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from mocapella.model.observations import BodyFrame
from mocapella.model.session import SensorPose
from mocapella.settings import parse
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = parse(StandStillTrackerSettings, settings, where="settings of stand-still")
    return StandStillTracker(values, sensors_expected=sensors_expected, sensors=sensors)


METHOD: Final = Method(
    interface=1,
    name="stand-still",
    summary="people, as the KinectMultiTrack thesis (2015) tracked them: the baseline",
    settings=StandStillTrackerSettings,
    frame_types=(BodyFrame,),
    parts=("people",),
    make=_make,
)
