"""What the calibration from people says of all sensors."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.time_offset import TimeOffset

Float64 = NDArray[np.float64]


class CalibratedSensor(msgspec.Struct, frozen=True, eq=False):
    """What is known of a sensor.

    Attributes:
        sensor: its name.
        T_world_sensor: (4, 4); of sensors with the same ``root`` the worlds are one.
        covariance: (6, 6) of a small motion in the world (translation [m], rotation [rad]): exp(d) T_world_sensor.
        root: the sensor in whose frame it is told; itself where nothing ties it to another.
        clock: what its times are ahead of the root's; None or not known: take 0.
        trusted: whether its place is sure enough to fuse what it sees with what others see.
        quality: ``12 mm, 0.4°``; empty where there is nothing to measure.
        condition: what is wrong or missing, and what to do; empty where nothing is.
    """

    sensor: str
    T_world_sensor: Float64
    covariance: Float64
    root: str
    clock: TimeOffset | None
    trusted: bool
    quality: str
    condition: str


class PeopleState(msgspec.Struct, frozen=True, eq=False):
    """What is known after a frame.

    Attributes:
        sensors: by name, in the order of the names.
        qualities: of every pair of sensors that has seen somebody together, in words.
        floor_known: whether the world's y = 0 is the floor; else the world is the root's camera space.
        calibrations: how many pairs of sensors were calibrated so far.
        moved: how often a sensor was found to have been moved.
    """

    sensors: Mapping[str, CalibratedSensor]
    qualities: tuple[str, ...]
    floor_known: bool
    calibrations: int
    moved: int

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every sensor's condition that is not empty, with its name."""
        return tuple(f"{name}: {sensor.condition}" for name, sensor in self.sensors.items() if sensor.condition)
