"""Kernels of the smooth union of tapered limbs, as a signed distance field, and of its triangulated surface.

A limb is a row of `LIMB` numbers: ends a (3) and b (3) [m], the radii there (2) [m], and the index of its group (1).
Importing this module imports numba; `mocapella.geometry.limb_surface` is the interface.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LIMB = 9


@njit(cache=True)
def smooth_min(a: float, b: float, k: float) -> float:
    """Return the quadratic smooth minimum of distances a and b, with the blending distance k, above 0 [m].

    It is below the minimum where they differ by less than k, by k/4 where they are equal; elsewhere it is the minimum.
    """
    h = k - abs(a - b)
    return min(a, b) - (h * h / (4.0 * k) if h > 0.0 else 0.0)


@njit(cache=True)
def limb_distance(limb: Float64, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point (x, y, z) from a tapered limb with round ends [m]; negative inside.

    Args:
        limb: (`LIMB`,) ends a (3) and b (3) [m], radii there (2) [m], and index of the group (1), which is not used.
        x, y, z: in the frame of the limb's ends [m].
    """
    ux, uy, uz = limb[3] - limb[0], limb[4] - limb[1], limb[5] - limb[2]
    px, py, pz = x - limb[0], y - limb[1], z - limb[2]
    uu = ux * ux + uy * uy + uz * uz
    t = min(max((px * ux + py * uy + pz * uz) / max(uu, 1e-18), 0.0), 1.0)
    dx, dy, dz = px - t * ux, py - t * uy, pz - t * uz
    return float(math.sqrt(dx * dx + dy * dy + dz * dz) - limb[6] - t * (limb[7] - limb[6]))


@njit(cache=True)
def flesh(limbs: Float64, within: Float64, between: float, x: float, y: float, z: float, by_group: Float64) -> float:
    """Evaluate the implicit surface: signed distance of a point (x, y, z) from the smooth union of all limbs [m].

    It is negative inside. `smooth_min` joins the limbs of each group, and then the groups. Without limbs, the distance
    is about 1000 m.

    Args:
        limbs: (n, `LIMB`), see `limb_distance`; sorted by group.
        within: (groups,) blending distance k of `smooth_min` between limbs of a group [m].
        between: blending distance k between groups [m].
        x, y, z: the point, in the frame of the limbs' ends [m].
        by_group: (groups,) written, a second result: signed distance from each group alone [m]; 1000 m if empty.
    """
    by_group[:] = 1e3
    for i in range(len(limbs)):
        g = int(limbs[i, 8])
        by_group[g] = smooth_min(by_group[g], limb_distance(limbs[i], x, y, z), within[g])
    out: float = 1e3
    for g in range(len(by_group)):
        out = smooth_min(out, by_group[g], between)
    return out


@njit(cache=True)
def sample(limbs: Float64, within: Float64, between: float, nodes: Float64, out: Float64) -> None:
    """Evaluate the implicit surface `flesh` at the nodes of a grid.

    Args:
        limbs, within, between: (n, `LIMB`), (groups,) [m] and a number [m], as in `flesh`.
        nodes: (a, b, c, 3) positions [m].
        out: (a, b, c) written: signed distances [m], negative inside.
    """
    by_group = np.empty(len(within))
    for i in range(nodes.shape[0]):
        for j in range(nodes.shape[1]):
            for k in range(nodes.shape[2]):
                p = nodes[i, j, k]
                out[i, j, k] = flesh(limbs, within, between, p[0], p[1], p[2], by_group)


@njit(cache=True)
def separate(values: Float64) -> bool:
    """Change signs until no cell face has inside and outside at alternating corners; return whether that succeeded.

    At such a face the surface would touch itself along an edge. Its inner corner nearest the surface is moved outside.

    Args:
        values: (a, b, c) signed distances at the nodes of a grid [m], negative inside; in and out.
    """
    shape = values.shape
    for _ in range(50):
        changed = 0
        for i in range(shape[0]):
            for j in range(shape[1]):
                for k in range(shape[2]):
                    for axis in range(3):
                        i1, j1, k1, i2, j2, k2 = i, j, k, i, j, k
                        if axis == 0:
                            j1, k2 = j + 1, k + 1
                        elif axis == 1:
                            i1, k2 = i + 1, k + 1
                        else:
                            i1, j2 = i + 1, j + 1
                        i3, j3, k3 = max(i1, i2), max(j1, j2), max(k1, k2)
                        if i3 >= shape[0] or j3 >= shape[1] or k3 >= shape[2]:
                            continue
                        a, b = values[i, j, k] < 0.0, values[i3, j3, k3] < 0.0
                        c, d = values[i1, j1, k1] < 0.0, values[i2, j2, k2] < 0.0
                        if a != b or c != d or a == c:
                            continue
                        changed += 1
                        if a:
                            if values[i, j, k] > values[i3, j3, k3]:
                                values[i, j, k] = 1e-6
                            else:
                                values[i3, j3, k3] = 1e-6
                        elif values[i1, j1, k1] > values[i2, j2, k2]:
                            values[i1, j1, k1] = 1e-6
                        else:
                            values[i2, j2, k2] = 1e-6
        if changed == 0:
            return True
    return False


