"""Tracks of arms: their settings, how far cameras are from the mean, and what decides between two views."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arm_frames import arm_at, places, seen

from mocapella.model.arms import PALM, WRIST, SeenArm
from mocapella.tracker.arm_tracks import ArmTrack, ArmTracks, ArmTracksSettings

INDEX_TIP = 8


def exact(points: np.ndarray, camera: str) -> SeenArm:
    return seen(points, camera, np.random.default_rng(0), noise_m=0.0)


@pytest.mark.parametrize(("settings", "ids"), [(None, [1]), (ArmTracksSettings(keep_s=5.0), [0])])
def test_an_arm_that_was_gone_for_two_seconds_keeps_its_id_if_the_settings_keep_it_so_long(
    settings: ArmTracksSettings | None, ids: list[int]
) -> None:
    tracks = ArmTracks(settings)
    assert tracks.settings == (settings or ArmTracksSettings())
    for at_s in (0.0, 2.0):
        tracks.update("a", [exact(arm_at(0.0), "a")], at_s, places())
    assert [arm.id for arm in tracks.tracked_arms()] == ids


@pytest.mark.parametrize("hz", [12, 30])
def test_the_distance_of_a_camera_comes_to_the_true_one_within_seconds_at_any_frame_rate(hz: int) -> None:
    """After a time constant, two seconds, a first-order filter is 1 − 1/e of the way."""
    tracks = ArmTracks()
    apart = {"a": 0.0, "b": 0.04}  # 2 cm each from the mean
    for k in range(2 * hz + 1):
        for camera, aside in apart.items():
            tracks.update(camera, [exact(arm_at(0.0) + np.array([aside, 0.0, 0.0]), camera)], k / hz, places())
    assert [away for away, _ in tracks.away.values()] == pytest.approx(2 * [0.02 * (1 - 1 / math.e)], rel=0.01)


@pytest.mark.parametrize("behind_m", [0.08, -0.08])
def test_of_two_views_that_disagree_the_one_on_the_path_of_a_moving_arm_is_right(behind_m: float) -> None:
    """At 2 m/s, a finger that one camera places 8 cm farther back would be on the path of one that moves back."""
    tracks = ArmTracks()
    for k in range(46):
        at_s = k / 60
        true, camera = arm_at(0.0) + np.array([2.0 * at_s - 1.0, 0.0, 0.0]), "ab"[k % 2]
        told = true.copy()
        if camera == "b" and at_s > 0.5:
            told[INDEX_TIP] -= [behind_m, 0.0, 0.0]
        tracks.update(camera, [exact(told, camera)], at_s, places())
        (arm,) = tracks.tracked_arms()
        if at_s > 0.2:
            assert np.linalg.norm(arm.points[INDEX_TIP] - true[INDEX_TIP]) < 0.02, at_s
    assert arm.cameras == ("a", "b")
    assert tracks.disputed > 10


def a_track(points: np.ndarray, velocity: np.ndarray, evidence: float = 0.0, at_s: float = 10.0) -> ArmTrack:
    return ArmTrack(0, {}, evidence, at_s, at_s, points, velocity, np.full(23, 2, np.uint8), np.zeros(23, np.float32),
                    np.zeros(21), None)  # fmt: skip


@given(st.floats(-50, 50) | st.just(0.0))
def test_an_arm_is_left_if_its_side_is_above_0_and_the_side_is_odd_in_the_evidence(evidence: float) -> None:
    track, other = (a_track(arm_at(0.0), np.zeros((23, 3)), sign * evidence) for sign in (1, -1))
    assert track.left == (evidence > 0)
    assert track.side == -other.side
    assert -1 <= track.side <= 1
    sure = 1 / (1 + math.exp(-evidence))  # the probability of a left arm
    assert track.side == pytest.approx(2 * sure - 1, abs=1e-12)


@pytest.mark.parametrize(("after_s", "moves_s"), [(0.0, 0.0), (0.05, 0.05), (0.1, 0.1), (3.0, 0.1), (-0.05, -0.05),
                                                  (-3.0, -0.1)])  # fmt: skip
def test_a_palm_is_moved_on_for_as_long_as_is_allowed_forwards_and_backwards(after_s: float, moves_s: float) -> None:
    points, velocity = arm_at(0.0), np.tile([0.5, -1.0, 2.0], (23, 1))
    velocity[WRIST] = [-3.0, 0.0, 0.0]
    track = a_track(points, velocity)
    np.testing.assert_allclose(track.palm_at(10.0 + after_s, 0.1), points[PALM] + moves_s * velocity[PALM], atol=1e-12)
    track.points = points.copy()
    track.points[PALM] = np.nan
    np.testing.assert_allclose(
        track.palm_at(10.0 + after_s, 0.1), points[WRIST] + moves_s * velocity[WRIST], atol=1e-12
    )
