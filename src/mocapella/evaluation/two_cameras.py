"""Measure the benefit of a second depth camera: score each camera's arm and the fused arm against ground truth.

Both cameras see one rendered arm; the second stands to the side, and takes its images half a frame later. Each is
scored at its own instants, the fused arm at all of them, without any correction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.detectors import ArmDetector
from mocapella.evaluation.arms import MATCH_M
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.arms import ELBOW, PALM, ArmFrame, SeenArms
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import TIPS, WRIST
from mocapella.model.observations import Arrival, JointState
from mocapella.settings import check
from mocapella.sources.simulate.depth_scene import DepthScene, DepthShot
from mocapella.tracker.arm_tracks import TO_SENSOR
from mocapella.tracker.arms import ArmsSettings, ArmsTracker

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

Told = tuple[Float64, UInt8, int]
"""Points (23, 3) in the world [m], their `JointState` (23,), and the id of an arm."""
ArmFinding = Callable[[DepthShot], SeenArms]
"""A function that detects the arms in a simulated depth image."""
CAMERAS: Final = ("first", "second")
FUSED: Final = "fused"


@dataclass
class _Errors:
    """Score of one camera, or of both together."""

    frames: int = 0
    followed: int = 0
    tips: list[float] = field(default_factory=list)
    measured: list[bool] = field(default_factory=list)
    filled: list[float] = field(default_factory=list)
    other: dict[str, list[float]] = field(default_factory=lambda: {"wrist": [], "palm": [], "elbow": []})
    ids: set[int] = field(default_factory=set)

    def add(self, arms: list[Told], true: Float64, seen: Bools, hidden: Bools) -> None:
        """Add one instant; ``seen`` (23,) by either camera, ``hidden`` (23,) from one and seen by the other."""
        self.frames += 1
        away = [float(np.nan_to_num(np.linalg.norm(arm[0][PALM] - true[PALM]), nan=math.inf)) for arm in arms]
        if not away or min(away) > MATCH_M:
            return
        points, states, number = arms[int(np.argmin(away))]
        self.followed += 1
        self.ids.add(number)
        error = np.linalg.norm(points - true, axis=-1)
        for tip in TIPS:
            if seen[tip] and np.isfinite(error[tip]):
                self.tips.append(float(error[tip]))
                self.measured.append(bool(states[tip] == JointState.TRACKED))
                if hidden[tip]:
                    self.filled.append(float(error[tip]))
        for name, at in (("wrist", WRIST), ("palm", PALM), ("elbow", ELBOW)):
            if np.isfinite(error[at]):
                self.other[name].append(float(error[at]))

    def table(self) -> dict[str, float]:
        """Return the figures: errors [mm], and fractions, 0 to 1; NaN where nothing was counted."""

        def of(values: list[float], q: float) -> float:
            return round(1e3 * float(np.percentile(values, q)), 2) if values else math.nan

        return {
            "instants": self.frames,
            "followed": round(self.followed / max(self.frames, 1), 4),
            "tip_median_mm": of(self.tips, 50),
            "tip_p95_mm": of(self.tips, 95),
            "tips_measured": round(float(np.mean(self.measured)), 4) if self.measured else math.nan,
            "tips_of_one_camera": len(self.filled),
            "tips_of_one_camera_median_mm": of(self.filled, 50),
            "tips_of_one_camera_p95_mm": of(self.filled, 95),
            **{f"{name}_median_mm": of(values, 50) for name, values in self.other.items()},
            "ids": len(self.ids),
        }


def beside(scene: DepthScene, angle_deg: float) -> DepthScene:
    """Return the scene as seen by a second camera, rotated about the hands' centre by ``angle_deg``."""
    distance = 0.5 * sum(scene.sensor.distance_m) * scene.settings.distance
    R, middle = rotation_about_y(math.radians(angle_deg)), np.array([0.0, 0.0, distance])
    return scene.from_camera(rigid(R, middle - R @ middle))


def looks_of(detectors: tuple[ArmDetector, ArmDetector]) -> tuple[ArmFinding, ArmFinding]:
    """Return a function for each of two cameras that detects the arms in a simulated depth image.

    The functions update the detectors, so images must be passed in the order of their times.
    """

    def of(detector: ArmDetector) -> ArmFinding:
        return lambda shot: detector.update(shot.depth * np.float32(shot.unit_m), shot.at_s)

    return of(detectors[0]), of(detectors[1])


