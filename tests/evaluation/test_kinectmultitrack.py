"""What the scoring of the study logs sums up over sessions."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from support.evaluation_sessions import body, log_of, session_of
from support.reference_methods import Method
from support.study_examples import FRONT, SIDE

from mocapella.evaluation import fused_metrics
from mocapella.evaluation.kinectmultitrack import (
    STATIONARY,
    STEPS,
    WALK,
    AsLogged,
    AsRun,
    OneSensor,
    Tally,
    _mean_and_sd,
    fused_figures,
    scorings,
)
from mocapella.evaluation.study_pairs import Pairs, StudySession
from mocapella.geometry import rigid
from mocapella.model.study_log import StudyLog


def test_a_figure_is_the_mean_of_the_sessions_that_have_it() -> None:
    tally = Tally()
    tally.fused["90"] = [{"lag_ms": 1.0, "jitter_mm": 4.0}, {"lag_ms": 3.0, "slide_cm_s": math.nan}]
    tally.fused["45"] = [{"lag_ms": 8.0, "jitter_mm": math.nan}]
    assert tally.fused_json() == {
        "all": {"sessions": 3, "lag_ms": 4.0, "jitter_mm": 4.0, "slide_cm_s": None},
        "90": {"sessions": 2, "lag_ms": 2.0, "jitter_mm": 4.0, "slide_cm_s": None},
        "45": {"sessions": 1, "lag_ms": 8.0, "jitter_mm": None},
    }


def test_without_a_session_there_is_no_figure() -> None:
    assert Tally().fused_json() == {}


SESSION = session_of(frames=90, noise=0.0)
WALKS = SESSION.pairs.where(SESSION.pairs.task == WALK)


def changed(**fields: Any) -> StudySession:
    return StudySession(msgspec.structs.replace(log_of(frames=30, noise=0.0), **fields))


def exchanged() -> StudySession:
    """The side sensor is the reference."""
    kinects = log_of(frames=30).kinect_id
    return changed(kinect_id=np.where(kinects == FRONT, SIDE, FRONT))


def test_each_task_is_a_row_and_steps_have_their_second_half_too() -> None:
    task = np.array([STEPS] * 5 + [WALK] * 2 + [STATIONARY, 77])
    rows = np.arange(9)[:, None] + np.zeros(2, dtype=np.int64)
    found = {name: pairs.rows[:, 0].tolist() for name, pairs in scorings(Pairs(rows, np.zeros(9), task))}
    half, walk = [2, 3, 4], [5, 6]
    assert found == {
        "stationary": [7], "steps": [0, 1, 2, 3, 4], "steps-second-half": half, "steps-second-half-refined": half,
        "walk": walk, "walk-frozen": walk, "walk-cold": walk, "scenario 77": [8],
    }  # fmt: skip


def test_rows_are_in_the_order_of_the_thesis() -> None:
    tally = Tally()
    tally.add(SESSION, AsLogged(SESSION))
    assert list(tally.as_json("", tally.counts())["tasks"]) == [
        "stationary", "steps", "steps-second-half", "steps-second-half-refined", "walk", "walk-frozen", "walk-cold"
    ]  # fmt: skip


def test_one_sensor_is_the_front_one_or_else_the_reference() -> None:
    log = log_of(frames=30, noise=0.01)
    named, swapped, unnamed = (
        StudySession(msgspec.structs.replace(log, kinect_id=np.where(log.kinect_id == FRONT, one, other)))
        for one, other in ((FRONT, SIDE), (SIDE, FRONT), ("10.0.0.1", SIDE))
    )
    for session, own in ((named, 0), (swapped, 1), (unnamed, 0)):
        at_s, skeletons = OneSensor(session).fused(session.pairs)
        rows = np.flatnonzero(session.sensor == own)
        np.testing.assert_array_equal(at_s, session.at_s[rows])
        np.testing.assert_array_equal(skeletons, session.log.positions[rows])


def test_the_yaw_is_that_of_the_side_sensor_whichever_is_the_reference() -> None:
    """Of angles that the log has: 0.1 rad for the reference, −1.4 for the other one."""
    assert AsLogged(SESSION).yaw() == pytest.approx(1.5)
    assert AsLogged(exchanged()).yaw() == pytest.approx(-1.5)
    wide = changed(init_angle=np.where(log_of(frames=30).skeleton_id == 0, 3.0, -1.0))
    assert AsLogged(wide).yaw() == pytest.approx(4.0 - 2 * np.pi)


class Turner(Method):
    """Turns the side sensor by 0.1 rad, and from the first frame of Walk on by more."""

    def start_from(self, T_world_sensor: Any) -> None:
        super().start_from(T_world_sensor)
        self.layout = self.T[self.others[0]]

    def conclude(self, arrival: Any) -> None:
        turn = rigid.rotation_about_y(0.1 if self.step < 2 * 60 else 0.5)
        self.T[self.others[0]] = rigid.rigid(turn, np.zeros(3)) @ self.layout


class Goer(Method):
    """Moves the side sensor by a decimetre with each of the first thirty frames."""

    def conclude(self, arrival: Any) -> None:
        step = [0.1 * min(self.step + 1, 30), 0, 0]
        self.T = {self.reference: np.eye(4), self.others[0]: rigid.rigid(np.eye(3), step)}


def test_the_yaw_of_a_method_is_what_it_knew_before_walk() -> None:
    assert AsRun(SESSION, Turner).yaw() == pytest.approx(1.5 - 0.1)


def shifts(output: AsRun, scoring: str) -> np.ndarray:
    """(pairs,) by how much the side sensor's view was moved."""
    views = output.views(scoring, WALKS)
    return np.asarray((views.raw_labels[:, 1] - SESSION.raw[WALKS.rows[:, 1]])[:, 0, 0])


