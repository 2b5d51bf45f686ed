"""Costs of samples on either side of a contour, and the energy of the contour; compiled.

Costs are −log p [nats], scaled to three channels, without the log 2π/2 that all densities share: p1 is the density
inside, p2 outside. `region_contour_kernels` defines bands, blocks and samples. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.region_density_kernels import INSIDE, OUTLIER, OUTSIDE, UNKNOWN, DensityLattice, node_row_above

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int16 = NDArray[np.int16]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

_0F, _1F, _0B = np.float32(0.0), np.float32(1.0), np.uint8(0)


class ContourBand(NamedTuple):
    """The samples that can change sides, as `region_reading_kernels.lay_out` and `read_samples` write them.

    Attributes:
        values: (channels, blocks, size) int16 half grey levels: grey level g is 2g − 255; size is a multiple of 8.
        active: (blocks, size) uint8, 1 where a sample may change sides.
        known: (blocks, size) uint8, 1 where a sample is active and the image shows it.
        phi: (rows, padded) float32 signed distance to the prior's contour [px], above 0 inside.
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        inside: (rows, padded) uint8, 1 inside the contour; the initial contour, overwritten with the result.
    """

    values: Int16
    active: UInt8
    known: UInt8
    phi: Float32
    blocks: Int32
    inside: UInt8


class ContourWeights(NamedTuple):
    """Weights and limits of a contour's energy.

    Attributes:
        prior_weight: cost of a sample on the other side than in the prior, per squared distance [nats/px²].
        length: cost of a sample that is surrounded by the other side [nats].
        slope: twice the slope of the blurred mask across a straight contour [1/px].
        guided: whether there is a shape prior.
        unsure: samples nearer to the prior's contour are not learnt from before the first move [px].
        fewest: weight of the density common to both sides in each side's density [samples].
        least_sd: smallest standard deviation of a density [half grey levels].
        most: upper bound of −log p [nats].
        inside_cost: −log p1 if it is constant; NaN if it is learnt [nats].
        iterations: largest number of moves.
    """

    prior_weight: np.float32
    length: np.float32
    slope: np.float32
    guided: bool
    unsure: np.float32
    fewest: float
    least_sd: float
    most: np.float32
    inside_cost: float
    iterations: int


class ContourSamples(NamedTuple):
    """The state of a band's samples, (blocks, size) each, or (samples,) in flat views.

    Attributes:
        distance: float32 signed distance to the prior's contour, above 0 inside [px].
        blurred: uint16 binomial mean of the mask about the sample [1/256].
        prior_gain: float32 cost of being outside minus cost of being inside, by the prior alone [nats].
        label: uint8 `INSIDE`, `OUTSIDE`, `OUTLIER` or `UNKNOWN`: the density that the sample counts in.
        inside: uint8 1 inside the contour.
        inside_cost, outside_cost: float32 −log p1 and −log p2 [nats].
        own_cost: float32 −log p of the side with the lower energy [nats].
        gain: float32 cost of being outside minus cost of being inside [nats].
        contrast: float32 log p1 − log p2 [nats]; 0 where unknown.
        new_label, new_inside: uint8 label and inside after the next move.
    """

    distance: Float32
    blurred: UInt16
    prior_gain: Float32
    label: UInt8
    inside: UInt8
    inside_cost: Float32
    outside_cost: Float32
    own_cost: Float32
    gain: Float32
    contrast: Float32
    new_label: UInt8
    new_inside: UInt8


@njit(cache=True, error_model="numpy")
def begin(samples: ContourSamples, active: UInt8, known: UInt8, w: ContourWeights) -> None:
    """Write the prior's gains and the first labels of flat samples.

    Args:
        samples: flat views; distance, blurred and inside are read, prior_gain and label written.
        active, known: (samples,) of `ContourBand`.
        w: weights.
    """
    near, mean, on, pull, state = samples.distance, samples.blurred, samples.inside, samples.prior_gain, samples.label
    prior_weight, length, slope, guided, unsure = w.prior_weight, w.length, w.slope, w.guided, w.unsure
    scale = np.float32(1 / 128)
    for j in range(len(near)):
        p = near[j]
        straight = slope * p
        straight = straight if straight < _1F else _1F
        straight = straight if straight > -_1F else -_1F
        gain = prior_weight * p * abs(p) + length * (straight + _1F - scale * np.float32(mean[j]))
        pull[j] = gain if guided else _0F
    for j in range(len(near)):
        gain = pull[j]
        pull[j] = gain if active[j] > _0B else _0F
    for j in range(len(near)):
        state[j] = INSIDE if on[j] > _0B else OUTSIDE
    for j in range(len(near)):
        side = state[j]
        state[j] = side if abs(near[j]) >= unsure else OUTLIER
    for j in range(len(near)):
        side = state[j]
        state[j] = side if known[j] > _0B else UNKNOWN


@njit(cache=True, error_model="numpy", forceinline=True)
def _costs_of_gray(
    row: Float32,
    rise: Float32,
    k: int,
    values: Float32,
    n: int,
    along: Float32,
    one: Float32,
    two: Float32,
    outside: bool,
) -> None:
    """Write −log p of the gray samples of block n: inside into ``one``, and ``outside`` also into ``two``."""
    a0, a1, a0_rise, a1_rise = row[k, 0], row[k, 1], rise[k, 0], rise[k, 1]
    b00, b00_rise, c00, c00_rise = row[k, 2], rise[k, 2], row[k, 4], rise[k, 4]
    b01, b01_rise, c01, c01_rise = row[k, 3], rise[k, 3], row[k, 5], rise[k, 5]
    for j in range(len(along)):
        t = along[j]
        v0 = values[0, n, j]
        cost = (a0 + t * a0_rise) + v0 * ((b00 + t * b00_rise) + v0 * (c00 + t * c00_rise))
        one[n, j] = cost
    if not outside:
        return
    for j in range(len(along)):
        t = along[j]
        v0 = values[0, n, j]
        cost = (a1 + t * a1_rise) + v0 * ((b01 + t * b01_rise) + v0 * (c01 + t * c01_rise))
        two[n, j] = cost


@njit(cache=True, error_model="numpy", forceinline=True)
def _costs_of_colour(
    row: Float32,
    rise: Float32,
    k: int,
    values: Float32,
    n: int,
    along: Float32,
    one: Float32,
    two: Float32,
    outside: bool,
) -> None:
    """Write −log p of the samples of block n of three channels, as `_costs_of_gray` does."""
    a0, a1, a0_rise, a1_rise = row[k, 0], row[k, 1], rise[k, 0], rise[k, 1]
    b00, b00_rise, c00, c00_rise = row[k, 2], rise[k, 2], row[k, 4], rise[k, 4]
    b01, b01_rise, c01, c01_rise = row[k, 3], rise[k, 3], row[k, 5], rise[k, 5]
    b10, b10_rise, c10, c10_rise = row[k, 6], rise[k, 6], row[k, 8], rise[k, 8]
    b11, b11_rise, c11, c11_rise = row[k, 7], rise[k, 7], row[k, 9], rise[k, 9]
    b20, b20_rise, c20, c20_rise = row[k, 10], rise[k, 10], row[k, 12], rise[k, 12]
    b21, b21_rise, c21, c21_rise = row[k, 11], rise[k, 11], row[k, 13], rise[k, 13]
    for j in range(len(along)):
        t = along[j]
        v0 = values[0, n, j]
        v1 = values[1, n, j]
        v2 = values[2, n, j]
        cost = (a0 + t * a0_rise) + v0 * ((b00 + t * b00_rise) + v0 * (c00 + t * c00_rise))
        cost = cost + v1 * ((b10 + t * b10_rise) + v1 * (c10 + t * c10_rise))
        cost = cost + v2 * ((b20 + t * b20_rise) + v2 * (c20 + t * c20_rise))
        one[n, j] = cost
    if not outside:
        return
    for j in range(len(along)):
        t = along[j]
        v0 = values[0, n, j]
        v1 = values[1, n, j]
        v2 = values[2, n, j]
        cost = (a1 + t * a1_rise) + v0 * ((b01 + t * b01_rise) + v0 * (c01 + t * c01_rise))
        cost = cost + v1 * ((b11 + t * b11_rise) + v1 * (c11 + t * c11_rise))
        cost = cost + v2 * ((b21 + t * b21_rise) + v2 * (c21 + t * c21_rise))
        two[n, j] = cost


@njit(cache=True, error_model="numpy")
def update_costs(
    levels: Float32, blocks: Int32, rows: int, along: Float32, coefficients: Float32, dirty: UInt8, modelled: UInt8,
    one: Float32, two: Float32,
) -> None:  # fmt: skip
    """Write the costs −log p [nats] of the samples of all blocks that ``dirty`` marks.

    The nodes' coefficients are interpolated linearly in both directions.

    Args:
        levels: (channels, blocks, size) float32 values in half grey levels: grey level g is 2g − 255.
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        rows: number of rows of the window.
        along: (size,) float32 a sample's distance along its block, 0 to 1.
        coefficients: (node rows, node columns, 2 + 4 channels) of `DensityLattice`.
        dirty: (blocks,) not 0 where a block is evaluated.
        modelled: (blocks,) uint8, 1 where a background model gives all costs outside, so ``two`` is not written.
        one, two: (blocks, size) written: costs inside and outside.
    """
    row = np.empty(coefficients.shape[1:], np.float32)
    rise = np.zeros(coefficients.shape[1:], np.float32)
    flat_row, flat_rise, last = row.reshape(-1), rise.reshape(-1), np.int64(-1)
    following = flat_row[coefficients.shape[2] :]
    for n in range(len(blocks)):
        if not dirty[n]:
            continue
        i, k = np.int64(blocks[n, 0]), np.int64(blocks[n, 1])
        if i != last:
            last = i
            top, low = node_row_above(i, rows, len(along))
            above, below = coefficients[top].reshape(-1), coefficients[top + 1].reshape(-1)
            t = np.float32(low) / np.float32(2 * len(along))
            for q in range(len(flat_row)):
                flat_row[q] = above[q] + t * (below[q] - above[q])
            for q in range(len(following)):
                flat_rise[q] = following[q] - flat_row[q]
        if len(levels) == 3:
            _costs_of_colour(row, rise, k, levels, n, along, one, two, modelled[n] == _0B)
        else:
            _costs_of_gray(row, rise, k, levels, n, along, one, two, modelled[n] == _0B)


@njit(cache=True, error_model="numpy")
def decide(samples: ContourSamples, outside: Float32, known: UInt8, active: UInt8, w: ContourWeights) -> None:
    """Determine the side of lower cost for each sample, and the difference.

    Args:
        samples: flat views; distance, blurred, prior_gain and both costs are read; both costs are cut off at
            ``w.most``; gain, contrast, own_cost, new_label and new_inside are written.
        outside: (samples,) −log p2 of a background model [nats], NaN where it is learnt; or (0,).
        known, active: (samples,) of `ContourBand`.
        w: weights.
    """
    ones, twos, pull, mean, near = (
        samples.inside_cost, samples.outside_cost, samples.prior_gain, samples.blurred, samples.distance
    )  # fmt: skip
    fields, gains, own, news, nows = (
        samples.gain, samples.contrast, samples.own_cost, samples.new_label, samples.new_inside
    )  # fmt: skip
    length, most, inner = w.length, w.most, np.float32(w.inside_cost)
    scale = np.float32(1 / 128)
    if not math.isnan(inner):
        ones[:] = inner
    if outside.size > 0:
        for j in range(len(ones)):
            cost = outside[j]
            twos[j] = twos[j] if math.isnan(cost) else cost
    for j in range(len(ones)):
        cost = ones[j]
        ones[j] = cost if cost < most else most
    for j in range(len(ones)):
        cost = twos[j]
        twos[j] = cost if cost < most else most
    for j in range(len(ones)):
        gain = twos[j] - ones[j]
        gains[j] = gain if known[j] > _0B else _0F
    for j in range(len(ones)):
        fields[j] = gains[j] + pull[j] + length * (scale * np.float32(mean[j]) - _1F)
    for j in range(len(ones)):
        a, b = fields[j], near[j]
        fields[j] = a if active[j] > _0B else b
    for j in range(len(ones)):
        a, b = ones[j], twos[j]
        own[j] = a if fields[j] > _0F else b
    for j in range(len(ones)):
        news[j] = INSIDE if fields[j] > _0F else OUTSIDE
    for j in range(len(ones)):
        nows[j] = np.uint8(OUTSIDE - news[j])
    for j in range(len(ones)):
        side = news[j]
        news[j] = side if own[j] < most else OUTLIER
    for j in range(len(ones)):
        side = news[j]
        news[j] = side if known[j] > _0B else UNKNOWN


@njit(cache=True, error_model="numpy")
def energy_of(
    band: ContourBand, samples: ContourSamples, blurred: UInt16, lattice: DensityLattice, outside_costs: Float32,
    w: ContourWeights,
) -> np.float64:  # fmt: skip
    """Return the energy of a contour with the densities learnt from it [nats × samples].

    Args:
        band: its samples.
        samples: their state.
        blurred: (rows, padded) the blurred mask [1/256].
        lattice: the densities.
        outside_costs: (blocks, size) −log p2 of a background model, or (0, 0).
        w: weights.
    """
    inside, known, (rows, columns), size = band.inside, band.known, band.inside.shape, band.values.shape[2]
    on, pull, state, sums, coefficients = (
        samples.inside, samples.prior_gain, samples.label, lattice.sums, lattice.coefficients
    )  # fmt: skip
    inside_cost, most = w.inside_cost, w.most
    modelled, learnt, unit = outside_costs.size > 0, math.isnan(inside_cost), 1.0 / (4 * size * size)
    energy: np.float64 = lattice.leans.sum()
    for i in range(rows):
        for j in range(columns):
            if inside[i, j]:
                energy += w.length * (1.0 - blurred[i, j] / 256.0)
    for n in range(len(on)):
        for j in range(size):
            u = on[n, j]
            if u:
                energy -= pull[n, j]
            if not known[n, j]:
                continue
            if u and not learnt:
                energy += inside_cost
            elif modelled and not u:
                energy += min(outside_costs[n, j], most)
            elif state[n, j] == OUTLIER:
                energy += most
    channels = sums.shape[3] // 2
    for side in range(2):
        if (not learnt) if side == 0 else modelled:
            continue
        for i in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                own, of = sums[side, i, k], coefficients[i, k]
                energy += float(of[side]) * (own[0] * unit)
                for c in range(channels):
                    energy += float(of[2 + 4 * c + side]) * (own[1 + c] * unit)
                    energy += float(of[4 + 4 * c + side]) * (own[1 + channels + c] * unit)
    return energy


@njit(cache=True, error_model="numpy")
def background_costs(
    values: Int16, usual: Int16, spread: Int16, known: UInt8, least_sd: float, darkest: float, shadow: float,
    out: Float32,
) -> None:  # fmt: skip
    """Write the cost −log p [nats] of every sample's value under a model of the empty scene, scaled to three channels.

    Args:
        values: (channels, blocks, size) int16 the image's values in half grey levels: grey level g is 2g − 255.
        usual: (channels, blocks, size) int16 the background's values, in the same unit.
        spread: (channels, blocks, size) int16 the background's standard deviation, as 8 × grey levels − 255.
        known: (blocks, size) uint8 of `ContourBand`.
        least_sd: smallest standard deviation [half grey levels].
        darkest: least share of its usual brightness for a sample to be in shadow.
        shadow: additional cost of a sample in shadow [nats].
        out: (blocks, size) float32, written; 0 where unknown.
    """
    channels, rows, columns = values.shape
    share = 3.0 / channels
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
            if not known[i, j]:
                continue
            plain, product, above, below = 0.0, 1.0, 0.0, 0.0
            for c in range(channels):
                sd = max((spread[c, i, j] + 255) * 0.25, least_sd)
                off, level = float(values[c, i, j] - usual[c, i, j]), usual[c, i, j] + 255.0
                plain += 0.5 * off * off / (sd * sd)
                product *= sd
                above += (level + off) * level / (sd * sd)
                below += level * level / (sd * sd)
            if channels == 3 and below > 0 and darkest <= above / below < 1:
                dim, shaded = above / below, shadow
                for c in range(3):
                    sd = max((spread[c, i, j] + 255) * 0.25, least_sd)
                    off = values[c, i, j] + 255.0 - dim * (usual[c, i, j] + 255.0)
                    shaded += 0.5 * off * off / (sd * sd)
                plain = min(plain, shaded)
            out[i, j] = share * (plain + math.log(product))
