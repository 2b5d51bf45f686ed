"""Rendered people in a room, seen by a ring of cameras: images with complete ground truth.

    scene = silhouette_scene("cartwheel", seed=3, cameras=4, outfit="background")
    for k in range(len(scene.times_s)):
        scene.images(k), scene.masks(k), scene.pose(k), scene.landmarks(k)

The seed determines the people, their clothes, the room, its light and the cameras' poses. Images are blue, green, red.
The same scene, seed and frame give the same images to the bit, independent of the order of rendering.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rotation_about_y
from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import Sex
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, posed
from mocapella.model.twist_tree import TreePose
from mocapella.settings import check
from mocapella.sources.simulate.backdrop import Backdrop, BackdropView, Light, darkened, make_backdrop
from mocapella.sources.simulate.body_motion import BodyMotion, body_motion, motion_names, usual_seconds
from mocapella.sources.simulate.body_paint import Covered, Layer, LitBodies, cell_m, covered, make_cast, painted, stand
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.hand_scene import SimulatedCamera
from mocapella.sources.simulate.later_things import LaterThing, seated_things
from mocapella.sources.simulate.outfits import Outfit, dressed, make_outfit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

_INSTANTS: Final = 4
"""Instants of an exposure that are averaged."""
_APART_M: Final = 1.1
"""Distance between several people."""
_BEHIND_M: Final = 0.9
"""Least distance between cameras and walls, where furniture stands."""
_FILLED: Final = 0.94
"""Fraction of the way from the image's centre to its border that the people's extent fills."""
_HEIGHT_M: Final[dict[Sex, tuple[float, float]]] = {"male": (1.77, 0.06), "female": (1.65, 0.055)}
"""Mean and standard deviation of people's heights [m]."""
_DARK_SHARE: Final = 0.06
"""Reflected light of a dark room, relative to other rooms: its walls are like black cloth."""
_TABLE: Final = 1 << 17
SEATED: Final = ("sits", "shifts")
"""Motions of people who sit on chairs that are not in the empty room, with bags and masks."""
DARK: Final = "print"
"""Outfit of seated people unless another is named: dark trousers."""


