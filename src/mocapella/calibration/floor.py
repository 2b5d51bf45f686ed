"""Which way is up, and where the floor is: from the feet that stand on it.

A foot that hardly moves stands. Where feet stood is a plane, fitted in the sensor's own frame. People's backs are
upright to a few degrees, which settles what the plane leaves open as long as everybody stands in one spot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid
from mocapella.model.bodies import Bodies
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

FOOT_HEIGHT_M: Final = 0.05
"""Of a standing foot's joint over the floor: the middle of the foot, not its sole [m]."""
STANDS_BELOW_M_S: Final = 0.2
"""A foot that moves no faster stands [m/s]."""
STANCE_S: Final = 0.5
"""One stance is one sample, however many frames show it [s]."""
FOOT_SD_M: Final = 0.03
"""Of one stance [m]."""
BACK_SD: Final = np.radians(5.0)
"""Of the mean back's direction against the vertical [rad]: nobody stands quite upright."""
OUTLIER_M: Final = 0.06
"""A foot so far from the floor counts a quarter [m]."""
EVERY_S: Final = 0.08
"""Frames that come sooner after the last are left out [s]."""
ENOUGH_S: Final = 1.0
"""Of standing feet, before there is a floor [s]."""


class FloorJoints(NamedTuple):
    """Joints of a topology that the floor is estimated from; ``feet`` (feet,)."""

    root: int
    head: int
    feet: NDArray[np.int64]


class FeetOfFrame(NamedTuple):
    """Tracking ids (bodies,) of a frame, and its feet (bodies, feet, 3) [m]; NaN where not seen."""

    ids: NDArray[np.uint64]
    positions: Float64


class Floor(msgspec.Struct, frozen=True, eq=False):
    """The floor in a sensor's frame: up·x + height = 0 for its points.

    Attributes:
        up: (3,) unit vector.
        height: of the sensor over it [m].
        up_sd: standard deviation of the direction [rad]. height_sd: of the height [m].
    """

    up: Float64
    height: float
    up_sd: float
    height_sd: float

    @classmethod
    def under(cls, T_world_sensor: Float64) -> Floor:
        """The floor of a sensor (4, 4) in a world whose y = 0 is the floor."""
        return cls(T_world_sensor[1, :3].copy(), float(T_world_sensor[1, 3]), 0.02, 0.03)

    @property
    def T_level_sensor(self) -> Float64:  # noqa: N802 - the field's notation
        """(4, 4) to a frame with y up, y = 0 on the floor, and the sensor over the origin, looking along +z."""
        forward = np.array([0.0, 0.0, 1.0])
        if abs(self.up[2]) > 0.99:  # it looks straight up or down: its own up is what remains
            forward = np.array([0.0, -np.sign(self.up[2]), 0.0])
        z = forward - self.up * (self.up @ forward)
        z /= np.linalg.norm(z)
        return rigid(np.stack([np.cross(self.up, z), self.up, z]), [0.0, self.height, 0.0])


def floor_of_pose(tilt: float, height: float) -> Floor:
    """The floor of a sensor whose tilt (upwards positive) [rad] and height [m] are given."""
    return Floor(np.array([0.0, np.cos(tilt), np.sin(tilt)]), height, 0.0, 0.0)


