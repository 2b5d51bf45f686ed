"""Calibrate by standing still, the method of the KinectMultiTrack thesis (2015).

All people stand still while every sensor collects frames. The centre C and shoulder angle θ of each body (one sensor's
tracking id) then give its own transform to the world. Any motion, arrival or departure restarts it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.centre_and_angle import body_centre, shoulder_angle, world_from_sensor
from mocapella.geometry.angles import circular_mean
from mocapella.model.bodies import Bodies, BodyKey, body_name
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase, TrackerState
from mocapella.settings import check

Float64 = NDArray[np.float64]

STILL_PARTS: Final = {"head": "head", "hand_left": "left hand", "hand_right": "right hand"}
"""Parts that must not move, and their names for users."""


@dataclass(frozen=True)
class StandStillSettings:
    """Duration, tolerance and averaging.

    Attributes:
        frames: number of successive frames, of each sensor, in which people must stand still; the latest count; larger:
            more accurate, but longer [frames].
        still_within_m: largest distance of a head or hand from the frame it is compared with; farther restarts the
            calibration; larger: more sway is accepted [m].
        compare_with: frame to compare with: the ``previous`` one (the thesis' algorithm) or the ``first`` of the stored
            ones (its program).
        angle_from: the shoulder angle is the circular ``mean`` over the frames, or that of the ``latest`` frame (its
            program).
        centre_of: the centre is the mean of the ``tracked`` joints, or of all ``seen`` ones, also the inferred. A
            sensor beside a person infers the far arm and leg, so that its tracked centre differs from another sensor's.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    frames: int = 120
    still_within_m: float = 0.10
    compare_with: Literal["previous", "first"] = "previous"
    angle_from: Literal["mean", "latest"] = "mean"
    centre_of: Literal["tracked", "seen"] = "tracked"

    def __post_init__(self) -> None:
        check(1 <= self.frames <= 100_000, "frames", self.frames, "from 1 to 100000")
        check(self.still_within_m > 0, "still_within_m", self.still_within_m, "greater than 0 m")
        check(self.compare_with in ("previous", "first"), "compare_with", self.compare_with, "previous or first")
        check(self.angle_from in ("mean", "latest"), "angle_from", self.angle_from, "mean or latest")
        check(self.centre_of in ("tracked", "seen"), "centre_of", self.centre_of, "tracked or seen")


class Calibration(msgspec.Struct, frozen=True, eq=False):
    """Result of the calibration after a frame.

    Attributes:
        state: its progress.
        T_world_sensor: (4, 4) by body, from the body's sensor; empty until the calibration is complete.
        number: number of completed calibrations so far, including this one.
    """

    state: TrackerState
    T_world_sensor: Mapping[BodyKey, Float64]
    number: int


class StandStill:
    """Collects frames until all bodies have stood still, then monitors for a reason to restart.

    Args:
        settings: duration, tolerance and averaging.
        sensors_expected: number of sensors that must send frames before frames are collected.

    Attributes:
        completed: number of completed calibrations.
        restarts: number of restarts.
    """

    def __init__(self, settings: StandStillSettings, sensors_expected: int) -> None:
        self.settings = settings
        self.sensors_expected = sensors_expected
        self.reset()

    def reset(self) -> None:
        """Forget everything, also the result and the counters; collection starts anew."""
        self.completed = 0
        self.restarts = 0
        self._reason = ""
        self._anybody_yet = False
        self._newest: dict[str, Bodies] = {}
        self._windows: dict[str, deque[Bodies]] = {}
        self._known_sensors: frozenset[str] = frozenset()
        self._unplaced: frozenset[BodyKey] = frozenset()
        self._T_world_sensor: dict[BodyKey, Float64] = {}

    def restart(self, reason: str) -> None:
        """Drop all frames and the result, and start to collect again; ``reason`` is reported to users."""
        self.restarts += 1
        self._reason = reason
        self._windows = {}
        self._T_world_sensor = {}

    def unknown(self, bodies: Bodies) -> bool:
        """Return whether any of a frame's bodies arrived after the calibration; False before its completion."""
        known = self._T_world_sensor
        return bool(known) and any(key not in known and key not in self._unplaced for key in bodies.keys)

    def rename(self, sensor: str, new_ids: Mapping[int, int]) -> None:
        """Replace tracking ids in a sensor's transforms, so that a body with a new id does not restart the calibration.

        Args:
            sensor: name of the sensor.
            new_ids: new id of the same body, by old id; ids that have no transform (yet) are ignored.
        """
        renamed = {old: new for old, new in new_ids.items() if (sensor, old) in self._T_world_sensor}
        kept = {key: T for key, T in self._T_world_sensor.items() if key[0] != sensor or key[1] not in renamed}
        kept |= {(sensor, new): self._T_world_sensor[sensor, old] for old, new in renamed.items()}
        self._T_world_sensor = kept

    def update(self, bodies: Bodies, speaking: Collection[str]) -> Calibration:
        """Update the calibration with one frame; return its progress, and the transforms once it is complete.

        After completion, a new body, or the departure of all people, restarts it.

        Args:
            bodies: bodies of one sensor's newest frame.
            speaking: names of the sensors that send frames, including this one. A silent one is left out until it
                returns.
        """
        self._newest[bodies.sensor] = bodies
        self._anybody_yet |= bool(bodies.ids)
        if self._T_world_sensor:
            self._watch(bodies, speaking)
        if not self._T_world_sensor:
            self._collect(bodies, speaking)
        return Calibration(self._state(speaking), self._T_world_sensor, self.completed)

    def _watch(self, bodies: Bodies, speaking: Collection[str]) -> None:
        if self.unknown(bodies):
            known = bodies.sensor in self._known_sensors
            self.restart(f"{bodies.sensor}: " + ("a new person arrived" if known else "a new sensor sees a person"))
        elif not self._any_body(speaking):
            self.restart("all people had left")

    def _collect(self, bodies: Bodies, speaking: Collection[str]) -> None:
        if len(speaking) < self.sensors_expected:
            self._windows = {}
            return
        self._windows = {sensor: window for sensor, window in self._windows.items() if sensor in speaking}
        window = self._windows.get(bodies.sensor)
        if window and (problem := self._problem(bodies, window)):
            self.restart(problem if self._any_body(speaking) else "all people had left")
        self._windows.setdefault(bodies.sensor, deque(maxlen=self.settings.frames)).append(bodies)
        if self._any_body(speaking) and self._frames_remaining(speaking) == 0:
            self._finish(speaking)

    def _problem(self, bodies: Bodies, window: deque[Bodies]) -> str:
        """Return why this frame does not continue its sensor's window; empty if it does."""
        before = window[0] if self.settings.compare_with == "first" else window[-1]
        if set(bodies.ids) - set(before.ids):
            return f"{bodies.sensor}: a new person arrived"
        if gone := sorted(set(before.ids) - set(bodies.ids)):
            return f"{bodies.sensor}: {body_name(gone[0])} is gone"
        return movement(before, bodies, self.settings.still_within_m) if bodies.ids else ""

    def _finish(self, speaking: Collection[str]) -> None:
        found: dict[BodyKey, Float64] = {}
        unplaced: list[BodyKey] = []
        for window in self._windows.values():
            latest = window[-1]
            centres, angles = standing(window, self.settings.angle_from, self.settings.centre_of)
            for body, centre, angle in zip(latest.ids, centres, angles, strict=True):
                if np.isfinite([*centre, angle]).all():
                    found[latest.sensor, body] = world_from_sensor(centre, angle)
                else:
                    unplaced.append((latest.sensor, body))
        problem = "; ".join(
            f"{sensor}: the shoulders of {body_name(body)} were never seen" for sensor, body in unplaced
        )
        if not found:
            self.restart(problem)
            return
        self._T_world_sensor, self._unplaced = found, frozenset(unplaced)
        self._known_sensors = frozenset(speaking)
        self._windows = {}
        self._reason = problem
        self.completed += 1

    def _frames_remaining(self, speaking: Collection[str]) -> int:
        """Return the count of the slowest sensor that sees a body; all frames if none does."""
        seeing = [sensor for sensor, bodies in self._newest.items() if bodies.ids and sensor in speaking]
        collected = [len(self._windows.get(sensor, ())) for sensor in seeing]
        return self.settings.frames - min(collected, default=0)

    def _any_body(self, speaking: Collection[str]) -> bool:
        return any(bodies.ids for sensor, bodies in self._newest.items() if sensor in speaking)

    def _state(self, speaking: Collection[str]) -> TrackerState:
        if self._T_world_sensor:
            silent = sorted({sensor for sensor, _ in self._T_world_sensor if sensor not in speaking})
            reasons = [self._reason] if self._reason else []
            reasons += [f"{sensor}: silent" for sensor in silent]
            return TrackerState(Phase.TRACKING, reason="; ".join(reasons))
        if missing := max(0, self.sensors_expected - len(speaking)):
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing, reason=self._reason)
        reason, phase = self._reason, Phase.CALIBRATING
        if not self._any_body(speaking):
            reason = "all people have left" if self._anybody_yet else "no person is in view yet"
            phase = Phase.NEEDS_RECALIBRATION if self._anybody_yet else phase
        return TrackerState(
            phase,
            frames_remaining=self._frames_remaining(speaking),
            frames_wanted=self.settings.frames,
            reason=reason,
        )


