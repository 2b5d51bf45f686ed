"""The prediction goes on as before, and being elsewhere costs the same wherever the world's origin lies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support import twist_trees as trees

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.kinematics.twist_fit import FitSettings, fit, normal_equations
from mocapella.kinematics.twist_prediction import JitterPenalty, looser, predicted, smoothness
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=20, deadline=None)
FINE = FitSettings(most_steps=60, rest_m=1e-11, rest_rad=1e-11)
PENALTY = JitterPenalty(root_per_m=20.0, root_per_rad=10.0, angle_per_rad=5.0)


def same(one: TreePose, other: TreePose, atol: float = 1e-10) -> None:
    np.testing.assert_allclose(one.T_world_model, other.T_world_model, atol=atol)
    np.testing.assert_allclose(one.angles, other.angles, atol=atol)


def screw(rng: np.random.Generator, begun: TreePose) -> tuple[Float64, Float64]:
    """A twist of the root in the world, and velocities of the angles."""
    return 0.5 * rng.normal(size=6), rng.normal(size=begun.angles.shape)


@few
@given(seeds, st.sampled_from([0.0, 0.5, 1.0, 2.3]))
def test_a_motion_that_goes_on_is_predicted_exactly(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    begun = trees.pose(rng, trees.tree(rng))
    twist, velocity = screw(rng, begun)

    def at(t: float) -> TreePose:
        return TreePose(exp_twist(t * twist) @ begun.T_world_model, begun.angles + t * velocity)

    same(predicted(at(0), at(1), ratio), at(1 + ratio))


@few
@given(seeds)
def test_the_prediction_moves_with_the_world_and_not_with_the_models_rest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    before = trees.pose(rng, model)
    last = trees.near(rng, model, before, 0.3)
    G, K = exp_twist(2 * rng.normal(size=(2, 6)))

    def there(pose: TreePose) -> TreePose:
        return TreePose(G @ pose.T_world_model @ K, pose.angles)

    same(predicted(there(before), there(last), 1.5), there(predicted(before, last, 1.5)))


def test_batches_are_what_each_alone_is() -> None:
    rng = np.random.default_rng(0)
    T, angles = exp_twist(rng.normal(size=(2, 3, 6))), rng.normal(size=(2, 3, 4))
    before, last = (TreePose(T[k], angles[k]) for k in range(2))
    one = predicted(TreePose(T[0, 1], angles[0, 1]), TreePose(T[1, 1], angles[1, 1]))
    np.testing.assert_allclose(predicted(before, last).T_world_model[1], one.T_world_model, atol=1e-14)
    np.testing.assert_array_equal(predicted(before, last).angles[1], one.angles)


@few
@given(seeds)
def test_what_stands_still_is_predicted_where_it_is_and_costs_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    at = trees.pose(rng, model)
    prediction = predicted(at, at)
    same(prediction, at, atol=1e-14)
    prior = smoothness(model, prediction, PENALTY)
    assert normal_equations(model, at, [], [prior]).cost == pytest.approx(0, abs=1e-24)
    found = fit(model, at, [trees.seen(rng, model, at)], [prior])
    assert found.prior_cost == pytest.approx(0, abs=1e-18)
    same(found.pose, at)


@few
@given(seeds, st.sampled_from([1e-6, 0.1, 1.0]))
def test_the_penalty_is_of_the_way_the_turn_and_the_angles_wherever_the_origin_lies(seed: int, far: float) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    prediction = trees.pose(rng, model)
    at = trees.near(rng, model, prediction, far)
    prior = smoothness(model, prediction, PENALTY)
    way, turn, angles = trees.deviation(model, at, prior)
    said = 20.0**2 * way @ way + 10.0**2 * turn @ turn + 5.0**2 * angles @ angles
    cost = normal_equations(model, at, [], [prior]).cost
    assert cost == pytest.approx(said, rel=1e-6)
    for G in exp_twist(rng.normal(size=(3, 6)) * [[0.1], [1.0], [3.0]]):
        there = smoothness(model, TreePose(G @ prediction.T_world_model, prediction.angles), PENALTY)
        moved = normal_equations(model, TreePose(G @ at.T_world_model, at.angles), [], [there]).cost
        assert moved == pytest.approx(cost, rel=1e-6 if far == 1e-6 else 1e-11)


def test_told_about_the_worlds_origin_the_same_turn_would_cost_more_far_from_it() -> None:
    """That is what the paper prints, and why the root's way and turn are taken instead."""
    turn = exp_twist([0.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    costs, printed = [], []
    for far in (0.0, 5.0):
        rng = np.random.default_rng(0)
        model = trees.tree(rng)
        T = rigid(np.eye(3), [far, 0.0, 0.0] - model.root)
        there = rigid(np.eye(3), [far, 0.0, 0.0])
        deviation = there @ turn @ np.linalg.inv(there)
        prior = smoothness(model, TreePose(T, np.zeros(9)), PENALTY)
        costs.append(normal_equations(model, TreePose(deviation @ T, np.zeros(9)), [], [prior]).cost)
        printed.append(np.linalg.norm(log_motion(deviation)))
    assert costs[0] == pytest.approx((10.0 * 0.1) ** 2)
    assert costs[1] == pytest.approx(costs[0])
    assert printed[1] > 4 * printed[0]


@few
@given(seeds)
def test_a_penalty_of_nothing_is_as_none_to_the_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    start, data = trees.near(rng, model, truth, 0.1), trees.noisy(rng, model, truth)
    off = smoothness(model, trees.pose(rng, model), JitterPenalty(0.0, 0.0, 0.0))
    with_it, without = fit(model, start, data, [off]), fit(model, start, data)
    np.testing.assert_array_equal(with_it.pose.T_world_model, without.pose.T_world_model)
    np.testing.assert_array_equal(with_it.pose.angles, without.pose.angles)
    assert with_it.prior_cost == 0.0


@few
@given(seeds)
def test_more_penalty_comes_nearer_to_the_prediction_and_in_the_end_to_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    data = [trees.seen(rng, model, truth)]
    prediction = trees.near(rng, model, truth, 0.05)
    costs = []
    for weight in (1.0, 10.0, 100.0, 1e6):
        penalty = JitterPenalty(weight, weight, weight)
        found = fit(model, truth, data, [smoothness(model, prediction, penalty)], FINE)
        costs.append(found.prior_cost / weight**2)
    assert (np.diff(costs) <= 1e-12).all()
    same(found.pose, prediction, atol=1e-5)


def test_the_penalty_takes_jitter_out_of_a_noisy_motion_and_leaves_the_motion() -> None:
    rng = np.random.default_rng(2)
    model = trees.tree(rng, parts=3, joints=3)
    begun = trees.pose(rng, model)

    def follow(penalty: JitterPenalty) -> tuple[float, float]:
        noise, angles, truths = np.random.default_rng(3), [], []
        before = last = begun
        for k in range(80):
            truth = TreePose(
                exp_twist([0, 0.01 * k, 0, 0, 0.02 * k, 0]) @ begun.T_world_model, begun.angles + np.sin(0.1 * k)
            )
            c = trees.seen(np.random.default_rng(4), model, truth, 30)
            lines = c.lines.copy()
            lines[:, 3:] += np.cross(0.02 * noise.normal(size=(30, 3)), lines[:, :3])
            prior = smoothness(model, predicted(before, last), penalty)
            found = fit(model, last, [type(c)(c.part, c.points, lines, c.weights)], [prior])
            before, last = last, found.pose
            angles.append(last.angles)
            truths.append(truth.angles)
        error = np.array(angles) - truths
        return float(np.std(np.diff(error, n=2, axis=0))), float(np.sqrt(np.mean(error**2)))

    (rough, wrong), (smooth, less_wrong) = follow(JitterPenalty(0, 0, 0)), follow(JitterPenalty(100, 100, 100))
    assert smooth < 0.4 * rough
    assert less_wrong < wrong


@pytest.mark.parametrize("name", ["root_per_m", "root_per_rad", "angle_per_rad"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_weights_are_checked(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        JitterPenalty(**({"root_per_m": 1.0, "root_per_rad": 1.0, "angle_per_rad": 1.0} | {name: value}))


def test_looser_is_a_penalty_of_larger_accelerations() -> None:
    rng = np.random.default_rng(0)
    model = trees.tree(rng)
    expected = trees.pose(rng, model)
    tight = smoothness(model, expected, JitterPenalty(3.0, 6.0, 9.0))
    loose, wanted = looser(tight, 3.0), smoothness(model, expected, JitterPenalty(1.0, 2.0, 3.0))
    assert (loose.root_per_m, loose.root_per_rad) == (wanted.root_per_m, wanted.root_per_rad)
    np.testing.assert_allclose(loose.angles_per_rad, wanted.angles_per_rad)
