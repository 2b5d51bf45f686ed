"""Compiled kernels of `mocapella.sources.simulate.depth_noise`; importing this module imports numba.

Random numbers are hashes of the image's key and the pixel's index, so each pixel's noise is independent of the order.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLW3301 - compiled: loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt16 = NDArray[np.uint16]
Bool = NDArray[np.bool_]

_LIGHT_M_S = 299792458.0
_ANGLES = 1024
"""Entries of the table over the cosine of the angle of incidence."""


class StructuredLightNoise(NamedTuple):
    """Fields of `StructuredLight` for the compiled kernels; ``steep0``, ``steep1``: its ``steep_deg`` in radians."""

    least_m: float
    most_m: float
    sd_m: float
    sd_per_m: float
    sd_least_at_m: float
    sd_angle: float
    step_per_m: float
    shared: float
    shared_px: int
    edge_px: float
    edge: float
    edge_holes: float
    steep0: float
    steep1: float
    dropout: float


class TimeOfFlightNoise(NamedTuple):
    """Parameters of a time-of-flight camera's noise, as floats: the fields of `TimeOfFlight`, in the same units."""

    least_m: float
    most_m: float
    sd_at_1m: float
    faintest: float
    spread: float
    low_hz: float
    wiggle_m: float
    wiggle_hz: float
    dropout: float


@njit(cache=True, inline="always")
def mixed(key: np.uint64, a: int) -> np.uint64:
    """Hash a key and a number to 64 random bits (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number
    generators", OOPSLA 2014)."""
    h = np.uint64(key) + np.uint64(a) * np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@njit(cache=True, inline="always")
def normal(h: np.uint64) -> float:
    """Turn 64 random bits into a nearly normal number of mean 0 and variance 1, within ±3.46.

    It is the sum of four uniform numbers of 16 bits.
    """
    total = 0.0
    for _ in range(4):
        total += float(h & np.uint64(0xFFFF))
        h >>= np.uint64(16)
    return (total - 2.0 * 65535.0) * (math.sqrt(3.0) / 65535.0)


