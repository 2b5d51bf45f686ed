"""Crops of an image at the size that a neural network takes, and the way back from the crop's pixels to the image's."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

PADDING: Final = 1.25
"""Size of a person's crop, relative to the box of the keypoints, as in the training of top-down networks (Xiao et al.,
Simple Baselines for Human Pose Estimation, ECCV 2018, section 3)."""
GREY: Final = 114
"""Value outside of a letterboxed image, as in the training of one-stage networks (Ge et al., YOLOX, 2021)."""


def to_rgb(image: UInt8) -> UInt8:
    """Return an image (height, width, 3) uint8 blue, green, red as a new one in the order red, green, blue."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def person_crop(image: UInt8, box: Float32, size_px: tuple[int, int]) -> tuple[UInt8, Float32]:
    """Cut a person's box out of an image, enlarged by `PADDING` and to the aspect ratio of the crop.

    Args:
        image: (height, width, 3) uint8.
        box: (4,) left, top, right, bottom [px].
        size_px: (width, height) of the crop.

    Returns:
        The crop (height, width, 3), black outside of the image, and T_image_crop, the affine map (2, 3) from pixels of
            the crop to pixels of the image; pixel centres have whole coordinates.
    """
    width, height = size_px
    middle, sides = (box[:2] + box[2:]) / 2, PADDING * np.maximum(box[2:] - box[:2], 1.0)
    scale = float(max(sides[0] / width, sides[1] / height))
    return _warped(image, scale, middle - scale * (np.array(size_px) - 1) / 2, size_px, 0)


def letterbox(image: UInt8, size_px: tuple[int, int]) -> tuple[UInt8, Float32]:
    """Scale a whole image into the upper left corner of a canvas, filled with `GREY`.

    Args:
        image: (height, width, 3) uint8.
        size_px: (width, height) of the canvas.

    Returns:
        The canvas (height, width, 3), and T_image_crop as of `person_crop`.
    """
    scale = max(image.shape[1] / size_px[0], image.shape[0] / size_px[1])
    return _warped(image, scale, np.full(2, (scale - 1) / 2), size_px, GREY)


def to_image(points_px: Float32, T_image_crop: Float32) -> Float32:
    """Return points (..., 2) of a crop as points of the image [px]."""
    return np.asarray(points_px @ T_image_crop[:, :2].T + T_image_crop[:, 2], np.float32)


def _warped(
    image: UInt8, scale: float, corner: NDArray[np.floating], size_px: tuple[int, int], fill: int
) -> tuple[UInt8, Float32]:
    """Return the image seen through a grid of pixels: image = scale · crop + corner."""
    T = np.array([[scale, 0, corner[0]], [0, scale, corner[1]]], np.float32)
    how = cv2.INTER_AREA if scale > 2 else cv2.INTER_LINEAR
    if how == cv2.INTER_AREA:  # warpAffine samples without averaging: halve the image first
        less = cv2.resize(image, None, fx=2 / scale, fy=2 / scale, interpolation=cv2.INTER_AREA)
        ratio = np.array([image.shape[1] / less.shape[1], image.shape[0] / less.shape[0]])
        inner = np.concatenate([np.diag(scale / ratio), ((corner + 0.5) / ratio - 0.5)[:, None]], axis=1)
        image = np.asarray(less, np.uint8)
    else:
        inner = np.asarray(T, np.float64)
    crop = cv2.warpAffine(
        image, inner, size_px, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=(fill, fill, fill)
    )
    return np.asarray(crop, np.uint8), T
