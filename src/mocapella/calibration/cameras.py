"""Calibrate lenses and poses of cameras from views of a board that is carried before them.

First each camera alone: its lens from its own views (`board_views`, Zhang 2000), which need no synchronisation. Then
all together (`board_bundle`): poses and lenses are adjusted to the shared views, with the first result as a prior of
the lenses. Coefficients that no view determines stay near typical lenses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.board_bundle import CAMERA, LENS, POSE, Adjusted, Bundle, Corners, LensPrior, adjust
from mocapella.calibration.board_guidance import Hint, coverage, field_counts
from mocapella.calibration.board_views import OneCamera, joint_start, one_camera, usable
from mocapella.calibration.corner_quality import CameraNoise, CornerQuality, corner_quality
from mocapella.calibration.lens_prior import lens_prior, observed
from mocapella.errors import CalibrationError
from mocapella.geometry.rigid import inverse, rigid
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera, CameraRig, PlacedCamera

Float64 = NDArray[np.float64]
Instants = Mapping[tuple[str, int], int]
"""Number of the group of simultaneous frames, by camera and frame number."""

SURE_FOCAL: Final = 0.05
"""Relative standard deviation of a focal length above which the views did not determine it."""
LEAST_FOR_HALVES: Final = 6
"""Least number of shared groups for a cross-validation: each half of the views by the other."""
BOARD_LYING: Final = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""``R_world_board`` of a board on the floor, face up: y up, x along its columns, z along its rows."""
BOARD_UPRIGHT: Final = np.diag([1.0, -1, -1])
"""``R_world_board`` of a board on a wall: y up, x along its columns, z out of the wall; ``R_world_camera`` if level."""


@dataclass(frozen=True)
class Origin:
    """Definition of the world frame by a board. Without one, the world is at the first camera, y up if it is level.

    Attributes:
        instant: number of the group of simultaneous views whose board defines the world.
        upright: whether the board hung on a wall then; otherwise it lay on the floor, face up.
    """

    instant: int
    upright: bool = False


@dataclass(frozen=True)
class CameraReport:
    """Quality of one camera's calibration.

    Attributes:
        views: number of images with a good detection of the board.
        rejected: number of images with too few corners, or all on a line.
        fields: fraction of the image's fields (`board_guidance.GRID`) that have corners.
        reprojection_px: root mean square reprojection error after the adjustment of all cameras together [px].
        own_px: robust standard deviation of a corner's coordinate, from this camera's own views [px].
        position_sd_mm: standard deviation of the camera's position: the root of the sum of the three variances; 0 for
            the world's origin [mm].
        rotation_sd_deg: standard deviation of its orientation, about all axes together [°].
        focal_sd_percent: relative standard deviation of its focal length; 0 if the lens was given [%].
        observed: coefficients among cx cy k1 k2 p1 p2 k3 that the views determined; the others are typical values.
    """

    views: int
    rejected: int
    fields: float
    reprojection_px: float
    own_px: float
    position_sd_mm: float
    rotation_sd_deg: float
    focal_sd_percent: float
    observed: list[str]


@dataclass(frozen=True)
class CameraCalibration:
    """A rig and its quality. A group is a set of simultaneous views of the board.

    Attributes:
        rig: the cameras in the order of their names.
        cameras: a report by name.
        instants: number of groups with one or more cameras.
        shared_instants: number of groups with two or more.
        sigma_px: standard deviation of a corner's coordinate in the joint adjustment; larger than each camera's own if
            the cameras are not triggered together [px].
        dispersion: variance of whole views' errors relative to that of single corners (`board_bundle.Adjusted`).
        fit: quality of triangulated corners, of the views used for calibration.
        left_out: quality of triangulated corners of each half of the views, by a calibration from the other; None if
            not measured, or with too few.
        hints: advice that would improve it.
    """

    rig: CameraRig
    cameras: Mapping[str, CameraReport]
    instants: int
    shared_instants: int
    sigma_px: float
    dispersion: float
    fit: CornerQuality
    left_out: list[CornerQuality] | None
    hints: list[Hint]


