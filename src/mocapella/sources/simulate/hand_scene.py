"""Rendered images of a hand with painted fingertips, seen by several cameras, with complete ground truth.

    scene = load_hand_scene("wide", seed=1)
    shot = scene.at("left", 2.5)
    shot.image, shot.centres_px, shot.markers_world

The hand consists of lit capsules in front of the cluttered wall of `marker_scene`, under its changing light. The image
has an exposure time and, optionally, a rolling shutter. Four rays per pixel, at four instants of the exposure, smooth
edges and motion. `camera_image` simulates a cheap camera.

A painted fingertip is a capsule around the tip, so its centre is the landmark; a marker on the palm is a ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.lens import project, undistort
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import DIGITS, TIPS, HandPose, hand_model
from mocapella.model.observations import check_sensor_name
from mocapella.settings import check, parse
from mocapella.sources.simulate.camera_image import CameraImageSettings, camera_image
from mocapella.sources.simulate.hand_motion import HandMotion, HandMotionSettings, landmarks_of
from mocapella.sources.simulate.marker_scene import Paint, wall

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

_STEP_S: Final = 1e-4
_BONE_RADII_M: Final = ((0.0135, 0.0108, 0.0095), *[(0.0095, 0.0085, 0.0076)] * 4)
"""Radii of the three bones of thumb and fingers, for a hand of the reference length [m]."""
_PALM_RADIUS_M: Final = 0.0125
_TIP_HALF_M: Final = 0.004
_BALL_M: Final = 0.009
BASE_MARKERS: Final = ("base", "index base", "little base")
"""Names of the markers on the palm: near the wrist, and below the knuckles of index and little finger."""


@dataclass(frozen=True)
class SimulatedCamera:
    """A simulated colour camera.

    Attributes:
        name: name of the sensor.
        position_m: position of the camera in the world, y up [m].
        looks_at_m: point on the optical axis, in the world [m].
        view_deg: horizontal field of view [deg].
        size_px: (width, height) of the image.
        distortion: distortion coefficients k1 k2 p1 p2 k3.
        fps: frame rate [Hz].
        phase_s: time of the first frame, on the scene's clock [s].
        readout_s: readout time from the first row to the last; 0 is a global shutter [s].
        exposure_s: exposure time of a row [s].
        image: parameters of the simulated image sensor.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    position_m: tuple[float, float, float]
    looks_at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    view_deg: float = 62.2
    size_px: tuple[int, int] = (640, 480)
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    fps: float = 60.0
    phase_s: float = 0.0
    readout_s: float = 0.0
    exposure_s: float = 0.006
    image: CameraImageSettings = field(default_factory=CameraImageSettings)

    def __post_init__(self) -> None:
        check_sensor_name(self.name)
        width, height = self.size_px
        even = width % 2 == 0 and height % 2 == 0
        check(even and 32 <= width <= 8192 and 32 <= height <= 8192, "size_px", self.size_px, "even, 32 to 8192")
        apart = math.dist(self.position_m, self.looks_at_m)
        check(apart > 0.01, "looks_at_m", self.looks_at_m, "at least 1 cm from position_m")
        check(5 <= self.view_deg <= 150, "view_deg", self.view_deg, "from 5 to 150")
        check(1 <= self.fps <= 1000, "fps", self.fps, "from 1 to 1000 Hz")
        check(0 <= self.phase_s <= 1, "phase_s", self.phase_s, "from 0 to 1 s")
        check(0 <= self.readout_s <= 1, "readout_s", self.readout_s, "from 0 to 1 s")
        check(0 <= self.exposure_s <= 1, "exposure_s", self.exposure_s, "from 0 to 1 s")

    @property
    def lens(self) -> Float64:
        """(9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3, as in `mocapella.geometry.lens`."""
        width, height = self.size_px
        focal = 0.5 * width / math.tan(0.5 * math.radians(self.view_deg))
        return np.array([focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), *self.distortion])

    @property
    def T_camera_world(self) -> Float64:  # noqa: N802 - the field's notation
        """(4, 4) from the world to the camera frame (x right, y down, z out of the lens), with the image upright."""
        forward = np.subtract(self.looks_at_m, self.position_m)
        z = forward / np.linalg.norm(forward)
        up = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.99 else np.array([0.0, 0.0, -1.0])
        x = np.cross(z, up)
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        return rigid(R, -R @ np.array(self.position_m))

    @property
    def placed(self) -> PlacedCamera:
        """The camera as part of a rig, with exact calibration."""
        camera = Camera(self.name, self.size_px, self.lens, self.readout_s)
        return PlacedCamera(camera, self.T_camera_world, np.zeros((6, 6)))


