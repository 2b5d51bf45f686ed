"""Simulated depth images of arms, with complete ground truth.

    scene = load_depth_scene("each-finger-before-palm", seed=100, sensor="kinect")
    shot = scene.at(2.5)
    shot.depth, shot.unit_m, shot.arms[0].points, shot.arms[0].seen

A person's arm (`arm_mesh`, moved by `arm_motion`), the body and the background are drawn into an image of exact depths;
`depth_noise` adds the sensor's noise. An image shows one instant. It is determined by the scene's name, the seed, the
sensor and the time, independent of earlier images.

The seed changes the person, the hand's side, the arm's pose, the timing, slightly the postures, the background, and the
noise. **By convention, seeds below 100 are for tuning and seeds from 100 on for scoring.**

`ArmTruth` is the ground truth of an arm in an image; methods are scored by its `seen` and `self_occluded`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import convert, own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rotation_about_x, rotation_about_y
from mocapella.model.arms import ARM_POINTS, ELBOW, PALM
from mocapella.model.depth import DepthFrame
from mocapella.model.depth import depth_frame as frame_of
from mocapella.model.hand import TIPS
from mocapella.settings import check
from mocapella.sources.simulate.arm_mesh import (
    ELBOW_END,
    FIRST_DIGIT,
    FIRST_TIP,
    PALM_BONE,
    PARTS,
    SHOULDER,
    UPPER_ARM,
    WRIST_END,
    ArmMesh,
    ArmMeshPose,
    ArmShape,
    arm_mesh,
    arm_shapes,
)
from mocapella.sources.simulate.arm_motion import ArmMotion, Key, Posture, held_at
from mocapella.sources.simulate.depth_drawing import BODY, FIRST_ARM, body_mesh, draw_background
from mocapella.sources.simulate.depth_noise import DepthNoise, Stereo, StructuredLight, TimeOfFlight, measured

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

SEEN_SHARE: Final = 0.12
SEEN_PX: Final = 6
VIEWS: Final = {
    "palm": np.stack([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]], axis=1),
    "back": np.stack([[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]], axis=1),
}
"""``R_camera_palm`` of a right hand whose fingers point up, by the side that faces the camera."""


class Sensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A depth camera.

    Attributes:
        size_px: (width, height) of the image.
        lens: fx, fy, cx, cy [px].
        unit_m: length of a unit of the image [m].
        distance_m: least and greatest distance of the hands in scenes [m].
        structured_light, time_of_flight, stereo: noise model of the camera, at most one; a perfect camera has none.
    """

    size_px: tuple[int, int]
    lens: tuple[float, float, float, float]
    unit_m: float
    distance_m: tuple[float, float]
    structured_light: StructuredLight | None = None
    time_of_flight: TimeOfFlight | None = None
    stereo: Stereo | None = None

    @property
    def noise(self) -> DepthNoise | None:
        """The noise model of the camera; None for a perfect one."""
        return self.structured_light or self.time_of_flight or self.stereo


class DepthSceneSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Description of a scene of arms in front of a depth camera; see `DepthScene`.

    Attributes:
        keys: key poses of the arm, repeated.
        view: side of the hand that faces the camera: palm, back, side (thumb's or little finger's), or tips.
        person: whether the arm's person is visible.
        behind: background: empty, wall or desk; empty text for a random one.
        arms: number of arms, one or two.
        still: whether the motion has the tempo of the keys, instead of a random one near it.
        peak_m_s: the palm's greatest speed [m/s]; 0 for that of the keys.
        before_torso_m: least and greatest distance from the arm to the torso behind it [m]; None leaves the torso at
            the arm's shoulder.
        roll_deg: least and greatest lean of the arm to the side [deg].
        pitch_deg: least and greatest angle by which the elbow is behind the hand [deg].
        joints_deg: flexion of the elbow, pronation, flexion and deviation of the wrist at the beginning [deg].
        distance: factor of the hands' distance.
        shape: the person's arm; None for one of `arm_shapes`, which the seed chooses.
    """

    keys: tuple[Key, ...]
    view: str = "palm"
    person: bool = True
    behind: str = ""
    arms: int = 1
    still: bool = False
    peak_m_s: float = 0.0
    before_torso_m: tuple[float, float] | None = None
    roll_deg: tuple[float, float] = (-30.0, 30.0)
    pitch_deg: tuple[float, float] = (8.0, 32.0)
    joints_deg: tuple[float, float, float, float] = (100.0, 75.0, 0.0, 0.0)
    distance: float = 1.0
    shape: ArmShape | None = None


class ArmTruth(msgspec.Struct, frozen=True, eq=False):
    """Ground truth of an arm at an instant, in the camera frame; methods are scored by it.

    Attributes:
        left: whether it is a left arm.
        points: (23, 3) positions of `mocapella.model.arms.ARM_POINTS` [m]. A fingertip's flesh ends 0.6 of its radius
            beyond its landmark, see `mocapella.model.hand_flesh`.
        shoulder: (3,) position of the shoulder, which is none of ``points`` [m].
        angles: (21,) angles in the order of `mocapella.model.hand.ANGLES` [rad].
        T_camera_palm: (4, 4) pose of the palm's frame, see `mocapella.model.hand`.
        seen: (23,) whether a landmark is measurable in the image *before noise*. A fingertip is if its patch (the
            surface of its last bone from 8 mm before the landmark to the end) has at least 6 pixels in the image, or at
            least one pixel and 12 % of those that it would cover without any occlusion. Any other landmark is if the
            pixel at its projection belongs to a part of this arm that begins or ends at it.
        self_occluded: (5,) whether a fingertip, thumb to little finger, is seen, but the palm or another digit of this
            hand is on the ray through its landmark, nearer or farther.
        tip_px: (5, 2) number of pixels of each tip's patch: in the image before noise; and without any occlusion, there
            also beyond the image's border.
        gesture: name of the gesture; empty without one.
        shape: the person's name in `arm_shapes`; empty for another arm.
    """

    left: bool
    points: Float64
    shoulder: Float64
    angles: Float64
    T_camera_palm: Float64
    seen: NDArray[np.bool_]
    self_occluded: NDArray[np.bool_]
    tip_px: Int64
    gesture: str
    shape: str


class Shot(msgspec.Struct, frozen=True, eq=False):
    """A rendered depth image.

    Attributes:
        at_s: time of the image since the scene's start [s].
        depth: (height, width) uint16 distance along the optical axis in units; 0 without a measurement.
        unit_m: length of a unit [m].
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
    """

    at_s: float
    depth: UInt16
    unit_m: float
    lens: Float64


class DepthShot(Shot, frozen=True, eq=False):
    """A depth image (see `Shot`) and its ground truth.

    Attributes:
        arms: ground truth of the scene's arms, in the image or not.
        exact_m: (height, width) float32 depth before noise [m]; infinite without a surface.
        parts: (height, width) uint8 label before noise: `NOTHING`, … of `depth_drawing`; `FIRST_ARM` and above.
    """

    arms: tuple[ArmTruth, ...]
    exact_m: Float32
    parts: UInt8


@dataclass(frozen=True, eq=False)
class _Actor:
    """An arm with its motion; a left arm is mirrored in the camera's x."""

    mesh: ArmMesh
    motion: ArmMotion
    shape: str
    later_s: float

    @property
    def mirror(self) -> Float64:
        return self.mesh.hand.mirror

    def at(self, at_s: float) -> tuple[ArmMeshPose, str]:
        held = self.motion.at(at_s + self.later_s)
        T, M = held.pose.T_camera_shoulder.copy(), self.mirror
        T[:3] = M[:, None] * T[:3]
        T[:3, :3] *= M
        return ArmMeshPose(held.pose.angles, held.pose.joints, T), held.gesture


