"""Six sensors around six people: no sensor's mark is amber while all is well, and the mark of a moved sensor is red."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.sources.simulate import SimulatedSensor, load_scene
from mocapella.sources.simulate.sensor import merge
from mocapella.tracker.default import DefaultTracker
from mocapella.viewer.perspective import Perspectives
from mocapella.viewer.sensor_marks import PlaceState, marks

BEGIN_S, FOUND_BY_S, MOVED_AT_S, REPORTED_BY_S = 6.0, 12.0, 16.0, 22.0  # people stand still at first
MOVED, SHIFT_M = "right-90", np.array([0.6, 0.0, 0.0], np.float32)


def scenes() -> Iterator[tuple[float, Scene]]:
    """The seconds and scenes of the room `crowd`, in which one sensor is moved."""
    room = load_scene("crowd")
    latency_s = {sensor.name: sensor.latency_s for sensor in room.settings.sensors}
    tracker = DefaultTracker(sensors_expected=len(latency_s))
    for item in merge([SimulatedSensor(room, name) for name in room.sensor_names], BEGIN_S, REPORTED_BY_S):
        frame, at_s = item.frame, item.truth.room_ns / NS_PER_S
        if frame.sensor == MOVED and at_s > MOVED_AT_S:
            frame = msgspec.structs.replace(frame, positions=frame.positions + SHIFT_M)
        yield at_s, tracker.update(Arrival(frame, round((at_s + latency_s[frame.sensor]) * NS_PER_S)))


@pytest.mark.slow
def test_only_a_sensor_that_is_wrong_has_a_mark_of_another_colour() -> None:
    seen = Perspectives()
    wrong_before, wrong_at_end, people = set(), {}, set()
    for at_s, scene in scenes():
        seen.learn(scene)
        wrong_at_end = {
            name: mark.standing
            for name, mark in marks(scene.sensors, seen.places, np.eye(4)).items()
            if mark.standing is not PlaceState.GOOD
        }
        if FOUND_BY_S < at_s < MOVED_AT_S:
            assert scene.state.phase is Phase.TRACKING
            assert not scene.state.reason
            wrong_before |= set(wrong_at_end)
            people.add(len(scene.people))
    assert (wrong_before, people) == (set(), {6})
    assert wrong_at_end == {MOVED: PlaceState.LOST}
    assert "it was moved" in scene.state.reason
