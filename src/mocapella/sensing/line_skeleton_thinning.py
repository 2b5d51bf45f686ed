"""The skeleton of a picture of what is and is not hand: thin lines in its middle, which lines are then looked for in.

Thinning is that of Zhang and Suen (1984), pixel for pixel as in OpenCV's `ximgproc.thinning`: pixels of the picture's
border are never removed. Everything is done in the rectangle around the hand alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]

_MARGIN_PX: Final = 2
"""Around what is drawn: as far as the Laplacian and the dilation reach beyond it."""
_WORD_PX: Final = 64
_TOGETHER_PX: Final = 32
"""A multiple of what OpenCV takes at a time."""
_KERNEL: Final = np.ones((3, 3), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The pictures of the skeleton stages, (height, width) each.

    Attributes:
        thinned: 255 where thin lines are, else 0.
        distance: float32, of each pixel to the nearest one that is 0 [px].
        ridges: its negative Laplacian, from 0 to 255.
        dilated: the ridges, a pixel wider to all sides.
        lines: 255 where a thin line is on a wide ridge, else 0.
    """

    thinned: UInt8
    distance: Float32
    ridges: UInt8
    dilated: UInt8
    lines: UInt8


def thin(mask: UInt8) -> UInt8:
    """Lines of a pixel's width.

    Args:
        mask: (height, width), not 0 where there is something.

    Returns:
        of the same shape, 255 or 0.
    """
    x, y, width, height = cv2.boundingRect(mask)
    out = np.zeros(mask.shape, dtype=np.uint8)
    if width:
        box = np.s_[y : y + height, x : x + width]
        _thin_box(mask[box], _at_border(mask.shape, x, y, width, height), out[box])
    return out


def skeleton(mask: UInt8, ridge_least: int = 128) -> Skeleton:
    """Thinning, distance transform, Laplacian, normalisation, dilation.

    Args:
        mask: (height, width), not 0 where there is something.
        ridge_least: a thinned pixel is kept where the dilated, normalised negative Laplacian is at least this, 0 to
            255: it is high in the middle of a limb, where distances to both edges meet.
    """
    shape = mask.shape
    x, y, width, height = cv2.boundingRect(mask)
    thinned, distance = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.float32)
    if width == 0:
        return Skeleton(thinned, distance, *(np.zeros(shape, dtype=np.uint8) for _ in range(3)))
    box = np.s_[y : y + height, x : x + width]
    _thin_box(mask[box], _at_border(shape, x, y, width, height), thinned[box])
    x0, x1 = _columns(x - _MARGIN_PX, x + width + _MARGIN_PX, shape[1])
    y0, y1 = max(y - _MARGIN_PX, 0), min(y + height + _MARGIN_PX, shape[0])
    around = np.s_[y0:y1, x0:x1]
    distance[around] = cv2.distanceTransform(mask[around], cv2.DIST_L2, 3)
    negative = cv2.Laplacian(distance[around], cv2.CV_32F, scale=-1)
    ridge = cv2.normalize(negative, np.empty(negative.shape, dtype=np.uint8), 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    wide = cv2.dilate(ridge, _KERNEL)
    # What 0 became: at the corner of a side that is not the picture's. Without such a side there is nothing to fill.
    flat = ridge[-1 if y1 < shape[0] else 0, -1 if x1 < shape[1] else 0]
    ridges, dilated = (np.full(shape, flat, dtype=np.uint8) for _ in range(2))
    lines = np.zeros(shape, dtype=np.uint8)
    ridges[around], dilated[around] = ridge, wide
    lines[around] = thinned[around] * (wide >= ridge_least)
    return Skeleton(thinned, distance, ridges, dilated, lines)


def _columns(begin: int, end: int, width: int) -> tuple[int, int]:
    """As many columns around these as make no difference to the last bit of a number.

    OpenCV rounds what is left over at the end of a row after several pixels at a time in another way.
    """
    if width % _TOGETHER_PX:
        return 0, width
    return max(begin, 0) // _TOGETHER_PX * _TOGETHER_PX, min(-(-end // _TOGETHER_PX) * _TOGETHER_PX, width)


def _at_border(shape: tuple[int, ...], x: int, y: int, width: int, height: int) -> tuple[bool, bool, bool, bool]:
    """Which sides of a box are the picture's: top, bottom, left, right."""
    return y == 0, y + height == shape[0], x == 0, x + width == shape[1]


def _thin_box(mask: UInt8, border: tuple[bool, bool, bool, bool], out: UInt8) -> None:
    """Thin all of a box, of which the sides that are ``border`` are never removed."""
    height, width = mask.shape
    stride = width // _WORD_PX + 1  # with a bit to spare
    strips = -(-height // _kernels().ROWS)
    words = _words(mask, stride)
    free = np.full(len(words), np.iinfo(np.uint64).max)
    if any(border):
        inside = np.ones(mask.shape, dtype=np.uint8)
        for side, edge in zip(border, (inside[0], inside[-1], inside[:, 0], inside[:, -1]), strict=True):
            if side:
                edge[:] = 0
        free = _words(inside, stride)
    # Apart from the others by more than a strip: what is compiled for several words at a time is left out where the
    # processor has to assume that they overlap.
    apart = (_kernels().ROWS + 2) * (stride + 1)
    gone = np.empty(len(words) + 2 * apart, dtype=np.uint64)[apart:-apart]
    _kernels().thin(words, free, gone, np.empty(strips + 2, dtype=np.int64), np.zeros(strips + 2, dtype=np.bool_),
                    height, stride)  # fmt: skip
    rows = words[1 + stride : -1 - stride].view(np.uint8).reshape(height, -1)
    np.multiply(np.unpackbits(rows, axis=1, count=width, bitorder="little"), 255, out=out)


def _words(mask: UInt8, stride: int) -> NDArray[np.uint64]:
    """Bits in the layout of `line_skeleton_kernels.thin`."""
    height = len(mask)
    words = np.zeros((height + 2) * stride + 2, dtype=np.uint64)
    packed = np.packbits(mask, axis=1, bitorder="little")
    words[1 + stride : -1 - stride].view(np.uint8).reshape(height, -1)[:, : packed.shape[1]] = packed
    return words


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import line_skeleton_kernels

    return line_skeleton_kernels
