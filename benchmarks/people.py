"""Cost of a frame with people, beside a chain of well-known libraries in the same run.

The peers' chain is made of packages: for each frame numpy transforms the bodies into one space, norfair tracks each
sensor's bodies, numpy averages the bodies of a person, and the package OneEuroFilter smooths every coordinate. It does
not calibrate, and receives the association of the sensors' tracks. `uv run --group peers python -m benchmarks people`.
"""

from __future__ import annotations

import logging
import math
import statistics
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, compared, measured, times_the_peer
from mocapella.association.tracks import TrackInputs, Tracks
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.bodies import tracked_bodies
from mocapella.model.observations import Arrival
from mocapella.sources.simulate import PersonSettings, SceneSettings, SensorSettings, SimulatedSensor, build_room, merge
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.people import People, PeopleSettings
from mocapella.tracker.people_memory import SensorBodies
from mocapella.tracker.people_update import associate_and_fuse

Float64 = NDArray[np.float64]

PEOPLE, SENSORS = 6, 4
STILL_S: Final = 6.6
"""Everybody stands so long at first."""
LONGEST_S: Final = 8.0
SIZES: Final = ((6, 1), (6, 2), (6, 4), (6, 8), (6, 16), (6, 32), (1, 4), (3, 4), (12, 4), (20, 4), (20, 32))
"""(people, sensors) of the curve."""


def run(quick: bool = False) -> list[Row]:
    """The rows of docs/methods/default.md."""
    known, arrivals = hall(PEOPLE, SENSORS, 2.0 if quick else LONGEST_S)
    rounds = len(arrivals) / SENSORS
    size = f"{PEOPLE} people × {SENSORS} sensors × 25 joints, a frame of each"
    ours: dict[str, tuple[Callable[[], float], float | None]] = {
        "associate + fuse + 1-euro": (lambda: chain_seconds(known, arrivals), 25.0),
        "default settings, calibration and articulated body included": (lambda: tracker_seconds(known, arrivals), 10.0),
        "of that, the compiled step alone (assignment, views, facing, fusion, body)": (
            lambda: step_seconds(known, arrivals),
            None,
        ),
    }
    for work, _ in ours.values():
        work()  # compiles
    peers = peers_chain(known)
    rows = []
    for name, (work, times) in ours.items():
        turns = [(work(), peers(arrivals) if peers else math.nan) for _ in range(2 if quick else 5)]
        value, peer_value = (1e6 / rounds * statistics.median(column) for column in zip(*turns, strict=True))
        goal = None if times is None else times_the_peer(times)
        what = f"people: {name}, {size}"
        if peers is None:
            rows.append(measured(what, value, "µs", goal=goal))
        else:
            rows.append(compared(what, value, "µs", peer=PEERS, peer_value=peer_value, goal=goal))
    return [*rows, *curve(SIZES[:3] if quick else SIZES, 1.0 if quick else 3.0)]


def curve(sizes: Sequence[tuple[int, int]], span_s: float) -> list[Row]:
    """What a frame costs with more sensors and people: to grow linearly, a frame may cost as much as its bodies do."""
    rows = []
    for people, sensors in sizes:
        known, arrivals = hall(people, sensors, span_s)
        seconds = statistics.median(tracker_seconds(known, arrivals) for _ in range(3))
        name = f"people: a frame of one of {sensors} sensors, {people} people, default settings"
        rows.append(measured(name, 1e6 * seconds / len(arrivals), "µs"))
    return rows


