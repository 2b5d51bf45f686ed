"""Kernels of the iteration of `mocapella.sensing.region_contour`; importing this module imports numba.

Iterative thresholding: local densities on both sides of the contour and the samples' sides are updated in turn, so that
the energy of `region_contour` falls.

A block is ``size`` consecutive samples of a row. The band is the samples near the prior's contour, which may change
sides. All samples of the blocks that it touches are evaluated at once, and again only where something has changed.
"""

# ruff: noqa: PLR0915, PLR0917, PLR1714, SIM109 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.signed_distance_kernels import signed_distance
from mocapella.sensing.region_cost_kernels import (
    ContourBand,
    ContourSamples,
    ContourWeights,
    begin,
    decide,
    energy_of,
    update_costs,
)
from mocapella.sensing.region_density_kernels import (
    INSIDE,
    OUTSIDE,
    DensityLattice,
    add_changes,
    add_sample,
    mark_blocks,
    node_row_above,
    node_rows,
    update_densities,
)
from mocapella.sensing.region_mask_kernels import SIDE_CHANGED, blur, flip, gather, replace, scatter, surety_of

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

_0F, _0B, _1B = np.float32(0.0), np.uint8(0), np.uint8(1)


@njit(cache=True, error_model="numpy")
def move_samples(
    band: ContourBand, samples: ContourSamples, lattice: DensityLattice, learning: bool, blurred: UInt16,
    block_at: Int32, dirty: UInt8,
) -> bool:  # fmt: skip
    """Move samples to the side with the lower cost, one by one, and mark the blocks to be evaluated again.

    Args:
        band: the samples; ``inside`` is updated.
        samples: their state, (blocks, size) arrays; label and inside become new_label and new_inside.
        lattice: the densities; sums are updated and changed nodes become stale, if ``learning``.
        learning: whether the densities are learnt.
        blurred, block_at, dirty: (rows, padded), (rows, blocks of a row) and (blocks,) of `region_mask_kernels.flip`,
            updated.

    Returns:
        Whether any sample changed.
    """
    values, blocks, inside = band.values, band.blocks, band.inside
    state, news, on, nows = samples.label, samples.new_label, samples.inside, samples.new_inside
    sums, stale = lattice.sums, lattice.stale
    rows, size = len(inside), values.shape[2]
    states, news_by_8 = state.reshape(-1).view(np.uint64), news.reshape(-1).view(np.uint64)
    ons, nows_by_8 = on.reshape(-1).view(np.uint64), nows.reshape(-1).view(np.uint64)
    eights, any_did = size // 8, False
    for m in range(len(states)):
        if states[m] == news_by_8[m] and ons[m] == nows_by_8[m]:
            continue
        any_did = True
        n = m // eights
        i, k = np.int64(blocks[n, 0]), np.int64(blocks[n, 1])
        top, low = node_row_above(i, rows, size)
        first = 8 * (m - n * eights)
        for j in range(first, first + 8):
            if nows[n, j] != on[n, j]:
                flip(inside, i, k * size + j, size, blurred, block_at, dirty)
            before, now = state[n, j], news[n, j]
            if not learning or before == now:
                continue
            if before == INSIDE or before == OUTSIDE:
                add_sample(values, n, j, top, low, k, -1, before - 1, sums)
            if now == INSIDE or now == OUTSIDE:
                add_sample(values, n, j, top, low, k, 1, now - 1, sums)
            for a in range(top, top + 2):
                for b in range(k, k + 2):
                    stale[a, b] = 1
        states[m], ons[m] = news_by_8[m], nows_by_8[m]
    return any_did


@njit(cache=True, error_model="numpy")
def _began_elsewhere(phi: Float32, inside: UInt8, prior: UInt8) -> np.bool_:
    """Write the mask of phi > 0 into ``prior``; return whether ``inside``, the initial mask, differs from it."""
    differs = _0B
    for i in range(phi.shape[0]):
        for j in range(phi.shape[1]):
            side = _1B if phi[i, j] > _0F else _0B
            prior[i, j] = side
            differs = np.uint8(differs | np.uint8(side ^ inside[i, j]))
    return differs > _0B


