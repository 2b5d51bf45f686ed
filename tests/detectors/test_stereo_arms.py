"""Arms before a stereo camera, whose images make fingers wider and have holes."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.fattening_guess import FATTENING_PX
from mocapella.evaluation.arms import matched
from mocapella.model.camera import Camera
from mocapella.model.hand import TIPS
from mocapella.sources.simulate.depth_scene import load_depth_scene


@pytest.mark.slow
def test_a_hand_is_found_and_what_is_measured_is_near_the_truth() -> None:
    scene = load_depth_scene("open-close", seed=3, sensor="stereo")
    detector = KinematicArmDetector(Camera("stereo", scene.sensor.size_px, scene.lens))
    tips, errors, found = [*TIPS], [], 0
    for k in range(20):
        shot = scene.at(k / 25)
        arm = matched(shot.arms[0], detector.update(shot.depth * np.float32(shot.unit_m), shot.at_s))
        if arm is not None:
            found += 1
            off = np.linalg.norm(arm.points[tips] - shot.arms[0].points[tips], axis=1)
            errors += off[arm.states[tips] == 2].tolist()
    assert detector._fattening.px == FATTENING_PX
    assert found >= 19
    assert np.median(errors) < 0.015
