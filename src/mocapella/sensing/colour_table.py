"""Classify colours by likelihood ratio: a look-up table of a profile, and the separability of its colours.

A cell of 8 × 8 × 8 values gets a colour's label if the colour is likelier than the background and any other colour, by
the margins. The background is a mixture: its histogram, skin, skin in specular light (between skin and white), and a
uniform density. The noise of dark or clipped pixels widens a colour's covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mocapella.sensing.colour_profile import (
    BINS,
    OFFSET,
    SPAN,
    Chromaticities,
    ColourProfile,
    brightness,
    chromaticity,
)  # fmt: skip
from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

CELLS: Final = 32
CELL: Final = 256 // CELLS
_ANYTHING: Final = 1 / (2 * SPAN) ** 2
_GLANCES: Final = (0.25, 0.5, 0.75, 1.0, 1.2)
"""Positions of skin in and out of reflections, from white (0) through skin as learnt (1)."""


@dataclass(frozen=True)
class TableSettings:
    """Margins of the classification, in chromaticities u and v as `colour_profile` defines them.

    Attributes:
        margin: least likelihood ratio to the background.
        margin_of_others: least likelihood ratio to any other colour.
        light_sd: standard deviation of u and v caused by changes of the light.
        value_sd: noise of a pixel's 8-bit values, including a cell's width.
        brightness_range: greatest factor between a colour's brightness and the learnt one, in 8-bit values.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    margin: float = 3.0
    margin_of_others: float = 2.0
    light_sd: float = 0.08
    value_sd: float = 4.0
    brightness_range: float = 2.2

    def __post_init__(self) -> None:
        check(1 <= self.margin <= 1e6, "margin", self.margin, "from 1 to 1000000")
        check(1 <= self.margin_of_others <= 1e6, "margin_of_others", self.margin_of_others, "from 1 to 1000000")
        check(0 <= self.light_sd <= 2, "light_sd", self.light_sd, "from 0 to 2")
        check(0.1 <= self.value_sd <= 50, "value_sd", self.value_sd, "from 0.1 to 50")
        check(1 <= self.brightness_range <= 100, "brightness_range", self.brightness_range, "from 1 to 100")


@dataclass(frozen=True)
class Separability:
    """Separability of colours from each other and from the background.

    Attributes:
        kept: share of pixels drawn from each colour's distribution that get its label, by name.
        in_background: share of the background's pixels within 2 standard deviations of each colour, by name.
        distances: (colours, colours) Mahalanobis distances between the colours' means [standard deviations].
        problems: sentences that name a problem and suggest a remedy; empty if there are none.
    """

    kept: dict[str, float]
    in_background: dict[str, float]
    distances: Float64
    problems: tuple[str, ...]


def lookup_table(profile: ColourProfile, settings: TableSettings | None = None, *, near_px: float = 0.0) -> UInt8:
    """Return (32768,) labels of cells (b >> 3) | (g >> 3) << 5 | (r >> 3) << 10: 0 for none, k for the k-th colour.

    A cell is classified by its middle; k counts from 1.

    Args:
        profile: the colours of the markers and of the background.
        settings: margins of the classification; the defaults if None.
        near_px: as in `classify`.
    """
    values = (np.arange(CELLS) + 0.5) * CELL - 0.5
    red, green, blue = np.meshgrid(values, values, values, indexing="ij")
    return classify(profile, np.stack([blue, green, red], axis=-1).reshape(-1, 3), settings, near_px=near_px)


def cell_of(bgr: NDArray[Any]) -> NDArray[np.int64]:
    """Quantise pixels (..., 3) uint8 blue, green, red to 5 bits each; return the indices (...) of `lookup_table`."""
    cell = np.asarray(bgr).astype(np.int64) // CELL
    return np.asarray(cell[..., 0] + CELLS * cell[..., 1] + CELLS * CELLS * cell[..., 2])