def hall(people: int, sensors: int, span_s: float) -> tuple[dict[str, Float64], list[Arrival]]:
    """Return the sensors' poses, and their frames of people who walk in a hall; each sensor sees all people."""
    side = math.ceil(math.sqrt(people))
    ring = tuple(
        SensorSettings(
            f"sensor-{i:02d}",
            position=(8 * math.sin(a), 2.5, 3.0 - 8 * math.cos(a)),
            yaw_deg=math.degrees(-a),
            tilt_deg=-12.0,
            range_m=(0.5, 30.0),
            fov_deg=(100.0, 80.0),
            phase_s=i / 30 / sensors,
            max_bodies=max(6, people),
        )
        for i, a in enumerate(2 * math.pi * k / sensors for k in range(sensors))
    )
    crowd = tuple(
        PersonSettings(start=(1.2 * (i % side - side / 2), 3.0 + 1.2 * (i // side - side / 2)), scenario="walk")
        for i in range(people)
    )
    room = build_room(SceneSettings("hall", ring, crowd, seed=1))
    frames = merge([SimulatedSensor(room, i + 1) for i in range(sensors)], STILL_S, STILL_S + span_s)
    arrivals = [Arrival(item.frame, round(1e9 * item.due_s)) for item in frames]
    return {sensor.name: standing(sensor) for sensor in ring}, arrivals


def standing(sensor: SensorSettings) -> Float64:
    """``T_world_sensor``."""
    turn = rotation_about_y(math.radians(sensor.yaw_deg)) @ rotation_about_x(-math.radians(sensor.tilt_deg))
    return rigid(turn, sensor.position)


def tracker_seconds(known: Mapping[str, Float64], arrivals: Sequence[Arrival]) -> float:
    """Of the method `default` over all frames, a sensor layout given."""
    tracker = DefaultTracker(sensors_expected=len(known))
    tracker.start_from(known)
    begin = time.perf_counter()
    for arrival in arrivals:
        tracker.update(arrival)
    return time.perf_counter() - begin


def step_seconds(known: Mapping[str, Float64], arrivals: Sequence[Arrival]) -> float:
    """Of the people's update alone, which is one compiled call, in the method `default` over all frames."""
    whole, update = 0.0, People.update

    def timed(people: People, frame: SensorBodies, tracks: TrackInputs, at_s: float) -> int:
        nonlocal whole
        begin = time.perf_counter()
        events = update(people, frame, tracks, at_s)
        whole += time.perf_counter() - begin
        return events

    with mock.patch.object(People, "update", timed):
        tracker_seconds(known, arrivals)
    return whole


def chain_seconds(known: Mapping[str, Float64], arrivals: Sequence[Arrival]) -> float:
    """Of the stages associate, fuse and 1-euro alone."""
    tracks = Tracks()
    people = People(PeopleSettings(smoothing="one-euro", facing=None), arrivals[0].frame.topology)
    bodies = [tracked_bodies(arrival.frame) for arrival in arrivals]
    begin = time.perf_counter()
    for arrival, seen in zip(arrivals, bodies, strict=True):
        at_s = 1e-9 * arrival.at_ns
        associate_and_fuse(tracks, people, arrival.frame, seen, known[seen.sensor], at_s=at_s, now_s=at_s)
    return time.perf_counter() - begin


PEERS: Final = "norfair + numpy + OneEuroFilter"


def peers_chain(known: Mapping[str, Float64]) -> Callable[[Sequence[Arrival]], float] | None:
    """Seconds of the peers' chain over frames; None where the peers are not installed."""
    try:
        from norfair import Detection, Tracker
        from OneEuroFilter import OneEuroFilter
    except ImportError:
        warnings.warn("no peers: uv run --group peers python -m benchmarks people", stacklevel=2)
        return None

    logging.getLogger().addFilter(lambda record: "scalar distance function" not in record.getMessage())

    def seconds(arrivals: Sequence[Arrival]) -> float:
        trackers = {name: Tracker(distance_function="mean_euclidean", distance_threshold=1.0) for name in known}
        newest: dict[str, dict[int, Float64]] = {name: {} for name in known}
        filters: dict[int, list[Any]] = {}
        bodies = [tracked_bodies(arrival.frame) for arrival in arrivals]
        begin = time.perf_counter()
        for arrival, seen in zip(arrivals, bodies, strict=True):
            at_s = 1e-9 * arrival.at_ns
            world = apply(known[seen.sensor], seen.positions)
            tracked = trackers[seen.sensor].update([Detection(points=np.nan_to_num(body)) for body in world])
            newest[seen.sensor] = {one.id: one.estimate for one in tracked}
            for number in newest[seen.sensor]:
                views = [found[number] for found in newest.values() if number in found]
                mean = np.mean(views, axis=0).ravel()
                own = filters.setdefault(number, [OneEuroFilter(30.0, beta=0.1) for _ in mean])
                [smooth(value, at_s) for smooth, value in zip(own, mean, strict=True)]
        return time.perf_counter() - begin

    return seconds
