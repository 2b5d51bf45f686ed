"""The skeleton of a binary image: thin lines along its medial axis.

Thinning by Zhang and Suen (1984), pixel for pixel as in OpenCV's `ximgproc.thinning`: pixels at the image's border are
never removed. Only the mask's bounding box is processed.
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
"""Margin around the mask: the reach of the Laplacian and the dilation."""
_WORD_PX: Final = 64
_TOGETHER_PX: Final = 32
"""A multiple of the number of pixels that OpenCV processes at a time."""
_KERNEL: Final = np.ones((3, 3), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The images of the skeleton stages, (height, width) each.

    Attributes:
        thinned: 255 on thin lines, else 0.
        distance: float32 distance of each pixel to the nearest pixel off the mask [px].
        ridges: the negative Laplacian of the distance, normalised to 0 to 255.
        dilated: the ridges, dilated by a pixel.
        lines: 255 on thin lines that lie on a dilated ridge, else 0.
    """

    thinned: UInt8
    distance: Float32
    ridges: UInt8
    dilated: UInt8
    lines: UInt8


def thin(mask: UInt8) -> UInt8:
    """Thin a mask to lines of one pixel's width.

    Args:
        mask: (height, width), not 0 on the object.

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
    """Run thinning, distance transform, Laplacian, normalisation and dilation.

    Args:
        mask: (height, width), not 0 on the object.
        ridge_least: least value, 0 to 255, of the dilated, normalised negative Laplacian at a thinned pixel that is
            kept: it is high on the axis of a limb, where distances to both edges meet.
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
    # The value that 0 was normalised to, from a corner inside the image; without one there is nothing to fill.
    flat = ridge[-1 if y1 < shape[0] else 0, -1 if x1 < shape[1] else 0]
    ridges, dilated = (np.full(shape, flat, dtype=np.uint8) for _ in range(2))
    lines = np.zeros(shape, dtype=np.uint8)
    ridges[around], dilated[around] = ridge, wide
    lines[around] = thinned[around] * (wide >= ridge_least)
    return Skeleton(thinned, distance, ridges, dilated, lines)


def _columns(begin: int, end: int, width: int) -> tuple[int, int]:
    """Widen columns so that results stay the same to the last bit.

    OpenCV processes several pixels at a time, and rounds the remaining ones at the end of a row differently.
    """
    if width % _TOGETHER_PX:
        return 0, width
    return max(begin, 0) // _TOGETHER_PX * _TOGETHER_PX, min(-(-end // _TOGETHER_PX) * _TOGETHER_PX, width)


def _at_border(shape: tuple[int, ...], x: int, y: int, width: int, height: int) -> tuple[bool, bool, bool, bool]:
    """Return which sides of a box are the image's: top, bottom, left, right."""
    return y == 0, y + height == shape[0], x == 0, x + width == shape[1]


def _thin_box(mask: UInt8, border: tuple[bool, bool, bool, bool], out: UInt8) -> None:
    """Thin a box; pixels on the sides marked in ``border`` are never removed."""
    height, width = mask.shape
    stride = width // _WORD_PX + 1  # with a spare bit
    strips = -(-height // _kernels().ROWS)
    words = _words(mask, stride)
    free = np.full(len(words), np.iinfo(np.uint64).max)
    if any(border):
        inside = np.ones(mask.shape, dtype=np.uint8)
        for side, edge in zip(border, (inside[0], inside[-1], inside[:, 0], inside[:, -1]), strict=True):
            if side:
                edge[:] = 0
        free = _words(inside, stride)
    # In memory more than a strip apart from the others: the vectorised loop runs only if arrays cannot overlap.
    apart = (_kernels().ROWS + 2) * (stride + 1)
    gone = np.empty(len(words) + 2 * apart, dtype=np.uint64)[apart:-apart]
    _kernels().thin(words, free, gone, np.empty(strips + 2, dtype=np.int64), np.zeros(strips + 2, dtype=np.bool_),
                    height, stride)  # fmt: skip
    rows = words[1 + stride : -1 - stride].view(np.uint8).reshape(height, -1)
    np.multiply(np.unpackbits(rows, axis=1, count=width, bitorder="little"), 255, out=out)


def _words(mask: UInt8, stride: int) -> NDArray[np.uint64]:
    """Return a mask as bits in the layout of `line_skeleton_kernels.thin`."""
    height = len(mask)
    words = np.zeros((height + 2) * stride + 2, dtype=np.uint64)
    packed = np.packbits(mask, axis=1, bitorder="little")
    words[1 + stride : -1 - stride].view(np.uint8).reshape(height, -1)[:, : packed.shape[1]] = packed
    return words


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import line_skeleton_kernels

    return line_skeleton_kernels
