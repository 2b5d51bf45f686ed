"""Read images from videos, image files, folders of images and live cameras, and files of capture times."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, check_filled, decode_csv, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.sensing.images import MOST_PX, decode_pixels

UInt8 = NDArray[np.uint8]

IMAGES: Final = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
LIVE: Final = "camera:"
_MOST_BOXES: Final = 10_000


@dataclass(frozen=True)
class Frames:
    """A selection of a video's frames: every ``step``-th from ``first`` up to, but not including, ``end``.

    Frames are numbered from 0. With ``end`` None, the selection goes to the video's end.
    """

    first: int = 0
    end: int | None = None
    step: int = 1

    def wants(self, frame: int) -> bool:
        """Whether a frame is selected."""
        inside = frame >= self.first and (self.end is None or frame < self.end)
        return inside and (frame - self.first) % self.step == 0


def parse_frames(text: str | None) -> Frames:
    """Parse a selection of frames, which are numbered from 0; None selects all frames.

    Args:
        text: ``odd`` or ``even`` numbers, or ``FROM:TO:STEP`` without the frame TO; each of the three may be left out.

    Raises:
        SettingsError: the text is none of these.
    """
    if text is None:
        return Frames()
    if text in ("odd", "even"):
        return Frames(int(text == "odd"), None, 2)
    match = re.fullmatch(r"(\d*):(\d*)(?::(\d*))?", text)
    if not match or match[3] == "0":
        raise SettingsError(f"frames {text!r} cannot be used; write odd, even or FROM:TO:STEP, such as 100:400:5")
    first, end, step = match.groups()
    return Frames(int(first or 0), int(end) if end else None, int(step or 1))


def pictures(path: Path | str, frames: Frames = Frames()) -> Generator[tuple[int, UInt8]]:
    """Read the selected frames of a video, an image, or a folder's images in the order of their names.

    A video is read one image at a time; it ends without an error at a frame that cannot be decoded. The only image of
    an image file has number 0, and is read whatever the selection.

    Yields:
        Number of the frame in the video, from 0, and image (height, width, 3) uint8 BGR, a new array each time.

    Raises:
        InputError: the path cannot be read, or has no image; raised when the first image is asked for.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGES)
        if not files:
            raise InputError("is a folder without images", file=path, fix=f"put images there ({', '.join(IMAGES)})")
        yield from ((k, read_image(file)) for k, file in enumerate(files) if frames.wants(k))
    elif path.suffix.lower() in IMAGES:
        yield 0, read_image(path)
    else:
        yield from _video(path, frames)


def read_image(path: Path) -> UInt8:
    """Read an image file as an array (height, width, 3) uint8 BGR, turned as its EXIF orientation says.

    Raises:
        InputError: the file does not exist, or is not an image.
    """
    if not path.is_file():
        raise InputError("is not there", file=path, fix="name a file that exists")
    data = read_whole(path, fix="name a file that can be read")
    image = decode_pixels(data)
    if image is None:
        fix = f"make it one of {', '.join(IMAGES)}, of at most {MOST_PX >> 20} megapixels"
        raise InputError("is no image that can be read", file=path, fix=fix)
    return np.asarray(image, dtype=np.uint8)


