"""What is counted of a posture: known errors, exchanged labels, missing people, and only while it is held."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from support.evaluation_sessions import KINECT, body

from mocapella.evaluation import posture_sessions
from mocapella.evaluation.posture_sessions import (
    POSTURE_S,
    PostureResult,
    _arrival,
    _room,
    _score,
    _with_true_labels,
    ideal_means,
)
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.observations import JointState, body_frame
from mocapella.sources.simulate.postures import RISE_S

Float64 = NDArray[np.float64]

MIRROR = list(KINECT.mirror)
PLACES = {"main": rigid(np.eye(3), [0.0, 1.0, 0.0]), "side": rigid(rotation_about_y(0.7), [2.0, 1.0, 0.5])}
WORLD = rigid(rotation_about_y(2.0), [5.0, -1.0, 3.0])
TRUE = body(0.3) + np.array([0.2, 1.0, 2.5])
BEGINS_S = 7.0
FPS = 16
LOST = 5
"""Index of a joint that sensors do not track, and whose position is nonsense."""
ROOM: Any = SimpleNamespace(
    sensor_names=("main", "side"),
    settings=SimpleNamespace(
        sensors=[SimpleNamespace(name=n, T_world_sensor=T, latency_s=0.06) for n, T in PLACES.items()]
    ),
)


class Says:
    """A tracker of the true skeleton, which is changed in a share of the main sensor's frames."""

    def __init__(self, **options: Any) -> None:
        self.found: Any = lambda true: true
        self.condition, self.people, self.place = "", True, True
        self.__dict__.update(options)
        self.worlds = {name: WORLD @ T for name, T in PLACES.items()}

    def update(self, arrival: Any) -> Any:
        person = SimpleNamespace(condition=self.condition, positions=apply(WORLD, self.found(TRUE)))
        known = {name: T for name, T in self.worlds.items() if name != "main" or self.place}
        sensors = [SimpleNamespace(sensor=name, T_world_sensor=T) for name, T in reversed(known.items())]
        return SimpleNamespace(people=(person,) if self.people else (), sensors=sensors)


def frames(begin_s: float, end_s: float, off_m: dict[str, float]) -> list[Any]:
    made = []
    for k in range(round((end_s - begin_s) * FPS)):
        for name, T in PLACES.items():
            seen = apply(inverse(T), TRUE + np.array([0.0, off_m[name], 0.0]))
            seen[LOST] = 9.0
            states = np.full(25, JointState.TRACKED)
            states[LOST], states[LOST + 1] = JointState.NOT_TRACKED, JointState.INFERRED
            frame = body_frame(name, KINECT, time_ns=0, positions=seen[None], states=states[None])
            truth = SimpleNamespace(room_ns=round(1e9 * (begin_s + k / FPS)), positions=TRUE[None])
            made.append(SimpleNamespace(frame=frame, truth=truth))
        nobody = body_frame("side", KINECT, time_ns=0, positions=[])
        made.append(SimpleNamespace(frame=nobody, truth=made[-1].truth))
    return made


def result(monkeypatch: pytest.MonkeyPatch, off_m: tuple[float, float] = (0.04, 0.03), **says: Any) -> PostureResult:
    off = dict(zip(PLACES, off_m, strict=True))
    monkeypatch.setattr(posture_sessions, "_frames", lambda _, begin_s, end_s: frames(begin_s, end_s, off))
    tracker: Any = Says(**says)
    return _score(tracker, ROOM, "bow", 60.0, BEGINS_S)


HELD = sum(RISE_S < k / FPS < POSTURE_S - RISE_S for k in range(round(POSTURE_S * FPS)))


def test_frames_of_the_main_sensor_count_while_the_posture_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    found = result(monkeypatch)
    assert (found.posture, found.heading_deg, found.frames) == ("bow", 60.0, HELD)
    assert (found.missing, found.warned, found.wrong) == (0, 0, 0)
    assert found.fused_m == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("off_m", [(0.04, 0.03), (0.03, 0.06)])
def test_the_best_sensor_is_the_one_whose_tracked_joints_are_nearest(
    monkeypatch: pytest.MonkeyPatch, off_m: tuple[float, float]
) -> None:
    found = result(monkeypatch, off_m, found=lambda true: true + np.array([0.0, 0.0, 0.02]))
    assert found.best_m == pytest.approx(0.03, abs=1e-6)
    assert found.fused_m == pytest.approx(0.02)
    assert found.mean_m == pytest.approx(sum(off_m) / 2, abs=1e-6)


def test_left_and_right_are_wrong_if_exchanging_them_is_nearer(monkeypatch: pytest.MonkeyPatch) -> None:
    assert result(monkeypatch, found=lambda true: true[MIRROR]).wrong == HELD
    flat = result(monkeypatch, found=lambda true: 0 * true + true.mean(axis=0))  # neither is
    assert flat.wrong == 0


