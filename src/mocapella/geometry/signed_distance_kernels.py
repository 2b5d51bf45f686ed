"""Kernels of `mocapella.geometry.signed_distance`; importing this module imports numba.

Distances are separable: along one axis to the next crossing in the same row or column, then over the other axis the
least of the sums of squares (P. F. Felzenszwalb, D. P. Huttenlocher, Distance Transforms of Sampled Functions, Theory
of Computing 8, 2012, section 2.1). Within a short reach, to try every offset is faster than parabolas' envelopes,
because the compiler makes vectors of it. Rows are padded to whole vectors, which leaves no remainders, and offsets are
tried eight at once, for each would load and store the least anew.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

# Loops are written out; a conditional becomes a vector's minimum, `min` does not.

_ONE = np.float32(1.0)
_VECTOR = 32
"""Samples that a compiled loop takes at once, at most."""
_NEAR = np.float32(2.25)
"""A sample whose own crossings are nearer is beside the outline [samples²]."""


@njit(cache=True, error_model="numpy")
def signed_distance(field: Float32, reach: int, step: float, out: Float32) -> None:
    """Write the signed distance of every sample to the zero crossing of a field [px].

    Args:
        field: (rows, columns) float32, above 0 inside; linear between neighbours.
        reach: distances are clipped at reach × step; a whole number [samples].
        step: distance between samples, float32 [px].
        out: (rows, columns) float32, written.
    """
    rows, columns = field.shape
    wide = (columns + _VECTOR - 1) // _VECTOR * _VECTOR
    groups = (reach + 3) // 4
    border = 4 * groups
    far = np.float32(reach + 1)
    # Squared distances along the columns and along the rows, each with a border that is far.
    down, across = np.empty((rows, wide + 2 * border), np.float32), np.empty((rows + 2 * border, wide), np.float32)
    _down_columns(field, far, border, down)
    for i in range(border):
        across[i] = far * far
        across[border + rows + i] = far * far
    _along_rows(field, far, border, across)
    # The least sum of squares, over rows of the distances along columns, and over columns of those along rows.
    flat_down, flat_across, best = down.reshape(-1), across.reshape(-1), np.empty(wide, np.float32)
    for i in range(rows):
        best[:] = np.float32(reach * reach)
        _least(flat_down, i * (wide + 2 * border) + border, 1, groups, best)
        _least(flat_across, (i + border) * wide, wide, groups, best)
        # Beside the outline: the line through the crossings of the sample's own row and column, not these alone.
        v, h = down[i, border : border + wide], across[i + border]
        for j in range(wide):
            a, b, least = v[j], h[j], best[j]
            both = a + b
            chord = a * b / (both if both > 0 else _ONE)
            chord = chord if (a if a < b else b) < _NEAR else least
            best[j] = np.float32(math.sqrt(chord if chord < least else least)) * step
        for j in range(columns):
            way = best[j]
            out[i, j] = way if field[i, j] > 0 else -way


@njit(cache=True, error_model="numpy")
def of_mask(mask: UInt8, reach: int, step: float, out: Float32) -> None:
    """Write the `signed_distance` of every sample of a mask to its outline, midway between samples that differ.

    Args:
        mask: (rows, columns) uint8, not 0 inside.
        reach, step, out: limit [samples], distance between samples [px] and (rows, columns) result [px], as in
            `signed_distance`.
    """
    field = np.empty(mask.shape, np.float32)
    for i in range(len(mask)):
        row, to = mask[i], field[i]
        for j in range(len(row)):
            to[j] = np.float32(0.5) if row[j] != 0 else np.float32(-0.5)
    signed_distance(field, reach, step, out)


@njit(cache=True, error_model="numpy")
def _down_columns(field: Float32, far: np.float32, border: int, squares: Float32) -> None:
    """Write the squared distance of every sample to the next crossing above or below, far² where none is near.

    Args:
        field: (rows, columns) float32.
        far: largest distance [samples].
        border: number of padding columns before the first, which get far².
        squares: (rows, border + columns or more) float32, written.
    """
    rows, columns = field.shape
    above, below = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    above[0] = far
    below[rows - 1] = far
    for i in range(1, rows):
        for j in range(columns):
            a, b = field[i - 1, j], field[i, j]
            way, back = above[i - 1, j] + _ONE, b / (b - a)
            crossed = (a > 0) != (b > 0)
            way = way if way < far else far
            above[i, j] = back if crossed else way
            below[i - 1, j] = _ONE - back if crossed else far
    for i in range(rows - 1, -1, -1):
        if i + 1 < rows:
            for j in range(columns):
                way, back = below[i + 1, j] + _ONE, below[i, j]
                below[i, j] = way if way < back else back
        squares[i] = far * far
        for j in range(columns):
            way, back = above[i, j], below[i, j]
            way = way if way < back else back
            squares[i, np.uint64(border + j)] = way * way


@njit(cache=True, error_model="numpy")
def _along_rows(field: Float32, far: np.float32, border: int, squares: Float32) -> None:
    """Write the squared distance of every sample to the next crossing left or right, far² where none is near.

    Args:
        field: (rows, columns) float32.
        far: largest distance [samples].
        border: number of padding rows before the first, which are not changed.
        squares: (border + rows or more, columns or more) float32, written.
    """
    rows, columns = field.shape
    crossed = np.zeros((columns + 8) // 8 * 8, np.uint8)  # from the sample before
    by_eight, after = crossed.view(np.uint64), crossed[1:]
    for i in range(rows):
        here, following, to = field[i], field[i, 1:], squares[border + i]
        to[columns:] = far * far
        for j in range(len(following)):
            after[j] = (here[j] > 0) != (following[j] > 0)
        crossed[columns] = 1
        begin, left = 0, far
        for n in range(len(by_eight)):
            if by_eight[n] == 0:
                continue
            for end in range(8 * n, 8 * n + 8):
                if not crossed[end]:
                    continue
                # From one crossing to the next, or to the border.
                right = here[end - 1] / (here[end - 1] - here[end]) if end < columns else far
                part = to[begin:end]
                last = len(part) - 1
                for k in range(len(part)):
                    back, way = left + np.float32(k), right + np.float32(last - k)
                    way = way if way < back else back
                    way = way if way < far else far
                    part[k] = way * way
                begin, left = end, _ONE - right


@njit(cache=True, error_model="numpy")
def _least(flat: Float32, first: int, apart: int, groups: int, best: Float32) -> None:
    """Lower ``best`` to a row's least sums of squares, over samples up to 4 × groups steps away on both sides.

    Args:
        flat: squared distances, flattened.
        first: index of the row's first value.
        apart: stride from a value to that one step away.
        groups: a quarter of the number of steps.
        best: (row,) smallest sums so far, updated.
    """
    here = flat[first:]
    for j in range(len(best)):
        way, least = here[j], best[j]
        best[j] = way if way < least else least
    for group in range(groups):
        o = 4 * group + 1
        a, b, c, d = np.float32(o**2), np.float32((o + 1) ** 2), np.float32((o + 2) ** 2), np.float32((o + 3) ** 2)
        # Slices, not places counted from one array: of those the compiler does not make vectors.
        a0, a1 = flat[first - o * apart :], flat[first + o * apart :]
        b0, b1 = flat[first - (o + 1) * apart :], flat[first + (o + 1) * apart :]
        c0, c1 = flat[first - (o + 2) * apart :], flat[first + (o + 2) * apart :]
        d0, d1 = flat[first - (o + 3) * apart :], flat[first + (o + 3) * apart :]
        for j in range(len(best)):
            p, q, r, s, t, u, v, w = a0[j], a1[j], b0[j], b1[j], c0[j], c1[j], d0[j], d1[j]
            p, r = (p if p < q else q) + a, (r if r < s else s) + b
            t, v = (t if t < u else u) + c, (v if v < w else w) + d
            p, t, least = p if p < r else r, t if t < v else v, best[j]
            p = p if p < t else t
            best[j] = p if p < least else least