class DepthScene:
    """A scene seen by one camera; made by `load_depth_scene`.

    Args:
        name, seed: name and random seed of the scene; both determine its random choices.
        settings: description of the scene.
        sensor: the camera.
        T_camera_first: (4, 4) from the frame of the camera that the scene is made for to this one's; None for that one.

    Attributes:
        name, seed, settings, sensor, T_camera_first: as given.
        period_s: period of the first arm's motion [s]; a second arm has another one.

    Raises:
        SettingsError: the settings' view, number of arms or background is unknown; names the valid ones.
    """

    def __init__(
        self,
        name: str,
        settings: DepthSceneSettings,
        sensor: Sensor,
        seed: int,
        T_camera_first: Float64 | None = None,
    ) -> None:
        check(settings.view in (*VIEWS, "side", "tips"), "view", settings.view, "palm, back, side or tips")
        check(settings.arms in (1, 2), "arms", settings.arms, "1 or 2")
        check(settings.behind in ("", "empty", "wall", "desk"), "behind", settings.behind, "empty, wall or desk")
        self.name, self.settings, self.sensor, self.seed = name, settings, sensor, seed
        self.T_camera_first = np.eye(4) if T_camera_first is None else np.asarray(T_camera_first, dtype=np.float64)
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        self._actors = self._cast(rng)
        self._body, self._from_shoulder = self._person(rng)
        behind = settings.behind or str(rng.choice(["empty", "wall", "desk"]))
        self._behind = draw_background(behind, sensor.size_px, sensor.lens, rng, self.T_camera_first)
        self.period_s = self._actors[0].motion.period_s
        self._key = int(rng.integers(1 << 62))
        if T_camera_first is not None:  # another camera has other noise
            self._key ^= zlib.crc32(self.T_camera_first.tobytes())

    @property
    def lens(self) -> Float64:
        """(9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3, as in `mocapella.geometry.lens`."""
        return np.array([*self.sensor.lens, *[0.0] * 5])

    def poses(self, at_s: float) -> tuple[ArmMeshPose, ...]:
        """Return the poses of the arms at a time since the scene's start [s], in the camera frame."""
        return tuple(self._seen(actor.at(at_s)[0]) for actor in self._actors)

    def gestures(self, at_s: float) -> tuple[str, ...]:
        """Return the arms' gestures at a time since the scene's start [s], as `ArmTruth` has them, without an image."""
        return tuple(actor.at(at_s)[1] for actor in self._actors)

    def from_camera(self, T_other_this: Float64) -> DepthScene:
        """Return the scene as seen by another camera of this kind, as a new object with other noise.

        ``T_other_this`` (4, 4) is from this camera's frame to the other camera's.
        """
        return DepthScene(self.name, self.settings, self.sensor, self.seed, T_other_this @ self.T_camera_first)

    def _seen(self, pose: ArmMeshPose) -> ArmMeshPose:
        """Transform a pose from the first camera's frame to this camera's."""
        return ArmMeshPose(pose.angles, pose.joints, self.T_camera_first @ pose.T_camera_shoulder)

    @property
    def meshes(self) -> tuple[ArmMesh, ...]:
        """Triangle meshes of the simulated arms."""
        return tuple(actor.mesh for actor in self._actors)

    def at(self, at_s: float) -> DepthShot:
        """Render the image at a time since the scene's start [s], with its ground truth."""
        images = self._behind.copy()
        drawn, shoulders = [], []
        for actor in self._actors:
            pose, gesture = actor.at(at_s)
            shoulders.append(pose.T_camera_shoulder[:3, 3])
            pose = self._seen(pose)
            drawn.append((actor, pose, gesture, actor.mesh.at(pose)))
        if self._body is not None:
            mirror = self._actors[0].mirror
            vertices, triangles = self._body
            placed = (vertices + shoulders[0] * mirror + self._from_shoulder) * mirror
            placed = np.ascontiguousarray(apply(self.T_camera_first, placed))
            if mirror[0] < 0:
                triangles = np.ascontiguousarray(triangles[:, ::-1])
            images.draw(placed, triangles, np.zeros(len(triangles), np.uint8), BODY, self.sensor.lens)
        seen = [
            images.draw(vertices, actor.mesh.triangles, actor.mesh.parts, FIRST_ARM + n * len(PARTS), self.sensor.lens)
            for n, (actor, _, _, vertices) in enumerate(drawn)
        ]
        arms = tuple(
            _truth(actor, pose, gesture, seen_px=seen[n], parts=images.parts, first=FIRST_ARM + n * len(PARTS),
                   lens=self.lens)
            for n, (actor, pose, gesture, _) in enumerate(drawn)
        )  # fmt: skip
        depth = measured(
            images.depth, images.slope, self.sensor.noise,
            focal_px=self.sensor.lens[0], unit_m=self.sensor.unit_m, key=self._key + round(1e9 * at_s),
        )  # fmt: skip
        return DepthShot(at_s, depth, self.sensor.unit_m, self.lens, arms, images.depth, images.parts)

    def frames(self, fps: float, start_s: float = 0.0, end_s: float | None = None) -> Iterator[DepthShot]:
        """Render a sequence of images.

        Args:
            fps: frame rate [Hz].
            start_s: time of the first image [s].
            end_s: time before which the sequence ends; None for one `period_s` [s].
        """
        end = start_s + self.period_s if end_s is None else end_s
        for i in range(math.ceil((end - start_s) * fps - 1e-9)):
            yield self.at(start_s + i / fps)

    def _cast(self, rng: np.random.Generator) -> list[_Actor]:
        s, data = self.settings, _data()
        names = list(arm_shapes())
        shape = names[int(rng.integers(len(names)))]
        left = bool(rng.integers(2))
        distance = float(rng.uniform(*self.sensor.distance_m)) * s.distance
        actors = []
        for n in range(s.arms):
            mesh = arm_mesh(s.shape or arm_shapes()[shape], "left" if left != bool(n) else "right")
            R = _facing(s, rng)
            joints = np.radians(s.joints_deg) + np.radians(rng.normal(0, [6, 5, 4, 3]))
            start = held_at(mesh, joints, R, np.zeros(3))
            points = mesh.frames(start)[1] @ start.T_camera_shoulder[:3, :3].T + start.T_camera_shoulder[:3, 3]
            middle = 0.5 * points[PALM] + 0.5 * (0.5 * points[ELBOW] + 0.5 * points[12])
            away = np.array([rng.normal(0, 0.015), rng.normal(0, 0.012), 0.0]).clip(-0.03, 0.03)
            if s.arms == 2:
                away[0] -= 0.19
            target = np.array([0.0, 0.0, distance]) + away
            T = start.T_camera_shoulder.copy()
            T[:3, 3] += target - [middle[0], middle[1], points[PALM, 2]]
            start = ArmMeshPose(start.angles, start.joints, T)
            motion = ArmMotion(
                mesh, s.keys, data["postures"], start, target,
                rate=1.0 if s.still else float(rng.uniform(0.85, 1.2)),
                peak_m_s=s.peak_m_s * float(rng.uniform(0.95, 1.1)),
                phase=float(rng.uniform()), amount_deg=2.5, seed=int(rng.integers(1 << 31)),
            )  # fmt: skip
            actors.append(_Actor(mesh, motion, "" if s.shape else shape, 0.7 * n))
        return actors

    def _person(self, rng: np.random.Generator) -> tuple[tuple[Float64, Int64] | None, Float64]:
        """The body's mesh relative to the shoulder, and its displacement (3,) [m]."""
        if not self.settings.person:
            return None, np.zeros(3)
        before_torso = self.settings.before_torso_m
        vertices, triangles = body_mesh(self.settings.arms if before_torso is None else 2)
        size = float(rng.uniform(0.92, 1.06))
        vertices = vertices * size
        if before_torso is None:
            return (vertices, triangles), np.zeros(3)
        gap = float(rng.uniform(*before_torso))
        motion = self._actors[0].motion
        deepest, shoulder = -math.inf, motion.start.T_camera_shoulder[:3, 3]
        for at_s in np.linspace(0.0, motion.period_s, 40):
            pose = motion.at(float(at_s)).pose
            T = pose.T_camera_shoulder
            z = (motion.mesh.frames(pose)[1] @ T[2, :3] + T[2, 3])[: ELBOW + 1].max()
            deepest = max(deepest, float(z - T[2, 3] + shoulder[2]))
        chest = (np.abs(vertices[:, 1] - 0.25) < 0.2) & (np.abs(vertices[:, 0] - 0.18) < 0.12)
        front = float(vertices[chest, 2].min())
        return (vertices, triangles), np.array([-0.04, 0.0, deepest + 0.03 + gap - front - shoulder[2]])


