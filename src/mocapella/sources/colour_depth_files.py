"""Folders of depth images and colour images of the same instants.

    FOLDER/depth/0001.png …       16-bit PNGs, with a depth.toml
    FOLDER/colour/0001.png …      colour images, as many; the folder may also be called color or rgb

Images belong together by their order, or, if all names are times in seconds as in the recordings of TUM
(J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012), by the nearest time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.sources.depth_files import SIDECAR, DepthFiles, DepthSidecar, RecordedDepth, natural, read_sidecar
from mocapella.sources.depth_options import DepthOptions, lens_of
from mocapella.sources.picture_source import ColourCamera
from mocapella.sources.video import IMAGES, read_image

DEPTH: Final = "depth"
COLOURS: Final = ("colour", "color", "rgb")
TOGETHER_S: Final = 0.02
"""Greatest difference of the times of images that belong together [s]."""


class ColourDepthFiles:
    """Depth images with the colour images of the same instants, as a `mocapella.sources.depth_files.DepthRecording`.

    Args:
        folder: folder with the folders of both; see the module.
        options: the depth camera's parameters as the user gives them; they take precedence over its ``depth.toml``.

    Attributes:
        name, state, count: name of the folder, the cameras' parameters, and number of pairs.

    Raises:
        InputError: a folder or image is missing or unreadable, images do not belong together, or the depth images are
            not of the size of the colour images and no ``colour_lens`` is given.
    """

    def __init__(self, folder: Path, options: DepthOptions | None = None) -> None:
        self.name = str(folder)
        colours = colour_folder(folder)
        if colours is None:
            fix = f"put colour images into {COLOURS[0]}, and depth images into {DEPTH}"
            raise InputError("has no folder of colour images", file=folder, fix=fix)
        self._depth = DepthFiles([folder / DEPTH], options)
        files = sorted((f for f in colours.iterdir() if f.suffix.lower() in IMAGES), key=lambda f: natural(f.name))
        self._pairs = _paired(self._depth.files, files, colours)
        self.count = sum(colour is not None for colour, _ in self._pairs)
        if not self.count:
            fix = f"their names are times in seconds, which differ by more than {TOGETHER_S:g} s"
            raise InputError("has no image of a depth image's time", file=colours, fix=fix)
        height, width = read_image(next(colour for colour, _ in self._pairs if colour is not None)).shape[:2]
        self.state = replace(self._depth.state, colour=self._camera(folder, (width, height)))

    def images(self) -> Iterator[RecordedDepth]:
        """Yield all pairs, from the first; a damaged depth image is yielded without an image, with the problem.

        Raises:
            InputError: as `DepthFiles.images`; or a colour image cannot be read, or has another size than the first.
        """
        wanted = self.state.colour.size_px if self.state.colour is not None else (0, 0)
        for image, (file, time_ns) in zip(self._depth.images(), self._pairs, strict=True):
            if file is None:
                continue
            colour = read_image(file)
            if colour.shape[1::-1] != wanted:
                fix = "put images of one camera there"
                raise InputError(f"is {colour.shape[1]} × {colour.shape[0]} px", file=file, fix=fix)
            yield replace(image, colour=colour, time_ns=image.time_ns if time_ns is None else time_ns)

    def _camera(self, folder: Path, size_px: tuple[int, int]) -> ColourCamera:
        path = folder / DEPTH / SIDECAR
        told = read_sidecar(path) if path.exists() else DepthSidecar()
        lens = lens_of(told.colour_lens or ())
        if lens is not None:
            T = np.eye(4)
            if told.colour_from_depth is not None:
                T[:3] = np.reshape(told.colour_from_depth, (3, 4))
            return ColourCamera(size_px, lens, tuple(tuple(map(float, row)) for row in T))
        if self._depth.state.size_px != size_px:
            size = "{} × {}".format(*(self._depth.state.size_px or (0, 0)))
            raise InputError(f"has depth images of {size} px and colour images of {size_px[0]} × {size_px[1]}",
                             file=folder, fix=f"write colour_lens and colour_from_depth into {DEPTH}/{SIDECAR}"
                             )  # fmt: skip
        return ColourCamera(size_px, self._depth.state.lens or ())


def colour_folder(folder: Path) -> Path | None:
    """Return the folder of colour images beside a folder of depth images in a folder; None if there are not both."""
    if not (folder / DEPTH).is_dir():
        return None
    return next((folder / name for name in COLOURS if (folder / name).is_dir()), None)


def _paired(depths: list[Path], colours: list[Path], where: Path) -> list[tuple[Path | None, int | None]]:
    """Return for each depth image its colour image, None without one, and its time [ns], None if names tell none."""
    times, others = _times_s(depths), _times_s(colours)
    if times is None or others is None:
        if len(depths) != len(colours):
            fix = "give as many images as there are depth images, or name both by their times in seconds"
            raise InputError(f"has {len(colours)} images for {len(depths)} depth images", file=where, fix=fix)
        return [(colour, None) for colour in colours]
    found: list[tuple[Path | None, int | None]] = []
    for time_s in times:
        nearest = int(np.argmin([abs(other - time_s) for other in others]))
        beside = colours[nearest] if abs(others[nearest] - time_s) <= TOGETHER_S else None
        found.append((beside, round((time_s - times[0]) * NS_PER_S) + 1))
    return found


def _times_s(files: list[Path]) -> list[float] | None:
    """Return the rising times that files are named by [s]; None if a name is no time with a fraction."""
    times = []
    for file in files:
        whole, dot, part = file.stem.partition(".")
        if not (dot and whole.isdecimal() and part.isdecimal() and file.stem.isascii() and len(file.stem) < 40):
            return None
        times.append(float(file.stem))
    return times if len(times) > 0 and all(a < b for a, b in pairwise(times)) else None