def test_a_frozen_row_has_one_motion_and_a_cold_one_begins_anew() -> None:
    output = AsRun(SESSION, Goer)
    assert shifts(output, "walk") == pytest.approx(3.0)
    assert shifts(output, "walk-frozen") == pytest.approx(3.0)
    cold = shifts(output, "walk-cold")
    assert cold[1:14] == pytest.approx(0.2 * np.arange(1, 14))
    early = SESSION.pairs.where(np.arange(len(SESSION.pairs)) >= 5)
    frozen = output.views("steps-second-half", early).raw_labels[:, 1] - SESSION.raw[early.rows[:, 1]]
    assert frozen[:, 0, 0] == pytest.approx(1.0)


def test_a_method_wanders_as_much_as_in_the_worse_of_its_runs() -> None:
    """It goes as far in Walk alone, in a third of the time."""
    output = AsRun(SESSION, Goer)
    assert output.wander_m_per_min == pytest.approx(3 * output.whole.wander_m_per_min, rel=0.1)


def test_a_session_without_walk_has_no_row_of_it_and_one_of_walk_alone_is_cold_from_the_beginning() -> None:
    stands = changed(scenario_id=np.full(60, STATIONARY))
    tally = Tally()
    tally.add(stands, AsRun(stands, Method))
    assert (dict(tally.fused), [name for name, _ in tally.scored]) == ({}, ["stationary"])
    walks = changed(scenario_id=np.full(60, WALK))
    output = AsRun(walks, Goer)
    for views in (output.views(name, walks.pairs) for name in ("walk", "walk-cold")):
        np.testing.assert_array_equal(views.raw_labels, output.views("walk", walks.pairs).raw_labels)


def test_distances_of_two_people_are_told_for_each() -> None:
    one = log_of(frames=30, noise=0.0)
    both = {name: np.repeat(getattr(one, name), 2, axis=0) for name in one.__struct_fields__ if name != "source"}
    second = np.arange(120) % 2
    both["person_id"] = both["person_id"] + second
    off_m = np.where(second * both["skeleton_id"], 0.1, 0.0)
    both["positions"] = (both["positions"] + second[:, None, None] + off_m[:, None, None] * [0, 1, 0]).astype(
        np.float32
    )
    session = StudySession(StudyLog(one.source, **both))
    tally = Tally()
    tally.add(session, AsLogged(session))
    people = tally.interactions[session.name]["people"]
    assert people["0"]["mean_cm"] == pytest.approx(0.0, abs=1e-4)
    assert people["1"]["mean_cm"] == pytest.approx(10.0, abs=1e-4)
    assert not tally.fused


