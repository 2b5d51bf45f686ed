"""What a refresh of the calibration from people leaves: poses that are shown, chosen and forgotten."""

from __future__ import annotations

from typing import Any

import numpy as np
from test_people_steps import AB, AC, BC, SETTINGS, frame, layout, pair, place

from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import NOT_ONE_BODY, PairCalibration
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.sensor_layout import VERSION, SensorLayout
from mocapella.calibration.sensor_pair import BY_LAYOUT, PairOfSensors
from mocapella.model import condition_texts as texts
from mocapella.model.bodies import Bodies
from mocapella.model.session import SensorPose


def test_people_are_upright_or_not_for_the_time_since_the_sensors_last_frame() -> None:
    class Timed(PeopleCalibration):
        def _orient(self, bodies: Bodies, pose: SensorPose, dt: float) -> None:
            took.append(dt)

    took: list[float] = []
    people = Timed()
    for name, at_s in (("a", 5.0), ("b", 5.5), ("a", 5.75), ("b", 6.0)):
        frame(people, name, at_s)
    assert took == [np.inf, np.inf, 0.75, 0.5]


def test_a_sensor_that_joins_is_shown_at_once_alone_or_as_the_layout_ties_it() -> None:
    people = PeopleCalibration()
    for k in range(12):  # more than one frame refreshes
        state = frame(people, f"s{k:02}", 0.0)
        assert set(state.sensors) == {f"s{i:02}" for i in range(k + 1)}
        assert state.sensors[f"s{k:02}"].root == f"s{k:02}"
    two = layout()
    people = PeopleCalibration(layout=SensorLayout(VERSION, True, {name: two.sensors[name] for name in "ab"}, []))
    for name in "ab":
        state = frame(people, name, 0.0)
    assert (state.sensors["b"].root, people._pairs[AB].told) == ("a", BY_LAYOUT)


def test_a_moved_sensor_is_calibrated_again_with_a_trusted_pair_and_what_is_not_tried_is_forgotten() -> None:
    tried, idle, none = PairOfSensors(None, ColdStart(SETTINGS.pair)), pair(), pair(NOT_ONE_BODY)
    people = PeopleCalibration()
    for name in "abc":
        frame(people, name, 0.0)
    for one in (tried, idle):
        one.cold.hypotheses = {(1, 1, False): PairCalibration()}
    idle.trying = none.trying = False
    people._pairs, people._moved = {AB: idle, AC: tried, BC: none}, {"a": 0.0, "c": 0.0}
    people._draw_graph()
    people._choose()
    assert people._moved == {"c": 0.0}
    assert people._steps[0] == ("forgotten", (AB,))
    people._forget_hypotheses([AB, AC])
    assert (len(idle.cold.hypotheses), len(tried.cold.hypotheses)) == (0, 1)


def test_a_floor_is_known_if_that_of_every_world_is() -> None:
    class Empty(PeopleCalibration):
        def _sensors(self, *_: Any) -> dict[str, Any]:
            return {}

    people = Empty()
    for known, told in (({}, False), ({"a": True}, True), ({"a": True, "b": False}, False), ({"a": False}, False)):
        people._worlds = {root: (np.eye(4), is_known) for root, is_known in known.items()}
        people._show()
        assert people.state.floor_known is told


def test_a_clock_that_jumped_is_told_of_for_a_while() -> None:
    people = PeopleCalibration()
    frame(people, "a", 0.0)
    people._jumped["a"] = 8.0
    for now, told in ((8.0, True), (12.9, True), (13.1, False)):
        people._now = now
        assert (people._conditions_of({"a": place("a")})["a"] == texts.CLOCK_JUMPED) is told
