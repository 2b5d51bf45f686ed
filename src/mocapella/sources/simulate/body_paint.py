"""Render moving, lit and clothed bodies into camera images, and their exact masks.

    stage = stand(cast, vertices, light)
    layer = painted(stage, placed)
    truth = covered(stage, placed)

Surfaces are drawn through the lens, with four samples a pixel for smooth colours, and one at the pixel's centre for the
ground truth. Light is directed, with the bodies' shadows on each other and on the floor, and ambient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import farthest_r2
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import PlacedCamera
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.sources.simulate.backdrop import Light
from mocapella.sources.simulate.outfits import Clothes

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]

_SIDE: Final = 2
"""Samples along a pixel's side."""
_FINE: Final = 10
"""Number of colour samples along a face's side: 2 to 3 mm apart on a body."""
_CELL_M: Final = 0.015
_MARGIN: Final = 12
"""Margin of the shadow map around the shadow, for its soft edge, in cells."""
_PENUMBRA_CELLS: Final = 2.2


@dataclass(frozen=True, eq=False)
class Cast:
    """All people's meshes as one mesh.

    Attributes:
        meshes: meshes of the people.
        rest: (n, 3) vertices of all meshes in the rest pose [m].
        faces: (m, 3) indices of each triangle's vertices.
        people: (m,) index of each face's person.
        parts: (m,) index of the part of that person's mesh.
        baked: (m, k, k, 4) float32 reflectance and gloss on a grid over each face; see `body_paint_kernels.bake`.
    """

    meshes: tuple[RiggedMesh, ...]
    rest: Float64
    faces: Int32
    people: Int32
    parts: Int32
    baked: Float32


def make_cast(meshes: Sequence[RiggedMesh], clothes: Sequence[Clothes]) -> Cast:
    """Join several dressed bodies to one mesh, and compute the colours of their surfaces once.

    Args:
        meshes: the bodies.
        clothes: the clothes of each, in the same order.
    """
    counts = [len(mesh.vertices) for mesh in meshes]
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return Cast(
        tuple(meshes),
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=True)]).astype(np.int32),
        np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]).astype(np.int32),
        np.concatenate([worn.parts for worn in clothes]).astype(np.int32),
        np.concatenate([_baked(mesh, worn) for mesh, worn in zip(meshes, clothes, strict=True)]),
    )


def _baked(mesh: RiggedMesh, clothes: Clothes) -> Float32:
    out = np.zeros((len(mesh.faces), _FINE, _FINE, 4), np.float32)
    _kernels().bake(
        mesh.faces, mesh.vertices, clothes.parts, clothes.zones, clothes.spots, clothes.materials, out
    )  # fmt: skip
    return out


@dataclass(frozen=True, eq=False)
class LitBodies:
    """Bodies at an instant, with their shadow map.

    Attributes:
        cast: the bodies.
        vertices: (n, 3) vertices in the world frame, y up, the floor at 0 [m].
        normals: (n, 3) unit normals of the vertices, outwards.
        light: the light in the room.
        tops: (k, l) shadow map: height plus 1 m of the first surface that the light hits on its way to each cell of the
            floor, in z and x; 0 without a surface [m].
        shade: (k, l) float32 fraction of the directed light that is blocked from the floor, 0 to 1.
        first_m: (2,) x and z of the first cell [m].
    """

    cast: Cast
    vertices: Float64
    normals: Float64
    light: Light
    tops: Float64
    shade: Float32
    first_m: Float64


@dataclass(frozen=True, eq=False)
class Layer:
    """Bodies in a window of an image.

    Attributes:
        origin_px: (x, y) of the window's first pixel.
        colour: (rows, columns, 3) float32 linear light, red, green, blue, premultiplied by alpha.
        alpha: (rows, columns) float32 fraction of each pixel that is covered, 0 to 1.
    """

    origin_px: tuple[int, int]
    colour: Float32
    alpha: Float32


@dataclass(frozen=True, eq=False)
class Covered:
    """Ground truth at the pixels' centres.

    Attributes:
        people: (height, width) int8 index of the person; -1 for background.
        parts: (height, width) int8 index of the part of that person's mesh; -1 for background.
        depth_m: (height, width) float32 z in the camera frame; infinite for background.
    """

    people: NDArray[np.int8]
    parts: NDArray[np.int8]
    depth_m: Float32


