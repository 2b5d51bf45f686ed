"""The budget of Δd of two people: each cause is found by its own figure."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.evaluation.methods import scored_tracker
from mocapella.evaluation.scored_views import TOPOLOGY
from mocapella.evaluation.session_runs import run_session
from mocapella.evaluation.study_pairs import study_sessions
from mocapella.evaluation.two_people_budget import NearViews, near_views, two_people_budget
from mocapella.geometry.rigid import apply, rotation_about_y
from mocapella.geometry.twists import exp_twist

JOINTS = len(TOPOLOGY)
PAIRS = 80
seeds = st.integers(0, 1000)


def people(seed: int) -> NearViews:
    """Equal views of two people in turn, who turn slowly and stand 1 m apart."""
    rng = np.random.default_rng(seed)
    person = np.arange(PAIRS) % 2
    yaw = 0.3 * np.sin(np.arange(PAIRS) / 9 + person)
    bodies = rng.normal(size=(2, JOINTS, 3)) * 0.4
    first = bodies[person] @ np.swapaxes(rotation_about_y(yaw), -1, -2) + person[:, None, None] * np.array([1.0, 0, 0])
    return NearViews(np.stack([first, first], axis=1), yaw, person.astype(np.int64), np.arange(PAIRS) / 30)


def displaced(views: NearViews, by: np.ndarray) -> NearViews:
    """The second view with joints displaced along the body's axes."""
    positions = views.positions.copy()
    positions[:, 1] += by @ np.swapaxes(rotation_about_y(views.yaw), -1, -2)
    return msgspec.structs.replace(views, positions=positions)


@settings(max_examples=4)
@given(seeds)
def test_equal_views_have_no_budget(seed: int) -> None:
    assert max(msgspec.structs.asdict(two_people_budget(people(seed))).values()) < 1e-9


@settings(max_examples=4)
@given(seeds)
def test_a_wrong_motion_is_found_in_either_half(seed: int) -> None:
    views = people(seed)
    T = exp_twist(np.array([0.1, 0.02, -0.05, 0.0, 0.2, 0.05]))
    positions = np.stack([views.positions[:, 0], apply(T, views.positions[:, 0])], axis=1)
    found = two_people_budget(msgspec.structs.replace(views, positions=positions))
    assert found.scored > 0.05
    assert max(found.motion, found.motion_of_other_half, found.own_motion) < 1e-6


@settings(max_examples=4)
@given(seeds)
def test_a_bias_that_both_people_share_is_told_from_a_personal_one(seed: int) -> None:
    views = people(seed)
    by = np.random.default_rng(seed).normal(size=(2, JOINTS, 3)) * 0.03
    shared = two_people_budget(displaced(views, np.repeat(by[:1], PAIRS, axis=0)))
    assert shared.scored > 0.02
    assert max(shared.constant, shared.constant_of_other_half, shared.constant_of_other_person) < 1e-9
    own = two_people_budget(displaced(views, by[views.person]))
    assert max(own.own_constant, own.own_constant_of_other_half) < 1e-9
    assert min(own.constant, own.constant_of_other_person) > 0.01


def test_exchanged_labels_are_found_and_a_missing_joint_counts_for_nothing() -> None:
    views = people(4)
    positions = views.positions.copy()
    positions[:, 1] = positions[:, 1][:, list(TOPOLOGY.mirror)]
    positions[:, 0, 3] = np.nan
    found = two_people_budget(msgspec.structs.replace(views, positions=positions))
    assert found.labels < 1e-9 < found.scored


def test_a_person_of_one_half_teaches_nothing_about_the_other() -> None:
    views = people(5)
    halves = msgspec.structs.replace(views, person=(np.arange(PAIRS) >= PAIRS // 2).astype(np.int64))
    assert np.isnan(two_people_budget(halves).own_constant_of_other_half)


@pytest.mark.slow
def test_the_budget_of_two_people_on_a_real_log(study_logs: Path) -> None:
    (session,) = study_sessions(study_logs, [21])
    found = two_people_budget(near_views(session, run_session(session, scored_tracker("default"), session.frames)))
    assert 0.02 < found.scored < 0.05
    assert found.own_constant < found.constant < found.scored
    assert found.own_constant < found.own_constant_of_other_half
