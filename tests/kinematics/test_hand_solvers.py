"""Fingertips → angles: the inverse of the independent forward kinematics, always within the limits, never worse than a
general solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares
from support.kinematic_hands import FULL, LEFT, RIGHT, THESIS, random_angles, tips

from mocapella.errors import SettingsError
from mocapella.kinematics.hand_solvers import (
    SOLVERS,
    ClosedForm,
    DampedLeastSquares,
    Fabrik,
    IterativeSettings,
    hand_solver,
)
from mocapella.model.hand import DIGIT_ANGLES, HandModel, HandShape, hand_model_from_toml

# No method runs these solvers by default: their kernels are compiled for these tests alone.
pytestmark = pytest.mark.slow

seeds = st.integers(0, 2**32 - 1)
anywhere = arrays(np.float64, (5, 3), elements=st.floats(allow_nan=True, allow_infinity=True) | st.floats(-0.3, 0.3))
HANDS = [(THESIS, RIGHT), (FULL, LEFT)]


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize(("model", "shape"), HANDS)
def test_the_closed_form_is_the_inverse_of_the_forward_kinematics(
    model: HandModel, shape: HandShape, seed: int
) -> None:
    targets = tips(model, shape, random_angles(model, np.random.default_rng(seed), 5))
    found = ClosedForm(model, shape).solve(targets)
    np.testing.assert_allclose(tips(model, shape, found.angles), targets, atol=1e-6)
    assert model.within(found.angles).all()


@settings(max_examples=30)
@given(seeds)
def test_where_the_third_joint_follows_the_second_the_angles_are_found_again(seed: int) -> None:
    angles = random_angles(THESIS, np.random.default_rng(seed), 5)
    found = ClosedForm(THESIS, LEFT).solve(tips(THESIS, LEFT, angles)).angles
    bent = angles[:, DIGIT_ANGLES[1:, 2]] > 0.05  # a straight finger's tip hardly says how straight
    fingers = np.abs(found - angles)[:, DIGIT_ANGLES[1:, :3]]
    assert np.median(fingers) < 1e-9
    assert (fingers[bent] < 1e-5).all()


@settings(max_examples=25)
@given(anywhere)
@pytest.mark.parametrize("name", list(SOLVERS))
def test_limits_are_held_whatever_comes_in(name: str, targets: np.ndarray) -> None:
    for model, shape in HANDS:
        found = hand_solver(name, model, shape).solve(targets, np.full(21, np.nan))
        assert model.within(found.angles)
        usable = np.isfinite(targets).all(axis=-1) & (np.abs(targets) < 100).all(axis=-1)
        assert found.measured[usable].all()
        assert not found.measured[~np.isfinite(targets).all(axis=-1)].any()


def test_a_target_at_the_joint_itself_is_no_trouble() -> None:
    for name in SOLVERS:
        for model, shape in HANDS:
            found = hand_solver(name, model, shape).solve(shape.bases * shape.mirror)
            assert model.within(found.angles)
            assert np.isfinite(found.errors_m).all()


@settings(max_examples=8)
@given(seeds)
def test_what_a_solver_says_of_its_errors_is_true(seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = tips(THESIS, LEFT, random_angles(THESIS, rng, 3)) + rng.normal(0, 0.02, (3, 5, 3))
    for name in SOLVERS:
        found = hand_solver(name, THESIS, LEFT).solve(targets)
        there = np.linalg.norm(tips(THESIS, LEFT, found.angles) - targets, axis=-1)
        np.testing.assert_allclose(found.errors_m, there, atol=1e-9)


def best_of_starts(
    model: HandModel, shape: HandShape, digit: int, target: np.ndarray, rng: np.random.Generator
) -> float:
    """Least distance that a general solver finds from many starts; the cone by direction and size."""
    f0, a0, F, A, least = model.cones[digit]
    local, row = model.frames[digit].T @ (target - shape.bases[digit]), DIGIT_ANGLES[digit]
    low = np.array([0.0, -math.pi if least < f0 else 0.0, 0.0, 0.0])
    high = np.array([1.0, math.pi, *model.limits[row[2:4], 1]])
    free = 3 if model.coupled[digit] else 4

    def missed(v: np.ndarray) -> np.ndarray:
        f, a = f0 + F * v[0] * math.sin(v[1]), a0 + A * v[0] * math.cos(v[1])
        bends = np.cumsum([f, v[2], model.coupling[digit] * v[2] if free == 3 else v[3]])
        u, w = shape.lengths[digit] @ np.cos(bends), shape.lengths[digit] @ np.sin(bends)
        return 1000 * (np.array([u * math.sin(a), -w, u * math.cos(a)]) - local)

    starts = (rng.uniform(low[:free], high[:free]) for _ in range(20))
    fits = [least_squares(missed, start, bounds=(low[:free], high[:free]), max_nfev=40) for start in starts]
    return min(float(np.linalg.norm(fit.fun)) for fit in fits) / 1000


def test_an_unreachable_target_is_met_as_nearly_as_by_a_general_solver() -> None:
    rng = np.random.default_rng(4)
    cases = [(THESIS, 1, 0.005), (THESIS, 2, 0.03), (THESIS, 4, 0.03), (THESIS, 0, 0.05), (FULL, 3, 0.03)]
    for model, digit, away in cases:
        targets = tips(model, RIGHT, random_angles(model, rng))[0] + rng.normal(0, away, (5, 3))
        mine = ClosedForm(model, RIGHT).solve(targets).errors_m[digit]
        assert mine <= best_of_starts(model, RIGHT, digit, targets[digit], rng) + 1e-4


@settings(max_examples=25)
@given(seeds)
def test_small_moves_of_a_target_move_the_hand_little(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = random_angles(THESIS, rng)[0]
    angles[DIGIT_ANGLES[1:, 2]] = np.clip(angles[DIGIT_ANGLES[1:, 2]], 0.4, 1.8)
    angles[DIGIT_ANGLES[1:, 0]] = np.clip(angles[DIGIT_ANGLES[1:, 0]], 0.1, 1.2)
    angles = THESIS.limited(angles)
    targets = tips(THESIS, RIGHT, angles)
    solver = ClosedForm(THESIS, RIGHT)
    one, two = solver.solve(targets), solver.solve(targets + rng.uniform(-1e-6, 1e-6, (5, 3)))
    fingers = DIGIT_ANGLES[1:, :4]
    assert np.abs(one.angles - two.angles)[fingers].max() < 1e-3


def test_a_digit_without_a_target_stays_as_it_was() -> None:
    rng = np.random.default_rng(1)
    start = random_angles(THESIS, rng)[0]
    targets = tips(THESIS, RIGHT, random_angles(THESIS, rng)[0])
    targets[2] = np.nan
    for name in SOLVERS:
        found = hand_solver(name, THESIS, RIGHT).solve(targets, start)
        np.testing.assert_allclose(found.angles[DIGIT_ANGLES[2, :4]], start[DIGIT_ANGLES[2, :4]], atol=1e-12)
        assert found.measured.tolist() == [True, True, False, True, True]
        assert np.isnan(found.errors_m[2])


def test_a_thumb_without_a_target_keeps_its_opposition() -> None:
    start = FULL.limited(np.full(21, 0.2))
    opposition = DIGIT_ANGLES[0, 4]
    assert start[opposition] > 0.1
    targets = np.stack([tips(FULL, RIGHT, start)] * 2)
    targets[1, 0] = np.nan
    for name in SOLVERS:
        found = hand_solver(name, FULL, RIGHT).solve(targets, start).angles
        assert found[0, opposition] == 0.0
        np.testing.assert_allclose(found[1, DIGIT_ANGLES[0]], start[DIGIT_ANGLES[0]], atol=1e-12)


def test_many_hands_at_once_are_each_alone() -> None:
    targets = tips(FULL, LEFT, random_angles(FULL, np.random.default_rng(2), 6)).reshape(2, 3, 5, 3)
    solver = ClosedForm(FULL, LEFT)
    np.testing.assert_array_equal(solver.solve(targets).angles[1, 2], solver.solve(targets[1, 2]).angles)


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != ClosedForm.name])
def test_an_iterative_solver_that_begins_near_arrives(name: str) -> None:
    near = FULL.limited(FULL.natural + 0.05)
    found = hand_solver(name, FULL, RIGHT).solve(tips(FULL, RIGHT, FULL.natural), near)
    # FABRIK creeps where a finger is nearly straight.
    assert (found.errors_m[1:] <= (1e-3 if name == Fabrik.name else 1e-4)).all()
    assert (found.iterations[1:] > 0).all()


def test_an_iterative_solver_stops_after_its_iterations_and_at_its_tolerance() -> None:
    far = np.full((5, 3), 0.5)
    for solver in (Fabrik, DampedLeastSquares):
        found = solver(THESIS, RIGHT, IterativeSettings(most_iterations=1, starts=0)).solve(far)
        assert found.iterations.tolist() == [1] * 5
    targets = tips(THESIS, RIGHT, THESIS.natural)
    loose = DampedLeastSquares(THESIS, RIGHT, IterativeSettings(tolerance_m=0.5)).solve(targets, np.zeros(21))
    assert (loose.iterations == 0).all()


def test_fabrik_stretches_towards_what_is_too_far() -> None:
    targets = RIGHT.bases + np.array([0.0, 0.0, 1.0])
    found = Fabrik(THESIS, RIGHT).solve(targets, THESIS.natural)
    assert np.abs(found.angles[DIGIT_ANGLES[1:, :4]]).max() < 1e-6


def test_what_is_out_of_range_is_refused() -> None:
    with pytest.raises(SettingsError, match="did you mean fabrik"):
        hand_solver("fabric", THESIS, RIGHT)
    for name in ("tolerance_m", "most_iterations", "damping_m"):
        with pytest.raises(SettingsError, match=name):
            IterativeSettings(**{name: 0})
    for starts in (-1, 5):
        with pytest.raises(SettingsError, match="starts"):
            IterativeSettings(starts=starts)


def test_a_cone_around_another_centre_is_held_too() -> None:
    from importlib.resources import files

    text = files("mocapella.model").joinpath("hands", "human.toml").read_text(encoding="utf-8")
    moved = text.replace(
        "centre_deg = [0, 0]\nflexion_deg = [-26.5, 26.5]", "centre_deg = [10, 0]\nflexion_deg = [-10, 30]"
    )
    assert moved != text
    model = hand_model_from_toml(moved)
    shape = model.shape("right")
    targets = tips(model, shape, random_angles(model, np.random.default_rng(3), 50))
    found = ClosedForm(model, shape).solve(targets)
    assert model.within(found.angles).all()
    assert (found.errors_m < 1e-4).all()
