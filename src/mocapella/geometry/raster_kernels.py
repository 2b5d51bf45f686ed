"""Kernels that rasterise triangles: the visible triangle at each sample of an image. Importing this imports numba.

A z-buffer: of the triangles that cover a sample, the one with the greatest inverse depth is visible.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

NEAR_M = 0.05
"""Depth of a corner below which its triangles are not drawn [m]."""


@njit(cache=True, nogil=True, error_model="numpy")
def project(vertices: Float64, T: Float64, lens: Float64, farthest_r2: float, out: Float64) -> None:
    """Project vertices to pixels and inverse depths.

    Args:
        vertices: (n, 3) world [m].
        T: (4, 4) `T_camera_world`.
        lens, farthest_r2: (9,) fx fy cx cy [px], k1 k2 p1 p2 k3; and the squared radius up to which its distortion is
            one-to-one, of `lens.farthest_r2`.
        out: (n, 3) written: x, y [px] and 1/z [1/m]; all 0 for vertices nearer than `NEAR_M` or outside the lens model.
    """
    for i in range(len(vertices)):
        p, q, r = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        z = T[2, 0] * p + T[2, 1] * q + T[2, 2] * r + T[2, 3]
        out[i, 0], out[i, 1], out[i, 2] = 0.0, 0.0, 0.0
        if z < NEAR_M:
            continue
        x = (T[0, 0] * p + T[0, 1] * q + T[0, 2] * r + T[0, 3]) / z
        y = (T[1, 0] * p + T[1, 1] * q + T[1, 2] * r + T[1, 3]) / z
        if x * x + y * y > farthest_r2:
            continue
        u, v, _, _, _ = distort(x, y, lens[4], lens[5], lens[6], lens[7], lens[8])
        out[i, 0], out[i, 1], out[i, 2] = lens[0] * u + lens[2], lens[1] * v + lens[3], 1.0 / z


@njit(cache=True, nogil=True, error_model="numpy")
def bounds(seen: Float64, size_px: tuple[int, int], margin_px: float, out: Float64) -> None:
    """Write the bounding box of the visible vertices, clipped to the image.

    Args:
        seen: (n, 3) projected vertices, of `project`; a third number of 0 or less marks an invisible one.
        size_px: (width, height) of the image.
        margin_px: margin of the box about the vertices [px].
        out: (4,) written: x0, y0, x1, y1 in whole pixels, the end exclusive; 0 if no vertex is visible. A box outside
            the image is empty.
    """
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(seen)):
        if seen[i, 2] > 0.0:
            x0, x1 = min(x0, seen[i, 0]), max(x1, seen[i, 0])
            y0, y1 = min(y0, seen[i, 1]), max(y1, seen[i, 1])
    if not x0 <= x1:
        out[0], out[1], out[2], out[3] = 0, 0, 0, 0
        return
    w, h = float(size_px[0]), float(size_px[1])
    out[0] = int(min(max(math.floor(x0) - margin_px, 0.0), w))
    out[1] = int(min(max(math.floor(y0) - margin_px, 0.0), h))
    out[2] = int(min(max(math.ceil(x1) + margin_px + 1, float(out[0])), w))
    out[3] = int(min(max(math.ceil(y1) + margin_px + 1, float(out[1])), h))


@njit(cache=True, nogil=True, error_model="numpy")
def cover(
    seen: Float64, triangles: Int64, left: float, top: float, step: float, nearest: Float64, which: Int64,
) -> None:  # fmt: skip
    """Write the nearest triangle at each sample of a grid; only the outside of the closed surface is drawn.

    A sample is a point; it is covered if it is inside the triangle or on its edge.

    Args:
        seen: (n, 3) of `project`.
        triangles: (m, 3) corners, counter-clockwise as seen from outside.
        left, top: position of the first sample [px].
        step: distance between samples [px].
        nearest: (rows, columns) float64 1/z of the nearest surface, 0 for none [1/m]; updated, so the caller resets it.
        which: (rows, columns) integer index of that surface's triangle, −1 for none; updated.
    """
    h, w = which.shape
    scale = 1.0 / step
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ia, ib, ic = seen[a, 2], seen[b, 2], seen[c, 2]
        if ia == 0.0 or ib == 0.0 or ic == 0.0:
            continue
        ax, ay = (seen[a, 0] - left) * scale, (seen[a, 1] - top) * scale
        bx, by = (seen[b, 0] - left) * scale, (seen[b, 1] - top) * scale
        cx, cy = (seen[c, 0] - left) * scale, (seen[c, 1] - top) * scale
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area >= 0.0:  # y points down, so outsides have a negative area
            continue
        x0, x1 = max(math.ceil(min(ax, bx, cx)), 0), min(math.floor(max(ax, bx, cx)), w - 1)
        y0, y1 = max(math.ceil(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), h - 1)
        # Barycentric coordinates along a row: at its first sample, and their increments.
        f = 1.0 / area
        du, dv, ds = -(cy - by) * f, -(ay - cy) * f, -(by - ay) * f
        near_x = du * ia + dv * ib + ds * ic  # 1/z is linear in the picture
        for y in range(y0, y1 + 1):
            u = ((cx - bx) * (y - by) - (cy - by) * (x0 - bx)) * f
            v = ((ax - cx) * (y - cy) - (ay - cy) * (x0 - cx)) * f
            s = ((bx - ax) * (y - ay) - (by - ay) * (x0 - ax)) * f
            near = u * ia + v * ib + s * ic
            for k in range(x1 - x0 + 1):
                if (
                    u + k * du >= 0.0
                    and v + k * dv >= 0.0
                    and s + k * ds >= 0.0
                    and near + k * near_x > nearest[y, x0 + k]
                ):
                    nearest[y, x0 + k], which[y, x0 + k] = near + k * near_x, t


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def weights(seen: Float64, a: int, b: int, c: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the perspective-correct barycentric weights of a triangle's corners at a pixel; their sum is 1.

    Args:
        seen: (n, 3) of `project`.
        a, b, c: indices of the corners.
        x, y: the pixel, inside the triangle [px].
    """
    ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
    u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) * seen[a, 2]
    v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) * seen[b, 2]
    s = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) * seen[c, 2]
    total = 1.0 / (u + v + s)
    return u * total, v * total, s * total


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_normals(vertices: Float64, triangles: Int64, out: Float64) -> None:
    """Write each vertex's outward unit normal: the area-weighted mean of its triangles' normals.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) corners, counter-clockwise as seen from outside.
        out: (n, 3) written; 0 for a vertex without triangles.
    """
    out[:] = 0.0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in (a, b, c):
            out[k, 0] += nx
            out[k, 1] += ny
            out[k, 2] += nz
    for i in range(len(out)):
        size = math.sqrt(out[i, 0] * out[i, 0] + out[i, 1] * out[i, 1] + out[i, 2] * out[i, 2])
        if size > 0.0:
            out[i, 0], out[i, 1], out[i, 2] = out[i, 0] / size, out[i, 1] / size, out[i, 2] / size
