"""Trajectories of points in the images of several cameras and in space, as stored in files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError

Float64 = NDArray[np.float64]


class ImageTracks(msgspec.Struct, frozen=True, eq=False):
    """Image positions of named points, by frame and camera.

    Attributes:
        cameras, points: names of the cameras and of the points.
        frames: (frames,) numbers of the frames in the file, ascending.
        at_s: (frames, cameras) capture times, on each camera's own clock [s]; NaN if not in the file.
        pixels: (frames, cameras, points, 2) x, y [px]; NaN where not seen.
        confidences: (frames, cameras, points) the detector's confidence, 0 to 1; 1 if the file has none.
        notes: sentences for the user about omissions and choices in reading the file.
    """

    cameras: tuple[str, ...]
    points: tuple[str, ...]
    frames: NDArray[np.int64]
    at_s: Float64
    pixels: Float64
    confidences: Float64
    notes: tuple[str, ...] = ()


class SpaceTracks(msgspec.Struct, frozen=True, eq=False):
    """World positions of named points, by frame.

    Attributes:
        points: names of the points.
        frames: (frames,) numbers of the frames.
        at_s: (frames,) capture times, on the rig's clock [s]; NaN if unknown.
        positions: (frames, points, 3) in the world [m]; NaN where not known.
        sds: (frames, points) root of the mean variance of a coordinate [m]; NaN if unknown.
        residuals_px: (frames, points) root mean square reprojection error over the cameras used [px].
        views: (frames, points) number of cameras used.
        states: (frames, points) a `geometry.triangulation.PointState`.
    """

    points: tuple[str, ...]
    frames: NDArray[np.int64]
    at_s: Float64
    positions: Float64
    sds: Float64
    residuals_px: Float64
    views: NDArray[np.int64]
    states: NDArray[np.uint8]


def match_cameras(
    seen: Sequence[str], rig: Iterable[str], *, file: object = None, remedy: str = "name the cameras like them"
) -> list[str]:
    """Match a file's camera names with a rig's: equal names, or else names with equal short forms.

    A short form drops case, punctuation, an ending ``_json``, then ``camera``, ``cam`` or ``port``, and leading zeros.

    Args:
        seen: the file's names.
        rig: the rig's names.
        file: named in errors; None leaves it out.
        remedy: how to name a camera like the rig's, in errors.

    Returns:
        The rig's name for each of ``seen``.

    Raises:
        InputError: a camera has no match or several, or two have the same.
    """
    names = list(rig)
    short: dict[str, list[str]] = {}
    for name in names:
        short.setdefault(_plain(name), []).append(name)
    found = []
    for name in seen:
        candidates = [name] if name in names else short.get(_plain(name), [])
        if len(candidates) != 1:
            raise InputError(
                "the rig has no such camera" if not candidates else f"the rig has several: {', '.join(candidates)}",
                file=file,
                field="camera",
                value=name,
                fix=f"the rig's are {', '.join(names)}; {remedy}",
            )
        found += candidates
    for name in found:
        if found.count(name) > 1:
            both = [a for a, b in zip(seen, found, strict=True) if b == name]
            raise InputError("two cameras are the same of the rig", file=file, value=both, fix="rename one")
    return found


def _plain(name: str) -> str:
    short = re.sub(r"[^a-z0-9]", "", name.lower().removesuffix("_json"))
    return re.sub(r"^(camera|cam|port)?0*(?=.)", "", short)
