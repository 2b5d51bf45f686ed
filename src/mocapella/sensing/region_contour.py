"""Segment a body in an image by local densities of grey or colour on both sides of its contour, and a shape prior.

Equation 15 of B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, Online Smoothing for Markerless Motion Capture, DAGM
2007, with the sign of its length term corrected:

    E(Φ) = −∫ H(Φ) log p1 + (1 − H(Φ)) log p2 dx + ν ∫ |∇H(Φ)| dx + λ ∫ (Φ − Φ0)² dx

It is not minimised by gradient descent. For a given contour Φ is known (Φ0 where its sign agrees, 0 elsewhere), so the
prior costs λ Φ0² wherever a sample is on the other side than in the model; the length is measured on a
blurred mask (S. Esedoglu, F. Otto, Threshold Dynamics for Networks with Arbitrary Surface Tensions, 2015), so that
every sample can go at once to the side where it costs less, and E falls with every move (D. Wang, H. Li, X. Wei, X.-P.
Wang, An Efficient Iterative Thresholding Method for Image Segmentation, 2017). p1 and p2 are Gaussian densities at the
nodes of a lattice (T. Brox, D. Cremers, On Local Statistical Region Models, 2009), between which −log p is linear.
`docs/methods/silhouettes.md` lists the deviations from the paper, and the reasons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.signed_distance import MOST_REACH
from mocapella.model.silhouettes import Silhouette
from mocapella.settings import check

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

NOTHING: Final = np.zeros((0, 0), dtype=np.float32)
_NO_START: Final = np.zeros((0, 0), dtype=np.uint8)
_NO_MASK: Final = np.zeros((0, 0), dtype=np.bool_)
HALF_LEVELS: Final = 510
"""Range of sample values [half grey levels]: grey level g is the value 2g − 255."""


@dataclass(frozen=True)
class RegionSettings:
    """Weights and limits of the segmentation.

    Attributes:
        prior_weight: λ, the cost of a pixel on the other side than the model, divided by its squared distance from the
            model's contour; relative to the sum of three channels' log-likelihoods; larger: the contour stays nearer to
            the model's. A gray pixel counts as three equal channels [nats/px²].
        length_weight: ν, the cost of the contour's length; larger: a smoother contour, without thin parts such as
            fingers [nats/px].
        window_px: distance between the nodes of the densities' lattice, and radius of their neighbourhoods; rounded to
            a multiple of 8 samples; larger: steadier densities that are less local [px].
        band_px: samples farther from the prior's contour do not change sides; larger: faster motion is found, at more
            work and with more false contours [px].
        unsure_px: samples nearer to the prior's contour are not learnt from before the first move; no effect if a start
            contour is given [px].
        iterations: largest number of moves of the contour; larger: nearer to the minimum, at more work [iterations].
        least_sd: least standard deviation of a density; larger: weak edges count less [grey levels].
        outliers: share of pixels whose value fits neither side; larger: a single pixel weighs less [0 to 1].
        fewest_px2: weight of the density common to both sides in each side's own density, as an area; it dominates a
            side with a smaller area [px²].
        median: whether a 3 × 3 median of the image removes single wrong pixels first.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    prior_weight: float = 0.05
    length_weight: float = 2.0
    window_px: float = 32.0
    band_px: float = 12.0
    unsure_px: float = 4.0
    iterations: int = 4
    least_sd: float = 2.0
    outliers: float = 0.3
    fewest_px2: float = 15.0
    median: bool = True

    def __post_init__(self) -> None:
        check(0 <= self.prior_weight <= 1e6, "prior_weight", self.prior_weight, "from 0 to 1e6")
        check(0 <= self.length_weight <= 1e3, "length_weight", self.length_weight, "from 0 to 1000")
        check(2 <= self.window_px <= 200, "window_px", self.window_px, "from 2 to 200")
        check(0 < self.band_px <= 200, "band_px", self.band_px, "above 0 and up to 200")
        check(0 <= self.unsure_px < self.band_px, "unsure_px", self.unsure_px, "from 0 to less than band_px")
        check(1 <= self.iterations <= 1000, "iterations", self.iterations, "from 1 to 1000")
        check(0.5 <= self.least_sd <= 100, "least_sd", self.least_sd, "from 0.5 to 100")
        check(0 < self.outliers < 1, "outliers", self.outliers, "between 0 and 1")
        check(0 < self.fewest_px2 <= 1e4, "fewest_px2", self.fewest_px2, "above 0 and up to 10000")

    @property
    def most_nats(self) -> float:
        """Upper bound of −log p of one channel [nats], without the log 2π/2 that all densities share."""
        return -math.log(self.outliers / HALF_LEVELS) - 0.5 * math.log(2 * math.pi)


