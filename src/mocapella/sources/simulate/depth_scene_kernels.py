"""Compiled kernels that draw triangle meshes into depth images; importing this module imports numba.

Rasterisation with a depth buffer, for a pinhole camera without distortion.
"""

# ruff: noqa: PLR0917, SIM110 - compiled: loops are written out
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Integers = NDArray[np.integer[Any]]
Bool = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]

NEAR_M = 0.05
"""Triangles with a vertex nearer than this are not drawn [m]."""


@njit(cache=True, error_model="numpy")
def project(vertices: Float64, pinhole: Float64, out: Float64) -> None:
    """Project vertices into the image.

    Args:
        vertices: (n, 3) in the camera frame [m].
        pinhole: (4,) fx, fy, cx, cy [px].
        out: (n, 3) written: x, y [px] and 1/z [1/m]; all 0 for a vertex nearer than `NEAR_M`.
    """
    for i in range(len(vertices)):
        z = vertices[i, 2]
        if z < NEAR_M:
            out[i, 0], out[i, 1], out[i, 2] = 0.0, 0.0, 0.0
            continue
        out[i, 0] = pinhole[0] * vertices[i, 0] / z + pinhole[2]
        out[i, 1] = pinhole[1] * vertices[i, 1] / z + pinhole[3]
        out[i, 2] = 1.0 / z


@njit(cache=True, error_model="numpy")
def draw(
    seen: Float64, triangles: Integers, labels: UInt8, first: np.uint8, vertices: Float64, depth: Float32, ids: UInt8,
    slope: Float32,
) -> None:  # fmt: skip
    """Draw triangles that face the camera with a depth buffer, if no vertex is nearer than `NEAR_M`.

    A triangle covers a pixel if the pixel's middle is inside or on an edge.

    Args:
        seen: (n, 3) of `project`.
        triangles: (m, 3) indices of vertices, anticlockwise as seen from the side that is drawn.
        labels: (m,) label of each triangle, relative to ``first``.
        first: label that is added to ``labels``.
        vertices: (n, 3) in the camera frame [m].
        depth: (h, w) float32 [m], infinite without a surface, in and out.
        ids: (h, w) uint8 label of the nearest surface, in and out.
        slope: (h, w) float32 cosine between the surface's normal and the ray, in and out.
    """
    h, w = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ia, ib, ic = seen[a, 2], seen[b, 2], seen[c, 2]
        if ia == 0.0 or ib == 0.0 or ic == 0.0:
            continue
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area >= 0.0:  # back face: with y down, a front face is anticlockwise in the image and negative here
            continue
        x0, x1 = max(math.ceil(min(ax, bx, cx)), 0), min(math.floor(max(ax, bx, cx)), w - 1)
        y0, y1 = max(math.ceil(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), h - 1)
        if x0 > x1 or y0 > y1:
            continue
        cosine = -1.0
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
                v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
                s = 1.0 - u - v
                if u < 0.0 or v < 0.0 or s < 0.0:
                    continue
                z = np.float32(1.0 / (u * ia + v * ib + s * ic))  # 1/z is linear in the image
                if z >= depth[y, x]:
                    continue
                if cosine < 0.0:
                    A, B, C = vertices[a], vertices[b], vertices[c]
                    nx = (B[1] - A[1]) * (C[2] - A[2]) - (B[2] - A[2]) * (C[1] - A[1])
                    ny = (B[2] - A[2]) * (C[0] - A[0]) - (B[0] - A[0]) * (C[2] - A[2])
                    nz = (B[0] - A[0]) * (C[1] - A[1]) - (B[1] - A[1]) * (C[0] - A[0])
                    size = math.sqrt((nx * nx + ny * ny + nz * nz) * (A[0] * A[0] + A[1] * A[1] + A[2] * A[2]))
                    cosine = min(abs(nx * A[0] + ny * A[1] + nz * A[2]) / max(size, 1e-30), 1.0)
                depth[y, x], ids[y, x], slope[y, x] = z, first + labels[t], cosine


@njit(cache=True, error_model="numpy")
def count_alone(seen: Float64, triangles: Integers, chosen: Bool, depth: NDArray[Any]) -> int:
    """Count the pixels that the chosen triangles cover, each once, as if nothing else were in the scene.

    Pixels beyond the image count too, up to its width and height on each side. Triangles count from either side; those
    with a vertex nearer than `NEAR_M` do not.

    Args:
        seen: (n, 3) of `project`.
        triangles: (m, 3) indices of vertices.
        chosen: (m,) whether each triangle counts.
        depth: (h, w); only its shape is used, as the image's size.
    """
    h, w = depth.shape
    x0, x1, y0, y1 = w, -1, h, -1
    for t in range(len(triangles)):
        if chosen[t]:
            for k in range(3):
                p = seen[triangles[t, k]]
                if p[2] > 0.0:
                    x0, x1 = min(x0, math.floor(p[0])), max(x1, math.ceil(p[0]))
                    y0, y1 = min(y0, math.floor(p[1])), max(y1, math.ceil(p[1]))
    x0, x1, y0, y1 = max(x0, -w), min(x1, 2 * w), max(y0, -h), min(y1, 2 * h)
    if x0 > x1 or y0 > y1:
        return 0
    hit, count = np.zeros((y1 - y0 + 1, x1 - x0 + 1), np.bool_), 0
    for t in range(len(triangles)):
        if not chosen[t]:
            continue
        a, b, c = seen[triangles[t, 0]], seen[triangles[t, 1]], seen[triangles[t, 2]]
        for y in range(max(math.ceil(min(a[1], b[1], c[1])), y0), min(math.floor(max(a[1], b[1], c[1])), y1) + 1):
            for x in range(max(math.ceil(min(a[0], b[0], c[0])), x0), min(math.floor(max(a[0], b[0], c[0])), x1) + 1):
                if not hit[y - y0, x - x0] and inside(seen, triangles[t], float(x), float(y)):
                    hit[y - y0, x - x0] = True
                    count += 1
    return count


@njit(cache=True, error_model="numpy")
def inside(seen: Float64, triangle: Integers, x: float, y: float) -> bool:
    """Return whether a point (x, y) of the image [px] is inside a triangle (3,), seen from either side.

    ``seen`` (n, 3) are the projected vertices of `project`.
    """
    a, b, c = seen[triangle[0]], seen[triangle[1]], seen[triangle[2]]
    if a[2] == 0.0 or b[2] == 0.0 or c[2] == 0.0:
        return False
    u = (c[0] - b[0]) * (y - b[1]) - (c[1] - b[1]) * (x - b[0])
    v = (a[0] - c[0]) * (y - c[1]) - (a[1] - c[1]) * (x - c[0])
    s = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
    return bool((u >= 0.0 and v >= 0.0 and s >= 0.0) or (u <= 0.0 and v <= 0.0 and s <= 0.0))


@njit(cache=True, error_model="numpy")
def covered(seen: Float64, triangles: Integers, chosen: Bool, x: float, y: float) -> bool:
    """Return whether one of the ``chosen`` triangles (m,) covers a point (x, y) of the image [px], occluded or not.

    ``seen`` (n, 3) are the projected vertices of `project`, ``triangles`` (m, 3) their indices.
    """
    for t in range(len(triangles)):
        if chosen[t] and inside(seen, triangles[t], x, y):
            return True
    return False
