"""The loops of `mocapella.sensing.region_contour`, compiled; importing this module imports numba.

A window is padded to whole blocks of samples of a row, between whose ends −log p is linear; blocks that the
band touches are looked at, all of their samples at once. Values of samples are whole numbers (half grey levels from the
middle of the scale), weights of the lattice, too: sums that are kept up as samples change sides are exact, and do not
depend on the order.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLR1714, SIM109, E501 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

OUTLIER, INSIDE, OUTSIDE, UNKNOWN = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
_0F, _1F, _0B, _1B = np.float32(0.0), np.float32(1.0), np.uint8(0), np.uint8(1)
# Loops over a block end at a length that is an array's, not a constant: else they are unrolled, not made vectors of. And
# they are short, over few arrays, whose places apart are asked about before each.


@njit(cache=True, error_model="numpy")
def lay_out(phi, start, band, unguided, pad, size, size_px, x0, y0, step, wide, inside, active, known, blocks):
    """Write a window with its padding, and which of its blocks have anything undecided.

    Args:
        phi: (rows, columns) float32 the prior's signed distance [px]; start: (rows, columns) uint8, 1 inside.
        band: [px] farther from the outline nothing moves, unless ``unguided``.
        pad: columns of padding before the first; size: of a block [samples].
        size_px: (width, height) of the image; x0, y0: the first sample's pixel, which may lie beyond it; step: [px].
        wide: (rows, padded) float32 phi, far outside in the padding; inside: (rows, padded) uint8 where to begin.
        active, known: (rows, padded) uint8, 1 where a sample is undecided, and where the image says anything of it.
        blocks: (capacity, 2) int32 row and block.

    Returns:
        How many blocks.
    """
    rows, columns = phi.shape
    padded = wide.shape[1]
    width, height = size_px
    first, last = min(max((-x0 + step - 1) // step, 0), columns), min(max((width - x0 + step - 1) // step, 0), columns)
    count = 0
    for i in range(rows):
        wide[i] = np.float32(-1e6)
        inside[i] = 0
        active[i] = 0
        known[i] = 0
        p, b = phi[i], start[i]
        w, u, on = wide[i, pad : pad + columns], inside[i, pad : pad + columns], active[i, pad : pad + columns]
        for j in range(columns):
            w[j] = p[j]
            near = abs(p[j]) <= band or unguided
            on[j] = _1B if near else _0B
            begin, usual = b[j], _1B if p[j] > _0F else _0B
            u[j] = begin if near else usual
        if 0 <= y0 + i * step < height:
            known[i, pad + first : pad + last] = active[i, pad + first : pad + last]
        on = active[i]
        for b in range(padded // size):
            some = _0B
            for j in range(b * size, (b + 1) * size):
                some = np.uint8(some | on[j])
            if some:
                blocks[count, 0], blocks[count, 1] = i, b
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def read_samples(image, x0, y0, step, median, size, blocks, values):
    """Write what the image is like about every sample of the blocks of a band.

    A sample is a mean over what lies nearer than a step, weighted like a tent, so that how much of its surroundings is
    inside shows in its value; before that, a median over three rows and columns takes away single wrong pixels.

    Args:
        image: (h, w, channels) uint8.
        x0, y0: the pixel of the first sample, padding included, which may lie beyond the image.
        step: [px]; median: whether there is one.
        size, blocks: of `lay_out`.
        values: (channels, rows, padded) int16 half grey levels, 0 the middle of the scale.
    """
    height, width, channels = image.shape
    columns = values.shape[2]
    taps = 2 * step - 1
    border = 1 if median else 0
    first_x, first_y = x0 - step + 1, y0 - step + 1
    wide = (columns - 1) * step + taps  # pixels that are looked at in a row, after the median
    inner, broad = channels * wide, channels * (wide + 2 * border)
    flat = image.reshape(-1)
    ring = np.empty((3, broad), np.uint8)  # rows of the image
    middle = np.empty(broad, np.uint8)
    smooth = np.empty((taps, inner), np.uint8)
    line, ready = np.empty(inner, np.int32), np.zeros(inner, np.int16)
    begin = first_x - border
    end = begin + wide + 2 * border
    low, high = min(max(begin, 0), width), max(min(end, width), 0)
    whole = step**4
    copied, done, block = 0, 0, 0
    while block < len(blocks):
        i = blocks[block, 0]
        if done < i * step:
            done = i * step
            copied = max(copied, done)
        while done < i * step + taps:  # one more row of what is smoothed
            to = smooth[done % taps]
            while copied < done + 1 + 2 * border:
                y = min(max(first_y - border + copied, 0), height - 1)
                source, target = flat[channels * y * width : channels * (y + 1) * width], ring[copied % 3]
                for x in range(begin, min(low, end)):
                    for c in range(channels):
                        target[channels * (x - begin) + c] = source[c]
                if high > low:
                    span = channels * (high - low)
                    part, place = source[channels * low :], target[channels * (low - begin) :]
                    for k in range(span):
                        place[k] = part[k]
                for x in range(max(high, begin), end):
                    for c in range(channels):
                        target[channels * (x - begin) + c] = source[channels * (width - 1) + c]
                copied += 1
            if median:
                a, b, d = ring[0], ring[1], ring[2]
                for k in range(broad):
                    p, q, r = a[k], b[k], d[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    middle[k] = less if less > more else more
                left, centre, right = middle[:inner], middle[channels:], middle[2 * channels :]
                for k in range(inner):
                    p, q, r = left[k], centre[k], right[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    to[k] = less if less > more else more
            else:
                source = ring[done % 3]
                for k in range(inner):
                    to[k] = source[k]
            done += 1
        if step == 1:
            row = smooth[0]
            for k in range(inner):
                ready[k] = 2 * np.int16(row[k]) - 255
        elif step == 2:
            above, here, below = smooth[2 * i % 3], smooth[(2 * i + 1) % 3], smooth[(2 * i + 2) % 3]
            for k in range(inner):
                line[k] = np.int32(above[k]) + 2 * np.int32(here[k]) + np.int32(below[k])
            left, centre, right = line, line[channels:], line[2 * channels :]
            for k in range(inner - 2 * channels):
                off = left[k] + 2 * centre[k] + right[k] - 2040
                far = (abs(off) + 4) >> 3  # a half is rounded away from the middle: an inverted image gives the same
                ready[k] = far if off >= 0 else -far
        else:
            line[:] = 0
            for t in range(taps):
                row, weight = smooth[(i * step + t) % taps], np.int32(step - abs(t - step + 1))
                for k in range(inner):
                    line[k] += weight * np.int32(row[k])
            for k in range(inner - 2 * channels * (step - 1)):
                total = 0
                for t in range(taps):
                    total += (step - abs(t - step + 1)) * line[k + channels * t]
                off = 2 * total - 255 * whole
                far = (2 * abs(off) + whole) // (2 * whole)
                ready[k] = far if off >= 0 else -far
        while block < len(blocks) and blocks[block, 0] == i:
            column = blocks[block, 1] * size
            for c in range(channels):
                to = values[c, i]
                for j in range(column, column + size):
                    to[j] = ready[channels * step * j + c]
            block += 1


@njit(cache=True)
def forget(ignore, x0, y0, step, reach, known):
    """Samples whose value comes in part of pixels that tell nothing, at most ``reach`` [px] away, are not known."""
    height, width = ignore.shape
    rows, columns = known.shape
    for i in range(rows):
        for j in range(columns):
            if not known[i, j]:
                continue
            x, y = x0 + j * step, y0 + i * step
            for b in range(max(y - reach, 0), min(y + reach + 1, height)):
                for a in range(max(x - reach, 0), min(x + reach + 1, width)):
                    if ignore[b, a]:
                        known[i, j] = 0


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
def _add(values, i, k, j, sign, side, sums):
    """Add a sample to the sums of the four nodes about it, or take it away."""
    channels, rows, _, size = values.shape
    top, low = _down(i, rows, size)
    right = 2 * j + 1
    for b in range(2):
        down = low if b else 2 * size - low
        for a in range(2):
            weight = sign * down * (right if a else 2 * size - right)
            sums[side, top + b, k + a, 0] += weight
            for c in range(channels):
                value = np.int64(values[c, i, k, j])
                sums[side, top + b, k + a, 1 + c] += weight * value
                sums[side, top + b, k + a, 1 + channels + c] += weight * value * value


@njit(cache=True, error_model="numpy")
def _add_all(values, state, blocks, odd, sums):
    """Add all samples to the sums of their sides: over a block, and how far along it, then to the four nodes about."""
    channels, rows, _, size = values.shape
    full = 2 * size
    whole, along = np.empty(sums.shape[3], np.int64), np.empty(sums.shape[3], np.int64)
    on, weight = np.empty(len(odd), np.int32), np.empty(len(odd), np.int32)
    for r in range(len(blocks)):
        i, k = np.int64(blocks[r, 0]), np.int64(blocks[r, 1])
        top, low = _down(i, rows, size)
        for side in range(2):
            wanted = INSIDE if side == 0 else OUTSIDE
            for j in range(size):
                on[j] = np.int32(1) if state[i, k, j] == wanted else np.int32(0)
            count, far = np.int32(0), np.int32(0)
            for j in range(size):
                weight[j] = on[j] * odd[j]
            for j in range(size):
                count += on[j]
                far += weight[j]
            if count == 0:
                continue
            whole[0], along[0] = count, far
            for c in range(channels):
                a, b, x, y = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                for j in range(size):
                    value = np.int32(values[c, i, k, j])
                    a += on[j] * value
                    b += weight[j] * value
                for j in range(size):
                    value = np.int32(values[c, i, k, j])
                    x += on[j] * (value * value)
                    y += weight[j] * (value * value)
                whole[1 + c], along[1 + c] = a, b
                whole[1 + channels + c], along[1 + channels + c] = x, y
            for m in range(len(whole)):
                rest = full * whole[m] - along[m]
                sums[side, top, k, m] += (full - low) * rest
                sums[side, top, k + 1, m] += (full - low) * along[m]
                sums[side, top + 1, k, m] += low * rest
                sums[side, top + 1, k + 1, m] += low * along[m]


@njit(cache=True, error_model="numpy")
def densities(sums, both, size, fewest, least_sd, coefficients):
    """Write each node's densities as −log p = a + b v + c v², as of three channels [nats].

    Where there are few samples, a density leans on that of all samples about the node, as if ``fewest`` of those were
    on its side.

    Args:
        sums: (2, node rows, node columns, 1 + 2 channels) int64; both: (node rows, node columns, 1 + 2 channels).
        size: of a block [samples]; fewest: [samples]; least_sd: [half grey levels].
        coefficients: (node rows, node columns, 2 + 4 channels) float32: a inside and outside, then of every channel
            b and c inside and outside.

    Returns:
        The cost of what the densities lean on [samples × nats].
    """
    _, rows, columns, terms = sums.shape
    channels = terms // 2
    unit, share, least = 1.0 / (4 * size * size), 3.0 / channels, least_sd * least_sd
    cost = 0.0
    for i in range(rows):
        for k in range(columns):
            if both[i, k, 0] == 0:
                coefficients[i, k] = 0.0
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
    return cost


@njit(cache=True, error_model="numpy")
def _energy(inside, mean, pull, state, known, outside_costs, inside_cost, coefficients, sums, lean, size, length, most):
    """What an outline costs [nats × samples], with the densities that were learnt of it."""
    rows, columns = inside.shape
    modelled, learnt, unit = outside_costs.size > 0, math.isnan(inside_cost), 1.0 / (4 * size * size)
    energy = lean
    for i in range(rows):
        for j in range(columns):
            u = inside[i, j]
            if u:
                energy += length * (1.0 - mean[i, j] / 256.0) - pull[i, j]
            if not known[i, j]:
                continue
            if u and not learnt:
                energy += inside_cost
            elif modelled and not u:
                energy += min(outside_costs[i, j], most)
            elif state[i, j] == OUTLIER:
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
def _costs_of_gray(row, values, i, k, along, one, two):
    """Write −log p of a block's samples, of gray, inside and outside: (blocks of a row, size)."""
    a0, a1 = row[k, 0], row[k, 1]
    a0_rise, a1_rise = row[k + 1, 0] - a0, row[k + 1, 1] - a1
    b00 = row[k, 2]
    b00_rise = row[k + 1, 2] - b00
    c00 = row[k, 4]
    c00_rise = row[k + 1, 4] - c00
    b01 = row[k, 3]
    b01_rise = row[k + 1, 3] - b01
    c01 = row[k, 5]
    c01_rise = row[k + 1, 5] - c01
    for j in range(len(along)):
        t = along[j]
        v0 = np.float32(values[0, i, k, j])
        cost = (a0 + t * a0_rise) + v0 * ((b00 + t * b00_rise) + v0 * (c00 + t * c00_rise))
        one[k, j] = cost
        cost = (a1 + t * a1_rise) + v0 * ((b01 + t * b01_rise) + v0 * (c01 + t * c01_rise))
        two[k, j] = cost


