"""Triangulate named points from the detections of several cameras, frame by frame.

Each frame's points are triangulated on their own: by least squares of the reprojection error with outlier rejection
(`mocapella.geometry.triangulation`), or by the weighted linear method (`mocapella.geometry.weighted_linear`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import one_of
from mocapella.geometry.triangulation import PointState, Triangulated, TriangulationSettings, triangulate, views
from mocapella.geometry.weighted_linear import WeightedLinearSettings, weighted_linear
from mocapella.model.camera import CameraRig
from mocapella.model.point_tracks import ImageTracks, SpaceTracks, match_cameras
from mocapella.settings import check

Float64 = NDArray[np.float64]

METHODS: Final = {
    "robust": "least squares of the distorted pixels; of cameras that disagree, those that agree best",
    "weighted-linear": "linear, weighted by confidence; cameras are dropped until the mean error is small",
    "linear": "linear, weighted by confidence, of all cameras; no point where the mean error is large",
}

ALARM: Final = 1.0 / 3.0
"""Share of unused detections above which a camera is named."""


@dataclass(frozen=True)
class TracksSettings:
    """Parameters of the triangulation.

    Attributes:
        method: ``robust`` (nonlinear least squares, cameras that disagree are rejected), ``weighted-linear`` or
            ``linear`` (DLT, weighted by confidence); see `METHODS`.
        sd_px: for the method robust: standard deviation of a coordinate of a detection with confidence 1; for others it
            is divided by the square root of the confidence [px].
        gate_sd: for the method robust: largest residual of an inlier, see `TriangulationSettings` [standard
            deviations].
        least_confidence: only detections with a higher confidence are used [0 to 1].
        largest_error_px: for the two linear methods: largest mean error, see `WeightedLinearSettings` [px].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    method: str = "robust"
    sd_px: float = 3.0
    gate_sd: float = 4.0
    least_confidence: float = 0.3
    largest_error_px: float = 15.0

    def __post_init__(self) -> None:
        check(self.method in METHODS, "method", self.method, f"one of {one_of(self.method, METHODS)}")
        check(0 < self.sd_px < 1e6, "sd_px", self.sd_px, "above 0 px")
        TriangulationSettings(gate_sd=self.gate_sd)
        WeightedLinearSettings(self.least_confidence, self.largest_error_px)


class TracksReport(msgspec.Struct, frozen=True):
    """Counts and errors of the points.

    Attributes:
        frames, points: number of frames, and of named points.
        counted: number of points of all frames in each `PointState`, by its name in lower case.
        residual_px: root mean square of the used detections' reprojection errors; 0 without any [px].
        cameras: report of each camera, by its name in the rig.
    """

    frames: int
    points: int
    counted: Mapping[str, int]
    residual_px: float
    cameras: Mapping[str, CameraPointsReport]


class CameraPointsReport(msgspec.Struct, frozen=True):
    """One camera's contribution.

    Attributes:
        seen: number of confident detections (above ``least_confidence``) of points that were triangulated.
        rejected_share: fraction of these detections that were rejected as outliers, 0 to 1; 0 without any.
        residual_px: root mean square of the reprojection errors of the used ones; 0 without any [px].
        unused_share: fraction of the confident detections of points that another camera saw, too, which were not used,
            also because the point was not triangulated, 0 to 1; 0 without any.
    """

    seen: int
    rejected_share: float
    residual_px: float
    unused_share: float = 0.0


def triangulate_tracks(
    tracks: ImageTracks, rig: CameraRig, settings: TracksSettings | None = None
) -> tuple[SpaceTracks, TracksReport]:
    """Triangulate every point of every frame in the rig's world.

    Args:
        tracks: detections of the points in the images of two cameras or more.
        rig: the cameras; the names are matched by `mocapella.model.point_tracks.match_cameras`.
        settings: method and its parameters; the defaults if None.

    Returns:
        The points, NaN where they cannot be triangulated, with the states and the median capture time of each frame, on
        the rig's clock; and a report.

    Raises:
        InputError: the rig has no such camera, or two with this name.
    """
    s = settings or TracksSettings()
    names = match_cameras(tracks.cameras, rig.cameras)
    placed = [rig.cameras[name] for name in names]
    lenses, T = np.array([c.camera.lens for c in placed]), np.array([c.T_camera_world for c in placed])
    pixels, confidences = np.moveaxis(tracks.pixels, 1, 2), np.moveaxis(tracks.confidences, 1, 2)
    confident = (confidences > s.least_confidence) & np.isfinite(pixels).all(axis=-1)
    if s.method == "robust":
        sd = np.where(confident, s.sd_px / np.sqrt(np.maximum(confidences, 1e-9)), np.nan)
        found = triangulate(pixels, views(lenses, T), sd, TriangulationSettings(gate_sd=s.gate_sd))
    else:
        linear = WeightedLinearSettings(s.least_confidence, s.largest_error_px, s.method == "weighted-linear")
        found = weighted_linear(pixels, confidences, lenses, T, linear)
    clocks = np.array([c.clock_s for c in placed])
    at_s = np.array(
        [np.median(row[there]) if (there := np.isfinite(row)).any() else np.nan for row in tracks.at_s - clocks]
    )
    squares = np.where(found.used, found.residuals_px**2, 0.0)
    count = found.used.sum(axis=-1)
    with np.errstate(invalid="ignore"):
        residuals = np.sqrt(squares.sum(axis=-1) / count)
        sds = np.sqrt(np.trace(found.covariances, axis1=-2, axis2=-1) / 3.0)
    space = SpaceTracks(tracks.points, tracks.frames, at_s, found.points, sds, residuals, count, found.states)
    return space, _report(found, confident, names)


def alarms(report: TracksReport) -> list[str]:
    """Return sentences about cameras whose detections are mostly rejected, with likely causes and remedies.

    The residual does not show it: the detections that are used agree.
    """
    bad = {name: one.unused_share for name, one in report.cameras.items() if one.unused_share > ALARM}
    if len(bad) * 2 > len(report.cameras):
        shares = ", ".join(f"{name} {share:.0%}" for name, share in bad.items())
        return [
            f"many detections are rejected ({shares}): compare the rig with the recording (its cameras, their names "
            "and image size), the order of the points, and whether the cameras began together and show the same person"
        ]
    return [
        f"camera {name}: {share:.0%} of its detections are rejected: it moved after the calibration, is another camera "
        "of the rig, began at another time, shows another person, or is less accurate than sd_px; calibrate it again, "
        "or check when it began"
        for name, share in bad.items()
    ]


def _report(found: Triangulated, confident: NDArray[np.bool_], names: list[str]) -> TracksReport:
    good = found.states == PointState.SEEN
    cameras = {}
    for k, name in enumerate(names):
        seen, used = confident[..., k] & good, found.used[..., k]
        share = float(1.0 - used.sum() / seen.sum()) if seen.any() else 0.0
        shared = confident[..., k] & (confident.sum(axis=-1) >= 2)
        unused = float(1.0 - (used & shared).sum() / shared.sum()) if shared.any() else 0.0
        cameras[name] = CameraPointsReport(int(seen.sum()), share, _rms(found.residuals_px[..., k][used]), unused)
    counted = {state.name.lower(): int((found.states == state).sum()) for state in PointState}
    return TracksReport(len(good), good.shape[1], counted, _rms(found.residuals_px[found.used]), cameras)


def _rms(values: Float64) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
