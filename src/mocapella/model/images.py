"""Images as frames: encoded, or raw pixels."""

from __future__ import annotations

from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.sensor_frame import SensorFrame

UInt8 = NDArray[np.uint8]

ImageFormat = Literal["raw", "jpeg", "png", "file", ""]
IMAGE_FORMATS: Final[tuple[ImageFormat, ...]] = ("raw", "jpeg", "png", "file", "")


class ImageFrame(SensorFrame, frozen=True, eq=False):
    """The image of one camera at one instant.

    Attributes:
        size_px: (width, height) of the image.
        format: ``raw``, ``jpeg``, ``png``, or in a take ``file``: a reference to a video's frame
            (`mocapella.sources.referenced_images`); empty if the camera delivered no image.
        data: the encoded bytes; for ``raw`` the (height, width, 3) uint8 BGR array; for ``file`` the reference; for an
            empty format no bytes.
        empty_room: whether the image shows the room without people.
    """

    size_px: tuple[int, int]
    format: ImageFormat
    data: bytes | UInt8
    empty_room: bool = False


def image_frame(
    sensor: str,
    image: UInt8 | bytes | None,
    *,
    time_ns: int,
    format: ImageFormat = "raw",
    size_px: tuple[int, int] | None = None,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
    empty_room: bool = False,
) -> ImageFrame:
    """Make an `ImageFrame` of an array, which is not copied, of encoded bytes, or of nothing; nothing is decoded.

    Args:
        sensor: the camera's name.
        image: (height, width, 3) uint8 BGR for ``raw``; the encoded bytes; None if the camera delivered no image.
        time_ns: capture time, on the camera's own clock.
        format: format of ``image``; ignored if that is None.
        size_px: (width, height) of the image; ignored for an array; without an image, None gives (0, 0).
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.
        empty_room: whether the image shows the room without people.

    Raises:
        SettingsError: an unknown format, an array that is not an image, or encoded bytes without a size.
    """
    if image is None:
        return ImageFrame(sensor, node_id, sequence, int(time_ns), int(sent_ns), size_px or (0, 0), "", b"", empty_room)
    if format not in IMAGE_FORMATS[:-1]:
        raise SettingsError(f"image format {format!r}; it must be one of {one_of(format, IMAGE_FORMATS[:-1])}")
    if isinstance(image, np.ndarray):
        if format != "raw" or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
            raise SettingsError(
                f"image is {image.dtype} {image.shape} of format {format!r}; (height, width, 3) uint8, raw, is wanted"
            )
        size_px = (image.shape[1], image.shape[0])
    elif format == "raw" or size_px is None:
        raise SettingsError(f"{len(image)} bytes of format {format!r} and size {size_px}; jpeg or png with a size")
    return ImageFrame(sensor, node_id, sequence, int(time_ns), int(sent_ns), size_px, format, image, empty_room)


REMEMBERED: Final[tuple[type[msgspec.Struct], ...]] = (ImageFrame,)
"""Argument ``kinds`` of `mocapella.model.memory.pack` for snapshots of objects that keep image frames."""
