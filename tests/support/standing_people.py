"""People who stand where we say, and sensors that see them without noise: for the tests of calibration and tracking."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.bodies import Bodies, tracked_bodies
from mocapella.model.observations import Arrival, JointState, body_frame
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
LEFT_SHOULDER, RIGHT_SHOULDER = KINECT.index("ShoulderLeft"), KINECT.index("ShoulderRight")
HEAD, RIGHT_HAND = KINECT.index("Head"), KINECT.index("HandRight")
FRAME_NS = 33_000_000


def somebody(seed: int = 0) -> NDArray[np.float64]:
    """(25, 3) joints, scattered like a body's, as stand-still's world has them: centred, shoulders along x."""
    points = np.random.default_rng(seed).normal(size=(25, 3)) * [0.2, 0.5, 0.1]
    shoulders = (points[LEFT_SHOULDER] + points[RIGHT_SHOULDER]) / 2
    half = np.array([0.2, 0, 0])
    points[LEFT_SHOULDER], points[RIGHT_SHOULDER] = shoulders - half, shoulders + half
    return points - points.mean(axis=0)


def sensor_at(yaw: float, distance: float = 2.5, across: float = 0.1, height: float = 0.2) -> NDArray[np.float64]:
    """``T_sensor_world`` of an upright sensor that looks at the origin from this yaw and distance."""
    return rigid(rotation_about_y(yaw), [across, -height, distance])


def see(
    sensor: str,
    T_sensor_world: NDArray[np.float64],
    people: Iterable[NDArray[np.float64]],
    frame: int,
    *,
    at: int | None = None,
    ids: Iterable[int] | None = None,
    states: object = None,
    node_id: int = 1,
) -> Arrival:
    """The frame in which that sensor sees these people; frame numbers count time in steps of 33 ms."""
    points = [apply(T_sensor_world, person) for person in people]
    observed = body_frame(
        sensor,
        KINECT,
        time_ns=frame * FRAME_NS,
        positions=np.array(points).reshape(-1, 25, 3),
        tracking_ids=list(range(1, 1 + len(points))) if ids is None else list(ids),
        states=states,
        sequence=frame,
        node_id=node_id,
    )
    return Arrival(observed, (frame if at is None else at) * FRAME_NS)


def bodies(sensor: str, people: Iterable[NDArray[np.float64]], **how: object) -> Bodies:
    """The same as a calibration takes it, seen from the front."""
    return tracked_bodies(see(sensor, sensor_at(0.0), people, 0, **how).frame)  # type: ignore[arg-type]


def without(joint: int, people: int = 1) -> NDArray[np.uint8]:
    """(people, 25) states: all tracked but this joint of the last person, which is not."""
    states = np.full((people, 25), JointState.TRACKED, dtype=np.uint8)
    states[-1, joint] = JointState.NOT_TRACKED
    return states


def moved(person: NDArray[np.float64], joint: int, by_m: float) -> NDArray[np.float64]:
    """The person with that joint higher by so much."""
    result = person.copy()
    result[joint, 1] += by_m
    return result


__all__ = [
    "FRAME_NS",
    "HEAD",
    "KINECT",
    "LEFT_SHOULDER",
    "RIGHT_HAND",
    "RIGHT_SHOULDER",
    "bodies",
    "inverse",
    "moved",
    "see",
    "sensor_at",
    "somebody",
    "without",
]
