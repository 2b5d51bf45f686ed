"""Descriptor of the method ``webcams`` (`mocapella.tracker.webcams`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from mocapella.errors import SettingsError
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.session import SensorPose
from mocapella.settings import parse
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig = values.pop("rig", None)
    if rig is None:
        fix = "mocapella serve --method webcams --rig RIG.toml, with a rig of mocapella calibrate cameras"
        raise SettingsError(f"the method webcams needs the poses of the cameras: {fix}")
    own = parse(WebcamsSettings, values, where="settings of webcams")
    return WebcamsTracker(decode_camera_rig(str(rig)), own, sensors_expected=sensors_expected)


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    from mocapella.tracker.webcams_warmup import warm_up_arrivals, warm_up_tracker

    return warm_up_tracker(), warm_up_arrivals()


METHOD: Final = Method(
    interface=1,
    name="webcams",
    summary="people and hands in 3D without markers, from the keypoints that two or more calibrated cameras see",
    settings=WebcamsSettings,
    frame_types=(KeypointFrame,),
    parts=("people", "hands"),
    make=_make,
    warm_up_run=_practice,
    kernels=118,
    camera_rig="required",
    files={"rig": "mocapella.tracker.method_files:camera_rig"},
)
"""A setting in addition to `WebcamsSettings`: the text ``rig`` of a camera rig file."""