def two_camera_scores(
    scene: DepthScene,
    looks: tuple[ArmFinding, ArmFinding],
    *,
    angle_deg: float = 60.0,
    fps: float = 30.0,
    seconds: float = 6.0,
    rig: bool = True,
    settings: ArmsSettings | None = None,
    make: Callable[..., ArmsTracker] = ArmsTracker,
) -> dict[str, Mapping[str, float]]:
    """Score each camera by itself and both together.

    Args:
        scene: scene with one arm, as seen by the first camera.
        looks: for each camera, a function that detects the arms in a simulated depth image.
        angle_deg: angle between the cameras, about the hand [deg].
        fps: frame rate of each camera [Hz].
        seconds: duration [s].
        rig: whether the tracker receives the cameras' poses; otherwise it estimates them, and is scored from the first
            estimate on.
        settings: settings of the tracker; None for the defaults.
        make: creates the tracker.

    Returns:
        Figures by name, which ends with the unit, of ``first``, ``second`` and ``fused``: errors of fingertips, wrist,
        palm and elbow, fractions of instants with an arm (``followed``) and of measured fingertips (``tips_measured``),
        and counts. A fingertip counts at an instant if at least one camera can see it; ``tips_of_one_camera`` are seen
        by one camera only: in figures of one camera, by the other one only. Without a rig, also ``place``: error and
        standard deviations of the second camera's pose, and the time until it was known (``known_after_s``).

    Raises:
        SettingsError: the scene does not have exactly one arm.
    """
    check(scene.settings.arms == 1, "scene", scene.name, "one with one arm")
    scenes = (scene, beside(scene, angle_deg))
    T_world = (TO_SENSOR, TO_SENSOR @ inverse(scenes[1].T_camera_first))
    tracker = make(settings, rig=_rig(scenes, T_world) if rig else None, sensors_expected=2)
    errors = {name: _Errors() for name in (*CAMERAS, FUSED)}
    newest: dict[int, DepthShot] = {}
    known_s = math.nan
    for k, sequence, shot in _in_turn(scenes, fps, seconds):
        newest[k] = shot
        seen = looks[k](shot)
        at_ns = round(shot.at_s * NS_PER_S) + 1
        frame = ArmFrame(
            CAMERAS[k], k + 1, sequence, at_ns, 0, scene.sensor.size_px, shot.lens, "scored", seen.arms, seen.reason
        )
        told = tracker.update(Arrival(frame, at_ns))
        if len(newest) < 2 or any(place.T_world_sensor is None for place in told.sensors):
            continue
        known_s = shot.at_s if math.isnan(known_s) else known_s
        truth, other = shot.arms[0], newest[1 - k].arms[0]
        true, either, hidden = apply(T_world[k], truth.points), truth.seen | other.seen, truth.seen ^ other.seen
        own = [(apply(T_world[k], arm.points), arm.states, arm.id) for arm in seen.arms]
        errors[CAMERAS[k]].add(own, true, either, hidden & ~truth.seen)
        errors[FUSED].add([(arm.points, arm.states, arm.id) for arm in told.arms], true, either, hidden)
    tables: dict[str, Mapping[str, float]] = {name: of.table() for name, of in errors.items()}
    if not rig:
        tables["place"] = _place_error(tracker, T_world[1], known_s)
    return tables


def _in_turn(scenes: tuple[DepthScene, DepthScene], fps: float, seconds: float) -> Iterator[tuple[int, int, DepthShot]]:
    for n in range(round(seconds * fps)):
        for k in (0, 1):
            yield k, n, scenes[k].at((n + 0.5 * k) / fps)


def _rig(scenes: tuple[DepthScene, DepthScene], T_world: tuple[Float64, Float64]) -> CameraRig:
    return CameraRig(
        {
            name: PlacedCamera(Camera(name, of.sensor.size_px, of.lens), inverse(T), np.zeros((6, 6)))
            for name, of, T in zip(CAMERAS, scenes, T_world, strict=True)
        }
    )


def _place_error(tracker: ArmsTracker, T_true: Float64, known_s: float) -> dict[str, float]:
    place = next((place for place in tracker.places if place.sensor == CAMERAS[1]), None)
    if place is None or place.T_world_sensor is None:
        return {"known_after_s": math.nan}
    off = inverse(T_true) @ place.T_world_sensor @ TO_SENSOR
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(off[:3, :3])) - 1.0))))
    return {
        "known_after_s": round(known_s, 2),
        "position_error_mm": round(1e3 * float(np.linalg.norm(off[:3, 3])), 2),
        "rotation_error_deg": round(math.degrees(angle), 3),
        "position_sd_mm": round(1e3 * place.position_sd, 2),
        "rotation_sd_deg": round(math.degrees(place.rotation_sd), 3),
    }
