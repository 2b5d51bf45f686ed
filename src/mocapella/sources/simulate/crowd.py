"""Scenes of several people before several cameras that detect keypoints, with ground truth.

    scene = crowd_scene("six-walk", seed=1)
    scene.rig
    for item in scene.frames():
        item.frame, item.at_ns, item.positions

The scenes are in ``data/crowds.toml``; docs/simulation.md describes them.
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y, rotation_about_z
from mocapella.model.bvh import read_bvh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.settings import check, parse
from mocapella.sources.simulate.body import BODY, bone_lengths
from mocapella.sources.simulate.gait import animate
from mocapella.sources.simulate.keypoint_camera import (
    PHANTOM,
    KeypointCameraSettings,
    SeenRoom,
    SimulatedKeypointCamera,
    SimulatedKeypoints,
)
from mocapella.sources.simulate.motion import POSE_HZ, Motion, normalised, together
from mocapella.sources.simulate.occlusion import Box, Cylinder, obstacles
from mocapella.sources.simulate.retarget import bvh_motion
from mocapella.sources.simulate.route import STEP_M, STEP_S
from mocapella.sources.simulate.scenarios import WRITTEN, plan, written_route

Float64 = NDArray[np.float64]

_BONE_SD: Final = 0.035
"""Standard deviation of a bone's length between people of one stature; it is ours [ratio]."""
_TRIES: Final = 100
_APART: Final = 0.45
"""Distance of two walkers' roots that their routes are chosen to keep, if they can [m]."""
CLOCK_OFFSET_S: Final = 500.0
"""Largest offset of a camera's clock from the common one [s]."""


@dataclass(frozen=True)
class CrowdPerson:
    """A person of a crowd.

    Attributes:
        start: initial position (world x, z) [m].
        scenario: as of `mocapella.sources.simulate.room.PersonSettings`; ``wander`` walks between random points.
        target: as of `PersonSettings` (world x, z); None for other scenarios [m].
        first: whether this person moves first, if two take turns.
        route: steps of the scenario ``route``.
        stature: height; larger: taller [m].
        tempo: factor of the speed of all movements; larger: quicker [ratio].
        lifeless: whether the body neither breathes nor sways, as a poster.
        seen_by: names of the only cameras that see this body, which is then not to be tracked; empty for all.
        bvh: path of a BVH file with the motion; None for none.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    start: tuple[float, float]
    scenario: str = "wander"
    target: tuple[float, float] | None = None
    first: bool = True
    route: tuple[str, ...] = ()
    stature: float = 1.75
    tempo: float = 1.0
    lifeless: bool = False
    seen_by: tuple[str, ...] = ()
    bvh: str | None = None

    def __post_init__(self) -> None:
        check(0.5 <= self.stature <= 2.5, "stature", self.stature, "from 0.5 to 2.5 m")
        check(0.2 <= self.tempo <= 3, "tempo", self.tempo, "from 0.2 to 3")


@dataclass(frozen=True)
class CameraRing:
    """Cameras on an arc around the room, which look at one point.

    Attributes:
        count: number of cameras; larger: more [count].
        centre: the point that they look at, world x, y, z [m].
        radius: horizontal distance of the cameras from it; larger: farther [m].
        height: height of the cameras; larger: higher [m].
        first_deg: direction of the first camera from the centre, from z towards x [deg].
        arc_deg: angle between the first camera and the end of the arc; 360 for a whole ring [deg].
        size_px: (width, height) of the images [px].
        focal_px: focal length; larger: narrower [px].
        distortion: k1 k2 p1 p2 k3 of the lenses.
        readout_s: rolling-shutter time; larger: slower [s].
        roll_deg: standard deviation of the cameras' rotation about their axis; larger: less level [deg].
        centre_sd: standard deviation of the principal points from the middle of the image, along each axis, as a share
            of the longer side; larger: less centred [ratio].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    count: int = 4
    centre: tuple[float, float, float] = (0.0, 1.0, 0.0)
    radius: float = 4.5
    height: float = 2.4
    first_deg: float = 20.0
    arc_deg: float = 360.0
    size_px: tuple[int, int] = (1280, 720)
    focal_px: float = 800.0
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.05, 0.0005, -0.0005, 0.0)
    readout_s: float = 0.0
    roll_deg: float = 1.0
    centre_sd: float = 0.0

    def __post_init__(self) -> None:
        check(1 <= self.count <= 32, "count", self.count, "from 1 to 32")
        check(0.5 <= self.radius <= 100, "radius", self.radius, "from 0.5 to 100 m")
        check(all(16 <= side <= 8000 for side in self.size_px), "size_px", self.size_px, "16 to 8000 px each")
        check(10 <= self.focal_px <= 1e5, "focal_px", self.focal_px, "from 10 to 100,000 px")
        check(0 <= self.readout_s <= 0.1, "readout_s", self.readout_s, "from 0 to 0.1 s")
        check(0 <= self.centre_sd <= 0.2, "centre_sd", self.centre_sd, "from 0 to 0.2")


