"""The loops of `mocapella.sensing.region_contour`, compiled; importing this module imports numba.

Values of samples are whole numbers (half grey levels from the middle of the scale), weights of the lattice, too: sums
that are kept up as samples change sides are exact, and do not depend on the order.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLR1730 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

OUTLIER, INSIDE, OUTSIDE, UNKNOWN = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
_0F, _1F, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


@njit(cache=True, error_model="numpy")
def read_samples(image, x0, y0, step, median, values, known):
    """Write what the image is like about every sample of a window.

    A sample is a mean over what lies nearer than a step, weighted like a tent, so that how much of its surroundings is
    inside shows in its value; before that, a median over three rows and columns takes away single wrong pixels.

    Args:
        image: (h, w, channels) uint8.
        x0, y0: the first sample's pixel, which may lie beyond the image.
        step: [px].
        median: whether there is one.
        values: (channels, rows, columns) int16 half grey levels, 0 the middle of the scale.
        known: (rows, columns) bool whether the sample's pixel is in the image.
    """
    height, width, channels = image.shape
    _, rows, columns = values.shape
    taps = 2 * step - 1
    border = 1 if median else 0
    first_x, first_y = x0 - step + 1, y0 - step + 1
    wide = (columns - 1) * step + taps  # pixels that are looked at in a row, after the median
    tall = (rows - 1) * step + taps
    broad = channels * (wide + 2 * border)
    flat = image.reshape(-1)
    ring = np.empty((3, broad), np.uint8)  # rows of the image
    middle = np.empty(broad, np.uint8)
    smooth = np.empty((taps, channels * wide), np.uint8)
    line = np.empty(channels * wide, np.int32)
    begin, end = first_x - border, first_x - border + wide + 2 * border
    low, high = min(max(begin, 0), width - 1), max(min(end, width), 1)
    copied = 0
    done = 0
    for i in range(rows):
        while done < i * step + taps:
            # One more row of what is smoothed.
            to = smooth[done % taps]
            while copied < done + 1 + 2 * border:
                y = min(max(first_y - border + copied, 0), height - 1)
                source, target = flat[channels * y * width : channels * (y + 1) * width], ring[copied % 3]
                for x in range(begin, low):
                    for c in range(channels):
                        target[channels * (x - begin) + c] = source[channels * low + c]
                if high > low:
                    at = channels * (low - begin)
                    if at < broad and high > begin:
                        target[at : at + channels * (high - low)] = source[channels * low : channels * high]
                for x in range(max(high, begin), end):
                    for c in range(channels):
                        target[channels * (x - begin) + c] = source[channels * (high - 1) + c]
                copied += 1
            if median:
                a, b, d = ring[0], ring[1], ring[2]
                for k in range(broad):
                    p, q, r = a[k], b[k], d[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    middle[k] = less if less > more else more
                left, centre, right = middle[: channels * wide], middle[channels:], middle[2 * channels :]
                for k in range(channels * wide):
                    p, q, r = left[k], centre[k], right[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    to[k] = less if less > more else more
            else:
                source = ring[done % 3]
                for k in range(channels * wide):
                    to[k] = source[k]
            done += 1
        if step == 1:
            row = smooth[0]
            for k in range(channels * wide):
                line[k] = row[k]
        elif step == 2:
            above, here, below = smooth[2 * i % 3], smooth[(2 * i + 1) % 3], smooth[(2 * i + 2) % 3]
            for k in range(channels * wide):
                line[k] = np.int32(above[k]) + 2 * np.int32(here[k]) + np.int32(below[k])
        else:
            line[:] = 0
            for t in range(taps):
                row, weight = smooth[(i * step + t) % taps], np.int32(step - abs(t - step + 1))
                for k in range(channels * wide):
                    line[k] += weight * np.int32(row[k])
        for c in range(channels):
            to = values[c, i]
            if step == 1:
                for j in range(columns):
                    to[j] = 2 * line[channels * j + c] - 255
            elif step == 2:
                for j in range(columns):
                    k = 2 * channels * j + c
                    off = line[k] + 2 * line[k + channels] + line[k + 2 * channels] - 2040
                    to[j] = (off + 4) >> 3 if off >= 0 else -((4 - off) >> 3)
            else:
                whole = step**4
                for j in range(columns):
                    total = 0
                    for t in range(taps):
                        total += (step - abs(t - step + 1)) * line[channels * (j * step + t) + c]
                    off = 2 * total - 255 * whole
                    to[j] = (2 * off + whole) // (2 * whole) if off >= 0 else -((whole - 2 * off) // (2 * whole))
        y = y0 + i * step
        row_known = known[i]
        for j in range(columns):
            x = x0 + j * step
            row_known[j] = 0 <= y < height and 0 <= x < width


@njit(cache=True)
def forget(ignore, x0, y0, step, reach, known):
    """Samples whose value comes in part of pixels that tell nothing, at most ``reach`` [px] away, are not known."""
    height, width = ignore.shape
    rows, columns = known.shape
    for i in range(rows):
        for j in range(columns):
            x, y = x0 + j * step, y0 + i * step
            for b in range(max(y - reach, 0), min(y + reach + 1, height)):
                for a in range(max(x - reach, 0), min(x + reach + 1, width)):
                    if ignore[b, a]:
                        known[i, j] = False


@njit(cache=True)
def lattice_nodes(samples, spacing):
    """How many nodes of a lattice, so many samples apart, span a row of samples, lying alike from both ends."""
    return (samples + spacing - 1) // spacing + 1


@njit(cache=True)
def _segments(samples, spacing, node, right):
    """The node to the left of every sample, and how much of it belongs to the next one [1 / (2 spacing)]."""
    nodes = lattice_nodes(samples, spacing)
    for j in range(samples):
        doubled = 2 * j - (samples - 1) + (nodes - 1) * spacing
        node[j], right[j] = doubled // (2 * spacing), doubled % (2 * spacing)


@njit(cache=True, error_model="numpy")
def blur(inside, across, out):
    """Write a binomial mean over 5 × 5 samples of a mask [1/256]; beyond the window there is nothing.

    Args:
        inside: (rows, columns) uint8, 0 or 1.
        across: (rows, columns) uint8 for what lies between; out: (rows, columns) uint16.
    """
    rows, columns = inside.shape
    line = np.zeros(columns + 4, np.uint8)
    for i in range(rows):
        source, to = inside[i], across[i]
        line[2 : 2 + columns] = source
        a, b, d, e = line[:columns], line[1 : 1 + columns], line[3 : 3 + columns], line[4 : 4 + columns]
        for j in range(columns):
            to[j] = a[j] + e[j] + 4 * (b[j] + d[j]) + 6 * source[j]
    nothing = np.zeros(columns, np.uint8)
    for i in range(rows):
        a = across[i - 2] if i > 1 else nothing
        b = across[i - 1] if i > 0 else nothing
        d = across[i + 1] if i < rows - 1 else nothing
        e = across[i + 2] if i < rows - 2 else nothing
        here, to = across[i], out[i]
        for j in range(columns):
            to[j] = (
                np.uint16(a[j])
                + np.uint16(e[j])
                + np.uint16(4) * (np.uint16(b[j]) + np.uint16(d[j]))
                + np.uint16(6) * np.uint16(here[j])
            )


@njit(cache=True, error_model="numpy")
def pull_of_prior(phi, mean, prior_weight, length, slope, band, guided, pull, active):
    """Write what a sample gains by being inside, of the prior alone [nats], and where anything is undecided.

    Args:
        phi: (rows, columns) float32 signed distance [px].
        mean: (rows, columns) uint16, the blurred mask of the prior [1/256].
        prior_weight: [nats/px²]; length: [nats] that a sample in the midst of the other side costs.
        slope: [1/px] of a straight outline's blurred mask, doubled.
        band: [px] farther from the prior's outline nothing moves.
        guided: whether there is a prior; all is undecided otherwise.
        pull: (rows, columns) float32; active: (rows, columns) bool.
    """
    rows, columns = phi.shape
    for i in range(rows):
        p, m, to, on = phi[i], mean[i], pull[i], active[i]
        if not guided:
            to[:] = _0F
            on[:] = True
            continue
        for j in range(columns):
            size = abs(p[j])
            straight = slope * p[j]
            straight = straight if straight < _1F else _1F
            straight = straight if straight > -_1F else -_1F
            bent = np.float32(m[j]) * np.float32(1 / 128) - _1F
            to[j] = prior_weight * p[j] * size + length * (straight - bent)
            on[j] = size <= band


@njit(cache=True, error_model="numpy")
def add_samples(values, state, segment_x, right_x, segment_y, right_y, spacing, sums):
    """Add all samples to the sums of the lattice's nodes.

    Args:
        values: (channels, rows, columns) int16; state: (rows, columns) uint8.
        segment_x, right_x, segment_y, right_y: of `_segments`.
        spacing: [samples].
        sums: (2, node rows, node columns, 1 + 2 channels) int64: weight, values, squares; inside and outside.
    """
    channels, rows, columns = values.shape
    terms = 1 + 2 * channels
    part = np.empty((2, 2, terms), np.int64)
    full = 2 * spacing
    for i in range(rows):
        top, low = segment_y[i], right_y[i]
        begin = 0
        while begin < columns:
            k = segment_x[begin]
            end = begin + 1
            while end < columns and segment_x[end] == k:
                end += 1
            # Sums over the stretch between two nodes, and the same weighted by how far along; the compiler makes
            # vectors of sums of 32 bits.
            s, w = state[i, begin:end], right_x[begin:end]
            n1, n2, r1, r2 = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
            for j in range(end - begin):
                one, two = np.int32(s[j] == INSIDE), np.int32(s[j] == OUTSIDE)
                n1 += one
                n2 += two
                r1 += one * w[j]
                r2 += two * w[j]
            part[0, 0, 0], part[0, 1, 0], part[1, 0, 0], part[1, 1, 0] = n1, r1, n2, r2
            for c in range(channels):
                v = values[c, i, begin:end]
                a1, a2, b1, b2 = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                q1, q2, t1, t2 = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                for j in range(end - begin):
                    one, two = np.int32(s[j] == INSIDE), np.int32(s[j] == OUTSIDE)
                    value = np.int32(v[j])
                    square = value * value
                    a1 += one * value
                    a2 += two * value
                    b1 += one * value * w[j]
                    b2 += two * value * w[j]
                    q1 += one * square
                    q2 += two * square
                    t1 += one * square * w[j]
                    t2 += two * square * w[j]
                part[0, 0, 1 + c], part[0, 1, 1 + c], part[1, 0, 1 + c], part[1, 1, 1 + c] = a1, b1, a2, b2
                m = 1 + channels + c
                part[0, 0, m], part[0, 1, m], part[1, 0, m], part[1, 1, m] = q1, t1, q2, t2
            for side in range(2):
                if part[side, 0, 0] == 0:
                    continue
                for m in range(terms):
                    whole, along = part[side, 0, m], part[side, 1, m]
                    rest = full * whole - along
                    sums[side, top, k, m] += (full - low) * rest
                    sums[side, top, k + 1, m] += (full - low) * along
                    sums[side, top + 1, k, m] += low * rest
                    sums[side, top + 1, k + 1, m] += low * along
            begin = end


@njit(cache=True, error_model="numpy")
def _change(values, i, j, sign, side, segment_x, right_x, segment_y, right_y, full, sums):
    """Add a sample to the sums of one side, or take it away."""
    channels = len(values)
    for b in range(2):
        down = right_y[i] if b else full - right_y[i]
        for a in range(2):
            weight = np.int64(sign * down * (right_x[j] if a else full - right_x[j]))
            to = sums[side, segment_y[i] + b, segment_x[j] + a]
            to[0] += weight
            for c in range(channels):
                value = np.int64(values[c, i, j])
                to[1 + c] += weight * value
                to[1 + channels + c] += weight * value * value


@njit(cache=True, error_model="numpy")
def densities(sums, all_sums, full, fewest, least_sd, coefficients):
    """Write each node's densities as −log p = a + b v + c v², a mean over the channels [nats].

    Where there are few samples, a density leans on that of all samples about the node, as if ``fewest`` of those were
    on its side.

    Args:
        sums: (2, node rows, node columns, 1 + 2 channels) int64; all_sums: the same of both sides together, at first.
        full: 2 × spacing; its square is the weight of one sample.
        fewest: [samples]; least_sd: [half grey levels].
        coefficients: (2, node rows, 1 + 2 channels, node columns) float32: a, then b and c of every channel.

    Returns:
        The cost of what the densities lean on [samples × nats].
    """
    _, rows, columns, terms = sums.shape
    channels = terms // 2
    unit = 1.0 / (full * full)
    cost = 0.0
    for side in range(2):
        for i in range(rows):
            for k in range(columns):
                count = all_sums[i, k, 0] * unit
                own = sums[side, i, k, 0] * unit
                a = 0.0
                for c in range(channels):
                    common, spread = 0.0, 128.0 * 128.0
                    if count > 0:
                        common = all_sums[i, k, 1 + c] * unit / count
                        spread = max(all_sums[i, k, 1 + channels + c] * unit / count - common * common, 0.0)
                    spread = max(spread, least_sd * least_sd)
                    total = own + fewest
                    mean = (sums[side, i, k, 1 + c] * unit + fewest * common) / total
                    square = (sums[side, i, k, 1 + channels + c] * unit + fewest * (spread + common * common)) / total
                    variance = max(square - mean * mean, least_sd * least_sd)
                    a += 0.5 * math.log(variance) + 0.5 * mean * mean / variance
                    coefficients[side, i, 1 + c, k] = -mean / variance / channels
                    coefficients[side, i, 1 + channels + c, k] = 0.5 / variance / channels
                    off = spread + (mean - common) * (mean - common)
                    cost += fewest * (0.5 * math.log(variance) + 0.5 * off / variance) / channels
                coefficients[side, i, 0, k] = a / channels
    return cost


@njit(cache=True, error_model="numpy")
def _row_costs(values, i, lower, upper, terms_above, terms_below, down, right_x, scale, most, costs):
    """Write −log p of the samples lower … upper of a row, which lie between the same two nodes.

    ``terms_above`` and ``terms_below`` are (1 + 2 channels, 2) of these nodes.
    """
    channels = len(values)
    up = _1F - down
    a0 = up * terms_above[0, 0] + down * terms_below[0, 0]
    a1 = up * terms_above[0, 1] + down * terms_below[0, 1] - a0
    to, along = costs[lower:upper], right_x[lower:upper]
    for j in range(upper - lower):
        to[j] = a0 + scale * np.float32(along[j]) * a1
    for c in range(channels):
        b0 = up * terms_above[1 + c, 0] + down * terms_below[1 + c, 0]
        b1 = up * terms_above[1 + c, 1] + down * terms_below[1 + c, 1] - b0
        m = 1 + channels + c
        c0 = up * terms_above[m, 0] + down * terms_below[m, 0]
        c1 = up * terms_above[m, 1] + down * terms_below[m, 1] - c0
        v = values[c, i, lower:upper]
        for j in range(upper - lower):
            t, value = scale * np.float32(along[j]), np.float32(v[j])
            to[j] += value * ((b0 + t * b1) + value * (c0 + t * c1))
    for j in range(upper - lower):
        to[j] = to[j] if to[j] < most else most


@njit(cache=True, error_model="numpy")
def runs_of(active, segment_x, runs):
    """Write (row, begin, end) of the stretches with samples to decide, each between two nodes; how many."""
    rows, columns = active.shape
    count = 0
    for i in range(rows):
        on = active[i]
        j = 0
        while j < columns:
            if not on[j]:
                j += 1
                continue
            begin, k = j, segment_x[j]
            last = j
            while j < columns and segment_x[j] == k:
                if on[j]:
                    last = j
                j += 1
            runs[count, 0], runs[count, 1], runs[count, 2] = i, begin, last + 1
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _energy(
    inside, mean, pull, state, active, known, outside_costs, inside_cost, coefficients, sums, lean, unit, length, most
):
    """What an outline costs [nats × samples] with the densities that were learnt of it."""
    rows, columns = inside.shape
    modelled, learnt = outside_costs.size > 0, math.isnan(inside_cost)
    energy = lean
    for i in range(rows):
        for j in range(columns):
            u = inside[i, j]
            if u:
                energy += length * (1.0 - mean[i, j] / 256.0)
                if active[i, j]:
                    energy -= pull[i, j]
            if not known[i, j]:
                continue
            if u and not learnt:
                energy += inside_cost
            elif modelled and not u:
                energy += min(outside_costs[i, j], most)
            elif state[i, j] == OUTLIER:
                energy += most
    for side in range(2):
        if (not learnt) if side == 0 else modelled:
            continue
        for i in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                for m in range(sums.shape[3]):
                    energy += float(coefficients[side, i, m, k]) * (sums[side, i, k, m] * unit)
    return energy


@njit(cache=True, error_model="numpy")
def segment(
    values, known, phi, inside, outside_costs, spacing, prior_weight, length, slope, band, guided, fewest, least_sd,
    most, inside_cost, iterations, field, contrast, energies,
):  # fmt: skip
    """Move an outline to where the energy is least; how many times it was moved.

    Args:
        values: (channels, rows, columns) int16 half grey levels; known: (rows, columns) bool.
        phi: (rows, columns) float32 the prior's signed distance [px].
        inside: (rows, columns) uint8 0 or 1: where to begin; where it ends.
        outside_costs: (rows, columns) float32 −log p2 [nats] of a model of the background, or (0, 0).
        spacing: [samples] of the lattice.
        prior_weight, length, slope, band, guided: as in `pull_of_prior`.
        fewest, least_sd: as in `densities`; most: [nats] at which −log p is cut off.
        inside_cost: [nats] −log p1 where it is the same everywhere; NaN where it is learnt.
        iterations: at most.
        field: (rows, columns) float32, above 0 inside: what every sample gains by that [nats]; phi beyond the band.
        contrast: (rows, columns) float32 log p1 − log p2 [nats]; 0 where nothing is known, and beyond the band.
        energies: (iterations + 1,) float64 [nats × samples] at first and after every move; none are summed where (0,).
    """
    channels, rows, columns = values.shape
    terms, full = 1 + 2 * channels, 2 * spacing
    node_rows, node_columns = lattice_nodes(rows, spacing), lattice_nodes(columns, spacing)
    segment_x, right_x = np.empty(columns, np.int32), np.empty(columns, np.int32)
    segment_y, right_y = np.empty(rows, np.int32), np.empty(rows, np.int32)
    _segments(columns, spacing, segment_x, right_x)
    _segments(rows, spacing, segment_y, right_y)

    across, mean = np.empty((rows, columns), np.uint8), np.empty((rows, columns), np.uint16)
    prior, active = np.empty((rows, columns), np.uint8), np.empty((rows, columns), np.bool_)
    state, pull = np.empty((rows, columns), np.uint8), np.empty((rows, columns), np.float32)
    for i in range(rows):
        p, to = phi[i], prior[i]
        for j in range(columns):
            to[j] = p[j] > 0
    blur(prior, across, mean)
    pull_of_prior(phi, mean, prior_weight, length, slope, band, guided, pull, active)
    for i in range(rows):
        a, b, on, to, there, f = inside[i], prior[i], active[i], state[i], known[i], field[i]
        p, d = phi[i], contrast[i]
        for j in range(columns):
            a[j] = a[j] if on[j] else b[j]
            to[j] = (INSIDE if a[j] else OUTSIDE) if there[j] else UNKNOWN
            f[j] = p[j]
            d[j] = _0F
    runs = np.empty((rows * node_columns, 3), np.int32)
    count = runs_of(active, segment_x, runs)

    modelled, learnt, told = outside_costs.size > 0, math.isnan(inside_cost), energies.size > 0
    sums = np.zeros((2, node_rows, node_columns, terms), np.int64)
    both = np.zeros((node_rows, node_columns, terms), np.int64)
    coefficients = np.zeros((2, node_rows, terms, node_columns), np.float32)
    lean, unit = 0.0, 1.0 / (full * full)
    if learnt:
        add_samples(values, state, segment_x, right_x, segment_y, right_y, spacing, sums)
        both[:] = sums[0] + sums[1]
        lean = densities(sums, both, full, fewest, least_sd, coefficients)
    blur(inside, across, mean)
    if told:
        energies[:] = _energy(
            inside, mean, pull, state, active, known, outside_costs, inside_cost, coefficients, sums, lean, unit,
            length, most,
        )  # fmt: skip
    one, two = np.empty(columns, np.float32), np.empty(columns, np.float32)
    scale = np.float32(1.0 / full)
    inner = np.float32(0.0 if learnt else inside_cost)
    for iteration in range(iterations):
        changes = 0
        for r in range(count):
            i, begin, end = runs[r, 0], runs[r, 1], runs[r, 2]
            k, top = segment_x[begin], segment_y[i]
            down = scale * np.float32(right_y[i])
            if learnt:
                _row_costs(
                    values, i, begin, end, coefficients[0, top, :, k : k + 2], coefficients[0, top + 1, :, k : k + 2],
                    down, right_x, scale, most, one,
                )  # fmt: skip
            else:
                one[begin:end] = inner
            if modelled:
                two[begin:end] = outside_costs[i, begin:end]
            else:
                _row_costs(
                    values, i, begin, end, coefficients[1, top, :, k : k + 2], coefficients[1, top + 1, :, k : k + 2],
                    down, right_x, scale, most, two,
                )  # fmt: skip
            f, d, m, p = field[i, begin:end], contrast[i, begin:end], mean[i, begin:end], pull[i, begin:end]
            there, first, second = known[i, begin:end], one[begin:end], two[begin:end]
            for j in range(end - begin):
                gain = second[j] - first[j] if there[j] else _0F
                d[j] = gain
                f[j] = gain + p[j] + length * (np.float32(m[j]) * np.float32(1 / 128) - _1F)
            u, s, on, p = inside[i, begin:end], state[i, begin:end], active[i, begin:end], phi[i, begin:end]
            for j in range(end - begin):
                if not on[j]:
                    f[j] = p[j]
                    continue
                now = np.uint8(f[j] > 0)
                to = UNKNOWN
                if there[j]:
                    to = INSIDE if now else OUTSIDE
                    if (first[j] if now else second[j]) >= most:
                        to = OUTLIER
                if now != u[j]:
                    u[j] = now
                    changes += 1
                if learnt and to != s[j]:
                    if s[j] == INSIDE or s[j] == OUTSIDE:
                        side = 0 if s[j] == INSIDE else 1
                        _change(values, i, begin + j, -1, side, segment_x, right_x, segment_y, right_y, full, sums)
                    if to == INSIDE or to == OUTSIDE:
                        side = 0 if to == INSIDE else 1
                        _change(values, i, begin + j, 1, side, segment_x, right_x, segment_y, right_y, full, sums)
                    changes += 1
                s[j] = to
        if changes == 0:
            return iteration
        if iteration == iterations - 1 and not told:
            break
        blur(inside, across, mean)
        if learnt:
            lean = densities(sums, both, full, fewest, least_sd, coefficients)
        if told:
            energies[iteration + 1 :] = _energy(
                inside, mean, pull, state, active, known, outside_costs, inside_cost, coefficients, sums, lean, unit,
                length, most,
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
            c[j] = source[j] if side[j] else -source[j]
        for j in range(columns):
            to[j] = (a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j]
    for i in range(rows):
        a, b, c, d, e, to = across[i], across[i + 1], across[i + 2], across[i + 3], across[i + 4], out[i]
        for j in range(columns):
            mean = scale * ((a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j])
            to[j] = mean if mean > _0F else _0F
