"""Learn marker colours from clicks: one on every marker, one on skin, and optional images without markers.

A region of similar colour is grown around a click. Its edge, which mixes with the background, is left out, and outliers
of colour are trimmed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mocapella.errors import InputError, SettingsError
from mocapella.sensing.colour_profile import (
    BINS,
    SKIN,
    SPAN,
    BackgroundColours,
    CameraControls,
    Chromaticities,
    Colour,
    ColourProfile,
    brightness,
    chromaticity,
)  # fmt: skip

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

LIKE: Final = 0.3
"""Greatest distance of a region's pixels from the line through grey and its median colour, in u and v."""
LEAST_PX: Final = 12
LARGEST_SHARE: Final = 0.1
COLOURLESS: Final = 0.25
"""Least chromaticity of a colour, as distance from grey."""
LARGEST_RATIO: Final = 20.0
"""Largest area of a marker's region over the median of the other markers' regions."""
_SEED_PX: Final = 4
_EDGE_PX: Final = 8
"""Margin around markers that is not learnt as background."""


@dataclass(frozen=True)
class ColourSample:
    """An image, and the clicks in it.

    Attributes:
        image: (height, width, 3) uint8 blue, green, red.
        clicks: x, y [px] by the marker's name; ``skin`` for skin.
    """

    image: UInt8
    clicks: Mapping[str, tuple[float, float]]


def learn_colours(
    camera: str,
    samples: Sequence[ColourSample],
    *,
    backgrounds: Sequence[UInt8] = (),
    controls: CameraControls | None = None,
) -> ColourProfile:
    """Return a profile of the clicked colours; labels follow the first occurrences of the names.

    Args:
        camera: its name.
        samples: images and clicks; a name may be in several images.
        backgrounds: images without markers; the background is learnt from these, and from ``samples`` off the markers.
        controls: values of the camera's controls, stored in the profile; None stores no value.

    Raises:
        InputError: a click that cannot be learnt from; names it and says where to click.
        SettingsError: no click on a marker, images of different sizes, or not (height, width, 3) uint8.
    """
    images = [sample.image for sample in samples] + list(backgrounds)
    if not any(name != SKIN for sample in samples for name in sample.clicks):
        raise SettingsError("no marker was pointed at; click on the middle of every marker once")
    for image in images:
        check_image(image)
        if image.shape != images[0].shape:
            raise SettingsError("the images to learn from differ in size; take them all from one camera, set alike")
    pixels: dict[str, list[UInt8]] = {}
    areas: dict[str, list[int]] = {}
    apart: list[tuple[UInt8, Mask]] = []
    for sample in samples:
        marked = np.zeros(sample.image.shape[:2], np.bool_)
        for name, click in sample.clicks.items():
            region = grow(sample.image, click, name)
            inner = inside(region)
            if inner.sum() < LEAST_PX:
                raise InputError(
                    f"only {inner.sum()} pixels of one colour are there", field=name, value=click,
                    fix=f"click on the middle of the marker, and bring it nearer: {LEAST_PX} pixels are needed",
                )  # fmt: skip
            pixels.setdefault(name, []).append(sample.image[inner])
            areas.setdefault(name, []).append(int(region.sum()))
            if name != SKIN:
                marked |= region
        apart.append((sample.image, ~ndimage.binary_dilation(marked, iterations=_EDGE_PX)))
    _refuse_leaks({name: click for sample in samples for name, click in sample.clicks.items()}, areas)
    learnt = {name: learn(np.concatenate(found)) for name, found in pixels.items()}
    colours = tuple(Colour(k, seen, float(np.median(areas[k]))) for k, seen in learnt.items() if k != SKIN)
    apart += [(image, np.ones(image.shape[:2], np.bool_)) for image in backgrounds]
    background = learn_background(apart)
    height, width = images[0].shape[:2]
    return ColourProfile(camera, (width, height), colours, background, learnt.get(SKIN), controls or CameraControls())


