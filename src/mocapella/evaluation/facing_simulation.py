"""Score facings and corrected labels in simulated rooms, with ground truth and sensors on all sides.

Identities, sensor poses and velocities are taken from the ground truth, so the filter alone is measured.
"""

from __future__ import annotations

from collections import defaultdict, deque
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.fusion.facing import FacingFilter
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.topology import Topology
from mocapella.sources.simulate import Room, SimulatedSensor, merge

Float64 = NDArray[np.float64]

VELOCITY_OVER_S: Final = 0.25


class SimulatedFigures(msgspec.Struct, frozen=True):
    """Figures over all bodies of all frames.

    Attributes:
        bodies: number of bodies.
        wrong_as_reported_percent: share of bodies with left and right swapped by the sensor [%].
        wrong_percent: share of bodies with left and right swapped after the correction [%].
        facing_wrong_percent: share of bodies with a facing more than 90° off [%].
        off_deg: median error of the facing [deg].
    """

    bodies: int
    wrong_as_reported_percent: float
    wrong_percent: float
    facing_wrong_percent: float
    off_deg: float


def simulated_figures(room: Room, facings: FacingFilter, seconds: float) -> SimulatedFigures:
    """Run a filter on the frames of a room's sensors in the first ``seconds``, and score its results.

    Args:
        room: the simulated room.
        facings: a new filter, for the room's topology.
        seconds: duration of the simulation [s].
    """
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names]
    T_world_sensor = {sensor.name: sensor.T_world_sensor for sensor in sensors}
    places: defaultdict[int, deque[tuple[float, Float64]]] = defaultdict(deque)
    found: list[tuple[NDArray[np.bool_], NDArray[np.bool_], Float64]] = []
    for item in merge(sensors, 0.0, seconds):
        frame, truth = item.frame, item.truth
        people = truth.body_people.tolist()
        at_s = truth.room_ns / NS_PER_S
        T = T_world_sensor[frame.sensor]
        positions = apply(T, frame.positions.astype(np.float64))
        positions[frame.states == JointState.NOT_TRACKED] = np.nan
        true = truth.positions[truth.body_people]
        sight = T[:3, 3] - true.mean(axis=1)
        velocities = np.array(
            [_velocity(places[person], at_s, root) for person, root in zip(people, true[:, 0], strict=True)]
        )
        now = facings.update(
            frame.sensor, people, positions, np.arctan2(sight[:, 0], sight[:, 2]), at_s, velocities.reshape(-1, 3)
        )
        found.append((truth.mirrored, now.mirrored, np.abs(wrap(now.yaw - _yaw(true, truth.topology)))))
    reported, repaired, off = (np.concatenate(column) for column in zip(*found, strict=True))
    return SimulatedFigures(
        bodies=len(off),
        wrong_as_reported_percent=100 * float(reported.mean()),
        wrong_percent=100 * float((reported != repaired).mean()),
        facing_wrong_percent=100 * float((off > np.pi / 2).mean()),
        off_deg=float(np.degrees(np.median(off))),
    )


def _yaw(positions: Float64, topology: Topology) -> Float64:
    across = positions[:, topology.parts["shoulder_left"]] - positions[:, topology.parts["shoulder_right"]]
    return np.asarray(np.arctan2(-across[:, 2], across[:, 0]))


def _velocity(places: deque[tuple[float, Float64]], at_s: float, place: Float64) -> Float64:
    """Return the mean velocity (3,) over the past `VELOCITY_OVER_S` from ``places``; NaN if they are too recent."""
    places.append((at_s, place))
    while at_s - places[0][0] > VELOCITY_OVER_S:
        places.popleft()
    elapsed = at_s - places[0][0]
    if elapsed < VELOCITY_OVER_S / 2:
        return np.full(3, np.nan)
    return np.asarray((place - places[0][1]) / elapsed)
