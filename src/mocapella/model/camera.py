"""Cameras, and rigs of cameras with known poses."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


class Camera(msgspec.Struct, frozen=True, eq=False):
    """A camera's image size and lens.

    Attributes:
        name: the camera's sensor name.
        size_px: (width, height) of the images for which ``lens`` is valid.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        readout_s: rolling-shutter time from the first row to the last; 0 for a global shutter [s].
    """

    name: str
    size_px: tuple[int, int]
    lens: Float64
    readout_s: float = 0.0


class PlacedCamera(msgspec.Struct, frozen=True, eq=False):
    """A camera of a rig.

    Attributes:
        camera: size and lens.
        T_camera_world: (4, 4) extrinsics; camera frame: x right, y down, z out of the lens.
        covariance: (6, 6) covariance of a small motion of the camera in its own frame, translation [m] then rotation
            [rad]; NaN if unknown.
        clock_s: clock offset: the camera's time minus the rig's, at the same instant [s].
    """

    camera: Camera
    T_camera_world: Float64
    covariance: Float64
    clock_s: float = 0.0


class CameraRig(msgspec.Struct, frozen=True, eq=False):
    """Cameras with poses in one world frame.

    Attributes:
        cameras: the cameras, by name.
    """

    cameras: Mapping[str, PlacedCamera]
