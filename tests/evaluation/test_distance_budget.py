from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import InputError
from mocapella.evaluation.distance_budget import (
    LASTING_S,
    distance_budget,
    fitted_distance,
    mean_distance,
    moving_mean,
    views_budget,
)
from mocapella.evaluation.kinectmultitrack import WALK
from mocapella.evaluation.methods import scored_tracker
from mocapella.evaluation.scored_views import TOPOLOGY
from mocapella.evaluation.session_runs import run_session
from mocapella.evaluation.study_pairs import study_sessions
from mocapella.fusion.joint_bias import TERMS, body_view, symmetric
from mocapella.fusion.joint_bias_training import ViewPairs
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist

JOINTS = len(TOPOLOGY)
AT_S = np.arange(60) / 30
seeds = st.integers(0, 1000)


def walker(seed: int) -> np.ndarray:
    """Joints (pairs, joints, 3) of a body that moves along a line [m]."""
    rng = np.random.default_rng(seed)
    body = rng.normal(size=(JOINTS, 3)) * 0.4
    return body + np.array([1.2, 0.0, 0.3]) * AT_S[:, None, None]


@settings(max_examples=10)
@given(seeds)
def test_no_figure_is_larger_than_the_scored_one_and_equal_views_have_none(seed: int) -> None:
    first = walker(seed)
    second = first + np.random.default_rng(seed).normal(size=first.shape) * 0.03
    found = views_budget(first, second, AT_S)
    assert all(found[name] <= found["scored"] + 1e-9 for name in ("labels", "offset"))
    assert found["each_motion"] < found["scored"]
    assert max(views_budget(first, first, AT_S).values()) < 1e-9


@settings(max_examples=10)
@given(seeds)
def test_each_cause_is_found_by_its_own_figure(seed: int) -> None:
    first = walker(seed)
    T = exp_twist(np.array([0.1, 0.02, -0.05, 0.0, 0.2, 0.05]))
    turned = views_budget(first, apply(T, first), AT_S)
    assert turned["scored"] > 0.05
    assert turned["motion"] < 1e-6
    late = views_budget(first, first + 0.03 * np.array([1.2, 0.0, 0.3]), AT_S)
    assert late["offset"] < 0.1 * late["scored"]
    exchanged = views_budget(first, first[:, list(TOPOLOGY.mirror)], AT_S)
    assert exchanged["labels"] == pytest.approx(0.0, abs=1e-9)


def test_a_motion_of_each_pair_finds_what_one_motion_cannot() -> None:
    first = walker(1)
    twists = np.random.default_rng(2).normal(size=(len(first), 6)) * 0.1
    found = views_budget(first, apply(exp_twist(twists), first), AT_S)
    assert found["each_motion"] < 1e-4 < found["motion"]


def test_what_lasts_is_told_from_what_does_not() -> None:
    first = walker(3)
    lasting = views_budget(first, first + 0.05, AT_S)
    assert lasting["fast"] < 1e-9
    assert lasting["lasting"] == pytest.approx(lasting["scored"])
    flicker = np.where(np.arange(len(first)) % 2, 0.05, -0.05)[:, None, None]
    fast = views_budget(first, first + flicker, AT_S)
    assert fast["lasting"] < 0.2 * fast["scored"] < fast["fast"]


def test_the_moving_mean_leaves_out_what_is_missing() -> None:
    values = np.array([[1.0], [np.nan], [3.0], [np.nan]])
    at_s = np.array([0.0, 0.1, 0.2, 0.2 + LASTING_S])
    assert moving_mean(values, at_s)[:, 0].tolist() == pytest.approx([2.0, 2.0, 2.0, np.nan], nan_ok=True)
    assert mean_distance(np.array([[3.0, 4.0, 0.0], [np.nan] * 3]), np.zeros((2, 3))) == 5.0


def test_a_bias_that_depends_on_the_facing_is_learnt_and_taken_off() -> None:
    rng = np.random.default_rng(5)
    n = 200
    facing = np.stack([rng.uniform(-3, 3, n), rng.uniform(-3, 3, n)], axis=1)
    position = np.broadcast_to([0.0, 0.0, 2.5], (n, 2, 3)).copy()
    of_view, R = body_view(facing, position, np.zeros((n, 2, 3)))
    weights = symmetric(rng.normal(size=(TERMS, JOINTS, 3)) * 0.05, TOPOLOGY.mirror)
    weights[6:] = 0.0
    bias = np.tensordot(of_view, weights, axes=1) @ np.swapaxes(R, -1, -2)
    body = rng.normal(size=(n, 1, JOINTS, 3)) * 0.4
    views = ViewPairs(body + bias, facing, position, np.zeros((n, 2, 3)), np.ones(n))
    assert fitted_distance(views, views) < 0.3 * mean_distance(views.positions[:, 0], views.positions[:, 1])


@pytest.mark.slow
def test_the_budget_of_a_recorded_walk(study_logs: Path) -> None:
    session = next(one for one in study_sessions(study_logs, [0]) if one.placement == "90")
    walk = session.pairs.where(session.pairs.task == WALK)
    run = run_session(session, scored_tracker("default"), session.frames)
    found = distance_budget(session, run, walk)
    assert found.own_bias < found.scored
    assert found.each_motion < found.motion < found.scored * 1.01
    assert found.fast < found.lasting
    with pytest.raises(InputError, match="two pairs of one person"):
        distance_budget(session, run, walk.where(np.zeros(len(walk), dtype=np.bool_)))
