"""The loops of `mocapella.sensing.region_contour`, compiled; importing this module imports numba.

A window is padded to whole blocks of samples of a row, between whose ends −log p is linear; blocks that the
band touches are looked at, all of their samples at once, and again only where something changed since. Values of samples are whole numbers (half grey levels from the
middle of the scale), weights of the lattice, too: sums that are kept up as samples change sides are exact, and do not
depend on the order.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLR1714, SIM109, E501 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.signed_distance_kernels import signed_distance

OUTLIER, INSIDE, OUTSIDE, UNKNOWN = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
_0F, _1F, _0B, _1B = np.float32(0.0), np.float32(1.0), np.uint8(0), np.uint8(1)
_DENSER, _FLIPPED = np.uint8(1), np.uint8(2)
"""Why a block has to be looked at again: densities changed, or a sample near it, in it or not."""
# Loops over a block end at a length that is an array's, not a constant: else they are unrolled, not made vectors of. And
# they are short, over few arrays, whose places apart are asked about before each.


@njit(cache=True)
def node_rows(rows, size):
    """How many rows of nodes there are, ``size`` samples apart, about so many rows of samples."""
    return (rows + size - 1) // size + 1


@njit(cache=True)
def _down(i, rows, size):
    """The row of nodes above a row of samples, and how much of it belongs to the next one [1 / (2 size)].

    They lie alike from above and from below.
    """
    doubled = 2 * i + 1 - rows + (node_rows(rows, size) - 1) * size
    return doubled // (2 * size), doubled % (2 * size)


@njit(cache=True, error_model="numpy")
def blur(inside, out):
    """Write a binomial mean over 5 × 5 samples of a mask [1/256]; beyond the window there is nothing.

    Args:
        inside: (rows, columns) uint8, 0 or 1.
        out: (rows, columns) uint16.
    """
    rows, columns = inside.shape
    line, down = np.zeros(columns + 4, np.uint8), np.zeros((rows + 4, columns), np.uint8)
    a, b, c, d, e = line[:columns], line[1:], line[2:], line[3:], line[4:]
    for i in range(rows):
        for j in range(columns):
            c[j] = inside[i, j]
        for j in range(columns):
            down[i + 2, j] = np.uint8(np.uint8(a[j] + e[j]) + np.uint8(np.uint8(b[j] + d[j]) << 2) + np.uint8(c[j] * 6))
    for i in range(rows):
        for j in range(columns):
            outer = np.uint16(down[i, j]) + np.uint16(down[i + 4, j])
            inner = np.uint16(down[i + 1, j]) + np.uint16(down[i + 3, j])
            out[i, j] = np.uint16(outer + (inner << 2) + np.uint16(down[i + 2, j]) * 6)


@njit(cache=True, error_model="numpy")
def _add(values, n, j, top, low, k, sign, side, sums):
    """Add a sample of a block to the sums of the four nodes about it, or take it away."""
    channels, _, size = values.shape
    right = 2 * j + 1
    for b in range(2):
        down = low if b else 2 * size - low
        for a in range(2):
            weight = sign * down * (right if a else 2 * size - right)
            sums[side, top + b, k + a, 0] += weight
            for c in range(channels):
                value = np.int64(values[c, n, j])
                sums[side, top + b, k + a, 1 + c] += weight * value
                sums[side, top + b, k + a, 1 + channels + c] += weight * value * value


@njit(cache=True, error_model="numpy")
def _add_all(values, before, state, blocks, rows, odd, sums):
    """Add all samples to the sums of their sides that were on others before, and take them away from these: over a
    block, and how far along it, then to the four nodes about.
    """
    channels, _, size = values.shape
    full = 2 * size
    whole, along = np.empty(sums.shape[3], np.int64), np.empty(sums.shape[3], np.int64)
    on, weight = np.empty(len(odd), np.int32), np.empty(len(odd), np.int32)
    aside = odd - np.int32(size)  # from a block's middle: squares of long blocks would be too much for 32 bits
    was, now, eights = before.reshape(-1).view(np.uint64), state.reshape(-1).view(np.uint64), size // 8
    for n in range(len(blocks)):
        same = True
        for m in range(n * eights, n * eights + eights):
            same &= was[m] == now[m]
        if same:
            continue
        k = np.int64(blocks[n, 1])
        top, low = _down(np.int64(blocks[n, 0]), rows, size)
        for side in range(2):
            wanted = INSIDE if side == 0 else OUTSIDE
            for j in range(size):
                on[j] = np.int32(state[n, j] == wanted) - np.int32(before[n, j] == wanted)
            count, far, some = np.int32(0), np.int32(0), np.int32(0)
            for j in range(size):
                weight[j] = on[j] * odd[j]
            for j in range(size):
                count = np.int32(count + on[j])
                far = np.int32(far + weight[j])
                some = np.int32(some | on[j])
            if some == 0:
                continue
            whole[0], along[0] = count, far
            for c in range(channels):
                a, b, x, y = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                for j in range(size):
                    value = np.int32(values[c, n, j])
                    once = np.int32(on[j] * value)
                    a = np.int32(a + once)
                    b = np.int32(b + np.int32(odd[j] * once))
                    square = np.int32(once * value)
                    x = np.int32(x + square)
                    y = np.int32(y + np.int32(aside[j] * square))
                whole[1 + c], along[1 + c] = a, b
                whole[1 + channels + c], along[1 + channels + c] = x, np.int64(size) * x + y
            for m in range(len(whole)):
                rest = full * whole[m] - along[m]
                sums[side, top, k, m] += (full - low) * rest
                sums[side, top, k + 1, m] += (full - low) * along[m]
                sums[side, top + 1, k, m] += low * rest
                sums[side, top + 1, k + 1, m] += low * along[m]


@njit(cache=True, error_model="numpy")
def densities(sums, both, size, fewest, least_sd, stale, leans, coefficients):
    """Write each node's densities as −log p = a + b v + c v², as of three channels [nats].

    Where there are few samples, a density leans on that of all samples about the node, as if ``fewest`` of those were
    on its side.

    Args:
        sums: (2, node rows, node columns, 1 + 2 channels) int64; both: (node rows, node columns, 1 + 2 channels).
        size: of a block [samples]; fewest: [samples]; least_sd: [half grey levels].
        stale: (node rows, node columns) uint8, 1 where sums have changed since.
        leans: (node rows, node columns) the cost of what the densities lean on [samples × nats].
        coefficients: (node rows, node columns, 2 + 4 channels) float32: a inside and outside, then of every channel
            b and c inside and outside.
    """
    _, rows, columns, terms = sums.shape
    channels = terms // 2
    unit, share, least = 1.0 / (4 * size * size), 3.0 / channels, least_sd * least_sd
    for i in range(rows):
        for k in range(columns):
            if not stale[i, k]:
                continue
            cost = 0.0
            if both[i, k, 0] == 0:
                coefficients[i, k] = 0.0
                leans[i, k] = 0.0
                continue
            count = both[i, k, 0] * unit
            to = coefficients[i, k]
            for side in range(2):
                own = sums[side, i, k]
                total = own[0] * unit + fewest
                a, product, off = 0.0, 1.0, 0.0
                for c in range(channels):
                    common = both[i, k, 1 + c] * unit / count
                    spread = max(both[i, k, 1 + channels + c] * unit / count - common * common, least)
                    mean = (own[1 + c] * unit + fewest * common) / total
                    square = (own[1 + channels + c] * unit + fewest * (spread + common * common)) / total
                    variance = max(square - mean * mean, least)
                    product *= variance
                    a += mean * mean / variance
                    off += (spread + (mean - common) * (mean - common)) / variance
                    to[2 + 4 * c + side] = -share * mean / variance
                    to[4 + 4 * c + side] = 0.5 * share / variance
                size = math.log(product)
                to[side] = 0.5 * share * (a + size)
                cost += 0.5 * share * fewest * (size + off)
            leans[i, k] = cost


@njit(cache=True, error_model="numpy")
def _energy(
    inside, mean, on, pull, state, known, outside_costs, inside_cost, coefficients, sums, leans, size, length, most
):
    """What an outline costs [nats × samples], with the densities that were learnt of it."""
    rows, columns = inside.shape
    modelled, learnt, unit = outside_costs.size > 0, math.isnan(inside_cost), 1.0 / (4 * size * size)
    energy = leans.sum()
    for i in range(rows):
        for j in range(columns):
            if inside[i, j]:
                energy += length * (1.0 - mean[i, j] / 256.0)
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


@njit(cache=True, error_model="numpy", forceinline=True)
def _costs_of_gray(row, rise, k, values, n, along, one, two, outside):
    """Write −log p of a block's samples, of gray, inside, and ``outside`` if wanted: (blocks, size)."""
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
def _costs_of_colour(row, rise, k, values, n, along, one, two, outside):
    """Write −log p of a block's samples, of three channels, inside, and ``outside`` if wanted: (blocks, size)."""
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
def _costs(levels, blocks, rows, along, coefficients, dirty, modelled, one, two):
    """Write −log p of the samples of all blocks that are dirty: (blocks, size) inside, and outside.

    Args:
        levels: (channels, blocks, size) float32 values.
        modelled: (blocks,) uint8, 1 where outside nothing is wanted.
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
            top, low = _down(i, rows, len(along))
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
def _decide(ones, twos, outside, known, active, pull, mean, near, fields, gains, own, news, nows, length, most, inner):
    """Write on which side samples cost less, and by how much: all arrays are of the same samples, one after another."""
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
def _flip(inside, i, j, size, mean, place, dirty):
    """A sample changes sides: the blurred mask changes with it, and the blocks about it have to be looked at again."""
    rows, columns = inside.shape
    now = 1 - np.int64(inside[i, j])
    inside[i, j] = now
    sign = 2 * now - 1
    for a in range(max(i - 2, 0), min(i + 3, rows)):
        down = 6 if a == i else 4 if abs(a - i) == 1 else 1
        for b in range(max(j - 2, 0), min(j + 3, columns)):
            across = 6 if b == j else 4 if abs(b - j) == 1 else 1
            mean[a, b] = np.int64(mean[a, b]) + sign * down * across
        for k in range(max(j - 2, 0) // size, (min(j + 2, columns - 1)) // size + 1):
            if place[a, k] >= 0:
                dirty[place[a, k]] = _FLIPPED


@njit(cache=True, error_model="numpy")
def _take_over(values, blocks, state, news, on, nows, learning, inside, mean, place, dirty, sums, stale):
    """Let samples go to the sides where they cost less, and say what has to be looked at again for that.

    Args:
        values, blocks: as of `segment`.
        state, on: (blocks, size) which become ``news`` and ``nows``; size is a multiple of 8.
        learning: whether sums are kept up.
        inside, mean, place, dirty: of `_flip`.
        sums, stale: of `densities`.

    Returns:
        Whether any did.
    """
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
        top, low = _down(i, rows, size)
        first = 8 * (m - n * eights)
        for j in range(first, first + 8):
            if nows[n, j] != on[n, j]:
                _flip(inside, i, k * size + j, size, mean, place, dirty)
            before, now = state[n, j], news[n, j]
            if not learning or before == now:
                continue
            if before == INSIDE or before == OUTSIDE:
                _add(values, n, j, top, low, k, -1, before - 1, sums)
            if now == INSIDE or now == OUTSIDE:
                _add(values, n, j, top, low, k, 1, now - 1, sums)
            for a in range(top, top + 2):
                for b in range(k, k + 2):
                    stale[a, b] = 1
        states[m], ons[m] = news_by_8[m], nows_by_8[m]
    return any_did


@njit(cache=True, error_model="numpy")
def segment(
    values, active, known, phi, blocks, inside, odd, outside_costs, prior_weight, length, slope, guided, unsure, fewest,
    least_sd, most, inside_cost, iterations, field, contrast, energies,
):  # fmt: skip
    """Move an outline to where the energy is least; how many times it was moved.

    Args:
        values: (channels, blocks, size) int16 half grey levels.
        active, known, phi, blocks, inside: of `lay_out`; inside becomes what was found.
        odd: (size,) int32 1, 3, 5 …: how far along a block a sample is [1 / (2 size)].
        outside_costs: (blocks, size) float32 −log p2 [nats] of a model of the background, or (0, 0); NaN: it is learnt.
        prior_weight: [nats/px²]; length: [nats] that a sample in the midst of the other side costs; slope: [1/px] of a
            straight outline's blurred mask, doubled.
        guided: whether there is a prior.
        unsure: [px] nearer to the prior's outline, nothing is learnt from at first.
        fewest, least_sd: as in `densities`; most: [nats] at which −log p is cut off.
        inside_cost: [nats] −log p1 where it is the same everywhere; NaN where it is learnt.
        iterations: at most.
        field: (rows, padded) float32, above 0 inside; in the band it becomes what every sample gains by that [nats].
        contrast: (rows, padded) float32, becomes log p1 − log p2 [nats] there; 0 where nothing is known.
        energies: (iterations + 1,) float64 [nats × samples] at first and after every move; none are summed where (0,).
    """
    channels, count, size = values.shape
    (rows, columns), row_blocks = phi.shape, phi.shape[1] // size
    learnt, told = math.isnan(inside_cost), energies.size > 0
    # Of the blocks, one after another: the prior's distance, the blurred mask, and what a sample gains by being inside,
    # of the prior alone.
    near, means = np.empty((count, size), np.float32), np.empty((count, size), np.uint16)
    pull, state = np.empty((count, size), np.float32), np.empty((count, size), np.uint8)
    on = np.empty((count, size), np.uint8)
    mean, prior = np.empty((rows, columns), np.uint16), np.empty((rows, columns), np.uint8)
    place = np.full((rows, row_blocks), -1, np.int32)
    begun = _0B
    for i in range(rows):
        for j in range(columns):
            side = _1B if phi[i, j] > _0F else _0B
            prior[i, j] = side
            begun = np.uint8(begun | np.uint8(side ^ inside[i, j]))
    blur(prior, mean)
    dirty = np.full(count, _FLIPPED, np.uint8)
    means_by_8, mean_by_8 = means.view(np.uint64), mean.view(np.uint64)
    _take(phi.view(np.uint64), blocks, dirty, _FLIPPED, near.view(np.uint64))
    _take(mean_by_8, blocks, dirty, _FLIPPED, means_by_8)
    _take(inside.view(np.uint64), blocks, dirty, _FLIPPED, on.view(np.uint64))
    for n in range(count):
        place[blocks[n, 0], blocks[n, 1]] = n
    _begin(
        near.reshape(-1), means.reshape(-1), on.reshape(-1), active.reshape(-1), known.reshape(-1), prior_weight, length,
        slope, guided, unsure, pull.reshape(-1), state.reshape(-1),
    )  # fmt: skip
    nodes, terms = (node_rows(rows, size), row_blocks + 1), 1 + 2 * channels
    sums = np.zeros((2, nodes[0], nodes[1], terms), np.int64)
    coefficients = np.zeros((nodes[0], nodes[1], 2 + 4 * channels), np.float32)
    leans, stale = np.zeros(nodes), np.ones(nodes, np.uint8)
    if learnt:
        _add_all(values, np.zeros_like(state), state, blocks, rows, odd, sums)
    both = sums[0] + sums[1]
    if learnt:
        densities(sums, both, size, fewest, least_sd, stale, leans, coefficients)
    if begun:  # elsewhere than the prior
        blur(inside, mean)
    if told:
        energies[:] = _energy(
            inside, mean, on, pull, state, known, outside_costs, inside_cost, coefficients, sums, leans, size, length,
            most,
        )  # fmt: skip
    one, two = np.empty((count, size), np.float32), np.zeros((count, size), np.float32)
    levels = values.astype(np.float32)
    along = odd.astype(np.float32) / np.float32(2 * size)
    fields, gains = np.empty((count, size), np.float32), np.empty((count, size), np.float32)
    own = np.empty((count, size), np.float32)
    news, nows = state.copy(), on.copy()
    inner = np.float32(math.nan if learnt else inside_cost)
    modelled = np.zeros(count, np.uint8)  # whose samples a model of the background says all of
    for n in range(len(outside_costs)):
        unknown = False
        for j in range(size):
            unknown |= outside_costs[n, j] != outside_costs[n, j]
        modelled[n] = not unknown
    # All samples of all blocks go through the long loops, also of those that nothing changed for: that is faster.
    flat = (
        one.reshape(-1), two.reshape(-1), outside_costs.reshape(-1), known.reshape(-1), active.reshape(-1),
        pull.reshape(-1), means.reshape(-1), near.reshape(-1), fields.reshape(-1), gains.reshape(-1), own.reshape(-1),
        news.reshape(-1), nows.reshape(-1),
    )  # fmt: skip
    iteration = 0
    while iteration < iterations:
        _take(mean_by_8, blocks, dirty, _FLIPPED, means_by_8)
        _costs(levels, blocks, rows, along, coefficients, dirty, modelled, one, two)
        _decide(*flat, length, most, inner)
        # At first most was unsure, and changes: all at once is faster.
        anew = learnt and iteration == 0 and unsure > 0
        dirty[:] = _FLIPPED if anew else _0B
        stale[:] = anew
        if anew:
            _add_all(values, state, news, blocks, rows, odd, sums)
            moved = _become(state.reshape(-1), news.reshape(-1)) | _become(on.reshape(-1), nows.reshape(-1))
            _put(on.view(np.uint64), blocks, inside.view(np.uint64))
            blur(inside, mean)
        else:
            moved = _take_over(values, blocks, state, news, on, nows, learnt, inside, mean, place, dirty, sums, stale)
        if not moved:
            break
        iteration += 1
        if iteration == iterations and not told:
            break
        if learnt:
            densities(sums, both, size, fewest, least_sd, stale, leans, coefficients)
            _blocks_of(stale, blocks, rows, size, dirty)
        if told:
            energies[iteration:] = _energy(
                inside, mean, on, pull, state, known, outside_costs, inside_cost, coefficients, sums, leans, size, length,
                most,
            )  # fmt: skip
    _put(gains.view(np.uint64), blocks, contrast.view(np.uint64))
    _put(fields.view(np.uint64), blocks, field.view(np.uint64))
    return iteration


@njit(cache=True, error_model="numpy")
def _begin(near, mean, on, active, known, prior_weight, length, slope, guided, unsure, pull, state):
    """Write what samples gain by being inside, of the prior alone, and their sides: (samples,) one after another."""
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


@njit(cache=True, error_model="numpy")
def _take(picture, blocks, chosen, wanted, out):
    """Write a picture's blocks one after another, of those chosen: all are seen as whole numbers of 8 bytes each.

    Args:
        picture: (rows, words of a row) uint64.
        chosen: (blocks,) uint8, of which ``wanted`` or more.
        out: (blocks, words of a block) uint64.
    """
    words = out.shape[1]
    for n in range(len(blocks)):
        if chosen[n] >= wanted:
            i, first = blocks[n, 0], blocks[n, 1] * words
            for m in range(words):
                out[n, m] = picture[i, first + m]


@njit(cache=True, error_model="numpy")
def _put(parts, blocks, picture):
    """Write the blocks of a picture, as of `_take`."""
    words = parts.shape[1]
    for n in range(len(blocks)):
        i, first = blocks[n, 0], blocks[n, 1] * words
        for m in range(words):
            picture[i, first + m] = parts[n, m]


@njit(cache=True, error_model="numpy")
def _become(old, new):
    """What is old becomes what is new, (samples,) uint8; whether it was anything else."""
    other = _0B
    for j in range(len(old)):
        other |= old[j] ^ new[j]
        old[j] = new[j]
    return other > _0B


@njit(cache=True, error_model="numpy")
def _blocks_of(stale, blocks, rows, size, dirty):
    """Blocks whose densities have changed at one of their four nodes have to be looked at again."""
    last, top = np.int64(-1), np.int64(0)
    for n in range(len(blocks)):
        i, k = np.int64(blocks[n, 0]), np.int64(blocks[n, 1])
        if i != last:
            last, (top, _) = i, _down(i, rows, size)
        if stale[top, k] | stale[top, k + 1] | stale[top + 1, k] | stale[top + 1, k + 1]:
            dirty[n] = max(dirty[n], _DENSER)


@njit(cache=True, error_model="numpy")
def surety_of(contrast, inside, out):
    """Write the binomial mean over 5 × 5 samples of how much a sample's value speaks for the side it is on [nats].

    Args:
        contrast: (rows, columns) float32 log p1 − log p2, 0 where nothing is known.
        inside: (rows, columns) uint8.
        out: (rows, columns) float32; 0 where what is seen speaks against it.
    """
    rows, columns = contrast.shape
    line, across = np.zeros(columns + 4, np.float32), np.zeros((rows + 4, columns), np.float32)
    four, six, scale = np.float32(4.0), np.float32(6.0), np.float32(1 / 256)
    for i in range(rows):
        source, side, to = contrast[i], inside[i], across[i + 2]
        a, b, c = line[:columns], line[1 : 1 + columns], line[2 : 2 + columns]
        d, e = line[3 : 3 + columns], line[4 : 4 + columns]
        for j in range(columns):
            value = source[j]
            c[j] = value if side[j] > 0 else -value
        for j in range(columns):
            to[j] = (a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j]
    for i in range(rows):
        a, b, c, d, e, to = across[i], across[i + 1], across[i + 2], across[i + 3], across[i + 4], out[i]
        for j in range(columns):
            mean = scale * ((a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j])
            to[j] = mean if mean > _0F else _0F


@njit(cache=True, error_model="numpy")
def settled(
    values, active, known, phi, blocks, inside, outside_costs, pad, columns, prior_weight, length, slope, guided, unsure,
    fewest, least_sd, most, inside_cost, iterations, told, reach, step,
):  # fmt: skip
    """All of this, and how far samples are from what was found.

    Args:
        values, active, known, phi, blocks, inside, outside_costs, prior_weight, length, slope, guided, unsure, fewest,
            least_sd, most, inside_cost, iterations: of `segment`; told: whether energies are.
        pad, columns: what of the rows is the window.
        reach, step: of `signed_distance`.

    Returns:
        How many times the outline was moved, its signed distance and `surety_of` it (rows, columns), and energies.
    """
    field, contrast, sure = phi.copy(), np.zeros_like(phi), np.empty_like(phi)
    odd = (1 + 2 * np.arange(values.shape[2])).astype(np.int32)
    energies = np.empty(iterations + 1 if told else 0)
    moved = segment(
        values, active, known, phi, blocks, inside, odd, outside_costs, prior_weight, length, slope, guided, unsure,
        fewest, least_sd, most, inside_cost, iterations, field, contrast, energies,
    )  # fmt: skip
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


@njit(cache=True, error_model="numpy")
def background_costs(values, usual, spread, known, least_sd, darkest, shadow, out):
    """Write −log p of every sample's value, as of three channels, where nobody is [nats].

    Args:
        values, usual: (channels, blocks, size) int16 half grey levels from the middle of the scale.
        spread: (channels, blocks, size) int16, a standard deviation as 8 × grey levels − 255.
        known: (blocks, size) uint8; least_sd: [half grey levels].
        darkest: of its usual brightness, in a shadow; shadow: [nats] that it costs to say that there is one.
        out: (blocks, size) float32; 0 where nothing is known.
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