def _truth(
    actor: _Actor, pose: ArmMeshPose, gesture: str, *, seen_px: Float64, parts: UInt8, first: int, lens: Float64
) -> ArmTruth:
    """Ground truth of an arm with projected vertices ``seen_px`` and labels from ``first`` on."""
    mesh, k = actor.mesh, _kernels()
    points = mesh.points(pose)
    px = project(points[: len(ARM_POINTS)], lens)
    height, width = parts.shape
    at = np.rint(np.nan_to_num(px, nan=-1e6)).astype(np.int64)
    inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    counts = np.bincount(parts.ravel(), minlength=first + len(PARTS))[first : first + len(PARTS)]
    seen, occluded, tip_px = np.zeros(len(ARM_POINTS), np.bool_), np.zeros(5, np.bool_), np.zeros((5, 2), np.int64)
    for i in range(len(ARM_POINTS)):
        if inside[i] and i not in TIPS:
            seen[i] = int(parts[at[i, 1], at[i, 0]]) - first in _ENDS[i]
    for digit, tip in enumerate(TIPS):
        there = int(counts[FIRST_TIP + digit])
        patch = mesh.parts == FIRST_TIP + digit
        alone = int(k.count_alone(seen_px, mesh.triangles, patch, parts))
        tip_px[digit] = there, alone
        seen[tip] = there >= SEEN_PX or (there > 0 and there >= SEEN_SHARE * alone)
        if seen[tip] and np.isfinite(px[tip]).all():
            others = mesh.palm_parts & (mesh.digit_of != digit)
            occluded[digit] = k.covered(seen_px, mesh.triangles, others, px[tip, 0], px[tip, 1])
    return ArmTruth(
        mesh.handedness == "left", points[: len(ARM_POINTS)], points[SHOULDER], pose.angles.copy(),
        mesh.T_camera_palm(pose), seen, occluded, tip_px, gesture, actor.shape,
    )  # fmt: skip