@njit(cache=True, error_model="numpy")
def _costs_of_colour(row, values, i, k, along, one, two):
    """Write −log p of a block's samples, of three channels, inside and outside: (blocks of a row, size)."""
    a0, a1 = row[k, 0], row[k, 1]
    a0_rise, a1_rise = row[k + 1, 0] - a0, row[k + 1, 1] - a1
    b00 = row[k, 2]
    b00_rise = row[k + 1, 2] - b00
    c00 = row[k, 4]
    c00_rise = row[k + 1, 4] - c00
    b01 = row[k, 3]
    b01_rise = row[k + 1, 3] - b01
    c01 = row[k, 5]
    c01_rise = row[k + 1, 5] - c01
    b10 = row[k, 6]
    b10_rise = row[k + 1, 6] - b10
    c10 = row[k, 8]
    c10_rise = row[k + 1, 8] - c10
    b11 = row[k, 7]
    b11_rise = row[k + 1, 7] - b11
    c11 = row[k, 9]
    c11_rise = row[k + 1, 9] - c11
    b20 = row[k, 10]
    b20_rise = row[k + 1, 10] - b20
    c20 = row[k, 12]
    c20_rise = row[k + 1, 12] - c20
    b21 = row[k, 11]
    b21_rise = row[k + 1, 11] - b21
    c21 = row[k, 13]
    c21_rise = row[k + 1, 13] - c21
    for j in range(len(along)):
        t = along[j]
        v0 = np.float32(values[0, i, k, j])
        v1 = np.float32(values[1, i, k, j])
        v2 = np.float32(values[2, i, k, j])
        cost = (a0 + t * a0_rise) + v0 * ((b00 + t * b00_rise) + v0 * (c00 + t * c00_rise))
        cost = cost + v1 * ((b10 + t * b10_rise) + v1 * (c10 + t * c10_rise))
        cost = cost + v2 * ((b20 + t * b20_rise) + v2 * (c20 + t * c20_rise))
        one[k, j] = cost
        cost = (a1 + t * a1_rise) + v0 * ((b01 + t * b01_rise) + v0 * (c01 + t * c01_rise))
        cost = cost + v1 * ((b11 + t * b11_rise) + v1 * (c11 + t * c11_rise))
        cost = cost + v2 * ((b21 + t * b21_rise) + v2 * (c21 + t * c21_rise))
        two[k, j] = cost


