"""Where cameras stand and how they see, from views of a board that is carried about before them.

First each camera alone: its lens by its own views (`board_views`, Zhang 2000), for which it does not matter when
other cameras looked. Then all together (`board_bundle`): places and lenses are adjusted to the views that are shared,
and what the first step knows of the lenses counts for what these do not tell. What no view determines stays near what
lenses are like.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.board_bundle import CAMERA, LENS, POSE, Adjusted, Bundle, Corners, LensPrior, adjust
from mocapella.calibration.board_views import OneCamera, joint_start, one_camera, usable
from mocapella.calibration.corner_quality import CameraNoise, CornerQuality, corner_quality
from mocapella.calibration.hints import Hint, coverage, field_counts
from mocapella.calibration.lens_prior import lens_prior, observed
from mocapella.errors import CalibrationError
from mocapella.geometry.rigid import inverse, rigid
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera, CameraRig, PlacedCamera

Float64 = NDArray[np.float64]
Instants = Mapping[tuple[str, int], int]
"""Which instant a camera's frame belongs to, by camera and frame."""

SURE_FOCAL: Final = 0.05
"""Relative standard deviation of a focal length above which the views did not determine it."""
LEAST_FOR_HALVES: Final = 6
"""Instants that two cameras or more saw, for a calibration of each half to be tried on the other."""
BOARD_LYING: Final = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""``R_world_board`` of a board on the floor, face up: y up, x along its columns, z along its rows."""
BOARD_UPRIGHT: Final = np.diag([1.0, -1, -1])
"""``R_world_board`` of a board on a wall: y up, x along its columns, z out of the wall; of a camera likewise."""


@dataclass(frozen=True)
class Origin:
    """Where the world is. Without an instant: at the first camera, y up where the camera is held level, z backwards.

    Attributes:
        instant: of which the board is the world.
        upright: whether it hung on a wall then; otherwise it lay on the floor, face up.
    """

    instant: int
    upright: bool = False


@dataclass(frozen=True)
class CameraReport:
    """What is known of one camera.

    Attributes:
        views: pictures in which the board was found well enough.
        rejected: pictures with too few corners, or all on a line.
        fields: share of the fields of the picture that have corners.
        reprojection_px: root of the mean square distance of corners to where they are expected, with all cameras.
        own_px: of a coordinate, by this camera's own views alone, robust: the noise of corners.
        position_sd_mm: of the camera's place: the root of the sum of the three variances; 0 where the world is.
        rotation_sd_deg: likewise of its orientation.
        focal_sd_percent: of its focal length; 0 where the lens was given.
        observed: which of cx cy k1 k2 p1 p2 k3 the views determined; the others are what lenses are like.
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
    """A rig, and how good it is.

    Attributes:
        rig: the cameras in the order of their names.
        cameras: a report by name.
        instants: at which one camera or more saw the board.
        shared_instants: two or more.
        sigma_px: of a corner's coordinate in the joint adjustment; more than the cameras' own where they are not
            triggered together.
        dispersion: see `board_bundle.Adjusted`.
        fit: of triangulated corners, from the views that the rig was made of.
        left_out: likewise, each half of the instants by a calibration of the other; None where there are too few.
        hints: what would make it better.
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
    """A rig of all cameras that are in the views; of one camera, its lens.

    Args:
        views: of the board.
        board: whose squares give the scale.
        instant_of: the frame's number where not given.
        known: cameras whose lens is given, and stays.
        origin: of the world; the first camera by name where not given.
        measure: whether halves are tried on each other, which takes twice as long again.

    Raises:
        CalibrationError: the views do not say it; names the camera and what to film.
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
    """What each camera's own views say of its lens, in addition.

    Of a variance D times that of independent corners, the joint views are worth 1/D of their number; what the same
    views say of the lens without the other cameras is worth all of it. The other (D − 1)/D are added here, so that
    nothing counts twice.
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
    """Turned from the space that was held into the world, which has y up."""
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
    """Each half of the shared instants, every second one, by a calibration of everything else."""
    if len(shared) < LEAST_FOR_HALVES:
        return None
    out = []
    for half in (set(shared[0::2]), set(shared[1::2])):
        used = [view for view in kept if instants[view.camera, view.frame] not in half]
        tested = [view for view in kept if instants[view.camera, view.frame] in half]
        try:
            found = _solve(used, board, instants, known, None)
        except CalibrationError:  # half of the views are too few: nothing is said about the whole
            return None
        cameras = _placed(found, used, known, None)
        if not {view.camera for view in tested} <= set(cameras):
            return None
        noise = CameraNoise(found.adjusted.sigma_px, found.adjusted.covariance)
        out.append(corner_quality(tested, instants, cameras, board, noise))
    return out