@dataclass(frozen=True)
class Mirror:
    """A mirror that one camera sees: a vertical plane.

    Attributes:
        camera: name of the camera.
        point: a point of the plane (world x, z) [m].
        normal_deg: direction of its normal, from z towards x [deg].
    """

    camera: str
    point: tuple[float, float]
    normal_deg: float


@dataclass(frozen=True)
class CrowdSettings:
    """Description of a scene; `build_crowd` makes it.

    Attributes:
        name: name of the scene.
        summary: its content in one line.
        seconds: duration; larger: longer [s].
        people: the people in the room.
        ring: the cameras.
        camera: timing and detector of all cameras.
        free_running: whether the cameras have phases and clocks of their own.
        out_of_step: largest number of frames by which the capture of a camera is earlier or later than that of the
            last camera, although the frames have one time; larger: worse synchronised [count].
        boxes, cylinders: what hides people.
        mirrors: mirrors that single cameras see.
        area: half width and half depth of the floor on which people wander [m].
        rig_error_px: standard deviation of the error in the middle of the image that the tracker's rig has, half by its
            directions and half by its positions; larger: worse calibrated [px].
        seed: random seed.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    summary: str
    seconds: float
    people: tuple[CrowdPerson, ...]
    ring: CameraRing = CameraRing()
    camera: KeypointCameraSettings = field(default_factory=KeypointCameraSettings)
    free_running: bool = False
    out_of_step: int = 0
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    mirrors: tuple[Mirror, ...] = ()
    area: tuple[float, float] = (2.0, 2.0)
    rig_error_px: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check(0 < self.seconds <= 3600, "seconds", self.seconds, "above 0 and at most 3600 s")
        check(len(self.people) >= 1, "people", self.people, "one or more")
        check(0 <= self.out_of_step <= 10, "out_of_step", self.out_of_step, "from 0 to 10")
        check(0 <= self.rig_error_px <= 100, "rig_error_px", self.rig_error_px, "from 0 to 100 px")
        check(0 <= self.seed < 2**63, "seed", self.seed, "from 0 to 2**63 − 1")


@dataclass(frozen=True, eq=False)
class CrowdScene:
    """A scene that is ready to be seen; made by `build_crowd`.

    Attributes:
        settings: as given.
        rig: the cameras with their true poses.
        calibrated: the rig as a tracker gets it, with the errors of its calibration.
        room: the room in their view.
        cameras: the simulated cameras, in the order of the rig.
    """

    settings: CrowdSettings
    rig: CameraRig
    calibrated: CameraRig
    room: SeenRoom
    cameras: tuple[SimulatedKeypointCamera, ...]

    def frames(self) -> Iterator[SimulatedKeypoints]:
        """Yield the frames of all cameras in the order of their arrival."""
        streams = [((item.due_ns, c, item) for item in camera.frames()) for c, camera in enumerate(self.cameras)]
        for _, _, item in heapq.merge(*streams, key=lambda row: row[:2]):
            yield item


def crowd_names() -> tuple[str, ...]:
    """Return the names of all scenes."""
    return tuple(_data()["scenes"])


def crowd_summaries() -> dict[str, str]:
    """Return what each scene shows, by its name."""
    return {name: scene["summary"] for name, scene in _data()["scenes"].items()}


def crowd_settings(name: str) -> CrowdSettings:
    """Return the settings of a scene, to change and build it.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    if name not in _data()["scenes"]:
        raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, crowd_names())}")
    return parse(CrowdSettings, {"name": name, **_data()["scenes"][name]}, where=f"scene {name}")