@njit(cache=True, error_model="numpy")
def segment(
    values, active, known, phi, blocks, inside, odd, outside_costs, prior_weight, length, slope, guided, unsure, fewest,
    least_sd, most, inside_cost, iterations, field, contrast, energies,
):  # fmt: skip
    """Move an outline to where the energy is least; how many times it was moved.

    Args:
        values: (channels, rows, blocks of a row, size) int16 half grey levels.
        active, known, phi, blocks, inside: of `lay_out`; inside becomes what was found.
        odd: (size,) int32 1, 3, 5 …: how far along a block a sample is [1 / (2 size)].
        outside_costs: (rows, padded) float32 −log p2 [nats] of a model of the background, or (0, 0); NaN: it is learnt.
        prior_weight: [nats/px²]; length: [nats] that a sample in the midst of the other side costs; slope: [1/px] of a
            straight outline's blurred mask, doubled.
        guided: whether there is a prior.
        unsure: [px] nearer to the prior's outline, nothing is learnt from at first.
        fewest, least_sd: as in `densities`; most: [nats] at which −log p is cut off.
        inside_cost: [nats] −log p1 where it is the same everywhere; NaN where it is learnt.
        iterations: at most.
        field: (rows, padded) float32, above 0 inside: what every sample gains by that [nats]; phi beyond the band.
        contrast: (rows, padded) float32 log p1 − log p2 [nats]; 0 where nothing is known, and beyond the band.
        energies: (iterations + 1,) float64 [nats × samples] at first and after every move; none are summed where (0,).
    """
    channels, rows, row_blocks, size = values.shape
    columns, terms = row_blocks * size, 1 + 2 * channels
    mean = np.empty((rows, columns), np.uint16)
    # What a sample gains by being inside, of the prior alone.
    pull, state = np.zeros((rows, columns), np.float32), np.empty((rows, columns), np.uint8)
    prior = np.empty((rows, columns), np.uint8)
    for i in range(rows):
        for j in range(columns):
            prior[i, j] = _1B if phi[i, j] > _0F else _0B
    blur(prior, mean)
    scale = np.float32(1 / 128)
    for i in range(rows):
        for j in range(columns):
            p = phi[i, j]
            straight = slope * p
            straight = straight if straight < _1F else _1F
            straight = straight if straight > -_1F else -_1F
            gain = prior_weight * p * abs(p) + length * (straight + _1F - scale * np.float32(mean[i, j]))
            pull[i, j] = gain if guided else _0F
        for j in range(columns):
            gain = pull[i, j]
            pull[i, j] = gain if active[i, j] > _0B else _0F
        for j in range(columns):
            field[i, j] = phi[i, j]
        for j in range(columns):
            contrast[i, j] = _0F
        for j in range(columns):
            state[i, j] = INSIDE if inside[i, j] > _0B else OUTSIDE
        for j in range(columns):
            side = state[i, j]
            state[i, j] = side if abs(phi[i, j]) >= unsure else OUTLIER
        for j in range(columns):
            side = state[i, j]
            state[i, j] = side if known[i, j] > _0B else UNKNOWN

    modelled, learnt, told = outside_costs.size > 0, math.isnan(inside_cost), energies.size > 0
    shape = (rows, row_blocks, size)
    states = state.reshape(shape)
    sums = np.zeros((2, node_rows(rows, size), row_blocks + 1, terms), np.int64)
    both = np.zeros(sums.shape[1:], np.int64)
    coefficients = np.zeros((node_rows(rows, size), row_blocks + 1, 2 + 4 * channels), np.float32)
    lean = 0.0
    if learnt:
        _add_all(values, states, blocks, odd, sums)
        both[:] = sums[0] + sums[1]
        lean = densities(sums, both, size, fewest, least_sd, coefficients)
    blur(inside, mean)
    if told:
        energies[:] = _energy(
            inside, mean, pull, state, known, outside_costs, inside_cost, coefficients, sums, lean, size, length, most
        )
    row = np.zeros((row_blocks + 1, 2 + 4 * channels), np.float32)
    flat_row = row.reshape(-1)
    one, two = np.zeros((row_blocks, size), np.float32), np.zeros((row_blocks, size), np.float32)
    ones, twos, gains = one.reshape(-1), two.reshape(-1), np.empty(columns, np.float32)
    fields, news, along = np.empty(columns, np.float32), np.empty(columns, np.uint8), np.empty(len(odd), np.float32)
    for j in range(size):
        along[j] = np.float32(odd[j]) / np.float32(2 * size)
    inner = np.float32(0.0 if learnt else inside_cost)
    for iteration in range(iterations):
        changes, block = 0, 0
        while block < len(blocks):
            i = int(blocks[block, 0])
            top, low = _down(i, rows, size)
            above, below = coefficients[top].reshape(-1), coefficients[top + 1].reshape(-1)
            t = np.float32(low) / np.float32(2 * size)
            for q in range(len(flat_row)):
                flat_row[q] = above[q] + t * (below[q] - above[q])
            while block < len(blocks) and blocks[block, 0] == i:
                k = int(blocks[block, 1])
                if channels == 3:
                    _costs_of_colour(row, values, i, k, along, one, two)
                else:
                    _costs_of_gray(row, values, i, k, along, one, two)
                block += 1
            # All of the row: longer loops are faster, and beside the blocks nothing is active.
            if not learnt:
                ones[:] = inner
            if modelled:
                for j in range(columns):
                    cost = outside_costs[i, j]
                    twos[j] = twos[j] if math.isnan(cost) else cost
            for j in range(columns):
                cost = ones[j]
                ones[j] = cost if cost < most else most
            for j in range(columns):
                cost = twos[j]
                twos[j] = cost if cost < most else most
            for j in range(columns):
                gain = twos[j] - ones[j]
                gains[j] = gain if known[i, j] > _0B else _0F
            for j in range(columns):
                fields[j] = gains[j] + pull[i, j] + length * (scale * np.float32(mean[i, j]) - _1F)
            for j in range(columns):
                a, b = fields[j], phi[i, j]
                fields[j] = a if active[i, j] > _0B else b
            for j in range(columns):
                field[i, j] = fields[j]
            for j in range(columns):
                contrast[i, j] = gains[j]
            for j in range(columns):
                a, b = ones[j], twos[j]
                ones[j] = a if fields[j] > _0F else b
            for j in range(columns):
                news[j] = INSIDE if fields[j] > _0F else OUTSIDE
            moved = _0B
            for j in range(columns):
                now = np.uint8(OUTSIDE - news[j])
                moved = np.uint8(moved | np.uint8(now ^ inside[i, j]))
                inside[i, j] = now
            for j in range(columns):
                side = news[j]
                news[j] = side if ones[j] < most else OUTLIER
            different = _0B
            for j in range(columns):
                side = news[j]
                now = side if known[i, j] > _0B else UNKNOWN
                news[j] = now
                different = np.uint8(different | np.uint8(now ^ state[i, j]))
            if moved or different:
                changes += 1
            if not different:
                continue
            for j in range(columns):
                before, now = state[i, j], news[j]
                if before == now:
                    continue
                state[i, j] = now
                if learnt and iteration > 0:
                    k = j // size
                    if before == INSIDE or before == OUTSIDE:
                        _add(values, i, k, j - k * size, -1, before - 1, sums)
                    if now == INSIDE or now == OUTSIDE:
                        _add(values, i, k, j - k * size, 1, now - 1, sums)
        if changes == 0:
            return iteration
        if learnt and iteration == 0:  # most was unsure and changes: all anew is faster
            sums[:] = 0
            _add_all(values, states, blocks, odd, sums)
        if iteration == iterations - 1 and not told:
            break
        blur(inside, mean)
        if learnt:
            lean = densities(sums, both, size, fewest, least_sd, coefficients)
        if told:
            energies[iteration + 1 :] = _energy(
                inside, mean, pull, state, known, outside_costs, inside_cost, coefficients, sums, lean, size, length,
                most,
            )  # fmt: skip
    return iterations


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
def background_costs(values, usual, spread, known, least_sd, darkest, shadow, out):
    """Write −log p of every sample's value, as of three channels, where nobody is [nats].

    Args:
        values, usual: (channels, rows, padded) int16 half grey levels from the middle of the scale.
        spread: (channels, rows, padded) int16, a standard deviation as 8 × grey levels − 255.
        known: (rows, padded) uint8; least_sd: [half grey levels].
        darkest: of its usual brightness, in a shadow; shadow: [nats] that it costs to say that there is one.
        out: (rows, padded) float32; 0 where nothing is known.
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
