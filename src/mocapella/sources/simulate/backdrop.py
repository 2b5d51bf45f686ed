"""Rendered rooms as backgrounds: walls, a floor, furniture, posters, light and shadows.

    room = make_backdrop(seed=3)
    view = room.seen_by(placed)
    view.linear, view.floor_m

A room is a set of boxes whose faces have materials (planks, bricks, books, cloth; `backdrop_kernels.reflected`). It is
ray-traced once for each camera through its lens, with four samples a pixel and one at its centre, so that all cameras
see the same room. All furniture is along the walls; the middle is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import PlacedCamera

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_SOFTNESS: Final = 0.12
_SAMPLES_PX: Final = ((0.0, 0.0), (-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375))
"""A pixel's centre, and four samples on a rotated grid, so that slanted edges are smooth."""
_FLOORS: Final = (("planks", 0.13), ("planks", 0.09), ("tiles", 0.45), ("tiles", 0.6), ("cloth", 0.5), ("paint", 0.4))
_WALLS: Final = ("paint", "paint", "bricks", "stripes", "paint")
_KINDS: Final = (
    *("paint", "planks", "bricks", "tiles", "carpet", "stripes", "books", "poster", "window", "curtain"),
    *("cloth", "sketch"),
)
"""Names of the materials, in the kernels' order."""


@dataclass(frozen=True, eq=False)
class Light:
    """The light in a room, as red, green and blue; 1 shows a white surface as white.

    Attributes:
        towards: (3,) unit vector towards the directed light.
        strength: (3,) strength of the directed light.
        sky: (3,) ambient light from above.
        ground: (3,) ambient light from below.
    """

    towards: Float64
    strength: Float64
    sky: Float64
    ground: Float64


@dataclass(frozen=True, eq=False)
class BackdropView:
    """A room as seen by one camera: the image's background, before the camera's exposure, noise and coding.

    Attributes:
        linear: (height, width, 3) linear light, red, green, blue; 1 is a white surface in full light.
        floor_m: (height, width, 2) x and z of the floor at a pixel's centre, in the world [m]; NaN where the floor is
            not visible.
    """

    linear: Float32
    floor_m: Float32


@dataclass(frozen=True, eq=False)
class Backdrop:
    """A room.

    Attributes:
        boxes: (n, 8) centre (3) and half edges (3) in the world [m], cosine and sine of the rotation about y; the first
            box is the room.
        faces: (n, 6) index of the material of the faces −x +x −y +y −z +z.
        materials: (m, 10) kind, two colours (3 + 3), size of the pattern [m], seed, gloss.
        light: the light in the room.
    """

    boxes: Float64
    faces: NDArray[np.int64]
    materials: Float64
    light: Light

    def seen_by(self, placed: PlacedCamera) -> BackdropView:
        """Render the room for a camera that is in it, at the camera's pose in the world and through its lens."""
        width, height = placed.camera.size_px
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)[:, :, None]
        pixels = grid + np.array(_SAMPLES_PX)
        rays = undistort(pixels.reshape(-1, 2), placed.camera.lens).reshape(pixels.shape)
        linear, floor = np.empty((height, width, 3), np.float32), np.empty((height, width, 2), np.float32)
        light, k = self.light, _kernels()
        geometry = k.RoomGeometry(self.boxes, self.faces, self.materials)
        lamps = np.array([1.15, 1.2, 1.3])
        lighting = k.RoomLight(light.strength, light.sky, light.ground, light.towards, _SOFTNESS, lamps)
        k.trace(rays, inverse(placed.T_camera_world), geometry, lighting, linear, floor)
        return BackdropView(linear, floor)