def _refuse_leaks(clicks: Mapping[str, tuple[float, float]], areas: Mapping[str, Sequence[int]]) -> None:
    """Refuse a region that is far larger than the other markers', because it has grown into the background.

    Args:
        clicks: x, y [px] by the marker's name, for the error.
        areas: areas of the regions around the clicks by name [px²].

    Raises:
        InputError: a marker's region is more than `LARGEST_RATIO` times as large as the median of two others or more.
    """
    sizes = {name: float(np.median(found)) for name, found in areas.items() if name != SKIN}
    for name, size in sizes.items():
        others = [other for marker, other in sizes.items() if marker != name]
        if len(others) >= 2 and size > LARGEST_RATIO * float(np.median(others)):
            raise InputError(
                f"the like-coloured region there is {size / float(np.median(others)):.0f} times as large as those of "
                "the other markers", field=name, value=clicks[name],
                fix="move the hand before something of another colour, and click again; or choose another colour",
            )  # fmt: skip


def check_image(image: Any) -> None:
    """Check that an image has three 8-bit channels; return nothing.

    Raises:
        SettingsError: it is another array or object; states its type and shape.
    """
    if not (isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3):
        what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise SettingsError(f"the image is {what}; it must be uint8 (height, width, 3): blue, green, red")


def grow(image: UInt8, click: tuple[float, float], name: str) -> Mask:
    """Segment the region of similar colour around a click.

    Args:
        image: (height, width, 3) uint8 blue, green, red.
        click: x, y [px]; the region grows from the most saturated pixel of the clicked hue within 4 px.
        name: the marker's name, used in errors; `SKIN` grows from the clicked pixel, of any colour and to any size.

    Returns:
        (height, width) bool, with filled holes.

    Raises:
        InputError: the click is outside, on a pixel without colour, or the region is empty or too large.
    """
    height, width = image.shape[:2]
    x, y = round(click[0]), round(click[1])
    if not (0 <= x < width and 0 <= y < height):
        fix = f"click into the image, which is {width} × {height} px"
        raise InputError("lies outside the image", field=name, value=click, fix=fix)
    at, light = _smooth(chromaticity(image), x, y), brightness(image)
    middle, luma = _seed(at, light, x, y, strongest=name != SKIN)
    if name != SKIN and np.linalg.norm(middle) < COLOURLESS:
        fix = "click on the coloured middle of the marker, beside a reflection"
        raise InputError("has hardly any colour there", field=name, value=click, fix=fix)
    at = chromaticity(image)
    region: Mask = np.zeros((height, width), np.bool_)
    for _ in range(2):
        like = _like(at, middle) & (light > 0.4 * luma) & (light < 2.5 * luma)
        labels, _ = ndimage.label(like)
        near = labels[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5]
        near = near[near > 0]
        if not len(near):
            fix = "click on the middle of the marker"
            raise InputError("no pixels of one colour are there", field=name, value=click, fix=fix)
        region = labels == np.bincount(near).argmax()
        middle = np.median(at[region], axis=0)
    if name != SKIN and region.mean() > LARGEST_SHARE:
        raise InputError(
            f"the like-coloured region there covers {100 * region.mean():.0f} % of the image", field=name, value=click,
            fix="click on the marker; if it was, its colour is that of what is behind it: choose another colour",
        )  # fmt: skip
    return np.asarray(ndimage.binary_fill_holes(region))


def _smooth(at: Float64, x: int, y: int) -> Float64:
    """Apply a 5 × 5 median near the seed only."""
    out = at.copy()
    part = (slice(max(y - 2 * _SEED_PX, 0), y + 2 * _SEED_PX), slice(max(x - 2 * _SEED_PX, 0), x + 2 * _SEED_PX))
    for k in range(2):
        out[(*part, k)] = ndimage.median_filter(at[(*part, k)], 5)
    return out


