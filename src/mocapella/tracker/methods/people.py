"""Descriptor of the method ``default`` (`mocapella.tracker.default`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from mocapella.model.arms import ArmFrame
from mocapella.model.images import ImageFrame
from mocapella.model.observations import BodyFrame
from mocapella.model.session import SensorPose
from mocapella.settings import parse
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.default_settings import DefaultSettings
from mocapella.tracker.method import Method
from mocapella.tracker.people_warmup import warm_up_run
from mocapella.tracker.protocol import Tracker


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = parse(DefaultSettings, settings, where="settings of default")
    return DefaultTracker(values, sensors_expected=sensors_expected, sensors=sensors)


METHOD: Final = Method(
    interface=1,
    name="default",
    summary="people, from any number of body sensors; calibrated by the people themselves",
    settings=DefaultSettings,
    frame_types=(BodyFrame, ArmFrame, ImageFrame),
    parts=("people", "arms", "bodies"),
    make=_make,
    warm_up_run=warm_up_run,
    warm_up_parts=("mocapella.tracker.people_warmup:pose_bodies", "mocapella.tracker.people_warmup:calibrate_sensors"),
    kernels=170,
    keeps_layout=True,
    files={
        "rig": "mocapella.tracker.method_files:bodies_rig",
        "start": "mocapella.cli.silhouette_start:settings_of_peoples_starts",
    },
    stages=("mocapella.viewer.stages:ARMS", "mocapella.viewer.stages:ROOM"),
)
