"""What is scored is raw joints moved by one rigid motion that was known before: each way around that is planted."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.evaluation_sessions import KINECT, log_of, session_of
from support.reference_methods import BatchFit, Bender, Copier, Doubter, Method

from mocapella.errors import EvaluationError
from mocapella.evaluation.causal_run import run_causally
from mocapella.evaluation.kinectmultitrack import AsLogged, AsRun, Tally
from mocapella.evaluation.protocol import SensorViews, check_rigid
from mocapella.evaluation.scored_views import SeenViews, asked_about, known_before, views_of
from mocapella.evaluation.study_pairs import Pairs, StudySession
from mocapella.evaluation.study_tables import MAX_WANDER, differences
from mocapella.geometry import rigid
from mocapella.model.observations import Arrival

WRONG = rigid.rigid(rigid.rotation_about_y(0.2), [0.3, 0.1, -0.2])


def rows_of(session: StudySession, make: Any) -> dict[str, Any]:
    """The method's rows, by the scoring's name."""
    logged, tally = Tally(), Tally()
    logged.add(session, AsLogged(session))
    tally.add(session, AsRun(session, make))
    tasks = tally.as_json("", logged.counts())["tasks"]
    return {name: placements["90"] for name, placements in tasks.items()}


def raw_dd(session: StudySession, make: Any, scoring: str = "walk") -> Any:
    pairs = session.pairs.where(session.pairs.task == 3)
    return differences(AsRun(session, make).views(scoring, pairs).raw_labels)[..., 3]


# What is known after a pair's frames is not applied to it


class Counter(Method):
    """Says with its motion how many frames it has seen."""

    def conclude(self, arrival: Arrival) -> None:
        self.T = {
            self.reference: np.eye(4),
            **{other: rigid.rigid(np.eye(3), [self.step + 1.0, 0, 0]) for other in self.others},
        }


def test_a_pair_is_scored_with_what_was_known_before_either_of_its_frames() -> None:
    session = session_of(noise=0.0)
    pairs = session.pairs
    run = run_causally(
        Counter, session.replay.sensors, session.frames.arrivals, {"front": np.eye(4), "side": np.eye(4)}
    )
    known = known_before(session.frames, pairs)
    seen_before = run.T_reference_sensor[known, 1, 0, 3]
    np.testing.assert_array_equal(seen_before, session.frames.of_row[pairs.rows].min(axis=1))
    views = views_of(session, run, pairs, known, known)
    np.testing.assert_allclose(views.raw_labels[:, 1, 0, 0] - session.raw[pairs.rows[:, 1], 0, 0], seen_before)


def test_frozen_is_what_was_known_before_the_first_frame_of_the_task() -> None:
    session = session_of()
    walk = session.pairs.where(session.pairs.task == 3)
    frozen = known_before(session.frames, walk, frozen=True)
    assert set(frozen.tolist()) == {int(known_before(session.frames, walk).min())}


def test_later_frames_change_nothing_of_what_was_scored_before() -> None:
    whole, changed = log_of(wrong=WRONG), log_of(wrong=WRONG)
    changed.positions[400:] += np.float32(0.5)
    one, other = (raw_dd(StudySession(log), BatchFit) for log in (whole, changed))
    before = 400 // 2 - 160  # Walk begins with pair 160
    np.testing.assert_array_equal(one[:before], other[:before])
    assert np.abs(one[before:] - other[before:]).max() > 1e-3


def test_cold_is_walk_alone() -> None:
    log, changed = log_of(wrong=WRONG), log_of(wrong=WRONG)
    changed.positions[:320] += np.float32([0.3, 0, 0])  # Stationary and Steps
    one, other = (raw_dd(StudySession(each), BatchFit, "walk-cold") for each in (log, changed))
    np.testing.assert_array_equal(one, other)


# Only one rigid motion


def test_fitting_every_frame_to_what_it_is_scored_on_fails_the_row() -> None:
    session = session_of(wrong=WRONG, noise=0.03)
    for row in rows_of(session, Copier).values():
        assert row["wander_m_per_min"] > MAX_WANDER
        assert "wanders" in row["problem"]


def test_an_honest_fit_passes_and_is_better_than_what_was_logged() -> None:
    session = session_of(wrong=WRONG, noise=0.01)
    rows = rows_of(session, BatchFit)
    assert {row["problem"] for row in rows.values()} == {""}
    # Two views with 1 cm of noise in each coordinate are 1 cm · √2 · √(8/π) = 2.26 cm apart.
    assert rows["walk"]["dd_cm"]["mean"] == pytest.approx(2.26, abs=0.15)
    assert rows["walk-frozen"]["dd_cm"]["mean"] == pytest.approx(2.26, abs=0.15)


def test_a_view_cannot_be_bent() -> None:
    with pytest.raises(EvaluationError, match="T_world_sensor of front is no rigid motion"):
        rows_of(session_of(frames=30), Bender)


motions = st.builds(
    lambda a, b, t: rigid.rigid(rigid.rotation_about_y(a) @ rigid.rotation_about_x(b), t),
    st.floats(-4, 4),
    st.floats(-4, 4),
    st.tuples(*[st.floats(-9, 9)] * 3),
)


@given(T=motions)
def test_rigid_motions_pass(T: Any) -> None:
    np.testing.assert_array_equal(check_rigid(T, "T"), T)


@given(T=motions, factor=st.floats(0.5, 1.5).filter(lambda factor: abs(factor - 1) > 1e-3), axis=st.integers(0, 2))
def test_anything_else_does_not(T: Any, factor: float, axis: int) -> None:
    bent, mirrored, lost, sheared = (T.copy() for _ in range(4))
    bent[axis, :3] *= factor
    mirrored[axis, :3] *= -1
    lost[axis, 3] = np.nan
    sheared[3, axis] = 0.1
    for planted in (bent, mirrored, lost, sheared, T[:3]):
        with pytest.raises(EvaluationError, match="T of side is no"):
            check_rigid(planted, "T of side")


class Rewriter(Method):
    """Changes afterwards what it said before."""

    def conclude(self, arrival: Arrival) -> None:
        if self.step == 200:
            for T in self.T.values():
                T[:3, 3] += 1.0
            self.T = {name: T.copy() for name, T in self.T.items()}


def test_what_was_said_cannot_be_changed_afterwards() -> None:
    session = session_of(frames=120)
    layout = {"front": np.eye(4), "side": session.replay.T_reference_second}
    run = run_causally(Rewriter, session.replay.sensors, session.frames.arrivals, layout)
    np.testing.assert_array_equal(run.T_reference_sensor[:200, 1], np.tile(layout["side"], (200, 1, 1)))


# Nothing is left out


def test_pairs_of_which_nothing_was_known_in_time_fail_the_row() -> None:
    rows = rows_of(session_of(), Doubter)
    assert "a motion was not known in time" in rows["stationary"]["problem"]
    assert "a motion was not known in time" in rows["walk-cold"]["problem"]
    assert rows["walk"]["problem"] == ""


def test_a_joint_that_the_log_misses_stays_missing_and_no_other_does() -> None:
    log = log_of()
    log.positions[350, 7] = np.nan
    session = StudySession(log)
    missing = np.isnan(raw_dd(session, BatchFit))
    assert missing.sum() == 1
    assert rows_of(session, BatchFit)["walk"]["problem"] == ""


# Time offsets, labels and bias


class Offset(Method):
    """Declares how late each sensor is, and calibrates nothing."""

    late: Mapping[str, float] = {"front": 0.0, "side": -0.05}

    def start_from(self, T_world_sensor: Mapping[str, Any]) -> None:
        super().start_from(T_world_sensor)
        self.offsets = dict(self.late)


def test_the_right_offset_brings_both_views_to_one_instant() -> None:
    session = session_of(noise=0.0, lag_s=0.05)
    as_it_came, aligned = (np.nanmean(raw_dd(session, make)) for make in (Method, Offset))
    assert as_it_came > 0.02
    assert aligned < 0.003


def test_a_view_is_never_made_of_frames_newer_than_its_own() -> None:
    log, changed = log_of(noise=0.0, lag_s=0.05), log_of(noise=0.0, lag_s=0.05)
    changed.positions[440:] += np.float32(0.5)
    one, other = (raw_dd(StudySession(each), Offset) for each in (log, changed))
    np.testing.assert_array_equal(one[: 220 - 160], other[: 220 - 160])


def test_an_offset_that_cannot_be_one_is_refused() -> None:
    wild = type("Wild", (Offset,), {"late": {"front": 0.0, "side": 2.0}})
    with pytest.raises(EvaluationError, match=r"a time offset of 2\.0 s"):
        rows_of(session_of(frames=30), wild)


class Swapper(Method):
    """Decides after frame 400 that the side sensor's labels are mirrored."""

    def conclude(self, arrival: Arrival) -> None:
        if self.step == 400:
            self.swapped = frozenset({("side", 0)})


