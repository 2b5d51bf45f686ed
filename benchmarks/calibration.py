"""Calibration from people: what a frame costs, how that grows, and how right it is in the simulated room."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.harness import Row, at_most, measured
from mocapella.calibration.people import PeopleCalibration
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.geometry.twists import log_motion
from mocapella.model.bodies import Bodies, tracked_bodies
from mocapella.model.topology import topology
from mocapella.sources.simulate import PersonSettings, SimulatedSensor, build_room, merge, scene_settings
from mocapella.sources.simulate.scenarios import STILL_S

WALKED_S = 8.0
CLOCKS_MS = (0.0, 30.0, -45.0)
RATE_HZ = 30.0


def run(*, quick: bool = False) -> list[Row]:
    rows = _accuracy(seeds=1 if quick else 5)
    for sensors, people in [(4, 6)] if quick else [(4, 1), (4, 6), (8, 6), (16, 10), (32, 20)]:
        goal = at_most(30.0) if (sensors, people) == (4, 6) else None
        rows.append(measured(f"a frame, {sensors} sensors × {people} people", _cost(sensors, people), "µs", goal=goal))
    return rows


def _accuracy(seeds: int) -> list[Row]:
    """Somebody walks for 8 s before three sensors whose clocks differ; how wrong the sensors' places are then."""
    found = [_errors(seed) for seed in range(seeds)]
    millimetres, degrees, clocks = (max(column) for column in zip(*found, strict=True))
    said = f"after {WALKED_S:.0f} s of walking, worst of {seeds} runs × 2 pairs"
    return [
        measured(f"place, {said}", millimetres, "mm", goal=at_most(10.0)),
        measured(f"angle, {said}", degrees, "°", goal=at_most(0.3)),
        measured(f"clock, {said}", clocks, "ms", goal=at_most(5.0)),
    ]


def _errors(seed: int) -> tuple[float, float, float]:
    settings = scene_settings("walk")
    room = build_room(
        replace(
            settings,
            seed=seed,
            people=(PersonSettings(start=settings.people[0].start, scenario="walk", stature=1.6 + 0.05 * seed),),
        )
    )
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names]
    calibration = PeopleCalibration()
    ahead_ns = {name: round(1e6 * ms) for name, ms in zip(room.sensor_names, CLOCKS_MS, strict=True)}
    truth = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
    begin_ns = {sensor.name: sensor.clock_ns(0) for sensor in room.settings.sensors}
    for item in merge(sensors, 0.0, STILL_S + WALKED_S):
        name = item.frame.sensor
        at_ns = item.frame.time_ns - begin_ns[name] + ahead_ns[name]
        calibration.update(tracked_bodies(item.frame), at_ns)
    known = calibration.state.sensors
    root, *others = room.sensor_names
    worst = (0.0, 0.0, 0.0)
    for other in others:
        if not known[other].trusted or known[other].root != known[root].root:
            return math.inf, math.inf, math.inf
        T = inverse(known[root].T_world_sensor) @ known[other].T_world_sensor
        error = inverse(inverse(truth[root]) @ truth[other]) @ T
        clocks = [known[name].clock for name in (root, other)]
        offset = np.nan if None in clocks else clocks[1].seconds - clocks[0].seconds  # type: ignore[union-attr]
        apart = 1e3 * float(np.linalg.norm(error[:3, 3]))
        turned = float(np.degrees(np.linalg.norm(log_motion(error)[3:])))
        clock = abs(1e3 * float(offset) - (ahead_ns[other] - ahead_ns[root]) / 1e6)
        worst = max(worst[0], apart), max(worst[1], turned), max(worst[2], clock)
    return worst


def _cost(sensors: int, people: int) -> float:
    """Processor time, mean over a second [µs], the least of the last four: other programs only make it longer."""
    calibration, numbers = PeopleCalibration(), dict[str, dict[int, int]]()
    seconds = 20 if sensors <= 8 else 10
    frames = list(_walking(sensors, people, seconds))
    for bodies, _ in frames[:sensors]:
        numbers[bodies.sensor] = {body: body for body in bodies.ids}
    taken = []
    for second in range(seconds):
        part = frames[round(second * RATE_HZ) * sensors : round((second + 1) * RATE_HZ) * sensors]
        begin = time.thread_time()
        for bodies, at_ns in part:
            calibration.update(bodies, at_ns, numbers.__getitem__)
        taken.append((time.thread_time() - begin) / len(part))
    return 1e6 * min(taken[-4:])


def _walking(sensors: int, people: int, seconds: float) -> Iterator[tuple[Bodies, int]]:
    """Frames of sensors in a circle, of people who walk in circles among them, with a centimetre of noise."""
    kinect, rng = topology("kinect_v2"), np.random.default_rng(0)
    turns = 2 * np.pi * np.arange(sensors) / sensors
    at = np.stack([3 * np.sin(turns), np.ones(sensors), -3 * np.cos(turns)], axis=-1)
    T_sensor_world = inverse(rigid(rotation_about_y(-turns), at))
    shape = rng.normal(size=(people, 25, 3)) * (0.25, 0.5, 0.15)
    states = np.full((people, 25), 2, dtype=np.uint8)
    phase = 2 * np.pi * np.arange(people) / people
    for i in range(round(seconds * RATE_HZ) * sensors):
        sensor, t = i % sensors, i / sensors / RATE_HZ
        a = phase + 0.7 * t
        place = rigid(rotation_about_y(a), np.stack([1.2 * np.sin(a), np.ones(people), 1.2 * np.cos(a)], axis=-1))
        seen = apply(T_sensor_world[sensor], apply(place, shape)) + 0.01 * rng.normal(size=shape.shape)
        yield Bodies(f"s{sensor:02d}", kinect, tuple(range(people)), seen, states), round(1e9 * t) + 10**9