def calibrate_cameras(
    views: Sequence[BoardView],
    board: Board,
    instant_of: Instants | None = None,
    *,
    known: Mapping[str, Camera] | None = None,
    origin: Origin | None = None,
    measure: bool = True,
) -> CameraCalibration:
    """Calibrate a rig of all cameras in the views, or one camera's lens. Views that are not `usable` are left out.

    Args:
        views: views of the board by all cameras.
        board: the calibration board, whose squares give the scale.
        instant_of: groups of simultaneous frames; None for the frame numbers.
        known: cameras with a given lens, which stays fixed, by name; None for none.
        origin: definition of the world frame; None for the first camera by name.
        measure: whether to cross-validate halves (``left_out``), which takes about twice as long in addition.

    Raises:
        CalibrationError: the views do not determine it; names the camera and what to film.
    """
    instants = instant_of or {(view.camera, view.frame): view.frame for view in views}
    known = known or {}
    names = sorted({view.camera for view in views})
    kept = sorted(
        (view for view in views if usable(view, board)),
        key=lambda view: (view.camera, instants[view.camera, view.frame]),
    )
    _check(kept, names, board, known)
    found = _solve(kept, board, instants, known, origin)
    for name, one in found.single.items():
        if name not in known:
            _check_focal(name, one)
    cameras = _placed(found, kept, known, origin)
    shared = _shared_instants(kept, instants)
    hints = coverage(kept, board, names, instants, lens_known=list(known))
    return CameraCalibration(
        CameraRig(cameras),
        {name: _report(name, k, found, views, board) for k, name in enumerate(names)},
        len(found.instants),
        len(shared),
        found.adjusted.sigma_px,
        found.adjusted.dispersion,
        corner_quality(kept, instants, cameras, board, CameraNoise(found.adjusted.sigma_px, found.adjusted.covariance)),
        _halves(kept, board, instants, known, shared) if measure else None,
        hints,
    )


@dataclass(frozen=True)
class _Found:
    single: Mapping[str, OneCamera]
    corners: Corners
    adjusted: Adjusted
    instants: list[int]


def _check(kept: Sequence[BoardView], names: Sequence[str], board: Board, known: Mapping[str, Camera]) -> None:
    if not names:
        raise CalibrationError("no picture shows the board: check its kind, columns, rows and dictionary")
    for name in names:
        mine = [view for view in kept if view.camera == name]
        if not mine:
            raise CalibrationError(
                f"camera {name} sees enough of the board in no picture: at least 6 corners on two rows are needed"
            )
        sizes = {view.size_px for view in mine} | ({known[name].size_px} if name in known else set())
        if len(sizes) > 1:
            given = " and its lens is of" if name in known else ""
            texts = [f"{width}×{height}" for width, height in sorted(sizes)]
            raise CalibrationError(
                f"camera {name} has pictures of several sizes{given}: {', '.join(texts)} px: a lens holds for one size "
                "only, so film with that one"
            )
    if board.turnable and len(names) > 1:
        raise CalibrationError(
            f"a chessboard of {board.columns} × {board.rows} squares looks the same when turned by 180°, so cameras "
            "that face it from different sides cannot agree on its corners: take one with an odd and an even number of "
            "squares, or a ChArUco board"
        )


def _solve(
    kept: Sequence[BoardView], board: Board, instants: Instants, known: Mapping[str, Camera], origin: Origin | None
) -> _Found:
    names = sorted({view.camera for view in kept})
    single = {
        name: one_camera([view for view in kept if view.camera == name], board, known.get(name)) for name in names
    }
    bundle, corners, order = joint_start(kept, instants, single, board)
    free, free_boards = np.ones((len(names), CAMERA), dtype=bool), np.ones(len(order), dtype=bool)
    free[:, LENS] = np.array([name not in known for name in names])[:, None]
    if origin is None:
        free[0, POSE] = False
    elif origin.instant in order:
        held = order.index(origin.instant)
        free_boards[held] = False
        T = bundle.T_world_board[held]
        bundle = Bundle(bundle.T_camera_world @ T, bundle.lenses, inverse(T) @ bundle.T_world_board)
    else:
        raise CalibrationError(
            f"no camera saw the board well at the instant {origin.instant} of the origin: choose one of "
            f"{order[0]} to {order[-1]}"
        )
    sizes = {view.camera: view.size_px for view in kept}
    prior = lens_prior(np.array([sizes[name] for name in names], dtype=np.float64), bundle.lenses[:, 0])
    adjusted = adjust(corners, bundle, free, free_boards, prior)
    if adjusted.dispersion > 1.0 and len(names) > 1:
        surer = _with_own_views(prior, list(single.values()), adjusted.dispersion - 1.0)
        adjusted = adjust(corners, adjusted.bundle, free, free_boards, surer)
    return _Found(single, corners, adjusted, order)


