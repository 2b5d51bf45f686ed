"""The loops of `mocapella.sources.simulate.depth_noise`, compiled; importing this module imports numba.

Random numbers are a hash of the image's key and the pixel, so that any pixel's noise can be had without the others'.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
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


@njit(cache=True)
def lattice_noise(key, x, y, cell):
    """Normal numbers that change smoothly with the place: bilinear between nodes ``cell`` apart, of variance 1."""
    i, j = x // cell, y // cell
    u, v = (x - i * cell) / cell, (y - j * cell) / cell
    a = normal(mixed(key, (j << 20) + i))
    b = normal(mixed(key, (j << 20) + i + 1))
    c = normal(mixed(key, ((j + 1) << 20) + i))
    d = normal(mixed(key, ((j + 1) << 20) + i + 1))
    wa, wb, wc, wd = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
    return (wa * a + wb * b + wc * c + wd * d) / math.sqrt(wa * wa + wb * wb + wc * wc + wd * wd)


@njit(cache=True, error_model="numpy")
def light_reaches(depth, focal_baseline, out):
    """Write which pixels (h, w) the projector lights: none nearer to it is seen in the same of its columns.

    Camera and projector are beside each other: in the projector's picture a pixel at x of depth z is at x − f·b/z.

    Args:
        depth: (h, w) float32 [m], infinite where nothing is.
        focal_baseline: f·b [px·m]; positive where the projector is on the side of greater x.
    """
    h, w = depth.shape
    nearest = np.empty(3 * w + 4, np.float32)
    for y in range(h):
        nearest[:] = np.inf
        for x in range(w):
            z = depth[y, x]
            if z < np.inf:
                at = x - focal_baseline / z + w
                k = math.floor(at)
                if 0 <= k < 3 * w:
                    nearest[k] = min(nearest[k], z)
                    nearest[k + 1] = min(nearest[k + 1], z)
        for x in range(w):
            z = depth[y, x]
            out[y, x] = False
            if z < np.inf:
                k = math.floor(x - focal_baseline / z + w + 0.5)
                # A surface seen at a slant must not shade itself: two pixels' change of disparity are let pass.
                slack = 0.004 + 2.0 * z * z / abs(focal_baseline)
                out[y, x] = not 0 <= k < 3 * w or z < nearest[k] + slack


@njit(cache=True, error_model="numpy")
def structured_light(depth, slope, lit, key, row, unit_m, out):
    """Write what a structured-light camera gives (h, w) uint16; see `StructuredLight`, whose fields ``row`` has in order.

    Args:
        depth: (h, w) float32 [m], infinite where nothing is; slope: (h, w) float32 cosine of the angle of incidence.
        lit: (h, w) of `light_reaches`.
    """
    h, w = depth.shape
    least, most = row[0], row[1]
    constant, square, nearest, angular, step, shared = row[2], row[3], row[4], row[5], row[6], row[7]
    cell, lateral, edge, hole, steep0, steep1, dropout = int(row[8]), row[9], row[10], row[11], row[12], row[13], row[14]
    one, two, three, four = mixed(key, 1), mixed(key, 2), mixed(key, 3), mixed(key, 4)
    own, together = math.sqrt(1.0 - shared), math.sqrt(shared)
    for y in range(h):
        for x in range(w):
            out[y, x] = 0
            yy, xx = y, x
            z = float(depth[y, x])
            # Is there an edge nearby?
            rough = False
            if 2 <= x < w - 2 and 2 <= y < h - 2:
                limit = edge * min(z, 10.0)
                for dy, dx in ((0, -2), (0, 2), (-2, 0), (2, 0)):
                    other = float(depth[y + dy, x + dx])
                    if abs(other - z) > limit and (other < np.inf or z < np.inf):
                        rough = True
            at = y * w + x
            if rough:
                g = mixed(one, at)
                b = mixed(two, (y // 3) * w + x // 3)
                sx = 0.7071 * lateral * (normal(g) + normal(b))
                sy = 0.7071 * lateral * (normal(mixed(g, 7)) + normal(mixed(b, 7)))
                xx = min(max(int(math.floor(x + sx + 0.5)), 0), w - 1)
                yy = min(max(int(math.floor(y + sy + 0.5)), 0), h - 1)
                z = float(depth[yy, xx])
                if uniform(mixed(b, 9)) < hole:
                    continue
            if not z < np.inf or not lit[yy, xx]:
                continue
            angle = math.acos(min(max(float(slope[yy, xx]), 0.0), 1.0))
            if angle > steep0 and uniform(mixed(three, at)) < (angle - steep0) / (steep1 - steep0):
                continue
            if uniform(mixed(four, at)) < dropout or uniform(mixed(four, -1 - (y // 4) * w - x // 4)) < 0.25 * dropout:
                continue
            sd = constant + square * (z - nearest) ** 2
            if angular > 0.0:
                sd += angular / math.sqrt(z) * angle * angle / (0.5 * math.pi - min(angle, 1.45)) ** 2
            quantum = step * z * z
            sd = math.sqrt(max(sd * sd - quantum * quantum / 12.0, 0.04 * sd * sd))  # rounding adds the rest
            g = own * normal(mixed(one, at + h * w)) + together * lattice_noise(two, x, y, cell)
            z += sd * g
            if step > 0.0:
                z = 1.0 / (step * math.floor(1.0 / (z * step) + 0.5))
            if least <= z <= most:
                out[y, x] = min(int(math.floor(z / unit_m + 0.5)), 65535)


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
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    yy, xx = min(max(y + dy, 0), h - 1), min(max(x + dx, 0), w - 1)
                    other = float(depth[yy, xx])
                    if abs(other - z) > 0.02 and (other < np.inf or z < np.inf):
                        rough = True
            if rough:  # the light of what is in front and of what is behind meets in the pixel
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        yy, xx = min(max(y + dy, 0), h - 1), min(max(x + dx, 0), w - 1)
                        other = float(depth[yy, xx])
                        if other < np.inf:
                            part = (1.0 - spread if dx == 0 else 0.5 * spread) * (
                                1.0 - spread if dy == 0 else 0.5 * spread
                            )
                            amplitude = part * max(float(slope[yy, xx]), 0.05) / (other * other)
                            re += amplitude * math.cos(turn * other)
                            im += amplitude * math.sin(turn * other)
            elif z < np.inf:
                amplitude = max(float(slope[y, x]), 0.05) / (z * z)
                re, im = amplitude * math.cos(turn * z), amplitude * math.sin(turn * z)
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
                out[y, x] = min(int(math.floor(z / unit_m + 0.5)), 65535)
