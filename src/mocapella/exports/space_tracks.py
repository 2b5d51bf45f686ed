"""Export named 3D points: Mocapella's CSV, and TRC for OpenSim and other biomechanics software."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError, one_of, visible
from mocapella.model.names import as_cell
from mocapella.model.point_tracks import SpaceTracks

Float64 = NDArray[np.float64]

COLUMNS: Final = ("frame", "time_s", "point", "x_m", "y_m", "z_m", "sd_m", "views", "residual_px")
"""Columns of the CSV; ``views`` and ``residual_px`` are explained at `SpaceTracks`."""
UP: Final = {"y": (0, 1, 2), "z": (1, 2, 0), "-y": (0, 1, 2)}
"""Indices of the world axes that become X, Y and Z of a TRC, whose Y is up, by the world's upward axis.

For ``-y``, Y and Z also change their signs."""


def write_space_tracks(tracks: SpaceTracks, path: Path, *, up: str = "y", hz: float | None = None) -> None:
    """Write named 3D points as CSV or TRC, by the path's suffix. The file appears complete or not at all.

    Args:
        tracks: the points. A CSV has rows for known points only; a TRC has NaN for unknown ones.
        path: the file, ending with .csv or .trc; an existing one is replaced.
        up: the world's upward axis: y or z, or -y if the world is a camera frame with y down. The points of a TRC are
            rotated so that Y is up; a CSV keeps the world's axes.
        hz: frame rate to compute times from; None for the times of the tracks [Hz].

    Raises:
        SettingsError: the suffix or axis is unknown, the rate is not above 0, or the file cannot be written.
        InputError: a TRC is to be written, and there is no frame, or ``hz`` is None and the frames' times give no rate.
    """
    writers: dict[str, Callable[[], str]] = {
        ".csv": lambda: as_csv(tracks, hz),
        ".trc": lambda: as_trc(tracks, path.name, up, hz),
    }
    suffix = path.suffix.lower()
    if suffix not in writers:
        raise SettingsError(
            f"--out {path}: no file of the kind {suffix!r}; end its name with {one_of(suffix, writers)}"
        )
    if up not in UP:
        raise SettingsError(f"up is {up!r}; it must be one of {', '.join(UP)}")
    if hz is not None and not 0 < hz < 1e6:
        raise SettingsError(f"hz is {hz!r}; it must be above 0")
    text = writers[suffix]()
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SettingsError(f"--out {path}: {error.strerror}; name a file in a folder that exists") from error


def as_csv(tracks: SpaceTracks, hz: float | None = None) -> str:
    """Return the text of a CSV with `COLUMNS`, with a row for each known point, positions in the world frame [m].

    Unknown times and standard deviations are empty.

    Args:
        tracks: the points.
        hz: frame rate, above 0, to compute times from; None for the times of the tracks [Hz].
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    at_s = times(tracks, hz)
    for i, frame in enumerate(tracks.frames):
        for p in np.flatnonzero(np.isfinite(tracks.positions[i]).all(axis=-1)):
            place = [f"{value:.6f}" for value in tracks.positions[i, p]]
            sd = tracks.sds[i, p]
            writer.writerow(
                [
                    int(frame),
                    "" if np.isnan(at_s[i]) else f"{at_s[i]:.6f}",
                    as_cell(tracks.points[p]),
                    *place,
                    "" if np.isnan(sd) else f"{sd:.6f}",
                    int(tracks.views[i, p]),
                    f"{tracks.residuals_px[i, p]:.3f}",
                ]
            )
    return out.getvalue()


def as_trc(tracks: SpaceTracks, name: str, up: str = "y", hz: float | None = None) -> str:
    """Return the text of a TRC, the marker file of OpenSim, in metres with Y up; unknown coordinates are NaN.

    The first frame's time is 0, and the frames keep their numbers. Without ``hz``, the header's rate is that of the
    median interval between frames with different times, or 1 Hz for a single frame.

    Args:
        tracks: the points.
        name: the file's name, for the header.
        up: the world's upward axis, a key of `UP`.
        hz: frame rate, above 0, to compute times from; None for the times of the tracks [Hz].

    Raises:
        InputError: there are no frames, or no rate is given, and the time of a frame is unknown or no time is later
            than the one before.
    """
    at_s = times(tracks, hz)
    if not np.isfinite(at_s).all() or len(at_s) < 1:
        raise InputError("a TRC needs times, and the points have none", fix="give the rate of their frames with --fps")
    intervals = np.diff(at_s)
    later = intervals[intervals > 0]
    if hz is None and len(intervals) > 0 and len(later) == 0:
        raise InputError("a TRC needs times that rise", fix="give the rate of their frames with --fps")
    rate = hz or (1.0 / float(np.median(later)) if len(later) > 0 else 1.0)
    count, points = len(at_s), len(tracks.points)
    rate_text = f"{rate:.6g}"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{visible(name)}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate_text}\t{rate_text}\t{count}\t{points}\tm\t{rate_text}\t{int(tracks.frames[0])}\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(map(_marker, tracks.points)) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{p}" for p in range(1, points + 1) for axis in "XYZ"),
    ]
    sign = np.array([1.0, -1.0, -1.0]) if up == "-y" else 1.0
    places = tracks.positions[..., list(UP[up])] * sign
    for i in range(count):
        cells = [
            "NaN" if np.isnan(value) else f"{value:.6f}" for value in places[i].ravel()
        ]  # OpenSim drops empty ends
        lines.append("\t".join([str(int(tracks.frames[i])), f"{at_s[i] - at_s[0]:.6f}", *cells]))
    return "\n".join(lines) + "\n"


def _marker(name: str) -> str:
    """Return the name of a marker, which in OpenSim begins with a letter: ``p7`` of a point that is only numbered."""
    return f"p{name}" if name.isdecimal() else visible(name)


def times(tracks: SpaceTracks, hz: float | None) -> Float64:
    """Return the times (frames,) of the frames [s].

    They are frame number / ``hz``; if that is None, the array ``tracks.at_s`` itself, with NaN where unknown.
    """
    return tracks.frames / hz if hz is not None else tracks.at_s