class Skeletons(AsLogged):
    """As many fused skeletons of each task as told; each is at the height of its task's number [m]."""

    def __init__(self, counts: dict[int, int]) -> None:
        super().__init__(SESSION)
        self.counts = counts

    def fused(self, pairs: Pairs) -> tuple[Any, Any]:
        """Half a second apart from 100 s on."""
        (task,) = np.unique(pairs.task).tolist()
        count = self.counts[task]
        return 100 + 0.5 * np.arange(count), np.tile(body() + np.array([0, task, 0]), (count, 1, 1))


def test_figures_of_a_fused_skeleton_are_in_the_units_of_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is of the skeletons of its own task, which are at the height of its number here."""
    told = {
        "bone_length_variation": 0.13, "foot_slide": 0.02, "shoulder_collapse": 0.3, "facing_against_motion": 0.4,
        "yaw_reversals": 4, "label_flips": 2, "lag": 0.05, "jitter": 0.007, "facing_away": 0.1,
    }  # fmt: skip
    tasks: dict[str, float] = {}

    def figure(name: str) -> Any:
        def of(skeletons: Any, *_: Any) -> float:
            tasks[name] = skeletons[0, 0, 1]
            return told[name]

        return of

    for name in told:
        monkeypatch.setattr(fused_metrics, name, figure(name))
    half_a_minute = 61
    every = {STATIONARY: 5, STEPS: 5, WALK: half_a_minute}
    found = fused_figures(SESSION, Skeletons(every))
    found.pop("lag_ms")
    assert found == pytest.approx({
        "bone_length_variation_percent": 13, "foot_slide_cm_s": 2, "shoulder_collapse_percent": 30,
        "facing_against_motion_percent": 40, "yaw_reversals_per_min": 8, "label_flips_per_min": 4,
        "stationary_jitter_mm": 7, "steps_facing_wrong_percent": 10,
    })  # fmt: skip
    as_many = fused_figures(SESSION, Skeletons(every | {WALK: len(WALKS)}))
    assert as_many["lag_ms"] == pytest.approx(50)
    assert tasks == dict.fromkeys(told, WALK) | {"jitter": STATIONARY, "facing_away": STEPS}
    assert math.isnan(fused_figures(SESSION, Skeletons(every))["lag_ms"])


@pytest.mark.parametrize(("count", "known"), [(2, {"steps_facing_wrong_percent"}), (3, None)])
def test_three_skeletons_of_a_task_are_enough_for_its_figures_and_one_of_steps(count: int, known: Any) -> None:
    found = fused_figures(SESSION, Skeletons({STATIONARY: count, STEPS: 1, WALK: count}))
    assert len(found) == (9 if known is None else 1)
    assert known is None or set(found) == known
    assert fused_figures(SESSION, Skeletons({STATIONARY: 0, STEPS: 0, WALK: 0})) == {}


@pytest.mark.parametrize("session", [SESSION, exchanged()])
def test_who_faces_the_front_sensor_in_steps_is_not_wrong_whichever_is_the_reference(session: StudySession) -> None:
    """Turned round, it is always wrong."""
    front = np.zeros(3) if session is SESSION else session.replay.T_reference_second[:3, 3]
    place = np.array([0.4, 0.0, 1.5])
    yaw = np.arctan2(*(front - place)[[0, 2]])
    for turned, wrong in ((0.0, 0.0), (1.4, 0.0), (1.8, 100.0), (np.pi, 100.0)):

        class Stands(AsLogged):
            def fused(self, pairs: Pairs, turned: float = turned) -> tuple[Any, Any]:
                return np.arange(1.0), (body(yaw + turned) + place)[None]

        assert fused_figures(session, Stands(session))["steps_facing_wrong_percent"] == wrong


def test_the_spread_of_a_yaw_is_that_of_a_sample() -> None:
    assert _mean_and_sd([1.0, 3.0]) == {"mean": 2.0, "sd": pytest.approx(math.sqrt(2)), "sessions": 2}
    assert math.isnan(_mean_and_sd([1.0])["sd"])
