"""The method ``default``: people that any number of body sensors see (`mocapella.tracker.default`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.kinematics.body_model import body_model
from mocapella.model.arms import ArmFrame
from mocapella.model.images import ImageFrame
from mocapella.model.observations import Arrival, BodyFrame, body_frame
from mocapella.model.session import SensorPose
from mocapella.model.topology import topology
from mocapella.settings import parse
from mocapella.tracker.default import DefaultSettings, DefaultTracker
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker

_PRACTICE_S: Final = 6.0
_RATE_HZ: Final = 30


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = parse(DefaultSettings, settings, where="settings of default")
    return DefaultTracker(values, sensors_expected=sensors_expected, sensors=sensors)


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    return DefaultTracker(sensors_expected=3), _walkers()


def _walkers() -> Iterator[Arrival]:
    """Two people who walk in circles before three sensors; one of them is lost for a while and comes back."""
    tree = topology("kinect_v2")
    offsets = body_model(tree.name).bones
    rest = np.zeros((len(tree), 3))
    for parent, child in tree.bones:
        rest[child] = rest[parent] + 1.7 * np.array(offsets[child].offset)
    places = [rigid(rotation_about_y(np.radians(a)), (2.5 * np.sin(np.radians(-a)), 1.0, 0.0)) for a in (0, 40, -40)]
    for k in range(round(_PRACTICE_S * _RATE_HZ)):
        for i, T_world_sensor in enumerate(places):
            t = (k + i / len(places)) / _RATE_HZ
            angles = [t] if 2.0 < t < 4.0 else [t, t + np.pi]
            world = [
                apply(rigid(rotation_about_y(a), (0.7 * np.sin(a), 1.0, 3.0 + 0.7 * np.cos(a))), rest) for a in angles
            ]
            frame = body_frame(
                f"warm-up-{i}",
                tree,
                time_ns=round(1e9 * t),
                positions=apply(inverse(T_world_sensor), np.array(world)),
                tracking_ids=range(len(angles)),
                sequence=k,
            )
            yield Arrival(frame, round(1e9 * t))


METHOD: Final = Method(
    interface=1,
    name="default",
    summary="people, from any number of body sensors; calibrated by the people themselves",
    settings=DefaultSettings,
    frame_types=(BodyFrame, ArmFrame, ImageFrame),
    parts=("people", "arms", "bodies"),
    make=_make,
    warm_up_run=_practice,
    keeps_layout=True,
    files={
        "rig": "mocapella.tracker.method_files:bodies_rig",
        "start": "mocapella.cli.silhouette_start:settings_of_peoples_starts",
    },
    stages=("mocapella.viewer.stages:ARMS", "mocapella.viewer.stages:ROOM"),
)
