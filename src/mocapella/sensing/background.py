"""Contours by background subtraction: the simple alternative to `region_contour`.

Shadows are recognised by their colour, the background's with less light (T. Horprasert, D. Harwood, L. Davis,
A Statistical Approach for Real-time Robust Background Subtraction and Shadow Detection, 1999); in gray images they
cannot be distinguished from dark clothes, and count as foreground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.region_contour import (
    DEFAULT,
    HALF_LEVELS,
    Band,
    RegionContour,
    RegionSettings,
    cost_kernels,
    read_band,
    reading,
    settle,
)
from mocapella.settings import check

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

SPREAD_UNIT: Final = 4
"""Number of units of `BackgroundModel.spread` in a grey level."""
FEWEST: Final = 3
"""Least number of images to learn from."""
SD_OF_MAD: Final = 1.4826


class BackgroundModel(msgspec.Struct, frozen=True, eq=False):
    """A pixel-wise model of the empty scene, usually of `learn_background`; a `Background` of `region_contour`.

    Attributes:
        usual: (height, width) or (height, width, 3) uint8, the median of every pixel; channels as in the images.
        spread: uint8 of the shape of ``usual``, a pixel's standard deviation in quarters of a grey level, at most 255.
        least_sd: least standard deviation of a density [grey levels].
        darkest: least brightness of a pixel in shadow, as a share of its usual one; 1: there are no shadows.
        shadow_nats: additional cost of a pixel in shadow [nats].

    Raises:
        SettingsError: a value is invalid, or the arrays differ in shape; names it and the valid values.
    """

    usual: UInt8
    spread: UInt8
    least_sd: float = 4.0
    darkest: float = 0.4
    shadow_nats: float = 2.0

    def __post_init__(self) -> None:
        if self.usual.shape != self.spread.shape:
            raise SettingsError(f"spread is of shape {self.spread.shape}; it must be that of usual, {self.usual.shape}")
        check(0.5 <= self.least_sd <= 100, "least_sd", self.least_sd, "from 0.5 to 100")
        check(0 < self.darkest <= 1, "darkest", self.darkest, "above 0 and up to 1")
        check(0 <= self.shadow_nats <= 100, "shadow_nats", self.shadow_nats, "from 0 to 100")

    def costs(self, band: Band, settings: RegionSettings = DEFAULT) -> Float32:
        """Return (blocks, size) the cost −log p of each sample's value under this model [nats]; see `Background.costs`.

        It is never NaN: the model is known everywhere. It is 0 where the band is not ``known``.

        Args:
            band: samples of an image of this model's size and channels.
            settings: only ``median`` is used: whether the model's images are filtered by a median, too.

        Raises:
            SettingsError: the band is of an image of another size or number of channels.
        """
        height, width = self.usual.shape[:2]
        channels = len(band.values)
        if (width, height) != band.size_px or self.usual.size != height * width * channels:
            raise SettingsError(
                f"the background is of shape {self.usual.shape}; it must be that of the image, "
                f"{band.size_px[1]} × {band.size_px[0]} of {channels} channels"
            )
        step = band.prior.step_px
        x, y = band.prior.origin_px
        read = []
        for picture in (self.usual, self.spread):
            pixels = np.ascontiguousarray(picture).reshape(height, width, channels)
            to = np.empty(band.values.shape, dtype=np.int16)
            columns = band.phi.shape[1]
            reading().read_samples(pixels, x - band.pad * step, y, step, settings.median, columns, band.blocks, to)
            read.append(to)
        out = np.empty(band.known.shape, dtype=np.float32)
        least, shadow = 2.0 * self.least_sd, float(self.shadow_nats)
        cost_kernels().background_costs(band.values, *read, band.known, least, float(self.darkest), shadow, out)
        return out


def learn_background(images: Sequence[UInt8], **settings: float) -> BackgroundModel:
    """Learn medians and spreads from images without people, or with people who keep moving.

    Args:
        images: at least 3, of one shape, (height, width) or (height, width, 3) uint8. A pixel must show the empty scene
            in more than half of them.
        settings: values of ``least_sd``, ``darkest`` and ``shadow_nats`` of `BackgroundModel`.

    Raises:
        SettingsError: there are too few, they differ in shape, or a value is out of range.
    """
    check(len(images) >= FEWEST, "images", len(images), f"at least {FEWEST}")
    shape = images[0].shape
    for image in images:
        if image.shape != shape or image.dtype != np.uint8 or not (image.ndim == 2 or image.shape[2:] == (3,)):
            raise SettingsError(f"an image is {image.dtype} of shape {image.shape}; all must be uint8 of one shape")
    stack = np.stack(images)
    median = np.median(stack, axis=0)
    sd = SD_OF_MAD * np.median(abs(stack - median), axis=0)
    spread = np.clip(np.rint(SPREAD_UNIT * sd), 0, 255).astype(np.uint8)
    return BackgroundModel(np.rint(median).astype(np.uint8), spread, **settings)


def background_contour(
    image: UInt8,
    model: BackgroundModel,
    window: Silhouette,
    *,
    guided: bool = True,
    ignore: Bool | None = None,
    settings: RegionSettings = DEFAULT,
    energies: bool = False,
) -> RegionContour:
    """Segment the foreground of an image by a background model, whatever the foreground's colour.

    Args:
        image: (height, width) or (height, width, 3) uint8.
        model: learnt from images of the same size and camera.
        window: the part of the image that is segmented; its phi is the shape prior if ``guided``, else it is ignored.
        guided: whether the window's phi is a prior, as for `region_contour`.
        ignore: (height, width) bool, True for pixels without information; None for none.
        settings: weights and limits; of those for local densities, only ``outliers`` and ``median`` are used.
        energies: whether energies are computed, which takes longer.

    Returns:
        The contour in the window; its phi has no positive values if there is no foreground.

    Raises:
        SettingsError: an array of another shape or type.
    """
    band = read_band(image, window, None, ignore, settings, guided=guided)
    outside = model.costs(band, settings)
    # Inside, the density is uniform: a person's pixels may have any value.
    inside_cost = 3 * (math.log(HALF_LEVELS) - 0.5 * math.log(2 * math.pi))
    if not guided:
        # Without a prior all samples are undecided, so all are in the blocks, row by row.
        band.inside[:] = ((outside > inside_cost) & (band.known > 0)).reshape(band.inside.shape)
        band.phi[:] = -1.0
    return settle(band, outside, inside_cost, settings, guided=guided, energies=energies)
