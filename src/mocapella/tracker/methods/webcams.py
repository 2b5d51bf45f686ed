"""Descriptor of the method ``webcams`` (`mocapella.tracker.webcams`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.markers import MarkerFrame
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
    own = parse(WebcamsSettings, values, where="settings of webcams")
    given = None if rig is None else decode_camera_rig(str(rig))
    return WebcamsTracker(given, own, sensors_expected=sensors_expected)


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    from mocapella.tracker.webcams_warmup import warm_up_arrivals, warm_up_tracker

    return warm_up_tracker(), warm_up_arrivals()


METHOD: Final = Method(
    interface=1,
    name="webcams",
    summary="people and hands in 3D without markers, from the keypoints that two or more cameras see",
    settings=WebcamsSettings,
    frame_types=(KeypointFrame, MarkerFrame),
    parts=("people", "hands"),
    make=_make,
    warm_up_run=_practice,
    kernels=213,
    camera_rig="optional",
    files={"rig": "mocapella.tracker.method_files:camera_rig"},
)
"""A setting in addition to `WebcamsSettings`: the text ``rig`` of a camera rig file. Without it, the cameras calibrate
themselves."""
