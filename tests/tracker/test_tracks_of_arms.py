"""Tracks of arms: their settings, how far cameras are from the mean, and what decides between two views."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.arm_frames import arm_at, places, seen

from mocapella.model.arms import SeenArm
from mocapella.tracker.arm_tracks import ArmTracks, ArmTracksSettings

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