def movement(before: Bodies, now: Bodies, still_within_m: float) -> str:
    """Describe a head or hand that went missing or moved too far between two frames; empty if none did.

    Motion counts only if a part is tracked in both frames, because an inferred position jumps although nothing moves. A
    part that is missing in both is ignored, because a sensor at a person's side may never see the far hand.

    Args:
        before, now: two frames of one sensor, with the same bodies.
        still_within_m: largest distance of a part that counts as still [m].
    """
    parts = [now.topology.parts[part] for part in STILL_PARTS]
    names = list(STILL_PARTS.values())
    seen_before = before.states[:, parts] != JointState.NOT_TRACKED
    missing = seen_before & (now.states[:, parts] == JointState.NOT_TRACKED)
    if missing.any():
        body, part = (int(i[0]) for i in missing.nonzero())
        return f"{now.sensor}: {names[part]} of {body_name(now.ids[body])} went missing"
    tracked = np.minimum(before.states[:, parts], now.states[:, parts]) == JointState.TRACKED
    step = np.where(tracked[..., None], now.positions[:, parts] - before.positions[:, parts], 0.0)
    distance_m = np.sqrt((step * step).sum(axis=-1))
    if distance_m.max(initial=0.0) > still_within_m:
        body, part = (int(i) for i in np.unravel_index(distance_m.argmax(), distance_m.shape))
        moved_cm = 100 * distance_m[body, part]
        return f"{now.sensor}: {names[part]} of {body_name(now.ids[body])} moved {moved_cm:.0f} cm"
    return ""


def standing(
    window: Collection[Bodies],
    angle_from: Literal["mean", "latest"],
    centre_of: Literal["tracked", "seen"] = "tracked",
) -> tuple[Float64, Float64]:
    """Return centres C (bodies, 3) [m] and shoulder angles θ (bodies,) [rad] over frames of the same bodies.

    A frame without even an inferred shoulder has no angle and does not count; NaN if no frame has one, or if no
    joint was ever tracked.

    Args:
        window: the frames.
        angle_from: whether θ is the circular mean over the frames, or that of the latest frame.
        centre_of: whether the centre is of the tracked joints, or of all seen ones.
    """
    parts = next(iter(window)).topology.parts
    positions = np.stack([bodies.positions for bodies in window], axis=1)
    states = np.stack([bodies.states for bodies in window], axis=1)
    angles = shoulder_angle(positions[..., parts["shoulder_left"], :], positions[..., parts["shoulder_right"], :])
    counted = [row[np.isfinite(row)] for row in angles]
    if angle_from == "latest":
        counted = [row[-1:] for row in counted]
    mean = [float(circular_mean(row)) if len(row) else np.nan for row in counted]
    return body_centre(positions, states, inferred=centre_of == "seen"), np.array(mean)
