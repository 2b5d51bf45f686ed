"""Kernels that render a mesh in a camera: projected vertices, mask and outline.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort

UInt8 = NDArray[np.uint8]
Int8 = NDArray[np.int8]
Int32 = NDArray[np.int32]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

NEAREST_M = 0.05
"""Depth below which vertices are not drawn [m]."""
MOST = 4096
"""Largest number of points that `outline` writes."""


@njit(cache=True, error_model="numpy")
def see(
    vertices: Float64, T_camera_world: Float64, lens: Float64, farthest_r2: float, pixels: Float64, depth: Float64,
) -> None:  # fmt: skip
    """Project a mesh's vertices to pixels.

    Args:
        vertices: (n, 3) in the world [m].
        T_camera_world: (4, 4) extrinsics.
        lens, farthest_r2: (9,) fx fy cx cy [px], k1 k2 p1 p2 k3; and the squared radius up to which its distortion is
            one-to-one, of `lens.farthest_r2`.
        pixels: (n, 2) written, x, y [px]; 0 where the depth is 0.
        depth: (n,) written: along the camera's axis [m]; 0 where a vertex is nearer than `NEAREST_M` or outside the
            range of the distortion model.
    """
    T = T_camera_world
    # Local scalars, no branches and separate arrays let the compiler vectorise the loop.
    xa, xb, xc, xd = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    ya, yb, yc, yd = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    za, zb, zc, zd = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    farthest, count = farthest_r2 if farthest_r2 > 0.0 else math.inf, len(vertices)
    xs, ys = np.empty(count), np.empty(count)
    for i in range(count):
        a, b, c = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        xs[i], ys[i] = xa * a + xb * b + xc * c + xd, ya * a + yb * b + yc * c + yd
        depth[i] = za * a + zb * b + zc * c + zd
    for i in range(count):
        z = depth[i]
        before = z > NEAREST_M
        w = z if before else 1.0
        x, y = xs[i] / w, ys[i] / w
        shown = before & (x * x + y * y <= farthest)
        u, v, _, _, _ = distort(x, y, k1, k2, p1, p2, k3)
        depth[i] = z if shown else 0.0
        xs[i], ys[i] = fx * u + cx if shown else 0.0, fy * v + cy if shown else 0.0
    for i in range(count):
        pixels[i, 0], pixels[i, 1] = xs[i], ys[i]


@njit(cache=True)
def within(
    vertices: Float64, T_camera_world: Float64, lens: Float64, farthest_r2: float, width: int, height: int,
) -> bool:  # fmt: skip
    """Return whether all vertices of a mesh are in front of the camera and within its image.

    Args:
        vertices, T_camera_world, lens, farthest_r2: (n, 3) world [m], (4, 4), (9,) and a number, as in `see`.
        width, height: size of the image [px].
    """
    pixels, depth = np.empty((len(vertices), 2)), np.empty(len(vertices))
    see(vertices, T_camera_world, lens, farthest_r2, pixels, depth)
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        if not (depth[i] > 0.0 and 0.0 <= x < width - 1.0 and 0.0 <= y < height - 1.0):
            return False
    return True


@njit(cache=True)
def window(
    pixels: Float64, depth: Float64, width: int, height: int, step: int, margin: int,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Return the window of samples about the visible vertices, with a margin that may extend beyond the image.

    Args:
        pixels, depth: (n, 2) [px] and (n,) [m] of `see`; a depth of 0 marks an invisible vertex.
        width, height: size of the image [px].
        step: distance between samples [px].
        margin: width of the margin [px].

    Returns:
        The first sample's x and y [px], then the numbers of columns and rows; zeros if no vertex is in the image.
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
def face_sides(pixels: Float64, depth: Float64, faces: Int32, sides: Int8) -> None:
    """Write the visible side of each triangle of a mesh.

    Args:
        pixels, depth: (n, 2) [px] and (n,) [m] of `see`; a depth of 0 marks an invisible vertex.
        faces: (k, 3) corners, counter-clockwise as seen from outside.
        sides: (k,) written: 1 for the outside, −1 for the inside, 0 where a corner is not visible.
    """
    for k in range(len(faces)):
        i, j, m = np.uint64(faces[k, 0]), np.uint64(faces[k, 1]), np.uint64(faces[k, 2])
        x, y = pixels[i, 0], pixels[i, 1]
        area = (pixels[j, 0] - x) * (pixels[m, 1] - y) - (pixels[j, 1] - y) * (pixels[m, 0] - x)
        # y points downwards: seen from outside the corners run clockwise there.
        side = np.int8(1) if area < 0.0 else np.int8(-1)
        sides[k] = side if (depth[i] > 0.0) & (depth[j] > 0.0) & (depth[m] > 0.0) else np.int8(0)


@njit(cache=True, error_model="numpy")
def cover(pixels: Float64, faces: Int32, sides: Int8, x0: int, y0: int, step: int, mask: UInt8) -> None:
    """Set mask (rows, columns) to 1 at the samples covered by faces with a visible outside; leave other samples.

    The sample (row, column) is the image's point (x0 + step·column, y0 + step·row) [px]. On a closed surface these
    faces cover as much as all faces.

    Args:
        pixels: (n, 2) of `see` [px].
        faces, sides: (k, 3) and (k,) of `face_sides`.
        x0, y0: pixel of the first sample.
        step: distance between samples [px].
        mask: (rows, columns) uint8, in and out.
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


