"""Layout of the 3D scene: the Scene stage in front, and the raised Sensors gallery behind it.

All positions are in the *view's space* [m]: y is up, and the browser's camera looks along +z, so that +x is to the left
of the screen, as in a sensor's camera space. The floor of a stage is at y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

SENSORS_SCALE = 0.6
"""Scale of the gallery: a metre in front of a sensor is this long in the view's space."""
LANE_WIDTH_M, LANE_DEPTH_M = 4.0, 4.5
"""Size of a lane's floor before scaling: the width of a Kinect's view at middle distance, and its range [m]."""
LANE_GAP = 0.12
"""Gap between two lanes, in the view's space [m]."""
LANES_A_ROW = 3
TRACKING_WIDTH_M, TRACKING_DEPTH_M = 5.0, 5.0
BEHIND_SENSOR_M = 0.5
"""Part of `TRACKING_DEPTH_M` that is behind the perspective's sensor, which is at the stage's origin."""
SENSORS_ORIGIN = np.array([0.0, 2.2, 5.0])
ROW_STEP = np.array([0.0, 1.3, 2.4])
"""Translation (3,) from one row of the gallery to the next [m]."""
PERSON_HEIGHT_M = 2.0


@dataclass(frozen=True, eq=False)
class Look:
    """Pose and field of view of the virtual camera in a browser.

    Attributes:
        position: (3,) position in the view's space [m].
        target: (3,) point that the camera looks at [m].
        fov: vertical field of view [rad].
    """

    position: Float64
    target: Float64
    fov: float


@dataclass(frozen=True, eq=False)
class BoundingBox:
    """An upright box in the view's space, by its corners (3,) with the smallest and the largest coordinates [m]."""

    low: Float64
    high: Float64

    @property
    def corners(self) -> Float64:
        """All corners (8, 3) of the box [m]."""
        pick = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T
        return np.where(pick == 0, self.low, self.high)


def lane_origins(count: int) -> Float64:
    """Return the middle of each lane's front edge as (count, 3) [m], the first lane at the left of the screen.

    The lanes stand in centred rows of `LANES_A_ROW`, each row above and behind the one before.
    """
    if count == 0:
        return np.zeros((0, 3))
    width = LANE_WIDTH_M * SENSORS_SCALE + LANE_GAP
    origins = []
    for start in range(0, count, LANES_A_ROW):
        lanes = min(LANES_A_ROW, count - start)
        left = (lanes - 1) / 2 * width
        row = SENSORS_ORIGIN + start // LANES_A_ROW * ROW_STEP
        origins += [row + np.array([left - lane * width, 0.0, 0.0]) for lane in range(lanes)]
    return np.array(origins)


def tracking_box() -> BoundingBox:
    """Return the extent of the Scene stage, which shows people life-size."""
    half = TRACKING_WIDTH_M / 2
    return BoundingBox(
        np.array([-half, 0.0, -BEHIND_SENSOR_M]), np.array([half, PERSON_HEIGHT_M, TRACKING_DEPTH_M - BEHIND_SENSOR_M])
    )


def arms_box() -> BoundingBox:
    """Return the extent of the ARMS stage, which shows enlarged arms, with its titles."""
    _, _, deep = stage_centre()
    return BoundingBox(np.array([-2.6, -0.45, deep]), np.array([2.6, 2.2, deep + 0.3]))


def sensors_box(count: int) -> BoundingBox:
    """Return the extent of a gallery with ``count`` lanes; for 0, that of one lane."""
    origins = lane_origins(max(count, 1))
    half = LANE_WIDTH_M * SENSORS_SCALE / 2
    size = np.array([half, PERSON_HEIGHT_M * SENSORS_SCALE, LANE_DEPTH_M * SENSORS_SCALE])
    return BoundingBox(origins.min(axis=0) - np.array([half, 0.0, 0.0]), origins.max(axis=0) + size)


def stage_centre() -> tuple[float, float, float]:
    """Return the position (3,) of the Scene stage's centre, at the height of a chest [m]."""
    return 0.0, 0.6 * PERSON_HEIGHT_M, TRACKING_DEPTH_M / 2 - BEHIND_SENSOR_M


def aside(place: int) -> Float64:
    """Return the pose (4, 4) at which a sensor with unknown pose is drawn, in a row at the stage's right edge.

    Args:
        place: index of the sensor in the row, from 0.
    """
    T = np.eye(4)
    T[:3, 3] = 0.3 - TRACKING_WIDTH_M / 2, 0.35, 0.7 * place - 0.2
    return T


def title_place(box: BoundingBox) -> tuple[float, float, float]:
    """Return the position (3,) of a stage's title [m]: the left end of the front edge of the stage's extent."""
    return float(box.high[0]) - 0.1, float(box.low[1]), float(box.low[2])


def frame(points: Float64, *, fov: float, aspect: float, elevation: float, margin: float = 1.05) -> Look:
    """Return the nearest camera that looks along +z, down by ``elevation``, and sees all the points.

    Args:
        points: (n, 3) points that must be visible, at least one, in the view's space [m].
        fov: vertical field of view [rad].
        aspect: width of the canvas over its height.
        elevation: angle between the camera's axis and the horizontal, downwards positive [rad].
        margin: height and width of the view relative to the smallest that contains the points; above 1 leaves a border.
    """
    forward = np.array([0.0, -np.sin(elevation), np.cos(elevation)])
    up = np.array([0.0, np.cos(elevation), np.sin(elevation)])
    right = np.array([-1.0, 0.0, 0.0])
    above = np.tan(fov / 2) / margin
    beside = above * aspect
    across, high, deep = points @ right, points @ up, points @ forward
    # A point (a, h, d) is in the picture of a camera at (a0, h0, d0) while |h − h0| ≤ above·(d − d0) and
    # |a − a0| ≤ beside·(d − d0): each tightest pair of lines meets at the nearest camera.
    top, bottom = (high - above * deep).max(), (high + above * deep).min()
    left, right_most = (across + beside * deep).min(), (across - beside * deep).max()
    d0 = min((bottom - top) / (2 * above), (left - right_most) / (2 * beside))
    h0 = (top + bottom) / 2
    position = (left + right_most) / 2 * right + h0 * up + d0 * forward
    distance = (deep.min() + deep.max()) / 2 - d0
    return Look(position, position + forward * distance, fov)


def eyes(tilt: float, height: float, fov: float) -> Look:
    """Return a camera at a sensor's pose at the stage's origin, to look through the sensor.

    Args:
        tilt: tilt of the sensor, upwards positive [rad].
        height: height of the sensor above the floor [m].
        fov: vertical field of view [rad].
    """
    position = np.array([0.0, height, 0.0])
    return Look(position, position + 3.0 * np.array([0.0, np.sin(tilt), np.cos(tilt)]), fov)
