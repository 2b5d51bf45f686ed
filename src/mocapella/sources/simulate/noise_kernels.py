"""Noise that is a function of place, for textures; compiled. Importing this module imports numba.

Value noise: random numbers at the points of a grid, between them smoothly interpolated, and sums of such noises of
halved period and strength (D. Ebert et al., *Texturing and Modeling*, 3rd ed., 2003, chapter 2).
"""

from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit


@njit(cache=True, nogil=True, inline="always")
def hashed(i, j, k):
    """A number from 0 to 1 for three whole numbers: the finaliser of MurmurHash3 over a sum of multiples."""
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
def noise2(x, y, seed):
    """From 0 to 1, of period 1."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    a = hashed(i, j, seed) * (1.0 - u) + hashed(i + 1, j, seed) * u
    b = hashed(i, j + 1, seed) * (1.0 - u) + hashed(i + 1, j + 1, seed) * u
    return a * (1.0 - v) + b * v


@njit(cache=True, nogil=True)
def noise3(x, y, z, seed):
    """From 0 to 1, of period 1."""
    k = math.floor(z)
    w = z - k
    w = w * w * (3.0 - 2.0 * w)
    return noise2(x, y, seed + 131 * k) * (1.0 - w) + noise2(x, y, seed + 131 * (k + 1)) * w


@njit(cache=True, nogil=True)
def rough2(x, y, seed):
    """Four octaves of `noise2`, from 0 to 1."""
    total, share = 0.0, 0.5
    for octave in range(4):
        total += share * noise2(x, y, seed + octave)
        x, y, share = 2.03 * x + 17.3, 2.03 * y + 5.9, 0.5 * share
    return total / 0.9375