@njit(cache=True)
def border(faces: Int32, edges: Int32, sides: Int8) -> Int32:
    """Return the occluding-contour edges of a mesh: between a face with a visible outside and another face or none.

    Args:
        faces: (k, 3) corners.
        edges: (e, 4) of `outline_edges`.
        sides: (k,) of `face_sides`.

    Returns:
        (m, 4) int32 for each edge its two ends, the third corner of the visible face, and 1 if that face runs from the
        first end to the second, else −1.
    """
    chosen, m = np.empty(len(edges) + 1, np.int32), 0
    for e in range(len(edges)):
        first, second = edges[e, 2], edges[e, 3]
        other = (second >= 0) & (sides[np.uint64(max(second, 0))] > 0)
        chosen[np.uint64(m)] = e  # and is written over where that was none
        m += (sides[np.uint64(first)] > 0) != other
    out = np.empty((m, 4), np.int32)
    for n in range(m):
        e = chosen[n]
        i, j = edges[e, 0], edges[e, 1]
        front = edges[e, 2] if sides[edges[e, 2]] > 0 else edges[e, 3]
        a, b, c = faces[front, 0], faces[front, 1], faces[front, 2]
        out[n, 0], out[n, 1], out[n, 2] = i, j, a + b + c - i - j
        out[n, 3] = 1 if (a == i and b == j) or (b == i and c == j) or (c == i and a == j) else -1
    return out


@njit(cache=True, error_model="numpy")
def cover_by_edges(pixels: Float64, edges: Int32, x0: int, y0: int, step: int, mask: UInt8) -> None:
    """Write 1 or 0 to every sample of mask (rows, columns), covered as by `cover`; for an oriented surface (`one_way`).

    Only the surface's contour edges are drawn. A sample is covered if, in its column above it, more of them run in one
    direction than in the other.

    Args:
        pixels, x0, y0, step, mask: (n, 2) [px], the first sample's pixel, the stride [px] and the mask, as in `cover`.
        edges: (m, 4) of `border`.
    """
    rows, columns = mask.shape
    f, steps = 1.0 / step, np.zeros((rows, columns), np.int8)
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        if edges[e, 3] < 0:
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


@njit(cache=True)
def alike(mask: UInt8, phi: Float32) -> float:
    """Return the intersection over union, 0 to 1, of a mask and the region where phi is above 0; 0 if both are empty.

    Args:
        mask: (rows, columns) uint8.
        phi: (rows, columns) float32 signed distance, above 0 inside [px].
    """
    both = either = 0
    for i in range(len(mask)):
        row, other, common, some = mask[i], phi[i], np.int32(0), np.int32(0)
        for j in range(len(row)):
            a, b = np.int32(row[j]), np.int32(other[j] > 0)
            common, some = np.int32(common + (a & b)), np.int32(some + (a | b))
        both, either = both + int(common), either + int(some)
    return both / either if either > 0 else 0.0


def one_way(faces: Int32) -> bool:
    """Return whether a mesh with faces (k, 3) is oriented consistently.

    That is, every edge has at most two faces, and these run along it in opposite directions.
    """
    along = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    if not len(along):
        return True
    return len(np.unique(along[:, 0] * (along.max() + 1) + along[:, 1])) == len(along)


