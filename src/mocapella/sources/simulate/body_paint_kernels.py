"""Compiled kernels of `mocapella.sources.simulate.body_paint`; importing this module imports numba.

A material is a row of 10 numbers: kind, first colour (3), second colour (3), size of the pattern [m], seed, gloss.
"""

# ruff: noqa: PLR0917 - compiled: loops are written out
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.raster_kernels import weights
from mocapella.sources.simulate.noise_kernels import noise2, noise3

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Integers = NDArray[np.integer[Any]]
UInt8 = NDArray[np.uint8]

PLAIN, HOOPS, CHECKS, PRINT, DOTS, CHEST, SKIN, HAIR = range(8)
"""Kinds of material; see `worn`."""
_BIAS_M = 0.03


class PaintedSurface(NamedTuple):
    """The bodies' surface at one instant, for one camera.

    Attributes:
        seen: (n, 3) projected vertices, see `raster_kernels.project`.
        triangles: (m, 3) indices of vertices.
        vertices, normals: (n, 3) in the world frame [m].
        baked: (m, k, k, 4) reflectance (red, green, blue) and gloss on a grid over each triangle, of `bake`.
    """

    seen: Float64
    triangles: Integers
    vertices: Float64
    normals: Float64
    baked: Float32


class LightHeights(NamedTuple):
    """A shadow map: the height of the first surface that the light hits on its way to each cell of the floor.

    Attributes:
        tops: (k, l) height plus 1 m over cells in z and x; 0 without a surface [m].
        first: (2,) x and z of the first cell's middle [m].
        cell_m: distance between cells [m].
    """

    tops: Float64
    first: Float64
    cell_m: float


class FloorShadow(NamedTuple):
    """The bodies' shadow on the floor.

    Attributes:
        shade: (k, l) float32 share of the directed light that is blocked, over cells of the floor in z and x.
        first, cell_m: (2,) x and z of the first cell's middle, and distance between cells [m].
        directed: (3,) share of the floor's light that is directed, by red, green, blue.
    """

    shade: Float32
    first: Float64
    cell_m: float
    directed: Float64


class BodyLayer(NamedTuple):
    """The bodies in a window of the image.

    Attributes:
        colour: (rows, columns, 3) float32 linear light, red, green, blue, premultiplied by alpha.
        alpha: (rows, columns) float32 fraction of each pixel that is covered, 0 to 1.
        left, top: column and row of the window's first pixel in the image.
    """

    colour: Float32
    alpha: Float32
    left: int
    top: int


class ColourCoding(NamedTuple):
    """How a camera codes light.

    Attributes:
        gain: factor of the light.
        coded, spread: (4097,) float32 tables over linear light from 0 to 1: 8-bit value from 0 to 255, and standard
            deviation of its noise.
    """

    gain: float
    coded: Float32
    spread: Float32


@njit(cache=True, nogil=True, error_model="numpy")
def worn(material: Float64, x: float, y: float, z: float, along: float, out: Float64) -> None:
    """Write the reflectance of cloth, skin or hair at a point of the body in its rest pose.

    Args:
        material: (10,) kind, first colour (3), second colour (3), size of the pattern [m], seed, gloss.
        x, y, z: the point in the mesh's rest frame [m].
        along: distance from the part's origin along its limb [m].
        out: (3,) written: reflectance of red, green, blue, 0 to 1.
    """
    kind, size, seed = int(material[0]), material[7], int(material[8])
    mix, light = 0.0, 1.0
    if kind == SKIN:
        light = 0.94 + 0.12 * noise3(x / 0.05, y / 0.05, z / 0.05, seed)
    elif kind == HAIR:
        light = 0.6 + 0.8 * noise2(math.atan2(x, z) * 30.0, y / 0.06, seed)
    else:
        folds = noise3(x / 0.07, y / 0.11, z / 0.07, seed) + 0.5 * noise3(x / 0.025, y / 0.04, z / 0.025, seed + 1)
        thread = noise3(x / 0.006, y / 0.006, z / 0.006, seed + 2)
        light = 0.86 + 0.16 * folds + 0.12 * (thread - 0.5)
        if kind == HOOPS:
            mix = 1.0 if (along / size) % 1.0 < 0.5 else 0.0
        elif kind == CHECKS:
            mix = 0.5 * (1.0 if (along / size) % 1.0 < 0.4 else 0.0) + 0.5 * (
                1.0 if ((x + z) / size) % 1.0 < 0.4 else 0.0
            )
        elif kind == PRINT:
            mix = 1.0 if noise3(x / size, y / size, z / size, seed + 3) > 0.5 else 0.0
        elif kind == DOTS:
            p, q = (along / size) % 1.0 - 0.5, ((x + 0.7 * z) / size) % 1.0 - 0.5
            mix = 1.0 if p * p + q * q < 0.07 else 0.0
        elif kind == CHEST:
            p, q = x / size, (along - 1.0) / size  # zones place the print's middle at along = 1
            ring = p * p + q * q
            mix = 1.0 if ring < 0.25 and not (0.06 < ring < 0.12) else 0.0
    for k in range(3):
        out[k] = min(max(light * (material[1 + k] * (1.0 - mix) + material[4 + k] * mix), 0.005), 0.95)