@njit(cache=True, error_model="numpy")
def _wholly_modelled(outside_costs: Float32, count: int) -> UInt8:
    """Return (count,) uint8, 1 for blocks with all costs from a background model."""
    modelled = np.zeros(count, np.uint8)
    for n in range(len(outside_costs)):
        unknown = False
        for j in range(outside_costs.shape[1]):
            unknown |= outside_costs[n, j] != outside_costs[n, j]
        modelled[n] = not unknown
    return modelled


@njit(cache=True, error_model="numpy")
def new_samples(shape: tuple[int, int]) -> ContourSamples:
    """Return the state of a band's samples, arrays (blocks, size); only outside_cost is initialised, to 0."""
    return ContourSamples(
        np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, np.float32),
        np.empty(shape, np.uint8), np.empty(shape, np.uint8), np.empty(shape, np.float32),
        np.zeros(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32),
        np.empty(shape, np.float32), np.empty(shape, np.uint8), np.empty(shape, np.uint8),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def flattened(s: ContourSamples) -> ContourSamples:
    """Return views (blocks × size,) of all arrays of samples."""
    return ContourSamples(
        s.distance.reshape(-1), s.blurred.reshape(-1), s.prior_gain.reshape(-1), s.label.reshape(-1),
        s.inside.reshape(-1), s.inside_cost.reshape(-1), s.outside_cost.reshape(-1), s.own_cost.reshape(-1),
        s.gain.reshape(-1), s.contrast.reshape(-1), s.new_label.reshape(-1), s.new_inside.reshape(-1),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def segment(
    band: ContourBand, odd: Int32, outside_costs: Float32, w: ContourWeights, field: Float32, contrast: Float32,
    energies: Float64,
) -> int:  # fmt: skip
    """Minimise the contour's energy by iterative thresholding (`region_contour` names the papers); return the moves.

    Args:
        band: the samples; its ``inside`` becomes the result.
        odd: (size,) int32 1, 3, 5 …: a sample's distance along its block [1 / (2 size)].
        outside_costs: (blocks, size) float32 −log p2 [nats] of a background model, NaN where it is learnt; or (0, 0).
        w: weights and limits.
        field: (rows, padded) float32, above 0 inside; in the band it becomes every sample's gain [nats].
        contrast: (rows, padded) float32, becomes log p1 − log p2 [nats] in the band; 0 where unknown.
        energies: (iterations + 1,) float64 [nats × samples] at the start and after every move; not computed where (0,).
    """
    values, known, phi, blocks, inside = band.values, band.known, band.phi, band.blocks, band.inside
    channels, count, size = values.shape
    (rows, columns), row_blocks = phi.shape, phi.shape[1] // size
    learnt, reported = math.isnan(w.inside_cost), energies.size > 0
    samples = new_samples((count, size))
    flat, flat_known, flat_active = flattened(samples), known.reshape(-1), band.active.reshape(-1)
    mean, prior = np.empty((rows, columns), np.uint16), np.empty((rows, columns), np.uint8)
    begun = _began_elsewhere(phi, inside, prior)
    blur(prior, mean)
    dirty = np.full(count, SIDE_CHANGED, np.uint8)
    blurred_words, mean_words = samples.blurred.view(np.uint64), mean.view(np.uint64)
    gather(phi.view(np.uint64), blocks, dirty, SIDE_CHANGED, samples.distance.view(np.uint64))
    gather(mean_words, blocks, dirty, SIDE_CHANGED, blurred_words)
    gather(inside.view(np.uint64), blocks, dirty, SIDE_CHANGED, samples.inside.view(np.uint64))
    block_at = np.full((rows, row_blocks), -1, np.int32)
    for n in range(count):
        block_at[blocks[n, 0], blocks[n, 1]] = n
    begin(flat, flat_active, flat_known, w)
    nodes, terms = (node_rows(rows, size), row_blocks + 1), 1 + 2 * channels
    sums = np.zeros((2, nodes[0], nodes[1], terms), np.int64)
    if learnt:
        add_changes(values, np.zeros_like(samples.label), samples.label, blocks, rows, odd, sums)
    lattice = DensityLattice(
        sums, sums[0] + sums[1], np.zeros(nodes), np.ones(nodes, np.uint8),
        np.zeros((nodes[0], nodes[1], 2 + 4 * channels), np.float32),
    )  # fmt: skip
    if learnt:
        update_densities(lattice, size, w.fewest, w.least_sd)
    if begun:
        blur(inside, mean)
    if reported:
        energies[:] = energy_of(band, samples, mean, lattice, outside_costs, w)
    levels = values.astype(np.float32)
    along = odd.astype(np.float32) / np.float32(2 * size)
    samples.new_label[:], samples.new_inside[:] = samples.label, samples.inside
    modelled, flat_outside = _wholly_modelled(outside_costs, count), outside_costs.reshape(-1)
    iteration = 0
    while iteration < w.iterations:
        gather(mean_words, blocks, dirty, SIDE_CHANGED, blurred_words)
        update_costs(
            levels, blocks, rows, along, lattice.coefficients, dirty, modelled, samples.inside_cost,
            samples.outside_cost,
        )  # fmt: skip
        # All samples of all blocks go through the long loops, also unchanged ones: that is faster.
        decide(flat, flat_outside, flat_known, flat_active, w)
        # After the first move most samples that were unsure change: all at once is faster then.
        anew = learnt and iteration == 0 and w.unsure > 0
        dirty[:] = SIDE_CHANGED if anew else _0B
        lattice.stale[:] = anew
        if anew:
            add_changes(values, samples.label, samples.new_label, blocks, rows, odd, sums)
            moved = replace(flat.label, flat.new_label) | replace(flat.inside, flat.new_inside)
            scatter(samples.inside.view(np.uint64), blocks, inside.view(np.uint64))
            blur(inside, mean)
        else:
            moved = move_samples(band, samples, lattice, learnt, mean, block_at, dirty)
        if not moved:
            break
        iteration += 1
        if iteration == w.iterations and not reported:
            break
        if learnt:
            update_densities(lattice, size, w.fewest, w.least_sd)
            mark_blocks(lattice.stale, blocks, rows, size, dirty)
        if reported:
            energies[iteration:] = energy_of(band, samples, mean, lattice, outside_costs, w)
    scatter(samples.contrast.view(np.uint64), blocks, contrast.view(np.uint64))
    scatter(samples.gain.view(np.uint64), blocks, field.view(np.uint64))
    return iteration


@njit(cache=True, error_model="numpy")
def settled(
    band: ContourBand, outside_costs: Float32, w: ContourWeights, pad: int, columns: int, reported: bool, reach: int,
    step: np.float32,
) -> tuple[int, Float32, Float32, Float64]:  # fmt: skip
    """Minimise the contour's energy (`segment`), then compute the signed distance to the contour found.

    Args:
        band, outside_costs, w: samples, (blocks, size) costs of a background model or (0, 0), and weights, as in
            `segment`; ``band.inside`` becomes the result.
        pad, columns: first column and number of columns of the window in its padded rows.
        reported: whether energies are computed.
        reach, step: limit of distances [samples], and distance between samples [px].

    Returns:
        Number of moves; (rows, columns) the contour's signed distance [px], above 0 inside; (rows, columns) evidence of
            the contour at each sample: mean log-likelihood ratio of its side to the other [nats]; and the energies at
            the start and after every move, of `segment` [nats × samples].
    """
    phi, inside = band.phi, band.inside
    field, contrast, sure = phi.copy(), np.zeros_like(phi), np.empty_like(phi)
    odd = (1 + 2 * np.arange(band.values.shape[2])).astype(np.int32)
    energies = np.empty(w.iterations + 1 if reported else 0)
    moved = segment(band, odd, outside_costs, w, field, contrast, energies)
    surety_of(contrast, inside, sure)
    window, surety = np.empty((len(phi), columns), np.float32), np.empty((len(phi), columns), np.float32)
    for i in range(len(phi)):
        a, b, to_a, to_b = field[i, pad:], sure[i, pad:], window[i], surety[i]
        for j in range(columns):
            to_a[j] = a[j]
        for j in range(columns):
            to_b[j] = b[j]
    out = np.empty_like(window)
    signed_distance(window, reach, step, out)
    return moved, out, surety, energies
