"""The penalty on accelerations of a body's skin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.silhouette_pictures import pose_at, somebody

from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.twist_fit import fit
from mocapella.model.twist_tree import TreePose, motions
from mocapella.tracker.limb_stillness import HeldPoints
from mocapella.tracker.silhouette_body import SKIN_POINTS, SilhouetteBody
from mocapella.tracker.silhouette_settings import Steadiness
from mocapella.tracker.surface_prior import AT_FIRST_M_PER_S, LATELY_S, SurfacePrior

BODY = SilhouetteBody(somebody())
SINCE_S = 1 / 60
PER_S2 = SINCE_S**-2
USUAL = Steadiness()


def standing(seed=0, aside_m=0.0):
    """Some pose within the limits."""
    rng, tree = np.random.default_rng(seed), BODY.mesh.tree
    T = exp_twist(rng.normal(0, 0.3, 6))
    return BODY.standing(TreePose(rigid(np.eye(3), [aside_m, 0, 0]) @ T, rng.uniform(*tree.limits.T)))


def given_to(skin, stands):
    return skin.steady(stands, motions(BODY.mesh.tree, stands.pose))


def at_rest(steadiness=USUAL):
    skin = SurfacePrior(BODY, steadiness)
    for _ in range(round(20 * LATELY_S / SINCE_S)):
        skin.expect(standing(), SINCE_S, PER_S2)
        skin.learn(standing())
    skin.expect(standing(), SINCE_S, PER_S2)
    return skin


def test_points_that_are_held_are_wanted_where_they_came_to_rest_and_others_where_expected():
    skin, stands = at_rest(), standing()
    points = np.arange(len(BODY.skin)) % 2 == 0
    before = given_to(skin, stands)
    skin.hold(HeldPoints(points, stands.vertices[BODY.skin] + 0.1))
    wanted = given_to(skin, stands)
    assert np.allclose(wanted.targets[points], stands.vertices[BODY.skin][points] + 0.1)
    assert np.array_equal(wanted.targets[~points], before.targets[~points])
    assert (wanted.weights[points] >= USUAL.still_m**-2).all()
    assert np.array_equal(wanted.weights[~points], before.weights[~points])


def test_of_one_camera_only_points_that_are_held_are_wanted_anywhere():
    skin, stands = at_rest(), standing()
    moved = motions(BODY.mesh.tree, stands.pose)
    assert not len(skin.steady(stands, moved, held_alone=True).part)
    points = np.arange(len(BODY.skin)) % 3 == 0
    skin.hold(HeldPoints(points, stands.vertices[BODY.skin] + 0.1))
    some, every = skin.steady(stands, moved, held_alone=True), skin.steady(stands, moved)
    for name in ("part", "points", "targets", "weights"):
        assert np.array_equal(getattr(some, name), getattr(every, name)[points])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_nothing_is_wanted_of_a_body_that_is_as_expected(seed):
    skin, stands = SurfacePrior(BODY, USUAL), standing(seed)
    skin.expect(stands, SINCE_S, PER_S2)
    wanted = given_to(skin, stands)
    R, t = motions(BODY.mesh.tree, stands.pose)
    at = np.einsum("nij,nj->ni", R[wanted.part].reshape(-1, 3, 3), wanted.points) + t[wanted.part]
    np.testing.assert_allclose(at, wanted.targets, atol=1e-12)


def test_alone_it_brings_a_body_back_to_where_it_is_expected():
    expected = BODY.standing(pose_at(BODY.mesh))
    skin = SurfacePrior(BODY, USUAL)
    skin.expect(expected, SINCE_S, PER_S2)
    angles = expected.pose.angles.copy()
    angles[:4] += 0.1
    pose = TreePose(exp_twist(np.array([0.02, -0.01, 0.03, 0.05, 0.0, 0.04])) @ expected.pose.T_world_model, angles)
    for _ in range(8):
        stands = BODY.standing(pose)
        pose = fit(BODY.mesh.tree, pose, [given_to(skin, stands)]).pose
    missed = np.linalg.norm(BODY.standing(pose).landmarks - expected.landmarks, axis=1)
    assert missed.max() < 0.005


def test_every_part_has_as_many_points():
    parts = np.bincount(BODY.figure.part[BODY.skin], minlength=len(BODY.mesh.part_names))
    assert set(parts[parts > 0]) == {SKIN_POINTS}


def test_who_is_at_rest_is_held_by_the_acceleration_of_the_settings():
    weights = given_to(at_rest(), standing()).weights
    np.testing.assert_allclose(weights, (PER_S2 / USUAL.point_m_per_s2) ** 2, rtol=1e-6)


def test_at_first_nobody_is_held_as_at_rest():
    """Recordings begin amid motion."""
    skin = SurfacePrior(BODY, USUAL)
    skin.expect(standing(), SINCE_S, PER_S2)
    most = np.hypot(USUAL.point_m_per_s2, USUAL.point_per_s * AT_FIRST_M_PER_S)
    np.testing.assert_allclose(given_to(skin, standing()).weights, (PER_S2 / most) ** 2)


@pytest.mark.parametrize("speed_m_per_s", [0.5, 2.0])
def test_who_moves_is_held_less(speed_m_per_s):
    skin = at_rest()
    skin.expect(standing(aside_m=speed_m_per_s * SINCE_S), SINCE_S, PER_S2)
    most = np.hypot(USUAL.point_m_per_s2, USUAL.point_per_s * speed_m_per_s)
    np.testing.assert_allclose(given_to(skin, standing()).weights, (PER_S2 / most) ** 2)


def test_who_was_accelerated_is_held_less_until_it_is_forgotten():
    skin, off_m = at_rest(), 0.01
    skin.learn(standing(aside_m=off_m))
    skin.expect(standing(aside_m=off_m), SINCE_S, PER_S2)
    most = np.hypot(USUAL.point_m_per_s2, USUAL.point_per_past * off_m * PER_S2)
    np.testing.assert_allclose(given_to(skin, standing()).weights, (PER_S2 / most) ** 2, rtol=1e-6)
    for _ in range(round(20 * LATELY_S / SINCE_S)):
        skin.learn(standing(aside_m=off_m))
        skin.expect(standing(aside_m=off_m), SINCE_S, PER_S2)
    np.testing.assert_allclose(given_to(skin, standing()).weights, (PER_S2 / USUAL.point_m_per_s2) ** 2, rtol=1e-3)