@njit(cache=True, nogil=True, error_model="numpy")
def material_of(zone: Float64, spots: Float64, x: float, y: float, z: float, along: float) -> int:
    """Return the index of the material at a point of the body in its rest pose.

    It depends on the distance along the limb, then on hair behind a plane, then on spots (eyes).

    Args:
        zone: (21,) a row of ``zones`` of `bake`.
        spots: (s, 5) as in `bake`.
        x, y, z: the point in the mesh's rest frame [m].
        along: distance from the zone's origin along its direction [m].
    """
    count = int(zone[6])
    k = 0
    while k < count - 1 and along > zone[7 + k]:
        k += 1
    which = int(zone[11 + k])
    if zone[20] >= 0.0 and k == count - 1:
        if zone[16] * x + zone[17] * y + zone[18] * z > zone[19]:
            which = int(zone[20])
        for i in range(len(spots)):
            u, v, w = x - spots[i, 0], y - spots[i, 1], z - spots[i, 2]
            if u * u + 3.0 * v * v + w * w < spots[i, 3] * spots[i, 3]:
                which = int(spots[i, 4])
    return which


@njit(cache=True, nogil=True, error_model="numpy")
def bake(
    triangles: Integers, rest: Float64, parts: Integers, zones: Float64, spots: Float64, materials: Float64,
    baked: Float32,
) -> None:  # fmt: skip
    """Compute the reflectance of each face on a grid, once in the rest pose, since clothes move with the skin.

    Args:
        triangles: (m, 3) indices of vertices.
        rest: (n, 3) vertices in the rest pose [m].
        parts: (m,) index of each triangle's zone.
        zones: (zones, 21) origin (3) [m], direction (3), number of materials, their ends along the direction (4) [m],
            their indices (5), plane (normal (3) and offset [m]), index of the material behind the plane or -1.
        spots: (s, 5) middle (3) [m], radius [m], index of the material.
        materials: (k, 10), rows as in `worn`.
        baked: (m, n, n, 4) float32, written: red, green, blue, gloss at the barycentric coordinates (i + ½)/n and
            (j + ½)/n of the first two corners; unchanged outside the triangle.
    """
    n, c, q = baked.shape[1], np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        a, b, d = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        zone = zones[parts[t]]
        for i in range(n):
            for j in range(n):
                u, v = (i + 0.5) / n, (j + 0.5) / n
                if i + j > n:
                    continue
                for k in range(3):
                    q[k] = u * rest[a, k] + v * rest[b, k] + (1.0 - u - v) * rest[d, k]
                along = (q[0] - zone[0]) * zone[3] + (q[1] - zone[1]) * zone[4] + (q[2] - zone[2]) * zone[5]
                material = materials[material_of(zone, spots, q[0], q[1], q[2], along)]
                worn(material, q[0], q[1], q[2], along, c)
                for k in range(3):
                    baked[t, i, j, k] = c[k]
                baked[t, i, j, 3] = material[9]