def make_backdrop(seed: int = 0, least_half_m: float = 4.9) -> Backdrop:
    """Return a random room, the same for the same arguments: y up, floor at y = 0, its centre at x = z = 0.

    Args:
        seed: random seed of the room's size, materials, furniture and light.
        least_half_m: least distance of each wall from the centre [m].
    """
    rng = np.random.default_rng([seed, 11])
    maker = _Maker(rng)
    half = np.array([least_half_m, 1.35, least_half_m]) + rng.uniform(0, 1, 3) * [0.9, 0.35, 0.9]
    kind, size_m = _FLOORS[rng.integers(len(_FLOORS))]
    floor = maker.material(kind, maker.floor_colours(), size_m)
    ceiling = maker.material("paint", (np.full(3, 0.8), np.full(3, 0.8)), 1.0)
    wall = _WALLS[rng.integers(len(_WALLS))]
    main, other = maker.wall_colours(), maker.wall_colours()
    walls = [
        maker.material(wall if k % 2 == 0 else "paint", main if k != 1 else other, 0.075 if wall == "bricks" else 0.5)
        for k in range(4)
    ]
    maker.box(np.array([0.0, half[1], 0.0]), half, 0.0, (walls[0], walls[1], floor, ceiling, walls[2], walls[3]))
    _rug(maker, rng)
    for side in range(4):
        _furnish(maker, rng, half, side)
    return Backdrop(np.array(maker.boxes), np.array(maker.faces), np.array(maker.materials), _light(rng))


def darkened(room: Backdrop, share: float) -> Backdrop:
    """Return a room whose materials reflect a ``share``, 0 to 1, of the light of another room's materials."""
    materials = room.materials.copy()
    materials[:, 1:7] *= share
    return replace(room, materials=materials)


def _light(rng: np.random.Generator) -> Light:
    around, up = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(50, 72))
    towards = np.array([math.cos(up) * math.cos(around), math.sin(up), math.cos(up) * math.sin(around)])
    warm = rng.uniform(-0.08, 0.12)
    strength = rng.uniform(0.75, 1.1) * np.array([1 + warm, 1.0, 1 - warm])
    sky = rng.uniform(0.55, 0.75) * np.array([1 - 0.3 * warm, 1.0, 1 + 0.5 * warm])
    return Light(towards, strength, sky, 0.55 * sky * np.array([1.05, 1.0, 0.9]))


