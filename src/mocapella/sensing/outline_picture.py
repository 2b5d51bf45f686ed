"""Draw contours into images: each body model's, and the image's where it deviates.

Where the segmented contour leaves the model's, the fit is wrong or the segmentation is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.model.outline_colours import INSIDE, OUTSIDE, Colour
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.outline_lines import border_samples

UInt8 = NDArray[np.uint8]
Int64 = NDArray[np.int64]

_QUALITY: Final = 85
_SMOOTHED: Final = 5
"""Number of consecutive contour samples whose majority decides whether the contour is outside, or inside, there."""


class Outlines(msgspec.Struct, frozen=True, eq=False):
    """The contours of one body in one image.

    Attributes:
        contour: the segmented silhouette.
        covered: silhouette of the fitted body model.
        colour: (red, green, blue) of the model's contour.
    """

    contour: Silhouette
    covered: Silhouette
    colour: Colour


def outlined(image: UInt8, bodies: Sequence[Outlines] = (), width: int | None = None) -> UInt8:
    """Draw each model's contour, and the parts of the image's contour outside (red) and inside (blue) of it.

    Args:
        image: (height, width, 3) uint8 BGR; not modified.
        bodies: the people in the image.
        width: width of the result [px]; None: the image's.

    Returns:
        (height', width, 3) uint8 BGR, of the image's proportions.
    """
    scale = 1.0 if width is None else width / image.shape[1]
    size = (image.shape[1], image.shape[0]) if width is None else (width, max(1, round(image.shape[0] * scale)))
    out = image.copy() if scale == 1.0 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    thick = max(1, round(max(size) / (500 if width is None else 180)))  # relatively thicker in small images

    def draw(lines: list[Int64], colour: Colour, *, closed: bool) -> None:
        places = [np.round(((line + 0.5) * scale - 0.5) * 16).astype(np.int32) for line in lines]
        cv2.polylines(out, places, isClosed=closed, color=colour[::-1], thickness=thick, lineType=cv2.LINE_AA, shift=4)

    for body in bodies:
        outside, inside = deviations(body.contour, body.covered)
        draw(outside, OUTSIDE, closed=False)
        draw(inside, INSIDE, closed=False)
    for body in bodies:  # on top: hides deviations below the line width
        draw(list(border_samples(body.covered)), body.colour, closed=True)
    return np.asarray(out, dtype=np.uint8)


def deviations(contour: Silhouette, covered: Silhouette) -> tuple[list[Int64], list[Int64]]:
    """Return the parts of the segmented contour at least half a sample outside and inside the model's.

    Args:
        contour: the segmented silhouette.
        covered: the model's silhouette.

    Returns:
        Open lines (n, 2), x and y of samples [px]: those outside, and those inside; empty lists without deviations.
    """
    mask = (covered.phi > 0).astype(np.uint8)
    # Samples on the model's own border do not deviate; the erosion removes them.
    within = cv2.erode(mask, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), borderValue=(0.0,))
    outside: list[Int64] = []
    inside: list[Int64] = []
    for line in border_samples(contour):
        column, row = ((line - np.array(covered.origin_px)) / covered.step_px).round().astype(np.int64).T
        there = (column >= 0) & (row >= 0) & (column < mask.shape[1]) & (row < mask.shape[0])
        column, row = np.where(there, column, 0), np.where(there, row, 0)
        outside += _parts(line, _most(~(there & (mask[row, column] > 0))))
        inside += _parts(line, _most(there & (within[row, column] > 0)))
    return outside, inside


def _most(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (n,) the majority of the flags around each sample of a closed line."""
    half = _SMOOTHED // 2
    around = np.pad(flags.astype(np.int64), half, mode="wrap")
    return np.asarray(2 * np.convolve(around, np.ones(_SMOOTHED, np.int64), "valid") > _SMOOTHED)


def _parts(line: Int64, chosen: NDArray[np.bool_]) -> list[Int64]:
    """Return the stretches of a closed line (n, 2) where ``chosen`` (n,), each with the next sample."""
    if chosen.all():
        return [np.concatenate([line, line[:1]])]
    first = int(np.argmin(chosen))  # start where no stretch is cut in two
    line, chosen = (np.concatenate([np.roll(one, -first, axis=0), one[first : first + 1]]) for one in (line, chosen))
    steps = np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [line[begin : end + 1] for begin, end in zip(begins, ends, strict=True)]


def side_by_side(pictures: list[UInt8], height: int = 720) -> UInt8:
    """Scale images (h, w, 3) uint8 of any sizes to one height [px] and join them in a row, (height, width, 3).

    At least one image is needed; a last odd column is cut off.
    """
    row = [cv2.resize(one, (max(1, round(one.shape[1] * height / one.shape[0])), height)) for one in pictures]
    joined = np.concatenate(row, axis=1)
    return np.asarray(joined[:, : joined.shape[1] // 2 * 2])  # video codecs require an even width


def jpeg(picture: UInt8, quality: int = _QUALITY) -> bytes:
    """Encode an image (height, width, 3) BGR as JPEG with a quality of 0 to 100."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


class OverlayWriter:
    """Writes images with contours: JPEGs in a folder, or one MP4 with all cameras in a row.

    Args:
        path: ends with .mp4, or is a folder, which is created.
        rate_hz: frame rate of the MP4 [Hz].
        sizes: (width, height) of the cameras' images, in the MP4's order; a camera without an image is black, and
            images of other cameras are left out. Not used for JPEGs.

    Raises:
        InputError: it cannot be written there.
    """

    def __init__(self, path: Path, rate_hz: float, sizes: Mapping[str, tuple[int, int]]) -> None:
        self._path, self._rate, self._sizes = path, rate_hz, dict(sizes)
        self._video: Any = None
        self._is_video = path.suffix.lower() == ".mp4"
        folder = path.parent if self._is_video else path
        try:
            if not self._is_video:
                folder.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot be made: {error.strerror}",
                file=path,
                field="--overlay",
                fix="name a folder in one that exists",
            ) from error
        if not folder.is_dir() or (path.suffix and not self._is_video):
            fix = "name a folder, or a file that ends with .mp4 in a folder that exists"
            raise InputError("cannot be written", file=path, field="--overlay", fix=fix)

    def write(self, frame: int, pictures: dict[str, UInt8]) -> None:
        """Write the images of one frame.

        Args:
            frame: its number, in the JPEGs' names; an MP4 takes frames in the order of the calls.
            pictures: (height, width, 3) uint8 BGR by camera.

        Raises:
            InputError: the MP4 or a JPEG cannot be written.
        """
        if not self._is_video:
            for name, picture in pictures.items():
                file = self._path / f"{name}_{frame:06d}.jpg"
                try:
                    file.write_bytes(jpeg(picture))
                except OSError as error:
                    fix = "name another folder, or free some space"
                    raise InputError(f"cannot be written: {error.strerror}", file=file, fix=fix) from error
            return
        black = {name: np.zeros((size[1], size[0], 3), np.uint8) for name, size in self._sizes.items()}
        joined = side_by_side([pictures.get(name, none) for name, none in black.items()])
        if self._video is None:
            size = (joined.shape[1], joined.shape[0])
            self._video = cv2.VideoWriter(str(self._path), cv2.VideoWriter.fourcc(*"mp4v"), self._rate, size)
            if not self._video.isOpened():
                raise InputError("cannot be written", file=self._path, fix="name a folder for pictures instead")
        self._video.write(joined)

    def close(self) -> None:
        """Finish the MP4; JPEGs need no closing. A second call has no effect."""
        if self._video is not None:
            self._video.release()
            self._video = None
