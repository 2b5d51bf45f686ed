"""Triangulate points of two nearly parallel cameras by one of three methods behind one interface.

``rays``: as `geometry.triangulation`. ``parallel``: the depth is B·f over the disparity, as for exactly parallel
cameras. ``parallel-fitted``: the depth is k·xᶻ of the disparity x, with k and z fitted to distances measured with a
ruler. For the last two the pixels, not the images, are undistorted and rotated until both cameras look across their
baseline, with the mean focal length; `geometry.parallel_pair` defines left and right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.lens import undistort
from mocapella.geometry.parallel_pair import ParallelPair, PowerLaw, swapped
from mocapella.geometry.triangulation import PointState, Triangulated, TriangulationSettings, triangulate, views
from mocapella.model.camera import CameraRig
from mocapella.settings import check

Float64 = NDArray[np.float64]

METHODS: Final = ("rays", "parallel", "parallel-fitted")


@dataclass(frozen=True)
class PairDepthSettings:
    """Parameters of the depth.

    Attributes:
        method: one of `METHODS`.
        k_cm: factor of the depth for ``parallel-fitted``, see `PowerLaw` [cm].
        z: exponent of the depth for ``parallel-fitted``, see `PowerLaw`.
        sd_px: standard deviation of a pixel's coordinate [px].
        gate_sd: largest disagreement of the two pixels of a point, in standard deviations; beyond, the point is NaN.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    method: str = "rays"
    k_cm: float = math.nan
    z: float = -1.0
    sd_px: float = 0.5
    gate_sd: float = 4.0

    def __post_init__(self) -> None:
        check(self.method in METHODS, "method", self.method, f"one of {one_of(self.method, METHODS)}")
        if self.method == "parallel-fitted":
            check(0 < self.k_cm < 1e9, "k_cm", self.k_cm, "above 0 cm: fit it with `mocapella lab depth fit`")
            check(-3 < self.z < 0, "z", self.z, "between -3 and 0: fit it with `mocapella lab depth fit`")
        check(0 < self.sd_px < 1e6, "sd_px", self.sd_px, "above 0 px")
        check(self.gate_sd > 0, "gate_sd", self.gate_sd, "above 0")


