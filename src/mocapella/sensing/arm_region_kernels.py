"""Segment the part of a depth image that may be an arm, on a subsampled grid; compiled.

A grid is a subsampled part of the depth image, (h, w) depths [m], 0 where nothing was measured. Its lens (4,) is
pinhole: focal lengths and principal point fx, fy, cx, cy [grid pixels]. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True)
def thinned(depth: Float32, x0: int, y0: int, step: int, near: float, far: float, out: Float64) -> None:
    """Write the depth at every ``step``-th pixel of an image into a grid; 0 where out of range or isolated.

    It is the mean over the neighbourhood within half a step, of the pixels within 1.5 cm of the centre's depth. Where
    the centre has no depth, the nearest depth of the neighbourhood replaces it, if most neighbours are measured. Pixels
    at the edges of surfaces mix both sides; fewer than a third of their neighbours are within 1.5 cm, so they become 0.

    Args:
        depth: (height, width) [m].
        x0, y0: pixel of the grid's first element.
        step: distance between the grid's elements [px].
        near, far: range of valid depths [m].
        out: (h, w) written [m]; must be within the image.
    """
    height, width = depth.shape
    half = max(step // 2, 1)
    for i in range(out.shape[0]):
        y = y0 + i * step
        for j in range(out.shape[1]):
            x = x0 + j * step
            out[i, j] = 0.0
            z = depth[y, x]
            if half == 1 and 0 < y < height - 1 and 0 < x < width - 1:  # the usual case: the same as below, but faster
                if not near <= z <= far:
                    count, least = 0, math.inf
                    for b in range(-1, 2):
                        for a in range(-1, 2):
                            other = depth[y + b, x + a]
                            if near <= other <= far:
                                count += 1
                                least = min(least, other)
                    if count < 5:
                        continue
                    z = least
                count, total = 0, 0.0
                for b in range(-1, 2):
                    for a in range(-1, 2):
                        other = depth[y + b, x + a]
                        close = abs(other - z) < 0.015
                        count += close
                        total += other if close else 0.0
                if count >= 3:
                    out[i, j] = total / count
                continue
            if not near <= z <= far:
                # The nearest neighbour, where most are measured.
                valid, looked, least = 0, 0, math.inf
                for b in range(max(y - half, 0), min(y + half + 1, height)):
                    for a in range(max(x - half, 0), min(x + half + 1, width)):
                        looked += 1
                        if near <= depth[b, a] <= far:
                            valid += 1
                            least = min(least, depth[b, a])
                if 2 * valid <= looked:
                    continue
                z = least
            count, looked, total = 0, 0, 0.0
            for b in range(max(y - half, 0), min(y + half + 1, height)):
                for a in range(max(x - half, 0), min(x + half + 1, width)):
                    looked += 1
                    if abs(depth[b, a] - z) < 0.015:
                        count += 1
                        total += depth[b, a]
            if 3 * count >= looked:
                out[i, j] = total / count


@njit(cache=True)
def bands(spheres: Float64, lens: Float64, gate: float, arm_gate: float, low: Float64, high: Float64) -> None:
    """Gate a depth image: write for each pixel the interval of depths that a surface near any sphere can have.

    Args:
        spheres: (k, 5) centre (3) in the camera frame and radius [m], and 1 for the hand or 0 for the arm.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        gate: largest distance of the surface from the spheres of the hand [m].
        arm_gate: largest distance of the surface from the spheres of the arm [m].
        low, high: (h, w) written: least and greatest depth [m]; infinite and 0 where no sphere is near.
    """
    height, width = low.shape
    for i in range(height):
        for j in range(width):
            low[i, j], high[i, j] = math.inf, 0.0
    for k in range(len(spheres)):
        x, y, z, r = (
            spheres[k, 0],
            spheres[k, 1],
            spheres[k, 2],
            spheres[k, 3] + (gate if spheres[k, 4] > 0.0 else arm_gate),
        )
        if z < 0.1:
            continue
        px, py, size = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3], lens[0] * r / z
        for i in range(max(int(py - size), 0), min(int(py + size) + 2, height)):
            left = 1.0 - ((i - py) / size) ** 2
            if left <= 0.0:
                continue
            reach, f = size * math.sqrt(left), 1.0 / size
            # Without a branch the compiler vectorises this loop over columns.
            for j in range(max(math.ceil(px - reach), 0), min(math.floor(px + reach) + 1, width)):
                d = f * (j - px)
                half = r * math.sqrt(max(left - d * d, 0.0))
                low[i, j] = min(low[i, j], z - half)
                high[i, j] = max(high[i, j], z + half)


@njit(cache=True)
def grown(
    seen: Float64, low: Float64, high: Float64, wide_low: Float64, wide_high: Float64, jump: float, front: Float64
) -> None:
    """Segment the arm's surface by region growing with two gates: seeds in narrow depth intervals, grown in wide ones.

    Surfaces in front of the narrow intervals but within the wide ones are seeds, too: a finger in front of the palm is
    not connected to the hand, because its shadow separates them.

    Args:
        seen: (h, w) depth [m]; 0 where nothing was measured.
        low, high: (h, w) narrow intervals, of `bands` with a small gate.
        wide_low, wide_high: (h, w) wide intervals, of `bands` with a large gate.
        jump: regions grow over neighbours whose depths differ by less [m].
        front: (h, w) written: depth of the arm's surface; minus the depth of other surfaces, 0 where unmeasured [m].
    """
    height, width = seen.shape
    stack = np.empty(height * width, np.int64)
    n = 0
    for i in range(height):
        for j in range(width):
            z = seen[i, j]
            front[i, j] = -z
            if (low[i, j] <= z or (low[i, j] < math.inf and wide_low[i, j] <= z)) and 0.0 < z <= high[i, j]:
                front[i, j] = z
                stack[n] = i * width + j
                n += 1
    while n > 0:
        n -= 1
        i, j = stack[n] // width, stack[n] % width
        z = seen[i, j]
        for k in range(4):
            a, b = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
            if 0 <= a < height and 0 <= b < width and front[a, b] < 0.0:
                other = seen[a, b]
                if abs(other - z) < jump and wide_low[a, b] <= other <= wide_high[a, b]:
                    front[a, b] = other
                    stack[n] = a * width + b
                    n += 1


@njit(cache=True)
def others_edges(front: Float64, jump: float) -> float:
    """Return the share of a surface's edges, 0 to 1, at which a nearer surface occludes it; 0 without edges.

    An edge may border on a shadow without measurements, so its first measured pixel beyond, in row or column, decides.

    Args:
        front: (h, w) depth of the surface, minus that of others, 0 where nothing was measured [m].
        jump: least difference in depth to a nearer surface [m].
    """
    own, others = 0, 0
    for axis in range(2):
        lines, length = front.shape if axis == 0 else front.shape[::-1]
        for i in range(lines):
            for j in range(length):
                z = front[i, j] if axis == 0 else front[j, i]
                if z <= 0.0:
                    continue
                for step in (-1, 1):
                    k = j + step
                    beyond = 0.0
                    while 0 <= k < length and beyond == 0.0:
                        beyond = front[i, k] if axis == 0 else front[k, i]
                        k += step
                    if beyond > 0.0:
                        continue  # the same surface
                    own += beyond == 0.0 or -beyond > z - jump
                    others += beyond < 0.0 and -beyond <= z - jump
    return others / max(own + others, 1)


@njit(cache=True)
def opposite(front: Float64, out: Int64) -> None:
    """Write a row-wise distance map: the column of the nearest pixel on the other side of the arm's silhouette.

    Args:
        front: (h, w) of `grown` [m]; above 0 on the arm.
        out: (h, w) written: the column; −1 where the row has none.
    """
    height, width = front.shape
    for i in range(height):
        last = -1
        for j in range(width):
            if j > 0 and (front[i, j] > 0.0) != (front[i, j - 1] > 0.0):
                last = j - 1
            out[i, j] = last
        last = -1
        for j in range(width - 1, -1, -1):
            if j + 1 < width and (front[i, j] > 0.0) != (front[i, j + 1] > 0.0):
                last = j + 1
            if last >= 0 and (out[i, j] < 0 or last - j < j - out[i, j]):
                out[i, j] = last


@njit(cache=True)
def unprojected(front: Float64, lens: Float64, out: Float64) -> int:
    """Back-project the arm's pixels to 3D points, evenly subsampled if ``out`` is too small; return their number.

    Args:
        front: (h, w) depth [m]; only pixels above 0 are used.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        out: (capacity, 3) the first rows are written: camera frame [m].
    """
    height, width = front.shape
    count = 0
    for i in range(height):
        for j in range(width):
            count += front[i, j] > 0.0
    every = max((count + len(out) - 1) // max(len(out), 1), 1)
    n, k = 0, 0
    for i in range(height):
        for j in range(width):
            z = front[i, j]
            if z > 0.0:
                if k % every == 0 and n < len(out):
                    out[n, 0], out[n, 1], out[n, 2] = (j - lens[2]) * z / lens[0], (i - lens[3]) * z / lens[1], z
                    n += 1
                k += 1
    return n


@njit(cache=True)
def labelled(seen: Float64, jump: float, labels: Int64, sizes: Int64) -> int:
    """Label the connected components of a depth image's surfaces; return their number.

    Args:
        seen: (h, w) depth [m]; 0 where nothing was measured.
        jump: neighbours whose depths differ by less are connected [m per metre of depth].
        labels: (h, w) written: the surface's number, from 1; 0 for none.
        sizes: (capacity,) written: size of surface i at index i [px]. Surfaces beyond the capacity are not labelled.
    """
    height, width = seen.shape
    stack = np.empty(height * width, np.int64)
    for i in range(height):
        for j in range(width):
            labels[i, j] = 0
    count = 0
    for i in range(height):
        for j in range(width):
            if seen[i, j] <= 0.0 or labels[i, j] != 0:
                continue
            count += 1
            if count >= len(sizes):
                return count - 1
            labels[i, j], stack[0], n, size = count, i * width + j, 1, 0
            while n > 0:
                n -= 1
                size += 1
                a, b = stack[n] // width, stack[n] % width
                z = seen[a, b]
                for k in range(4):
                    c, d = a + (k == 0) - (k == 1), b + (k == 2) - (k == 3)
                    if 0 <= c < height and 0 <= d < width and labels[c, d] == 0:
                        other = seen[c, d]
                        if other > 0.0 and abs(other - z) < jump * z:
                            labels[c, d] = count
                            stack[n] = c * width + d
                            n += 1
            sizes[count] = size
    return count


@njit(cache=True)
def inner_distance(seen: Float64, labels: Int64, lens: Float64, out: Float64) -> None:
    """Write the distance of each pixel to the edge of its surface, by the chamfer distance 5-7-11.

    G. Borgefors, "Distance transformations in digital images", Computer Vision, Graphics, and Image Processing 34
    (1986) 344. The image's border is not an edge of a surface. A pixel at the edge is 1 pixel from it.

    Args:
        seen: (h, w) depth [m].
        labels: (h, w) of `labelled`.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        out: (h, w) written [m]; 0 off any surface.
    """
    height, width = seen.shape
    for i in range(height):
        for j in range(width):
            out[i, j] = 0.0 if labels[i, j] == 0 else 1e6
    for i in range(height):
        for j in range(width):
            if labels[i, j] == 0:
                continue
            own = labels[i, j]
            if (
                (i > 0 and labels[i - 1, j] != own)
                or (j > 0 and labels[i, j - 1] != own)
                or (i + 1 < height and labels[i + 1, j] != own)
                or (j + 1 < width and labels[i, j + 1] != own)
            ):
                out[i, j] = 1.0
    for sweep in range(2):
        for row in range(height):
            for column in range(width):
                i = row if sweep == 0 else height - 1 - row
                j = column if sweep == 0 else width - 1 - column
                if labels[i, j] == 0:
                    continue
                s = 1 if sweep == 0 else -1
                best = out[i, j]
                for k in range(8):
                    a, b, c = _KNIGHT[k]
                    y, x = i + s * int(a), j + s * int(b)
                    if 0 <= y < height and 0 <= x < width and labels[y, x] == labels[i, j]:
                        best = min(best, out[y, x] + c)
                out[i, j] = best
    for i in range(height):
        for j in range(width):
            out[i, j] *= seen[i, j] / lens[0]


_KNIGHT = np.array(
    [
        (0, -1, 1.0),
        (-1, 0, 1.0),
        (-1, -1, 1.4),
        (-1, 1, 1.4),
        (-2, -1, 2.2),
        (-2, 1, 2.2),
        (-1, -2, 2.2),
        (-1, 2, 2.2),
    ]
)


@njit(cache=True)
def geodesic(
    seen: Float64, lens: Float64, jump: float, from_y: int, from_x: int, most: float, out: Float64
) -> None:  # fmt: skip
    """Write the distances along the surface from one pixel, by Dijkstra's algorithm.

    Args:
        seen: (h, w) depth [m]; 0 where nothing was measured.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        jump: neighbours whose depths differ by more are not connected [m per metre of depth].
        from_y, from_x: row and column of the pixel.
        most: largest distance that is computed [m].
        out: (h, w) written [m]; infinite beyond ``most`` and where the surface is not connected.
    """
    height, width = seen.shape
    for i in range(height):
        for j in range(width):
            out[i, j] = math.inf
    heap_d, heap_i = np.empty(8 * height * width), np.empty(8 * height * width, np.int64)
    out[from_y, from_x] = 0.0
    heap_d[0], heap_i[0], n = 0.0, from_y * width + from_x, 1
    while n > 0:
        d, at = heap_d[0], heap_i[0]
        n -= 1
        last_d, last_i, k = heap_d[n], heap_i[n], 0
        while True:
            child = 2 * k + 1
            if child >= n:
                break
            if child + 1 < n and heap_d[child + 1] < heap_d[child]:
                child += 1
            if heap_d[child] >= last_d:
                break
            heap_d[k], heap_i[k], k = heap_d[child], heap_i[child], child
        heap_d[k], heap_i[k] = last_d, last_i
        i, j = at // width, at % width
        if d > out[i, j]:
            continue
        z = seen[i, j]
        for a in range(max(i - 1, 0), min(i + 2, height)):
            for b in range(max(j - 1, 0), min(j + 2, width)):
                other = seen[a, b]
                if other <= 0.0 or abs(other - z) > jump * z or (a == i and b == j):
                    continue
                dx = (b - lens[2]) * other / lens[0] - (j - lens[2]) * z / lens[0]
                dy = (a - lens[3]) * other / lens[1] - (i - lens[3]) * z / lens[1]
                there = d + math.sqrt(dx * dx + dy * dy + (other - z) ** 2)
                if there < out[a, b] and there <= most:
                    out[a, b] = there
                    k = n
                    n += 1
                    while k > 0 and heap_d[(k - 1) // 2] > there:
                        heap_d[k], heap_i[k] = heap_d[(k - 1) // 2], heap_i[(k - 1) // 2]
                        k = (k - 1) // 2
                    heap_d[k], heap_i[k] = there, a * width + b


@njit(cache=True)
def _persistent_tops(
    seen: Float64, away: Float64, jump: float, least: float, tops: Int64, persists: Float64
) -> int:  # fmt: skip
    """Write the farthest pixels of all branches, as flat indices, and their persistence [m]; return their number.

    Arguments of `branches`; the farthest of all pixels comes last.
    """
    height, width = seen.shape
    flat = away.ravel()
    count = 0
    for i in range(len(flat)):
        count += flat[i] < math.inf
    order, values, n = np.empty(count, np.int64), np.empty(count), 0
    for i in range(len(flat)):
        if flat[i] < math.inf:
            order[n], values[n] = i, -flat[i]
            n += 1
    order = order[np.argsort(values)]
    parent = np.full(len(flat), -1, np.int64)
    top = np.empty(len(flat), np.int64)
    n = 0
    for at in order:
        parent[at] = at
        top[at] = at
        i, j = at // width, at % width
        for a in range(max(i - 1, 0), min(i + 2, height)):
            for b in range(max(j - 1, 0), min(j + 2, width)):
                other = a * width + b
                if parent[other] < 0 or other == at:
                    continue
                z = seen[i, j]
                if abs(seen[a, b] - z) > jump * z:
                    continue
                one, two = at, other
                while parent[one] != one:
                    parent[one] = parent[parent[one]]
                    one = parent[one]
                while parent[two] != two:
                    parent[two] = parent[parent[two]]
                    two = parent[two]
                if one == two:
                    continue
                if flat[top[one]] > flat[top[two]]:
                    one, two = two, one
                # branch `one` ends here
                if flat[top[one]] - flat[at] >= least:
                    tops[n], persists[n] = top[one], flat[top[one]] - flat[at]
                    n += 1
                parent[one] = two
    if count > 0:
        last = order[0]
        tops[n], persists[n] = last, flat[last]
        n += 1
    return n


@njit(cache=True)
def branches(seen: Float64, away: Float64, lens: Float64, jump: float, least: float, found: Float64) -> int:
    """Find the branches of a surface, such as fingers, by their distance from an origin; return their number.

    A branch grows from a farthest pixel towards the origin, until it meets one that reaches farther: its persistence is
    its length up to there (H. Edelsbrunner, D. Letscher, A. Zomorodian, "Topological persistence and simplification",
    Discrete & Computational Geometry 28 (2002) 511).

    Args:
        seen: (h, w) depth [m].
        away: (h, w) distances along the surface from the origin [m], infinite off it; of `geodesic`.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        jump: neighbours whose depths differ by more are not connected [m per metre of depth].
        least: branches with a smaller persistence are part of the one they meet [m].
        found: (capacity, 8) written, the branch that reaches farthest first: row and column of its farthest pixel, its
            distance from the origin [m], persistence [m], the width of its last 4 cm [m], row and column of the centre
            of that part, and 1 if that part touches the image's border, else 0.
    """
    height, width = seen.shape
    flat = away.ravel()
    tops, persists = np.empty(len(flat), np.int64), np.empty(len(flat))
    n = _persistent_tops(seen, away, jump, least, tops, persists)
    stack, marked = np.empty(len(flat), np.int64), np.zeros(len(flat), np.int64)
    written = 0
    for k in range(n - 1, -1, -1):
        if written == len(found):
            break
        level = flat[tops[k]] - min(persists[k], 0.04)
        stack[0], m = tops[k], 1
        marked[tops[k]] = k + 1
        area, lines, columns, edge = 0.0, 0.0, 0.0, 0.0
        while m > 0:
            m -= 1
            i, j = stack[m] // width, stack[m] % width
            z = seen[i, j]
            piece = z * z / (lens[0] * lens[1])
            area += piece
            lines += piece * i
            columns += piece * j
            if i == 0 or j == 0 or i == height - 1 or j == width - 1:
                edge = 1.0
            for a in range(max(i - 1, 0), min(i + 2, height)):
                for b in range(max(j - 1, 0), min(j + 2, width)):
                    other = a * width + b
                    if marked[other] != k + 1 and level <= flat[other] < math.inf and abs(seen[a, b] - z) <= jump * z:
                        marked[other] = k + 1
                        stack[m] = other
                        m += 1
        found[written, 0], found[written, 1] = tops[k] // width, tops[k] % width
        found[written, 2], found[written, 3] = flat[tops[k]], persists[k]
        found[written, 4] = area / max(min(persists[k], 0.04), 1e-3)
        found[written, 5], found[written, 6], found[written, 7] = lines / area, columns / area, edge
        written += 1
    return written
