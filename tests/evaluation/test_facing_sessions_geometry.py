"""Where sensors and people are in the sequences of a person's facing, and which way these move."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.evaluation_sessions import log_of, session_of

from mocapella.evaluation import facing_sessions as module
from mocapella.evaluation.facing_sessions import (
    HEADING_OVER,
    TASKS,
    AlignedViews,
    _velocity,
    aligned_views,
    facing_session,
    left_out,
    trained_on,
)
from mocapella.evaluation.study_pairs import StudySession
from mocapella.fusion.facing_model import shipped_model
from mocapella.geometry import rigid
from mocapella.geometry.angles import wrap
from mocapella.model.topology import topology

WRONG = rigid.rigid(rigid.rotation_about_y(0.2), [0.3, 0.1, -0.2])
ROOT = topology("kinect_v2").index("SpineBase")
STATIONARY, STEPS, WALK = TASKS
SESSION = session_of(noise=0.0, frames=180)


def views_of(session: StudySession = SESSION) -> AlignedViews:
    found = aligned_views(session)
    assert found is not None
    return found


def test_the_second_view_is_aligned_by_what_both_saw_before_walk() -> None:
    log = log_of(noise=0.0, frames=60, wrong=WRONG)
    log.positions[(log.scenario_id == WALK) & (log.skeleton_id == 1)] += np.float32([0.0, 0.0, 0.7])
    views = views_of(StudySession(log))
    apart = views.positions[:, 1] - views.positions[:, 0]
    still = views.task != WALK
    np.testing.assert_allclose(apart[still], 0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(apart[~still], axis=-1), 0.7, atol=1e-5)


def test_the_second_sensor_is_as_far_from_who_stands_and_as_far_round_as_its_calibration_says() -> None:
    """The person stood before the reference sensor, as far away as the log says, and as far aside as it was seen."""
    log = SESSION.log
    views = views_of()
    turn = log.init_angle[log.skeleton_id == 1][0] - log.init_angle[log.skeleton_id == 0][0]
    far, far_second = (log.init_dist[log.skeleton_id == k][0] for k in (0, 1))
    stood = np.array([views.positions[views.task == STATIONARY][:, 0, :, 0].mean(), 0.0, far])
    sight = stood - views.places[1]
    np.testing.assert_array_equal(views.places[0], 0)
    assert np.linalg.norm(sight) == pytest.approx(far_second, abs=1e-4)
    assert sight == pytest.approx(far_second * np.array([np.sin(turn), 0.0, np.cos(turn)]), abs=1e-4)


def test_sensors_are_where_the_person_looks_to_see_them() -> None:
    views = views_of()
    for k, place in enumerate(views.places):
        spine = views.positions[:, k][:, module._TRUNK].mean(axis=1)
        there = np.stack([np.sin(views.toward[:, k]), np.cos(views.toward[:, k])], axis=-1)
        sight = (place - spine)[:, [0, 2]]
        np.testing.assert_allclose(there, sight / np.linalg.norm(sight, axis=-1, keepdims=True), atol=1e-9)


def test_the_facing_is_known_in_all_tasks_but_walk_and_the_heading_of_a_circle_is_along_it() -> None:
    session = facing_session(SESSION)
    assert session is not None
    walks = session.task == WALK
    np.testing.assert_array_equal(np.isnan(session.sequence.known_yaw), walks)
    np.testing.assert_array_equal(session.sequence.known_yaw[~walks], session.toward_front[~walks])
    root = views_of().positions[:, :, ROOT].mean(axis=1)
    around = root - [0.0, 0.0, 2.4]  # the circle's middle
    along = np.arctan2(-around[:, 2], around[:, 0])  # a quarter turn on
    inside = slice(round(HEADING_OVER * 30), -round(HEADING_OVER * 30))
    np.testing.assert_allclose(wrap(session.heading - along)[inside], 0, atol=1e-3)
    np.testing.assert_array_equal(np.isnan(session.heading[[0, 1, -2, -1]]), True)
    assert np.isfinite(session.heading[4:-4]).all()


@given(st.tuples(*[st.floats(-3, 3)] * 3), st.sampled_from([(0.25, 0.0), (0.125, 0.125), (0.0, 0.5)]))
def test_a_steady_velocity_is_known_wherever_its_interval_is_covered(v: Any, interval: tuple[float, float]) -> None:
    at_s = np.arange(17) / 16
    before_s, after_s = interval
    found = _velocity(at_s, 5.0 + at_s[:, None] * v, before_s, after_s)
    covered = (at_s - before_s >= 0) & (at_s + after_s <= 1)
    np.testing.assert_array_equal(np.isfinite(found), np.repeat(covered[:, None], 3, axis=1))
    np.testing.assert_allclose(found[covered], np.tile(v, (covered.sum(), 1)), atol=1e-9)


def test_frames_of_the_training_are_counted_by_task() -> None:
    session = facing_session(SESSION)
    assert session is not None
    assert trained_on([session, session])["frames_by_task"] == {"stationary": 120, "steps": 120, "walk": 120}


def test_nobody_is_judged_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    made = facing_session(session_of(frames=60))
    assert made is not None
    sessions = [msgspec.structs.replace(made, participant=n) for n in (4, 2, 9)]
    asked: list[list[int]] = []

    def yaws(of: Any, *_: Any, **__: Any) -> list[np.ndarray]:
        asked.append([one.participant for one in of])
        return [one.front_labels for one in of]

    monkeypatch.setattr(module, "train", lambda *_: shipped_model())
    monkeypatch.setattr(module, "_yaws", yaws)
    monkeypatch.setattr(module, "reference_facings", yaws)
    assert {told.sessions for told in left_out(sessions, 3, shipped_model()).values()} == {3}
    assert asked == [[n] for n in (2, 4, 9) for _ in range(5)] + [[2, 4, 9]] * 2
