"""Calibrate the cameras of the method ``webcams`` from the people they track, if there is no rig.

Tracking begins when the stated standard deviations suffice. Later estimates replace the rig when they are more certain;
their world is aligned with the present one, so that people move little and keep their numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.people_rig import LEAST_EXTENT_M, POOR_DEG, POOR_MM, SURE, RigFromPeople, RigScale
from mocapella.calibration.people_rig_live import REMEMBERED as LIVE_REMEMBERED
from mocapella.calibration.people_rig_live import WALK, LiveRigFromPeople
from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.scene import Phase, SensorPlace, TrackerState
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]

ANEW: Final = "walk about: it is calibrated anew"
"""What to do about a camera that does not agree with the others."""
STAMP_SD_S: Final = 0.005
"""Standard deviation of the time stamps of an ordinary webcam, beside its clock: a part of its exposure [s]."""
SMALL_M: Final = 0.25
"""Largest step of a camera's position after which people keep their places [m]."""


class NewRig(msgspec.Struct, frozen=True, eq=False):
    """A rig to use from now on, and whether all cameras are nearly where they were."""

    rig: CameraRig
    small: bool


class SelfCalibration:
    """Calibrates cameras from the people they see, and decides when the result suffices.

    Args:
        settings: settings of the method.
        cameras: number of cameras to wait for.

    Attributes:
        calibrations: number of rigs that were put to use.
        restarts: number of times that a camera was found to have moved.
    """

    def __init__(self, settings: WebcamsSettings, cameras: int) -> None:
        self.settings = settings
        scale = RigScale(stature_m=settings.height_m) if settings.height_m else None
        self._live = LiveRigFromPeople(cameras, scale, settings=settings.calibration)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._live.reset()
        self._used: RigFromPeople | None = None
        self._anew = False
        self.calibrations = self.restarts = 0

    def begin_anew(self) -> None:
        """Calibrate anew, because a camera was moved; the rig in use stays until then. Once begun, it goes on."""
        if not self._anew:
            self._anew = True
            self.restarts += 1
            self._live.begin_anew()

    def update(self, frame: KeypointFrame, at_s: float) -> NewRig | None:
        """Take a frame, and return a rig to use from now on; None for the one in use, or none.

        Args:
            frame: the detections of one camera.
            at_s: its capture time on the common clock [s].
        """
        if not self._live.update(frame, at_s):
            return None
        found = self._live.rig()
        if found is None or why_not(found, self.settings):
            return None
        before, self._used, self._anew = self._used, found, False
        self.calibrations += 1
        if before is None:
            return NewRig(found.rig, small=False)
        rig = in_world_of(found.rig, before.rig)
        self._used = msgspec.structs.replace(found, rig=rig)
        return NewRig(rig, small=largest_step_m(rig, before.rig) <= SMALL_M)

    def state(self, expected: int, reason: str) -> TrackerState:
        """Return the state while there is no rig in use.

        Args:
            expected: number of cameras to wait for.
            reason: text of the last state, which stays while cameras are missing.
        """
        missing = expected - self._live.cameras
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, missing, reason=reason or WALK)
        now_s, due_s = self._live.progress
        rate_hz = self.settings.calibration.rate_hz
        wanted = round(due_s * rate_hz)
        left = 0 if self._live.estimating else max(wanted - round(now_s * rate_hz), 0)
        found = self._live.rig()
        problem = self._live.problem or ("" if found is None else why_not(found, self.settings))
        text = problem if WALK in problem or not problem else f"{problem}; {WALK}"
        return TrackerState(Phase.CALIBRATING, 0, left, wanted, text or WALK)

    @property
    def advice(self) -> str:
        """What would make the rig in use better; empty if it is good."""
        if self._used is None or self._used.good:
            return ""
        position_m, rotation_deg = _worst(self._used)
        return (
            f"the cameras may be off by {1e3 * SURE * position_m:.0f} mm and {SURE * rotation_deg:.1f}° "
            f"({POOR_MM:.0f} mm and {POOR_DEG:g}° are good): walk on, nearer and farther; it gets better"
        )

    def places(self, placed: tuple[SensorPlace, ...]) -> tuple[SensorPlace, ...]:
        """Return sensors' places of the rig in use with their quality in words; a guessed scale is named."""
        if self._used is None:
            return placed
        scale = f"; scale guessed ± {100 * self._used.scale_sd:.0f} %" if self._used.guessed else ""
        words = {
            name: f"{one.position_sd_mm:.0f} mm, {one.rotation_sd_deg:.1f}°{scale}"
            for name, one in self._used.cameras.items()
        }
        return tuple(msgspec.structs.replace(one, quality=words.get(one.sensor, one.quality)) for one in placed)

    def time_sds_s(self, names: Sequence[str]) -> Float64:
        """Return the standard deviations (cameras,) of the clocks of the rig in use; infinite where none is stated [s].

        The errors of single time stamps add to the clock's own: `STAMP_SD_S`.
        """
        known = {} if self._used is None else self._used.cameras
        own = [known[name].clock_sd_ms / 1e3 if name in known else math.inf for name in names]
        return np.hypot(own, STAMP_SD_S)

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall`; its classes are `REMEMBERED`."""
        return {
            "live": self._live.memory(), "used": self._used, "anew": self._anew, "calibrations": self.calibrations,
            "restarts": self.restarts,
        }  # fmt: skip

    def recall(self, memory: dict[str, Any]) -> None:
        """Restore the state that `memory` returned."""
        self._live.recall(memory["live"])
        self._used, self._anew = memory["used"], memory["anew"]
        self.calibrations, self.restarts = memory["calibrations"], memory["restarts"]


REMEMBERED: Final = LIVE_REMEMBERED
"""Classes in the state of a `SelfCalibration`, see `mocapella.model.memory`."""


def why_not(found: RigFromPeople, settings: WebcamsSettings) -> str:
    """Return why a rig does not suffice to track; empty if it does."""
    if found.extent_m < LEAST_EXTENT_M:
        return f"people stayed within {found.extent_m:.1f} m, which does not determine the cameras"
    position_m, rotation_deg = _worst(found)
    if position_m <= settings.start_position_m and rotation_deg <= settings.start_rotation_deg:
        return ""
    reason = (
        f"the cameras are known to ± {1e3 * position_m:.0f} mm and {rotation_deg:.1f}°, and "
        f"{1e3 * settings.start_position_m:.0f} mm and {settings.start_rotation_deg:g}° are needed"
    )
    unknown = any(one.focal_sd_percent > 0 for one in found.cameras.values())
    if len(found.cameras) > 2 or not unknown or settings.calibration.same_lenses:
        return reason
    return f"{reason}; a third camera helps, or calibration.same_lenses=true if both cameras are of one model"


def _worst(found: RigFromPeople) -> tuple[float, float]:
    """Return the worst standard deviations of a position [m] and a direction [°]."""
    of = found.cameras.values()
    return max(one.position_sd_mm for one in of) / 1e3, max(one.rotation_sd_deg for one in of)


def in_world_of(rig: CameraRig, other: CameraRig) -> CameraRig:
    """Return a rig in the world of another one, moved along the floor and turned about y so that cameras fit best.

    Upward and the height of the floor stay as in ``rig``. With fewer than two cameras in common it is unchanged.
    """
    shared = [name for name in rig.cameras if name in other.cameras]
    if len(shared) < 2:
        return rig
    p, q = (np.array([inverse(of.cameras[n].T_camera_world)[:3, 3] for n in shared]) for of in (other, rig))
    p0, q0 = p.mean(axis=0), q.mean(axis=0)
    a, b = p - p0, q - q0
    angle = math.atan2(float((b[:, 2] * a[:, 0] - b[:, 0] * a[:, 2]).sum()), float((a * b)[:, [0, 2]].sum()))
    R = rotation_about_y(angle)
    T = rigid(R, (p0 - R @ q0) * [1.0, 0.0, 1.0])
    moved = {
        name: msgspec.structs.replace(one, T_camera_world=one.T_camera_world @ inverse(T))
        for name, one in rig.cameras.items()
    }
    return CameraRig(moved)


def largest_step_m(rig: CameraRig, other: CameraRig) -> float:
    """Return the largest distance of a camera's positions in two rigs [m]; infinite without a common camera."""
    steps = [
        float(np.linalg.norm(inverse(one.T_camera_world)[:3, 3] - inverse(other.cameras[n].T_camera_world)[:3, 3]))
        for n, one in rig.cameras.items()
        if n in other.cameras
    ]
    return max(steps, default=math.inf)
