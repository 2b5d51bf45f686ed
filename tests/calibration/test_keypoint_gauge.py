"""Standard deviations of cameras do not depend on the frame of the rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.keypoint_people import ring

from mocapella.calibration.keypoint_gauge import aligned_sds
from mocapella.evaluation.rig_from_people import pose_errors
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.camera import CameraRig, PlacedCamera

Float64 = NDArray[np.float64]
RIG = ring(4, 2)
T = np.array([one.T_camera_world for one in RIG.cameras.values()])


def motions_of_world(motion: Float64) -> Float64:
    """Motions (24,) of all cameras, in their frames, that one motion of the world causes."""
    return np.concatenate([log_motion(one @ exp_twist(motion) @ inverse(one)) for one in T])


def test_a_motion_of_the_world_is_no_error() -> None:
    J = np.stack([motions_of_world(1e-6 * axis) / 1e-6 for axis in np.eye(6)], axis=1)
    position, direction = aligned_sds(T, (J @ J.T).reshape(4, 6, 4, 6))
    np.testing.assert_allclose(position, 0.0, atol=1e-4)
    np.testing.assert_allclose(direction, 0.0, atol=1e-4)


def test_the_standard_deviations_do_not_depend_on_the_world() -> None:
    random = np.random.default_rng(0)
    half = random.normal(size=(24, 24))
    covariance = (half @ half.T).reshape(4, 6, 4, 6)
    moved = T @ exp_twist(np.array([0.3, -2.0, 1.0, 0.4, 1.2, -0.7]))
    np.testing.assert_allclose(aligned_sds(moved, covariance), aligned_sds(T, covariance), rtol=1e-9)


def test_they_are_those_of_the_errors_after_the_best_motion() -> None:
    random = np.random.default_rng(1)
    half = 1e-4 * random.normal(size=(24, 24))
    squares = np.zeros((2, 4))
    draws = 300
    for _ in range(draws):
        errors = (half @ random.normal(size=24)).reshape(4, 6)
        cameras = {
            name: PlacedCamera(one.camera, exp_twist(error) @ one.T_camera_world, one.covariance)
            for (name, one), error in zip(RIG.cameras.items(), errors, strict=True)
        }
        squares += np.square(pose_errors(CameraRig(cameras), RIG)) / draws
    np.testing.assert_allclose(np.sqrt(squares), aligned_sds(T, (half @ half.T).reshape(4, 6, 4, 6)), rtol=0.15)