@njit(cache=True, inline="always")
def uniform(h: np.uint64) -> float:
    """Turn 64 random bits into a uniform number from 0 to 1."""
    return float(h >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy")
def light_reaches(depth: Float32, focal_baseline: float, out: Bool) -> None:
    """Find the pixels that the projector lights: no nearer surface in the same projector column occludes them.

    Camera and projector are side by side: a pixel at column x and depth z is at x − f·b/z in the projector's image.

    Args:
        depth: (h, w) float32 [m], infinite without a surface.
        focal_baseline: f·b [px·m]; positive if the projector is on the side of greater x.
        out: (h, w) written: whether each pixel is lit.
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
            # A slanted surface must not shade itself: a change of disparity by two pixels is tolerated.
            out[y, x] = z < np.inf and (not 0 <= k < 3 * w or z < nearest[k] + np.float32(0.004) + slack * z * z)


@njit(cache=True)
def lattice_row(key: np.uint64, j: int, out: Float64) -> None:
    """Write random numbers of `normal` for row ``j`` of the correlated noise's lattice into ``out`` (n,).

    The same key, row and column give the same number.
    """
    for i in range(len(out)):
        out[i] = normal(mixed(key, (j << 20) + i))


@njit(cache=True, error_model="numpy")
def _incidence_tables(noise: StructuredLightNoise, more: Float64, lost: Float64) -> None:
    """Write, over the cosine of the angle of incidence, the added deviation [m^1.5] and the share of lost pixels."""
    for i in range(_ANGLES + 1):
        angle = math.acos(i / _ANGLES)
        more[i] = noise.sd_angle * angle * angle / (0.5 * math.pi - min(angle, 1.45)) ** 2
        lost[i] = noise.dropout + max(angle - noise.steep0, 0.0) / (noise.steep1 - noise.steep0)


@njit(cache=True, error_model="numpy")
def _lattice_weights(u: Float64, size: Float64) -> None:
    """Write the positions u (n,) within a cell, and the factors (n, n) that give interpolated noise the variance 1."""
    cell = len(u)
    for i in range(cell):
        u[i] = i / cell
    for i in range(cell):
        for k in range(cell):
            size[i, k] = 1.0 / math.sqrt((u[i] ** 2 + (1 - u[i]) ** 2) * (u[k] ** 2 + (1 - u[k]) ** 2))


@njit(cache=True, error_model="numpy")
def structured_light(
    depth: Float32, slope: Float32, lit: Bool, key: np.uint64, noise: StructuredLightNoise, unit_m: float, out: UInt16
) -> None:
    """Simulate the depth image of a structured-light camera.

    Adds Gaussian depth noise (Nguyen et al. 2012), rounds to whole steps of 1/z, displaces edges, and leaves holes in
    the projector's shadow, at edges and at grazing angles; sources: `mocapella.sources.simulate.depth_noise`.

    Args:
        depth: (h, w) float32 [m], infinite without a surface.
        slope: (h, w) float32 cosine of the angle of incidence.
        lit: (h, w) of `light_reaches`.
        key: key of the image's random numbers.
        noise: the camera's parameters.
        unit_m: length of a unit of the image [m].
        out: (h, w) uint16 depth in units, written, at most 65535; 0 where nothing is measured or the depth is outside
            of the camera's range.
    """
    h, w = depth.shape
    cell, edge, step, lateral = noise.shared_px, noise.edge, noise.step_per_m, noise.edge_px
    one, two, three, four = mixed(key, 1), mixed(key, 2), mixed(key, 3), mixed(key, 4)
    per_step = 1.0 / step if step > 0.0 else 0.0
    own, together, per_unit = math.sqrt(1.0 - noise.shared), math.sqrt(noise.shared), 1.0 / unit_m
    more, lost = np.empty(_ANGLES + 1), np.empty(_ANGLES + 1)
    _incidence_tables(noise, more, lost)
    # Correlated noise: bilinear between the nodes of a lattice, of variance 1 everywhere.
    above, below, blocks = np.empty(w // cell + 2), np.empty(w // cell + 2), np.empty(w // 4 + 1, np.bool_)
    nodes, columns = np.arange(w) // cell, np.arange(w) % cell
    u, size = np.empty(cell), np.empty((cell, cell))
    _lattice_weights(u, size)
    for y in range(h):
        part = y % cell
        if part == 0:
            lattice_row(two, y // cell, above)
            lattice_row(two, y // cell + 1, below)
        if y % 4 == 0:
            for i in range(len(blocks)):
                blocks[i] = uniform(mixed(four, -1 - (y // 4) * w - i)) < 0.25 * noise.dropout
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
                    if uniform(mixed(block, 9)) < noise.edge_holes:
                        continue
            if not near < np.inf or not lit[yy, xx] or blocks[x >> 2]:
                continue
            z, i, at = float(near), int(slope[yy, xx] * np.float32(_ANGLES)), y * w + x
            g = mixed(three, at)
            if float(mixed(four, at) >> np.uint64(40)) < lost[i] * 16777216.0:
                continue
            quantum = step * z * z
            sd = noise.sd_m + noise.sd_per_m * (z - noise.sd_least_at_m) ** 2
            if noise.sd_angle > 0.0:
                sd += more[i] / math.sqrt(z)
            # Rounding adds the variance of the quantisation step.
            sd = math.sqrt(max(sd * sd - quantum * quantum * (1.0 / 12.0), 0.04 * sd * sd))
            k, column = nodes[x], columns[x]
            t = u[column]
            smooth = (1.0 - v) * ((1.0 - t) * above[k] + t * above[k + 1]) + v * (
                (1.0 - t) * below[k] + t * below[k + 1]
            )
            z += sd * (own * normal(g) + together * smooth * size[part, column])
            if step > 0.0:
                z = 1.0 / (step * int(per_step / z + 0.5))
            if noise.least_m <= z <= noise.most_m:
                out[y, x] = min(int(z * per_unit + 0.5), 65535)


@njit(cache=True, error_model="numpy")
def time_of_flight(
    depth: Float32, slope: Float32, key: np.uint64, noise: TimeOfFlightNoise, unit_m: float, out: UInt16
) -> None:
    """Simulate the depth image of a time-of-flight camera.

    Adds depth noise inverse to the amplitude, mixes the phasors of two surfaces at edges (flying pixels), and adds the
    periodic error of the light's odd harmonics; sources: `mocapella.sources.simulate.depth_noise`.

    Args:
        depth: (h, w) float32 [m], infinite without a surface.
        slope: (h, w) float32 cosine of the angle of incidence.
        key: key of the image's random numbers.
        unit_m: length of a unit of the image [m].
        out: (h, w) uint16 depth in units, written; 0 where nothing is measured.
        noise: the camera's parameters.
    """
    h, w = depth.shape
    spread = noise.spread
    one, four = mixed(key, 1), mixed(key, 4)
    turn = 4.0 * math.pi * noise.low_hz / _LIGHT_M_S
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
            if rough:  # light of the near and the far surface adds up in the pixel
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
            if strength < noise.faintest or uniform(mixed(four, at)) < noise.dropout:
                continue
            if rough:
                phase = math.atan2(im, re)
                z = (phase if phase >= 0.0 else phase + 2.0 * math.pi) / turn
            z += noise.wiggle_m * math.sin(16.0 * math.pi * noise.wiggle_hz * z / _LIGHT_M_S)
            z += noise.sd_at_1m / strength * normal(mixed(one, at))
            if noise.least_m <= z <= noise.most_m:
                out[y, x] = min(int(z / unit_m + 0.5), 65535)
