"""Descriptor of the method ``arms`` (`mocapella.tracker.arms`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from mocapella.model.arms import ArmFrame, SeenArm
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.observations import Arrival
from mocapella.model.session import SensorPose
from mocapella.settings import parse
from mocapella.tracker.arms import ArmsSettings, ArmsTracker
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker

_RATE_HZ: Final = 30
_SIZE: Final = (640, 480)
_LENS: Final = np.array([530.0, 530.0, 319.5, 239.5, -0.05, 0.0, 0.0, 0.0, 0.0])


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig = values.pop("rig", None)
    return ArmsTracker(
        parse(ArmsSettings, values, where="settings of arms"),
        rig=None if rig is None else decode_camera_rig(str(rig)),
        sensors_expected=sensors_expected,
        sensors=sensors,
    )


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    return ArmsTracker(), _arm()


def _arm() -> Iterator[Arrival]:
    """Arrivals of an arm held still before a camera; they load every module that the method loads lazily."""
    points, states, sd = np.full((23, 3), 0.5), np.full(23, 2, np.uint8), np.full(23, 0.005, np.float32)
    arm = SeenArm(0, False, 0.9, points, states, sd, np.zeros(21))
    for k in range(3):
        at_ns = round(1e9 * k / _RATE_HZ) + 1
        yield Arrival(ArmFrame("warm-up", 0, k, at_ns, 0, _SIZE, _LENS, "warm-up", (arm,)), at_ns)


METHOD: Final = Method(
    interface=1,
    name="arms",
    summary="arms and hands, from one depth camera or several",
    settings=ArmsSettings,
    frame_types=(ArmFrame,),
    parts=("arms",),
    make=_make,
    warm_up_run=_practice,
    camera_rig="optional",
    keeps_layout=True,
    files={"rig": "mocapella.tracker.method_files:camera_rig"},
    stages=("mocapella.viewer.stages:ARMS", "mocapella.viewer.stages:ROOM"),
)
"""One setting in addition to `ArmsSettings`: ``rig``, the text of a camera rig file, which is optional."""
