"""Compiled kernels of `mocapella.sources.simulate.backdrop`; importing this module imports numba.

A box is a row of 8 numbers: centre (3), half edges (3) [m], cosine and sine of its rotation about y. A material is a
row of 10: kind, first colour (3), second colour (3), size of the pattern [m], seed, gloss.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: loops are written out
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sources.simulate.noise_kernels import hashed, noise2, rough2

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Integers = NDArray[np.integer[Any]]

PAINT, PLANKS, BRICKS, TILES, CARPET, STRIPES, BOOKS, POSTER, WINDOW, CURTAIN, CLOTH, SKETCH = range(12)
"""Kinds of material; see `reflected`."""
FAR_M = 1e9
"""Distance of a ray that hits nothing [m]."""


class RoomGeometry(NamedTuple):
    """The boxes of a room.

    Attributes:
        boxes: (n, 8) centre (3) and half edges (3) [m], cosine and sine of the rotation about y; the first is the room
            itself, seen from inside.
        faces: (n, 6) index of the material of each box's faces −x +x −y +y −z +z.
        materials: (m, 10) kind, first colour (3), second colour (3), size of the pattern [m], seed, gloss.
    """

    boxes: Float64
    faces: Integers
    materials: Float64


class RoomLight(NamedTuple):
    """The light in a room; colours are red, green, blue.

    Attributes:
        strength: (3,) strength of the directed light.
        sky, ground: (3,) strength of the ambient light from above and from below.
        towards: (3,) unit vector towards the directed light.
        softness: range of the random change of each component of ``towards`` from sample to sample, for penumbrae.
        lamps: (3,) light that a `WINDOW` of reflectance 1 emits.
    """

    strength: Float64
    sky: Float64
    ground: Float64
    towards: Float64
    softness: float
    lamps: Float64


@njit(cache=True, nogil=True, error_model="numpy")
def enter_box(o: Float64, d: Float64, box: Float64, inside: bool) -> tuple[float, int, float]:
    """Intersect a ray with a box.

    Args:
        o, d: (3,) origin [m] and direction of the ray.
        box: (8,) centre (3) and half edges (3) [m], cosine and sine of the rotation about y.
        inside: whether to return the far side, as for a room seen from inside.

    Returns:
        The distance in lengths of ``d``, `FAR_M` without a hit; the axis of the face that is hit, 0 to 2; and the sign
        of the face's normal along that axis, towards the ray's origin.
    """
    c, s = box[6], box[7]
    px, pz = o[0] - box[0], o[2] - box[2]
    ox, oy, oz = c * px - s * pz, o[1] - box[1], s * px + c * pz
    dx, dy, dz = c * d[0] - s * d[2], d[1], s * d[0] + c * d[2]
    near, far, near_axis, far_axis = -FAR_M, FAR_M, 0, 0
    for axis in range(3):
        p = ox if axis == 0 else (oy if axis == 1 else oz)
        q = dx if axis == 0 else (dy if axis == 1 else dz)
        half = box[3 + axis]
        if abs(q) < 1e-12:
            if abs(p) > half:
                return FAR_M, 0, 1.0
            continue
        a, b = (-half - p) / q, (half - p) / q
        if a > b:
            a, b = b, a
        if a > near:
            near, near_axis = a, axis
        if b < far:
            far, far_axis = b, axis
    if near > far:
        return FAR_M, 0, 1.0
    if inside:
        q = dx if far_axis == 0 else (dy if far_axis == 1 else dz)
        return far, far_axis, -1.0 if q > 0.0 else 1.0
    if near < 1e-4:
        return FAR_M, 0, 1.0
    q = dx if near_axis == 0 else (dy if near_axis == 1 else dz)
    return near, near_axis, -1.0 if q > 0.0 else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _laid(kind: int, size: float, seed: int, u: float, v: float) -> tuple[float, float]:
    """(share of the second colour, brightness) of planks, bricks or tiles at u across and v up [m]."""
    mix, light = 0.0, 1.0
    if kind == PLANKS:
        row = math.floor(v / size)
        shift = 3.0 * hashed(row, seed, 1)
        plank = math.floor((u + shift) / (12.0 * size))
        tint = hashed(row, plank, seed)
        grain = rough2(u / (4.0 * size), v / (0.12 * size) + 7.0 * tint, seed + int(97 * tint))
        mix = 0.55 * tint + 0.45 * grain
        across, along = v / size - row, (u + shift) / (12.0 * size) - plank
        if across < 0.03 or along < 0.003:
            light = 0.55
        return mix, light
    long = 3.0 * size if kind == BRICKS else size
    row = math.floor(v / size)
    shift = 0.5 * long * (row % 2) if kind == BRICKS else 0.0
    column = math.floor((u + shift) / long)
    across, along = v / size - row, (u + shift) / long - column
    gap = 0.12 if kind == BRICKS else 0.025
    joint = across < gap or along * long < gap * size
    own = hashed(row, column, seed)
    if joint:
        mix, light = 1.0, 0.9 + 0.2 * noise2(u / 0.01, v / 0.01, seed)
    elif kind == BRICKS:
        light = 0.7 + 0.5 * own + 0.3 * (rough2(u / 0.03, v / 0.03, seed) - 0.5)
    else:
        mix = 1.0 * ((row + column) % 2) * (0.35 + 0.1 * own)
        light = 0.95 + 0.1 * rough2(u / (0.6 * size) + 9.0 * own, v / (0.6 * size), seed)
    return mix, light


@njit(cache=True, nogil=True, error_model="numpy")
def _books(size: float, seed: int, u: float, v: float, w: float, h: float, out: Float64) -> float:
    """Write the colour of a book and return -1; return the brightness of the shelf if there is no book there."""
    rows = max(round(h / size), 1)
    row = math.floor(v / h * rows)
    up = v - row * h / rows
    thick = 0.045
    column = math.floor(u / thick)
    board = up < 0.025 or u < 0.03 or w - u < 0.03 or h - v < 0.025
    tall = (0.55 + 0.35 * hashed(column, row, seed)) * h / rows
    gone = hashed(math.floor(column / 5.0), row, seed + 5) < 0.18
    if board:
        return float(0.8 + 0.3 * noise2(u / 0.2, v / 0.01, seed))
    if gone or up > tall:
        return 0.22
    rounded = (u / thick - column - 0.5) * 2.0
    dark = 0.35 + 0.9 * hashed(column, row, seed + 9)
    band = 1.35 if 0.62 < up / tall < 0.72 or 0.15 < up / tall < 0.18 else 1.0
    shade = dark * band * (1.0 - 0.45 * rounded * rounded)
    for k in range(3):
        out[k] = min(shade * (0.06 + 0.45 * hashed(column, row, seed + 20 + k)), 0.9)
    return -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def reflected(material: Float64, u: float, v: float, w: float, h: float, out: Float64) -> None:
    """Write the reflectance of a surface at u across and v up [m], on a face of w × h [m].

    Args:
        material: (10,) kind, first colour (3), second colour (3), size of the pattern [m], seed, gloss.
        u, v: position on the face, from its lower left corner [m].
        w, h: width and height of the face [m].
        out: (3,) written: reflectance of red, green, blue, 0 to 1.
    """
    kind, size, seed = int(material[0]), material[7], int(material[8])
    mix, light = 0.0, 1.0
    if kind == PAINT:
        light = (
            1.0 + 0.10 * (rough2(u / size, v / size, seed) - 0.5) + 0.03 * (noise2(u / 0.006, v / 0.006, seed) - 0.5)
        )
    elif kind in (PLANKS, BRICKS, TILES):
        mix, light = _laid(kind, size, seed, u, v)
    elif kind == CARPET:
        border = min(u, w - u, v, h - v)
        p, q = abs((u / size) % 2.0 - 1.0), abs((v / size) % 2.0 - 1.0)
        mix = 1.0 if (abs(p + q - 1.0) < 0.16 or 0.08 < border < 0.13 or (p + q < 0.3)) else 0.0
        light = 0.8 + 0.4 * noise2(u / 0.008, v / 0.008, seed)
    elif kind == STRIPES:
        mix = 1.0 if (u / size) % 1.0 < 0.5 else 0.0
        light = 0.97 + 0.06 * rough2(u / 0.1, v / 0.1, seed)
    elif kind == BOOKS:
        light = _books(size, seed, u, v, w, h, out)
        if light < 0.0:
            return
    elif kind == POSTER:
        if min(u, w - u, v, h - v) < 0.03:
            out[0] = out[1] = out[2] = 0.75
            return
        x, y = u / w, v / h
        mix, light = y, 0.9
        for k in range(7):
            cx, cy, r = hashed(k, 1, seed), hashed(k, 2, seed), 0.08 + 0.2 * hashed(k, 3, seed)
            ball = (x - cx) ** 2 * (w / h) ** 2 + (y - cy) ** 2 < r * r
            bar = abs(x - cx) < 1.3 * r and abs(y - cy) < 0.4 * r
            if (k % 2 == 0 and ball) or (k % 2 == 1 and bar):
                for c in range(3):
                    out[c] = 0.05 + 0.75 * hashed(k, 10 + c, seed)
                return
    elif kind == WINDOW:
        x, y = (u / w * 2.0) % 1.0, (v / h * 2.0) % 1.0
        if min(min(x, 1.0 - x) * w, min(y, 1.0 - y) * h) < 0.05:
            out[0] = out[1] = out[2] = 0.7
            return
        sky = v / h + 0.25 * (rough2(u / 0.5, v / 0.3, seed) - 0.5)
        for c in range(3):
            out[c] = material[1 + c] * min(max(sky, 0.0), 1.0) + material[4 + c] * (1.0 - min(max(sky, 0.0), 1.0))
        return
    elif kind == CURTAIN:
        fold = math.sin(2.0 * math.pi * (u / size + 0.35 * noise2(u / (3.0 * size), v / 1.5, seed)))
        light = 0.8 + 0.3 * fold
        mix = 0.5 + 0.5 * math.sin(2.0 * math.pi * v / (4.0 * size)) if seed % 2 == 0 else 0.0
    elif kind == CLOTH:
        light = 0.8 + 0.3 * noise2(u / 0.005, v / 0.005, seed) + 0.25 * (rough2(u / size, v / size, seed) - 0.5)
        mix = 0.5 if (u / size) % 1.0 < 0.08 else 0.0
    elif kind == SKETCH:  # drawers, doors, boxes with print
        x, y = (u / size) % 1.0, (v / size) % 1.0
        edge = min(x, 1.0 - x, y, 1.0 - y)
        light = 0.95 + 0.1 * rough2(u / 0.3, v / 0.05, seed)
        if edge < 0.02:
            light = 0.5
        elif abs(x - 0.5) < 0.12 and abs(y - 0.8) < 0.025:
            mix = 1.0
    for k in range(3):
        out[k] = min(max(light * (material[1 + k] * (1.0 - mix) + material[4 + k] * mix), 0.005), 0.95)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def passes(o: Float64, d: Float64, box: Float64) -> bool:
    """Return whether a ray misses the bounding sphere of a box, and so the box.

    Args:
        o, d: (3,) origin [m] and direction of the ray; ``d`` has any length.
        box: (8,) centre (3) and half edges (3) [m], cosine and sine of the rotation about y.
    """
    x, y, z = box[0] - o[0], box[1] - o[1], box[2] - o[2]
    along, size = x * d[0] + y * d[1] + z * d[2], d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    r2 = box[3] * box[3] + box[4] * box[4] + box[5] * box[5]
    off = x * x + y * y + z * z
    return bool(off > r2 and (along < 0.0 or off - along * along / size > r2))


@njit(cache=True, nogil=True, error_model="numpy")
def hit(o: Float64, d: Float64, boxes: Float64) -> tuple[float, int, int, float]:
    """Intersect a ray with all boxes of a room.

    Args:
        o, d: (3,) origin [m] and direction of the ray.
        boxes: (n, 8), see `RoomGeometry`; box 0 is the room, seen from inside.

    Returns:
        Distance in lengths of ``d``, index of the box, axis and sign of the face that is hit first; see `enter_box`.
    """
    best, axis, sign = enter_box(o, d, boxes[0], True)
    which = 0
    for b in range(1, len(boxes)):
        if passes(o, d, boxes[b]):
            continue
        t, a, s = enter_box(o, d, boxes[b], False)
        if t < best:
            best, which, axis, sign = t, b, a, s
    return best, which, axis, sign


@njit(cache=True, nogil=True, error_model="numpy")
def _ambient_share(room: Float64, p: Float64, n: Float64, axis: int, which: int) -> float:
    """Share of the ambient light at a point of a surface: less near the edges where the room's faces meet."""
    rx, rz = room[3] - abs(p[0] - room[0]), room[5] - abs(p[2] - room[2])
    low, high = p[1] - room[1] + room[4], room[4] - p[1] + room[1]
    near_x = 1.0 - (0.0 if axis == 0 and which == 0 else 0.35 * math.exp(-rx / 0.35))
    near_z = 1.0 - (0.0 if axis == 2 and which == 0 else 0.35 * math.exp(-rz / 0.35))
    near_y = (
        1.0
        - (0.0 if n[1] > 0.5 else 0.30 * math.exp(-low / 0.3))
        - (0.0 if n[1] < -0.5 else 0.20 * math.exp(-high / 0.3))
    )
    return near_x * near_z * near_y


