"""Fingers that open and close fast: the detector follows them without falling behind and jumping after them."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mocapella.detectors import arm_following
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.evaluation.arms import score
from mocapella.kinematics.arm_quality import misdetected
from mocapella.model.arms import ARM_JOINTS
from mocapella.model.camera import Camera
from mocapella.sources.simulate.depth_scene import load_depth_scene


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_finger_that_is_stretched_within_an_image_or_two_is_followed(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_depth_scene("cloth", seed=seed, sensor="kinect")
    shots = list(scene.frames(30.0, 140 / 30, 175 / 30))
    camera = Camera("kinect", scene.sensor.size_px, scene.lens)
    joints = [shot.arms[0].points[list(ARM_JOINTS)] for shot in shots]
    assert any(misdetected(a, b, 0.05).jumped for a, b in pairwise(joints))  # fast, in truth
    assert score(KinematicArmDetector(camera), shots).misdetected.of_joints == 0
    monkeypatch.setattr(arm_following, "_CLEARLY", 0.0)  # without the freer fit
    assert score(KinematicArmDetector(camera), shots).misdetected.of_joints > 0
