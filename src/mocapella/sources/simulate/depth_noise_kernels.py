"""The loops of `mocapella.sources.simulate.depth_noise`, compiled; importing this module imports numba.

Random numbers are a hash of the image's key and the pixel, so that any pixel's noise can be had without the others'.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLW3301 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

_LIGHT_M_S = 299792458.0


@njit(cache=True, inline="always")
def mixed(key, a):
    """64 random bits of a key and a number (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number
    generators", OOPSLA 2014)."""
    h = np.uint64(key) + np.uint64(a) * np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@njit(cache=True, inline="always")
def normal(h):
    """Nearly normal, of mean 0 and variance 1, within ±3.46: the sum of four uniform numbers of 16 bits."""
    total = 0.0
    for _ in range(4):
        total += float(h & np.uint64(0xFFFF))
        h >>= np.uint64(16)
    return (total - 2.0 * 65535.0) * (math.sqrt(3.0) / 65535.0)


@njit(cache=True, inline="always")
def uniform(h):
    """From 0 to 1."""
    return float(h >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy")
def light_reaches(depth, focal_baseline, out):
    """Write which pixels (h, w) the projector lights: none nearer to it is seen in the same of its columns.

    Camera and projector are beside each other: in the projector's picture a pixel at x of depth z is at x − f·b/z.

    Args:
        depth: (h, w) float32 [m], infinite where nothing is.
        focal_baseline: f·b [px·m]; positive where the projector is on the side of greater x.
    """
    h, w = depth.shape
    fb = np.float32(focal_baseline)
    nearest, column = np.empty(3 * w + 4, np.float32), np.empty(w, np.float32)
    slack = np.float32(2.0 / abs(focal_baseline))
    for y in range(h):
        nearest[:] = np.inf
        for x in range(w):
            column[x] = np.float32(x + w) - fb / depth[y, x]
        for x in range(w):
            z = depth[y, x]
            k = int(column[x])
            if z < np.inf and 0 <= k < 3 * w:
                nearest[k] = min(nearest[k], z)
                nearest[k + 1] = min(nearest[k + 1], z)
        for x in range(w):
            z = depth[y, x]
            k = int(column[x] + np.float32(0.5))
            # A surface seen at a slant must not shade itself: two pixels' change of disparity are let pass.
            out[y, x] = z < np.inf and (not 0 <= k < 3 * w or z < nearest[k] + np.float32(0.004) + slack * z * z)


@njit(cache=True)
def lattice_row(key, j, out):
    """Write normal numbers at a row of a lattice."""
    for i in range(len(out)):
        out[i] = normal(mixed(key, (j << 20) + i))


_ANGLES = 1024


@njit(cache=True, error_model="numpy")
def structured_light(depth, slope, lit, key, row, unit_m, out):
    """Write what a structured-light camera gives (h, w) uint16; ``row`` has the fields of `StructuredLight` in order.

    Args:
        depth: (h, w) float32 [m], infinite where nothing is; slope: (h, w) float32 cosine of the angle of incidence.
        lit: (h, w) of `light_reaches`.
    """
    h, w = depth.shape
    least, most = row[0], row[1]
    constant, square, nearest, angular, step, shared = row[2], row[3], row[4], row[5], row[6], row[7]
    cell, lateral, edge, hole, steep0, steep1, dropout = (
        int(row[8]),
        row[9],
        row[10],
        row[11],
        row[12],
        row[13],
        row[14],
    )
    one, two, three, four = mixed(key, 1), mixed(key, 2), mixed(key, 3), mixed(key, 4)
    per_step = 1.0 / step if step > 0.0 else 0.0
    own, together, per_unit = math.sqrt(1.0 - shared), math.sqrt(shared), 1.0 / unit_m
    # By the cosine of the angle of incidence: what it adds to the noise, and how many pixels are lost.
    more, lost = np.empty(_ANGLES + 1), np.empty(_ANGLES + 1)
    for i in range(_ANGLES + 1):
        angle = math.acos(i / _ANGLES)
        more[i] = angular * angle * angle / (0.5 * math.pi - min(angle, 1.45)) ** 2
        lost[i] = dropout + max(angle - steep0, 0.0) / (steep1 - steep0)
    # Smooth noise: bilinear between the nodes of a lattice, of variance 1 everywhere.
    above, below, blocks = np.empty(w // cell + 2), np.empty(w // cell + 2), np.empty(w // 4 + 1, np.bool_)
    nodes, columns = np.arange(w) // cell, np.arange(w) % cell
    u, size = np.empty(cell), np.empty((cell, cell))
    for i in range(cell):
        u[i] = i / cell
    for i in range(cell):
        for k in range(cell):
            size[i, k] = 1.0 / math.sqrt((u[i] ** 2 + (1 - u[i]) ** 2) * (u[k] ** 2 + (1 - u[k]) ** 2))
    for y in range(h):
        part = y % cell
        if part == 0:
            lattice_row(two, y // cell, above)
            lattice_row(two, y // cell + 1, below)
        if y % 4 == 0:
            for i in range(len(blocks)):
                blocks[i] = uniform(mixed(four, -1 - (y // 4) * w - i)) < 0.25 * dropout
        v = u[part]
        for x in range(w):
            out[y, x] = 0
            yy, xx = y, x
            near = depth[y, x]
            if 2 <= x < w - 2 and 2 <= y < h - 2:  # is there an edge nearby?
                a, b, c, d = depth[y, x - 2], depth[y, x + 2], depth[y - 2, x], depth[y + 2, x]
                low = min(min(a, b), min(c, d), near)
                if low < np.inf and max(max(a, b), max(c, d), near) - low > np.float32(edge) * low:
                    g, block = mixed(one, y * w + x), mixed(two, (y // 3) * w + x // 3)
                    sx = 0.7071 * lateral * (normal(g) + normal(block))
                    sy = 0.7071 * lateral * (normal(mixed(g, 7)) + normal(mixed(block, 7)))
                    xx = min(max(math.floor(x + sx + 0.5), 0), w - 1)
                    yy = min(max(math.floor(y + sy + 0.5), 0), h - 1)
                    near = depth[yy, xx]
                    if uniform(mixed(block, 9)) < hole:
                        continue
            if not near < np.inf or not lit[yy, xx] or blocks[x >> 2]:
                continue
            z, i, at = float(near), int(slope[yy, xx] * np.float32(_ANGLES)), y * w + x
            g = mixed(three, at)
            if float(mixed(four, at) >> np.uint64(40)) < lost[i] * 16777216.0:
                continue
            quantum = step * z * z
            sd = constant + square * (z - nearest) ** 2
            if angular > 0.0:
                sd += more[i] / math.sqrt(z)
            sd = math.sqrt(max(sd * sd - quantum * quantum * (1.0 / 12.0), 0.04 * sd * sd))  # rounding adds the rest
            k, column = nodes[x], columns[x]
            t = u[column]
            smooth = (1.0 - v) * ((1.0 - t) * above[k] + t * above[k + 1]) + v * (
                (1.0 - t) * below[k] + t * below[k + 1]
            )
            z += sd * (own * normal(g) + together * smooth * size[part, column])
            if step > 0.0:
                z = 1.0 / (step * int(per_step / z + 0.5))
            if least <= z <= most:
                out[y, x] = min(int(z * per_unit + 0.5), 65535)


@njit(cache=True, error_model="numpy")
def time_of_flight(depth, slope, key, row, unit_m, out):
    """Write what a time-of-flight camera gives (h, w) uint16; see `TimeOfFlight`, whose fields ``row`` has in order.

    Args:
        depth, slope: as of `structured_light`.
    """
    h, w = depth.shape
    least, most, sd_at_1m, faintest, spread, low_hz, wiggle, wiggle_hz, dropout = (
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8],
    )  # fmt: skip
    one, four = mixed(key, 1), mixed(key, 4)
    turn = 4.0 * math.pi * low_hz / _LIGHT_M_S
    for y in range(h):
        for x in range(w):
            out[y, x] = 0
            z, re, im, rough = float(depth[y, x]), 0.0, 0.0, False
            if 1 <= x < w - 1 and 1 <= y < h - 1:
                low, high = depth[y, x], depth[y, x]
                for dy in range(-1, 2):
                    low = min(low, min(depth[y + dy, x - 1], min(depth[y + dy, x], depth[y + dy, x + 1])))
                    high = max(high, max(depth[y + dy, x - 1], max(depth[y + dy, x], depth[y + dy, x + 1])))
                rough = low < np.inf and high - low > np.float32(0.02)
            if rough:  # the light of what is in front and of what is behind meets in the pixel
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        yy, xx = y + dy, x + dx
                        other = float(depth[yy, xx])
                        if other < np.inf:
                            part = (1.0 - spread if dx == 0 else 0.5 * spread) * (
                                1.0 - spread if dy == 0 else 0.5 * spread
                            )
                            amplitude = part * max(float(slope[yy, xx]), 0.05) / (other * other)
                            re += amplitude * math.cos(turn * other)
                            im += amplitude * math.sin(turn * other)
            elif z < np.inf:
                re = max(float(slope[y, x]), 0.05) / (z * z)
            strength = math.sqrt(re * re + im * im)
            at = y * w + x
            if strength < faintest or uniform(mixed(four, at)) < dropout:
                continue
            if rough:
                phase = math.atan2(im, re)
                z = (phase if phase >= 0.0 else phase + 2.0 * math.pi) / turn
            z += wiggle * math.sin(16.0 * math.pi * wiggle_hz * z / _LIGHT_M_S)
            z += sd_at_1m / strength * normal(mixed(one, at))
            if least <= z <= most:
                out[y, x] = min(int(z / unit_m + 0.5), 65535)
