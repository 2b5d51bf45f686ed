"""Trees fitted to lines, points and planes: the equations are those of all rows, and what they find obeys laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support import twist_trees as trees

from mocapella.errors import SettingsError
from mocapella.geometry.plucker import join, moved
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import adjoint, exp_twist, revolute
from mocapella.kinematics.twist_fit import (
    Constraints,
    FitSettings,
    InPlanes,
    OnLines,
    OnPoints,
    Prior,
    TreeFit,
    fit,
    normal_equations,
)
from mocapella.kinematics.twist_step_kernels import factorise, path, step, substitute
from mocapella.model.twist_tree import TreePose, TwistTree, twist_tree

Float64 = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
FINE = FitSettings(most_steps=60, rest_m=1e-11, rest_rad=1e-11)
few = settings(max_examples=20, deadline=None)


def same(one: TreePose, other: TreePose, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(one.T_world_model, other.T_world_model, atol=atol)
    np.testing.assert_allclose(one.angles, other.angles, atol=atol)


def brought(G: Float64, given: Constraints) -> Constraints:
    """Constraints after a rigid motion of the world."""
    if isinstance(given, OnLines):
        return OnLines(given.part, given.points, moved(G, given.lines), given.weights)
    if isinstance(given, OnPoints):
        return OnPoints(given.part, given.points, apply(G, given.targets), given.weights)
    n = given.planes[:, :3] @ G[:3, :3].T
    planes = np.c_[n, given.planes[:, 3] + n @ G[:3, 3]]
    return InPlanes(given.part, given.points, planes, given.weights)


def brought_prior(G: Float64, prior: Prior) -> Prior:
    there = TreePose(G @ prior.pose.T_world_model, prior.pose.angles)
    return Prior(there, prior.root_per_m, prior.root_per_rad, prior.angles_per_rad)


def problem(seed: int) -> tuple[TwistTree, TreePose, list[Constraints], list[Prior]]:
    """A tree, where it is begun with, contradicting constraints, and two priors."""
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    at = trees.pose(rng, model)
    constraints = trees.noisy(rng, model, trees.near(rng, model, at, 0.1))
    return model, at, constraints, [trees.prior_of(rng, model, at) for _ in range(2)]


@few
@given(seeds)
def test_the_equations_are_those_of_all_rows_written_out(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    found = normal_equations(model, at, constraints, priors)
    J, r = trees.rows(model, at, constraints, priors)
    # The turn's derivative is left at 1; only the curvature of the squared angle differs by that.
    scale = np.abs(J.T @ J).max()
    np.testing.assert_allclose(found.H, J.T @ J, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(found.g, -J.T @ r, rtol=1e-12, atol=1e-12 * scale)
    assert found.cost == pytest.approx(r @ r, rel=1e-11)
    np.testing.assert_allclose(found.about, trees.place(model, at), atol=1e-15)


@few
@given(seeds)
def test_a_step_is_the_least_squares_solution_of_all_rows(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    J, r = trees.rows(model, at, constraints, priors)
    delta = np.linalg.lstsq(J, -r, rcond=None)[0]
    one = fit(model, at, constraints, priors, FitSettings(most_steps=1)).pose
    np.testing.assert_allclose(one.angles, at.angles + delta[6:], atol=1e-9)
    way = trees.place(model, one) - trees.place(model, at)
    np.testing.assert_allclose(way, delta[:3], atol=1e-9)
    turn = exp_twist([0, 0, 0, *delta[3:6]])[:3, :3]
    np.testing.assert_allclose(one.T_world_model[:3, :3], turn @ at.T_world_model[:3, :3], atol=1e-9)


@pytest.mark.slow
@settings(few, max_examples=8)
@given(seeds)
def test_rows_are_the_derivatives_of_the_residuals(seed: int) -> None:
    model, at, constraints, _ = problem(seed)
    J, _ = trees.rows(model, at, constraints)
    for i, column in enumerate(np.eye(model.dofs)):
        there, back = (trees.rows(model, trees.stepped(model, at, s * column), constraints)[1] for s in (1e-6, -1e-6))
        np.testing.assert_allclose(J[:, i], (there - back) / 2e-6, atol=2e-8)


@few
@given(seeds)
def test_g_is_the_descent_of_the_cost_with_priors_too(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    far = [Prior(trees.near(np.random.default_rng(seed), model, at, 0.8), 2.0, 3.0, np.ones(9))]
    for held in (priors, far):
        g = normal_equations(model, at, constraints, held).g
        for i, column in enumerate(np.eye(model.dofs)):
            there, back = (
                normal_equations(model, trees.stepped(model, at, s * column), constraints, held).cost
                for s in (1e-5, -1e-5)
            )
            assert g[i] == pytest.approx(-0.5 * (there - back) / 2e-5, rel=1e-5, abs=1e-4)


@few
@given(seeds, st.sampled_from([2, 4]))
def test_a_known_pose_is_found_from_exact_lines_of_two_cameras_or_more(seed: int, cameras: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    found = fit(model, trees.near(rng, model, truth, 0.05), [trees.seen(rng, model, truth, 120, cameras)], (), FINE)
    assert found.rests
    assert 0 <= found.cost < 1e-9
    same(found.pose, truth)


@few
@given(seeds)
def test_a_known_pose_is_found_from_points_and_from_planes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    start = trees.near(rng, model, truth, 0.05)
    part, points, x = trees.points_of(rng, model, truth, 150)
    same(fit(model, start, [OnPoints(part, points, x, np.ones(150))], (), FINE).pose, truth)
    n = rng.normal(size=x.shape)
    n /= np.linalg.norm(n, axis=1)[:, None]
    planes = InPlanes(part, points, np.c_[n, (n * x).sum(axis=1)], np.ones(150))
    same(fit(model, start, [planes], (), FINE).pose, truth)


@few
@given(seeds)
def test_moving_the_worlds_origin_moves_the_estimate_and_changes_nothing_else(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    G = exp_twist(2 * np.random.default_rng(seed + 1).normal(size=6))
    found = fit(model, at, constraints, priors, FINE)
    there = fit(
        model, TreePose(G @ at.T_world_model, at.angles), [brought(G, c) for c in constraints],
        [brought_prior(G, p) for p in priors], FINE,
    )  # fmt: skip
    same(there.pose, TreePose(G @ found.pose.T_world_model, found.pose.angles), atol=1e-10)
    assert (there.cost, there.prior_cost) == pytest.approx((found.cost, found.prior_cost), rel=1e-9)


@few
@given(seeds)
def test_where_the_model_lies_at_rest_changes_nothing(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    G = exp_twist(np.random.default_rng(seed + 1).normal(size=6))

    def other(pose: TreePose) -> TreePose:
        return TreePose(pose.T_world_model @ inverse(G), pose.angles)

    moved_model = twist_tree(
        model.parents, model.joint_parts, (adjoint(G) @ model.twists[..., None])[..., 0], model.limits,
        apply(G, model.root[None])[0],
    )  # fmt: skip
    rested = [
        type(c)(c.part, apply(G, c.points), *(getattr(c, f) for f in c.__struct_fields__[2:])) for c in constraints
    ]
    expected = [Prior(other(p.pose), p.root_per_m, p.root_per_rad, p.angles_per_rad) for p in priors]
    found = fit(model, at, constraints, priors, FINE)
    there = fit(moved_model, other(at), rested, expected, FINE)
    same(there.pose, other(found.pose), atol=1e-10)


@few
@given(seeds, st.floats(0.01, 100))
def test_only_the_ratios_of_weights_matter(seed: int, factor: float) -> None:
    model, at, constraints, priors = problem(seed)
    heavier = [type(c)(*(getattr(c, f) for f in c.__struct_fields__[:3]), factor**2 * c.weights) for c in constraints]
    surer = [Prior(p.pose, factor * p.root_per_m, factor * p.root_per_rad, factor * p.angles_per_rad) for p in priors]
    found, there = fit(model, at, constraints, priors, FINE), fit(model, at, heavier, surer, FINE)
    same(there.pose, found.pose, atol=1e-10)
    assert there.cost == pytest.approx(factor**2 * found.cost, rel=1e-9)


@few
@given(seeds)
def test_constraints_add_up_and_those_not_seen_do_not_count(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    lines = constraints[0]
    assert isinstance(lines, OnLines)
    halves = [OnLines(lines.part[k::2], lines.points[k::2], lines.lines[k::2], lines.weights[k::2]) for k in (0, 1)]
    rng = np.random.default_rng(seed)
    junk = OnLines(
        np.zeros(5, dtype=np.int64), rng.normal(size=(5, 3)), rng.normal(size=(5, 6)),
        np.array([0.0, -1.0, np.nan, 1.0, 1.0]),
    )  # fmt: skip
    junk.lines[3, 4], junk.points[4, 1] = np.nan, np.inf
    apart = normal_equations(model, at, [constraints[1], halves[1], junk, *constraints[2:], halves[0]], priors)
    together = normal_equations(model, at, constraints, priors)
    np.testing.assert_allclose(apart.H, together.H, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(apart.g, together.g, rtol=1e-9, atol=1e-9)


def bounded(seed: int, width: float) -> tuple[TwistTree, TreePose, list[Constraints], TreeFit]:
    """A fit within limits that the data contradict."""
    rng = np.random.default_rng(seed)
    free = trees.tree(rng)
    at = trees.pose(rng, free)
    low = at.angles - width * rng.uniform(0, 1, 9)
    model = twist_tree(free.parents, free.joint_parts, free.twists, np.c_[low, low + width], free.root)
    data: list[Constraints] = [trees.seen(rng, model, trees.near(rng, model, at, 0.2), 120)]
    return model, at, data, fit(model, at, data, (), FINE)


@few
@given(seeds, st.sampled_from([0.0, 0.1, 0.4]))
def test_limits_hold_and_what_they_leave_free_is_at_its_best(seed: int, width: float) -> None:
    model, _, data, found = bounded(seed, width)
    angles = found.pose.angles
    assert ((angles >= model.limits[:, 0]) & (angles <= model.limits[:, 1])).all()
    np.testing.assert_array_equal(found.held, (angles == model.limits[:, 0]) | (angles == model.limits[:, 1]))
    at_best = normal_equations(model, found.pose, data)
    scale = np.sqrt(np.diag(at_best.H))  # so that the descent is in units of the cost's square root
    g = at_best.g / scale
    np.testing.assert_allclose(g[:6], 0, atol=1e-5)
    np.testing.assert_allclose(g[6:][~found.held], 0, atol=1e-5)
    low, high = angles <= model.limits[:, 0], angles >= model.limits[:, 1]
    assert (g[6:][low & ~high] <= 1e-5).all()
    assert (g[6:][high & ~low] >= -1e-5).all()


def test_limits_are_felt_and_an_angle_that_begins_at_one_or_beyond_comes_off_it() -> None:
    felt = sum(bounded(seed, 0.1)[3].held.sum() for seed in range(10))
    assert felt > 10
    rng = np.random.default_rng(5)
    free = trees.tree(rng)
    truth = trees.pose(rng, free)
    limits = np.c_[truth.angles - 0.05, truth.angles + 0.05]
    model = twist_tree(free.parents, free.joint_parts, free.twists, limits, free.root)
    for begun in (limits[:, 0], limits[:, 1], limits[:, 1] + 1.0):
        found = fit(model, TreePose(truth.T_world_model, begun), [trees.seen(rng, model, truth, 120)], (), FINE)
        same(found.pose, truth)
        assert not found.held.any()


@few
@given(seeds, st.integers(1, 6))
def test_no_step_costs_more_however_far_the_start(seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    start = trees.near(rng, model, truth, 2.0)
    data, priors = [trees.seen(rng, model, truth)], [trees.prior_of(rng, model, truth)]
    costs = [normal_equations(model, start, data, priors).cost]
    for most in range(1, steps + 1):
        found = fit(model, start, data, priors, FitSettings(most_steps=most))
        assert found.steps <= most
        costs.append(found.cost + found.prior_cost)
        assert costs[-1] == pytest.approx(normal_equations(model, found.pose, data, priors).cost, rel=1e-9)
    assert (np.diff(costs) <= 1e-9 * costs[0]).all()


def test_steps_that_would_cost_more_are_not_taken_and_shorter_ones_are_tried() -> None:
    """From far away, with one camera, many a step without damping is worse than none."""
    rng = np.random.default_rng(0)
    worse, rest = 0, []
    for _ in range(30):
        model = trees.tree(rng)
        truth = trees.pose(rng, model)
        start = trees.near(rng, model, truth, 1.5)
        data, priors = [trees.seen(rng, model, truth, 16, cameras=1)], [Prior(truth, 1.0, 1.0, np.ones(9))]
        begun = normal_equations(model, start, data, priors)
        there = trees.stepped(model, start, np.linalg.solve(begun.H, begun.g))
        if normal_equations(model, there, data, priors).cost > begun.cost:
            worse += 1
            one, some = (fit(model, start, data, priors, FitSettings(most_steps=most)) for most in (1, 12))
            assert one.steps == 1
            assert one.cost + one.prior_cost < begun.cost  # what is tried and not taken is no step
            assert some.cost + some.prior_cost < 0.9 * begun.cost
        rest.append(fit(model, start, data, priors, FitSettings(most_steps=60)).rests)
    assert worse >= 5
    assert np.mean(rest) > 0.5  # with a damping that stays, few do


@few
@given(seeds)
def test_what_one_camera_cannot_see_is_as_the_prior_says(seed: int) -> None:
    """A rigid object of which one point is seen: it comes to the line by the shortest way, and does not turn."""
    rng = np.random.default_rng(seed)
    model = twist_tree([-1], root=[0.1, -0.2, 0.3])
    expected = trees.pose(rng, model)
    eye = trees.place(model, expected) + rng.normal(size=3) * 3
    line = join(eye, trees.place(model, expected) + 0.3 * rng.normal(size=3))
    data = [OnLines(np.array([0]), model.root[None], line[None], np.array([1e8]))]
    assert np.linalg.matrix_rank(normal_equations(model, expected, data).H) == 2
    found = fit(model, trees.near(rng, model, expected, 0.1), data, [Prior(expected, 1.0, 1.0, np.empty(0))])
    assert found.rests
    np.testing.assert_allclose(found.pose.T_world_model[:3, :3], expected.T_world_model[:3, :3], atol=1e-6)
    n = line[:3]
    along = (trees.place(model, expected) - eye) @ n
    np.testing.assert_allclose(trees.place(model, found.pose), eye + along * n, atol=1e-6)


@few
@given(seeds)
def test_one_camera_does_with_the_prior_what_two_do_without(seed: int) -> None:
    """A body of which one camera sees a few points: nothing is known of most angles but the prediction."""
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    data = [trees.seen(rng, model, truth, 5, cameras=1)]
    eigenvalues = np.linalg.eigvalsh(normal_equations(model, truth, data).H)
    assert eigenvalues[0] < 1e-9 * eigenvalues[-1]
    prior = Prior(truth, 10.0, 10.0, np.full(9, 10.0))
    found = fit(model, trees.near(rng, model, truth, 0.05), data, [prior], FINE)
    assert found.rests
    same(found.pose, truth, atol=1e-7)


@pytest.mark.parametrize(
    "data", [[], [OnLines(np.empty(0, np.int64), *(np.empty((0, k)) for k in (3, 6)), np.empty(0))]]
)
def test_what_nothing_holds_stays_where_it_is(data: list[Constraints]) -> None:
    rng = np.random.default_rng(0)
    model = trees.tree(rng)
    at = trees.pose(rng, model)
    found = fit(model, at, data)
    same(found.pose, at, atol=1e-15)
    assert (found.rests, found.steps, found.cost, found.prior_cost) == (True, 1, 0.0, 0.0)


def test_a_joint_that_moves_no_point_stays_as_it_is() -> None:
    rng = np.random.default_rng(0)
    model = trees.tree(rng)
    at = trees.pose(rng, model)
    data = trees.seen(rng, model, trees.near(rng, model, at, 0.05), 100)
    only_root = [OnLines(0 * data.part, data.points, data.lines, data.weights)]
    found = fit(model, at, only_root)
    assert found.rests
    np.testing.assert_array_equal(found.pose.angles, at.angles)


def test_too_few_steps_are_said() -> None:
    model, at, constraints, priors = problem(3)
    found = fit(model, at, constraints, priors, FitSettings(most_steps=1))
    assert (found.steps, found.rests) == (1, False)
    assert fit(model, at, constraints, priors).rests


def test_what_cannot_be_computed_does_not_rest_and_stays_where_it_is_within_limits() -> None:
    free, at, constraints, priors = problem(3)
    constraints[1].points[0] = 1e200  # finite, but not its square
    found = fit(free, at, constraints, priors, FitSettings(most_steps=1000))
    assert not found.rests
    assert found.steps < 30
    assert not found.held.any()
    same(found.pose, at, atol=1e-15)
    limits = np.c_[at.angles - 2, at.angles - 1]
    model = twist_tree(free.parents, free.joint_parts, free.twists, limits, free.root)
    found = fit(model, at, constraints, priors)
    assert found.held.all()
    np.testing.assert_array_equal(found.pose.angles, limits[:, 1])


def test_a_rotation_is_one_whatever_it_begins_with() -> None:
    rng = np.random.default_rng(1)
    model = trees.tree(rng)
    truth = trees.pose(rng, model)
    start = truth.T_world_model + 1e-8 * rng.normal(size=(4, 4)) * [[1, 1, 1, 0]]
    R = fit(model, TreePose(start, truth.angles), [trees.seen(rng, model, truth)]).pose.T_world_model[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


@pytest.mark.slow
@few
@given(seeds, st.sampled_from([0.001, 0.01, 0.1]))
def test_a_step_ends_at_limits_and_is_the_best_for_all_that_is_free(seed: int, width: float) -> None:
    model, at, constraints, priors = problem(seed)
    rng = np.random.default_rng(seed)
    equations = normal_equations(model, at, constraints, priors)
    low = at.angles - width * rng.integers(0, 2, 9)
    limits = np.c_[low, low + width]
    above, held, delta = np.empty(model.dofs, dtype=np.int64), np.empty(9, dtype=np.bool_), np.empty(model.dofs)
    path(model.parents, model.joint_parts, above)
    L = np.empty((model.dofs, model.dofs))
    assert step(above, np.tril(equations.H), equations.g, 0.0, at.angles, limits, L, held, delta)
    angles = at.angles + delta[6:]
    assert ((angles >= limits[:, 0] - 1e-15) & (angles <= limits[:, 1] + 1e-15)).all()
    ends = np.abs(angles[held, None] - limits[held]).min(axis=1)
    np.testing.assert_allclose(ends, 0, atol=1e-15)
    free = np.r_[np.ones(6, dtype=np.bool_), ~held]
    left = (equations.g - equations.H @ delta)[free]
    np.testing.assert_allclose(left, 0, atol=1e-8 * np.abs(equations.H).max())


def test_a_limit_is_not_passed_by_rounding() -> None:
    """Where an angle and the rest of its way add up to more than the limit, it is at the limit."""
    rng, passed = np.random.default_rng(0), 0
    axis = revolute([0.0, 0.0, 1.0], np.zeros(3))
    part, points = np.ones(20, dtype=np.int64), rng.normal(size=(20, 3))
    for begun, most in rng.uniform([-1, 0], [0, 0.1], (100, 2)):
        if begun < most < begun + (most - begun):
            passed += 1
            model = twist_tree([-1, 0], [1], [axis], [[-1, most]])
            turned = points @ exp_twist((most + 0.2) * axis)[:3, :3].T
            kept = Prior(TreePose(np.eye(4), np.zeros(1)), 1e3, 1e3, np.zeros(1))
            data = [OnPoints(part, points, turned, np.ones(20))]
            assert fit(model, TreePose(np.eye(4), np.array([begun])), data, [kept]).pose.angles[0] == most
    assert passed > 10


@pytest.mark.slow
@settings(few, max_examples=10)
@given(seeds)
def test_the_factor_along_paths_is_that_of_the_whole_matrix(seed: int) -> None:
    model, at, constraints, priors = problem(seed)
    equations = normal_equations(model, at, constraints, priors)
    above = np.empty(model.dofs, dtype=np.int64)
    path(model.parents, model.joint_parts, above)
    L, x = np.tril(equations.H), equations.g.copy()
    assert factorise(above, L)
    np.testing.assert_allclose(L.T @ L, equations.H, rtol=1e-9, atol=1e-9)
    substitute(above, L, x)
    np.testing.assert_allclose(equations.H @ x, equations.g, rtol=1e-7, atol=1e-7)
    on_path = np.tril(equations.H) != 0
    assert (L[~on_path] == 0).all()  # no fill-in


@pytest.mark.parametrize("element", [-1.0, 0.0, np.nan])
def test_what_is_not_positive_definite_has_no_factor(element: float) -> None:
    above, H = np.arange(-1, 6), np.eye(7)
    H[3, 3] = element
    assert not factorise(above, H)
    H, g = np.eye(7), np.ones(7)
    H[3, 3] = np.nan
    free, held = np.array([[-np.inf, np.inf]]), np.empty(1, dtype=np.bool_)
    assert not step(above, H, g, 0.0, np.zeros(1), free, np.empty((7, 7)), held, np.empty(7))


@pytest.mark.parametrize("n", [np.int64(-1), np.int64(6)])
def test_a_part_that_there_is_not_is_refused(n: np.int64) -> None:
    model, at, constraints, _ = problem(0)
    for c in constraints:
        part = c.part.copy()
        part[7] = n
        wrong = type(c)(part, *(getattr(c, f) for f in c.__struct_fields__[1:]))
        with pytest.raises(SettingsError, match=f"part is {n}; it must be 0 to 5"):
            fit(model, at, [wrong])


def test_what_does_not_fit_together_is_refused() -> None:
    model, at, constraints, _ = problem(0)
    c = constraints[0]
    assert isinstance(c, OnLines)
    for wrong in (
        OnLines(c.part, c.points, c.lines[:, :4], c.weights),
        OnLines(c.part[1:], c.points, c.lines, c.weights),
        OnLines(c.part, c.points, c.lines, c.weights[1:]),
    ):
        with pytest.raises(SettingsError, match="shapes"):
            fit(model, at, [wrong])
    for n in (1, 8):
        with pytest.raises(SettingsError, match="angles_per_rad"):
            fit(model, at, [c], [Prior(at, 1.0, 1.0, np.ones(n))])
    for pose, said in (
        (TreePose(at.T_world_model, at.angles[1:]), "shapes"),
        (TreePose(at.T_world_model[:3], at.angles), "shapes"),
        (TreePose(at.T_world_model, np.full(9, np.nan)), "finite"),
        (TreePose(rigid(np.eye(3), [0, np.inf, 0]), at.angles), "finite"),
    ):
        with pytest.raises(SettingsError, match=said):
            fit(model, pose, [c])
        with pytest.raises(SettingsError, match=said):
            fit(model, at, [c], [Prior(pose, 1.0, 1.0, np.ones(9))])


@pytest.mark.parametrize(
    "weights", [(-1.0, 1.0, np.ones(9)), (1.0, np.nan, np.ones(9)), (1.0, 1.0, np.r_[np.ones(8), np.inf])]
)
def test_weights_of_priors_are_checked(weights: tuple[float, float, Float64]) -> None:
    with pytest.raises(SettingsError, match="0 or more"):
        Prior(problem(0)[1], *weights)


@pytest.mark.parametrize("wrong", [{"most_steps": 0}, {"rest_m": 0.0}, {"rest_rad": -1.0}])
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        FitSettings(**wrong)  # type: ignore[arg-type]
