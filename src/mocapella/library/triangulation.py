"""Triangulate 2D points of calibrated cameras: files or arrays; `mocapella track points` uses it too."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocapella.errors import InputError, SettingsError
from mocapella.exports.space_tracks import times, write_space_tracks
from mocapella.fusion.point_tracks import TracksReport, TracksSettings, alarms, triangulate_tracks
from mocapella.geometry.triangulation import PointState
from mocapella.library.motion_tracks import MotionTracks
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.observations import JointState
from mocapella.model.point_tracks import ImageTracks, SpaceTracks
from mocapella.model.trajectories import Trajectories, median_step
from mocapella.recording.detection_files import read_detections
from mocapella.recording.detections import AUTO, image_tracks

Detections = ImageTracks | Mapping[str, ArrayLike] | Sequence[Path | str] | Path | str
"""2D points: tracks, arrays by camera, or files."""


@dataclass(frozen=True, eq=False, repr=False)
class TriangulatedPoints:
    """Points in space, in the rig's world.

    Attributes:
        tracks: positions, standard deviations, residuals and numbers of views.
        report: counts and errors.
        notes: sentences about omissions in reading the points, and about cameras that disagree.
        fps: frame rate that the times follow; None for the times of the points [Hz].
    """

    tracks: SpaceTracks
    report: TracksReport
    notes: tuple[str, ...] = ()
    fps: float | None = None

    @property
    def points(self) -> MotionTracks:
        """The points as a motion with one individual; they are measured where at least two cameras agree.

        Raises:
            SettingsError: the times of the frames are unknown or do not rise; give ``fps``.
        """
        own = self.tracks
        at_s = times(own, self.fps)
        steps = np.diff(at_s)
        if not np.isfinite(at_s).all() or not (steps > 0).all():
            raise SettingsError("the points have no rising times; give triangulate(…, fps=) their frame rate")
        seen = own.states == PointState.SEEN
        found = Trajectories(
            "points", at_s - at_s[:1], np.zeros(len(at_s), np.int64), ("points",), own.points, own.positions[:, None],
            np.where(seen, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)[:, None],
            own.sds.astype(np.float32)[:, None], rate_hz=1.0 / median_step(at_s),
            notes=self.notes,
        )  # fmt: skip
        return MotionTracks.of_file(found, "")

    def save(self, path: Path | str, *, up: str = "y") -> None:
        """Write the points as .csv or .trc, as `mocapella.exports.space_tracks.write_space_tracks` does.

        Args:
            path: the file; an existing one is replaced.
            up: the world's upward axis: y, z or -y; a TRC has y up.

        Raises:
            SettingsError, InputError: the file cannot be written, or the times give no rate.
        """
        write_space_tracks(self.tracks, Path(path), up=up, hz=self.fps)

    def __repr__(self) -> str:
        counted = self.report.counted["seen"]
        return (
            f"<{counted} of {self.report.frames * self.report.points} points of {self.report.frames} frames; "
            f"{self.report.residual_px:.2f} px>"
        )


def triangulate(
    points: Detections,
    rig: CameraRig | Path | str,
    *,
    solver: str = "robust",
    sd_px: float = 3.0,
    least_confidence: float = 0.3,
    largest_error_px: float = 15.0,
    order: str = AUTO,
    names: Sequence[str] | None = None,
    fps: float | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> TriangulatedPoints:
    """Triangulate 2D points, which any program found in the images of calibrated cameras, to points in space.

    found = mocapella.triangulate({"left": left_px, "right": right_px}, "rig.toml", fps=60)
    found.points.to_pandas()

    Args:
        points: by camera an array (frames, points, 2) of x, y [px], or (frames, points, 3) with the confidence, NaN
            where not seen; or files of other programs: a folder or file for each camera, a folder with these, or a CSV
            of all.
        rig: the cameras, or their file.
        solver: robust, weighted-linear or linear, see `mocapella.fusion.point_tracks.METHODS`.
        sd_px: standard deviation of a certain detection; of the solver robust [px].
        least_confidence: only detections with a higher confidence are used [0 to 1].
        largest_error_px: largest mean reprojection error of a point; of the linear solvers [px].
        order: order of keypoints without names, such as BODY_25; auto: by their number and places, see
            `mocapella.recording.detections.ORDERS`.
        names: names of the points of arrays; ``p0``, ``p1`` … if None.
        fps: frame rate; None for the times of the file [Hz].
        progress: called with a line about each stage.

    Raises:
        InputError: a file cannot be used, or the rig has not the cameras.
        SettingsError: an argument is invalid; names the valid ones.
    """
    settings = TracksSettings(solver, sd_px, 4.0, least_confidence, largest_error_px)
    if fps is not None and not 0 < fps < 1e6:
        raise SettingsError(f"fps is {fps!r}; it must be above 0")
    cameras = rig if isinstance(rig, CameraRig) else load_camera_rig(Path(rig))
    if len(cameras.cameras) < 2:
        raise InputError(
            f"has {len(cameras.cameras)} camera", file="the rig" if isinstance(rig, CameraRig) else rig,
            fix="give a rig of two cameras or more",
        )  # fmt: skip
    tracks = _image_tracks(points, order, names, progress)
    progress(f"triangulating {len(tracks.frames)} frames")
    space, report = triangulate_tracks(tracks, cameras, settings)
    return TriangulatedPoints(space, report, (*tracks.notes, *alarms(report)), fps)


def _image_tracks(
    points: Detections, order: str, names: Sequence[str] | None, progress: Callable[[str], None]
) -> ImageTracks:
    if isinstance(points, ImageTracks):
        return points
    if isinstance(points, Mapping):
        return tracks_of_arrays(points, names)
    paths = [points] if isinstance(points, Path | str) else points
    files = [Path(path) for path in paths]
    found = read_detections(files, order=order, progress=lambda text: progress(f"reading {text}"))
    return image_tracks(found, file=paths[0] if paths else None)


def tracks_of_arrays(arrays: Mapping[str, ArrayLike], names: Sequence[str] | None = None) -> ImageTracks:
    """Return arrays of image positions, as of `triangulate`, as tracks; frames are numbered from 0.

    Raises:
        SettingsError: the arrays differ in their frames or points, or have another shape.
    """
    found: dict[str, NDArray[Any]] = {name: np.asarray(one, dtype=np.float64) for name, one in arrays.items()}
    shapes = {one.shape[:2] for one in found.values()}
    if len(shapes) != 1 or any(one.ndim != 3 or one.shape[2] not in (2, 3) for one in found.values()):
        given = ", ".join(f"{name} {one.shape}" for name, one in found.items()) or "none"
        raise SettingsError(f"arrays are {given}; give (frames, points, 2 or 3) of equal frames and points by camera")
    ((frames, count),) = shapes
    if names is not None and len(set(names)) != count:
        raise SettingsError(f"{len(set(names))} different names for {count} points; give a name for each")
    confidences = [one[..., 2] if one.shape[2] == 3 else np.ones((frames, count)) for one in found.values()]
    return ImageTracks(
        tuple(found), tuple(names or (f"p{k}" for k in range(count))), np.arange(frames),
        np.full((frames, len(found)), np.nan), np.stack([one[..., :2] for one in found.values()], axis=1),
        np.nan_to_num(np.stack(confidences, axis=1)),
    )  # fmt: skip
