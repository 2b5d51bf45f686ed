"""People who walk before three sensors, to compile the kernels of the method ``default`` (`mocapella.tracker.warmup`).

Each part calls kernels that take long to compile and that nothing else of the method needs first, so that processes
compile them at the same time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.people import PeopleCalibration
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.kinematics.articulated_body import ArticulatedBody
from mocapella.kinematics.body_model import body_model
from mocapella.model.bodies import tracked_bodies
from mocapella.model.observations import Arrival, BodyFrame, body_frame
from mocapella.model.topology import topology
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.protocol import Tracker

_SECONDS: Final = 6.0
_RATE_HZ: Final = 30
_TREE: Final = "kinect_v2"
_HEIGHT_M: Final = 1.7
_YAWS_DEG: Final = (0, 40, -40)


def warm_up_run() -> tuple[Tracker, Iterable[Arrival]]:
    """Return a new tracker of the method, and synthetic arrivals for it that call all of its kernels."""
    return DefaultTracker(sensors_expected=len(_YAWS_DEG)), (Arrival(frame, frame.time_ns) for frame in _frames())


def pose_bodies() -> None:
    """Compile the kernels of the articulated body, by a fit."""
    rest = _rest()
    ArticulatedBody(topology(_TREE)).update(rest, np.full(len(rest), 1e-4), 0.0)


def calibrate_sensors() -> None:
    """Compile the kernels of the calibration, by calibrating sensors from people's motion."""
    calibration = PeopleCalibration()
    for frame in _frames():
        calibration.update(tracked_bodies(frame), frame.time_ns)


def _rest() -> NDArray[np.float64]:
    """(joints, 3) of a body at rest, from its root [m]."""
    tree = topology(_TREE)
    offsets = body_model(tree.name).bones
    rest = np.zeros((len(tree), 3))
    for parent, child in tree.bones:
        rest[child] = rest[parent] + _HEIGHT_M * np.array(offsets[child].offset)
    return rest


def _frames() -> Iterator[BodyFrame]:
    """Three people who walk in circles before three sensors; one of them is lost for two seconds."""
    rest = _rest()
    poses = [rigid(rotation_about_y(a), (-2.5 * np.sin(a), 1.0, 0.0)) for a in np.radians(_YAWS_DEG)]
    for k in range(round(_SECONDS * _RATE_HZ)):
        for i, T_world_sensor in enumerate(poses):
            t = (k + i / len(poses)) / _RATE_HZ
            angles = [t + 2 * np.pi * i / 3 for i in range(2 if 2.0 < t < 4.0 else 3)]
            world = [
                apply(rigid(rotation_about_y(a), (0.7 * np.sin(a), 1.0, 3.0 + 0.7 * np.cos(a))), rest) for a in angles
            ]
            yield body_frame(
                f"warm-up-{i}",
                topology(_TREE),
                time_ns=round(1e9 * t),
                positions=apply(inverse(T_world_sensor), np.array(world)),
                tracking_ids=range(len(angles)),
                sequence=k,
            )
