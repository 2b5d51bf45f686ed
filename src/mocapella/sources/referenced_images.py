"""References to images outside a take: a frame of a video, by path and checksum.

A take of videos stores some 200 bytes per image instead of the pixels. It replays to the bit as long as the videos are
neither moved nor changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_json
from mocapella.errors import InputError
from mocapella.model.images import ImageFrame
from mocapella.sources.video import IMAGES, Frames, pictures

UInt8 = NDArray[np.uint8]

FORMAT: Final = "file"
_PIECE: Final = 1 << 20


class ImageReference(msgspec.Struct, frozen=True):
    """A reference that a frame has instead of pixels.

    Attributes:
        path: absolute path of the video, image or folder of images.
        sha256: hash of its content, see `checksum`.
        frame: number of the frame, from 0; in a folder, the image's index in the order of names.
    """

    path: str
    sha256: str
    frame: Annotated[int, msgspec.Meta(ge=0)]


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's images and their names in order, in hexadecimal digits.

    Raises:
        InputError: it cannot be read.
    """
    digest = hashlib.sha256()
    try:
        folder = path.is_dir()
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGES) if folder else [path]
        for file in files:
            digest.update(file.name.encode() if folder else b"")
            with file.open("rb") as content:
                while piece := content.read(_PIECE):
                    digest.update(piece)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, fix="name a video that is there") from error
    return digest.hexdigest()


def referred(frame: ImageFrame, path: Path, sha256: str, number: int) -> ImageFrame:
    """Return a copy of a frame with a reference instead of its pixels; `ReferencedImages.resolve` is the inverse.

    Args:
        frame: the frame; not changed.
        path: path of the video, image or folder of images.
        sha256: hash of its content, see `checksum`.
        number: number of the video's frame, from 0.
    """
    data = msgspec.json.encode(ImageReference(str(path.absolute()), sha256, number))
    return msgspec.structs.replace(frame, format=FORMAT, data=data)


class ReferencedImages:
    """Reader of the images that `referred` replaced by references, for the replay of a take.

    A video's content is compared with its checksum once, at its first frame. Reading its frames in rising order is
    fast; going back reads it from the beginning.
    """

    def __init__(self) -> None:
        self._videos: dict[str, _Video] = {}

    def resolve(self, frame: ImageFrame) -> ImageFrame:
        """Return a copy of a frame with the pixels (height, width, 3) uint8 BGR, format ``raw``, for its reference.

        A frame without a reference is returned itself. Do not change the pixels: a repeated frame shares them.

        Raises:
            InputError: the video does not exist, has changed, or has no such frame.
        """
        if frame.format != FORMAT:
            return frame
        reference = decode_json(
            bytes(frame.data), ImageReference, what="reference to a video", file=f"image of {frame.sensor}"
        )
        video = self._videos.get(reference.path)
        if video is None:
            video = self._videos[reference.path] = _Video(reference)
        image = video.at(reference.frame)
        return msgspec.structs.replace(frame, format="raw", data=image)


class _Video:
    """One video, verified once, and read forward."""

    def __init__(self, reference: ImageReference) -> None:
        self._path = Path(reference.path)
        try:
            there = self._path.exists()
        except OSError:  # such as a name that is too long
            there = False
        if not there:
            raise InputError("is not there any more", file=self._path, fix="put it back where the take was made of it")
        if checksum(self._path) != reference.sha256:
            raise InputError(
                "is not the video that the take was made of", file=self._path, field="sha256", value=reference.sha256,
                fix="put that one back",
            )  # fmt: skip
        self._last = -1
        self._frames: Iterator[tuple[int, UInt8]] = iter(())
        self._image: UInt8 | None = None

    def at(self, number: int) -> UInt8:
        """(height, width, 3) uint8 BGR of a frame."""
        if number < self._last or self._image is None:
            self._frames, self._last = pictures(self._path, Frames()), -1
        while self._last < number:
            found = next(self._frames, None)
            if found is None:
                raise InputError("has no such frame", file=self._path, field="frame", value=number)
            self._last, self._image = found
        assert self._image is not None
        return self._image
