"""Arms before a stereo camera, whose images make fingers wider and have holes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.arm_variety import FPS, OPENING, clip
from mocapella.detectors.arm_finding import ArmFinder, Found
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.arm_track import CameraArmTrack
from mocapella.detectors.fattening_guess import FATTENING_PX
from mocapella.evaluation.arms import matched
from mocapella.kinematics.arm_fit import ArmPose, Fitted
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


@pytest.mark.slow
def test_a_small_fist_is_found_although_the_cut_end_of_its_forearm_fits_as_well() -> None:
    detector, found = None, []
    for k, (depth, lens, truth, _) in enumerate(clip(OPENING, seed=28)):
        height, width = depth.shape
        detector = detector or KinematicArmDetector(Camera("stereo", (width, height), lens))
        found.append(matched(truth, detector.update(depth, k / FPS)) is not None)
        if k == 3:
            break
    assert detector is not None
    assert detector._fattening.px == FATTENING_PX
    assert found[1:] == [True] * 3


def _fit(detector: KinematicArmDetector, x: float, cost: float) -> Found:
    """Return a fit of a right hand, x [m] beside the camera's axis."""
    model = detector.models["right"]
    pose = ArmPose(np.eye(3).reshape(9), np.array([x, 0.0, 0.5]), model.natural.copy(), model.state())
    return Found(cost, "right", Fitted(pose, np.zeros(7)))


def test_fits_to_other_surfaces_are_no_evidence_for_the_kind_of_camera() -> None:
    detector = KinematicArmDetector(Camera("stereo", (640, 480), np.array([385.0, 385.0, 320.0, 240.0])))
    hand, elsewhere = _fit(detector, 0.0, 0.2), _fit(detector, 0.4, 0.18)
    again = _fit(detector, 0.01, 0.32)
    assert detector._of_same_hands([elsewhere], [hand], [again], [hand]) == ([0.32], [0.2])
    near = _fit(detector, 0.02, 0.25)
    assert detector._of_same_hands([elsewhere, near], [hand], [again], [hand]) == ([0.25, 0.32], [0.2])
    assert detector._of_same_hands([elsewhere], [], [], []) == ([0.18], [])


def test_the_likeliest_hand_tells_the_kind_of_camera_not_the_cheapest_fit() -> None:
    detector = KinematicArmDetector(Camera("stereo", (640, 480), np.array([385.0, 385.0, 320.0, 240.0])))
    hand, cheaper = _fit(detector, 0.0, 0.2), _fit(detector, 0.4, 0.1)
    again = [_fit(detector, 0.0, 0.3), _fit(detector, 0.4, 0.15)]
    assert detector._of_same_hands([], [hand, cheaper], again, [hand]) == ([0.3], [0.2])


def test_an_arm_that_is_mostly_hidden_is_not_reported_although_its_visible_part_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    detector = KinematicArmDetector(Camera("stereo", (640, 480), np.array([385.0, 385.0, 320.0, 240.0])))
    fitted = _fit(detector, 0.0, 0.0).fitted
    arm = CameraArmTrack("right", detector.models["right"], fitted, 0.0, 1)
    detector._arms = [arm]
    assert fitted.cost < detector.settings.firm
    monkeypatch.setattr(ArmFinder, "shown_cost", lambda *_: 0.25)
    assert not detector._believed()
    monkeypatch.setattr(ArmFinder, "shown_cost", lambda *_: 0.1)
    assert detector._believed() == [arm]