@njit(cache=True)
def surface_net(values: Float64, nodes: Float64, vertices: Float64, triangles: Int64) -> tuple[int, int]:
    """Triangulate the surface at which signed distances are 0; return the numbers of vertices and triangles.

    S. Gibson, "Constrained elastic surface nets" (MICCAI 1998): a vertex in each cell that the surface crosses, at the
    mean of the crossings of its edges; a quadrilateral about each edge that it crosses.

    Args:
        values: (a, b, c) signed distances at the nodes, negative inside [m].
        nodes: (a, b, c, 3) positions of the nodes [m].
        vertices: (capacity, 3) written [m]; four for each edge that the surface crosses suffice.
        triangles: (capacity, 3) written, anticlockwise as seen from outside; two for each such edge suffice.
    """
    a, b, c = values.shape
    cell = np.full((a, b, c), -1, np.int64)
    n = 0
    for i in range(a - 1):
        for j in range(b - 1):
            for k in range(c - 1):
                x, y, z, crossings = 0.0, 0.0, 0.0, 0
                for e in range(12):
                    axis, u, v = e // 4, e & 1, (e >> 1) & 1
                    if axis == 0:
                        i0, j0, k0 = i, j + u, k + v
                        i1, j1, k1 = i + 1, j0, k0
                    elif axis == 1:
                        i0, j0, k0 = i + u, j, k + v
                        i1, j1, k1 = i0, j + 1, k0
                    else:
                        i0, j0, k0 = i + u, j + v, k
                        i1, j1, k1 = i0, j0, k + 1
                    p, q = values[i0, j0, k0], values[i1, j1, k1]
                    if (p < 0.0) == (q < 0.0):
                        continue
                    t = p / (p - q)
                    x += nodes[i0, j0, k0, 0] + t * (nodes[i1, j1, k1, 0] - nodes[i0, j0, k0, 0])
                    y += nodes[i0, j0, k0, 1] + t * (nodes[i1, j1, k1, 1] - nodes[i0, j0, k0, 1])
                    z += nodes[i0, j0, k0, 2] + t * (nodes[i1, j1, k1, 2] - nodes[i0, j0, k0, 2])
                    crossings += 1
                if crossings:
                    vertices[n, 0], vertices[n, 1], vertices[n, 2] = x / crossings, y / crossings, z / crossings
                    cell[i, j, k] = n
                    n += 1
    m = 0
    for i in range(1, a - 1):
        for j in range(1, b - 1):
            for k in range(1, c - 1):
                for axis in range(3):
                    inside = values[i, j, k] < 0.0
                    if axis == 0:
                        other = values[i + 1, j, k] < 0.0
                        q0, q1, q2, q3 = cell[i, j - 1, k - 1], cell[i, j, k - 1], cell[i, j, k], cell[i, j - 1, k]
                    elif axis == 1:
                        other = values[i, j + 1, k] < 0.0
                        q0, q1, q2, q3 = cell[i - 1, j, k - 1], cell[i - 1, j, k], cell[i, j, k], cell[i, j, k - 1]
                    else:
                        other = values[i, j, k + 1] < 0.0
                        q0, q1, q2, q3 = cell[i - 1, j - 1, k], cell[i, j - 1, k], cell[i, j, k], cell[i - 1, j, k]
                    if inside == other:
                        continue
                    if other:
                        q1, q3 = q3, q1
                    triangles[m, 0], triangles[m, 1], triangles[m, 2] = q0, q1, q2
                    triangles[m + 1, 0], triangles[m + 1, 1], triangles[m + 1, 2] = q0, q2, q3
                    m += 2
    return n, m


@njit(cache=True)
def settle(limbs: Float64, within: Float64, between: float, vertices: Float64, most_m: float) -> None:
    """Move vertices (n, 3) [m] onto the surface, in place, by three steps along its gradient.

    Args:
        limbs, within, between: (n, `LIMB`), (groups,) [m] and a number [m], as in `flesh`.
        vertices: (n, 3) [m], in and out.
        most_m: longest step, where the gradient has the length 1 [m].
    """
    by_group, e = np.empty(len(within)), 2e-4
    for i in range(len(vertices)):
        p = vertices[i]
        for _ in range(3):
            f = flesh(limbs, within, between, p[0], p[1], p[2], by_group)
            gx = (flesh(limbs, within, between, p[0] + e, p[1], p[2], by_group) - f) / e
            gy = (flesh(limbs, within, between, p[0], p[1] + e, p[2], by_group) - f) / e
            gz = (flesh(limbs, within, between, p[0], p[1], p[2] + e, by_group) - f) / e
            step = -f / max(gx * gx + gy * gy + gz * gz, 0.25)
            step = min(max(step, -most_m), most_m)
            p[0], p[1], p[2] = p[0] + step * gx, p[1] + step * gy, p[2] + step * gz


@njit(cache=True)
def group_distances(limbs: Float64, within: Float64, points: Float64, out: Float64) -> None:
    """Write the signed distance of each point from each group of limbs alone [m]; negative inside.

    Args:
        limbs, within: (n, `LIMB`) and (groups,) blending distances [m], as in `flesh`.
        points: (n, 3) [m].
        out: (n, groups) written.
    """
    for i in range(len(points)):
        flesh(limbs, within, 1e-6, points[i, 0], points[i, 1], points[i, 2], out[i])