@pytest.mark.parametrize("lacks", ["people", "place"])
def test_people_are_missing_without_a_scene_that_has_them_and_the_main_sensor(
    monkeypatch: pytest.MonkeyPatch, lacks: str
) -> None:
    found = result(monkeypatch, condition="too near", **{lacks: False})
    assert (found.frames, found.missing, found.warned) == (HELD, HELD, 0)
    assert np.isnan(found.fused_m)


def test_a_person_with_a_condition_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    assert result(monkeypatch, condition="too near").warned == HELD


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 180.0])
def test_the_person_turns_to_its_heading_against_the_first_sensor_before_the_posture(heading_deg: float) -> None:
    """It stands where both sensors look, and turns away from the second one."""
    room, begins_s = _room("bow", heading_deg, 3, (0.0, 90.0))
    first, second = room.settings.sensors
    true = room.positions_at(round(1e9 * (begins_s - 0.5)))[0]
    across = true[KINECT.index("ShoulderLeft")] - true[KINECT.index("ShoulderRight")]
    sights = [np.arctan2(*(sensor.T_world_sensor[:3, 3] - true[0])[[0, 2]]) for sensor in (first, second)]
    turned = np.arctan2(-across[2], across[0]) - sights[0]
    assert np.degrees(wrap(sights[1] - sights[0])) == pytest.approx(90, abs=6)
    assert np.degrees(wrap(turned + np.radians(heading_deg))) == pytest.approx(0, abs=6)
    assert (first.latency_s, second.latency_s) == pytest.approx((0.06, 0.07))
    assert (first.phase_s, second.phase_s) == pytest.approx((0.0, 0.011))
    assert [sensor.T_world_sensor[1, 3] for sensor in (first, second)] == pytest.approx([1.0, 1.1])


def test_a_frame_arrives_its_own_sensors_latency_after_its_instant() -> None:
    room, _ = _room("stand", 0.0, 0, (0.0, 90.0))
    for name, latency_s in zip(room.sensor_names, (0.06, 0.07), strict=True):
        item: Any = SimpleNamespace(frame=SimpleNamespace(sensor=name), truth=SimpleNamespace(room_ns=10**9))
        assert _arrival(room, item).at_ns == round(1e9 * (1 + latency_s))


ERRORS = arrays(np.float64, (2, 5, 4, 3), elements=st.integers(-50, 50).map(lambda n: n / 100))


@given(ERRORS)
def test_ideal_means_of_one_sensor_are_its_error_and_of_exact_ones_nothing(errors: Float64) -> None:
    own = np.linalg.norm(errors[0], axis=-1).mean()
    np.testing.assert_allclose(ideal_means([list(errors[0])]), own)
    np.testing.assert_allclose(ideal_means([list(errors[0]), list(-errors[0])]), 0, atol=1e-15)
    assert ideal_means([list(errors[0]), list(np.zeros_like(errors[0]))])[1] < 1e-9


@given(ERRORS, st.floats(0.1, 10))
def test_ideal_means_know_no_order_of_sensors_and_grow_with_the_errors(errors: Float64, factor: float) -> None:
    one = ideal_means([list(errors[0]), list(errors[1])])
    np.testing.assert_allclose(ideal_means([list(errors[1]), list(errors[0])]), one, rtol=1e-9)
    grown = ideal_means([list(factor * errors[0]), list(factor * errors[1])])
    np.testing.assert_allclose(grown, factor * np.array(one), rtol=1e-9, atol=1e-15)


def test_ideal_weights_are_better_than_none_for_sensors_unlike_in_quality() -> None:
    rng = np.random.default_rng(0)
    plain, weighted = ideal_means([list(rng.normal(0, sd, (200, 25, 3))) for sd in (0.01, 0.04)])
    assert weighted < 0.6 * plain
    assert weighted < 0.01 * math.sqrt(8 / math.pi)  # better than the better sensor alone


def test_a_view_that_exchanges_left_and_right_counts_with_the_true_labels() -> None:
    for seen in (TRUE, TRUE[MIRROR]):
        np.testing.assert_array_equal(_with_true_labels(seen, TRUE), TRUE)


def test_a_joint_that_a_sensor_does_not_track_is_another_sensors_alone() -> None:
    first, second = np.full((3, 2, 3), 0.1), np.full((3, 2, 3), 0.3)
    first[:, 1] = np.nan
    np.testing.assert_allclose(ideal_means([list(first), list(second)])[0], math.sqrt(3) * (0.2 + 0.3) / 2)
    assert np.isnan(ideal_means([list(first), []])).all()