@njit(cache=True, nogil=True, error_model="numpy")
def lit_share(tops: Float64, first: Float64, cell_m: float, x: float, z: float, y: float) -> float:
    """Return the fraction of the directed light that arrives at a point, interpolated between the four nearest cells.

    Args:
        tops, first, cell_m: the shadow map, as in `LightHeights`: heights plus 1 m (k, l), middle of the first cell
            (2,), and distance between cells [m].
        x, z: where the light ray through the point meets the floor [m].
        y: the point's height [m].
    """
    deep, wide = tops.shape
    x, z = (x - first[0]) / cell_m, (z - first[1]) / cell_m
    i, j = math.floor(x), math.floor(z)
    if i < 0 or j < 0 or i + 1 >= wide or j + 1 >= deep:
        return 1.0
    u, v, most = x - i, z - j, y + 1.0 + _BIAS_M
    near = (1.0 - u) * (tops[j, i] <= most) + u * (tops[j, i + 1] <= most)
    return float((1.0 - v) * near + v * ((1.0 - u) * (tops[j + 1, i] <= most) + u * (tops[j + 1, i + 1] <= most)))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def whole(which: Integers, r: int, k: int) -> bool:
    """Return whether the 2 × 2 samples of ``which`` from row ``r`` and column ``k`` on all show a body (0 or more)."""
    return bool(which[r, k] >= 0 and which[r, k + 1] >= 0 and which[r + 1, k] >= 0 and which[r + 1, k + 1] >= 0)


@njit(cache=True, nogil=True, error_model="numpy")
def paint(
    which: Integers, per_pixel: int, surface: PaintedSurface, eye: Float64, light: Float64, heights: LightHeights,
    share: float, layer: BodyLayer,
) -> None:  # fmt: skip
    """Add the light and the coverage of bodies to a window of an image.

    Args:
        which: (rows·k, columns·k) index of the triangle at each sample, -1 for none, of `raster_kernels.cover`; k is
            ``per_pixel``.
        per_pixel: number of samples along a pixel's side.
        surface: the bodies' surface.
        eye: (3,) the camera's position in the world [m].
        light: (4, 3) rows: directed light, ambient light from above, from below, unit vector towards the directed
            light.
        heights: the shadow map.
        share: coverage that one sample adds; 1 is a whole pixel.
        layer: the window; ``colour`` and ``alpha`` are added to.
    """
    h, w = which.shape
    seen, triangles, vertices, normals = surface.seen, surface.triangles, surface.vertices, surface.normals
    baked, colour, alpha, left, top = surface.baked, layer.colour, layer.alpha, layer.left, layer.top
    step, fine = 1.0 / per_pixel, baked.shape[1]
    lx, ly, lz = light[3, 0], light[3, 1], light[3, 2]
    red, green, blue = light[0, 0], light[0, 1], light[0, 2]
    mean = 0.5 * (light[1] + light[2])  # of the ambient light
    swing = 0.5 * (light[1] - light[2])  # its change from sideways to upwards
    for r in range(h):
        y, row = top + (r + 0.5) * step - 0.5, r // per_pixel
        for k in range(w):
            t = which[r, k]
            if t < 0:
                continue
            much = share
            if per_pixel == 2 and whole(which, r - r % 2, k - k % 2):  # inside a body, every second sample is enough
                if (r + k) % 2 == 1:
                    continue
                much = 2.0 * share
            i0, i1, i2 = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            s0, s1, s2 = weights(seen, i0, i1, i2, left + (k + 0.5) * step - 0.5, y)
            nx = s0 * normals[i0, 0] + s1 * normals[i1, 0] + s2 * normals[i2, 0]
            ny = s0 * normals[i0, 1] + s1 * normals[i1, 1] + s2 * normals[i2, 1]
            nz = s0 * normals[i0, 2] + s1 * normals[i1, 2] + s2 * normals[i2, 2]
            size = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
            i, j = min(int(s0 * fine), fine - 1), min(int(s1 * fine), fine - 1)
            lit, shine = max((nx * lx + ny * ly + nz * lz) * size, 0.0), 0.0
            if lit > 0.0:
                px = s0 * vertices[i0, 0] + s1 * vertices[i1, 0] + s2 * vertices[i2, 0]
                py = s0 * vertices[i0, 1] + s1 * vertices[i1, 1] + s2 * vertices[i2, 1]
                pz = s0 * vertices[i0, 2] + s1 * vertices[i1, 2] + s2 * vertices[i2, 2]
                x, z = px - py * lx / ly, pz - py * lz / ly
                arrives = lit_share(heights.tops, heights.first, heights.cell_m, x, z, py)
                lit *= arrives
                gloss = baked[t, i, j, 3]
                if arrives > 0.0 and gloss > 0.0:  # J. Blinn's halfway vector
                    ex, ey, ez = eye[0] - px, eye[1] - py, eye[2] - pz
                    far = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
                    hx, hy, hz = ex * far + lx, ey * far + ly, ez * far + lz
                    cosine = max(hx * nx + hy * ny + hz * nz, 0.0) * size / math.sqrt(hx * hx + hy * hy + hz * hz)
                    cosine = cosine * cosine * cosine
                    cosine = cosine * cosine
                    shine = gloss * arrives * cosine * cosine * cosine * cosine
            up, c = ny * size, k // per_pixel
            colour[row, c, 0] += much * (baked[t, i, j, 0] * (red * lit + mean[0] + swing[0] * up) + shine * red)
            colour[row, c, 1] += much * (baked[t, i, j, 1] * (green * lit + mean[1] + swing[1] * up) + shine * green)
            colour[row, c, 2] += much * (baked[t, i, j, 2] * (blue * lit + mean[2] + swing[2] * up) + shine * blue)
            alpha[row, c] += much


