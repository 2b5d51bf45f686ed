"""Point at a plane with a hand: where the ray meets it, and its corners, taught by pointing at them from two places.

One ray does not tell how far away a corner is. Two rays from places that are apart do: the corner is the point with the
least sum of squared distances from them (`mocapella.geometry.plucker.nearest_point`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import CalibrationError
from mocapella.geometry.plucker import line, nearest_point, residual
from mocapella.model.arms import ELBOW
from mocapella.model.observations import JointState
from mocapella.model.scene import TrackedArm
from mocapella.settings import check

Float64 = NDArray[np.float64]

CORNERS: Final = ("top left", "top right", "bottom left")
"""The corners that describe a plane, in their order, as its user sees them."""
PLACES: Final = 2
"""Number of places to point at each corner from."""
POINTERS: Final = {"index": (5, 8), "forearm": (ELBOW, 0)}
"""What points, as two of `mocapella.model.arms.ARM_POINTS`: the index finger from knuckle to tip, elbow to wrist."""
LARGEST_SD_M: Final = 0.03
"""Standard deviation of either point above which a ray is uncertain [m]."""


def ray_of(arm: TrackedArm | None, by: str) -> tuple[Float64, Float64] | None:
    """Return an arm's pointing ray: (3,) its origin, at the tip or wrist, and (3,) its direction [m].

    None without an arm, or if a point is not measured by a camera now, or its standard deviation is above
    `LARGEST_SD_M`.

    Args:
        arm: in the frame of the ray; None if there is none.
        by: one of `POINTERS`.
    """
    if arm is None or not arm.cameras:
        return None
    begin, tip = POINTERS[by]
    ends = [begin, tip]
    if (arm.states[ends] != JointState.TRACKED).any() or not (arm.sd[ends] < LARGEST_SD_M).all():
        return None
    return arm.points[tip], arm.points[tip] - arm.points[begin]


def plane_corners(numbers: Any, name: str = "corners") -> Float64:
    """Return nine numbers as (3, 3) `CORNERS` [m].

    Raises:
        SettingsError: the corners are in a line, nearly so, or hundreds of metres apart; names the setting ``name``.
    """
    corners = np.reshape(np.asarray(numbers, dtype=np.float64), (3, 3))
    check(_span_a_plane(corners), name, numbers, "three corners that are not in a line [m]")
    return corners


def plane_hit(origin: Any, direction: Any, corners: Any) -> Float64:
    """Return where a ray meets a plane, as shares of its edges from the top left corner: (2,) x to the right, y down.

    Args:
        origin: (3,) beginning of the ray [m].
        direction: (3,) of any length.
        corners: (3, 3) `CORNERS` in the ray's frame [m].

    Returns:
        (2,): 0 to 1 between the corners, beyond them outside; NaN if the ray is parallel to the plane, leads away from
        it, or is not known.
    """
    corners = np.asarray(corners, dtype=np.float64)
    matrix = np.stack([corners[1] - corners[0], corners[2] - corners[0], -np.asarray(direction)], axis=1)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-9:
        return np.full(2, np.nan)
    x, y, along = np.linalg.solve(matrix, origin - corners[0])
    return np.array([x, y]) if along > 0 else np.full(2, np.nan)


@dataclass(frozen=True)
class CornerSettings:
    """When a hand that points is still, and which rays determine a corner.

    Attributes:
        hold_s: time for which a ray is held still [s].
        still_deg: largest angle of a still ray from its mean; the next ray is taken after a larger change [deg].
        still_m: largest distance of a still ray's origin from its mean [m].
        gap_s: gap between two rays after which holding starts again [s].
        least_angle_deg: least angle between the two rays to a corner; a smaller one leaves its distance open [deg].
        largest_miss_m: largest distance of a corner from its rays [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    hold_s: float = 1.5
    still_deg: float = 4.0
    still_m: float = 0.03
    gap_s: float = 0.25
    least_angle_deg: float = 10.0
    largest_miss_m: float = 0.15

    def __post_init__(self) -> None:
        check(0 < self.hold_s <= 60, "hold_s", self.hold_s, "above 0, at most 60 s")
        check(0 < self.still_deg <= 45, "still_deg", self.still_deg, "above 0, at most 45 degrees")
        check(0 < self.still_m <= 1, "still_m", self.still_m, "above 0, at most 1 m")
        check(0 < self.gap_s <= 60, "gap_s", self.gap_s, "above 0, at most 60 s")
        check(0 < self.least_angle_deg <= 90, "least_angle_deg", self.least_angle_deg, "above 0, at most 90 degrees")
        check(0 < self.largest_miss_m <= 10, "largest_miss_m", self.largest_miss_m, "above 0, at most 10 m")


class CornerLearning:
    """Learn the corners of a plane from a hand that points at each of them, first from one place, then from another.

    Attributes:
        settings: when a ray is still, and which rays determine a corner.
    """

    def __init__(self, settings: CornerSettings | None = None) -> None:
        self.settings = settings or CornerSettings()
        self.reset()

    def reset(self) -> None:
        """Forget all rays, as if newly made."""
        self._taken: list[Float64] = []
        self._held: list[tuple[float, Float64]] = []

    @property
    def request(self) -> str:
        """What the user is asked to do next, in a sentence; empty once all corners have been pointed at."""
        done = len(self._taken)
        if done == PLACES * len(CORNERS):
            return ""
        first = "" if done != len(CORNERS) else "Go a metre or more to the side. "
        return f"{first}Point at the {CORNERS[done % len(CORNERS)]} corner, and hold still."

    def update(self, origin: Any, direction: Any, at_s: float) -> bool:
        """Feed the ray of one frame; return whether it completes a still one, so that the request changes.

        Args:
            origin: (3,) [m]; the caller leaves out rays that are uncertain.
            direction: (3,) of any length; a ray with a NaN is ignored.
            at_s: capture time [s]; not before the last one.
        """
        s, length = self.settings, float(np.linalg.norm(direction))
        ray = np.concatenate([origin, np.divide(direction, length if length > 0 else math.nan)])
        if not np.isfinite(ray).all() or not self.request:
            return False
        if self._held and at_s - self._held[-1][0] > s.gap_s:
            self._held.clear()
        self._held.append((at_s, ray))
        while not self._still(np.array([held for _, held in self._held])):
            self._held.pop(0)
        if at_s - self._held[0][0] < s.hold_s:
            return False
        while at_s - self._held[1][0] >= s.hold_s:
            self._held.pop(0)
        mean = np.mean([held for _, held in self._held], axis=0)
        if self._taken and self._still(np.stack([self._taken[-1], mean]), 0.5):
            return False  # still the corner before
        self._taken.append(mean)
        self._held.clear()
        return True

    def corners(self) -> Float64:
        """Return the corners, (3, 3) in the order of `CORNERS`, in the rays' frame [m].

        Raises:
            CalibrationError: a corner has not been pointed at from both places, its rays do not meet before both hands
                or meet at too small an angle, or the corners are in a line.
        """
        if self.request:
            raise CalibrationError(f"not all corners are taught; {self.request[0].lower()}{self.request[1:-1]}")
        rays = np.array(self._taken).reshape(PLACES, len(CORNERS), 6).swapaxes(0, 1)
        lines = line(rays[..., :3], rays[..., 3:])
        points = nearest_point(lines)
        angles = np.degrees(np.arccos(np.clip((lines[:, 0, :3] * lines[:, 1, :3]).sum(axis=-1), -1.0, 1.0)))
        misses = np.linalg.norm(residual(points[:, None], lines), axis=-1).max(axis=-1)
        ahead = ((points[:, None] - rays[..., :3]) * lines[..., :3]).sum(axis=-1).min(axis=-1)
        again = "teach the corners again, from two places that are farther apart"
        for name, angle, miss, along in zip(CORNERS, angles, misses, ahead, strict=True):
            if not self.settings.least_angle_deg <= angle <= 180.0 - self.settings.least_angle_deg:
                raise CalibrationError(f"{name} corner: its two rays differ by {angle:.0f} degrees only; {again}")
            if not (miss <= self.settings.largest_miss_m and along > 0):
                how = f"miss each other by {2 * miss:.2f} m" if along > 0 else "meet behind a hand"
                raise CalibrationError(f"{name} corner: its two rays {how}; {again}")
        if not _span_a_plane(points):
            raise CalibrationError("the taught corners are in a line; teach the corners again")
        return points

    def _still(self, rays: Float64, share: float = 1.0) -> bool:
        """Whether rays (n, 6), origin and unit direction, are near their mean, within a share of the settings."""
        mean = rays.mean(axis=0)
        along = (rays[:, 3:] @ mean[3:]) / max(float(np.linalg.norm(mean[3:])), 1e-9)
        near = np.linalg.norm(rays[:, :3] - mean[:3], axis=-1).max() <= share * self.settings.still_m
        return bool(near and along.min() >= math.cos(math.radians(share * self.settings.still_deg)))


def _span_a_plane(corners: Float64) -> bool:
    area = float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])))
    return 1e-4 < area < 1e4
