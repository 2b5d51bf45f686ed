"""A fist that opens: its arm is not confused with the other end of the arm, and hidden fingertips are not measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.arm_variety import FPS, OPENING, clip
from mocapella.detectors import arm_track
from mocapella.detectors.arm_finding import ArmFinder, Found
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.arm_starts import arm_starts, fists_behind_fingers
from mocapella.detectors.arm_track import CameraArmTrack
from mocapella.evaluation.arms import matched
from mocapella.kinematics.arm_fit import ArmPose, Fitted, kernels
from mocapella.model.camera import Camera
from mocapella.model.hand import TIPS
from mocapella.sensing.arm_region import PalmCandidate, Region

DETECTOR = KinematicArmDetector(Camera("any", (640, 480), np.array([385.0, 385.0, 320.0, 240.0])))
FINDER, MODEL = DETECTOR.finder, DETECTOR.models["right"]


def fit_at(x: float, cost: float = 0.2) -> Found:
    """Return a fit of a right hand, x [m] beside the camera's axis."""
    pose = ArmPose(np.eye(3).reshape(9), np.array([x, 0.0, 0.5]), MODEL.natural.copy(), MODEL.state())
    return Found(cost, "right", Fitted(pose, np.zeros(7)))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "from_image"), [(305, 0), (309, 0), (318, 0), (540, 0)])
def test_a_fist_is_found_although_the_other_end_of_its_arm_fits_as_well(seed: int, from_image: int) -> None:
    detector = None
    for k, (depth, lens, truth, _) in enumerate(clip(OPENING, seed)):
        height, width = depth.shape
        detector = detector or KinematicArmDetector(Camera("fist", (width, height), lens))
        arm = matched(truth, detector.update(depth, k / FPS))
        if k >= from_image:
            assert arm is not None
            assert arm.left == truth.left
        if k == 4:
            break


def test_fits_that_overlap_by_way_of_others_are_judged_on_the_same_points(monkeypatch: pytest.MonkeyPatch) -> None:
    chain, far = [fit_at(0.0), fit_at(0.075), fit_at(0.15)], fit_at(0.6)
    assert not FINDER.overlap(chain[0], chain[2])
    judged_on: list[int] = []

    def region(_: ArmFinder, depth: np.ndarray, spheres: np.ndarray) -> None:
        judged_on.append(len(spheres))

    monkeypatch.setattr(ArmFinder, "region", region)
    FINDER.judged(np.zeros((480, 640), np.float32), [chain[0], chain[2], far, chain[1]])
    one = len(MODEL.spheres(far.fitted.pose))
    assert sorted(judged_on) == [one, 3 * one]


def test_the_own_cost_of_a_fit_counts_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    hand, other = fit_at(0.0, 0.10), fit_at(0.05, 0.20)
    around = {id(hand): 0.30, id(other): 0.15}
    part = Region(np.zeros((50, 3)), np.zeros((4, 4)), np.zeros((4, 4), np.int64), np.ones(4))
    monkeypatch.setattr(ArmFinder, "region", lambda *_: part)
    monkeypatch.setattr(ArmFinder, "_around_cost", lambda _, one, *__: around[id(one)])
    depth = np.zeros((480, 640), np.float32)
    assert FINDER.judged(depth, [other, hand]) == [hand, other]
    around[id(hand)] = 0.36
    assert FINDER.judged(depth, [hand, other]) == [other, hand]


def test_of_fits_that_overlap_the_best_remains() -> None:
    a, b, c = fit_at(0.0), fit_at(0.075), fit_at(0.15)
    assert FINDER.alone([a, b, c]) == [a, c]
    assert FINDER.alone([b, a, c]) == [b]


def test_a_fist_is_tried_although_ends_of_branches_are_seen() -> None:
    tips = np.array([[0.0, -0.09, 0.5], [0.02, -0.09, 0.5]])
    down = np.array([0.0, 1.0, 0.0])
    candidate = PalmCandidate(
        np.array([0.0, 0.0, 0.5]), 0.035, np.array([0.0, 0.0, -1.0]), down, tips, np.zeros((0, 5))
    )
    assert any(targets is None for _, targets in arm_starts(MODEL, candidate))


