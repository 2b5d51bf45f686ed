"""Where a body's outline is in an image: local densities of grey or colour on both sides, and the model as a prior.

Equation 15 of B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, Online Smoothing for Markerless Motion Capture, DAGM
2007, with the sign of its length term put right:

    E(Φ) = −∫ H(Φ) log p1 + (1 − H(Φ)) log p2 dx + ν ∫ |∇H(Φ)| dx + λ ∫ (Φ − Φ0)² dx

It is not descended by gradients. For an outline that is given, Φ is known (Φ0 where that has the right sign, 0
elsewhere), so the prior costs λ Φ0² wherever a sample is on the other side than in the model; the length is that of a
blurred mask (S. Esedoglu, F. Otto, Threshold Dynamics for Networks with Arbitrary Surface Tensions, 2015), so that
every sample can go at once to the side where it costs less, and E falls with every move (D. Wang, H. Li, X. Wei, X.-P.
Wang, An Efficient Iterative Thresholding Method for Image Segmentation, 2017). p1 and p2 are Gaussian densities at the
nodes of a lattice (T. Brox, D. Cremers, On Local Statistical Region Models, 2009), between which −log p is linear.
`docs/methods/silhouettes.md` says what is chosen differently than in the paper, and why.
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
"""Values are counted in halves of grey levels."""


@dataclass(frozen=True)
class RegionSettings:
    """How an outline is found.

    Attributes:
        prior_weight: λ [nats/px²]: what a pixel costs that is on the other side than in the model, by the square of how
            far it is from the model's outline; beside the sum of its three channels' log-likelihoods. A gray pixel
            counts as three equal channels.
        length_weight: ν [nats/px] that a pixel's length of outline costs.
        window_px: from a node of the densities' lattice to the next; each is of what is nearer to it than that. It is
            rounded to a multiple of 8 samples.
        band_px: farther from the prior's outline nothing moves.
        unsure_px: nearer to the prior's outline, nothing is learnt from before the outline is moved for the first time.
        iterations: how many times the outline is moved, at most.
        least_sd: of a density [grey levels].
        outliers: share of pixels whose value is like neither side, so that one of them says only so much.
        fewest_px2: where less than about that area is on a side, its density leans on that of both sides.
        median: whether single wrong pixels are taken away by a median over 3 × 3.
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
        """At which −log p is cut off, without the log 2π/2 that all densities share."""
        return -math.log(self.outliers / HALF_LEVELS) - 0.5 * math.log(2 * math.pi)


DEFAULT: Final = RegionSettings()
GRAY: Final = RegionSettings(prior_weight=0.1, length_weight=3.0)
"""Better for gray images: one channel is not worth three, as which it is counted, so the prior weighs twice as much."""


class RegionContour(msgspec.Struct, frozen=True, eq=False):
    """An outline, and how clearly the image shows it.

    Attributes:
        silhouette: in the prior's window; phi is cut off at the prior's reach.
        surety: (rows, columns) by how much the values about a sample are likelier on the side that they are on than on
            the other, a mean over 5 × 5 samples, to be read beside the outline [nats a pixel]; 0 where the image shows
            no edge, where nothing is known and far from the prior's outline.
        iterations: after which the outline rested, or that were allowed.
        energies: E [nats px²] at the beginning and after every iteration, but for what does not depend on the outline
            within the band; empty unless asked for.
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
    """Move an outline to where the image shows it.

    Args:
        image: (height, width) or (height, width, 3) uint8; only the prior's window is read. Beyond the image, and
            where it is ignored, the prior alone says what is inside.
        prior: the model's outline.
        start: where to begin, such as the outline of the image before; the prior's where not given.
        ignore: (height, width) bool pixels that say nothing.
        background: what the image is like without anybody, instead of a local density outside, where it knows that.
        settings: how.
        energies: whether they are told; that takes longer, and needs a background that knows all or none.

    Raises:
        SettingsError: an array of another shape or type, or energies of what is only known in part.
    """
    band = read_band(image, prior, start, ignore, settings)
    outside = NOTHING if background is None else background.costs(band, settings)
    partly = energies and bool(np.isnan(outside).any())
    check(not partly, "energies", energies, "False with a background that does not know everything")
    unsure_px = settings.unsure_px if start is None else 0.0
    return settle(band, outside, math.nan, settings, unsure_px=unsure_px, energies=energies)


class Background(Protocol):
    """What says what an image is like without anybody."""

    def costs(self, band: Band, settings: RegionSettings) -> Float32:
        """(blocks, size) −log p of a band's values where nobody is [nats], as of three channels of half grey levels,
        without the log 2π/2 of each; NaN where that is not known.
        """
        ...


class Band(msgspec.Struct, frozen=True, eq=False):
    """What an image is like about an outline, in a window that is padded to whole blocks of samples.

    Attributes:
        prior: the outline's.
        size_px: (width, height) of the image.
        pad: columns of padding before the first.
        values: (channels, blocks, size) int16 half grey levels from the middle of the scale.
        phi: (rows, padded) the prior's.
        inside: (rows, padded) uint8, 1 inside the outline to begin with.
        active, known: (blocks, size) uint8, 1 where a sample is undecided, and where the image says anything of it.
        blocks: (blocks, 2) int32 row and number of those that have undecided samples.
        reach: [steps] at which distances are cut off.
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
    """Read an image about an outline; everywhere in the window, where not ``guided``.

    Raises:
        SettingsError: an array of another shape or type.
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
    """Refuse one that is no window of distances.

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
    """Move the outline; ``outside``, ``inside_cost`` and ``unsure_px`` as in the kernel `settled`."""
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
    """How many samples it is from a node of the densities to the next."""
    return max(8 * round(settings.window_px / (8 * step_px)), 8)


def starting(prior: Silhouette, start: Silhouette) -> UInt8:
    """(rows, columns) 1 inside the outline to begin with, on the prior's samples; beyond its window the prior's."""
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
        if prior.step_px == start.step_px:  # one after another: no list of places
            part = start.phi[rows[i][0] : rows[i][-1] + 1, columns[j][0] : columns[j][-1] + 1]
        else:
            part = start.phi[np.ix_(rows[i], columns[j])]
        inside[i, j] = part > 0
    return inside


@cache
def reading() -> ModuleType:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import region_reading_kernels

    return region_reading_kernels


@cache
def kernels() -> ModuleType:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import region_contour_kernels

    return region_contour_kernels


@cache
def cost_kernels() -> ModuleType:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import region_cost_kernels

    return region_cost_kernels