def test_labels_are_repaired_from_the_pair_after_the_decision_on_and_never_in_the_raw_row() -> None:
    session = session_of(noise=0.0)
    views = AsRun(session, Swapper).views("walk", session.pairs)
    swapped = np.abs(views.repaired - views.raw_labels).max(axis=(1, 2, 3)) > 0
    first = session.frames.of_row[session.pairs.rows].min(axis=1)
    np.testing.assert_array_equal(swapped, first > 400)
    mirrored = views.raw_labels[swapped][:, 1][:, list(KINECT.mirror)]
    np.testing.assert_array_equal(views.repaired[swapped][:, 1], mirrored)
    assert views.swaps_per_min > 0


class Biased(Method):
    """Adds to the side sensor's joints; keeps what it was asked with."""

    asked: list[Any] = []  # noqa: RUF012

    @staticmethod
    def joint_bias(sensor: str, facing: float, position: Any, velocity: Any) -> Any:
        Biased.asked.append((sensor, facing, position, velocity))
        return np.full((25, 3), 0.1 if sensor == "side" else 0.0)


def test_a_bias_is_a_function_of_the_fused_person_only() -> None:
    session = session_of(noise=0.0)
    Biased.asked = []
    biased, plain = raw_dd(session, Biased), raw_dd(session, Method)
    np.testing.assert_allclose(biased, plain + 0.1 * np.sqrt(3), atol=1e-6)
    sensor, facing, position, velocity = next(asked for asked in Biased.asked[100:] if asked[0] == "front")
    assert sensor == "front"
    assert np.linalg.norm(velocity) == pytest.approx(0.6, abs=0.02)
    assert abs(facing) <= np.pi
    assert 1.7 < position[2] < 3.1


