"""What is read of a tracker after each frame: where people are, how late clocks are, how much poses wander."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import EvaluationError
from mocapella.evaluation.causal_run import LONGEST_STEP, MAX_TIME_OFFSET, TO_FIND_IT, _wander_m_per_min, run_causally
from mocapella.evaluation.protocol import SensorViews
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y

MAIN = rigid(rotation_about_y(0.5), [1.0, 0.0, 2.0])
SIDE = rigid(rotation_about_y(-0.5), [3.0, 0.0, 2.0])
PERSON = np.random.default_rng(0).normal(size=(25, 3))


class Told:
    """A tracker of one person that tells what it is made with."""

    joint_bias = None

    def __init__(self, shown: dict[str, np.ndarray], offsets: dict[str, float]) -> None:
        self.shown, self.offsets = shown, offsets

    def start_from(self, _: Any) -> None: ...

    def update(self, _: Any) -> Any:
        sensors = [SimpleNamespace(sensor=name, T_world_sensor=T) for name, T in self.shown.items()]
        views = [
            SimpleNamespace(sensor="main", tracking_id=4, states=np.array([0, 2])),
            SimpleNamespace(sensor="side", tracking_id=5, states=np.array([0, 0])),
        ]
        return SimpleNamespace(sensors=sensors, people=[SimpleNamespace(id=7, views=views, positions=PERSON)])

    def sensor_views(self) -> SensorViews:
        return SensorViews({"main": MAIN, "side": SIDE}, self.offsets)


def run(shown: dict[str, np.ndarray] | None = None, offsets: dict[str, float] | None = None) -> Any:
    made: Any = Told(shown or {}, offsets or {})
    arrivals: Any = [SimpleNamespace(at_ns=k) for k in range(2)]
    return run_causally(lambda _: made, ("main", "side"), arrivals, {})


def test_people_are_in_the_space_of_the_reference_sensor_where_the_scene_has_it_or_else_the_estimate() -> None:
    moved = rigid(np.eye(3), [0.0, 0.3, 0.0]) @ MAIN
    for shown, T in (({"side": SIDE, "main": moved}, moved), ({"side": SIDE}, MAIN), ({}, MAIN)):
        ((person,), _) = run(shown).people
        np.testing.assert_allclose(person.positions, apply(inverse(T), PERSON))
        assert (person.id, person.keys) == (7, {("main", 4)})


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_clock_may_be_off_by_a_second_and_by_no_more(sign: int) -> None:
    told = run(offsets={"side": sign * MAX_TIME_OFFSET})
    np.testing.assert_array_equal(told.time_offset_s, np.tile([np.nan, sign * MAX_TIME_OFFSET], (3, 1)))
    with pytest.raises(EvaluationError, match=r"1\.0 s is the most"):
        run(offsets={"side": sign * np.nextafter(MAX_TIME_OFFSET, 2)})


def moving(steps: int, by_m: float, sensors: int = 2) -> np.ndarray:
    """(steps + 1, sensors, 4, 4) poses, of which the last goes straight on by that at each step."""
    T = np.tile(np.eye(4), (steps + 1, sensors, 1, 1))
    T[:, -1, 0, 3] = by_m * np.arange(steps + 1)
    return T


@given(st.integers(20, 60), st.floats(0.0, 0.2), st.integers(2, 3), st.sampled_from([0.25, 0.5, 1.0]))
def test_poses_wander_by_their_path_a_minute_but_the_first_metre(
    steps: int, by_m: float, sensors: int, every_s: float
) -> None:
    """The reference sensor's is none; of several others, the one that wanders most counts."""
    at_ns = np.round(1e9 * every_s * np.arange(steps)).astype(np.int64)
    minutes = every_s * (steps - 1) / 60
    path = max(0.0, steps * by_m - TO_FIND_IT)
    assert _wander_m_per_min(moving(steps, by_m, sensors), at_ns) == pytest.approx(path / minutes)


def test_a_pause_of_the_log_is_a_second_of_wandering() -> None:
    at_ns = 10**9 * np.array([0, 1, 100, 101])
    assert _wander_m_per_min(moving(4, 1.0), at_ns) == pytest.approx(60 * (4 - TO_FIND_IT) / (3 * LONGEST_STEP))
    assert _wander_m_per_min(moving(1, 5.0), at_ns[:1]) == pytest.approx(60 * (5 - TO_FIND_IT) / LONGEST_STEP)


def test_a_sensor_alone_does_not_wander() -> None:
    assert _wander_m_per_min(moving(9, 1.0, sensors=1), 10**9 * np.arange(9)) == 0
