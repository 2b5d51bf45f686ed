"""Initial values of the rig: each camera's lens from its own views of a board, then poses from shared views.

Each camera: focal length and board poses from homographies (Z. Zhang, IEEE PAMI 22(11), 2000;
`mocapella.geometry.homography`), refined by reprojection error with a prior of typical lenses. Then extrinsics are
chained along a spanning tree of the cameras with most shared views. `board_bundle` adjusts the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.board_bundle import CAMERA, LENS, Bundle, Corners, adjust
from mocapella.calibration.lens_prior import lens_prior
from mocapella.errors import CalibrationError
from mocapella.geometry.homography import focal_length, homography, plane_pose
from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera

Float64 = NDArray[np.float64]

LEAST_CORNERS: Final = 6
"""Fewest corners of a view, on at least two rows and two columns, for a reliable pose."""
LEAST_VIEWS: Final = 3
"""Fewest views of a camera whose lens is estimated (Zhang, section 3.1)."""
CANDIDATES: Final = 40
"""Largest number of candidates for the motion between two cameras, each from one group of simultaneous views."""


def usable(view: BoardView, board: Board) -> bool:
    """Return whether a view determines the board's pose: enough corners, not all on a line."""
    rows, columns = np.divmod(view.ids, board.columns - 1)
    return len(view.ids) >= LEAST_CORNERS and len(set(rows.tolist())) > 1 and len(set(columns.tolist())) > 1


@dataclass(frozen=True)
class OneCamera:
    """A camera estimated from its own views alone.

    Attributes:
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_camera_board: (4, 4) for each view, in order.
        sigma_px: standard deviation of a corner's coordinate [px].
        covariance: (9, 9) covariance of the lens; 0 if it was given.
    """

    lens: Float64
    T_camera_board: list[Float64]
    sigma_px: float
    covariance: Float64


def one_camera(views: Sequence[BoardView], board: Board, known: Camera | None = None) -> OneCamera:
    """Estimate a camera's intrinsics, unless given, and the board's pose in each of its views, by reprojection error.

    Args:
        views: one or more `usable` views of this camera, of one image size.
        board: the calibration board.
        known: the camera, whose lens stays fixed; None to estimate the lens.

    Returns:
        The camera, with the pose of the board in each view, in the order of ``views``.

    Raises:
        CalibrationError: there are too few views for a lens.
    """
    name, size = views[0].camera, np.array(views[0].size_px, dtype=np.float64)
    plane = board.corners_m[:, :2]
    if known is not None:
        lens = known.lens
    else:
        if len(views) < LEAST_VIEWS:
            raise CalibrationError(
                f"camera {name} sees the board in {len(views)} pictures, and a lens needs {LEAST_VIEWS} at the very "
                "least: film the board longer, or give its lens with --rig"
            )
        lens = _first_lens(views, plane, size)
    poses = [plane_pose(plane[view.ids], _directions(view, lens)) for view in views]
    corners = stacked([(0, i, view) for i, view in enumerate(views)], board)
    free = np.zeros((1, CAMERA), dtype=bool)
    free[:, LENS] = known is None
    start = Bundle(np.eye(4)[None], lens[None], np.array(poses))
    prior = lens_prior(size[None], lens[:1])
    found = adjust(corners, start, free, np.ones(len(views), dtype=bool), prior)
    return OneCamera(
        found.bundle.lenses[0], list(found.bundle.T_world_board), found.sigma_px, found.covariance[0, LENS, 0, LENS]
    )


def _first_lens(views: Sequence[BoardView], plane: Float64, size: Float64) -> Float64:
    """Return a lens (9,) without distortion to begin with: a usual one where the views leave the focal length open.

    Args:
        views: the views.
        plane: (corners, 2) in the board's frame [m].
        size: (2,) width and height of the images [px].
    """
    centre = (size - 1) / 2
    f = focal_length([homography(plane[view.ids], view.corners_px) for view in views], centre)
    f = f if 0.2 * size[0] < f < 10 * size[0] else 0.9 * size[0]
    return np.array([f, f, *centre, 0, 0, 0, 0, 0])


def _directions(view: BoardView, lens: Float64) -> Float64:
    """Return undistorted corners; without correction of the distortion where the lens model ends."""
    direct = undistort(view.corners_px, lens)
    return np.where(np.isfinite(direct), direct, (view.corners_px - lens[2:4]) / lens[:2])


def stacked(views: Sequence[tuple[int, int, BoardView]], board: Board) -> Corners:
    """Concatenate the corners of views, for `board_bundle.adjust`.

    Args:
        views: for each view the index of its camera, the index of its board pose, and the view.
        board: gives the corners' positions.
    """
    counts = [len(view.ids) for _, _, view in views]
    return Corners(
        np.repeat([camera for camera, _, _ in views], counts),
        np.repeat([pose for _, pose, _ in views], counts),
        np.concatenate([board.corners_m[view.ids] for _, _, view in views]),
        np.concatenate([view.corners_px for _, _, view in views]),
    )


Poses = Mapping[str, Mapping[int, Float64]]
"""``T_camera_board`` (4, 4) by camera name and group of simultaneous views."""