def classify(
    profile: ColourProfile, bgr: NDArray[Any], settings: TableSettings | None = None, *, near_px: float = 0.0
) -> UInt8:
    """Return (...) uint8 labels of pixels (..., 3) blue, green, red, 0 … 255: 0 for none, k ≥ 1 for the k-th colour.

    Args:
        profile: the colours of the markers and of the background.
        bgr: (..., 3) pixels, of any number type.
        settings: margins of the classification; the defaults if None.
        near_px: side of a window that the marker is known to be in [px]; 0 for the whole image. A window has a small
            part of the scene's background, which counts by the window's share of the image.
    """
    s = settings or TableSettings()
    values = np.asarray(bgr, np.float64)
    at, luma, noise = chromaticity(values), brightness(values), _noise(values, s)
    likely = np.stack([gaussian(at, colour.seen, noise) for colour in profile.colours], axis=-1)
    for k, colour in enumerate(profile.colours):
        low, _, high = colour.seen.luma
        likely[..., k] *= (luma >= low / s.brightness_range) & (luma <= high * s.brightness_range)
    best = np.argmax(likely, axis=-1)
    top = np.take_along_axis(likely, best[..., None], axis=-1)[..., 0]
    np.put_along_axis(likely, best[..., None], 0.0, axis=-1)
    areas = np.array([colour.area_px for colour in profile.colours])[best]
    if near_px > 0:
        areas = areas * max(profile.size_px[0] * profile.size_px[1] / near_px**2, 1.0)
    sure = (top > s.margin * no_marker(profile, at, noise, areas)) & (top > s.margin_of_others * likely.max(axis=-1))
    return np.where(sure, best + 1, 0).astype(np.uint8)


def _noise(values: Float64, s: TableSettings) -> Float64:
    """Return (..., 3) variances uu, uv, vv of the chromaticity of 8-bit values; large for clipped ones."""
    sd = np.where(values >= 256 - CELL, 10 * s.value_sd, s.value_sd)
    blue, green, red = np.moveaxis((sd / (values + OFFSET)) ** 2, -1, 0)
    light = s.light_sd**2
    return np.stack([red + green + light, green, blue + green + light], axis=-1)


def gaussian(at: Float64, seen: Chromaticities, noise: Float64 | float = 0.0) -> Float64:
    """Return the Gaussian density (...) of a colour at chromaticities (..., 2).

    Args:
        at: (..., 2) u and v.
        seen: the colour's distribution.
        noise: (..., 3) added to its covariance uu, uv, vv.
    """
    uu, uv, vv = np.moveaxis(np.asarray(seen.covariance) + noise, -1, 0)
    x, y = np.moveaxis(at - np.asarray(seen.mean), -1, 0)
    det = uu * vv - uv * uv
    return np.asarray(np.exp(-0.5 * (vv * x * x - 2 * uv * x * y + uu * y * y) / det) / (2 * np.pi * np.sqrt(det)))


def no_marker(profile: ColourProfile, at: Float64, noise: Float64, areas_px: Float64) -> Float64:
    """Return the density (...) of the background's colours at chromaticities, for the likelihood ratio to a marker.

    It is a mixture of the scene's histogram, skin, if learnt, and a uniform density. The histogram is in units of the
    marker's area, so that a background object as large as the marker has the integral 1, like the marker's density.

    Args:
        profile: the background's colours.
        at: (..., 2) u and v.
        noise: (..., 3) added to the covariances uu, uv, vv.
        areas_px: (...) area of the marker [px²].
    """
    counts = np.array(profile.background.counts, np.float64)
    per_image = profile.size_px[0] * profile.size_px[1] / max(counts.sum(), 1)
    bin_width = 2 * SPAN / BINS
    density = ndimage.gaussian_filter(counts, 0.7, mode="constant") * per_image / bin_width**2
    places = np.moveaxis((at + SPAN) / bin_width - 0.5, -1, 0)
    wall = ndimage.map_coordinates(density, places, order=1, mode="nearest") / areas_px
    if profile.skin is None:
        return np.asarray(wall + 0.5 * _ANYTHING)
    u, v = profile.skin.mean
    skin = np.mean([
        gaussian(at, Chromaticities((t * u, t * v), profile.skin.covariance, profile.skin.luma, 1), noise)
        for t in _GLANCES
    ], axis=0)  # fmt: skip
    return np.asarray(wall + 0.25 * skin + 0.25 * _ANYTHING)


