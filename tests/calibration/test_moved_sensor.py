from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
from support.walking_people import FRONT, SIDE, Sensor, Walker, standing_at
from test_pair_calibration import calibrated

from mocapella.calibration import pair_memory as at
from mocapella.calibration.moved_sensor import AGREED_BEFORE_S, SEEN_WITHIN_S, disagrees_for, moved_sensors
from mocapella.calibration.pair_calibration import PairCalibration


def test_the_sensor_that_most_pairs_disagree_with_is_the_one_that_moved() -> None:
    names = ["a", "b", "c", "d"]
    assert moved_sensors([("a", "b"), ("b", "c"), ("b", "d")], [("a", "c"), ("c", "d")], names) == ["b"]
    assert moved_sensors([("a", "b")], [("b", "c")], names) == ["a"]
    assert moved_sensors([("a", "b")], [("a", "c")], names) == ["b"]
    assert moved_sensors([("a", "b"), ("c", "d")], [], names) == ["d", "b"]
    assert moved_sensors([], [("a", "b")], names) == []


def test_of_two_alone_the_first_is_kept() -> None:
    assert moved_sensors([("front", "side")], [], ["front", "side"]) == ["side"]


def test_a_pair_disagrees_from_when_a_sensor_moves_and_not_before() -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01)
    pair = calibrated(a, b, {0: Walker()}, 10)
    pair.trust(pair.estimate())
    calibrated(a, b, {0: Walker()}, 5, pair, begin=10.0)
    assert disagrees_for(pair, 15.0) == 0.0
    T_before = pair.T_a_b.copy()
    b.T_world_sensor = SIDE @ standing_at(0.1, 0.0, 8.0, height=0.0)
    calibrated(a, b, {0: Walker()}, 2.5, pair, begin=15.0)
    assert 1.5 < disagrees_for(pair, 17.4) <= 2.4
    np.testing.assert_array_equal(pair.T_a_b, T_before)  # what does not fit is left out
    assert disagrees_for(pair, 30.0) == 0.0  # nobody is seen by both any more


def test_somebody_who_never_agreed_is_no_evidence() -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01)
    pair = calibrated(a, b, {0: Walker()}, 10)
    pair.trust(pair.estimate())
    pair.forget_bodies(lambda who: False)
    b.T_world_sensor = SIDE @ standing_at(1.0, 0.0, 30.0, height=0.0)
    calibrated(a, b, {0: Walker()}, 4, pair, begin=10.0)
    assert disagrees_for(pair, 14.0) == 0.0


def test_a_body_counts_for_half_a_second_after_it_was_last_compared_and_no_longer() -> None:
    body = np.full(at.STEP_AT + 1, np.nan)
    body[at.STEP_AT], body[at.AGREED], body[at.DISAGREES_SINCE] = 10.0, AGREED_BEFORE_S, 8.0
    pair = cast(PairCalibration, SimpleNamespace(bodies={(1, 2): body}))
    last = 10.0 + SEEN_WITHIN_S
    assert disagrees_for(pair, last) == last - 8.0
    assert disagrees_for(pair, last + 1e-6) == 0.0
