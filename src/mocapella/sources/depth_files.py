"""Depth images as 16-bit PNG files, with the camera's parameters from a ``depth.toml`` beside them."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.kinect_depth import UNIT_M, kinect_units
from mocapella.sensing.images import MOST_PX, decode_pixels
from mocapella.settings import parse
from mocapella.sources.depth_options import KINECT_RAW, DepthOptions, check_disparities, lens_of
from mocapella.sources.picture_source import SourceState

UInt16 = NDArray[np.uint16]

SIDECAR: Final = "depth.toml"
USUAL_FPS: Final = 30.0
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_GREY: Final = 0
_AGAIN: Final = "record it again, or leave it out"


@dataclass(frozen=True, eq=False)
class RecordedDepth:
    """One depth image of a recording.

    Attributes:
        file: name of its file, or its take and frame number.
        time_ns: capture time on the recording's clock [ns], rising.
        depth: (height, width) uint16 distance along the optical axis, in the recording's unit; 0 where nothing was
            measured. None if the image is unreadable.
        problem: why it is unreadable; empty if it is readable.
        colour: (height, width, 3) uint8 BGR image of the same instant; None if there is none.
    """

    file: str
    time_ns: int
    depth: UInt16 | None
    problem: str = ""
    colour: NDArray[np.uint8] | None = None


class DepthRecording(Protocol):
    """A recording of depth images.

    Attributes:
        name: name of the file, folder or take.
        state: the camera's parameters; lens and unit are None if unknown.
        count: number of images.
    """

    name: str
    state: SourceState
    count: int

    def images(self) -> Iterator[RecordedDepth]:
        """Yield all images, from the first."""
        ...


@dataclass(frozen=True)
class DepthSidecar:
    """The camera's parameters in a ``depth.toml``; None for a parameter that the file does not give.

    Attributes:
        unit_m: length of a unit of the images [m].
        raw: ``kinect-raw`` if the images are a Kinect v1's disparities; empty if they are depths.
        lens: F, CX, CY, or FX, FY, CX, CY [px], or these four and the distortion K1, K2, P1, P2, K3.
        fps: frame rate [Hz].
        colour_lens: lens of the colour images beside the depth images, as ``lens``; without it, the depth images are
            registered to the colour images, pixel by pixel.
        colour_from_depth: 12 numbers, the rows [R | t] of the motion from the depth camera's frame to the colour
            camera's, t in metres; with ``colour_lens`` only.

    Raises:
        SettingsError: a value is invalid.
    """

    unit_m: float | None = None
    raw: str = ""
    lens: tuple[float, ...] | None = None
    fps: float | None = None
    colour_lens: tuple[float, ...] | None = None
    colour_from_depth: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.raw not in ("", KINECT_RAW):
            raise SettingsError(f"raw is {self.raw!r}; {KINECT_RAW!r} is wanted, or nothing")
        if self.lens is not None and lens_of(self.lens) is None:
            raise SettingsError(f"lens is {list(self.lens)}; [F, CX, CY] or [FX, FY, CX, CY] in pixels is wanted")
        if self.colour_lens is not None and lens_of(self.colour_lens) is None:
            raise SettingsError(f"colour_lens is {list(self.colour_lens)}; [FX, FY, CX, CY] in pixels is wanted")
        T = self.colour_from_depth
        if T is not None and (self.colour_lens is None or not _is_motion(T)):
            wanted = "the rows [R | t] of a rotation and a translation in metres"
            raise SettingsError(f"colour_from_depth wants colour_lens, and 12 numbers: {wanted}")
        for name, value in (("unit_m", self.unit_m), ("fps", self.fps)):
            if value is not None and not 0 < value < float("inf"):
                raise SettingsError(f"{name} is {value}; a number above 0 is wanted")


class DepthFiles:
    """A sequence of 16-bit PNGs as a `DepthRecording`.

    The constructor decodes the first readable image for its size. Kinect v1 disparities are converted to depths.

    Args:
        paths: files, in this order, or one folder, whose PNGs are sorted by the numbers in their names.
        options: the camera's parameters as the user gives them; they take precedence over a ``depth.toml`` in the
            folder of the first file.

    Attributes:
        name, state, count: name of the recording, the camera's parameters, and number of images.
        files: the images' files, in their order.
        fps: frame rate [Hz]: the user's, else that of ``depth.toml``, else `USUAL_FPS`.

    Raises:
        InputError: a file does not exist, none is readable, they are not 16-bit images, or ``depth.toml`` is invalid.
        SettingsError: ``paths`` is empty.
    """

    def __init__(self, paths: Sequence[Path], options: DepthOptions | None = None) -> None:
        options = options or DepthOptions()
        self.files = _files(paths)
        folder = self.files[0].parent
        self.name = str(paths[0] if len(paths) == 1 else folder)
        sidecar = read_sidecar(folder / SIDECAR) if (folder / SIDECAR).exists() else DepthSidecar()
        self._raw = options.kinect_raw or (options.unit_m is None and sidecar.raw == KINECT_RAW)
        unit_m = UNIT_M if self._raw else options.unit_m if options.unit_m is not None else sidecar.unit_m
        lens = options.lens if options.lens is not None else lens_of(sidecar.lens or ())
        self.fps = options.fps or sidecar.fps or USUAL_FPS
        self.count = len(self.files)
        height, width = self._first().shape
        self.state = SourceState((width, height), self.fps, unit_m=unit_m, lens=lens)

    def images(self) -> Iterator[RecordedDepth]:
        """Yield all images, from the first; a damaged or truncated file is yielded without an image, with the problem.

        Image k is captured k / ``fps`` seconds plus 1 ns after the recording's time 0.

        Raises:
            InputError: a file is not a 16-bit image, has another size than the first, or has values above a Kinect's
                11 bits.
        """
        for number, file in enumerate(self.files):
            time_ns = round(number * NS_PER_S / self.fps) + 1
            try:
                depth = read_depth_png(file)
            except DamagedImageError as error:
                yield RecordedDepth(str(file), time_ns, None, f"{error.problem}; {error.fix}")
                continue
            size = depth.shape[1], depth.shape[0]
            if size != self.state.size_px:
                was = "{} × {}".format(*(self.state.size_px or ()))
                fix = f"put images of one camera there: {self.files[0].name} is {was}"
                raise InputError(f"is {size[0]} × {size[1]} px", file=file, fix=fix)
            if self._raw:
                check_disparities(depth, file)
            yield RecordedDepth(str(file), time_ns, kinect_units(depth) if self._raw else depth)

    def _first(self) -> UInt16:
        """The first readable image."""
        first: DamagedImageError | None = None
        for file in self.files:
            try:
                return read_depth_png(file)
            except DamagedImageError as error:
                first = first or error
        assert first is not None
        raise first


class DamagedImageError(InputError):
    """A PNG file that is truncated or corrupted."""


def read_depth_png(path: Path) -> UInt16:
    """Read a 16-bit greyscale PNG as an array (height, width) uint16, with the file's own values.

    Raises:
        DamagedImageError: it is truncated, or a chunk has a wrong checksum.
        InputError: it does not exist, is not a PNG, or has another pixel format or more than `MOST_PX` pixels.
    """
    data = read_whole(path, fix="name a file that is there")
    _check_png(data, path)
    image = decode_pixels(data, unchanged=True)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise DamagedImageError("cannot be unpacked", file=path, fix=_AGAIN)
    return np.asarray(image, dtype=np.uint16)


def _check_png(data: bytes, path: Path) -> None:
    """Check a PNG's chunks (ISO/IEC 15948, clause 5), since OpenCV fills up missing data without an error."""
    if not data.startswith(_SIGNATURE):
        if _SIGNATURE.startswith(data):
            raise DamagedImageError("is cut off at its beginning", file=path, fix=_AGAIN)
        raise InputError("is no PNG", file=path, fix="depth images are 16-bit greyscale PNGs")
    at = len(_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        if at + 12 > len(data):
            raise DamagedImageError(f"is cut off after {len(data)} bytes", file=path, fix=_AGAIN)
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            raise DamagedImageError(f"is cut off after {len(data)} bytes", file=path, fix=_AGAIN)
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise DamagedImageError(f"is damaged at byte {at}", file=path, fix=_AGAIN)
        if kind == b"IHDR":
            _check_header(data[at + 8 : end - 4], path)
        at = end


def _check_header(header: bytes, path: Path) -> None:
    if len(header) != 13:
        raise DamagedImageError("has no header that can be read", file=path, fix=_AGAIN)
    width, height, bits, colour = struct.unpack_from(">IIBB", header)
    if (bits, colour) != (16, _GREY):
        what = "greyscale" if colour == _GREY else "colour"
        fix = "depth images have 16 bits of greyscale; an 8-bit image is for display only, its depths are lost"
        raise InputError(f"is an image of {bits}-bit {what}", file=path, fix=fix)
    if width * height > MOST_PX:
        raise InputError(f"is {width} × {height} px", file=path, fix=f"at most {MOST_PX} pixels are read")


def read_sidecar(path: Path) -> DepthSidecar:
    """Read a ``depth.toml``, which has the camera's parameters of the depth images in its folder.

    Raises:
        InputError: it cannot be read, or has unknown keys or invalid values.
    """
    fix = "write unit_m = 0.001 and lens = [F, CX, CY]"
    data = decode_toml(read_whole(path, fix=fix), file=path, fix=fix)
    try:
        return parse(DepthSidecar, data, where=str(path))
    except SettingsError as error:
        raise InputError(str(error).removeprefix(f"{path}: "), file=path, fix=fix) from error


def _is_motion(rows: tuple[float, ...]) -> bool:
    """Return whether 12 numbers are the rows [R | t] of a rotation and a translation below 1 m."""
    if len(rows) != 12 or not np.isfinite(rows).all():
        return False
    T = np.reshape(rows, (3, 4))
    turned = np.abs(T[:, :3] @ T[:, :3].T - np.eye(3)).max() < 1e-3 and np.linalg.det(T[:, :3]) > 0
    return bool(turned and np.abs(T[:, 3]).max() < 1.0)


def natural(name: str) -> list[tuple[int, str]]:
    """Return the key for sorting names by the numbers in them, ignoring case, so that ``a9`` comes before ``A10``."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name.lower()) if part]


def _files(paths: Sequence[Path]) -> list[Path]:
    if len(paths) == 1 and paths[0].is_dir():
        files = sorted((f for f in paths[0].iterdir() if f.suffix.lower() == ".png"), key=lambda f: natural(f.name))
        if not files:
            raise InputError("is a folder without PNGs", file=paths[0], fix="depth images are 16-bit greyscale PNGs")
        return files
    for path in paths:
        if not path.is_file():
            fix = "name 16-bit PNGs, a folder of them, or a take"
            raise InputError("is a folder among files" if path.is_dir() else "is not there", file=path, fix=fix)
    if not paths:
        raise SettingsError("no depth images; name 16-bit PNGs, a folder of them, or a take")
    return list(paths)