def _facing(s: DepthSceneSettings, rng: np.random.Generator) -> Float64:
    """Draw a random ``R_camera_palm`` within the settings."""
    sign = 1.0 if rng.integers(2) else -1.0
    roll, pitch, yaw = rng.uniform(*s.roll_deg), rng.uniform(*s.pitch_deg), rng.uniform(-18, 18)
    if s.view == "side":
        yaw = sign * rng.uniform(55, 78)
    if s.view == "tips":
        pitch = rng.uniform(48, 62)
    R = rotation_about_x(math.radians(pitch)) @ rotation_about_y(math.radians(yaw)) @ VIEWS.get(s.view, VIEWS["palm"])
    c, n = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    return np.asarray(np.array([[c, -n, 0], [n, c, 0], [0, 0, 1]]) @ R)


def _ends() -> list[set[int]]:
    ends: list[set[int]] = [{WRIST_END, PALM_BONE}]
    for digit in range(5):
        bone = FIRST_DIGIT + 3 * digit
        ends += [{PALM_BONE, bone}, {bone, bone + 1}, {bone + 1, bone + 2}, {bone + 2, FIRST_TIP + digit}]
    return [*ends, {PALM_BONE, FIRST_DIGIT}, {ELBOW_END, UPPER_ARM}]


_ENDS: Final = _ends()


def shot_frame(shot: DepthShot, sensor: str, *, sequence: int = 0, node_id: int = 0) -> DepthFrame:
    """Return a simulated depth image as a frame, whose capture time is the image's time in the scene [ns].

    Args:
        shot: the image.
        sensor: name of the sensor.
        sequence, node_id: number of the frame, and id of the node.
    """
    return frame_of(
        sensor, shot.depth, unit_m=shot.unit_m, lens=shot.lens, time_ns=round(1e9 * shot.at_s), node_id=node_id,
        sequence=sequence,
    )  # fmt: skip


def depth_scene_names() -> tuple[str, ...]:
    """Return the names that `load_depth_scene` knows."""
    return tuple(_data()["scenes"])


def depth_sensor_names() -> tuple[str, ...]:
    """Return the names of cameras that `depth_sensor` knows."""
    return tuple(_data()["sensors"])


def depth_sensor(name: str) -> Sensor:
    """Look up a camera by name.

    Raises:
        SettingsError: unknown sensor; lists the known ones.
    """
    known: dict[str, Sensor] = _data()["sensors"]
    if name not in known:
        raise SettingsError(f"unknown sensor {name!r}; known: {one_of(name, known)}")
    return known[name]


def load_depth_scene(name: str, *, seed: int = 0, sensor: str = "kinect") -> DepthScene:
    """Load a scene seen by a camera.

    Args:
        name: one of `depth_scene_names`.
        seed: variant of the scene; below 100 for tuning, from 100 on for scoring.
        sensor: kinect, sr305, tof, or exact, which has no noise.

    Raises:
        SettingsError: unknown scene or sensor; lists the known ones.
    """
    data = _data()
    if name not in data["scenes"]:
        raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, data['scenes'])}")
    check(0 <= seed < 1 << 63, "seed", seed, "0 or more")
    return DepthScene(name, data["scenes"][name], depth_sensor(sensor), seed)


@cache
def _data() -> dict[str, Any]:
    data = own_toml("mocapella.sources.simulate", "data", "depth_scenes.toml")
    scenes = {}
    for name, scene in data["scenes"].items():
        same = scene.pop("same_keys_as", None)
        if same:
            scene["keys"] = data["scenes"][same]["keys"]
        scenes[name] = convert(scene, DepthSceneSettings, what="scene")
    return {
        "scenes": scenes,
        "postures": convert(data["postures"], dict[str, Posture], what="posture"),
        "sensors": convert(data["sensors"], dict[str, Sensor], what="sensor"),
    }


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import depth_scene_kernels

    return depth_scene_kernels