def crowd_scene(
    name: str, *, seed: int = 0, cameras: int | None = None, topology: str | None = None, bvh: str | Path | None = None
) -> CrowdScene:
    """Build a named scene.

    Args:
        name: one of `crowd_names`.
        seed: equal seeds give equal frames to the bit.
        cameras: number of cameras; None for the scene's.
        topology: name of the topology of the frames; None for the scene's.
        bvh: a BVH file whose motion the first person has; None for none.

    Raises:
        SettingsError: an unknown scene or topology, or a number out of range.
        InputError: the BVH file cannot be used.
    """
    settings = dataclasses.replace(crowd_settings(name), seed=seed)
    if cameras is not None:
        settings = dataclasses.replace(settings, ring=dataclasses.replace(settings.ring, count=cameras))
    if topology is not None:
        settings = dataclasses.replace(settings, camera=dataclasses.replace(settings.camera, topology=topology))
    if bvh is not None:
        first = dataclasses.replace(settings.people[0], bvh=str(bvh))
        settings = dataclasses.replace(settings, people=(first, *settings.people[1:]))
    return build_crowd(settings)


def build_crowd(settings: CrowdSettings) -> CrowdScene:
    """Plan and animate all people, and place the cameras.

    Raises:
        SettingsError: an unknown scenario, topology, detector or camera.
        InputError: a BVH file cannot be used.
    """
    rig = ring_rig(settings.ring, settings.seed)
    motions: list[Motion] = []
    for i, person in enumerate(settings.people):
        motions.append(_motion(person, settings, i, motions))
    names = list(rig.cameras)
    for name in [*(n for p in settings.people for n in p.seen_by), *(m.camera for m in settings.mirrors)]:
        check(name in names, "camera", name, f"one of {', '.join(names)}")
    real = [not person.seen_by for person in settings.people]
    numbers = np.where(real, np.cumsum(real) - 1, PHANTOM).astype(np.int64)
    mirrors: dict[str, tuple[tuple[Float64, Float64], ...]] = {}
    for mirror in settings.mirrors:
        turn = math.radians(mirror.normal_deg)
        plane = np.array([mirror.point[0], 0.0, mirror.point[1]]), np.array([math.sin(turn), 0.0, math.cos(turn)])
        mirrors[mirror.camera] = (*mirrors.get(mirror.camera, ()), plane)
    blocks = obstacles(settings.boxes, settings.cylinders)
    poses = max(math.ceil(settings.seconds * POSE_HZ) + 10, *(len(motion) for motion in motions))
    room = SeenRoom(
        together([_held(motion, poses) for motion in motions]),
        numbers,
        tuple(p.seen_by for p in settings.people),
        blocks,
        mirrors,
    )
    cameras = tuple(
        SimulatedKeypointCamera(
            room, placed, _timing(settings, c), seed=settings.seed, index=c, duration_s=settings.seconds
        )
        for c, placed in enumerate(rig.cameras.values())
    )
    return CrowdScene(settings, rig, _miscalibrated(rig, settings), room, cameras)


