"""Procedural noise for textures, compiled; importing this module imports numba.

Value noise: random numbers at the points of a grid, smoothly interpolated between them, and sums of octaves, each of
half the period and strength (D. Ebert et al., *Texturing and Modeling*, 3rd ed., 2003, chapter 2).
"""

from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit


@njit(cache=True, nogil=True, inline="always")
def hashed(i: int, j: int, k: int) -> float:
    """Hash three integers to a pseudorandom number from 0 to 1: MurmurHash3's finaliser over a sum of multiples."""
    x = (
        np.uint32(i) * np.uint32(0x8DA6B343)
        + np.uint32(j) * np.uint32(0xD8163841)
        + np.uint32(k) * np.uint32(0xCB1AB31F)
    )
    x = np.uint32(x)
    x = np.uint32(x ^ (x >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    x = np.uint32(x)
    x = np.uint32(x ^ (x >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    x = np.uint32(x)
    x = np.uint32(x ^ (x >> np.uint32(16)))
    return float(x) / 4294967296.0


@njit(cache=True, nogil=True)
def noise2(x: float, y: float, seed: int) -> float:
    """Return value noise at (x, y), from 0 to 1, smooth over a grid of cells of length 1."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    a = hashed(i, j, seed) * (1.0 - u) + hashed(i + 1, j, seed) * u
    b = hashed(i, j + 1, seed) * (1.0 - u) + hashed(i + 1, j + 1, seed) * u
    return float(a * (1.0 - v) + b * v)


@njit(cache=True, nogil=True)
def noise3(x: float, y: float, z: float, seed: int) -> float:
    """Return value noise at (x, y, z), from 0 to 1, smooth over a grid of cells of length 1."""
    k = math.floor(z)
    w = z - k
    w = w * w * (3.0 - 2.0 * w)
    return float(noise2(x, y, seed + 131 * k) * (1.0 - w) + noise2(x, y, seed + 131 * (k + 1)) * w)


@njit(cache=True, nogil=True)
def rough2(x: float, y: float, seed: int) -> float:
    """Return the weighted sum of four octaves of `noise2` at (x, y), from 0 to 1; the coarsest has cells of 1."""
    total, share = 0.0, 0.5
    for octave in range(4):
        total += share * noise2(x, y, seed + octave)
        x, y, share = 2.03 * x + 17.3, 2.03 * y + 5.9, 0.5 * share
    return total / 0.9375
