"""A mesh as a camera sees it: where its vertices are, what it covers, and its outline; compiled.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort

NEAREST_M = 0.05
"""What is nearer than this to the camera's plane is not drawn [m]."""


@njit(cache=True)
def see(vertices, T_camera_world, lens, farthest_r2, pixels, depth):
    """Write where vertices (n, 3) are seen, (n, 2) [px], and how far before the camera, (n,) [m].

    What the lens cannot show, or is too near, has the depth 0.
    """
    T = T_camera_world
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    for i in range(len(vertices)):
        a, b, c = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        depth[i], pixels[i, 0], pixels[i, 1] = 0.0, 0.0, 0.0
        if not z > NEAREST_M:
            continue
        x = (T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]) / z
        y = (T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]) / z
        if x * x + y * y > farthest_r2 > 0.0:
            continue
        u, v, _, _, _ = distort(x, y, k1, k2, p1, p2, k3)
        depth[i], pixels[i, 0], pixels[i, 1] = z, fx * u + cx, fy * v + cy


@njit(cache=True)
def window(pixels, depth, width, height, step, margin):
    """The part of an image about what is seen: (x, y) of its first sample, columns, rows; none are 0.

    It reaches ``margin`` px beyond the body, and so far beyond the image at most.
    """
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for i in range(len(pixels)):
        if depth[i] > 0.0:
            left, right = min(left, pixels[i, 0]), max(right, pixels[i, 0])
            top, bottom = min(top, pixels[i, 1]), max(bottom, pixels[i, 1])
    if not (right >= 0.0 and left <= width - 1.0 and bottom >= 0.0 and top <= height - 1.0):
        return 0, 0, 0, 0
    left, right = max(left, 0.0) - margin, min(right, width - 1.0) + margin
    top, bottom = max(top, 0.0) - margin, min(bottom, height - 1.0) + margin
    x, y = step * math.floor(left / step), step * math.floor(top / step)
    return x, y, math.ceil((right - x) / step) + 1, math.ceil((bottom - y) / step) + 1


@njit(cache=True)
def face_sides(pixels, depth, faces, sides):
    """Write which side of each face is seen: 1 the outside, −1 the inside, 0 where a corner is not seen."""
    for k in range(len(faces)):
        i, j, m = faces[k, 0], faces[k, 1], faces[k, 2]
        if depth[i] == 0.0 or depth[j] == 0.0 or depth[m] == 0.0:
            sides[k] = 0
            continue
        x, y = pixels[i, 0], pixels[i, 1]
        area = (pixels[j, 0] - x) * (pixels[m, 1] - y) - (pixels[j, 1] - y) * (pixels[m, 0] - x)
        sides[k] = 1 if area < 0.0 else -1  # y points downwards: seen from outside the corners run clockwise there


@njit(cache=True, error_model="numpy")
def cover(pixels, faces, sides, x0, y0, step, mask):
    """Set mask (rows, columns) to 1 at the samples that faces cover whose outside is seen.

    The sample (row, column) is the image's point (x0 + step·column, y0 + step·row). Of a closed surface these faces
    cover what all of them do.
    """
    rows, columns = mask.shape
    f = 1.0 / step
    for k in range(len(faces)):
        if sides[k] <= 0:
            continue
        i, j, m = faces[k, 0], faces[k, 1], faces[k, 2]
        ax, ay = f * (pixels[i, 0] - x0), f * (pixels[i, 1] - y0)
        bx, by = f * (pixels[j, 0] - x0), f * (pixels[j, 1] - y0)
        cx, cy = f * (pixels[m, 0] - x0), f * (pixels[m, 1] - y0)
        top, bottom = max(math.ceil(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), rows - 1)
        ab, bc, ca = (bx - ax) / (by - ay), (cx - bx) / (cy - by), (ax - cx) / (ay - cy)
        for row in range(top, bottom + 1):
            left, right = math.inf, -math.inf
            if (ay <= row) != (by <= row):
                x = ax + (row - ay) * ab
                left, right = min(left, x), max(right, x)
            if (by <= row) != (cy <= row):
                x = bx + (row - by) * bc
                left, right = min(left, x), max(right, x)
            if (cy <= row) != (ay <= row):
                x = cx + (row - cy) * ca
                left, right = min(left, x), max(right, x)
            if left <= right:
                for column in range(max(math.ceil(left), 0), min(math.floor(right), columns - 1) + 1):
                    mask[row, column] = 1