def _seed(at: Float64, light: Float64, x: int, y: int, *, strongest: bool) -> tuple[Float64, float]:
    """Return the chromaticity and luma to grow from: the clicked pixel's, or the strongest nearby of its hue."""
    part = (slice(max(y - _SEED_PX, 0), y + _SEED_PX + 1), slice(max(x - _SEED_PX, 0), x + _SEED_PX + 1))
    clicked, near = at[y, x], at[part].reshape(-1, 2)
    strength = np.linalg.norm(near, axis=-1)
    cosine = near @ clicked / np.maximum(strength * np.linalg.norm(clicked), 1e-9)
    strength[cosine < 0.9] = -1.0
    best = int(np.argmax(strength))
    if not strongest or strength[best] < 0:
        return clicked, float(light[y, x])
    return near[best], float(light[part].reshape(-1)[best])


def _like(at: Float64, middle: Float64) -> Mask:
    """Return which chromaticities are near a median, or between it and white, as in reflections."""
    size = max(float(np.linalg.norm(middle)), 1e-9)
    along = at @ middle / size
    across = np.abs(at @ np.array([-middle[1], middle[0]]) / size)
    return np.asarray((across < LIKE) & (along > min(0.5 * size, size - LIKE)) & (along < size + max(LIKE, 0.3 * size)))


def inside(region: Mask) -> Mask:
    """Return a region (height, width) without its edge of two pixels, or of one if fewer than `LEAST_PX` would be left.

    The edge's colours mix with the background. The result may be empty.
    """
    inner = np.asarray(ndimage.binary_erosion(region, iterations=2))
    return inner if inner.sum() >= LEAST_PX else np.asarray(ndimage.binary_erosion(region))


def learn(bgr: UInt8) -> Chromaticities:
    """Fit the distribution of one colour to pixels (n, 3) blue, green, red, and return it.

    Outliers, such as pixels in reflections, are trimmed: those farther from the mean chromaticity than three standard
    deviations. The result's ``pixels`` is the number of pixels that are kept.
    """
    at, luma = chromaticity(bgr), brightness(bgr)
    kept = np.ones(len(at), np.bool_)
    centre = np.median(at, axis=0)
    near = np.linalg.norm(at - centre, axis=-1)
    kept = near <= 3 * max(float(np.median(near)), 0.02)
    for _ in range(3):
        mean, covariance = at[kept].mean(axis=0), np.cov(at[kept].T) + 1e-4 * np.eye(2)
        off = at - mean
        kept = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off) <= 9.0
    low, middle, high = np.percentile(luma[kept], (5, 50, 95))
    return Chromaticities(
        (float(mean[0]), float(mean[1])),
        (float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])),
        (float(low), float(middle), float(high)),
        int(kept.sum()),
    )


def learn_background(images: Sequence[tuple[UInt8, Mask]]) -> BackgroundColours:
    """Return the histogram and the light of the images' pixels in their masks, which exclude the markers.

    The histogram counts means of 3 × 3 pixels, which suppress the noise of single pixels but not marker-sized objects.

    Args:
        images: (height, width, 3) uint8 blue, green, red, each with its mask (height, width) bool of the background.
    """
    counts = np.zeros((BINS, BINS))
    for image, mask in images:
        smooth = np.stack([ndimage.uniform_filter(image[..., k].astype(np.float64), 3) for k in range(3)], axis=-1)
        at = chromaticity(smooth[mask])
        counts += np.histogram2d(at[:, 0], at[:, 1], bins=BINS, range=((-SPAN, SPAN), (-SPAN, SPAN)))[0]
    luma, u, v = light_of(np.concatenate([image[mask] for image, mask in images]))
    return BackgroundColours(tuple(tuple(int(n) for n in row) for row in counts), luma, (u, v))


def light_of(bgr: UInt8) -> tuple[float, float, float]:
    """Measure the light: return the medians of luma (0 to 255) and of chromaticities u and v of pixels (..., 3) BGR.

    The chromaticities are logarithmic, as `colour_profile` defines them.
    """
    flat = bgr.reshape(-1, 3)
    u, v = np.median(chromaticity(flat), axis=0)
    return float(np.median(brightness(flat))), float(u), float(v)
