"""Views of an arm become one: by information, measured before inferred, and not halfway between two that disagree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.fusion.arm_points import fuse_angles, fuse_points, fuse_poses
from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y


def one_point(places: list[float], states: list[int], sd: list[float], expected: float = np.nan):  # type: ignore[no-untyped-def]
    """Views of one point on the x axis."""
    points = np.array([[[x, 0.0, 0.0]] for x in places])
    return fuse_points(
        points, np.array(states, np.uint8)[:, None], np.array(sd)[:, None], np.array([[expected, 0.0, 0.0]])
    )


@given(st.integers(1, 4), st.integers(1, 23), st.integers(0, 9999))
@settings(max_examples=50)
def test_the_order_of_views_does_not_matter_and_what_is_alike_stays(views: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = rng.normal(size=(n, 3))
    points = true + 0.002 * rng.normal(size=(views, n, 3))
    states, sd = rng.integers(0, 3, (views, n)).astype(np.uint8), rng.uniform(0.002, 0.01, (views, n))
    points[states == 0] = np.nan
    nowhere = np.full((n, 3), np.nan)
    order = rng.permutation(views)
    one, other = fuse_points(points, states, sd, nowhere), fuse_points(points[order], states[order], sd[order], nowhere)
    np.testing.assert_allclose(one.points, other.points, atol=1e-12)
    np.testing.assert_array_equal(one.states, states.max(axis=0))
    np.testing.assert_array_equal(np.isnan(one.points[:, 0]), one.states == 0)
    np.testing.assert_array_equal(np.isnan(one.sd), one.states == 0)
    same = fuse_points(np.broadcast_to(true, points.shape), np.full((views, n), 2, np.uint8), sd, nowhere)
    np.testing.assert_allclose(same.points, true, atol=1e-12)
    assert not same.disputed.any()


def test_the_surer_view_counts_more_and_two_are_surer_than_one() -> None:
    told = one_point([0.0, 0.01], [2, 2], [0.004, 0.008])
    np.testing.assert_allclose(told.points[0, 0], 0.01 * 0.2)
    assert told.sd[0] < 0.004
    np.testing.assert_allclose(told.weights[0] / told.weights[1], 4.0)


def test_views_that_agree_less_than_they_say_are_less_sure() -> None:
    alike, apart = one_point([0.0, 0.0], [2, 2], [0.003, 0.003]), one_point([0.0, 0.018], [2, 2], [0.003, 0.003])
    assert apart.sd[0] > 1.5 * alike.sd[0]
    assert not apart.disputed.any()


def test_what_is_measured_is_not_mixed_with_what_is_inferred() -> None:
    told = one_point([0.5, 0.51], [1, 2], [0.001, 0.02])
    assert (told.points[0, 0], told.states[0]) == (0.51, 2)
    assert not told.disputed.any()


def test_of_two_that_disagree_the_expected_one_is_believed_and_else_the_surer() -> None:
    for expected, believed in ((0.0, 0.0), (0.11, 0.1), (np.nan, 0.1)):
        told = one_point([0.0, 0.1], [2, 2], [0.005, 0.004], expected)
        np.testing.assert_allclose(told.points[0, 0], believed)
        assert told.disputed[:, 0].tolist() == [believed != 0.0, believed == 0.0]


@pytest.mark.parametrize(("sd", "gate_m"), [([0.003, 0.004], 0.025), ([0.006, 0.008], 0.04), ([0.03, 0.04], 0.06)])
def test_views_agree_up_to_a_centimetre_and_three_sds_of_their_distance_but_six_centimetres_at_most(
    sd: list[float], gate_m: float
) -> None:
    near, far = (one_point([0.0, distance], [2, 2], sd) for distance in (0.999 * gate_m, 1.001 * gate_m))
    assert near.disputed[:, 0].tolist() == [False, False]
    assert far.disputed[:, 0].tolist() == [False, True]


def test_two_of_three_outvote_what_was_expected() -> None:
    told = one_point([0.0, 0.1, 0.101], [2, 2, 2], [0.004] * 3, 0.0)
    np.testing.assert_allclose(told.points[0, 0], 0.1005)
    assert told.disputed[:, 0].tolist() == [True, False, False]


def test_nobody_is_surer_than_the_least_and_who_does_not_say_is_unsure() -> None:
    told = one_point([0.0, 0.0], [2, 2], [0.0, np.nan])
    np.testing.assert_allclose(1.0 / np.sqrt(told.weights[:, 0]), [0.003, 0.02])


def test_a_digits_angles_are_those_of_the_view_that_sees_it() -> None:
    weights = np.zeros((2, 23))
    weights[0, 1:5], weights[1, 5:9] = 1e5, 1e5  # the thumb, the index finger
    angles = np.stack([np.full(21, 0.1), np.full(21, 0.5)])
    angles[0, 20], angles[:, 13] = np.nan, np.nan
    out = fuse_angles(angles, weights)
    np.testing.assert_allclose(out[:5], 0.1, atol=1e-9)
    np.testing.assert_allclose(out[5:9], 0.5, atol=1e-9)
    np.testing.assert_allclose(out[9], 0.3)  # nobody sees the middle finger
    np.testing.assert_allclose(out[20], 0.5)
    assert np.isnan(out[13])


def test_the_fused_pose_is_a_rotation_between_and_that_of_one_view_is_its_own() -> None:
    T = np.stack([rigid(rotation_about_y(a), [a, 0.0, 0.0]) for a in (0.1, 0.3)])
    weights = np.ones((2, 23))
    both = fuse_poses(T, weights)
    assert both is not None
    np.testing.assert_allclose(both, rigid(rotation_about_y(0.2), [0.2, 0.0, 0.0]), atol=1e-12)
    alone = rigid(rotation_about_x(1.0), [1.0, 2.0, 3.0])
    one = fuse_poses(alone[None], np.zeros((1, 23)))
    assert one is not None
    np.testing.assert_allclose(one, alone, atol=1e-12)
    assert fuse_poses(np.zeros((0, 4, 4)), np.zeros((0, 23))) is None