@dataclass(frozen=True)
class HandSceneSettings:
    """Description of a scene: a hand with painted markers, and colour cameras that see it; see `HandScene`.

    Attributes:
        cameras: the cameras.
        paints: paints of thumb to little finger, and of the base markers, with the markers' names.
        motion: motion of the hand.
        handedness: left or right.
        hand_length_m: length of the hand from the wrist to the tip of the middle finger [m].
        skin: reflectance of the skin in red, green, blue, 0 to 1.
        skin_gloss: gloss of the skin.
        clutter: colourfulness of the wall, 0 to 1.
        brightness_change: greatest factor by which the light's strength rises and falls.
        colour_change: greatest relative change of the light's red and blue.
        shading: fraction of the light that is directed, 0 to 1.
        light_hz: frequency of the light's changes [Hz].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    cameras: tuple[SimulatedCamera, ...]
    paints: tuple[Paint, ...]
    motion: HandMotionSettings = field(default_factory=HandMotionSettings)
    handedness: str = "right"
    hand_length_m: float = 0.189
    skin: tuple[float, float, float] = (0.52, 0.31, 0.22)
    skin_gloss: float = 0.12
    clutter: float = 0.5
    brightness_change: float = 1.3
    colour_change: float = 0.06
    shading: float = 0.5
    light_hz: float = 0.2

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        check(
            len(names) >= 1 and len(set(names)) == len(names), "cameras", names, "at least one, each with its own name"
        )
        wanted = "six to eight: five fingertips and one to three of the hand's base"
        check(6 <= len(self.paints) <= 5 + len(BASE_MARKERS), "paints", len(self.paints), wanted)
        paints = [paint.name for paint in self.paints]
        check(len(set(paints)) == len(paints), "paints", paints, "each with its own name")
        check(self.handedness in ("left", "right"), "handedness", self.handedness, "left or right")
        check(0 <= self.clutter <= 1, "clutter", self.clutter, "from 0 to 1")
        check(1 <= self.brightness_change <= 10, "brightness_change", self.brightness_change, "from 1 to 10")
        check(0 <= self.colour_change < 0.9, "colour_change", self.colour_change, "from 0 to 0.9")
        check(0 <= self.shading <= 1, "shading", self.shading, "from 0 to 1")
        check(0 <= self.light_hz <= 10, "light_hz", self.light_hz, "from 0 to 10 Hz")


@dataclass(frozen=True, eq=False)
class HandShot:
    """A rendered image of a hand with painted markers, and its ground truth.

    Attributes:
        camera: name of the camera.
        at_s: the middle of the first row's exposure, on the scene's clock [s].
        image: (height, width, 3) uint8 BGR.
        centres_px: (markers, 2) x, y of the markers' centres at the middle of the exposure of their row [px]; NaN
            behind the camera.
        visible: (markers,) fraction of the marker's projected area in the image that is not occluded; 0 if its centre
            is outside the image.
        markers_world: (markers, 3) centres at ``at_s``, world [m].
        pose: pose of the hand at ``at_s``.
        landmarks: (21, 3) at ``at_s``, world [m].
    """

    camera: str
    at_s: float
    image: UInt8
    centres_px: Float64
    visible: Float64
    markers_world: Float64
    pose: HandPose
    landmarks: Float64


class HandScene:
    """A scene that can be rendered for each camera at any time.

    Args:
        settings: description of the scene.
        seed: random seed of motion, walls, light and noise; the same scene, seed, camera and time give the same image.

    Attributes:
        settings, seed: as given.
        model, shape: model of the hand's joints, and the hand's bones.
        motion: motion of the hand.
        cameras: the cameras by name.

    Raises:
        SettingsError: the hand's size is not human.
    """

    def __init__(self, settings: HandSceneSettings, seed: int = 0) -> None:
        self.settings, self.seed = settings, seed
        self.model = hand_model()
        self.shape = self.model.shape(settings.handedness, hand_length_m=settings.hand_length_m)  # type: ignore[arg-type]  # checked to be left or right
        self.motion = HandMotion(self.model, self.shape, settings.motion, seed)
        self.cameras = {camera.name: camera for camera in settings.cameras}
        rng = np.random.default_rng([seed, 1])
        self._phases, self._rates = rng.uniform(0, 2 * math.pi, 5), rng.uniform(0.8, 1.25, 5)
        self._walls = {c.name: wall(c.size_px, settings.clutter, np.random.default_rng([seed, 3, i]))
                       for i, c in enumerate(settings.cameras)}  # fmt: skip
        self._rays = {camera.name: _rays(camera) for camera in settings.cameras}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers, in the order of a shot's arrays: thumb to little finger, then the base."""
        return tuple(paint.name for paint in self.settings.paints)

    @property
    def rig(self) -> CameraRig:
        """The cameras, with exact calibration."""
        return CameraRig({camera.name: camera.placed for camera in self.settings.cameras})

    def at(self, camera: str, at_s: float, taken_by: SimulatedCamera | None = None) -> HandShot:
        """Render a camera's image whose first row's exposure is centred at ``at_s``, on the scene's clock [s].

        Args:
            camera: name of the camera.
            at_s: time on the scene's clock [s].
            taken_by: the camera with other exposure times or image settings; None for the scene's own. Its place, lens
                and image size are those of the scene's camera.

        Raises:
            SettingsError: unknown camera; lists the known ones.
        """
        if camera not in self.cameras:
            raise SettingsError(f"unknown camera {camera!r}; known: {one_of(camera, self.cameras)}")
        s, c = self.settings, taken_by or self.cameras[camera]
        width, height = c.size_px
        pose, (parts, landmarks) = self.motion.at(at_s), self._parts(at_s)
        rates = (self._parts(at_s + _STEP_S)[0][:, :6] - self._parts(at_s - _STEP_S)[0][:, :6]) / (2 * _STEP_S)
        T = c.T_camera_world
        parts[:, :6] = apply(T, parts[:, :6].reshape(-1, 3)).reshape(-1, 6)
        rates = (rates.reshape(-1, 3) @ T[:3, :3].T).reshape(-1, 6)
        strength, colour, direction = self.light(at_s)
        linear = np.empty((height, width, 3), np.float32)
        seen, whole = np.zeros(len(s.paints)), np.zeros(len(s.paints))
        lens = c.lens
        k = _kernels()
        shutter = k.HandCamera(lens[:4].copy(), float(c.exposure_s), float(c.readout_s))
        lighting = k.HandLight(strength * colour, T[:3, :3] @ direction, float(s.shading))
        k.photograph(self._walls[camera], self._rays[camera], parts, rates, shutter, lighting, linear, seen, whole)
        of_marker = parts[:, MARKER].astype(int)
        rows = [int(np.flatnonzero(of_marker == k)[0]) for k in range(len(s.paints))]
        centre = 0.5 * (parts[rows, :3] + parts[rows, 3:6])
        moving = 0.5 * (rates[rows, :3] + rates[rows, 3:])
        late = np.zeros((len(rows), 1))
        for _ in range(4):  # row and time depend on each other: iterate
            px = project(centre + late * moving, lens)
            late = np.nan_to_num(px[:, 1:]) * c.readout_s / height
        inside = (centre[:, 2] > 0.02) & (px >= -0.5).all(axis=1) & (px <= np.array(c.size_px) - 0.5).all(axis=1)
        visible = np.where(inside, seen / np.maximum(whole, 1.0), 0.0)
        rng = np.random.default_rng([self.seed, 2, list(self.cameras).index(camera), round(1e6 * at_s) % (1 << 62)])
        world = apply(np.asarray(np.linalg.inv(T), np.float64), centre)
        return HandShot(camera, at_s, camera_image(linear, c.image, rng), px, visible, world, pose, landmarks)

    def light(self, at_s: float) -> tuple[float, Float64, Float64]:
        """Return the light at a time of the scene [s]: its strength, colour (3,) as red, green, blue, and direction.

        The direction is the unit vector (3,) towards the light, in the world.
        """
        s = self.settings
        swing = np.sin(2 * math.pi * s.light_hz * self._rates * at_s + self._phases)
        colour = np.array([1 + s.colour_change * swing[1], 1.0, 1 - s.colour_change * swing[1]])
        towards = np.array([0.7 * swing[2], 0.8 + 0.4 * swing[3], 1.0])
        return float(s.brightness_change ** swing[0]), colour, towards / np.linalg.norm(towards)

    def _parts(self, at_s: float) -> tuple[Float64, Float64]:
        """Capsules (parts, 13) of the hand, world, and its landmarks (21, 3)."""
        s, pose = self.settings, self.motion.at(at_s)
        L = landmarks_of(self.model, self.shape, pose)
        big = s.hand_length_m / self.model.hand_length_m
        R, wrist = pose.T_world_palm[:3, :3], pose.T_world_palm[:3, 3]
        skin = [*s.skin, s.skin_gloss, 12.0, -1.0]
        parts: list[list[float]] = []

        def add(a: Float64, b: Float64, radius: float, look: list[float]) -> None:
            parts.append([*a, *b, big * radius, *look])

        def painted(k: int) -> list[float]:
            paint = s.paints[k]
            return [*paint.albedo, paint.gloss, 30.0, float(k)]

        for digit, radii in enumerate(_BONE_RADII_M):
            joints = L[1 + 4 * digit : 5 + 4 * digit]
            for bone, radius in enumerate(radii):
                add(joints[bone], joints[bone + 1], radius, skin)
            along = joints[3] - joints[2]
            along *= big * _TIP_HALF_M / np.linalg.norm(along)
            add(joints[3] - along, joints[3] + along, radii[2] + 0.0008, painted(digit))
        for a, b in ((0, 5), (0, 9), (0, 13), (0, 17), (5, 9), (9, 13), (13, 17), (1, 5)):
            add(L[a], L[b], _PALM_RADIUS_M, skin)
        add(L[0], L[1], 0.014, skin)
        for a in (5, 9, 13):  # between the metacarpals
            add(0.3 * L[0] + 0.7 * L[a], 0.3 * L[0] + 0.7 * L[a + 4], _PALM_RADIUS_M, skin)
        add(wrist - R @ [0.0, 0.0, 0.28], wrist - R @ [0.0, 0.0, 0.01], 0.024, skin)
        front = R @ [0.0, -big * _PALM_RADIUS_M, 0.0]
        places = (0.75 * L[0] + 0.25 * L[9], 0.15 * L[0] + 0.85 * L[5], 0.15 * L[0] + 0.85 * L[17])
        for k, place in enumerate(places[: len(s.paints) - len(DIGITS)]):
            add(place + front, place + front, _BALL_M, painted(len(DIGITS) + k))
        return np.array(parts), L