@njit(cache=True, nogil=True, error_model="numpy")
def trace(
    rays: Float64, T_world_camera: Float64, geometry: RoomGeometry, lighting: RoomLight, linear: Float32, floor: Float32
) -> None:
    """Ray-trace the light that a camera receives from a room, and the visible floor.

    Args:
        rays: (h, w, samples, 2) directions x/z and y/z of a pixel's samples; the first is the pixel's middle.
        T_world_camera: (4, 4) pose of the camera.
        geometry: the room's boxes and materials.
        lighting: the light in the room.
        linear: (h, w, 3) float32, written: red, green, blue.
        floor: (h, w, 2) float32, written: x and z [m]; NaN where a pixel's middle does not show the floor.
    """
    h, w, samples, _ = rays.shape
    o, d, p, q, n, colour = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    boxes, light, towards = geometry.boxes, lighting.strength, lighting.towards
    sky, ground, lamps = lighting.sky, lighting.ground, lighting.lamps
    room = boxes[0]
    for i in range(3):
        o[i] = T_world_camera[i, 3]
    for y in range(h):
        for x in range(w):
            floor[y, x, 0] = floor[y, x, 1] = np.nan
            linear[y, x, 0] = linear[y, x, 1] = linear[y, x, 2] = 0.0
            for k in range(samples):
                a, b = rays[y, x, k, 0], rays[y, x, k, 1]
                for i in range(3):
                    d[i] = T_world_camera[i, 0] * a + T_world_camera[i, 1] * b + T_world_camera[i, 2]
                size = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                for i in range(3):
                    d[i] /= size
                far, which, axis, sign = hit(o, d, boxes)
                if far >= FAR_M:
                    continue
                box = boxes[which]
                c, s = box[6], box[7]
                for i in range(3):
                    p[i] = o[i] + far * d[i]
                px, pz = p[0] - box[0], p[2] - box[2]
                lx, ly, lz = c * px - s * pz + box[3], p[1] - box[1] + box[4], s * px + c * pz + box[5]
                n[0] = n[1] = n[2] = 0.0
                if axis == 0:
                    n[0], n[2] = sign * c, -sign * s
                    u, v, across, up = lz, ly, 2.0 * box[5], 2.0 * box[4]
                elif axis == 1:
                    n[1] = sign
                    u, v, across, up = lx, lz, 2.0 * box[3], 2.0 * box[5]
                else:
                    n[0], n[2] = sign * s, sign * c
                    u, v, across, up = lx, ly, 2.0 * box[3], 2.0 * box[4]
                outward = sign if which > 0 else -sign
                material = geometry.materials[geometry.faces[which, 2 * axis + (1 if outward > 0.0 else 0)]]
                reflected(material, u, v, across, up, colour)
                if k == 0 and p[1] < 0.03 and n[1] > 0.5:
                    floor[y, x, 0], floor[y, x, 1] = p[0], p[2]
                # Each sample has its own light direction: penumbrae appear as noise, which the samples average.
                for i in range(3):
                    q[i] = towards[i] + lighting.softness * (hashed(4 * x + k, y, 77 + i) - 0.5)
                    p[i] += 1e-3 * n[i]
                facing = n[0] * towards[0] + n[1] * towards[1] + n[2] * towards[2]
                lit = max(facing, 0.0)
                if lit > 0.0:
                    for other in range(1, len(boxes)):
                        if not passes(p, q, boxes[other]) and enter_box(p, q, boxes[other], False)[0] < FAR_M:
                            lit = 0.0
                            break
                open_sky = _ambient_share(room, p, n, axis, which)
                share = 0.5 + 0.5 * n[1]
                shines = material[0] == WINDOW and which > 0
                for i in range(3):
                    e = light[i] * lit + open_sky * (sky[i] * share + ground[i] * (1.0 - share))
                    linear[y, x, i] += colour[i] * (lamps[i] if shines else e) / samples
