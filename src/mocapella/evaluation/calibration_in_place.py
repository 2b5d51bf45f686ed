"""Score the calibration of two body sensors from a person who exercises in place, against ground truth.

The sensors have the errors of real ones (docs/simulation.md). A *normalised error* is an error in units of its stated
standard deviation: over many sessions, its root mean square is 1 if the stated uncertainty is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.people_state import CalibratedSensor
from mocapella.conventions import NS_PER_S
from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import adjoint, log_motion
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.sources.simulate import (
    PersonSettings,
    Room,
    SceneSettings,
    SensorSettings,
    SimulatedSensor,
    build_room,
    merge,
)
from mocapella.sources.simulate.measured import KIND

Float64 = NDArray[np.float64]

ANGLES_DEG: Final = (30.0, 60.0, 90.0)
"""Angles between the two sensors, as seen from the person [deg]."""
EXERCISES: Final = ("stand", "squat", "sit", "wave", "bend")
"""What the person does: stands, or a posture of `mocapella.sources.simulate.postures.POSTURES`."""
CENTRE_M: Final = (0.0, 2.8)
"""Position of the person (world x, z) [m]."""
INFERRED_S: Final = 60.0
"""Time for which a sensor infers a joint that it does not see [s]. A Kinect v2 infers it for as long as it tracks the
body: the study's sessions of two people have nearly all joints (``joint_lost`` of the measured errors), and recordings
of gestures have all, many of them inferred."""
_LONGER_S: Final = 5.0
"""Duration of the exercise beyond the scored time, so that it does not end before [s]."""
_LATENCY_S: Final = (0.06, 0.07)


class CalibratingTracker(Protocol):
    """Interface of a scored tracker; `mocapella.tracker.default.DefaultTracker` implements it."""

    @property
    def calibrated_sensors(self) -> Mapping[str, CalibratedSensor]:
        """Present pose and clock of each sensor, by name."""

    def update(self, arrival: Arrival) -> Scene:
        """Process one frame."""


class PoseError(msgspec.Struct, frozen=True):
    """Error of the relative pose of two sensors.

    Attributes:
        at_s: time since the first frame [s].
        position_m: displacement of a point at the person's position [m].
        rotation_deg: angle of the rotation [deg].
        position_normalised, rotation_normalised: both errors divided by their stated standard deviations.
        normalised: root mean square error over the six degrees of freedom, normalised by the stated covariance.
    """

    at_s: float
    position_m: float
    rotation_deg: float
    position_normalised: float
    rotation_normalised: float
    normalised: float


class InPlaceResult(msgspec.Struct, frozen=True):
    """Result of one session.

    Attributes:
        calibrated_s: time from the first frame until both sensors have trusted poses in one world frame; infinite if
            never [s].
        errors: errors at the given times; a time is missing if such poses were not known.
    """

    calibrated_s: float
    errors: tuple[PoseError, ...]


def in_place_room(exercise: str, angle_deg: float, seed: int, seconds: float = 20.0) -> Room:
    """Build a room with two sensors with measured errors, and a person who exercises in place between them.

    With an even seed the person faces the first sensor, with an odd one the middle between the two.

    Args:
        exercise: one of `EXERCISES`.
        angle_deg: angle between the sensors, as seen from the person [deg].
        seed: random seed of noise, and of the person's stature.
        seconds: least duration of the exercise [s].

    Raises:
        SettingsError: unknown exercise.
    """
    first = 0.0 if seed % 2 == 0 else -angle_deg / 2
    rng = np.random.default_rng([seed, round(angle_deg)])
    sensors = (
        measured_sensor("a", first, height=1.0, tilt_deg=0.0, phase_s=0.0, latency_s=_LATENCY_S[0]),
        measured_sensor("b", first + angle_deg, height=1.1, tilt_deg=-3.0, phase_s=0.011, latency_s=_LATENCY_S[1]),
    )
    route = (f"{exercise} {seconds + _LONGER_S}",)
    person = PersonSettings(CENTRE_M, "route", route=route, stature=float(rng.uniform(1.6, 1.9)))
    return build_room(SceneSettings(f"{exercise} in place", sensors, (person,), seed=seed))


def run_in_place(tracker: CalibratingTracker, room: Room, at_s: Sequence[float]) -> InPlaceResult:
    """Run a tracker on a room's frames until the last of the given times; return the errors of the pose.

    Args:
        tracker: a new tracker.
        room: a room with two sensors.
        at_s: times since the first frame at which the pose is scored, ascending [s].
    """
    one, other = room.sensor_names
    true = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
    centre = apply(inverse(true[one]), room.positions_at(0)[0, :1])[0]
    T_true = inverse(true[one]) @ true[other]
    late_ns = {sensor.name: round(sensor.latency_s * NS_PER_S) for sensor in room.settings.sensors}
    waiting, errors, calibrated_s = [*at_s], [], np.inf
    for item in merge([SimulatedSensor(room, name) for name in room.sensor_names], 0.0, at_s[-1] + 1.0):
        now_s = item.truth.room_ns / NS_PER_S
        if not waiting:
            break
        tracker.update(Arrival(item.frame, item.truth.room_ns + late_ns[item.frame.sensor]))
        sensors = tracker.calibrated_sensors
        known = one in sensors and other in sensors and sensors[one].root == sensors[other].root
        known = known and sensors[one].trusted and sensors[other].trusted
        if known:
            calibrated_s = min(calibrated_s, now_s)
        if now_s >= waiting[0]:
            waiting.pop(0)
            if known:
                errors.append(_error(now_s, sensors[one], sensors[other], T_true, centre))
    return InPlaceResult(calibrated_s, tuple(errors))


def normalised_error(errors: Sequence[PoseError]) -> float:
    """Return the root mean square of the normalised errors of several sessions; NaN without any."""
    return float(np.sqrt(np.mean([error.normalised**2 for error in errors]))) if errors else np.nan


def _error(at_s: float, a: CalibratedSensor, b: CalibratedSensor, T_true: Float64, centre: Float64) -> PoseError:
    """Compare the pose of b in a's frame with the true one; ``centre`` (3,) is the person's position in that frame."""
    to_a = inverse(a.T_world_sensor)
    d = log_motion(to_a @ b.T_world_sensor @ inverse(T_true))
    turn = adjoint(to_a)
    C = turn @ (a.covariance + b.covariance) @ turn.T  # one of them is the root's, which is 0
    at_person = np.concatenate([np.eye(3), -cross_matrix(centre)], axis=1)
    position, rotation = np.linalg.norm(at_person @ d), np.linalg.norm(d[3:])
    return PoseError(
        at_s,
        float(position),
        float(np.degrees(rotation)),
        float(position / np.sqrt(np.trace(at_person @ C @ at_person.T))),
        float(rotation / np.sqrt(np.trace(C[3:, 3:]))),
        float(np.sqrt(d @ np.linalg.solve(C, d) / 6)),
    )


def measured_sensor(
    name: str, azimuth_deg: float, *, height: float, tilt_deg: float, phase_s: float, latency_s: float
) -> SensorSettings:
    """Return a sensor with measured errors that looks at the person's position from a direction.

    Args:
        name: name of the sensor.
        azimuth_deg: direction of the sensor, as seen from the person; 0 is towards -z [deg].
        height: height above the floor [m].
        tilt_deg: upward tilt [deg].
        phase_s, latency_s: as in `mocapella.sources.simulate.SensorSettings`.
    """
    x, z = CENTRE_M
    turn = np.radians(azimuth_deg)
    position = (x - z * float(np.sin(turn)), height, z - z * float(np.cos(turn)))
    return SensorSettings(
        name, position, azimuth_deg, tilt_deg, phase_s=phase_s, latency_s=latency_s, lost=0.003, errors=KIND,
        forget_s=INFERRED_S,
    )  # fmt: skip