@pytest.mark.parametrize("ends", [0, 1, 3, 4])
def test_a_fist_whose_palm_faces_the_camera_may_be_started_behind_its_fingers(ends: int) -> None:
    tips = np.array([[0.02 * k, -0.09, 0.5] for k in range(ends)]).reshape(-1, 3)
    candidate = PalmCandidate(
        np.array([0.0, 0.0, 0.5]), 0.035, np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]), tips, np.zeros((0, 5))
    )
    starts = list(fists_behind_fingers(MODEL, candidate))
    assert bool(starts) == (ends < 4)
    for pose in starts:
        assert pose.R.reshape(3, 3)[2, 1] > 0.9  # the back points away from the camera
        assert pose.t[2] - 0.5 > 0.04
    assert all(pose.t[2] - 0.5 < 0.02 for pose, _ in arm_starts(MODEL, candidate))


@pytest.mark.slow
def test_a_fist_whose_palm_faces_the_camera_is_found_in_the_first_image() -> None:
    depth, lens, truth, _ = next(clip(OPENING, 429))
    height, width = depth.shape
    arm = matched(truth, KinematicArmDetector(Camera("fist", (width, height), lens)).update(depth, 0.0))
    assert arm is not None
    off_m = np.linalg.norm(arm.points[[*TIPS]] - truth.points[[*TIPS]], axis=1)
    assert off_m.max() < 0.03


@given(st.lists(st.floats(-0.01, 0.02), min_size=1, max_size=20))
def test_a_fingertip_is_clear_once_every_other_posture_costs_more(clearness: list[float]) -> None:
    arm = CameraArmTrack("right", MODEL, fit_at(0.0).fitted, 0.0, 1)
    assert not arm.clear.any()
    for value in clearness:
        before = bool(arm.clear[2])
        arm.check(2, value)
        assert arm.clear[2] == (value > (arm_track._STILL_CLEAR if before else arm_track._CLEAR))
    assert not arm.clear[[0, 1, 3, 4]].any()


def test_a_fingertip_counts_if_it_was_visible_shortly_before_and_other_landmarks_at_once() -> None:
    arm = CameraArmTrack("right", MODEL, fit_at(0.0).fitted, 0.0, 1)
    hidden, seen = np.zeros(23), np.ones(23)
    for _ in range(2):
        np.testing.assert_array_equal(arm.confirmed(hidden), hidden)
    shares = arm.confirmed(seen)
    assert not shares[[*TIPS]].any()
    assert np.delete(shares, [*TIPS]).all()
    np.testing.assert_array_equal(arm.confirmed(seen), seen)
    np.testing.assert_array_equal(arm.confirmed(hidden), hidden)
    np.testing.assert_array_equal(arm.confirmed(seen), seen)  # hidden in one image only
    np.testing.assert_array_equal(CameraArmTrack("right", MODEL, fit_at(0.0).fitted, 0.0, 1).confirmed(seen), seen)


@pytest.mark.parametrize(("cost", "replaced"), [(0.1, True), (0.25, False)])
def test_a_reported_arm_is_not_replaced_by_one_that_could_not_be_reported(
    monkeypatch: pytest.MonkeyPatch, cost: float, replaced: bool
) -> None:
    def track(cost: float) -> CameraArmTrack:
        costs = np.zeros(7)
        costs[0] = cost / kernels().COSTS[0]
        arm = CameraArmTrack("right", MODEL, fit_at(0.0).fitted._replace(costs=costs), 0.0, 1)
        assert arm.fitted.cost == pytest.approx(cost)
        return arm

    detector = KinematicArmDetector(DETECTOR.camera)
    reported, other = track(0.05), track(cost)
    reported.believed = True
    detector._arms = [reported]
    monkeypatch.setattr(ArmFinder, "judged", lambda _, depth, found: found)  # the new one is the better one
    detector._admit(other, np.zeros((480, 640), np.float32))
    assert detector._arms == [other if replaced else reported]