def stand(cast: Cast, vertices: Float64, light: Light) -> LitBodies:
    """Compute normals and shadows of bodies at one instant.

    Args:
        cast: the bodies.
        vertices: (n, 3) all their vertices, posed, in the world frame with the floor at y = 0 [m]; kept, not copied.
        light: the light in the room.
    """
    from scipy.ndimage import gaussian_filter

    normals = np.empty_like(vertices)
    _raster().vertex_normals(vertices, cast.faces, normals)
    slant = light.towards[[0, 2]] / light.towards[1]
    ground = vertices[:, [0, 2]] - vertices[:, 1:2] * slant
    first = ground.min(axis=0) - _MARGIN * _CELL_M
    wide, deep = np.ceil((ground.max(axis=0) - first) / _CELL_M).astype(int) + _MARGIN
    seen = np.column_stack([(ground - first) / _CELL_M, np.maximum(vertices[:, 1] + 1.0, 1e-3)])
    tops, which = np.zeros((deep, wide)), np.full((deep, wide), -1, np.int32)
    _raster().cover(seen, cast.faces, 0.0, 0.0, 1.0, tops, which)
    shade = gaussian_filter((which >= 0).astype(np.float32), _PENUMBRA_CELLS, truncate=3.0)
    return LitBodies(cast, vertices, normals, light, tops, shade, first)


def painted(stages: Sequence[LitBodies], placed: PlacedCamera) -> Layer:
    """Render bodies for a camera, averaged over ``stages``, the instants of its exposure; at least one.

    The layer is empty if no body is in the image.
    """
    views = [_seen(stage, placed) for stage in stages]
    boxes = np.array([box for _, box in views])
    shown = boxes[boxes[:, 2] > boxes[:, 0]] if (boxes[:, 2] > boxes[:, 0]).any() else np.zeros((1, 4), np.int64)
    left, top = shown[:, :2].min(axis=0)
    right, low = shown[:, 2:].max(axis=0)
    colour, alpha = np.zeros((low - top, right - left, 3), np.float32), np.zeros((low - top, right - left), np.float32)
    eye = inverse(placed.T_camera_world)[:3, 3].copy()
    for stage, (seen, _) in zip(stages, views, strict=True):
        cast, light = stage.cast, stage.light
        which = _nearest(seen, cast.faces, (left, top, right, low), _SIDE)[1]
        k = _kernels()
        k.paint(
            which, _SIDE, k.PaintedSurface(seen, cast.faces, stage.vertices, stage.normals, cast.baked), eye,
            np.array([light.strength, light.sky, light.ground, light.towards]),
            k.LightHeights(stage.tops, stage.first_m, _CELL_M), 1.0 / (_SIDE * _SIDE * len(stages)),
            k.BodyLayer(colour, alpha, int(left), int(top)),
        )  # fmt: skip
    return Layer((int(left), int(top)), colour, alpha)


def covered(stage: LitBodies, placed: PlacedCamera) -> Covered:
    """Render the ground truth of bodies at one instant for a camera: person, part and depth at each pixel's centre."""
    width, height = placed.camera.size_px
    people, parts = np.full((height, width), -1, np.int8), np.full((height, width), -1, np.int8)
    depth = np.full((height, width), np.inf, np.float32)
    seen, box = _seen(stage, placed)
    left, top, right, low = box
    near, which = _nearest(seen, stage.cast.faces, box, 1)
    window, hit = np.s_[top:low, left:right], which >= 0
    people[window][hit] = stage.cast.people[which[hit]]
    parts[window][hit] = stage.cast.parts[which[hit]]
    depth[window][hit] = 1.0 / near[hit]
    return Covered(people, parts, depth)


def cell_m() -> float:
    """Return the distance between cells of the shadow map [m]."""
    return _CELL_M


def _seen(stage: LitBodies, placed: PlacedCamera) -> tuple[Float64, NDArray[np.int64]]:
    """Projected vertices, and the window around them: left, top, right, bottom (exclusive)."""
    camera = placed.camera
    seen, box = np.empty_like(stage.vertices), np.empty(4, np.int64)
    _raster().project(stage.vertices, placed.T_camera_world, camera.lens, farthest_r2(camera.lens), seen)
    _raster().bounds(seen, np.array(camera.size_px), 1, box)
    return seen, box


def _nearest(seen: Float64, faces: Int32, box: Any, side: int) -> tuple[Float64, Int32]:
    left, top, right, low = box
    near = np.zeros((side * (low - top), side * (right - left)))
    which = np.full(near.shape, -1, np.int32)
    shift = 0.5 / side - 0.5
    _raster().cover(seen, faces, left + shift, top + shift, 1.0 / side, near, which)
    return near, which


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import body_paint_kernels

    return body_paint_kernels


@cache
def _raster() -> Any:
    """Import the raster kernels, and numba, on first use."""
    from mocapella.geometry import raster_kernels

    return raster_kernels
