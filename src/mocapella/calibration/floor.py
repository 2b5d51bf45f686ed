"""Which way is up, and where the floor is: from the feet that stand on it.

A foot that hardly moves stands. Where feet stood is a plane, fitted in the sensor's own frame. People's backs are
upright to a few degrees, which settles what the plane leaves open as long as everybody stands in one spot.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState

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
        feet: by (tracking id, foot's joint): place and time where it was last seen.
        known: the floor as it was when a twentieth less had been seen; None before there was one.
        last: time of the newest frame that was looked at [s].
    """

    sums: Float64 = field(default_factory=lambda: np.zeros(10))
    back: Float64 = field(default_factory=lambda: np.zeros(4))
    feet: dict[tuple[int, int], Float64] = field(default_factory=dict)
    known: Floor | None = None
    last: float = -np.inf

    def update(self, bodies: Bodies, at: float) -> None:
        """Take one frame in, at its time [s]. Joints that are only inferred do not count; ten frames a second do."""
        if at - self.last < EVERY_S:
            return
        self.last = at
        parts = bodies.topology.parts
        seen: dict[tuple[int, int], Float64] = {}
        for body, p, states in zip(bodies.ids, bodies.positions, bodies.states, strict=True):
            good = (states == JointState.TRACKED) & np.isfinite(p).all(axis=-1) & (p != 0.0).any(axis=-1)
            feet = [foot for part, foot in parts.items() if part.startswith("foot_") and good[foot]]
            root, head = parts["root"], parts["head"]
            if good[root] and good[head] and feet:
                upward = p[head] - p[root]
                self.back += 0.03 * np.append(upward / np.linalg.norm(upward), 1.0)
            up = self.back[:3]
            for foot in feet:
                seen[body, foot] = np.append(p[foot], at)
            # The lower one: the other may be lifted and still.
            foot = min(feet, key=lambda foot: float(up @ p[foot]), default=-1)
            if (body, foot) in self.feet:
                self._stand(self.feet[body, foot], seen[body, foot])
        self.feet = seen

    def _stand(self, earlier: Float64, now: Float64) -> None:
        dt = now[3] - earlier[3]
        if not 0.0 < dt < 0.3 or np.linalg.norm(now[:3] - earlier[:3]) > STANDS_BELOW_M_S * dt:
            return
        x, weight = now[:3], dt / STANCE_S
        if self.known is not None:
            off = float(self.known.up @ x + self.known.height - FOOT_HEIGHT_M)
            weight *= (OUTLIER_M**2 / (OUTLIER_M**2 + off * off)) ** 2
        before = self.sums[0]
        self.sums += weight * np.concatenate([[1.0], x, np.outer(x, x)[_UPPER]])
        if not before or int(20 * np.log(self.sums[0])) > int(20 * np.log(before)):
            self.known = self.floor()

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


def mean_floor(floors: list[tuple[Float64, Floor]]) -> Floor:
    """Several sensors' floors as one, weighted by how sure each is.

    Args:
        floors: ``T_root_sensor`` (4, 4) of each, and its floor; at least one.

    Returns:
        The floor in the root's frame.
    """
    ups, heights, directions, levels = [], [], [], []
    for T, floor in floors:
        up = T[:3, :3] @ floor.up
        ups.append(up)
        heights.append(floor.height - up @ T[:3, 3])
        directions.append(1.0 / max(floor.up_sd, 1e-3) ** 2)
        levels.append(1.0 / max(floor.height_sd, 1e-3) ** 2)
    up = np.average(ups, axis=0, weights=directions)
    up /= np.linalg.norm(up)
    height = float(np.average(heights, weights=levels))
    return Floor(up, height, float(np.sum(directions) ** -0.5), float(np.sum(levels) ** -0.5))