class _Maker:
    """Collector of boxes and materials."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.boxes: list[Float64] = []
        self.faces: list[tuple[int, ...]] = []
        self.materials: list[Float64] = []

    def material(self, kind: str, colours: tuple[Float64, Float64], size_m: float) -> int:
        seed = int(self.rng.integers(1, 10000))
        self.materials.append(np.array([_KINDS.index(kind), *colours[0], *colours[1], size_m, seed, 0.0]))
        return len(self.materials) - 1

    def box(self, centre: Float64, half: Float64, turn: float, faces: tuple[int, ...]) -> None:
        self.boxes.append(np.array([*centre, *half, math.cos(turn), math.sin(turn)]))
        self.faces.append(faces if len(faces) == 6 else faces * 6)

    def colour(self, grey: tuple[float, float], colourful: float) -> Float64:
        tint = np.exp(colourful * self.rng.normal(0, 1, 3))
        tint /= tint.mean()
        return np.asarray(np.clip(self.rng.uniform(*grey) * tint, 0.02, 0.85))

    def wall_colours(self) -> tuple[Float64, Float64]:
        first = self.colour((0.3, 0.68), 0.12)
        return first, np.clip(first * self.rng.uniform(0.75, 1.2), 0.05, 0.85)

    def floor_colours(self) -> tuple[Float64, Float64]:
        wood = np.array([0.42, 0.27, 0.15]) * self.rng.uniform(0.6, 1.35)
        if self.rng.random() < 0.35:
            wood = self.colour((0.2, 0.5), 0.06)
        return wood, wood * self.rng.uniform(0.5, 0.75)


def _rug(maker: _Maker, rng: np.random.Generator) -> None:
    """Add a flat rug in the middle, at random; it counts as floor."""
    if rng.random() < 0.5:
        colours = (maker.colour((0.1, 0.4), 0.4), maker.colour((0.2, 0.6), 0.3))
        rug = maker.material("carpet", colours, rng.uniform(0.15, 0.3))
        half = np.array([rng.uniform(1.2, 2.0), 0.002, rng.uniform(0.9, 1.6)])
        maker.box(
            np.array([rng.uniform(-0.4, 0.4), 0.002, rng.uniform(-0.4, 0.4)]), half, rng.uniform(0, math.pi), (rug,)
        )


def _furnish(maker: _Maker, rng: np.random.Generator, half: Float64, side: int) -> None:
    """Place objects of random widths along one wall, from corner to corner, and pictures above the low ones."""
    along = half[0] if side < 2 else half[2]
    depth_at = half[2] if side < 2 else half[0]
    sign = 1.0 if side % 2 == 0 else -1.0

    def put(middle: float, aside: float, up: float, size: tuple[float, float, float], turn: float, *faces: int) -> None:
        """Add a box (width, height, depth) with its back to the wall."""
        middle += aside
        w, h, d = (0.5 * s for s in size)
        out = sign * (depth_at - d - 0.01)
        if side < 2:
            maker.box(np.array([middle, up + h, out]), np.array([w, h, d]), turn, faces)
        else:
            maker.box(np.array([out, up + h, middle]), np.array([d, h, w]), turn, faces)

    at = -along + 0.3
    while at < along - 0.8:
        width = min(float(rng.uniform(0.6, 1.9)), along - 0.2 - at)
        middle = at + 0.5 * width
        kind = rng.choice(["books", "sofa", "cabinet", "window", "boxes", "curtain", "gap", "picture"])
        top = _put_object(maker, rng, str(kind), width, partial(put, middle))
        if top < 1.3 and kind != "gap":
            colours = (maker.colour((0.1, 0.6), 0.4), maker.colour((0.1, 0.6), 0.4))
            poster = maker.material("poster", colours, 1.0)
            put(middle, 0.0, max(top + 0.25, 1.2), (0.6 * width, min(0.8, 0.7 * width), 0.02), 0.0, poster)
        at += width + float(rng.uniform(0.05, 0.5))


def _put_object(maker: _Maker, rng: np.random.Generator, kind: str, width: float, put: Callable[..., None]) -> float:
    """Add an object of a kind and width [m]; return its height [m]."""
    top = 0.0
    if kind == "books":
        shelf = maker.material("books", (maker.colour((0.1, 0.5), 0.15),) * 2, 0.36)
        top = float(rng.uniform(1.2, 2.3))
        put(0.0, 0.0, (width, top, 0.32), 0.0, shelf)
    elif kind == "sofa":
        cloth = maker.material("cloth", (maker.colour((0.06, 0.45), 0.35), maker.colour((0.1, 0.4), 0.2)), 0.4)
        put(0.0, 0.0, (width, 0.42, 0.75), 0.0, cloth)
        put(0.0, 0.42, (width, 0.4, 0.2), 0.0, cloth)
        pillow = maker.material("stripes", (maker.colour((0.2, 0.6), 0.4), maker.colour((0.2, 0.6), 0.4)), 0.08)
        put(0.2 * width, 0.42, (0.42, 0.34, 0.36), 0.0, pillow)
        top = 0.85
    elif kind == "cabinet":
        wood = maker.material("sketch", (maker.colour((0.1, 0.6), 0.15), np.full(3, 0.08)), 0.5 * width)
        top = float(rng.choice([0.5, 1.0, 1.5]) * width)
        top = min(top, 1.9)
        put(0.0, 0.0, (width, top, 0.45), 0.0, wood)
        if top < 1.3:
            ornament = maker.material("paint", (maker.colour((0.05, 0.5), 0.4),) * 2, 0.1)
            put(0.0, top, (0.3 * width, 0.3, 0.2), 0.0, ornament)
            top += 0.3
    elif kind == "boxes":
        for k in range(3):
            card = maker.material("sketch", (np.array([0.4, 0.28, 0.17]) * rng.uniform(0.7, 1.2), np.full(3, 0.1)), 0.4)
            size = float(rng.uniform(0.35, 0.55))
            put(rng.uniform(-0.1, 0.1) * width, 0.4 * k, (size, 0.4, size), rng.uniform(-0.2, 0.2), card)
        top = 1.2
    elif kind == "curtain":
        cloth = maker.material("curtain", (maker.colour((0.15, 0.5), 0.3), maker.colour((0.15, 0.5), 0.3)), 0.16)
        top = 2.4
        put(0.0, 0.1, (width, top, 0.06), 0.0, cloth)
    elif kind == "window":
        sky = maker.material("window", (np.array([0.55, 0.7, 0.95]), np.array([0.35, 0.4, 0.3])), 1.0)
        put(0.0, 0.9, (width, 1.3, 0.03), 0.0, sky)
        top = 2.3
    return top


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import backdrop_kernels

    return backdrop_kernels
