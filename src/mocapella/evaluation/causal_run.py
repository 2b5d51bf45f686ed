"""Run a method over a session's frames in the order of their arrival, and store its estimates after each frame.

The run is causal: an estimate uses frames that arrived before, never later ones, so a score cannot profit from
hindsight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.evaluation.protocol import JointBias, ScoredTracker, check_rigid
from mocapella.geometry import rigid
from mocapella.model.bodies import BodyKey
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.tracker.protocol import SensorViews

Float64 = NDArray[np.float64]

MAX_TIME_OFFSET = 1.0
"""Largest clock offset that a method may report [s]."""
TO_FIND_IT = 1.0
"""Path length that the estimated motions between sensors may take at first without counting as wandering [m]."""
LONGEST_STEP = 1.0
"""A longer gap between two frames is a pause of the log, and counts as this long [s]."""
_PERSON_AREA = np.array([[0.0, 0.0, 2.4], [0.5, 0.0, 2.4], [0.0, 0.5, 2.4]])
"""Three points where people stand (3, 3), in each sensor's camera space [m]."""


class PersonThen(msgspec.Struct, frozen=True, eq=False):
    """One tracked person in one scene of a run: the fused skeleton, and which views it was fused from.

    Attributes:
        id: the person's id.
        keys: sensor and tracking id of the fused views.
        positions: (joints, 3) fused skeleton, in the reference sensor's camera space [m].
    """

    id: int
    keys: frozenset[BodyKey]
    positions: Float64


class CausalRun(msgspec.Struct, frozen=True, eq=False):
    """A method's estimates. In arrays (arrivals + 1, …), entry k is from *before* arrival k; entry 0 the initial one.

    Attributes:
        sensors: names of the sensors, the reference sensor first.
        T_reference_sensor: (arrivals + 1, sensors, 4, 4) from each sensor's camera space to the reference sensor's; NaN
            where unknown.
        time_offset_s: (arrivals + 1, sensors) offsets to add to a sensor's capture times [s]; NaN if not estimated.
        swapped: (arrivals + 1,) views with swapped labels, each as sensor and tracking id.
        people: (arrivals,) people of each scene, entry k *after* arrival k.
        at_ns: (arrivals,) capture times, on the common clock.
        joint_bias: the method's bias, which it declares before the first frame; None without one.
        wander_m_per_min: path length of points at people's positions under the changing estimates of a sensor's pose,
            largest of the sensors, less the `TO_FIND_IT` metres allowed for the initial estimation [m/min].
    """

    sensors: tuple[str, ...]
    T_reference_sensor: Float64
    time_offset_s: Float64
    swapped: tuple[frozenset[BodyKey], ...]
    people: tuple[tuple[PersonThen, ...], ...]
    at_ns: NDArray[np.int64]
    joint_bias: JointBias | None
    wander_m_per_min: float


def run_causally(
    make: Callable[[int], ScoredTracker],
    sensors: Sequence[str],
    arrivals: Sequence[Arrival],
    layout: Mapping[str, Float64],
) -> CausalRun:
    """Feed every frame to a new tracker; read its estimates before the first and after each.

    The scoring of a frame can then use what the method knew before it.

    Args:
        make: creates a tracker for a number of sensors.
        sensors: names of the sensors, the reference sensor first.
        arrivals: the frames, in the order of their arrival.
        layout: poses T_world_sensor (4, 4) that are known before the first frame, by sensor: the calibration in the
            study log.

    Raises:
        EvaluationError: a motion is not rigid, or a clock offset is above `MAX_TIME_OFFSET`.
    """
    tracker = make(len(sensors))
    tracker.start_from({sensor: T.copy() for sensor, T in layout.items()})
    bias = tracker.joint_bias
    known = [_known(tracker.sensor_views(), sensors)]
    people: list[tuple[PersonThen, ...]] = []
    for arrival in arrivals:
        scene = tracker.update(arrival)
        known.append(_known(tracker.sensor_views(), sensors))
        # The scene's own pose: a tracker may approach a better estimate gradually, with its people.
        place = next((place.T_world_sensor for place in scene.sensors if place.sensor == sensors[0]), None)
        people.append(_people(scene, known[-1][0][0] if place is None else place))
    T_world_sensor, offsets, swapped = (tuple(values) for values in zip(*known, strict=True))
    T = np.stack(T_world_sensor)
    T_reference_sensor = rigid.inverse(T[:, :1]) @ T
    at_ns = np.array([arrival.at_ns for arrival in arrivals], dtype=np.int64)
    wander = _wander_m_per_min(T_reference_sensor, at_ns)
    return CausalRun(tuple(sensors), T_reference_sensor, np.stack(offsets), swapped, tuple(people), at_ns, bias, wander)


def _wander_m_per_min(T_reference_sensor: Float64, at_ns: NDArray[np.int64]) -> float:
    if T_reference_sensor.shape[1] < 2:
        return 0.0
    points = rigid.apply(T_reference_sensor[:, 1:], _PERSON_AREA)
    path = np.nansum(np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(axis=-1), axis=0).max()
    seconds = np.minimum(np.diff(at_ns) / 1e9, LONGEST_STEP).sum()
    return float(max(0.0, path - TO_FIND_IT) / max(seconds, LONGEST_STEP) * 60)


def _known(views: SensorViews, sensors: Sequence[str]) -> tuple[Float64, Float64, frozenset[BodyKey]]:
    T = np.full((len(sensors), 4, 4), np.nan)
    offset_s = np.full(len(sensors), np.nan)
    for i, sensor in enumerate(sensors):
        if sensor in views.T_world_sensor:
            T[i] = check_rigid(views.T_world_sensor[sensor], f"T_world_sensor of {sensor}")
        offset_s[i] = views.time_offset_s.get(sensor, np.nan)
    if (np.abs(offset_s) > MAX_TIME_OFFSET).any():
        raise EvaluationError(f"a time offset of {np.nanmax(np.abs(offset_s)):.1f} s; {MAX_TIME_OFFSET} s is the most")
    return T, offset_s, frozenset(views.swapped)


def _people(scene: Scene, T_world_reference: Float64) -> tuple[PersonThen, ...]:
    if np.isnan(T_world_reference).any():
        return ()
    T_reference_world = rigid.inverse(T_world_reference)
    return tuple(
        PersonThen(
            person.id,
            frozenset((view.sensor, view.tracking_id) for view in person.views if view.states.any()),
            rigid.apply(T_reference_world, person.positions),
        )
        for person in scene.people
    )
