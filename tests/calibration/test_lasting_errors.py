"""The covariance of cameras that people calibrate has lasting errors: many images of one place are not many errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.webcam_people import Path, circling, standing, walker

from mocapella.calibration.keypoint_bundle import (
    BONES,
    CAMERA,
    JOINTS,
    STATURES,
    BundlePrior,
    KeypointViews,
    PeopleBundle,
    adjust_people,
)
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
RIG = list(circle_of_cameras(3).cameras.values())


def positions_sd(path: Path, bodies: int) -> float:
    """Stated standard deviation of the last camera's position [m], with one person on a path for 6 s."""
    times = np.linspace(0.0, 6.0, bodies, endpoint=False)
    T_camera_world = np.array([one.T_camera_world @ inverse(RIG[0].T_camera_world) for one in RIG])
    joints = np.array([apply(RIG[0].T_camera_world, walker(t, path)) for t in times])
    camera, body, joint = (
        index.ravel() for index in np.meshgrid(range(3), range(bodies), range(JOINTS), indexing="ij")
    )
    random = np.random.default_rng(0)
    exact = np.array([project(apply(T, joints), one.camera.lens) for T, one in zip(T_camera_world, RIG, strict=True)])
    exact = exact.reshape(-1, 2)
    count = len(camera)
    views = KeypointViews(
        camera, body, joint, exact + random.normal(0.0, 0.3, exact.shape), np.zeros((count, 2)), np.full(count, 0.5),
        np.zeros(bodies, np.int64), np.arange(bodies) // 5,
    )  # fmt: skip
    lengths = [[] for _ in STATURES]  # type: list[list[float]]
    for one, other, which in BONES:
        lengths[which] += np.linalg.norm(joints[:, one] - joints[:, other], axis=-1).tolist()
    free = np.ones((3, CAMERA), dtype=bool)
    free[0, :6] = False
    free[:, 6:] = False
    log_lengths = np.log([[float(np.mean(of)) for of in lengths]])
    prior = BundlePrior(
        free, np.array([one.camera.lens for one in RIG]), np.zeros(3), np.full((3, CAMERA), np.inf),
        float(np.exp(np.mean(log_lengths - np.log(STATURES)))),
    )  # fmt: skip
    start = PeopleBundle(T_camera_world, np.array([o.camera.lens for o in RIG]), np.zeros(3), joints, log_lengths)
    found = adjust_people(views, start, prior, rounds=1)
    return float(np.sqrt(np.trace(found.covariance[2, :3, 2, :3])))


def test_people_in_one_place_determine_cameras_badly_however_long_they_stay() -> None:
    short, long = (positions_sd(standing(0.2, 0.1, 0.3), bodies) for bodies in (10, 40))
    assert long > 0.65 * short  # 0.5 if errors were independent
    assert positions_sd(circling(0.9, 6.0), 40) < 0.6 * long
