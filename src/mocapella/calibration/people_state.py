"""Results of the calibration from people: extrinsics, clock offsets, covariances and problems of all sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import inverse
from mocapella.model.scene import SensorPlace

Float64 = NDArray[np.float64]


class CalibratedSensor(msgspec.Struct, frozen=True, eq=False):
    """Pose and clock of one sensor.

    Attributes:
        sensor: name of the sensor.
        T_world_sensor: (4, 4); sensors with the same ``root`` share one world frame.
        covariance: (6, 6) of a small motion d in the world (translation [m], rotation [rad]) that corrects the pose to
            exp(d) T_world_sensor.
        root: sensor in whose frame the pose is estimated; itself if no other sensor is tied to it.
        clock: offset of its clock from the root's; None or unknown counts as 0.
        trusted: whether the pose is certain enough for fusion with other sensors.
        quality: standard deviations for users, such as ``12 mm, 0.4°``; empty for a root.
        condition: the problem and its remedy; empty without one.
    """

    sensor: str
    T_world_sensor: Float64
    covariance: Float64
    root: str
    clock: TimeOffset | None
    trusted: bool
    quality: str
    condition: str

    def place(self, T_world_sensor: Float64 | None) -> SensorPlace:
        """Return the sensor's place for a scene, with the pose ``T_world_sensor`` (4, 4) in use; None if unknown."""
        variances: list[float] = self.covariance.diagonal().tolist()
        sd_m, sd_rad = math.sqrt(sum(variances[:3])), math.sqrt(sum(variances[3:]))
        return SensorPlace(self.sensor, T_world_sensor, sd_m, sd_rad, self.quality, self.condition)


class PeopleState(msgspec.Struct, frozen=True, eq=False):
    """All sensors after a frame.

    Attributes:
        sensors: pose and clock of each sensor by name, in the order of names.
        qualities: descriptions of all pairs of sensors that have seen a person together.
        floor_known: whether the world's y = 0 is the floor; else the world is the root's camera frame.
        calibrations: number of times that the relative pose of a pair was found without an earlier one, or anew after
            a sensor was moved.
        moved: number of times that any sensor was detected as moved.
    """

    sensors: Mapping[str, CalibratedSensor]
    qualities: tuple[str, ...]
    floor_known: bool
    calibrations: int
    moved: int

    @property
    def conditions(self) -> tuple[str, ...]:
        """The sensors' conditions that are not empty, each with its sensor's name."""
        return tuple(f"{name}: {sensor.condition}" for name, sensor in self.sensors.items() if sensor.condition)

    @property
    def trusted_by_root(self) -> dict[str, list[str]]:
        """Names of the trusted sensors, by the sensor in whose frame their poses are estimated."""
        names: dict[str, list[str]] = {}
        for name, sensor in self.sensors.items():
            if sensor.trusted:
                names.setdefault(sensor.root, []).append(name)
        return names

    def poses_from(self, root: str) -> dict[str, Float64]:
        """Return ``T_root_sensor`` (4, 4) of the sensor ``root``, and of all that are tied to it if it is trusted."""
        of_root = self.sensors[root]
        if not of_root.trusted:
            return {root: np.eye(4)}
        to_root, tied = inverse(of_root.T_world_sensor), self.trusted_by_root[of_root.root]
        return {name: to_root @ self.sensors[name].T_world_sensor for name in tied} | {root: np.eye(4)}