DEFAULT: Final = RegionSettings()
GRAY: Final = RegionSettings(prior_weight=0.1, length_weight=3.0)
"""For gray images: one channel counts as three but carries less information, so the prior weighs more."""


class RegionContour(msgspec.Struct, frozen=True, eq=False):
    """A contour, and how clearly the image shows it.

    Attributes:
        silhouette: the contour, in the prior's window; phi is clipped to the largest magnitude in the prior's phi, in
            whole steps (without a prior, to ``band_px``).
        surety: (rows, columns) log-likelihood ratio between the side that a sample is on and the other, a mean over
            5 × 5 samples, meaningful beside the contour [nats per pixel]; 0 where the image shows no edge, where it is
            unknown, and far from the prior's contour.
        iterations: number of moves until the contour was at rest, or the limit.
        energies: E [nats px²] at the start and after every iteration, without terms that do not depend on the contour
            within the band; empty unless requested.
    """

    silhouette: Silhouette
    surety: Float32
    iterations: int
    energies: Float64


def region_contour(
    image: UInt8,
    prior: Silhouette,
    start: Silhouette | None = None,
    *,
    ignore: Bool | None = None,
    background: Background | None = None,
    settings: RegionSettings = DEFAULT,
    energies: bool = False,
) -> RegionContour:
    """Segment a body: move the contour to minimise the energy.

    Args:
        image: (height, width) or (height, width, 3) uint8; only the prior's window is read. Beyond the image, and
            where it is ignored, the prior alone decides.
        prior: the model's contour.
        start: the initial contour, such as that of the previous image; the prior's if None.
        ignore: (height, width) bool, True for pixels without information; None for none.
        background: a model that replaces the local density outside, wherever it is known; None for none.
        settings: weights and limits.
        energies: whether energies are computed, which takes longer and needs a background known everywhere or nowhere.

    Returns:
        The contour in the prior's window, in new arrays. Samples farther than ``band_px`` from the prior's contour keep
        its side.

    Raises:
        SettingsError: an array of another shape or type, or energies with a background that is known in part.
    """
    band = read_band(image, prior, start, ignore, settings)
    outside = NOTHING if background is None else background.costs(band, settings)
    partly = energies and bool(np.isnan(outside).any())
    check(not partly, "energies", energies, "False with a background that does not know everything")
    unsure_px = settings.unsure_px if start is None else 0.0
    return settle(band, outside, math.nan, settings, unsure_px=unsure_px, energies=energies)


class Background(Protocol):
    """Interface of background models, such as `BackgroundModel` and `BackgroundMemory`."""

    def costs(self, band: Band, settings: RegionSettings) -> Float32:
        """Return the cost −log p of each sample of a band under the background model [nats]; NaN where it is unknown.

        p is a density per half grey level. The cost is scaled to three channels, without the (log 2π)/2 of each.

        Args:
            band: the samples.
            settings: settings of the segmentation.

        Returns:
            (blocks, size) float32, as ``band.blocks``.
        """
        ...


