"""Compiled kernels of `mocapella.sources.simulate.camera_image`; importing this module imports numba.

One pass applies blur, mosaic, noise, demosaicking, gain, gamma and chroma subsampling.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: loops are written out
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


class ImageSensor(NamedTuple):
    """The parameters of `CameraImageSettings` that apply to single pixels, by the same names and in the same units.

    ``white_balance`` is an array (3,): red, green, blue.
    """

    exposure: float
    photons: float
    read_noise: float
    bayer: bool
    white_balance: Float64
    saturation: float
    shared_chroma: bool


@njit(cache=True, nogil=True)
def blurred(x: Float32, taps: Float32) -> Float32:
    """Return an image x (h, w, 3), convolved with a symmetric kernel along rows and columns; the border is repeated.

    ``taps`` (n,) is one side of the kernel, its centre first.
    """
    h, w, _ = x.shape
    half, out = np.empty_like(x), np.empty_like(x)
    for r in range(h):
        for c in range(w):
            for k in range(3):
                s = taps[0] * x[r, c, k]
                for d in range(1, len(taps)):
                    s += taps[d] * (x[r, max(c - d, 0), k] + x[r, min(c + d, w - 1), k])
                half[r, c, k] = s
    for r in range(h):
        for c in range(w):
            for k in range(3):
                s = taps[0] * half[r, c, k]
                for d in range(1, len(taps)):
                    s += taps[d] * (half[max(r - d, 0), c, k] + half[min(r + d, h - 1), c, k])
                out[r, c, k] = s
    return out


@njit(cache=True, nogil=True)
def demosaicked(raw: Float32) -> Float32:
    """Demosaic a raw image (h, w) with an RGGB mosaic to red, green, blue (h, w, 3), bilinearly.

    A missing colour is the mean of the 3 × 3 neighbours that have it.
    """
    h, w = raw.shape
    out = np.empty((h, w, 3), np.float32)
    for r in range(h):
        for c in range(w):
            for k in range(3):
                s, n = np.float32(0.0), 0
                own = (r % 2) + (c % 2)
                if own == k:
                    out[r, c, k] = raw[r, c]
                    continue
                for i in range(max(r - 1, 0), min(r + 2, h)):
                    for j in range(max(c - 1, 0), min(c + 2, w)):
                        if (i % 2) + (j % 2) == k:
                            s += raw[i, j]
                            n += 1
                out[r, c, k] = s / n
    return out


@njit(cache=True, nogil=True)
def expose(linear: Float32, noise: Float32, taps: Float32, sensor: ImageSensor, gamma: Float32, image: UInt8) -> None:
    """Convert linear light to a camera's image.

    Args:
        linear: (h, w, 3) float32 red, green, blue; even h and w.
        noise: (h, w) float32 standard normal numbers.
        taps: (n,) kernel of the lens' blur, see `blurred`.
        sensor: parameters of the camera.
        gamma: (n,) float32 8-bit values, from 0 to 255, for linear light from 0 to 1.
        image: (h, w, 3) uint8 BGR, written.
    """
    h, w, _ = linear.shape
    exposure, photons, read_noise = sensor.exposure, sensor.photons, sensor.read_noise
    white_balance, saturation = sensor.white_balance, sensor.saturation
    light = blurred(linear, taps) if taps[0] < 0.999 else linear
    if sensor.bayer:
        raw = np.empty((h, w), np.float32)
        for r in range(h):
            for c in range(w):
                s = exposure * light[r, c, (r % 2) + (c % 2)]
                s += noise[r, c] * np.sqrt(read_noise * read_noise + max(s, 0.0) / photons)
                raw[r, c] = min(max(s, 0.0), 1.0)
        seen = demosaicked(raw)
    else:
        seen = np.empty((h, w, 3), np.float32)
        for r in range(h):
            for c in range(w):
                for k in range(3):
                    s = exposure * light[r, c, k]
                    s += noise[r, (c + 7 * k) % w] * np.sqrt(read_noise * read_noise + max(s, 0.0) / photons)
                    seen[r, c, k] = min(max(s, 0.0), 1.0)
    coded, top = np.empty((h, w, 3), np.float32), len(gamma) - 1
    for r in range(h):
        for c in range(w):
            red, green, blue = (
                white_balance[0] * seen[r, c, 0],
                white_balance[1] * seen[r, c, 1],
                white_balance[2] * seen[r, c, 2],
            )
            grey = 0.2126 * red + 0.7152 * green + 0.0722 * blue
            coded[r, c, 0] = gamma[int(top * min(max(grey + saturation * (red - grey), 0.0), 1.0))]
            coded[r, c, 1] = gamma[int(top * min(max(grey + saturation * (green - grey), 0.0), 1.0))]
            coded[r, c, 2] = gamma[int(top * min(max(grey + saturation * (blue - grey), 0.0), 1.0))]
    for r in range(0, h, 2):
        for c in range(0, w, 2):
            u = v = 0.0  # blue and red minus the luma of ITU-R BT.601
            for i in range(r, r + 2):
                for j in range(c, c + 2):
                    y = 0.299 * coded[i, j, 0] + 0.587 * coded[i, j, 1] + 0.114 * coded[i, j, 2]
                    u += 0.25 * (coded[i, j, 2] - y)
                    v += 0.25 * (coded[i, j, 0] - y)
            for i in range(r, r + 2):
                for j in range(c, c + 2):
                    y = 0.299 * coded[i, j, 0] + 0.587 * coded[i, j, 1] + 0.114 * coded[i, j, 2]
                    if not sensor.shared_chroma:
                        u, v = coded[i, j, 2] - y, coded[i, j, 0] - y
                    image[i, j, 0] = np.uint8(min(max(y + u + 0.5, 0.0), 255.0))
                    image[i, j, 1] = np.uint8(min(max(y - (0.114 * u + 0.299 * v) / 0.587 + 0.5, 0.0), 255.0))
                    image[i, j, 2] = np.uint8(min(max(y + v + 0.5, 0.0), 255.0))