def _with_own_views(prior: LensPrior, single: Sequence[OneCamera], weight: float) -> LensPrior:
    """Return the prior with each camera's own estimate of its lens added.

    If the variance is D times that of independent corners, the joint views are worth 1/D of their number, but fully for
    the lens of one camera alone. The other (D − 1)/D are added here, so that nothing counts twice.
    """
    mean, precision = prior.mean.copy(), prior.precision.copy()
    for c, one in enumerate(single):
        if one.covariance.any():  # a lens that was given has none
            own = weight * np.linalg.inv(one.covariance)
            mean[c] = np.linalg.solve(precision[c] + own, precision[c] @ mean[c] + own @ one.lens)
            precision[c] += own
    return LensPrior(mean, precision)


def _check_focal(name: str, one: OneCamera) -> None:
    spread = float(np.sqrt(one.covariance[0, 0])) / one.lens[0]
    if not spread < SURE_FOCAL:
        raise CalibrationError(
            f"camera {name}: its pictures leave the focal length uncertain by {100 * spread:.0f} %, as where the board "
            "is parallel to the picture in all of them: tilt the board more, forwards, backwards and to both sides"
        )


def _placed(
    found: _Found, kept: Sequence[BoardView], known: Mapping[str, Camera], origin: Origin | None
) -> dict[str, PlacedCamera]:
    """Return the cameras in the world, which has y up."""
    R = BOARD_UPRIGHT if origin is None or origin.upright else BOARD_LYING
    T_held_world = inverse(rigid(R, np.zeros(3)))
    sizes = {view.camera: view.size_px for view in kept}
    adjusted, cameras = found.adjusted, {}
    for k, name in enumerate(found.single):
        camera = known.get(name) or Camera(name, sizes[name], adjusted.bundle.lenses[k])
        T = adjusted.bundle.T_camera_world[k] @ T_held_world
        cameras[name] = PlacedCamera(camera, T, adjusted.covariance[k, POSE, k, POSE])
    return cameras


def _report(name: str, k: int, found: _Found, views: Sequence[BoardView], board: Board) -> CameraReport:
    mine = [view for view in views if view.camera == name]
    good = [view for view in mine if usable(view, board)]
    adjusted = found.adjusted
    residual = adjusted.residual_px[found.corners.camera == k]
    covariance = adjusted.covariance[k, :, k]
    variance = np.diag(covariance)
    lens_free = bool(variance[LENS].any())
    return CameraReport(
        len(good),
        len(mine) - len(good),
        float((field_counts(good) > 0).mean()),
        float(np.sqrt((residual**2).sum(axis=1).mean())),
        found.single[name].sigma_px,
        1e3 * float(np.sqrt(variance[:3].sum())),
        float(np.degrees(np.sqrt(variance[3:6].sum()))),
        100 * float(np.sqrt(variance[LENS][0])) / float(adjusted.bundle.lenses[k, 0]),
        observed(covariance[LENS, LENS], good[0].size_px) if lens_free else [],
    )


def _shared_instants(views: Sequence[BoardView], instants: Instants) -> list[int]:
    seen: dict[int, set[str]] = {}
    for view in views:
        seen.setdefault(instants[view.camera, view.frame], set()).add(view.camera)
    return sorted(instant for instant, names in seen.items() if len(names) > 1)


def _halves(
    kept: Sequence[BoardView], board: Board, instants: Instants, known: Mapping[str, Camera], shared: Sequence[int]
) -> list[CornerQuality] | None:
    """Evaluate each half of the shared views, alternating, by a calibration from everything else."""
    if len(shared) < LEAST_FOR_HALVES:
        return None
    out = []
    for half in (set(shared[0::2]), set(shared[1::2])):
        used = [view for view in kept if instants[view.camera, view.frame] not in half]
        tested = [view for view in kept if instants[view.camera, view.frame] in half]
        try:
            found = _solve(used, board, instants, known, None)
        except CalibrationError:  # half of the views are too few, the whole may be enough
            return None
        cameras = _placed(found, used, known, None)
        if not {view.camera for view in tested} <= set(cameras):
            return None
        noise = CameraNoise(found.adjusted.sigma_px, found.adjusted.covariance)
        out.append(corner_quality(tested, instants, cameras, board, noise))
    return out
