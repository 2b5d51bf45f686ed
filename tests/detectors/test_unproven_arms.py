"""Arms without a good fit yet: their side and posture may be wrong, so they are soon searched anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.arm_variety import FPS, OPENING, clip
from mocapella.detectors import arm_track
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.detectors.arm_track import CameraArmTrack
from mocapella.evaluation.arms import matched, score
from mocapella.kinematics.arm_fit import ArmPose, Fitted
from mocapella.model.camera import Camera
from mocapella.model.hand import TIPS
from mocapella.sources.simulate.depth_scene import load_depth_scene

MODEL = KinematicArmDetector(Camera("any", (64, 48), np.array([60.0, 60, 32, 24, 0, 0, 0, 0, 0]))).models["right"]
S = KinematicArmSettings()
GOOD = arm_track._PROVEN * S.doubt


def fit_of(cost: float) -> Fitted:
    pose = ArmPose(np.eye(3).reshape(9), np.array([0.0, 0.0, 0.8]), MODEL.natural.copy(), MODEL.state())
    return Fitted(pose, np.array([cost, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))


def arm_of(costs: list[float]) -> CameraArmTrack:
    arm = CameraArmTrack("right", MODEL, fit_of(costs[0]), 0.0, S.look_again_after)
    for cost in costs:
        arm.fitted = fit_of(cost)
        arm.count_doubt(cost > S.doubt, S)
    return arm


@given(st.lists(st.floats(GOOD + 0.001, S.firm - 0.001), min_size=1, max_size=20))
def test_until_a_good_fit_an_arm_stays_in_doubt_and_is_due_after_some_images(costs: list[float]) -> None:
    arm = arm_of(costs)
    assert not arm.proven
    assert arm.in_doubt == sum(cost > S.doubt for cost in costs)
    assert arm.is_due(S) == (arm.in_doubt >= arm_track._SOON)


@given(st.integers(0, 20), st.floats(0.0, GOOD - 0.001), st.integers(0, 20))
def test_after_a_good_fit_one_image_ends_the_doubt_and_an_arm_waits_for_longer(n: int, good: float, more: int) -> None:
    arm = arm_of([S.doubt + 0.01] * n + [good] + [S.doubt + 0.01] * more)
    assert arm.proven
    assert arm.in_doubt == more
    assert arm.is_due(S) == (more >= S.look_again_after)
    assert arm_of([good] + [S.doubt + 0.01] * more + [S.doubt - 0.001]).in_doubt == 0


@given(st.integers(1, 20))
def test_what_is_perhaps_no_arm_is_not_searched_so_soon(n: int) -> None:
    assert arm_of([S.firm] * n).is_due(S) == (n >= S.look_again_after)


@pytest.mark.slow
def test_a_hand_whose_best_start_is_on_the_wrong_side_is_soon_on_the_right_one() -> None:
    scene = load_depth_scene("fist", seed=0, sensor="sr305")
    begin_s = scene.period_s / 6 + 0.5
    shots = scene.frames(30.0, begin_s, begin_s + 1.0)
    found = score(KinematicArmDetector(Camera("sr305", scene.sensor.size_px, scene.lens)), shots).table()
    assert found["named"] >= 0.9


@pytest.mark.slow
def test_a_fist_that_fits_badly_is_better_where_it_is_soon_searched_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    shots = list(clip(OPENING, 305))

    def median_error_m() -> float:
        (height, width), off = shots[0][0].shape, []
        detector = KinematicArmDetector(Camera("stereo", (width, height), shots[0][1]))
        for k, (depth, _, truth, _) in enumerate(shots):
            arm = matched(truth, detector.update(depth, k / FPS))
            if arm is not None:
                tips = np.linalg.norm(arm.points - truth.points, axis=1)[[*TIPS]]
                off += tips[truth.seen[[*TIPS]]].tolist()
        return float(np.median(off))

    soon = median_error_m()
    monkeypatch.setattr(arm_track, "_SOON", 1000)
    assert soon < 0.9 * median_error_m()