MARKER: Final = 12


def base_places(scene: HandScene) -> Float64:
    """Return the positions (base markers, 3) of a scene's markers on the palm, in the palm's frame [m].

    Those of a left hand are mirrored to a right hand's frame.
    """
    shot_pose = scene.motion.at(0.0)
    parts, _ = scene._parts(0.0)
    rows = [int(np.flatnonzero(parts[:, MARKER] == k)[0]) for k in range(len(TIPS), len(scene.settings.paints))]
    places = (parts[rows, :3] - shot_pose.T_world_palm[:3, 3]) @ shot_pose.T_world_palm[:3, :3]
    return np.asarray(scene.shape.mirror * places)


def _rays(camera: SimulatedCamera) -> NDArray[np.float32]:
    """Directions (height, width, 4, 2) of each pixel's rays."""
    width, height = camera.size_px
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    offsets = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
    pixels = np.stack([x, y], axis=-1)[:, :, None, :] + offsets
    return undistort(pixels, camera.lens).astype(np.float32)


def hand_scene_names() -> tuple[str, ...]:
    """Return the names that `load_hand_scene` knows."""
    return tuple(_data()["scenes"])


def hand_scene_settings(name: str) -> HandSceneSettings:
    """Look up a scene's settings by name; change them with `dataclasses.replace`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    data = _data()
    if name not in data["scenes"]:
        raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, data['scenes'])}")
    scene = {**data["common"], **data["scenes"][name]}
    rig = scene.pop("rig")
    if rig not in data["rigs"]:
        raise SettingsError(f"scene {name}: unknown rig {rig!r}; known: {one_of(rig, data['rigs'])}")
    every_camera = scene.pop("every_camera", {})
    scene["cameras"] = [{**camera, **every_camera} for camera in data["rigs"][rig]]
    return parse(HandSceneSettings, scene, where=f"scene {name}")


def load_hand_scene(name: str, *, seed: int = 0) -> HandScene:
    """Load a scene by name, with a random seed as in `HandScene`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    return HandScene(hand_scene_settings(name), seed)


@cache
def _data() -> dict[str, Any]:
    return own_toml("mocapella.sources.simulate", "data", "hand_scenes.toml")


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import hand_scene_kernels

    return hand_scene_kernels