class PairDepth:
    """Triangulation by two cameras of a rig, nearly parallel and side by side; stateless.

    Args:
        rig: a rig of two cameras or more.
        settings: method and its parameters; the defaults if None.
        left, right: names of the two cameras, as for a person who faces them; the rig's first and second if None.

    Attributes:
        pair: an exactly parallel pair with the baseline and the mean focal length of the two cameras.

    Raises:
        SettingsError: there are no two such cameras, or they stand in one place or one before the other.
    """

    def __init__(
        self,
        rig: CameraRig,
        settings: PairDepthSettings | None = None,
        *,
        left: str | None = None,
        right: str | None = None,
    ) -> None:
        """Choose and rectify the cameras; the class describes the arguments."""
        self.settings = settings or PairDepthSettings()
        names = list(rig.cameras)
        chosen = [left or next(iter(names), ""), right or next(iter(names[1:]), "")]
        for name in chosen:
            if name not in rig.cameras:
                raise SettingsError(f"camera {name!r} is not of the rig; known: {one_of(name, names)}")
        if chosen[0] == chosen[1]:
            raise SettingsError(f"left and right are both {left!r}; name two cameras")
        cameras = [rig.cameras[name] for name in chosen]
        self._lenses = np.array([c.camera.lens for c in cameras])
        self._T = np.array([c.T_camera_world for c in cameras])
        self._views = views(self._lenses, self._T)
        R = self._T[:, :3, :3]
        centres = self._views.numbers[:, 22:]
        across = centres[0] - centres[1]
        baseline = float(np.linalg.norm(across))
        if not baseline > 1e-6:
            raise SettingsError(f"cameras {chosen[0]} and {chosen[1]} stand in one place; calibrate the rig")
        x = across / baseline
        x = x if x @ R[:, 0].mean(axis=0) > 0 else -x
        ahead = R[:, 2].mean(axis=0)
        z = ahead - x * (x @ ahead)
        if not np.linalg.norm(z) > 0.1:
            raise SettingsError(f"cameras {chosen[0]} and {chosen[1]} look along their baseline; put them side by side")
        z /= np.linalg.norm(z)
        self._R_pair_world = np.stack([x, np.cross(z, x), z])
        self._middle = centres.mean(axis=0)
        width = cameras[0].camera.size_px[0]
        focal = float(self._lenses[:, 0].mean())
        self.pair: ParallelPair = ParallelPair(baseline, width, 2.0 * math.atan(width / (2.0 * focal)))

    def disparity(self, pixels: Any) -> Float64:
        """Return the disparity (...,) of points, after undistortion and rectification [px]: x right minus x left.

        ``pixels`` (..., 2, 2) are the image points x, y of the left and of the right camera [px]; NaN gives NaN.
        """
        rays = self._rays(np.asarray(pixels, dtype=np.float64))
        return np.asarray(self.pair.focal_px * (rays[..., 1, 0] - rays[..., 0, 0]))

    def swapped(self, pixels: Any) -> bool:
        """Return whether most finite disparities are negative: the cameras ``left`` and ``right`` are swapped.

        It is False without a finite disparity. ``pixels`` as in `disparity`.
        """
        return swapped(self.disparity(pixels))

    def points(self, pixels: Any) -> Triangulated:
        """Triangulate points in the rig's world, by the method of the settings.

        Args:
            pixels: (..., 2, 2) image points x, y of the left and of the right camera [px]; NaN where not seen.

        Returns:
            Points (..., 3) in the world [m] with a `PointState`; NaN unless that is SEEN. For the parallel methods it
            is ONE_VIEW where a pixel is NaN, BEHIND for a disparity of 0 or less, and INCONSISTENT where the rows of
            the two rectified image points differ by more than ``gate_sd``.
        """
        s = self.settings
        pixels = np.asarray(pixels, dtype=np.float64)
        if s.method == "rays":
            return triangulate(pixels, self._views, s.sd_px, TriangulationSettings(gate_sd=s.gate_sd))
        rays, f = self._rays(pixels), self.pair.focal_px
        disparity = f * (rays[..., 1, 0] - rays[..., 0, 0])
        if s.method == "parallel":
            depth, power = self.pair.depth(disparity), -1.0
        else:
            depth, power = PowerLaw(s.k_cm, s.z).depth(disparity), s.z
        apart = np.abs(f * (rays[..., 1, 1] - rays[..., 0, 1]))
        states = np.where(apart > s.gate_sd * math.sqrt(2.0) * s.sd_px, PointState.INCONSISTENT, PointState.SEEN)
        states = np.where(disparity <= 0, PointState.BEHIND, states)
        states = np.where(np.isnan(disparity), PointState.ONE_VIEW, states).astype(np.uint8)
        good = states == PointState.SEEN
        depth = np.where(good, depth, np.nan)
        ray = np.concatenate([rays.mean(axis=-2), np.ones((*depth.shape, 1))], axis=-1)
        slope = power * depth / np.where(good, disparity, np.nan)
        along = ray[..., :, None] * ray[..., None, :] * (2.0 * (slope * s.sd_px) ** 2)[..., None, None]
        aside = np.diag([1.0, 1.0, 0.0]) * (0.5 * (depth * s.sd_px / f) ** 2)[..., None, None]
        R = self._R_pair_world
        half = np.where(good, apart / 2.0, np.nan)
        return Triangulated(
            self._middle + (ray * depth[..., None]) @ R,
            R.T @ (along + aside) @ R,
            np.stack([half, half], axis=-1),
            np.stack([good, good], axis=-1),
            states,
        )

    def _rays(self, pixels: Float64) -> Float64:
        """Return x/z and y/z (..., 2, 2) in the pair's space, with the same axes for both."""
        turned = []
        for k in range(2):
            seen = undistort(pixels[..., k, :], self._lenses[k])
            ray = np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1)
            turned.append(ray @ self._T[k, :3, :3] @ self._R_pair_world.T)
        rays = np.stack(turned, axis=-2)
        return np.asarray(rays[..., :2] / rays[..., 2:])