def test_the_velocity_of_the_fused_person_is_over_the_past_quarter_of_a_second() -> None:
    """Of each person alone; that of a person's first views is 0."""
    at_s = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0])
    person = np.array([1, 1, 2, 1, 1, 1, 1])
    rows = np.stack([np.arange(7)] * 2, axis=1)
    joints = np.random.default_rng(3).normal(size=(7, 1, 25, 3)).repeat(2, axis=1)
    seen = SeenViews(joints, np.broadcast_to(np.eye(4), (7, 2, 4, 4)), np.zeros((7, 2), bool))
    session: Any = SimpleNamespace(at_s=at_s)
    found = asked_about(session, Pairs(rows, person, person), seen).velocity[:, 0]
    for k, before in enumerate([0, 0, 2, 0, 1, 3, 5]):
        step_s = at_s[k] - at_s[before]
        expected = (joints[k, 0, 0] - joints[before, 0, 0]) / step_s if step_s else np.zeros(3)
        np.testing.assert_allclose(found[k], expected)


def test_a_bias_of_another_shape_is_refused() -> None:
    class Odd(Method):
        @staticmethod
        def joint_bias(sensor: str, facing: float, position: Any, velocity: Any) -> Any:
            return np.zeros(3)

    with pytest.raises(EvaluationError, match="joint bias of front"):
        rows_of(session_of(frames=30), Odd)


def test_an_unknown_sensor_is_one_that_is_left_out() -> None:
    views = SensorViews({"front": np.eye(4)})
    assert msgspec.structs.astuple(views)[1:] == ({}, frozenset())
