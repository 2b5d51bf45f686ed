"""Simulate a cheap colour camera on a clean image: blur, Bayer mosaic, noise, gains, gamma, tone, chroma subsampling.

The input is linear light on the sensor; 1 is a white surface in full light. The output is the 8-bit image that a
program receives. All renderers of colour images share these imperfections.

Noise: photon noise, whose variance grows with the signal, and read noise, which does not, before demosaicking (EMVA
standard 1288, section 2). Demosaicking is bilinear, so that noise and chroma are smeared over neighbours, too.
Gamma is that of sRGB (IEC 61966-2-1). Chroma is averaged over 2 × 2 pixels (4:2:0), as JPEG and most video do; the
coding itself (blocks of 8 × 8) is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class CameraImageSettings:
    """Parameters of a simulated colour camera.

    Attributes:
        exposure: signal of white in full light, relative to full scale; above 1 white clips.
        lens_blur_px: standard deviation of the lens' blur [px].
        photons: number of electrons at full scale; fewer give more photon noise.
        read_noise: standard deviation of the read noise, relative to full scale.
        bayer: whether the sensor has one colour per pixel (RGGB).
        white_balance: gains of (red, green, blue) after the sensor.
        saturation: factor of a colour's distance from grey; 1 keeps colours.
        shared_chroma: whether 2 × 2 pixels share their chroma.
        gain: amplification of the signal and its noise before it is digitised; bright light clips earlier.
        contrast: factor of an 8-bit value's distance from the middle, 127.5, after the gamma.
        brightness: added to the 8-bit values, after the contrast.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    exposure: float = 0.8
    lens_blur_px: float = 0.6
    photons: float = 6000.0
    read_noise: float = 0.004
    bayer: bool = True
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    shared_chroma: bool = True
    gain: float = 1.0
    contrast: float = 1.0
    brightness: float = 0.0

    def __post_init__(self) -> None:
        check(0.01 <= self.exposure <= 100, "exposure", self.exposure, "from 0.01 to 100")
        check(0 <= self.lens_blur_px <= 5, "lens_blur_px", self.lens_blur_px, "from 0 to 5 px")
        check(10 <= self.photons <= 1e6, "photons", self.photons, "from 10 to 1000000")
        check(0 <= self.read_noise <= 0.2, "read_noise", self.read_noise, "from 0 to 0.2")
        check(all(0.1 <= g <= 10 for g in self.white_balance), "white_balance", self.white_balance, "from 0.1 to 10")
        check(0 <= self.saturation <= 3, "saturation", self.saturation, "from 0 to 3")
        check(1 <= self.gain <= 100, "gain", self.gain, "from 1 to 100")
        check(0 <= self.contrast <= 10, "contrast", self.contrast, "from 0 to 10")
        check(-255 <= self.brightness <= 255, "brightness", self.brightness, "from -255 to 255")


def camera_image(linear: Float32, settings: CameraImageSettings, rng: np.random.Generator) -> UInt8:
    """Convert linear light to the camera's image.

    Args:
        linear: (height, width, 3) linear light, red, green, blue, 0 or more; even height and width. Not changed.
        settings: parameters of the camera.
        rng: random numbers of the noise; the same state gives the same image to the bit.

    Returns:
        (height, width, 3) uint8 BGR.

    Raises:
        SettingsError: the height or the width is odd.
    """
    height, width = linear.shape[:2]
    check(height % 2 == 0 and width % 2 == 0, "size of the picture", (width, height), "even")
    noise = rng.standard_normal((height, width), dtype=np.float32)
    image = np.empty((height, width, 3), np.uint8)
    s = settings
    sensor = _kernels().ImageSensor(
        float(s.exposure * s.gain), float(s.photons / s.gain), float(s.read_noise * s.gain), bool(s.bayer),
        np.array(s.white_balance, dtype=np.float64), float(s.saturation), bool(s.shared_chroma),
    )  # fmt: skip
    _kernels().expose(np.ascontiguousarray(linear, np.float32), noise, _taps(s.lens_blur_px), sensor, _tone(s), image)
    return image


@cache
def _taps(sd_px: float) -> Float32:
    """One side of a normalised Gaussian, centre first."""
    reach = max(1, int(np.ceil(3 * sd_px)))
    taps = np.exp(-0.5 * (np.arange(reach + 1) / max(sd_px, 1e-3)) ** 2)
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()), np.float32)


def _tone(s: CameraImageSettings) -> Float32:
    """Table (4097,) of 8-bit values for linear 0 … 1: gamma, then contrast and brightness."""
    if s.contrast == 1 and s.brightness == 0:
        return _gamma()
    toned = np.clip(s.contrast * (_gamma() - 127.5) + 127.5 + s.brightness, 0, 255)
    return np.asarray(toned, np.float32)


@cache
def _gamma() -> Float32:
    """Table (4097,) of sRGB's 8-bit values for linear 0 … 1."""
    x = np.linspace(0, 1, 4097)
    coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(255 * coded, np.float32)


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import camera_image_kernels

    return camera_image_kernels
