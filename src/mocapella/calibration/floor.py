"""Estimate the vertical and the floor from the feet that stand on it.

A foot that hardly moves stands. Positions of standing feet are fitted by a plane in the sensor's own frame. People's
backs are upright to a few degrees, or else their centre of mass is above their feet, which determines the plane while
all people stand in one spot.
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
"""Height of a standing foot's joint, the middle of the foot, over the floor [m]."""
STANDS_BELOW_M_S: Final = 0.2
"""A foot slower than this stands [m/s]."""
STANCE_S: Final = 0.5
"""Duration of a stance, which counts as one sample, however many frames show it [s]."""
FOOT_SD_M: Final = 0.03
"""Standard deviation of one stance [m]."""
BACK_SD: Final = np.radians(5.0)
"""Standard deviation of the mean back direction from the vertical [rad]."""
OUTLIER_M: Final = 0.06
"""Distance of a foot from the floor at which its weight is a quarter [m]."""
EVERY_S: Final = 0.08
"""Least interval between frames that are used [s]."""
ENOUGH_S: Final = 1.0
"""Time of standing feet before there is a floor [s]."""


class FloorJoints(NamedTuple):
    """Indices of the joints of a topology that the floor is estimated from: root, head, and ``feet`` (feet,)."""

    root: int
    head: int
    feet: NDArray[np.int64]


class FeetOfFrame(NamedTuple):
    """Tracking ``ids`` (bodies,) of a frame, and ``positions`` (bodies, feet, 3) of feet; NaN where not seen [m]."""

    ids: NDArray[np.uint64]
    positions: Float64


class Floor(msgspec.Struct, frozen=True, eq=False):
    """The floor in a sensor's frame: up·x + height = 0 for its points.

    Attributes:
        up: (3,) unit vector, upwards.
        height: height of the sensor over the floor [m].
        up_sd: standard deviation of the direction [rad].
        height_sd: standard deviation of the height [m].
    """

    up: Float64
    height: float
    up_sd: float
    height_sd: float

    @classmethod
    def under(cls, T_world_sensor: Float64) -> Floor:
        """Return the floor in a sensor's frame, from its pose (4, 4) in a world with the floor at y = 0.

        Its standard deviations are assumed: 0.02 rad and 0.03 m.
        """
        return cls(T_world_sensor[1, :3].copy(), float(T_world_sensor[1, 3]), 0.02, 0.03)

    @property
    def T_level_sensor(self) -> Float64:  # noqa: N802 - the field's notation
        """Transform (4, 4) to a frame with y up, the floor at y = 0, and the sensor above the origin, facing +z."""
        forward = np.array([0.0, 0.0, 1.0])
        if abs(self.up[2]) > 0.99:  # it looks straight up or down: use its own up instead
            forward = np.array([0.0, -np.sign(self.up[2]), 0.0])
        z = forward - self.up * (self.up @ forward)
        z /= np.linalg.norm(z)
        return rigid(np.stack([np.cross(self.up, z), self.up, z]), [0.0, self.height, 0.0])


def floor_of_pose(tilt: float, height: float) -> Floor:
    """Return the floor of a sensor from its measured tilt (upwards positive) [rad] and height [m], taken as exact."""
    return Floor(np.array([0.0, np.cos(tilt), np.sin(tilt)]), height, 0.0, 0.0)


@dataclass
class FloorFromFeet:
    """Estimates the floor from one sensor's standing feet, all in its camera space. The state does not grow with time.

    Attributes:
        sums: (10,) Σ w (1), Σ w x [m] (3), and Σ w x xᵀ [m²] by its upper triangle (6), of standing feet; a foot that
            stands for `STANCE_S` has the weight 1.
        back: (4,) upward directions of bodies, each with the weight `floor_kernels.BACK_STEP_S`: weighted sum of unit
            vectors along the back, or from feet to centre of mass where people squat or bend (3), and Σ weight [s].
        plane: (4,) the floor's ``up`` (3) and height [m] at the last update; 0 before.
        grown: ``sums[0]`` at that update; the next update is due when it has grown by 5 %.
        ids: (bodies,) tracking ids of the newest frame that was used.
        feet: (bodies, feet, 3) feet of that frame [m]; NaN where not seen.
        last: time of that frame [s].
        known: the floor of ``plane``; None before the first update.
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
        """Update with a sensor's frame; about ten frames a second are used, and no inferred joints.

        A frame less than `EVERY_S` after the last one used is ignored. After a gap, or a step back in time, no foot is
        taken as standing.

        Args:
            bodies: the frame's bodies.
            at: its capture time [s].
        """
        dt = at - self.last
        if 0 <= dt < EVERY_S:
            return
        joints = _joints(bodies.topology.name)
        ids = bodies.numbers
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
        """Return the floor from all standing feet so far; None before feet stood for `ENOUGH_S`, or without a back.

        `known` has the floor of the last update, at less cost.
        """
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
    """Return a topology's root, head and feet."""
    parts = topology(name).parts
    feet = np.array([j for part, j in parts.items() if part.startswith("foot_")])
    return FloorJoints(parts["root"], parts["head"], feet)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import floor_kernels

    return floor_kernels


def mean_floor(floors: list[tuple[Float64, Floor]]) -> Floor:
    """Average several sensors' floors, weighted by certainty.

    Args:
        floors: ``T_root_sensor`` (4, 4) and the floor of each; at least one.

    Returns:
        The floor in the root's frame.
    """
    T = np.stack([place for place, _ in floors])
    own_up = np.stack([floor.up for _, floor in floors])
    figures = np.array([(floor.height, floor.up_sd, floor.height_sd) for _, floor in floors])
    weights = np.maximum(figures[:, 1:], 1e-3) ** -2
    total = weights.sum(axis=0)
    ups = (T[:, :3, :3] @ own_up[..., None])[..., 0]
    up = weights[:, 0] @ ups
    up /= math.sqrt(up @ up)
    height = weights[:, 1] @ (figures[:, 0] - (ups * T[:, :3, 3]).sum(axis=1)) / total[1]
    return Floor(up, float(height), float(total[0] ** -0.5), float(total[1] ** -0.5))