def separability(profile: ColourProfile, settings: TableSettings | None = None) -> Separability:
    """Return the separability of a profile's colours, and their problems, so that users can choose better colours.

    Args:
        profile: the colours of the markers and of the background.
        settings: margins of the classification; the defaults if None.
    """
    s = settings or TableSettings()
    count, names = len(profile.colours), profile.names
    distances = np.zeros((count, count))
    for i, a in enumerate(profile.colours):
        for j, b in enumerate(profile.colours):
            uu, uv, vv = (np.array(a.seen.covariance) + np.array(b.seen.covariance)) / 2 + s.light_sd**2 * _UNIT
            apart = np.array(a.seen.mean) - np.array(b.seen.mean)
            distances[i, j] = np.sqrt(apart @ np.linalg.solve([[uu, uv], [uv, vv]], apart))
    kept = {name: _kept(profile, k, s) for k, name in enumerate(names)}
    background = {name: _in_background(profile, k, s) for k, name in enumerate(names)}
    problems = []
    for i in range(count):
        for j in range(i):
            if distances[i, j] < TOO_ALIKE:
                problems.append(
                    f"{names[j]} and {names[i]} are too alike ({distances[i, j]:.1f} standard deviations apart, "
                    f"{TOO_ALIKE:g} are needed): choose another colour for one of them"
                )
    for name, share in background.items():
        if share > IN_BACKGROUND:
            problems.append(
                f"{name} is in the background too, {100 * share:.1f} % of it: choose another colour, or cover it"
            )
    for name, share in kept.items():
        if share < KEPT:
            problems.append(
                f"only {100 * share:.0f} % of what was pointed at as {name} can be told from the rest: choose a "
                "stronger colour, or more light"
            )
    return Separability(kept, background, distances, tuple(problems))


TOO_ALIKE: Final = 4.0
IN_BACKGROUND: Final = 0.003
KEPT: Final = 0.8
_UNIT: Final = np.array([1.0, 0.0, 1.0])


def _kept(profile: ColourProfile, k: int, s: TableSettings) -> float:
    """Return the share of pixels drawn from colour k, at its median brightness, that are labelled k."""
    seen = profile.colours[k].seen
    uu, uv, vv = seen.covariance
    draws = np.random.default_rng(0).multivariate_normal(seen.mean, [[uu, uv], [uv, vv]], 2000)
    return float((classify(profile, _values(draws, seen.luma[1]), s) == k + 1).mean())


def _in_background(profile: ColourProfile, k: int, s: TableSettings) -> float:
    """Return the share of the background within 2 standard deviations of colour k, including changes of the light."""
    counts = np.array(profile.background.counts, np.float64)
    middles = (np.arange(BINS) + 0.5) * 2 * SPAN / BINS - SPAN
    at = np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1)
    seen, light = profile.colours[k].seen, s.light_sd**2 * _UNIT
    near = gaussian(at, seen, light) > np.exp(-2.0) * gaussian(np.array(seen.mean), seen, light)
    return float((counts * near).sum() / max(counts.sum(), 1))


def _values(at: Float64, luma: float) -> Float64:
    """Return (n, 3) blue, green, red of chromaticities (n, 2) at a luma."""
    ratios = np.stack([np.exp(at[:, 1]), np.ones(len(at)), np.exp(at[:, 0])], axis=-1)
    green = (luma + OFFSET) / brightness(ratios)
    return np.asarray(np.clip(ratios * green[:, None] - OFFSET, 0, 255))