class Band(msgspec.Struct, frozen=True, eq=False):
    """An image's samples near a contour, in a window that is padded to whole blocks.

    A block is ``size`` consecutive samples of a row.

    Attributes:
        prior: the silhouette near whose contour the samples are.
        size_px: (width, height) of the image.
        pad: number of columns of padding before the window's first column.
        values: (channels, blocks, size) int16 half grey levels: grey level g is 2g − 255.
        phi: (rows, padded) signed distance to the prior's contour, above 0 inside [px].
        inside: (rows, padded) uint8, 1 inside the initial contour.
        active: (blocks, size) uint8, 1 where a sample may change sides.
        known: (blocks, size) uint8, 1 where a sample is active and the image shows it.
        blocks: (blocks, 2) int32 row of each block with active samples, and its number in the row.
        reach: distance at which signed distances are cut off [steps].
    """

    prior: Silhouette
    size_px: tuple[int, int]
    pad: int
    values: NDArray[np.int16]
    phi: Float32
    inside: UInt8
    active: UInt8
    known: UInt8
    blocks: NDArray[np.int32]
    reach: int


def read_band(
    image: UInt8,
    prior: Silhouette,
    start: Silhouette | None,
    ignore: Bool | None,
    settings: RegionSettings,
    *,
    guided: bool = True,
) -> Band:
    """Sample an image for `settle`: its half grey levels near the prior's contour, and the initial contour.

    Args:
        image: (height, width) or (height, width, 3) uint8; only the prior's window is read.
        prior: the model's contour.
        start: the initial contour; the prior's if None.
        ignore: (height, width) bool, True for pixels without information; None for none.
        settings: width of the band, size of the blocks, and median.
        guided: whether only samples within the band may change sides; otherwise all samples of the window may.

    Raises:
        SettingsError: an array of another shape or type, or a prior that is not finite.
    """
    check_silhouette(prior, "prior")
    good = image.dtype == np.uint8 and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3)))
    if not good or not image.size:
        raise SettingsError(
            f"image is {image.dtype} of shape {image.shape}; it must be uint8, (height, width) or (height, width, 3)"
        )
    height, width = image.shape[:2]
    if ignore is not None and (ignore.dtype != np.bool_ or ignore.shape != (height, width)):
        raise SettingsError(f"ignore is {ignore.dtype} of shape {ignore.shape}; it must be bool, {height, width}")
    (x, y), step, columns, size = prior.origin_px, prior.step_px, prior.phi.shape[1], block_of(settings, prior.step_px)
    padded = -(-columns // size) * size
    pad = (padded - columns) // 2
    farthest, *read = reading().read(
        np.ascontiguousarray(image).reshape(height, width, -1), np.ascontiguousarray(prior.phi),
        _NO_START if start is None else starting(prior, start), settings.band_px, guided, settings.median,
        reading().WindowLayout(x, y, step, pad, padded, size),
        _NO_MASK if ignore is None else np.ascontiguousarray(ignore),
    )  # fmt: skip
    check(math.isfinite(farthest), "prior.phi", "of NaN or infinite values", "finite")
    phi, inside, active, known, blocks, values = read
    reach = math.ceil((farthest if guided else settings.band_px) / step)
    return Band(prior, (width, height), pad, values, phi, inside, active, known, blocks, min(max(reach, 1), MOST_REACH))


def check_silhouette(silhouette: Silhouette, name: str) -> None:
    """Check that a silhouette is a window of signed distances; ``name`` is its name in errors.

    Raises:
        SettingsError: phi is of another shape or type, or the step is below 1.
    """
    phi = silhouette.phi
    if phi.dtype != np.float32 or phi.ndim != 2 or min(phi.shape) < 2:
        raise SettingsError(f"{name}.phi is {phi.dtype} of shape {phi.shape}; it must be float32, at least 2 × 2")
    check(silhouette.step_px >= 1, f"{name}.step_px", silhouette.step_px, "1 or more")


def settle(
    band: Band,
    outside: Float32,
    inside_cost: float,
    s: RegionSettings,
    *,
    unsure_px: float = 0.0,
    guided: bool = True,
    energies: bool = False,
) -> RegionContour:
    """Minimise the energy E of the module's equation for a contour whose image was read by `read_band`.

    Args:
        band: samples of the image; its ``inside`` is overwritten.
        outside: (blocks, size) −log p2 of a background model [nats], NaN where the density is learnt; or (0, 0).
        inside_cost: −log p1 if it is constant [nats]; NaN if it is learnt.
        s: weights and limits.
        unsure_px: samples nearer to the prior's contour are not learnt from before the first move [px].
        guided: whether the band's silhouette is a shape prior.
        energies: whether energies are computed.

    Returns:
        The contour, in the window of the band's silhouette.
    """
    step, columns = band.prior.step_px, band.prior.phi.shape[1]
    k = kernels()
    weights = k.ContourWeights(
        prior_weight=np.float32(s.prior_weight),
        length=np.float32(s.length_weight * math.sqrt(2 * math.pi) / step),
        slope=np.float32(math.sqrt(2 / math.pi) / step),
        guided=guided,
        unsure=np.float32(unsure_px),
        fewest=s.fewest_px2 / step**2,
        least_sd=2.0 * s.least_sd,
        most=np.float32(3 * s.most_nats),
        inside_cost=inside_cost,
        iterations=s.iterations,
    )
    samples = k.ContourBand(band.values, band.active, band.known, band.phi, band.blocks, band.inside)
    moved, phi, surety, told = k.settled(
        samples, outside, weights, band.pad, columns, energies, band.reach, np.float32(step)
    )
    return RegionContour(Silhouette(band.prior.origin_px, step, phi), surety, moved, told * step**2)


def block_of(settings: RegionSettings, step_px: int) -> int:
    """Return the number of samples of a block, which is the distance between nodes of the densities' lattice.

    Args:
        settings: the distance in pixels.
        step_px: distance between samples [px].
    """
    return max(8 * round(settings.window_px / (8 * step_px)), 8)


def starting(prior: Silhouette, start: Silhouette) -> UInt8:
    """Return the initial contour at the prior's samples: (rows, columns) uint8, 1 inside.

    Samples beyond the window of ``start`` are inside if they are inside the prior.

    Raises:
        SettingsError: as `check_silhouette`, for ``start``.
    """
    inside: UInt8 = (prior.phi > 0).astype(np.uint8)
    check_silhouette(start, "start")
    picked: list[NDArray[np.int64]] = []
    for axis in (0, 1):
        first = prior.origin_px[1 - axis] - start.origin_px[1 - axis] + start.step_px // 2
        picked.append((first + prior.step_px * np.arange(prior.phi.shape[axis])) // start.step_px)
    rows, columns = picked
    of_rows = np.flatnonzero((rows >= 0) & (rows < start.phi.shape[0]))
    of_columns = np.flatnonzero((columns >= 0) & (columns < start.phi.shape[1]))
    if len(of_rows) and len(of_columns):
        i, j = slice(of_rows[0], of_rows[-1] + 1), slice(of_columns[0], of_columns[-1] + 1)
        if prior.step_px == start.step_px:  # contiguous: no index arrays
            part = start.phi[rows[i][0] : rows[i][-1] + 1, columns[j][0] : columns[j][-1] + 1]
        else:
            part = start.phi[np.ix_(rows[i], columns[j])]
        inside[i, j] = part > 0
    return inside


@cache
def reading() -> ModuleType:
    """Return the module `region_reading_kernels`; the first call imports it, and with it numba."""
    from mocapella.sensing import region_reading_kernels

    return region_reading_kernels


@cache
def kernels() -> ModuleType:
    """Return the module `region_contour_kernels`; the first call imports it, and with it numba."""
    from mocapella.sensing import region_contour_kernels

    return region_contour_kernels


@cache
def cost_kernels() -> ModuleType:
    """Return the module `region_cost_kernels`; the first call imports it, and with it numba."""
    from mocapella.sensing import region_cost_kernels

    return region_cost_kernels
