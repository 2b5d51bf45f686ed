"""Zhang–Suen thinning on 64 pixels at a time, compiled; importing this module imports numba.

Source: T. Y. Zhang, C. Y. Suen: A Fast Parallel Algorithm for Thinning Digital Patterns (Communications of the ACM
27(3), 1984), conditions (a) to (d) of the first subiteration and (c') and (d') of the second. All pixels of a
subiteration are tested on the same image, so a word of 64 pixels is tested by Boolean operations on nine words. Bit 0
of a word is its leftmost pixel.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Int64 = NDArray[np.int64]
UInt64 = NDArray[np.uint64]

ROWS = 8
"""Rows of a strip, the unit of work: a strip is tested again only if it or a neighbouring one has changed."""

_1, _63, _0 = np.uint64(1), np.uint64(63), np.uint64(0)


@njit(cache=True, error_model="numpy")
def removable(
    words: UInt64, free: UInt64, gone: UInt64, begin: int, end: int, stride: int, second: bool
) -> np.uint64:  # fmt: skip
    """Write the pixels that a subiteration removes from a range of words; return the bitwise or of the written words.

    The neighbours are p2 (above), p3 (above right), … p9 (above left), clockwise as in the paper.

    Args:
        words, free, gone: uint64 arrays of one shape, the image, its removable pixels and the result, as in `thin`;
            gone[begin:end] is written.
        begin, end: the range of words.
        stride: words per row.
        second: whether it is the second subiteration.
    """
    some = _0
    for i in range(begin, end):
        p2, p6 = words[i - stride], words[i + stride]
        p8 = (words[i] << _1) | (words[i - 1] >> _63)
        p4 = (words[i] >> _1) | (words[i + 1] << _63)
        p9 = (p2 << _1) | (words[i - stride - 1] >> _63)
        p3 = (p2 >> _1) | (words[i - stride + 1] << _63)
        p7 = (p6 << _1) | (words[i + stride - 1] >> _63)
        p5 = (p6 >> _1) | (words[i + stride + 1] << _63)
        # (b) exactly one step from 0 to 1 around the pixel. Two adjacent steps exclude each other.
        a, b = (~p2 & p3) | (~p3 & p4), (~p4 & p5) | (~p5 & p6)
        c, d = (~p6 & p7) | (~p7 & p8), (~p8 & p9) | (~p9 & p2)
        one = (a ^ b ^ c ^ d) & ~((a & b) | (c & d))  # an odd number of them, and not three
        # (a) at least 2 neighbours: with one such step they are one run, so that two are adjacent.
        pairs = (p2 & (p3 | p9)) | (p4 & (p3 | p5)) | (p6 & (p5 | p7)) | (p8 & (p7 | p9))
        # (c) and (d), or (c') and (d'); and of (a) at most 6 neighbours. Where those hold, a single 0 among 7
        # neighbours can be at one of two positions only.
        if second:
            held = (p2 & p8 & (p4 | p6)) | (~p2 & p9 & p3) | (~p8 & p7 & p9)
        else:
            held = (p4 & p6 & (p2 | p8)) | (~p4 & p3 & p5) | (~p6 & p5 & p7)
        removed = words[i] & free[i] & one & pairs & ~held
        gone[i] = removed
        some |= removed
    return some


@njit(cache=True, error_model="numpy")
def thin(
    words: UInt64, free: UInt64, gone: UInt64, changed: Int64, pending: NDArray[np.bool_], height: int, stride: int
) -> int:
    """Thin a binary image in place, until two subiterations in a row, one of each kind, remove nothing.

    Args:
        words: (1 + (height + 2) * stride + 1,) uint64 pixels: a word, a row of zeros, the rows, a row of zeros, a word.
            The last bit of a row is 0, so that rows do not touch at their ends.
        free: uint64 of the same shape; bits are 1 for pixels that may be removed.
        gone: uint64 of the same shape; workspace.
        changed, pending: (strips + 2,) int64 and bool workspace; a strip has `ROWS` rows, and the first and last of
            these are empty.
        height, stride: rows, and words per row.

    Returns:
        The number of subiterations.
    """
    strips = len(changed) - 2
    changed[:] = -1
    at, last = 0, -1
    while at <= last + 2:
        for strip in range(1, strips + 1):
            pending[strip] = False
            # The same conditions were tested two subiterations ago: again only if the pixel or a neighbour changed.
            if max(changed[strip - 1], changed[strip], changed[strip + 1]) >= at - 2:
                begin, end = strip_of(strip, height, stride)
                pending[strip] = removable(words, free, gone, begin, end, stride, at % 2 == 1) != _0
        for strip in range(1, strips + 1):
            if pending[strip]:
                begin, end = strip_of(strip, height, stride)
                for i in range(begin, end):
                    words[i] &= ~gone[i]
                changed[strip] = last = at
        at += 1
    return at


@njit(cache=True)
def strip_of(strip: int, height: int, stride: int) -> tuple[int, int]:
    """Return the first word of a strip and its end, exclusive; strips are counted from 1.

    Args:
        strip: number of the strip.
        height, stride: rows of the image, and words per row.
    """
    first = (strip - 1) * ROWS
    return 1 + stride * (1 + first), 1 + stride * (1 + min(first + ROWS, height))
