"""What a camera is, and cameras that stand somewhere."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


class Camera(msgspec.Struct, frozen=True, eq=False):
    """A camera's picture and lens.

    Attributes:
        name: as of a sensor.
        size_px: (width, height) of the picture for which the lens holds.
        lens: (9,) of `mocapella.geometry.lens`.
        readout_s: from the capture of the first row to that of the last; 0 of a global shutter [s].
    """

    name: str
    size_px: tuple[int, int]
    lens: Float64
    readout_s: float = 0.0


class PlacedCamera(msgspec.Struct, frozen=True, eq=False):
    """A camera of a rig.

    Attributes:
        camera: see there.
        T_camera_world: (4, 4) to its space: x right, y down, z out of the lens.
        covariance: (6, 6) of a small motion of the camera in its own space, translation then rotation, [m] and [rad];
            NaN where nobody knows.
        clock_s: how much later its clock says the same instant than the rig's [s].
    """

    camera: Camera
    T_camera_world: Float64
    covariance: Float64
    clock_s: float = 0.0


class CameraRig(msgspec.Struct, frozen=True, eq=False):
    """Cameras that see one space.

    Attributes:
        cameras: by name.
    """

    cameras: Mapping[str, PlacedCamera]