def open_video(path: Path) -> cv2.VideoCapture:
    """Open a video's file with OpenCV; the caller releases the capture.

    Raises:
        InputError: it is no video, or its images have more than `MOST_PX` pixels.
    """
    try:
        capture = cv2.VideoCapture(str(path))
    except cv2.error as error:
        raise _no_video(path) from error
    if not capture.isOpened():
        raise _no_video(path)
    width, height = (capture.get(key) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if width * height > MOST_PX:
        capture.release()
        raise InputError(
            f"has images of {width:g} × {height:g} px", file=path, fix=f"at most {MOST_PX} pixels are read"
        )
    return capture


def _no_video(path: Path) -> InputError:
    if is_cut_off(path):
        again = "copy it again, or let the camera finish the recording"
        return InputError("is an MP4 that ends before its index: it is not whole", file=path, fix=again)
    return InputError("is no video that can be read", file=path, fix="make it an MP4 (H.264) or AVI")


def is_cut_off(path: Path) -> bool:
    """Whether a file begins as an MP4 and ends before its index, the box ``moov`` (ISO 14496-12), or within a box."""
    size = path.stat().st_size
    with path.open("rb") as file:
        at = 0
        kinds: list[bytes] = []
        while at + 8 <= size and len(kinds) < _MOST_BOXES:
            file.seek(at)
            head = file.read(16)
            kinds.append(head[4:8])
            length = int.from_bytes(head[:4], "big")
            if length == 1:
                length = int.from_bytes(head[8:16], "big")
            at = size if length == 0 else at + max(length, 8)  # 0: up to the file's end
    return kinds[:1] == [b"ftyp"] and (b"moov" not in kinds or at > size)


def _video(path: Path, frames: Frames) -> Iterator[tuple[int, UInt8]]:
    if not path.is_file():
        raise InputError("is not there", file=path, fix="name a video, an image or a folder of images")
    capture = open_video(path)
    try:
        frame = 0
        while (frames.end is None or frame < frames.end) and capture.grab():
            if frames.wants(frame):
                read, image = capture.retrieve()
                if not read:
                    break
                yield frame, np.asarray(image, dtype=np.uint8)
            frame += 1
        if frame == 0:
            raise _no_video(path)
    finally:
        capture.release()


class LiveCameras:
    """Local cameras, read together: all grab a frame before any image is decoded. The constructor opens them.

    Args:
        numbers: the system's numbers of the cameras, by name.
        open_capture: replaces `cv2.VideoCapture` in tests.
        clock: the clock of the capture times, for all cameras [s].

    Attributes:
        lost: number of missing images by camera.

    Raises:
        InputError: a camera cannot be opened; the others are closed.
    """

    def __init__(
        self,
        numbers: Mapping[str, int],
        *,
        open_capture: Callable[[int], Any] = cv2.VideoCapture,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.lost: dict[str, int] = dict.fromkeys(numbers, 0)
        """Number of missing images by camera."""
        self._clock = clock
        self._captures: dict[str, Any] = {}
        for name, number in numbers.items():
            capture = open_capture(number)
            self._captures[name] = capture
            if not capture.isOpened():
                self.close()
                raise InputError(
                    "cannot be opened",
                    file=f"{LIVE}{number}",
                    fix="see mocapella doctor for the cameras that there are",
                )

    def read(self) -> dict[str, tuple[float, UInt8]]:
        """Wait for an image of each camera; a camera that gives none is counted in ``lost`` and omitted.

        Returns:
            Time at which the grab began on ``clock`` [s], and image (height, width, 3) uint8 BGR, by camera.
        """
        grabbed = {name: (self._clock(), capture.grab()) for name, capture in self._captures.items()}
        found: dict[str, tuple[float, UInt8]] = {}
        for name, (at, there) in grabbed.items():
            read, image = self._captures[name].retrieve() if there else (False, None)
            if read:
                found[name] = (at, np.asarray(image, dtype=np.uint8))
            else:
                self.lost[name] += 1
        return found

    def close(self) -> None:
        """Close the cameras."""
        for capture in self._captures.values():
            capture.release()


def read_timestamps(path: Path | str, cameras: Sequence[str]) -> dict[str, list[float]]:
    """Read the capture times of each camera's frames.

    The file is CSV with a column ``camera`` (or ``cam_id``, ``port``), a column ``time_s`` (or ``frame_time``) and, if
    rows are missing or out of order, a column ``frame`` (or ``frame_index``). Without the latter, a camera's rows in
    the order of their times are its frames. A camera ``1`` of the file is ``1`` or ``cam_1`` of the rig. Rows of other
    cameras, and rows without a time, are ignored.

    Args:
        path: the file.
        cameras: names of the cameras to read.

    Returns:
        Capture times by camera, indexed by frame number, on the file's clock [s]; NaN for a frame without a row.

    Raises:
        InputError: a column or a camera is missing, or a value is not a number.
    """
    fix = "write camera,frame,time_s"
    columns, rows = decode_csv(read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES), file=path, fix=fix)
    of_camera, of_time, of_frame = (
        next((name for name in names if name in columns), None)
        for names in (("camera", "cam_id", "port"), ("time_s", "frame_time"), ("frame", "frame_index"))
    )
    if of_camera is None or of_time is None:
        raise InputError("has no columns camera and time_s", file=path, row=1, fix=fix)
    found: dict[str, dict[int, float]] = {name: {} for name in cameras}
    unnumbered: dict[str, list[float]] = {name: [] for name in cameras}
    count = 0
    for number, row in rows:
        count += 1
        camera, time_s = row.get(of_camera, ""), row.get(of_time, "")
        name = next((name for name in (camera, f"cam_{camera}") if name in found), None)
        if name is None or not time_s:
            continue
        try:
            at = float(time_s)
            if of_frame is None:
                unnumbered[name].append(at)
            else:
                found[name][int(row.get(of_frame, ""))] = at
        except ValueError:
            raise InputError("is no number", file=path, row=number, value=row, fix="write seconds") from None
    out = {}
    for name in cameras:
        times = found[name] or dict(enumerate(sorted(unnumbered[name])))
        if not times:
            raise InputError(
                "has no row", file=path, field=of_camera, value=name, fix="name the cameras as in the file"
            )
        check_filled(max(times) + 1, count, file=path)
        out[name] = [times.get(k, float("nan")) for k in range(max(times) + 1)]
    return out