@njit(cache=True, error_model="numpy")
def cover_by_edges(pixels, faces, edges, sides, x0, y0, step, mask):
    """What `cover` does, of a surface whose edges have two faces at most, which run along them in opposite directions.

    Only the edges between a face whose outside is seen and one that is not are drawn: above a sample of a column as
    many of them lead one way as the other, unless faces cover it.

    Args:
        edges: (e, 4) of `outline_edges`.
    """
    rows, columns = mask.shape
    f, steps = 1.0 / step, np.zeros((rows, columns), np.int8)
    for e in range(len(edges)):
        first, second = edges[e, 2], edges[e, 3]
        seen = sides[first] > 0
        if seen == (second >= 0 and sides[second] > 0):
            continue
        front = first if seen else second
        i, j = edges[e, 0], edges[e, 1]
        if not (
            (faces[front, 0] == i and faces[front, 1] == j)
            or (faces[front, 1] == i and faces[front, 2] == j)
            or (faces[front, 2] == i and faces[front, 0] == j)
        ):
            i, j = j, i
        ax, ay = f * (pixels[i, 0] - x0), f * (pixels[i, 1] - y0)
        bx, by = f * (pixels[j, 0] - x0), f * (pixels[j, 1] - y0)
        if ax < bx:
            left, right, sign = ax, bx, np.int8(1)
        else:
            left, right, sign = bx, ax, np.int8(-1)
        slope = (by - ay) / (bx - ax)
        # Columns from the left end, which is one of them, to the right end, which is not.
        for column in range(max(math.ceil(left), 0), min(math.ceil(right), columns)):
            row = max(math.ceil(ay + (column - ax) * slope), 0)
            if row < rows:
                steps[row, column] += sign
    depth = np.zeros(columns, np.int8)
    for i in range(rows):
        for j in range(columns):
            depth[j] += steps[i, j]
        for j in range(columns):
            mask[i, j] = 1 if depth[j] != 0 else 0


def one_way(faces):
    """Whether every edge has two faces at most, which run along it in opposite directions."""
    along = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    if not len(along):
        return True
    return len(np.unique(along[:, 0] * (along.max() + 1) + along[:, 1])) == len(along)


@njit(cache=True)
def _covered(mask, x0, y0, step, x, y):
    column, row = round((x - x0) / step), round((y - y0) / step)
    return 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and mask[row, column] != 0


@njit(cache=True)
def outline(
    vertices, pixels, depth, faces, edges, sides, mask, x0, y0, step, spacing, bones, at, normals, points, bone, far
):
    """Write points of the outline: of edges between a face seen from outside and one that is not, beside the mask.

    Args:
        vertices: (n, 3) [m].
        pixels, depth: of `see`.
        faces: (m, 3).
        edges: (e, 4) of `outline_edges`: the two ends, then the faces left and right of it, −1 where there is none.
        sides: of `face_sides`.
        mask, x0, y0, step: of `cover`; an edge within it, as of an arm before the body, is none of the outline.
        spacing: a point for about so much of an edge [px].
        bones: (n,) the part that moves each vertex most.
        at, normals, points, bone, far: written: (most, 2) where [px], (most, 2) outwards, of the length of outline
            that the point stands for [px], (most, 3) [m], (most,) part, (most,) depth [m].

    Returns:
        How many; where there is no room for more, the rest is left out.
    """
    count, most = 0, len(at)
    for e in range(len(edges)):
        f, g = edges[e, 2], edges[e, 3]
        front = f if sides[f] > 0 else g
        if front < 0 or sides[front] <= 0:
            continue
        back = g if front == f else f
        if back >= 0 and sides[back] > 0:
            continue
        i, j = edges[e, 0], edges[e, 1]
        m = faces[front, 0] + faces[front, 1] + faces[front, 2] - i - j
        x, y, dx, dy = pixels[i, 0], pixels[i, 1], pixels[j, 0] - pixels[i, 0], pixels[j, 1] - pixels[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length < 1e-9:
            continue
        nx, ny = dy / length, -dx / length
        if nx * (pixels[m, 0] - x) + ny * (pixels[m, 1] - y) > 0.0:
            nx, ny = -nx, -ny
        pieces = max(1, round(length / spacing))
        for p in range(pieces):
            s = (p + 0.5) / pieces
            u, v = x + s * dx, y + s * dy
            if _covered(mask, x0, y0, step, u + 1.5 * step * nx, v + 1.5 * step * ny):
                continue
            if count == most:
                return count
            at[count, 0], at[count, 1] = u, v
            normals[count, 0], normals[count, 1] = nx * length / pieces, ny * length / pieces
            for d in range(3):
                points[count, d] = (1.0 - s) * vertices[i, d] + s * vertices[j, d]
            bone[count] = bones[i] if s < 0.5 else bones[j]
            far[count] = (1.0 - s) * depth[i] + s * depth[j]
            count += 1
    return count


def outline_edges(faces):
    """(e, 4) each edge once: its two corners, then the faces beside it, −1 for the second where there is one face."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    face = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, face = ends[order], face[order]
    first = np.r_[True, (np.diff(ends, axis=0) != 0).any(axis=1)] if len(ends) else np.zeros(0, dtype=bool)
    start = np.flatnonzero(first)
    count = np.diff(np.r_[start, len(ends)])
    second = np.where(count > 1, face[np.minimum(start + 1, max(len(face) - 1, 0))], -1)
    return np.ascontiguousarray(np.c_[ends[start], face[start], second], dtype=np.int32)
