"""Laws of every solver of a hand's inverse kinematics: it reaches, keeps limits, mirrors, and stays at a solution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.kinematic_hands import FULL, LEFT, RIGHT, THESIS, markers, random_angles, random_motion, tips

from mocapella.errors import SettingsError
from mocapella.kinematics.hand_solvers import SOLVER_NAMES, SOLVERS, ClosedForm, hand_solver
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.model.hand import DIGIT_ANGLES, HandModel

pytestmark = pytest.mark.slow  # compiles the kernels of all solvers

seeds = st.integers(0, 2**32 - 1)
NAMES = list(SOLVERS)
REACHED_M = {"fabrik": 0.03, "transpose": 0.002, "dls": 2e-4}
"""Bounds of the solvers that converge slowly near straight digits, or deadlock; of the others, 0.1 mm."""
NEAREST_M = {"fabrik": 0.04, "transpose": 0.002, "pseudo-inverse": 0.03}
"""How much farther from an unreachable target a tip ends than the nearest posture; of the others, 0.2 mm."""


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize("model", [THESIS, FULL], ids=["thesis", "full"])
@pytest.mark.parametrize("name", NAMES)
def test_reachable_tips_are_reached(name: str, model: HandModel, seed: int) -> None:
    targets = tips(model, RIGHT, random_angles(model, np.random.default_rng(seed), 5))
    found = hand_solver(name, model, RIGHT).solve(targets)
    there = np.linalg.norm(tips(model, RIGHT, found.angles) - targets, axis=-1)
    assert there.max() <= REACHED_M.get(name, 1.001e-4)
    assert np.median(there) <= 1.001e-4
    assert model.within(found.angles).all()


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize("name", NAMES)
def test_unreachable_tips_end_near_the_nearest_posture(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = tips(THESIS, RIGHT, random_angles(THESIS, rng, 5)) + rng.normal(0, 0.01, (5, 5, 3))
    found = hand_solver(name, THESIS, RIGHT).solve(targets)
    nearest = ClosedForm(THESIS, RIGHT).solve(targets).errors_m
    assert np.isfinite(found.angles).all()
    assert THESIS.within(found.angles).all()
    assert (found.errors_m - nearest).max() <= NEAREST_M.get(name, 2e-4)


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_hand_has_the_same_angles(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = tips(THESIS, RIGHT, random_angles(THESIS, rng, 2)) + rng.normal(0, 0.005, (2, 5, 3))
    right = hand_solver(name, THESIS, RIGHT).solve(targets)
    left = hand_solver(name, THESIS, LEFT).solve(targets * LEFT.mirror)
    np.testing.assert_array_equal(left.angles, right.angles)
    np.testing.assert_array_equal(left.errors_m, right.errors_m)


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize("name", NAMES)
def test_a_hand_at_its_solution_stays_there(name: str, seed: int) -> None:
    angles = random_angles(THESIS, np.random.default_rng(seed), 2)
    solver, targets = hand_solver(name, THESIS, RIGHT), tips(THESIS, RIGHT, angles)
    once = solver.solve(targets, angles)
    again = solver.solve(targets, once.angles)
    np.testing.assert_array_equal(again.angles, once.angles)
    if name != ClosedForm.name:
        assert (once.iterations == 0).all()
        np.testing.assert_allclose(once.angles, angles, atol=1e-12)


@pytest.mark.parametrize("name", SOLVER_NAMES)
def test_the_tracker_takes_every_solver(name: str) -> None:
    rng, layout = np.random.default_rng(7), base_layout(RIGHT, 3)
    angles, T = THESIS.limited(THESIS.natural + 0.1), random_motion(rng)
    angles[DIGIT_ANGLES[0, 4]] = 0.0
    points = markers(THESIS, LEFT, layout, angles, T)
    one, other = (HandTracker(THESIS, LEFT, layout, solver=name) for _ in range(2))
    for k in range(4):
        seen = points.copy()
        seen[1] = np.nan if k == 2 else seen[1]
        hand, same = one.update(seen, k / 60), other.update(seen, k / 60)
        np.testing.assert_array_equal(hand.angles, same.angles)
        assert THESIS.within(hand.angles)
    np.testing.assert_allclose(hand.angles[DIGIT_ANGLES[1:, :4]], angles[DIGIT_ANGLES[1:, :4]], atol=0.12)
    assert (one.fingers is None) == (name == "map")
    one.reset()
    assert one.fingers is None


def test_a_solver_brings_tips_nearer_to_their_markers_than_the_fit_with_priors() -> None:
    rng, layout = np.random.default_rng(3), base_layout(RIGHT, 3)
    points = markers(THESIS, RIGHT, layout, random_angles(THESIS, rng)[0], np.eye(4))
    left = [HandTracker(THESIS, RIGHT, layout, solver=name).update(points, 0.0).residuals_m for name in ("map", "dls")]
    assert left[1][:5].sum() < left[0][:5].sum()


def test_a_digit_without_a_marker_keeps_the_angles_of_the_fit() -> None:
    layout = base_layout(RIGHT, 3)
    points = markers(THESIS, RIGHT, layout, THESIS.natural, np.eye(4))
    points[3] = np.nan
    fit, solved = (HandTracker(THESIS, RIGHT, layout, solver=name).update(points, 0.0) for name in ("map", "newton"))
    np.testing.assert_array_equal(solved.angles[DIGIT_ANGLES[3, :4]], fit.angles[DIGIT_ANGLES[3, :4]])
    assert (solved.angles != fit.angles).any()


def test_an_unknown_solver_is_refused_with_the_list() -> None:
    with pytest.raises(SettingsError, match=r"solver is 'newtn'.*map, closed-form, fabrik.*did you mean newton"):
        HandTracker(THESIS, RIGHT, base_layout(RIGHT, 3), solver="newtn")
