"""Laws of lines of sight as constraints of a body: exact ones recover the pose, wrong ones are bounded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.plucker import join, residual
from mocapella.kinematics.keypoint_lines import (
    KeypointLineSettings,
    LandmarkLines,
    line_weights,
    meeting_points,
)
from mocapella.kinematics.twist_fit import OnLines, fit
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.twist_tree import TreePose

CENTRES = np.array([[3.0, 1.5, 2.0], [-3.0, 1.4, 2.2], [0.5, 1.6, -4.0], [-2.0, 2.4, -3.0]])
SEEDS = st.integers(0, 2**32 - 1)


def lines_to(points, cameras=4, sd_rad=0.005):
    """Exact lines from the first cameras to points (landmarks, 3)."""
    centres = CENTRES[:cameras]
    lines = join(centres[None], points[:, None])
    return LandmarkLines(lines, centres, np.full(lines.shape[:2], sd_rad))


def somewhere(seed, count=6):
    return np.random.default_rng(seed).uniform([-0.8, 0.0, -0.8], [0.8, 1.9, 0.8], (count, 3))


@given(SEEDS, st.integers(2, 4))
@settings(max_examples=50, deadline=None)
def test_exact_lines_of_two_cameras_or_more_meet_in_their_point(seed, cameras):
    points = somewhere(seed)
    met = meeting_points(lines_to(points, cameras), somewhere(seed + 1))
    assert met.agree.all()
    np.testing.assert_allclose(met.points, points, atol=1e-6)


@given(SEEDS, st.integers(0, 3))
@settings(max_examples=50, deadline=None)
def test_one_wrong_line_of_four_does_not_move_the_point(seed, wrong):
    points = somewhere(seed)
    given_lines = lines_to(points)
    given_lines.lines[:, wrong] = join(CENTRES[wrong], points + np.array([0.0, 0.8, 0.0]))
    met = meeting_points(given_lines, points)
    assert not met.agree[:, wrong].any()
    np.testing.assert_allclose(met.points, points, atol=1e-6)


def test_a_single_line_and_two_lines_in_one_direction_meet_nowhere():
    points = somewhere(1)
    assert not meeting_points(lines_to(points, 1), points).known.any()
    twice = lines_to(points, 2)
    twice.lines[:, 1] = twice.lines[:, 0]
    assert not meeting_points(twice, points).known.any()


def test_of_two_points_with_equally_many_lines_the_one_nearer_to_the_expected_counts():
    points = somewhere(2)
    other = points + np.array([0.0, 0.7, 0.0])
    both = lines_to(points)
    both.lines[:, 2:] = lines_to(other).lines[:, 2:]
    np.testing.assert_allclose(meeting_points(both, points).points, points, atol=1e-6)
    np.testing.assert_allclose(meeting_points(both, other).points, other, atol=1e-6)


@given(SEEDS, st.floats(0.0, 100.0))
@settings(max_examples=50, deadline=None)
def test_the_pull_of_a_single_wrong_line_is_bounded(seed, away_m):
    s, points = KeypointLineSettings(), somewhere(seed)
    alone = lines_to(points, 1)
    places = points + np.random.default_rng(seed).normal(size=(len(points), 3)) * away_m
    weights = line_weights(alone, meeting_points(alone, places), places)
    pull = weights[:, 0] * np.linalg.norm(residual(places, alone.lines[:, 0]), axis=-1)
    # The largest of r / s² / (1 + r² / (c s)²)² is at r = c s / √3.
    assert (pull <= s.agree_sd / s.misfit_m * 9.0 / (16.0 * np.sqrt(3.0)) + 1e-9).all()


def test_lines_that_meet_count_no_more_than_their_misfit_says_however_many_there_are():
    s, points = KeypointLineSettings(), somewhere(3)
    for cameras in (2, 3, 4):
        some = lines_to(points, cameras, sd_rad=1e-6)
        whole = line_weights(some, meeting_points(some, points), points).sum(axis=1)
        np.testing.assert_allclose(whole, s.misfit_m**-2, rtol=1e-3)


def test_a_line_that_is_not_seen_has_no_weight():
    points = somewhere(4)
    some = lines_to(points)
    some.lines[0, 1] = np.nan
    some.sds_rad[1, 2] = np.nan
    met = meeting_points(some, points)
    weights = line_weights(some, met, points)
    assert weights[0, 1] == weights[1, 2] == 0.0
    assert (np.delete(weights.ravel(), [1, 6]) > 0).all()
    assert met.known.all()
    none = some.without(np.ones(len(points), np.bool_))
    assert not line_weights(none, meeting_points(none, points), points).any()


def test_exact_lines_alone_recover_the_landmarks_of_a_pose():
    mesh, rng = body_mesh("male", 1.78), np.random.default_rng(5)
    usual = np.clip(0.0, *mesh.tree.limits.T)
    pose = TreePose(np.eye(4), np.clip(usual + rng.uniform(-0.4, 0.4, len(usual)), *mesh.tree.limits.T))
    truth = landmarks_at(mesh, pose)
    marks = list(mesh.landmarks.values())
    part, rest = np.array([mark.part for mark in marks]), np.array([mark.point for mark in marks])
    given_lines = lines_to(truth)
    at = TreePose(np.eye(4), usual)
    for _ in range(5):
        places = landmarks_at(mesh, at)
        weights = line_weights(given_lines, meeting_points(given_lines, places), places)
        which, camera = np.nonzero(weights)
        on = OnLines(part[which], rest[which], given_lines.lines[which, camera], weights[which, camera])
        at = fit(mesh.tree, at, [on]).pose
    assert np.linalg.norm(landmarks_at(mesh, at) - truth, axis=1).max() < 1e-3


@pytest.mark.parametrize(
    "wrong",
    [
        {"joint_sd": 0.0}, {"least_sd_px": 0.0}, {"misfit_m": 0.0}, {"least_confidence": 1.0}, {"agree_sd": 0.0},
        {"least_angle_rad": 0.0}, {"contradicts_m": 0.0},
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        KeypointLineSettings(**wrong)
