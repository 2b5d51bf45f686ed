"""Filter one articulated body from the rays of cameras, without a tracker.

The filter is an iterated extended Kalman filter in joint space, see `ray_body_kernels` and
docs/methods/webcams-body.md. A body's *memory* is its state: pose, velocity, covariance and bone lengths, laid out by
`articulated_memory`, where ``jumps`` holds each keypoint's offset from its joint of the chain, in the frame of the bone
that ends there [m], and the variance of a coordinate [m²]. `articulated_body.pose_of` reads its pose.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_body import Pose, pose_of
from mocapella.kinematics.articulated_model import ArticulatedModel, ArticulatedSettings, memory_size
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SKELETON_OF_RAYS: Final = "halpe_26"
"""Topology of the bodies that cameras see."""
RAY_SETTINGS: Final = ArticulatedSettings(full_surprise=1.0, arm_surprise=1.0, calm=1e-4)
"""Default settings of the filter of rays, whose restlessness is 1 for a body that moves."""


class RayEstimate(msgspec.Struct, frozen=True, eq=False):
    """The estimated joints of a body at an instant.

    Attributes:
        at_s: the instant [s].
        positions: (joints, 3) world [m]; NaN where the body is not known.
        covariances: (joints, 3, 3) [m²]; NaN where the body is not known.
        support: (joints,) number of rays that agree with each joint.
        weights: (n,) robust weight of each ray, from 0 to 1.
    """

    at_s: float
    positions: Float64
    covariances: Float64
    support: UInt8
    weights: Float64

    @property
    def known(self) -> bool:
        """Whether the body is known."""
        return bool(np.isfinite(self.positions[0, 0]))


def ray_model(settings: ArticulatedSettings | None = None) -> ArticulatedModel:
    """Return the body model of `SKELETON_OF_RAYS` with these settings, or `RAY_SETTINGS` if None.

    ``noise_s``, ``surprise_s``, ``scale_sd``, ``scale_s``, ``stand_diffusion`` and ``stand_speed`` belong to the filter
    of points and change nothing here.
    """
    return ArticulatedModel.of(topology(SKELETON_OF_RAYS), settings or RAY_SETTINGS)


class RayBody:
    """Filter of one body that cameras see. Equal inputs give equal outputs, to the bit.

    Args:
        settings: process noise and thresholds; `RAY_SETTINGS` if None.

    Attributes:
        model: the body model and the settings.
        memory: (1, memory_size) the body's state, see `articulated_memory`; updated in place.
    """

    def __init__(self, settings: ArticulatedSettings | None = None) -> None:
        self.model = ray_model(settings)
        self.reset()

    def reset(self) -> None:
        """Forget the body."""
        self.memory: Float64 = np.full((1, memory_size(self.model)), np.nan)

    def update(
        self, at_s: float, joints: Any, origins: Any, directions: Any, sds_rad: Any, *, after_s: Any = 0.0
    ) -> RayEstimate:
        """Update the body with the rays of one instant.

        Args:
            at_s: the instant [s]; a time before the last update's counts as that of the last update.
            joints: (n,) index of the joint that each ray sees; a camera has at most one ray to a joint.
            origins: (n, 3) centres of the rays' cameras, world [m].
            directions: (n, 3) directions, world, of any length.
            sds_rad: (n,) or one: standard deviation of a direction, of one angle across [rad].
            after_s: (n,) or one: how much later than ``at_s`` a ray is [s].

        Returns:
            All joints at the instant, including unseen ones; NaN until two rays each triangulate enough joints to
            initialise the body, and after ``forget_after_s`` without rays.

        Raises:
            SettingsError: the arrays have other lengths than ``joints``.
        """
        index = np.ascontiguousarray(joints, dtype=np.int64).reshape(-1)
        n = len(index)
        o, d = (_rows(values, n, name) for values, name in ((origins, "origins"), (directions, "directions")))
        length = np.linalg.norm(d, axis=1, keepdims=True)
        d = d / np.where(length > 0.0, length, np.nan)
        sds, after = (_numbers(values, n, name) for values, name in ((sds_rad, "sds_rad"), (after_s, "after_s")))
        estimate = self._empty(at_s, n)
        _kernels().correct_by_rays(
            self.model.arrays, self.memory[0], float(at_s), index, o, d, sds, after, estimate.weights,
            estimate.positions, estimate.covariances, estimate.support,
        )  # fmt: skip
        return estimate

    def predict(self, at_s: float) -> RayEstimate:
        """Predict the body at an instant [s], without changing it; a time before the last update's counts as that."""
        estimate = self._empty(at_s, 0)
        _kernels().predict_body(
            self.model.arrays, self.memory[0], float(at_s), estimate.positions, estimate.covariances
        )
        return estimate

    def _empty(self, at_s: float, rays: int) -> RayEstimate:
        joints = self.model.layout.joints
        return RayEstimate(
            float(np.fmax(at_s, self.memory[0, at.AT])), np.empty((joints, 3)), np.empty((joints, 3, 3)),
            np.zeros(joints, np.uint8), np.zeros(rays),
        )  # fmt: skip

    def move(self, T_new_old: Float64) -> None:
        """Transform the state to another world frame, by a rigid motion (4, 4) from the old to the new world."""
        move_bodies(self.model, self.memory, T_new_old)

    @property
    def pose(self) -> Pose | None:
        """The pose at the last update, copied; None until a body is initialised."""
        return pose_of(self.model, self.memory[0])


def move_bodies(model: ArticulatedModel, memory: Float64, T_new_old: Float64) -> None:
    """Transform the states of all bodies to another world frame, in place.

    Args:
        model: the body model.
        memory: (people, memory_size) a state in each row, changed.
        T_new_old: (4, 4) rigid motion from the old to the new world.
    """
    own = model.layout
    # Only innovations and last directions are vectors of the world; offsets are in the bones' frames.
    vectors = own._replace(contacts=own.ages + 1, jumps=own.ages + 1, size=own.ages + 8 * own.joints)
    _kernels().move(vectors, memory, np.ascontiguousarray(T_new_old, dtype=np.float64))


def _rows(values: Any, n: int, name: str) -> Float64:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (n, 3):
        raise SettingsError(f"{name} has the shape {array.shape}; {n} joints want ({n}, 3)")
    return array


def _numbers(values: Any, n: int, name: str) -> Float64:
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (n,)):
        raise SettingsError(f"{name} has the shape {array.shape}; {n} joints want one number or ({n},)")
    return np.ascontiguousarray(np.broadcast_to(array, (n,)))


@cache
def _kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import ray_body_kernels

    return ray_body_kernels