@dataclass(frozen=True)
class CameraLook:
    """Exposure and noise of the cameras.

    Attributes:
        exposure: signal of white in full light, relative to full scale.
        photons: number of electrons at full scale; fewer give more photon noise.
        read_noise: standard deviation of the read noise, relative to full scale.
        flicker: relative standard deviation of the brightness from image to image.
        drift: greatest relative change of the brightness, in a wave with a period of ten seconds.
        exposure_s: exposure time; 0 gives no motion blur [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    exposure: float = 0.75
    photons: float = 9000.0
    read_noise: float = 0.003
    flicker: float = 0.0
    drift: float = 0.0
    exposure_s: float = 0.0

    def __post_init__(self) -> None:
        check(0.01 <= self.exposure <= 100, "exposure", self.exposure, "from 0.01 to 100")
        check(10 <= self.photons <= 1e9, "photons", self.photons, "from 10 to 1e9")
        check(0 <= self.read_noise <= 0.2, "read_noise", self.read_noise, "from 0 to 0.2")
        check(0 <= self.flicker <= 0.5, "flicker", self.flicker, "from 0 to 0.5")
        check(0 <= self.drift <= 0.9, "drift", self.drift, "from 0 to 0.9")
        check(0 <= self.exposure_s <= 0.1, "exposure_s", self.exposure_s, "from 0 to 0.1 s")


class SilhouetteScene:
    """People, a room and cameras; made by `silhouette_scene`. All arguments are attributes of the same names.

    Args:
        name: name of the motion.
        seed: random seed of noise, flicker, and the folds of the clothes.
        meshes, outfits, motions: mesh, clothes and motion of each person.
        backdrop: the room.
        rig: the cameras, with exact calibration.
        times_s: (frames,) capture times of the images since the motion's start [s].
        look: exposure and noise of the cameras.
        corruption: corruption of the images; None for none.
        things: things that are not in the images of `background`.
    """

    def __init__(
        self, name: str, seed: int, *, meshes: Sequence[RiggedMesh], outfits: Sequence[Outfit],
        motions: Sequence[BodyMotion], backdrop: Backdrop, rig: CameraRig, times_s: Float64, look: CameraLook,
        corruption: Corruption | None, things: Sequence[LaterThing] = (),
    ) -> None:  # fmt: skip
        self.name, self.seed = name, seed
        self.meshes, self.outfits, self.motions = tuple(meshes), tuple(outfits), tuple(motions)
        self.backdrop, self.rig, self.times_s = backdrop, rig, times_s
        self.look, self.corruption, self.things = look, corruption, tuple(things)
        clothes = [
            dressed(mesh, outfit, seed + k) for k, (mesh, outfit) in enumerate(zip(meshes, outfits, strict=True))
        ]
        self._cast = make_cast(
            [*self.meshes, *(thing.mesh for thing in things)], [*clothes, *(thing.clothes for thing in things)]
        )
        self._placed = list(rig.cameras.values())
        phase = np.random.default_rng([seed, 41]).uniform(0, 2 * math.pi)
        flicker = np.random.default_rng([seed, 42]).normal(0, 1, len(times_s))
        self._gains = np.exp(
            look.flicker * flicker + math.log1p(look.drift) * np.sin(0.2 * math.pi * times_s + phase)
        ) * look.exposure  # fmt: skip
        self._tables = _coding(look)
        self._noise = np.random.default_rng([seed, 43]).standard_normal(_TABLE, dtype=np.float32)
        self._staged: tuple[int, LitBodies] | None = None

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def mesh(self) -> RiggedMesh:
        """The first person's body mesh."""
        return self.meshes[0]

    def pose(self, k: int, person: int = 0) -> TreePose:
        """Return a person's pose in the frame of index k."""
        return self.motions[person].pose(self.times_s[k])

    def poses(self, person: int = 0) -> TreePose:
        """Return a person's poses in all frames, with a batch axis (frames,)."""
        return self.motions[person].pose(self.times_s)

    def landmarks(self, k: int, person: int = 0) -> Float64:
        """Return a person's landmarks (landmarks, 3) in the frame of index k, in the mesh's order, world [m]."""
        return landmarks_at(self.meshes[person], self.pose(k, person))

    def images(self, k: int) -> list[UInt8]:
        """Return images (height, width, 3) uint8 BGR of all cameras in the frame of index k, with the corruption."""
        return [self.image(k, camera) for camera in range(len(self._placed))]

    def image(self, k: int, camera: int) -> UInt8:
        """Return one camera's image (height, width, 3) uint8 BGR in the frame of index k, with the corruption.

        The camera is given by its index in the rig's order.
        """
        stage = self._stage(k)
        stages: Sequence[LitBodies] = (stage,)
        if self.look.exposure_s > 0:
            instants = ((np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5) * self.look.exposure_s
            stages = [self._stage_at(self.times_s[k] + late) for late in instants]
        image = self._developed(painted(stages, self._placed[camera]), stage, k, camera)
        return image if self.corruption is None else self.corruption.of(image, k, camera)

    def masks(self, k: int) -> list[NDArray[np.bool_]]:
        """Return the true masks (height, width) bool of all cameras in the frame of index k.

        They state whether each pixel's centre shows a person, at the middle of the exposure and without `corruption`.
        """
        count = len(self.meshes)
        return [(covered.people >= 0) & (covered.people < count) for covered in self.covered(k)]

    def covered(self, k: int) -> list[Covered]:
        """Return the ground truth of all cameras in the frame of index k: person, part and depth at pixels' centres.

        The `things` follow the people: the index of the first is the number of people.
        """
        return [covered(self._stage(k), placed) for placed in self._placed]

    def background(self, k: int = 0) -> list[UInt8]:
        """Return images (height, width, 3) uint8 BGR of the empty room of all cameras, without `things` and corruption.

        Their brightness is that of frame k; their noise is their own.
        """
        empty = Layer((0, 0), np.zeros((0, 0, 3), np.float32), np.zeros((0, 0), np.float32))
        return [self._developed(empty, None, k, camera) for camera in range(len(self._placed))]

    @cached_property
    def _views(self) -> list[BackdropView]:
        return [self.backdrop.seen_by(placed) for placed in self._placed]

    def _stage(self, k: int) -> LitBodies:
        if self._staged is None or self._staged[0] != k:
            self._staged = (k, self._stage_at(self.times_s[k]))
        return self._staged[1]

    def _stage_at(self, at_s: float) -> LitBodies:
        bodies = [posed(mesh, motion.pose(at_s)) for mesh, motion in zip(self.meshes, self.motions, strict=True)]
        bodies += [thing.vertices(at_s) for thing in self.things]
        return stand(self._cast, np.concatenate(bodies), self.backdrop.light)

    def _developed(self, layer: Layer, stage: LitBodies | None, k: int, camera: int) -> UInt8:
        view, light = self._views[camera], self.backdrop.light
        height, width = view.linear.shape[:2]
        # The empty room has noise of its own: no two images of a camera share their noise.
        rng = np.random.default_rng([self.seed, 44, k, camera, int(stage is None)])
        starts = rng.integers(0, _TABLE - 3 * width, height)
        coded, spread = self._tables
        image = np.empty((height, width, 3), np.uint8)
        shade, first = (np.zeros((1, 1), np.float32), np.zeros(2)) if stage is None else (stage.shade, stage.first_m)
        kernels = _kernels()
        kernels.develop(
            view.linear, view.floor_m, kernels.BodyLayer(layer.colour, layer.alpha, *layer.origin_px),
            kernels.FloorShadow(shade, first, cell_m(), _directed(light)),
            kernels.ColourCoding(float(self._gains[k]), coded, spread), self._noise, starts, image,
        )  # fmt: skip
        return image


def silhouette_scene(
    name: str, *, seed: int = 0, cameras: int = 4, size_px: tuple[int, int] = (640, 480), seconds: float | None = None,
    fps: float = 60.0, outfit: str | None = None, people: int = 1, sex: Sex | None = None,
    height_m: float | None = None, surroundings: str | None = None, arc_deg: float = 360.0,
    loose_m: float = 0.0,
    look: CameraLook | None = None, corruption: Corruption | None = None, bvh: Path | str | None = None,
) -> SilhouetteScene:  # fmt: skip
    """Make a scene of `scene_names`.

    Args:
        name: name of the motion.
        seed: random seed of bodies, clothes, room, light, tempo, and the cameras' poses.
        cameras: number of cameras, in a ring.
        size_px: (width, height) of their images.
        seconds: duration [s]; None for that of the motion.
        fps: frame rate [Hz].
        outfit: one of `outfits.outfit_names`; None for a random one. ``background`` has the colours of the room.
        people: number of people, next to each other.
        sex, height_m: sex and height [m] of the first person; None for random ones. Random heights are 1.5 to 1.98 m.
        surroundings: things about the people of the motions `SEATED`, one of `later_things.SURROUNDINGS`; None for a
            chair, a bag and a mask alone.
        arc_deg: arc about the people along which the cameras stand, 360 for a whole ring [deg].
        loose_m: distance of the first person's trousers from the legs, larger towards the ankles [m].
        look: exposure and noise of the cameras; None for the defaults.
        corruption: corruption of the images; None for none.
        bvh: a BVH file whose motion replaces the motion ``walk``; None for none.

    Raises:
        SettingsError: unknown motion or outfit, or a number out of range; states what would work.
        InputError: the BVH file cannot be read.
    """
    check(1 <= cameras <= 32, "cameras", cameras, "from 1 to 32")
    check(1 <= people <= 4, "people", people, "from 1 to 4")
    check(0 <= loose_m <= 0.1, "loose_m", loose_m, "from 0 to 0.1 m")
    check(30 <= arc_deg <= 360, "arc_deg", arc_deg, "from 30 to 360°")
    check(1 <= fps <= 1000, "fps", fps, "from 1 to 1000 Hz")
    check(all(16 <= side <= 8192 for side in size_px), "size_px", size_px, "16 to 8192 each")
    check(bvh is None or name == "walk", "bvh", bvh, "given with the motion walk only")
    check(seed >= 0, "seed", seed, "0 or more")
    check(
        surroundings is None or name in SEATED, "surroundings", surroundings,
        f"given with the motions {', '.join(SEATED)} only",
    )  # fmt: skip
    usual_seconds(name)  # refuses an unknown motion early
    rng = np.random.default_rng([seed, 51])
    meshes, motions = [], []
    for person in range(people):
        meshes.append(body_mesh(*(_somebody(rng, sex, height_m) if person == 0 else _somebody(rng))))
        motion = _motion(name, meshes[-1], seconds, seed + 100 * person, bvh)
        motions.append(_moved(motion, rng.uniform(0, 2 * math.pi), _APART_M * (person - 0.5 * (people - 1))))
    meshes[0] = loosely_dressed(meshes[0], loose_m)
    lasts = min(motion.seconds for motion in motions)
    times = np.arange(max(math.floor(lasts * fps + 1e-9), 1)) / fps
    rig = _ring(cameras, size_px, meshes, motions, times, arc=math.radians(arc_deg), rng=rng)
    eyes = [inverse(placed.T_camera_world)[:3, 3] for placed in rig.cameras.values()]
    backdrop = make_backdrop(seed, max(4.9, float(np.abs(eyes).max()) + _BEHIND_M))
    colours = _room_colours(backdrop)
    worn, things = outfit, list[LaterThing]()
    if name in SEATED:
        worn = DARK if outfit is None else outfit
        about = surroundings or "chair"
        things = [
            one for mesh, motion in zip(meshes, motions, strict=True) for one in seated_things(mesh, motion, about)
        ]
        backdrop = darkened(backdrop, _DARK_SHARE) if about == "dark" else backdrop
    outfits = [make_outfit(worn, seed + 100 * person, colours) for person in range(people)]
    return SilhouetteScene(
        name, seed, meshes=meshes, outfits=outfits, motions=motions, backdrop=backdrop, rig=rig, times_s=times,
        look=look or CameraLook(), corruption=corruption, things=things,
    )  # fmt: skip


def loosely_dressed(mesh: RiggedMesh, loose_m: float) -> RiggedMesh:
    """Return a body's mesh whose thighs and shanks are wider, as in loose trousers; the joints stay.

    Args:
        mesh: the body.
        loose_m: distance of the cloth from the skin at the ankles; half of it at the hips [m].
    """
    legs = [k for k, name in enumerate(mesh.part_names) if name.endswith(("thigh", "shank"))]
    if loose_m == 0 or not legs:
        return mesh
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    hip, ankle = (mesh.landmarks[f"left {name}"].point[1] for name in ("hip", "ankle"))
    down = np.clip((hip - mesh.vertices[:, 1]) / (hip - ankle), 0.0, 1.0)
    wide = np.isin(mesh.bones[:, 0], legs) * loose_m * (0.5 + 0.5 * down)
    return msgspec.structs.replace(mesh, vertices=mesh.vertices + wide[:, None] * normals)


def scene_names() -> tuple[str, ...]:
    """Return the names that `silhouette_scene` knows; they are the motions of `body_motion`."""
    return motion_names()


def _somebody(rng: np.random.Generator, sex: Sex | None = None, height_m: float | None = None) -> tuple[Sex, float]:
    """Draw a sex and a height of 1.5 to 1.98 m where they are not given; all use the same random numbers."""
    drawn: Sex = ("male", "female")[rng.integers(2)]
    mean, sd = _HEIGHT_M[drawn]
    tall = float(rng.normal(mean, sd))
    if sex is not None and sex != drawn:
        of_mean = (tall - mean) / sd
        mean, sd = _HEIGHT_M[sex]
        tall = mean + of_mean * sd
    return sex or drawn, min(max(round(tall, 2), 1.5), 1.98) if height_m is None else height_m


def _motion(name: str, mesh: RiggedMesh, seconds: float | None, seed: int, bvh: Path | str | None) -> BodyMotion:
    if bvh is None:
        return body_motion(name, mesh, seconds, seed)
    from mocapella.model.bvh import read_bvh
    from mocapella.sources.simulate.bvh_body import body_motion_of

    file = read_bvh(bvh)
    if seconds is None:  # as much as a ring of cameras can see well
        seconds = min((len(file.channels) - 1) * file.frame_s, usual_seconds(name))
    return body_motion_of(file, mesh, seconds, file=bvh)


def _moved(motion: BodyMotion, turn: float, aside_m: float) -> BodyMotion:
    """Rotate a motion about the vertical through the origin, and then shift it along x."""
    R, shift = rotation_about_y(turn), np.array([aside_m, 0.0, 0.0])
    turns, place = motion.turns, motion.place
    return replace(
        motion,
        turns=lambda at: turns(at) + np.array([turn, 0.0, 0.0]),
        place=lambda at: place(at) @ R.T + shift,
    )


def _ring(
    count: int, size_px: tuple[int, int], meshes: Sequence[RiggedMesh], motions: Sequence[BodyMotion], times: Float64,
    *, arc: float, rng: np.random.Generator,
) -> CameraRig:  # fmt: skip
    """Make an arc [rad] of cameras with the longest focal lengths at which all people stay in all images."""
    some = times[:: max(len(times) // 40, 1)]
    points = np.concatenate(
        [posed(mesh, motion.pose(some))[:, ::7].reshape(-1, 3) for mesh, motion in zip(meshes, motions, strict=True)]
    )
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    reach = float(np.linalg.norm((points - middle)[:, [0, 2]], axis=1).max())
    first = rng.uniform(0, 2 * math.pi)
    placed = {}
    for k in range(count):
        around = first + arc * (k + rng.uniform(-0.18, 0.18)) / count
        far, up = max(rng.uniform(4.1, 4.7), rng.uniform(3.2, 3.5) + reach), rng.uniform(0.9, 2.2)
        position = np.array([middle[0] + far * math.sin(around), up, middle[2] + far * math.cos(around)])
        radial = rng.uniform(-0.14, -0.04)
        distortion = (radial, -0.35 * radial, rng.normal(0, 6e-4), rng.normal(0, 6e-4), 0.0)
        x, y, z = map(float, middle)
        camera = SimulatedCamera(f"camera{k + 1}", (float(position[0]), up, float(position[2])), (x, y, z))
        T, lens = camera.T_camera_world, np.array([1.0, 1.0, 0.0, 0.0, *distortion])
        seen = np.abs(project(apply(T, points), lens))
        halves = 0.5 * _FILLED * np.array(size_px)
        focal = float(np.min(halves / np.nanmax(seen, axis=0)))
        centre = 0.5 * (np.array(size_px) - 1) + rng.normal(0, 0.006, 2) * size_px[0]
        lens = np.array([focal, focal * rng.normal(1, 1e-3), *centre, *distortion])
        placed[camera.name] = PlacedCamera(Camera(camera.name, size_px, lens), T, np.zeros((6, 6)))
    return CameraRig(placed)


def _room_colours(backdrop: Backdrop) -> Any:
    """Colours of a wall and the floor."""
    wall, floor = (backdrop.materials[backdrop.faces[0, face], 1:4] for face in (0, 2))
    return tuple(map(float, wall)), tuple(map(float, floor))


def _directed(light: Light) -> Float64:
    """Share (3,) of the floor's light that is directed."""
    directed = light.strength * light.towards[1]
    return np.asarray(directed / (directed + light.sky))


def _coding(look: CameraLook) -> tuple[Float32, Float32]:
    """Tables (4097,) of sRGB's 8-bit values (IEC 61966-2-1) for linear 0 … 1, and of their noise.

    Photon noise grows with the signal, read noise does not (EMVA standard 1288, section 2).
    """
    x = np.linspace(0, 1, 4097)

    def code(linear: Float64) -> Float64:
        linear = np.clip(linear, 0, 1)
        return 255 * np.where(
            linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
        )

    sd = np.sqrt(look.read_noise**2 + x / look.photons)
    return code(x).astype(np.float32), (0.5 * (code(x + sd) - code(x - sd))).astype(np.float32)


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import body_paint_kernels

    return body_paint_kernels