def motion_between(a: Mapping[int, Float64], b: Mapping[int, Float64], corners_m: Float64) -> tuple[Float64, float]:
    """Return the extrinsics ``T_a_b`` of two cameras from the shared view that fits the others best (least median).

    A board that is small in the image may be mistaken for its mirror image in depth; the median over the views ignores
    a minority of such errors.

    Args:
        a, b: ``T_camera_board`` (4, 4) of each camera by group of simultaneous views; at least one group is shared.
        corners_m: (corners, 3) in the board's frame [m].

    Returns:
        ``T_a_b`` (4, 4), and the median over views of the largest distance between the corners from both cameras [m].
    """
    shared = sorted(set(a) & set(b))
    of_a, of_b = np.array([a[i] for i in shared]), np.array([b[i] for i in shared])
    seen_a, seen_b = apply(of_a, corners_m), apply(of_b, corners_m)
    tried = np.unique(np.linspace(0, len(shared) - 1, CANDIDATES).astype(int))
    candidates = of_a[tried] @ inverse(of_b[tried])
    off = [np.median(np.linalg.norm(apply(T, seen_b) - seen_a, axis=-1).max(axis=-1)) for T in candidates]
    best = int(np.argmin(off))
    return candidates[best], float(off[best])


def places(poses: Poses, corners_m: Float64) -> dict[str, Float64]:
    """Return the extrinsics ``T_camera_first`` (4, 4) by camera, chained along a spanning tree of most shared views.

    The first camera is the root.

    Args:
        poses: ``T_camera_board`` (4, 4) by camera name and group of simultaneous views.
        corners_m: (corners, 3) in the board's frame [m].

    Raises:
        CalibrationError: a camera shares no view with those connected to the first.
    """
    names = list(poses)
    shared = {(a, b): len(set(poses[a]) & set(poses[b])) for a, b in combinations(names, 2)}
    found = {names[0]: np.eye(4)}
    while len(found) < len(names):
        edges = [
            (count, a, b) if a in found else (count, b, a)
            for (a, b), count in shared.items()
            if (a in found) != (b in found) and count
        ]
        if not edges:
            lost = [name for name in names if name not in found]
            raise CalibrationError(
                f"{_cameras(lost)} never sees the board at the same instant as {_cameras(list(found))}: hold the board "
                "where both see it, and check that all videos begin together (or give --timestamps)"
            )
        _, a, b = max(edges, key=lambda edge: edge[0])
        T_b_a = motion_between(poses[b], poses[a], corners_m)[0]
        found[b] = T_b_a @ found[a]
    return found


def _cameras(names: Sequence[str]) -> str:
    return f"camera {names[0]}" if len(names) == 1 else f"cameras {', '.join(names)}: none"


def board_poses(
    poses: Poses, T_camera_first: Mapping[str, Float64], corners_m: Float64, instants: Sequence[int]
) -> Float64:
    """Return ``T_first_board`` (instants, 4, 4): of each group's views, the pose nearest to the others.

    Args:
        poses: ``T_camera_board`` (4, 4) by camera name and group of simultaneous views.
        T_camera_first: (4, 4) of each camera, of `places`.
        corners_m: (corners, 3) in the board's frame [m].
        instants: the groups of simultaneous views.
    """
    out = np.empty((len(instants), 4, 4))
    for k, instant in enumerate(instants):
        candidates = np.array(
            [inverse(T_camera_first[name]) @ of[instant] for name, of in poses.items() if instant in of]
        )
        seen = apply(candidates, corners_m)
        off = np.linalg.norm(seen[:, None] - seen[None], axis=-1).mean(axis=-1)
        out[k] = candidates[off.sum(axis=1).argmin()]
    return out


def joint_start(
    views: Sequence[BoardView],
    instant_of: Mapping[tuple[str, int], int],
    single: Mapping[str, OneCamera],
    board: Board,
) -> tuple[Bundle, Corners, list[int]]:
    """Return initial values of the bundle adjustment, in the first camera's frame.

    Args:
        views: `usable` views of all cameras, each camera's in the order that `one_camera` got them.
        instant_of: group of simultaneous frames, by camera and frame number.
        single: each camera from its own views; the first one's frame is the world.
        board: the calibration board.

    Returns:
        Cameras and board poses, the corners, and the group of simultaneous frames of each board pose.

    Raises:
        CalibrationError: as `places`.
    """
    names = list(single)
    seen: dict[str, int] = dict.fromkeys(names, 0)
    poses: dict[str, dict[int, Float64]] = {name: {} for name in names}
    for view in views:
        poses[view.camera][instant_of[view.camera, view.frame]] = single[view.camera].T_camera_board[seen[view.camera]]
        seen[view.camera] += 1
    T_camera_first = places(poses, board.corners_m)
    instants = sorted({instant for of in poses.values() for instant in of})
    at = {instant: k for k, instant in enumerate(instants)}
    corners = stacked(
        [(names.index(view.camera), at[instant_of[view.camera, view.frame]], view) for view in views], board
    )
    bundle = Bundle(
        np.array([T_camera_first[name] for name in names]),
        np.array([single[name].lens for name in names]),
        board_poses(poses, T_camera_first, board.corners_m, instants),
    )
    return bundle, corners, instants
