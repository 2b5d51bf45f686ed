"""Sessions without a problem: no sensor has a condition once its calibration is complete, and never a warning."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.condition_sessions import ALONE, APART, ConditionRun, run_session, session_names, session_room
from mocapella.model import condition_texts as texts
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, SensorPlace
from mocapella.sources.simulate.measured import KIND
from mocapella.tracker.default import DefaultTracker


# People stand for 6.6 s in most scenes; the sessions begin shortly before they move, and each ends seconds after the
# calibration. `python -m benchmarks conditions` runs all scenes from begin to end.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "begin_s", "tracked_by_s", "end_s"),
    [
        ("walk", 0, 6.0, 9.0, 12.0),
        ("squats", 1, 6.0, 9.0, 11.0),
        ("sit", 2, 6.0, 9.0, 11.0),
        ("wave", 0, 6.0, 9.0, 11.0),
        ("bend", 1, 6.0, 9.0, 11.0),
        ("obstacle", 1, 6.0, 12.0, 14.5),
        ("crossing", 2, 4.0, 12.0, 14.5),
        ("crowd", 0, 6.0, 10.5, 12.0),
        (APART, 0, 0.0, 10.0, 17.0),
        (ALONE, 0, 0.0, 0.5, 3.0),
    ],
)
def test_a_session_without_a_problem_has_no_condition(
    name: str, seed: int, begin_s: float, tracked_by_s: float, end_s: float
) -> None:
    room = session_room(name, seed)
    run = run_session(DefaultTracker(sensors_expected=len(room.sensor_names)), room, begin_s, end_s)
    assert (run.warned, run.unfinished) == ({}, {})
    assert run.tracking_s < tracked_by_s


class Saying:
    """In place of a tracker: tracks after its second frame, and says what it is told about the first sensor."""

    def __init__(self, problem: str, *, stays: bool = True) -> None:
        self.inner, self.problem, self.stays, self.frames = DefaultTracker(), problem, stays, 0

    def update(self, arrival: Arrival) -> Scene:
        self.frames += 1
        scene = self.inner.update(arrival)
        tracks = self.frames > 2 and (self.stays or self.frames % 2 == 1)
        phase = Phase.TRACKING if tracks else Phase.CALIBRATING
        state = msgspec.structs.replace(scene.state, phase=phase)
        return msgspec.structs.replace(scene, state=state, sensors=(SensorPlace("front", None, problem=self.problem),))


@pytest.mark.parametrize(
    ("problem", "stays", "warned", "unfinished"),
    [
        (texts.MOVED, True, {f"front: {texts.MOVED}": 30}, {}),
        (f"with left: {texts.WALK}", True, {}, {f"front: {texts.WALK}": 28}),
        ("", False, {}, {"phase calibrating": 14}),
        ("", True, {}, {}),
    ],
)
def test_conditions_are_counted(problem: str, stays: bool, warned: dict[str, int], unfinished: dict[str, int]) -> None:
    run = run_session(Saying(problem, stays=stays), session_room(ALONE, 0), 0.0, 1.0)
    assert run == ConditionRun(run.tracking_s, 30, warned, unfinished)
    assert run.conditions == sum(warned.values()) + sum(unfinished.values())
    assert run.tracking_s == pytest.approx(2 / 30, abs=0.02)


def test_frames_arrive_after_their_sensors_latency_until_the_motion_ends() -> None:
    """Never tracked, a session has no time of it, and all that is unfinished is right."""
    room, arrivals = session_room(ALONE, 0), []

    class Hears(Saying):
        def update(self, arrival: Arrival) -> Scene:
            arrivals.append(arrival)
            self.frames = 0
            return super().update(arrival)

    run = run_session(Hears(texts.WALK), room, room.duration_s - 0.5)
    (latency_s,) = (sensor.latency_s for sensor in room.settings.sensors)
    times = np.array([one.at_ns for one in arrivals]) / 1e9 - latency_s
    assert times[0] == pytest.approx(room.duration_s - 0.5, abs=1 / 30)
    assert times[-1] == pytest.approx(room.duration_s, abs=1 / 30)
    assert (run.tracking_s, run.frames, run.conditions) == (np.inf, len(arrivals), 0)


@pytest.mark.parametrize(
    ("name", "sensors", "people"), [("walk", 3, 1), (APART, 2, 2), (ALONE, 1, 1), ("six", 4, 6), ("walk-45", 2, None)]
)
def test_sessions_have_their_sensors_with_the_errors_of_real_ones(name: str, sensors: int, people: int | None) -> None:
    settings = session_room(name, 5).settings
    assert len(settings.sensors) == sensors
    assert people is None or len(settings.people) == people
    assert {sensor.errors for sensor in settings.sensors} == {KIND}
    assert settings.seed == 5


def test_every_scene_is_a_session_and_no_other_name() -> None:
    assert {"walk", "crowd", "six", APART, ALONE} <= set(session_names())
    with pytest.raises(SettingsError, match="unknown session 'nowhere'"):
        session_room("nowhere", 0)
