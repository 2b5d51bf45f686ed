"""Draw the marker pixels and detected markers of an image, to choose colours and for the view."""

from __future__ import annotations

from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.markers import MarkerFrame
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.colour_table import CELL, CELLS

UInt8 = NDArray[np.uint8]

_DIMMED: Final = 0.35
"""Brightness of pixels off the markers."""
_ARM_PX: Final = 9
"""Length of the arms of a marker's cross [px]."""
QUALITY: Final = 85
"""Quality of a JPEG, 0 to 100."""


def labels_of(image: UInt8, table: UInt8) -> UInt8:
    """Return (height, width) uint8 label of every pixel by a look-up table; 0 for none.

    Args:
        image: (height, width, 3) uint8 blue, green, red.
        table: (32768,) of `mocapella.sensing.colour_table.lookup_table`.
    """
    blue, green, red = (image[..., k].astype(np.uint16) // np.uint16(CELL) for k in range(3))
    return np.asarray(table[blue + green * np.uint16(CELLS) + red * np.uint16(CELLS * CELLS)])


def paint_of(profile: ColourProfile) -> UInt8:
    """Return (colours + 1, 3) the brightest blue, green, red of each learnt hue; black for label 0."""
    uv = np.array([colour.seen.mean for colour in profile.colours])
    values = np.exp(np.stack([uv[:, 1], np.zeros(len(uv)), uv[:, 0]], axis=-1))
    painted = np.zeros((len(uv) + 1, 3))
    painted[1:] = 255 * values / values.max(axis=-1, keepdims=True)
    return np.asarray(painted.round(), dtype=np.uint8)


def mask_image(image: UInt8, profile: ColourProfile, table: UInt8, frame: MarkerFrame | None = None) -> UInt8:
    """Return the image, dimmed and gray, with labelled pixels in their colour and a cross on every detected marker.

    Args:
        image: (height, width, 3) uint8 blue, green, red.
        profile: the markers' colours.
        table: its look-up table (`mocapella.sensing.colour_table.lookup_table`).
        frame: markers detected in the image; None for no crosses.

    Returns:
        (height, width, 3) uint8 blue, green, red.
    """
    labels = labels_of(image, table)
    gray = (_DIMMED * cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)).astype(np.uint8)
    out = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    marked = labels > 0
    out[marked] = paint_of(profile)[labels[marked]]
    if frame is not None:
        for name, (x, y) in zip(frame.names, frame.positions_px, strict=True):
            if np.isfinite(x) and np.isfinite(y):
                _cross(out, float(x), float(y), name)
    return np.asarray(out)


def encode_image(image: UInt8, kind: Literal["jpeg", "png"], scale: float = 1.0) -> bytes:
    """Encode an image (height, width, 3) BGR, resized by the factor ``scale``, as JPEG or PNG.

    Raises:
        SettingsError: the result would be empty, or the image cannot be encoded.
    """
    if min(image.shape[:2]) * scale < 1:
        raise SettingsError(f"scale is {scale:g}: nothing of {image.shape[1]} × {image.shape[0]} px would be left")
    if scale != 1.0:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    done, data = (
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        if kind == "jpeg"
        else cv2.imencode(".png", image)
    )
    if not done:
        raise SettingsError(f"the image {image.shape} cannot be made a {kind}")
    return bytes(data)


def _cross(image: Any, x: float, y: float, name: str) -> None:
    bits = 4  # fractional bits of a pixel, for a sub-pixel position
    at = round(x * 2**bits), round(y * 2**bits)
    arm = _ARM_PX << bits
    for dx, dy in ((1, 0), (0, 1)):
        ends = (at[0] - dx * arm, at[1] - dy * arm), (at[0] + dx * arm, at[1] + dy * arm)
        cv2.line(image, *ends, (255, 255, 255), 1, cv2.LINE_AA, bits)
    where = (round(x) + _ARM_PX, round(y) - _ARM_PX // 2)
    cv2.putText(image, name, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
