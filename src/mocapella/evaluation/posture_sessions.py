"""Score a tracker on people in postures unlike walking, with sensors that have the errors of real ones.

A person walks, so that the sensors find their poses, returns to the middle, turns, and assumes a posture. Each posture
continues from the same walk: the tracker's state after it is restored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.evaluation.calibration_in_place import CENTRE_M, measured_sensor
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.observations import Arrival, JointState
from mocapella.model.skeleton import SKELETON
from mocapella.sources.simulate import (
    PersonSettings,
    Room,
    SceneSettings,
    SimulatedFrame,
    SimulatedSensor,
    build_room,
    merge,
)
from mocapella.sources.simulate.postures import POSTURES, RISE_S
from mocapella.sources.simulate.scenarios import written_route
from mocapella.tracker.default import DefaultTracker

Float64 = NDArray[np.float64]

UPRIGHT: Final = ("stand", *(name for name in POSTURES if not name.startswith(("lie", "crawl"))))
"""Postures whose trunk is not horizontal, and standing; the others are at the end of `POSTURES`."""
HEADINGS_DEG: Final = (0.0, 60.0, 180.0)
"""Headings of the person: 0 is towards the first sensor, 180 away from it [deg]."""
POSTURE_S: Final = 6.0
"""Duration of a posture [s]."""
_WALK: Final = ("go 0.7 2.3", "go -0.7 3.3", "go -0.6 2.2", "go 0.6 3.2", "go 0.0 2.8")
_MIRROR: Final = np.array(SKELETON.mirror)
_SIDED: Final = np.arange(len(SKELETON)) != _MIRROR


class PostureResult(msgspec.Struct, frozen=True):
    """Score of one posture.

    Attributes:
        posture: name of the posture.
        heading_deg: heading of the person, see `HEADINGS_DEG` [deg].
        frames: number of scored frames, without the transitions.
        missing: number of these frames without a person in the scene.
        warned: number of these frames whose person has a condition, although the posture is within all limits.
        wrong: number of frames whose left and right are exchanged: exchanging them back lowers the mean error.
        fused_m: mean error of the joints of the fused skeleton [m].
        best_m: mean error of the joints of the best sensor with its own labels [m].
        mean_m: mean error of the mean of the sensors' views, with true poses and labels [m].
        weighted_m: as ``mean_m``, with each joint weighted by the inverse of its true mean square error in the view:
            what fusion of single frames could reach if it knew the errors [m].
    """

    posture: str
    heading_deg: float
    frames: int
    missing: int
    warned: int
    wrong: int
    fused_m: float
    best_m: float
    mean_m: float
    weighted_m: float


def score_postures(
    heading_deg: float, seed: int, postures: Sequence[str] = UPRIGHT, azimuths_deg: Sequence[float] = (0.0, 90.0)
) -> Iterator[PostureResult]:
    """Yield the score of each posture after one walk.

    Args:
        heading_deg: heading of the person during the posture, see `HEADINGS_DEG` [deg].
        seed: random seed of noise, and of the person's stature.
        postures: names of postures.
        azimuths_deg: directions of the sensors, as seen from the person; the first is scored as the main one [deg].

    Raises:
        SettingsError: unknown posture.
    """
    tracker = DefaultTracker(sensors_expected=len(azimuths_deg))
    snapshot, begins_s = b"", 0.0
    for posture in postures:
        room, turned_s = _room(posture, heading_deg, seed, azimuths_deg)
        if not snapshot:
            begins_s = turned_s
            for item in _frames(room, 0.0, begins_s):
                tracker.update(_arrival(room, item))
            snapshot = tracker.snapshot()
        tracker.restore(snapshot)
        yield _score(tracker, room, posture, heading_deg, begins_s)


def _score(tracker: DefaultTracker, room: Room, posture: str, heading_deg: float, begins_s: float) -> PostureResult:
    main, frames, missing, warned, wrong = room.sensor_names[0], 0, 0, 0, 0
    fused: list[float] = []
    sensors: dict[str, list[float]] = {name: [] for name in room.sensor_names}
    views: dict[str, list[Float64]] = {name: [] for name in room.sensor_names}
    T_world = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
    for item in _frames(room, begins_s, begins_s + POSTURE_S):
        scene = tracker.update(_arrival(room, item))
        at_s = item.truth.room_ns / NS_PER_S - begins_s
        if not RISE_S < at_s < POSTURE_S - RISE_S:
            continue
        truth = item.truth.positions[0]
        if len(item.frame.positions):
            seen = apply(T_world[item.frame.sensor], item.frame.positions[0])
            tracked = item.frame.states[0] != JointState.NOT_TRACKED
            sensors[item.frame.sensor].append(float(np.linalg.norm(seen - truth, axis=-1)[tracked].mean()))
            views[item.frame.sensor].append(_with_true_labels(np.where(tracked[:, None], seen, np.nan), truth) - truth)
        if item.frame.sensor != main:
            continue
        frames += 1
        place = next((place.T_world_sensor for place in scene.sensors if place.sensor == main), None)
        if not scene.people or place is None:
            missing += 1
            continue
        warned += bool(scene.people[0].condition)
        found = apply(T_world[main] @ inverse(place), scene.people[0].positions)
        error, exchanged = (np.linalg.norm(found[order] - truth, axis=-1) for order in (slice(None), _MIRROR))
        wrong += bool(np.nanmean(exchanged[_SIDED]) < np.nanmean(error[_SIDED]))
        fused.append(float(np.nanmean(error)))
    best = min((float(np.mean(errors)) for errors in sensors.values() if errors), default=np.nan)
    fused_m = float(np.mean(fused)) if fused else np.nan
    return PostureResult(
        posture, heading_deg, frames, missing, warned, wrong, fused_m, best, *ideal_means([*views.values()])
    )


def _with_true_labels(seen: Float64, truth: Float64) -> Float64:
    """Return joints (joints, 3), left and right exchanged if that brings them nearer to the true ones."""
    straight, exchanged = (np.nanmean(np.linalg.norm(seen[order] - truth, axis=-1)) for order in (slice(None), _MIRROR))
    return seen[_MIRROR] if exchanged < straight else seen


def ideal_means(views: Sequence[Sequence[Float64]]) -> tuple[float, float]:
    """Return the mean errors of the plain and of the ideally weighted mean of several sensors' views [m].

    The weight of a joint in a view is the inverse of its mean square error over all frames of the sensor
    (Aitken, 1936: the best linear estimate of independent errors). Both are NaN without frames of every sensor.

    Args:
        views: of each sensor, the errors (joints, 3) of its frames [m]; NaN where a joint is not tracked.
    """
    count = min(map(len, views))
    if count == 0:
        return np.nan, np.nan
    errors = np.array([frames[:count] for frames in views])
    square = (errors**2).sum(-1)
    known = np.isfinite(square)
    of_joint = np.where(known, square, 0.0).sum(1) / np.maximum(known.sum(1), 1)
    weights = np.broadcast_to(1.0 / np.maximum(of_joint, np.finfo(np.float64).tiny)[:, None], known.shape)
    plain, weighted = (_mean_error(errors, np.where(known, w, 0.0)) for w in (np.ones(known.shape), weights))
    return plain, weighted


def _mean_error(errors: Float64, weights: Float64) -> float:
    """Return the mean length of the weighted mean of errors (sensors, frames, joints, 3) over the sensors [m]."""
    total = weights.sum(0)
    mean = (np.nan_to_num(errors) * weights[..., None]).sum(0)[total > 0] / total[total > 0][:, None]
    return float(np.linalg.norm(mean, axis=-1).mean())


def _frames(room: Room, begin_s: float, end_s: float) -> Iterator[SimulatedFrame]:
    return merge([SimulatedSensor(room, name) for name in room.sensor_names], begin_s, end_s)


def _arrival(room: Room, item: SimulatedFrame) -> Arrival:
    latency_s = next(sensor.latency_s for sensor in room.settings.sensors if sensor.name == item.frame.sensor)
    return Arrival(item.frame, item.truth.room_ns + round(latency_s * NS_PER_S))


def _room(posture: str, heading_deg: float, seed: int, azimuths_deg: Sequence[float]) -> tuple[Room, float]:
    """Build the room of one posture; return it and the time at which the posture begins [s]."""
    rng = np.random.default_rng([seed, round(heading_deg)])
    stature = float(rng.uniform(1.6, 1.9))
    sensors = tuple(
        measured_sensor(
            f"sensor{k}", azimuth, height=1.0 + 0.1 * k, tilt_deg=0.0, phase_s=0.011 * k, latency_s=0.06 + 0.01 * k
        )
        for k, azimuth in enumerate(azimuths_deg)
    )
    turn = ("stand 2", *_WALK, *_WALK, f"turn {180.0 - heading_deg}", "stand 1")

    route = (*turn, f"{posture} {POSTURE_S}")
    person = PersonSettings(CENTRE_M, "route", route=route, stature=stature)
    room = build_room(SceneSettings(f"{posture} after a walk", sensors, (person,), seed=seed))
    return room, written_route(CENTRE_M, turn).seconds