@njit(cache=True, nogil=True, error_model="numpy")
def develop(
    backdrop: Float32, floor: Float32, layer: BodyLayer, shadow: FloorShadow, coding: ColourCoding, noise: Float32,
    starts: Integers, image: UInt8,
) -> None:  # fmt: skip
    """Compose a camera's image: bodies in front of a room with their shadow on the floor, exposed, coded, with noise.

    Args:
        backdrop: (h, w, 3) linear light of the room, red, green, blue.
        floor: (h, w, 2) x, z of the visible floor [m], NaN elsewhere.
        layer: the bodies, of `paint`.
        shadow: the bodies' shadow on the floor.
        coding: how the camera codes light.
        noise: (n,) float32 standard normal numbers.
        starts: (h,) index of each row's first number in ``noise``.
        image: (h, w, 3) uint8 blue, green, red, written.
    """
    h, w, _ = backdrop.shape
    colour, alpha, left, top = layer.colour, layer.alpha, layer.left, layer.top
    shade, first, cell_m, dark = shadow.shade, shadow.first, shadow.cell_m, shadow.directed
    gain, coded, spread = coding.gain, coding.coded, coding.spread
    rows, columns = alpha.shape
    deep, wide = shade.shape
    last = np.float32(len(coded) - 1)
    g = np.float32(gain) * last
    one, zero, half, white = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(255.0)
    first_x, first_z, cells = np.float32(first[0]), np.float32(first[1]), np.float32(1.0 / cell_m)
    right, low = np.float32(wide - 1), np.float32(deep - 1)
    for r in range(h):
        at = starts[r]
        inside = top <= r < top + rows
        for c in range(w):
            red, green, blue = backdrop[r, c, 0], backdrop[r, c, 1], backdrop[r, c, 2]
            x, y = (floor[r, c, 0] - first_x) * cells, (floor[r, c, 1] - first_z) * cells
            if x >= zero and y >= zero and x < right and y < low:
                i, j = int(x), int(y)
                u, v = x - i, y - j
                gone = (1.0 - v) * ((1.0 - u) * shade[j, i] + u * shade[j, i + 1]) + v * (
                    (1.0 - u) * shade[j + 1, i] + u * shade[j + 1, i + 1]
                )
                red *= np.float32(1.0 - gone * dark[0])
                green *= np.float32(1.0 - gone * dark[1])
                blue *= np.float32(1.0 - gone * dark[2])
            if inside and left <= c < left + columns:
                a = one - alpha[r - top, c - left]
                red = a * red + colour[r - top, c - left, 0]
                green = a * green + colour[r - top, c - left, 1]
                blue = a * blue + colour[r - top, c - left, 2]
            i, j, k = (
                int(min(max(g * blue, zero), last)),
                int(min(max(g * green, zero), last)),
                int(min(max(g * red, zero), last)),
            )
            image[r, c, 0] = np.uint8(min(max(coded[i] + spread[i] * noise[at] + half, zero), white))
            image[r, c, 1] = np.uint8(min(max(coded[j] + spread[j] * noise[at + 1] + half, zero), white))
            image[r, c, 2] = np.uint8(min(max(coded[k] + spread[k] * noise[at + 2] + half, zero), white))
            at += 3
