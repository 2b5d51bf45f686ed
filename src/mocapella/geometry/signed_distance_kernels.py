"""The loops of `mocapella.geometry.signed_distance`, compiled; importing this module imports numba.

Distances are separable: along one axis to the next crossing in the same row or column, then over the other axis the
least of the sums of squares (P. F. Felzenszwalb, D. P. Huttenlocher, Distance Transforms of Sampled Functions, Theory
of Computing 8, 2012, section 2.1). Within a short reach, to try every offset is faster than parabolas' envelopes,
because the compiler makes vectors of it.
"""

# ruff: noqa: PLR0912 - compiled: loops are written out; a conditional becomes a vector's minimum, `min` does not
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

_ONE = np.float32(1.0)


@njit(cache=True, error_model="numpy")
def signed_distance(field, reach, step, out):
    """Write the signed distance [steps × step] of every sample to where a field crosses 0.

    Args:
        field: (rows, columns) float32, above 0 inside; linear between neighbours.
        reach: [samples] whole; farther is cut off at reach × step.
        step: [px] float32 between samples.
        out: (rows, columns) float32.
    """
    rows, columns = field.shape
    far = np.float32(reach + 1)
    # Along the columns: how far the next crossing above or below is.
    down = np.empty((rows, columns), np.float32)
    across = np.empty((rows, columns), np.float32)
    for j in range(columns):
        down[0, j] = far
    for i in range(1, rows):
        for j in range(columns):
            a, b = field[i - 1, j], field[i, j]
            way, back = down[i - 1, j] + _ONE, b / (b - a)
            way = back if (a > 0) != (b > 0) else way
            down[i, j] = way if way < far else far
    for i in range(rows - 2, -1, -1):
        for j in range(columns):
            a, b, best = field[i + 1, j], field[i, j], down[i, j]
            way, back = down[i + 1, j] + _ONE, b / (b - a)
            way = back if (a > 0) != (b > 0) else way
            down[i, j] = way if way < best else best
    for i in range(rows):  # there are few crossings in a row: from each outwards
        here, to = field[i], across[i]
        to[:] = far
        side = here[0] > 0
        for j in range(1, columns):
            if (here[j] > 0) == side:
                continue
            side = not side
            way = here[j] / (here[j] - here[j - 1])
            for k in range(min(reach + 1, columns - j)):
                to[j + k] = min(to[j + k], way + np.float32(k))
            way = _ONE - way
            for k in range(min(reach + 1, j)):
                to[j - 1 - k] = min(to[j - 1 - k], way + np.float32(k))
    # Over the other axis: the least sum of squares.
    limit = np.float32(reach * reach)
    line = np.empty(columns + 2 * reach, np.float32)
    squares = np.empty((rows, columns), np.float32)
    line[:] = far * far
    for i in range(rows):
        for j in range(columns):
            line[np.uint64(reach + j)] = down[i, j] * down[i, j]
        for j in range(columns):
            out[i, j] = limit
        for offset in range(2 * reach + 1):
            more = np.float32((offset - reach) * (offset - reach))
            for j in range(columns):
                way, best = line[np.uint64(offset + j)] + more, out[i, j]
                out[i, j] = way if way < best else best
        for j in range(columns):
            squares[i, j] = across[i, j] * across[i, j]
    for i in range(rows):
        for other in range(max(0, i - reach), min(rows, i + reach + 1)):
            more = np.float32((other - i) * (other - i))
            for j in range(columns):
                way, best = squares[other, j] + more, out[i, j]
                out[i, j] = way if way < best else best
        # Beside the outline: the line through the crossings of the sample's own row and column, not these alone.
        for j in range(columns):
            v, h, best = down[i, j] * down[i, j], squares[i, j], out[i, j]
            chord = v * h / (v + h) if v + h > 0 else np.float32(0.0)
            near = (v if v < h else h) < np.float32(2.25)
            best = chord if near and chord < best else best
            way = np.float32(math.sqrt(best)) * step
            out[i, j] = way if field[i, j] > 0 else -way
