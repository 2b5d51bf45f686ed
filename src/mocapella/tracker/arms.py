"""The method ``arms``: track arms with one or more depth cameras.

    poses = the rig's, or calibrate(frames)   an uncalibrated camera is calibrated by an arm that it and others see
    arms  = follow(frames, poses)             `arm_tracks`: assign to tracks, fuse

The world is the rig's. Without a rig it is the sensor space of the first camera (x to the camera's left, y up, z out of
the lens), corrected by its tilt and height if these are set. See docs/arms/fusion.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.arm_extrinsics import REMEMBERED as PLACES_REMEMBERED
from mocapella.calibration.arm_extrinsics import ArmExtrinsics, ArmExtrinsicsSettings
from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import inverse, rigid, rotation_about_x
from mocapella.model.arms import ArmFrame
from mocapella.model.camera import CameraRig
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedArm, TrackerState
from mocapella.model.session import SensorPose
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.tracker.arm_tracks import REMEMBERED as TRACKS_REMEMBERED
from mocapella.tracker.arm_tracks import TO_SENSOR, ArmTracks, ArmTracksSettings
from mocapella.tracker.arrivals import camera_problem, time_problem
from mocapella.tracker.method import not_taken
from mocapella.tracker.protocol import TrackerReport, scene_at

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class ArmsSettings:
    """The settings of every stage.

    Attributes:
        tracks: tracking and fusion of arms.
        places: calibration of cameras without a rig.
        silent_after_s: a camera without a frame for this long is not waited for [s].
        moved_m: a camera whose palms are on average farther than this from the mean of all cameras is reported as
            moved; larger: only larger moves are noticed [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tracks: ArmTracksSettings = field(default_factory=ArmTracksSettings)
    places: ArmExtrinsicsSettings = field(default_factory=ArmExtrinsicsSettings)
    silent_after_s: float = 1.0
    moved_m: float = 0.03

    def __post_init__(self) -> None:
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")
        check(0 < self.moved_m <= 1, "moved_m", self.moved_m, "above 0 and at most 1 m")


class ArmsTracker:
    """Tracker of the method ``arms``.

    Associates the arms that detectors find in each camera's depth images with tracks, and fuses each track's views.
    Cameras without a pose are calibrated from arms that they see together with calibrated ones.

    Args:
        settings: the settings of every stage; the defaults if None.
        rig: known poses of cameras; if None, the first camera defines the world and arms calibrate the others.
        sensors_expected: number of cameras to wait for; the scene's phase is WAITING_FOR_SENSORS before.
        sensors: tilt and height by camera name, for a first camera without a rig.

    Attributes:
        camera_rig: the argument ``rig``.
    """

    def __init__(
        self,
        settings: ArmsSettings | None = None,
        *,
        rig: CameraRig | None = None,
        sensors_expected: int = 1,
        sensors: Mapping[str, SensorPose] | None = None,
    ) -> None:
        self.settings = s = settings or ArmsSettings()
        self.camera_rig = rig
        self._expected = sensors_expected
        self._poses = dict(sensors or {})
        self._tracks = ArmTracks(s.tracks)
        self._calibration = ArmExtrinsics(s.places)
        self._kept: dict[str, LayoutSensor] = {}
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._tracks.reset()
        self._heard_ns: dict[str, int] = {}
        self._now_ns = 0
        self._newest: dict[str, tuple[int, int]] = {}
        self._reasons: dict[str, str] = {}
        self._rejected: Counter[str] = Counter()
        self._steps = self._calibrations = self._restarts = 0
        self._arms: tuple[TrackedArm, ...] = ()
        self._begin_places()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._expected)

    def recalibrate(self, reason: str) -> None:
        """Recalibrate the cameras placed by an arm or a layout; cameras of a camera rig keep their poses.

        The tracker's state gives ``reason``, a text for the user, until the next usable frame updates the state.
        """
        self._restarts += 1
        self._kept = {}
        self._begin_places()
        for camera in self._heard_ns:
            self._tracks.forget(camera)
        phase = Phase.TRACKING if len(self._heard_ns) < 2 else Phase.CALIBRATING
        self._state = TrackerState(phase, reason=reason)

    def _begin_places(self) -> None:
        """Forget the calibrated poses; `_given` becomes the rig's and the layout's, empty without them."""
        self._calibration.reset()
        cameras = {} if self.camera_rig is None else self.camera_rig.cameras
        kept = {name: np.array(sensor.T_world_sensor) @ TO_SENSOR for name, sensor in self._kept.items()}
        given = kept | {name: inverse(camera.T_camera_world) for name, camera in cameras.items()}
        self._given: dict[str, Float64] = dict(sorted(given.items()))
        self._placed = dict(self._given)
        self._delay_s: dict[str, float] = {}
        self._places: tuple[SensorPlace, ...] = self._sensor_places()

    def use_layout(self, layout: SensorLayout) -> None:
        """Restart from a layout of an earlier session; the poses of a camera rig take precedence."""
        self._kept = dict(layout.sensors)
        self.reset()

    def layout(self) -> SensorLayout | None:
        """Return the estimated layout; None before two cameras have a pose, and with a camera rig."""
        if self.camera_rig is not None or len(self._placed) < 2:
            return None
        places = (place for place in self._places if place.T_world_sensor is not None)
        sensors = {
            place.sensor: LayoutSensor(
                np.asarray(place.T_world_sensor).tolist(), 1e3 * place.position_sd, float(np.degrees(place.rotation_sd))
            )
            for place in places
        }
        return SensorLayout(VERSION, False, sensors, [])

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        parts = [
            {name: getattr(self, name) for name in _OWN_MEMORY},
            {name: value for name, value in vars(self._tracks).items() if name != "settings"},
            {name: value for name, value in vars(self._calibration).items() if name != "settings"},
        ]
        return pack(parts, _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        own, tracks, calibration = unpack(data, _REMEMBERED)
        if not all(isinstance(kept, LayoutSensor) for kept in own["_kept"].values()):  # `reset` uses them
            raise TypeError("_kept has another type")
        set_memory(self, own, _OWN_MEMORY)
        set_memory(self._tracks, tracks)
        set_memory(self._calibration, calibration)

    @property
    def report(self) -> TrackerReport:
        """Counts of used and rejected frames, calibrations and restarts so far."""
        kept = self._steps - self._rejected.total()
        return TrackerReport(self._steps, kept, dict(self._rejected), self._calibrations, self._restarts)

    @property
    def delays_s(self) -> Mapping[str, float]:
        """Delay of the frames of each camera calibrated from an arm, relative to the calibrated one [s]."""
        return self._delay_s

    @property
    def places(self) -> tuple[SensorPlace, ...]:
        """Name, pose (4, 4) in the world and uncertainty of each camera."""
        return self._places

    def update(self, arrival: Arrival) -> Scene:
        """Process a depth camera's frame of arms, and return the scene: all tracked arms, and the cameras' poses.

        A frame that cannot be used is counted in `report` and changes nothing: its scene repeats the last results.
        """
        frame: Any = arrival.frame
        if type(frame) is not ArmFrame:
            problem = not_taken(frame, "arms")
        elif not (problem := self._problem(frame)):
            self._see(arrival, frame)
        if problem:
            self._rejected[problem] += 1
        return self._scene(arrival)

    def _see(self, arrival: Arrival, frame: ArmFrame) -> None:
        """Process a depth camera's arms."""
        camera = frame.sensor
        self._newest[camera] = (frame.node_id, frame.time_ns)
        self._heard_ns[camera] = arrival.at_ns
        self._now_ns = max(self._now_ns, arrival.at_ns)
        self._reasons[camera] = frame.reason
        if not self._given:
            self._given[camera] = self._placed[camera] = self._level(camera)
        at_s = arrival.at_ns / NS_PER_S
        self._calibrate(camera, frame, at_s)
        if camera in self._placed:
            self._tracks.update(camera, frame.arms, at_s - self._delay_s.get(camera, 0.0), self._placed)
            self._arms = self._tracks.tracked_arms()
        self._places = self._sensor_places()
        self._state = self._stand()

    def _problem(self, frame: ArmFrame) -> str:
        rig, problem = self.camera_rig, ""
        if rig is not None and frame.sensor in rig.cameras:
            problem = camera_problem(rig, frame.sensor, frame.size_px)
        return problem or time_problem(frame, self._newest.get(frame.sensor))

    def _level(self, camera: str) -> Float64:
        """Return ``T_world_camera`` of the camera that defines the world."""
        pose = self._poses.get(camera, SensorPose())
        return np.asarray(rigid(rotation_about_x(-pose.tilt), (0.0, pose.height, 0.0)) @ TO_SENSOR)

    def _calibrate(self, camera: str, frame: ArmFrame, at_s: float) -> None:
        for name in self._calibration.update(camera, frame.arms, at_s, self._given):
            found = self._calibration.found[name]
            if found.missing:
                continue
            self._calibrations += name not in self._placed
            self._placed[name] = found.T_world_camera
            self._delay_s[name] = found.delay_s

    def _speaking(self) -> list[str]:
        limit = self.settings.silent_after_s * NS_PER_S
        return [name for name, at_ns in sorted(self._heard_ns.items()) if self._now_ns - at_ns < limit]

    def _stand(self) -> TrackerState:
        speaking = self._speaking()
        missing = self._expected - len(speaking)
        needs = [f"{name}: {self._calibration.needs(name)}" for name in speaking if name not in self._placed]
        reasons = [*needs, *(f"{name}: {self._moved(name)}" for name in speaking if self._moved(name))]
        reasons += [f"{name}: {_one_part(self._reasons[name])}" for name in speaking if self._reasons[name]]
        reason = "; ".join(reasons)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing, reason=reason)
        return TrackerState(Phase.CALIBRATING if needs else Phase.TRACKING, reason=reason)

    def _moved(self, camera: str) -> str:
        away, _ = self._tracks.away.get(camera, (0.0, 0.0))
        if away <= self.settings.moved_m:
            return ""
        return f"its hands are {1e2 * away:.0f} cm from the mean of all cameras: was it moved? recalibrate"

    def _sensor_places(self) -> tuple[SensorPlace, ...]:
        names = sorted(self._given.keys() | self._heard_ns.keys())
        return tuple(self._place(name) for name in names)

    def _place(self, name: str) -> SensorPlace:
        T, problem = self._placed.get(name), self._moved(name)
        if T is None:
            return SensorPlace(name, None, problem=self._calibration.needs(name))
        found, kept = self._calibration.found.get(name), self._kept.get(name)
        if kept is not None:
            turn = float(np.radians(kept.rotation_sd_deg))
            return SensorPlace(name, T @ TO_SENSOR, 1e-3 * kept.position_sd_mm, turn, "as kept", problem)
        if found is None:
            return SensorPlace(
                name, T @ TO_SENSOR, 0.0, 0.0, "" if self.camera_rig is None else "as calibrated", problem
            )
        sd, turn = found.position_sd_m, found.rotation_sd_rad
        words = f"{1e3 * sd:.0f} mm and {np.degrees(turn):.1f}°"
        return SensorPlace(name, T @ TO_SENSOR, sd, turn, words, problem)

    def _scene(self, arrival: Arrival) -> Scene:
        step, self._steps = self._steps, self._steps + 1
        parts = {"arms": self._arms}
        return scene_at(arrival, step, self._state, parts, topology=topology("hand"), sensors=self._places)


def _one_part(reason: str) -> str:
    """Replace each ``; `` by a comma, because it separates the cameras' parts of a state's reason."""
    return reason.replace("; ", ", ")


_OWN_MEMORY: Final = (
    *("_heard_ns", "_now_ns", "_newest", "_reasons", "_rejected", "_steps", "_calibrations", "_restarts", "_arms"),
    *("_kept", "_given", "_placed", "_delay_s", "_places", "_state"),
)
_REMEMBERED: Final = tuple(
    dict.fromkeys((*TRACKS_REMEMBERED, *PLACES_REMEMBERED, LayoutSensor, TrackedArm, SensorPlace, Phase, TrackerState))
)