@dataclass
class FloorFromFeet:
    """Collects where one sensor sees feet stand. All memory has a fixed size.

    Attributes:
        sums: (10,) weight, Σ w x, and Σ w x xᵀ by its upper triangle, of standing feet.
        back: (4,) Σ of directions from the root to the head, and how many seconds of them.
        plane: (4,) the floor's ``up`` and height as they were when a twentieth less had been seen; 0 before.
        grown: ``sums[0]`` at that time.
        ids: (bodies,) tracking ids of the newest frame that was looked at; feet: (bodies, feet, 3) where theirs were,
            NaN where not seen; last: its time [s].
        known: the floor of ``plane``; None before there was one.
    """

    sums: Float64 = field(default_factory=lambda: np.zeros(10))
    back: Float64 = field(default_factory=lambda: np.zeros(4))
    plane: Float64 = field(default_factory=lambda: np.zeros(4))
    grown: float = 0.0
    ids: NDArray[np.uint64] = field(default_factory=lambda: np.zeros(0, dtype=np.uint64))
    feet: Float64 = field(default_factory=lambda: np.zeros((0, 1, 3)))
    last: float = -np.inf
    known: Floor | None = None

    def update(self, bodies: Bodies, at: float) -> None:
        """Take one frame in, at its time [s]. Joints that are only inferred do not count; ten frames a second do."""
        dt = at - self.last
        if 0 <= dt < EVERY_S:
            return
        joints = _joints(bodies.topology.name)
        ids = np.array(bodies.ids, dtype=np.uint64)
        feet = np.empty((len(ids), len(joints.feet), 3))
        _kernels().stand(
            self.sums, self.back, self.plane, FeetOfFrame(self.ids, self.feet), FeetOfFrame(ids, feet), dt,
            np.ascontiguousarray(bodies.positions), np.ascontiguousarray(bodies.states), joints,
        )  # fmt: skip
        self.ids, self.feet, self.last = ids, feet, at
        if self.sums[0] > 1.05 * self.grown:
            self.grown, self.known = float(self.sums[0]), self.floor()
            if self.known is not None:
                self.plane[:3], self.plane[3] = self.known.up, self.known.height

    def floor(self) -> Floor | None:
        """The floor; None before anybody stood for a moment."""
        W = self.sums[0]
        if W * STANCE_S < ENOUGH_S or self.back[3] <= 0.0:
            return None
        up0 = self.back[:3] / np.linalg.norm(self.back[:3])
        E = np.linalg.svd(up0[None])[2][1:]  # two directions across
        mean = self.sums[1:4] / W
        xx = np.empty((3, 3))
        xx[_UPPER] = self.sums[4:]
        xx[_UPPER[1], _UPPER[0]] = self.sums[4:]
        scatter = xx - W * np.outer(mean, mean)
        # Least squares of (up0 + Eᵀs)·(x − mean) with a prior on s: the backs.
        A = E @ scatter @ E.T / FOOT_SD_M**2 + np.eye(2) / BACK_SD**2
        C = np.linalg.inv(A)
        s = -C @ (E @ scatter @ up0) / FOOT_SD_M**2
        up = up0 + s @ E
        up /= np.linalg.norm(up)
        reach = E @ mean
        height_sd = float(np.sqrt(FOOT_SD_M**2 / W + reach @ C @ reach))
        return Floor(up, float(FOOT_HEIGHT_M - up @ mean), float(np.sqrt(np.trace(C))), height_sd)


_UPPER: Final = np.triu_indices(3)


@cache
def _joints(name: str) -> FloorJoints:
    parts = topology(name).parts
    feet = np.array([j for part, j in parts.items() if part.startswith("foot_")])
    return FloorJoints(parts["root"], parts["head"], feet)


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.calibration import floor_kernels

    return floor_kernels


def mean_floor(floors: list[tuple[Float64, Floor]]) -> Floor:
    """Several sensors' floors as one, weighted by how sure each is.

    Args:
        floors: ``T_root_sensor`` (4, 4) of each, and its floor; at least one.

    Returns:
        The floor in the root's frame.
    """
    T = np.stack([place for place, _ in floors])
    own_up = np.stack([floor.up for _, floor in floors])
    told = np.array([(floor.height, floor.up_sd, floor.height_sd) for _, floor in floors])
    weights = np.maximum(told[:, 1:], 1e-3) ** -2
    total = weights.sum(axis=0)
    ups = (T[:, :3, :3] @ own_up[..., None])[..., 0]
    up = weights[:, 0] @ ups
    up /= math.sqrt(up @ up)
    height = weights[:, 1] @ (told[:, 0] - (ups * T[:, :3, 3]).sum(axis=1)) / total[1]
    return Floor(up, float(height), float(total[0] ** -0.5), float(total[1] ** -0.5))
