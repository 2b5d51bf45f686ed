"""Pictures with outlines drawn in: what was segmented, and what the model would look like."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.model.silhouettes import Silhouette

UInt8 = NDArray[np.uint8]

SEGMENTED: Final = (60, 60, 255)
MODEL: Final = (90, 255, 60)
"""Blue, green, red."""
_QUALITY: Final = 85


def outlined(image: UInt8, contour: Silhouette | None, covered: Silhouette | None, width: int | None = None) -> UInt8:
    """An image with both outlines, the model's over the segmentation's.

    Args:
        image: (height, width, 3) BGR; stays as it is.
        contour: what was segmented.
        covered: what the model covers.
        width: of the result [px]; None: the image's.

    Returns:
        (height', width, 3) BGR.
    """
    scale = 1.0 if width is None else width / image.shape[1]
    size = (image.shape[1], image.shape[0]) if width is None else (width, max(1, round(image.shape[0] * scale)))
    out = image.copy() if scale == 1.0 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    thick = max(1, round(max(size) / 500))
    for silhouette, colour in ((contour, SEGMENTED), (covered, MODEL)):
        if silhouette is None:
            continue
        mask = (silhouette.phi > 0).astype(np.uint8)
        lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        places = [
            np.round(((line * silhouette.step_px + np.array(silhouette.origin_px) + 0.5) * scale - 0.5) * 16).astype(
                np.int32
            )
            for line in lines
        ]
        cv2.polylines(out, places, isClosed=True, color=colour, thickness=thick, lineType=cv2.LINE_AA, shift=4)
    return np.asarray(out, dtype=np.uint8)


def side_by_side(pictures: list[UInt8], height: int = 720) -> UInt8:
    """(height, width, 3) of pictures of any sizes, in a row."""
    row = [cv2.resize(one, (max(1, round(one.shape[1] * height / one.shape[0])), height)) for one in pictures]
    joined = np.concatenate(row, axis=1)
    return np.asarray(joined[:, : joined.shape[1] // 2 * 2])  # video codecs want an even width


def jpeg(picture: UInt8, quality: int = _QUALITY) -> bytes:
    """Of (height, width, 3) BGR."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


class OverlayWriter:
    """Writes pictures with outlines: JPEGs in a folder, or one MP4 with all cameras in a row.

    Args:
        path: ends with .mp4, or is a folder, which is made.
        rate_hz: of the MP4.

    Raises:
        InputError: it cannot be written there.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate = path, rate_hz
        self._video: Any = None
        self._is_video = path.suffix.lower() == ".mp4"
        folder = path.parent if self._is_video else path
        try:
            if not self._is_video:
                folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}", file=path, fix="name another folder") from error
        if not folder.is_dir() or (path.suffix and not self._is_video):
            fix = "name a folder, or a file that ends with .mp4 in a folder that exists"
            raise InputError("cannot be written", file=path, field="--overlay", fix=fix)

    def write(self, frame: int, pictures: dict[str, UInt8]) -> None:
        """The pictures of a frame, by camera."""
        if not self._is_video:
            for name, picture in pictures.items():
                (self._path / f"{name}_{frame:06d}.jpg").write_bytes(jpeg(picture))
            return
        joined = side_by_side(list(pictures.values()))
        if self._video is None:
            size = (joined.shape[1], joined.shape[0])
            self._video = cv2.VideoWriter(str(self._path), cv2.VideoWriter.fourcc(*"mp4v"), self._rate, size)
            if not self._video.isOpened():
                raise InputError("cannot be written", file=self._path, fix="name a folder for pictures instead")
        self._video.write(joined)

    def close(self) -> None:
        """Finish the file."""
        if self._video is not None:
            self._video.release()
            self._video = None