@njit(cache=True)
def outline(
    vertices: Float64, pixels: Float64, depth: Float64, edges: Int32, mask: UInt8, x0: float, y0: float,
    step: int, spacing: float, bones: Int32, at: Float64, normals: Float64, points: Float64, bone: Int32,
    far: Float64,
) -> int:  # fmt: skip
    """Sample a mesh's outline: write points on its contour edges that are outside the mask; return their number.

    Args:
        vertices: (n, 3) in the world [m].
        pixels, depth: (n, 2) [px] and (n,) [m] of `see`; a depth of 0 marks an invisible vertex.
        edges: (m, 4) of `border`.
        mask, x0, y0, step: (rows, columns) uint8, the first sample's pixel, and the stride [px], as in `cover`. An edge
            within the mask, as of an arm in front of the body, is not part of the outline.
        spacing: approximate distance between points [px].
        bones: (n,) int32 part of the body model with the largest weight of each vertex.
        at, normals, points, bone, far: written: (most, 2) pixels, (most, 2) outward normals as long as each point's
            share of the outline [px], (most, 3) positions in the world [m], (most,) parts, (most,) depths [m].

    Returns:
        Number of points; points beyond the capacity ``most`` are left out.
    """
    count, most = 0, len(at)
    rows, columns = mask.shape
    for e in range(len(edges)):
        i, j, m = edges[e, 0], edges[e, 1], edges[e, 2]
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
            column, row = round((u + 1.5 * step * nx - x0) / step), round((v + 1.5 * step * ny - y0) / step)
            if 0 <= row < rows and 0 <= column < columns and mask[row, column] != 0:
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


@njit(cache=True)
def outlined(
    vertices: Float64, T_camera_world: Float64, lens: Float64, farthest_r2: float, size_px: tuple[int, int],
    faces: Int32,
    edges: Int32, by_edges: bool, bones: Int32, step: int, margin: int, spacing: float, given: tuple[int, int, int,
    int],
) -> tuple[int, int, UInt8, Float64, Float64, Float64, Int32, Float64]:  # fmt: skip
    """Render mask and outline of a mesh.

    Args:
        vertices, T_camera_world, lens, farthest_r2: (n, 3) world [m], (4, 4), (9,) and a number, as in `see`.
        size_px: (width, height) of the image.
        faces: (k, 3) corners, counter-clockwise as seen from outside.
        edges: (e, 4) of `outline_edges`.
        by_edges: whether `cover_by_edges` can be used, see `one_way`.
        step, margin: distance between samples, and margin of the window about the mesh [px].
        given: window (x0, y0, columns, rows) that is reused from an earlier call, unless it has no columns.
        spacing, bones: distance between the outline's points [px], and (n,) part of each vertex, as in `outline`.

    Returns:
        The first sample's x and y [px], the mask (rows, columns) uint8, and of the outline (n, 2) points [px], (n, 2)
        normals [px], (n, 3) positions in the world [m], (n,) parts and (n,) depths [m]; an empty mask and no points
        where nothing is visible.
    """
    count = len(vertices)
    pixels, depth = np.empty((count, 2)), np.empty(count)
    see(vertices, T_camera_world, lens, farthest_r2, pixels, depth)
    x0, y0, columns, rows = given
    if columns == 0:
        x0, y0, columns, rows = window(pixels, depth, size_px[0], size_px[1], step, margin)
    most = 0 if columns < 3 or rows < 3 else MOST
    at, normals, points = np.empty((most, 2)), np.empty((most, 2)), np.empty((most, 3))
    bone, far = np.empty(most, np.int32), np.empty(most)
    if most == 0:
        return x0, y0, np.zeros((0, 0), np.uint8), at, normals, points, bone, far
    sides, mask = np.empty(len(faces), np.int8), np.zeros((rows, columns), np.uint8)
    face_sides(pixels, depth, faces, sides)
    beside = border(faces, edges, sides)
    if by_edges:
        cover_by_edges(pixels, beside, x0, y0, step, mask)
    else:
        cover(pixels, faces, sides, x0, y0, step, mask)
    m = outline(vertices, pixels, depth, beside, mask, x0, y0, step, spacing, bones, at, normals, points, bone, far)
    return x0, y0, mask, at[:m], normals[:m], points[:m], bone[:m], far[:m]


def outline_edges(faces: Int32) -> Int32:
    """Return each edge of a mesh once.

    Args:
        faces: (k, 3) int32 corners.

    Returns:
        (e, 4) int32: the edge's two ends, then the indices of its faces; −1 for a missing second face. Of an edge with
        more than two faces, the first two.
    """
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    face = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, face = ends[order], face[order]
    first = np.r_[True, (np.diff(ends, axis=0) != 0).any(axis=1)] if len(ends) else np.zeros(0, dtype=bool)
    start = np.flatnonzero(first)
    count = np.diff(np.r_[start, len(ends)])
    second = np.where(count > 1, face[np.minimum(start + 1, max(len(face) - 1, 0))], -1)
    return np.ascontiguousarray(np.c_[ends[start], face[start], second], dtype=np.int32)