def ring_rig(ring: CameraRing, seed: int = 0) -> CameraRig:
    """Place cameras on an arc; names are ``c1``, ``c2``, …. The world is y up, as the simulated rooms."""
    rng, of_lenses = np.random.default_rng([seed, 3]), np.random.default_rng([seed, 11])
    centre, whole = np.array(ring.centre), ring.arc_deg >= 360
    cameras = {}
    for c in range(ring.count):
        share = c / ring.count if whole else c / max(ring.count - 1, 1)
        angle = math.radians(ring.first_deg + share * ring.arc_deg)
        eye = np.array(
            [centre[0] + ring.radius * math.sin(angle), ring.height, centre[2] + ring.radius * math.cos(angle)]
        )
        ahead = normalised(centre - eye)
        right = normalised(np.cross(ahead, np.array([0.0, 1.0, 0.0])))
        R = np.stack([right, np.cross(ahead, right), ahead])
        R = rotation_about_z(float(rng.normal(0.0, math.radians(ring.roll_deg)))) @ R
        middle = np.array(ring.size_px) / 2 - 0.5 + of_lenses.normal(0.0, ring.centre_sd * max(ring.size_px), 2)
        lens = np.array([ring.focal_px, ring.focal_px, *middle])
        name = f"c{c + 1}"
        camera = Camera(name, ring.size_px, np.concatenate([lens, ring.distortion]), ring.readout_s)
        cameras[name] = PlacedCamera(camera, rigid(R, -R @ eye), np.full((6, 6), np.nan))
    return CameraRig(cameras)


def _miscalibrated(rig: CameraRig, settings: CrowdSettings) -> CameraRig:
    """The rig with errors of directions and positions, which move the middle of each image by `rig_error_px`.

    Errors that all cameras share move the world, which is no error: the rig's world is turned back to the true one.
    """
    if settings.rig_error_px == 0.0:
        return rig
    cameras, half = {}, settings.rig_error_px / settings.ring.focal_px / math.sqrt(2.0)
    for c, (name, placed) in enumerate(rig.cameras.items()):
        rng = np.random.default_rng([settings.seed, 7, c])
        turn, shift = rng.normal(0.0, half, 3), rng.normal(0.0, half * settings.ring.radius, 3)
        R = rotation_about_x(turn[0]) @ rotation_about_y(turn[1]) @ rotation_about_z(turn[2])
        T = rigid(R, shift) @ placed.T_camera_world
        cameras[name] = PlacedCamera(placed.camera, T, placed.covariance)
    middle = np.array(settings.ring.centre)
    points = middle + np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)

    def world(x: Float64) -> Float64:
        R = rotation_about_x(x[0]) @ rotation_about_y(x[1]) @ rotation_about_z(x[2])
        return rigid(R, middle + x[3:] - R @ middle)

    def apart(x: Float64) -> Float64:
        rows = [
            project(apply(cameras[name].T_camera_world @ world(x), points), one.camera.lens)
            - project(apply(one.T_camera_world, points), one.camera.lens)
            for name, one in rig.cameras.items()
        ]
        return np.concatenate(rows).ravel()

    T_rig_world = world(least_squares(apart, np.zeros(6)).x)
    return CameraRig({
        name: PlacedCamera(one.camera, one.T_camera_world @ T_rig_world, one.covariance)
        for name, one in cameras.items()
    })  # fmt: skip


def _timing(settings: CrowdSettings, camera: int) -> KeypointCameraSettings:
    if settings.out_of_step > 0:
        return _out_of_step(settings, camera)
    if not settings.free_running:
        return settings.camera
    rng, own = np.random.default_rng([settings.seed, 4, camera]), settings.camera
    return dataclasses.replace(
        own,
        phase_s=float(rng.uniform(0, 1 / own.hz)),
        clock_offset_s=float(rng.uniform(0, CLOCK_OFFSET_S)),
        clock_drift_ppm=float(rng.normal(0, 30)),
        latency_s=own.latency_s + float(rng.uniform(0, 0.03)),
    )


def _out_of_step(settings: CrowdSettings, camera: int) -> KeypointCameraSettings:
    """The timing of a camera whose frames are some periods early or late, and arrive with the other cameras' frames."""
    rng, own, most = np.random.default_rng([settings.seed, 8, camera]), settings.camera, settings.out_of_step
    last = camera == settings.ring.count - 1
    phase_s = (most if last else int(rng.integers(0, 2 * most + 1))) / own.hz
    latency_s = own.latency_s + 2 * most / own.hz - phase_s
    return dataclasses.replace(own, phase_s=phase_s, known_clock_s=most / own.hz - phase_s, latency_s=latency_s)


