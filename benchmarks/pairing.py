"""How often `stand-still` takes the views of different people for one person, in simulated rooms of two people.

Each run is one calibration with its own seed. The two differ in stature by what the row says, stand at random places in
the middle of the room, and face the main sensor. A calibration is wrong where a person has views of different people.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from benchmarks.harness import Row, measured
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase
from mocapella.sources.simulate import PersonSettings, Room, SimulatedSensor, build_room, merge, scene_settings
from mocapella.tracker import make_tracker

SCENE: Final = "exchange"
STATURE_M: Final = 1.75
DIFFERENCES_M: Final = (0.0, 0.05, 0.15)
APART_M: Final = 0.9
LIMIT_S: Final = 6.5
"""Simulated people stand still for a little longer than this."""


def run(quick: bool = False) -> list[Row]:
    seeds = 3 if quick else 40
    rows = []
    for sensors in (2, 3):
        for difference_m in DIFFERENCES_M:
            results = [wrongly_paired(seed, sensors, difference_m) for seed in range(seeds)]
            done = [wrong for wrong in results if wrong is not None]
            what = f"two people {100 * difference_m:.0f} cm apart in stature, {sensors} sensors"
            rows.append(measured(f"pairing: calibrations done, {what}", len(done), f"of {seeds}"))
            if done:
                rows.append(measured(f"pairing: of these, wrongly paired, {what}", 100 * float(np.mean(done)), "%"))
    return rows


def wrongly_paired(seed: int, sensors: int, difference_m: float) -> bool | None:
    """Whether the first calibration took views of different people for one; None where none was done in time."""
    room = two_people(seed, sensors, difference_m)
    tracker = make_tracker("stand-still", sensors_expected=sensors)
    who: dict[tuple[str, int], int] = {}
    for item in merge([SimulatedSensor(room, sensor) for sensor in room.sensor_names], 0.0, LIMIT_S):
        frame = item.frame
        ids = ((frame.sensor, body) for body in frame.tracking_ids.tolist())
        who |= dict(zip(ids, item.truth.body_people.tolist(), strict=True))
        scene = tracker.update(Arrival(frame, item.truth.room_ns))
        if scene.state.phase is Phase.TRACKING:
            truly = [{who[view.sensor, view.tracking_id] for view in person.views} for person in scene.people]
            return any(len(people) > 1 for people in truly)
    return None


def two_people(seed: int, sensors: int, difference_m: float) -> Room:
    """A room with the first sensors of `SCENE` and two people who stand."""
    settings = scene_settings(SCENE)
    rng = np.random.default_rng([seed, sensors])
    middle, turn = rng.uniform([-0.3, 2.6], [0.3, 3.0]), rng.uniform(0, np.pi)
    aside = APART_M / 2 * np.array([np.cos(turn), np.sin(turn)])
    statures = STATURE_M + difference_m / 2 * rng.permutation([-1.0, 1.0])
    people = tuple(
        PersonSettings(start=(float(x), float(z)), stature=float(stature))
        for (x, z), stature in zip((middle - aside, middle + aside), statures, strict=True)
    )
    return build_room(dataclasses.replace(settings, sensors=settings.sensors[:sensors], people=people, seed=seed))
