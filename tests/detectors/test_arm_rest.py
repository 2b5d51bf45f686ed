"""Arms at rest: they are recognised by their motions' mean, and hardly tremble."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.detectors import arm_track
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.arm_track import CameraArmTrack
from mocapella.evaluation.arms import jitter
from mocapella.kinematics.arm_fit import ArmFitSettings, ArmPose, Fitted
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.model.camera import Camera
from mocapella.sources.simulate.depth_scene import load_depth_scene

STEP_S = 1 / 30
MODEL = KinematicArmDetector(Camera("any", (64, 48), np.array([60.0, 60, 32, 24, 0, 0, 0, 0, 0]))).models["right"]


def pose(x_m: float) -> ArmPose:
    return ArmPose(np.eye(3).reshape(9), np.array([x_m, 0.0, 0.8]), MODEL.natural.copy(), MODEL.state())


def moved(xs_m: list[float]) -> CameraArmTrack:
    """An arm whose palm was at these x, one an image."""
    arm = CameraArmTrack("right", MODEL, Fitted(pose(xs_m[0]), np.zeros(7)), 0.0, 1)
    for x in xs_m[1:]:
        arm.move(Fitted(pose(x), np.zeros(7)), STEP_S)
    return arm


def test_a_new_arm_counts_as_moving() -> None:
    assert moved([0.0]).rests < 0.01


@given(st.floats(0.0005, 0.003))
def test_an_arm_that_trembles_about_its_place_comes_to_rest_there(size_m: float) -> None:
    arm = moved([size_m * (-1) ** k for k in range(40)])
    assert arm.rests > 0.5
    now, rates = arm.fitted.pose, ArmFitSettings()
    ahead = arm.predicted(STEP_S)
    assert abs(ahead.t[0] - now.t[0]) < abs(arm.velocity[0]) * STEP_S / 2
    assert (arm.expected(ahead, STEP_S, rates).steady > 0).all()


@given(st.floats(0.006, 0.1), st.sampled_from([-1, 1]))
def test_an_arm_that_moves_on_is_predicted_at_its_velocity(step_m: float, way: int) -> None:
    arm = moved([way * step_m * k for k in range(40)])
    assert arm.rests < 0.05
    assert arm.predicted(STEP_S).t[0] - arm.fitted.pose.t[0] == pytest.approx(way * step_m, rel=0.05)


@given(st.floats(0.02, 0.2))
def test_an_arm_that_starts_is_no_longer_at_rest_in_the_next_image(step_m: float) -> None:
    assert moved([0.0] * 40).rests > 0.9
    assert moved([0.0] * 40 + [step_m]).rests < 0.2


@given(st.floats(1.0, 1e7), st.floats(0.0, 10.0), st.floats(1.0, 100.0))
def test_what_is_at_rest_is_held_near_its_prediction_and_released_beyond(
    information: float, near: float, factor: float
) -> None:
    """A part's prediction never pulls more than a Gaussian one would from 0.66 standard deviations."""
    weight = fit_kernels()._steady.py_func
    off = near * information**-0.5
    assert weight(information, 0.0) == information
    assert weight(information, (factor * off) ** 2) <= weight(information, off**2)
    assert weight(information, off**2) * off <= 0.66 * information**0.5
    assert weight(information, 400.0 / information) < 1e-3 * information


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "begin_s"), [("kinect", 1.9), ("sr305", 1.9)])
def test_a_still_hand_hardly_trembles(sensor: str, begin_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_depth_scene("still", seed=1, sensor=sensor)
    camera = Camera(sensor, scene.sensor.size_px, scene.lens)
    shots = list(scene.frames(30.0, begin_s, begin_s + 2.4))
    assert max(jitter(KinematicArmDetector(camera), shots).values()) <= 0.0015
    monkeypatch.setattr(arm_track, "_DRIFTS", 1e-6)  # no arm is at rest
    assert max(jitter(KinematicArmDetector(camera), shots).values()) > 0.0015