def _motion(person: CrowdPerson, settings: CrowdSettings, index: int, others: list[Motion]) -> Motion:
    rng = np.random.default_rng([settings.seed, 5, index])
    lengths = bone_lengths(person.stature) * _proportions(rng)
    if person.bvh is not None:
        return _quickened(
            bvh_motion(read_bvh(person.bvh), person.start, person.stature, rng, file=person.bvh), person.tempo
        )
    if person.scenario == "wander":
        return _wandering(person, settings, lengths, rng, others)
    if person.scenario == WRITTEN:
        route = written_route(person.start, person.route)
    else:
        route = plan(person.scenario, person.start, person.target, first=person.first)
    return _quickened(animate(route.legs, lengths, person.stature, rng, lifeless=person.lifeless), person.tempo)


def _proportions(rng: np.random.Generator) -> Float64:
    """Factors (25,) of the bones' lengths, equal on both sides."""
    factors = 1.0 + np.clip(rng.normal(0.0, _BONE_SD, len(BODY)), -0.1, 0.1)
    mirror = np.array(BODY.mirror)
    return np.asarray(factors[np.minimum(np.arange(len(BODY)), mirror)])


def _wandering(
    person: CrowdPerson, settings: CrowdSettings, lengths: Float64, rng: np.random.Generator, others: list[Motion]
) -> Motion:
    """Walk between random points of the area; of several routes the first that keeps away from the others is taken."""
    best: tuple[float, Motion] | None = None
    for _ in range(_TRIES):
        words, at, seconds = ["stand 0.4"], np.array(person.start), 0.4
        while seconds < settings.seconds * person.tempo:
            to = rng.uniform(-1.0, 1.0, 2) * settings.area
            seconds += float(np.hypot(*(to - at))) / STEP_M * STEP_S + 1.0
            words += [f"go {to[0]:.3f} {to[1]:.3f}"]
            if rng.random() < 0.3:
                words.append("stand 1")
                seconds += 1.0
            at = to
        words.append(f"go {person.start[0]:.3f} {person.start[1]:.3f}")
        route = written_route(person.start, words)
        motion = _quickened(animate(route.legs, lengths, person.stature, rng), person.tempo)
        near = min((_nearest(motion, other) for other in others), default=9.0)
        if best is None or near > best[0]:
            best = near, motion
        if near >= _APART:
            break
    assert best is not None
    return best[1]


def _nearest(a: Motion, b: Motion) -> float:
    """Least horizontal distance of two roots, while both move [m]."""
    n = min(len(a), len(b))
    return float(np.hypot(*(a.root[:n, [0, 2]] - b.root[:n, [0, 2]]).T).min())


def _held(motion: Motion, poses: int) -> Motion:
    """The motion, and then its last pose until it has that many poses: people do not turn in an instant."""
    index = np.minimum(np.arange(poses), len(motion) - 1)
    return Motion(motion.root[index], motion.directions[index], motion.lengths, motion.radii)


def _quickened(motion: Motion, tempo: float) -> Motion:
    """The motion with all movements quicker by a factor."""
    if tempo == 1.0:
        return motion
    at = np.arange(0.0, len(motion) - 1 - 1e-6, tempo)
    index = np.minimum(at.astype(np.int64), len(motion) - 2)
    weight = (at - index)[:, None]
    root = (1 - weight) * motion.root[index] + weight * motion.root[index + 1]
    weight = weight[..., None]
    directions = (1 - weight) * motion.directions[index] + weight * motion.directions[index + 1]
    return Motion(root, normalised(directions), motion.lengths, motion.radii)


@cache
def _data() -> Mapping[str, Any]:
    return own_toml("mocapella.sources.simulate", "data", "crowds.toml")
