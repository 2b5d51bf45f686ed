"""Simulated sessions without a fault, and the conditions that a tracker reports in them all the same.

A *warning* is a condition that calls for an action (`mocapella.model.conditions.is_warning`), and is wrong in
these sessions at any time. Until the first frame of the phase tracking, a calibration may be unfinished. Afterwards no
condition at all is right, and the phase stays.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from typing import Final, Protocol

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.simulation import scene_room, scene_summaries
from mocapella.model.conditions import is_warning, trouble
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.sources.simulate import (
    PersonSettings,
    Room,
    SceneSettings,
    SimulatedSensor,
    build_room,
    merge,
    scene_names,
    scene_settings,
)
from mocapella.sources.simulate.measured import KIND

APART: Final = "apart"
"""Session of two people who both sensors see at first; later each of the two stands where only one sensor sees."""
ALONE: Final = "alone"
"""Session of one person before a single sensor."""


class TrackingTracker(Protocol):
    """Interface of a judged tracker; `mocapella.tracker.default.DefaultTracker` implements it."""

    def update(self, arrival: Arrival) -> Scene:
        """Process one frame."""


class ConditionRun(msgspec.Struct, frozen=True):
    """Conditions of one session.

    Attributes:
        tracking_s: room time of the first frame in the phase tracking [s]; infinite if there is none.
        frames: number of frames.
        warned: number of frames with each warning, by ``SENSOR: TEXT``.
        unfinished: number of frames since ``tracking_s`` with each other condition, and with each other phase.
    """

    tracking_s: float
    frames: int
    warned: Mapping[str, int]
    unfinished: Mapping[str, int]

    @property
    def conditions(self) -> int:
        """Number of frames with conditions, each counted by itself; 0 in a session without problems."""
        return sum(self.warned.values()) + sum(self.unfinished.values())


def session_names() -> tuple[str, ...]:
    """Return the names that `session_room` knows."""
    return (*dict.fromkeys((*scene_names(), *scene_summaries())), APART, ALONE)


def session_room(name: str, seed: int) -> Room:
    """Build the room of a session, with sensors that have the errors of real ones.

    Args:
        name: one of `session_names`.
        seed: random seed of the room and of the sensors' errors.

    Raises:
        SettingsError: unknown name; lists the known ones.
    """
    if name in _ROUTES:
        sensors, people = _ROUTES[name]
        there = {sensor.name: sensor for sensor in scene_settings("crowd").sensors}
        settings = SceneSettings(
            name,
            tuple(there[sensor] for sensor in sensors),
            tuple(PersonSettings(start, "route", route=route) for start, route in people),
        )
    elif name in scene_names():
        settings = scene_settings(name)
    elif name in scene_summaries():
        return scene_room(name, seed)
    else:
        raise SettingsError(f"unknown session {name!r}; known: {one_of(name, session_names())}")
    measured = tuple(dataclasses.replace(sensor, errors=KIND) for sensor in settings.sensors)
    return build_room(dataclasses.replace(settings, sensors=measured, seed=seed))


def run_session(tracker: TrackingTracker, room: Room, begin_s: float = 0.0, end_s: float | None = None) -> ConditionRun:
    """Run a tracker on a room's frames, and count the frames with conditions.

    Args:
        tracker: a new tracker that expects all sensors of the room.
        room: the room.
        begin_s, end_s: room time of the first frame, and of the end; None for the end of the motion [s].
    """
    late_ns = {sensor.name: round(sensor.latency_s * NS_PER_S) for sensor in room.settings.sensors}
    tracking_s, frames = float("inf"), 0
    warned, unfinished = Counter[str](), Counter[str]()
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names]
    for item in merge(sensors, begin_s, room.duration_s if end_s is None else end_s):
        scene = tracker.update(Arrival(item.frame, item.truth.room_ns + late_ns[item.frame.sensor]))
        frames += 1
        if scene.state.phase is Phase.TRACKING:
            tracking_s = min(tracking_s, item.truth.room_ns / NS_PER_S)
        tracked = tracking_s < float("inf")
        if tracked and scene.state.phase is not Phase.TRACKING:
            unfinished[f"phase {scene.state.phase}"] += 1
        for place in scene.sensors:
            if is_warning(place.problem):
                warned[f"{place.sensor}: {trouble(place.problem)}"] += 1
            elif place.problem and tracked:
                unfinished[f"{place.sensor}: {trouble(place.problem)}"] += 1
    return ConditionRun(tracking_s, frames, dict(warned), dict(unfinished))


_Route = tuple[tuple[float, float], tuple[str, ...]]
_ROUTES: Final[Mapping[str, tuple[tuple[str, ...], tuple[_Route, ...]]]] = {
    APART: (
        ("left", "right"),
        (
            (
                (-0.3, 2.8),
                ("stand 1", "go 0.4 2.4", "go -0.4 2.4", "go -0.4 3.2", "go 0.2 2.8", "go 1.2 4.2", "stand 12"),
            ),
            ((0.5, 3.3), ("stand 9", "go -0.9 3.0", "go -1.2 4.2", "stand 9")),
        ),
    ),
    ALONE: (("front",), (((0.0, 2.8), ("stand 2", "go 0.5 2.2", "go -0.5 3", "stand 2")),)),
}
