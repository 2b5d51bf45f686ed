"""Compare the ends of the hand's branches with the fingertips of a fit: each end of a narrow branch is some fingertip.

The branches are those of `mocapella.sensing.arm_region.PalmCandidate`: of geodesic distances along the surface, as in
C. Plagemann, V. Ganapathi, D. Koller, S. Thrun, "Real-time identification and localization of body parts from depth
images" (ICRA 2010), section III: extremities of a surface are candidates for the ends of limbs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.arm_fit import ArmModel, ArmPose
from mocapella.sensing.arm_region import ArmRegionSettings, Grid, grid_about, kernels

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

EXPLAINED_M: Final = 0.015
"""Distance from a fingertip below which it explains the end of a branch [m]: less than the width of a finger, and more
than a branch ends before or behind the true tip in most images before a Kinect."""


def branch_ends(depth: Float32, lens: Float64, palm: Float64, s: ArmRegionSettings) -> Float64:
    """Return (k, 3) the ends of branches as narrow as a finger of the surface around a palm, camera frame [m].

    Distances along the surface start at its point nearest to the palm. Surfaces not connected to it have no branches,
    nor has an image without a surface within `_ON_PALM_M` of the palm.

    Args:
        depth: (height, width) [m].
        lens: (4,) fx, fy, cx, cy of the image [px], or (9,) with the distortion, which is not used.
        palm: (3,) the palm's middle, camera frame [m].
        s: width of fingers, length of branches, and jump in depth between surfaces.
    """
    k, grid = kernels(), grid_about(depth, lens, np.array([[*palm, _FARTHEST_M - s.grow_m, 1.0]]), s)
    if grid is None:
        return np.empty((0, 3))
    ys, xs = np.nonzero(grid.seen > 0)
    off_m = np.linalg.norm(_unprojected(grid, ys, xs) - palm, axis=1)
    if off_m.min(initial=np.inf) > _ON_PALM_M:
        return np.empty((0, 3))
    at = int(np.argmin(off_m))
    away, found = np.empty(grid.seen.shape), np.empty((_MOST, 8))
    k.geodesic(grid.seen, grid.lens, s.jump, int(ys[at]), int(xs[at]), _FARTHEST_M, away)
    found = found[: k.branches(grid.seen, away, grid.lens, s.jump, s.branch_m, found)]
    long, own, wide, cut = found[:, 2], found[:, 3], found[:, 4], found[:, 7] > 0
    finger = (wide <= s.finger_m) & (own > _OWN_M) & (long > _NEAREST_M) & (long < _FARTHEST_M - s.branch_m) & ~cut
    return _unprojected(grid, *found[finger, :2].T.astype(np.int64))


def _unprojected(grid: Grid, ys: Int64, xs: Int64) -> Float64:
    """Return (n, 3) points of a grid's pixels, camera frame [m]."""
    z, (fx, fy, cx, cy) = grid.seen[ys, xs], grid.lens
    return np.asarray(np.stack([(xs - cx) * z / fx, (ys - cy) * z / fy, z], axis=-1))


def unexplained(ends: Float64, tips: Float64) -> Float64:
    """Return (j, 3) the ends of branches that no fingertip explains, the farthest from any fingertip first.

    Args:
        ends: (k, 3) ends of branches as narrow as a finger, on the surface, camera frame [m].
        tips: (5, 3) fingertips of a fit, camera frame [m].
    """
    apart = np.linalg.norm(ends[:, None] - tips[None], axis=2).min(axis=1, initial=np.inf)
    order = np.argsort(-apart, kind="stable")
    return np.asarray(ends[order[apart[order] > EXPLAINED_M]])


def missed(ends: Float64, tips: Float64) -> float:
    """Return how badly fingertips explain ends of branches: 0 if all are at tips, up to their number if none is.

    Each end adds d² / (d² + `EXPLAINED_M`²), the robust loss of S. Geman, D. McClure ("Statistical methods for
    tomographic image reconstruction", Bull. ISI 52, 1987), of its distance d from the nearest tip.

    Args:
        ends, tips: as for `unexplained`.
    """
    apart = np.linalg.norm(ends[:, None] - tips[None], axis=2).min(axis=1, initial=np.inf)
    return float((1.0 / (1.0 + (EXPLAINED_M / np.maximum(apart, 1e-6)) ** 2)).sum())


def reached(ends: Float64, tips: Float64, within_m: float = EXPLAINED_M) -> Float64:
    """Return (5, 3) the end of a branch that each fingertip is at, NaN for none: nearest to each other, and near.

    Args:
        ends, tips: as for `unexplained`.
        within_m: greatest distance between both [m].
    """
    out = np.full((5, 3), np.nan)
    if len(ends):
        apart = np.linalg.norm(ends[:, None] - tips[None], axis=2)
        for digit, end in enumerate(apart.argmin(axis=0)):
            if apart[end].argmin() == digit and apart[end, digit] <= within_m:
                out[digit] = ends[end]
    return out


def shown_ends(depth: Float32, lens: Float64, bones: Float64) -> Float64:
    """Return (5, 3) where fingertips end in front of a surface farther away, camera frame [m]; NaN for the others.

    From the end of a tip's flesh back along its bone, the first place whose surface is measured is the end. It is none
    if it is the tip's own end, if nothing is measured within `_SHORTER_M`, or if a nearer surface hides the tip.

    Args:
        depth: (height, width) [m].
        lens: (4,) fx, fy, cx, cy of the image [px], or (9,) with the distortion, which is not used.
        bones: (5, 8) of `ArmModel.last_bones`.
    """
    begin, end, (ra, rb) = bones[:, :3], bones[:, 3:6], bones[:, 6:].T
    long = np.linalg.norm(end - begin, axis=1)
    along = (end - begin) / long[:, None]
    back = np.arange(0.0, _SHORTER_M, _STEP_M)
    at = long[:, None] + rb[:, None] - back  # (5, steps) from the bone's begin
    beyond = np.clip(at - long[:, None], 0.0, None)
    radius = rb[:, None] + (ra - rb)[:, None] * np.clip(1.0 - at / long[:, None], 0.0, 1.0)
    radius = np.sqrt(np.clip(radius**2 - beyond**2, 0.0, None))
    points = begin[:, None] + at[..., None] * along[:, None]
    fx, fy, cx, cy = lens[:4]
    z = np.maximum(points[..., 2], _NEAREST_Z_M)
    columns, lines = (np.rint(points[..., k] / z * f + c).astype(np.int64) for k, f, c in ((0, fx, cx), (1, fy, cy)))
    height, width = depth.shape
    inside = (columns >= 0) & (columns < width) & (lines >= 0) & (lines < height)
    seen = np.where(inside, depth[lines.clip(0, height - 1), columns.clip(0, width - 1)], 0.0)
    behind = seen - (z - radius)
    shown = inside & (seen > 0) & (np.abs(behind) < _SHOWN_M)
    first = shown.argmax(axis=1)
    hidden = (seen > 0) & (behind < -_SHOWN_M)
    digits = np.arange(5)
    apart = (seen > 0) & (behind > _SHOWN_M) & (np.arange(len(back)) < first[:, None])
    ended = shown[digits, first] & (back[first] > _OWN_END_M) & apart.any(axis=1)
    ended &= ~(hidden & (np.arange(len(back)) < first[:, None])).any(axis=1)
    return np.asarray(np.where(ended[:, None], points[digits, first], np.nan))


def reaching(model: ArmModel, pose: ArmPose, end: Float64) -> Iterator[tuple[ArmPose, Float64]]:
    """Yield starts of fits with one digit at the end of a branch, for each digit that can.

    A digit can if its tip is within `REACHED_M` of the end in one of `ArmModel.ways`. It starts in the nearest one.

    Args:
        model: the arm.
        pose: its pose; only the digit's angles change.
        end: (3,) the branch's end, camera frame [m].

    Yields:
        The start, and targets of the fingertips (5, 3), NaN but for the digit's, as `ArmModel.fit` takes them.
    """
    there = pose.R.reshape(3, 3).T @ (end - pose.t)
    for digit, columns in enumerate(model.columns):
        free = columns >= 0
        starts = []
        for way in model.ways[digit][1:]:
            start = pose._replace(z=pose.z.copy())
            start.z[columns[free]] = way[free]
            starts.append(start)
        off_m = [float(np.linalg.norm(model.pieces(start)[1][digit, 3] - there)) for start in starts]
        nearest = int(np.argmin(off_m))
        if off_m[nearest] < REACHED_M:
            targets = np.full((5, 3), np.nan)
            targets[digit] = end
            yield starts[nearest], targets


REACHED_M: Final = 0.03
"""Distance from the end of a branch within which a digit's nearest posture must have its tip [m]."""
_SHORTER_M: Final = 0.024
"""Greatest length of a fingertip's flesh that is not measured, in front of another surface [m]."""
_STEP_M: Final = 0.001
_SHOWN_M: Final = 0.012
"""Greatest distance between the flesh's surface and the measured one [m]."""
_OWN_END_M: Final = 0.003
_NEAREST_Z_M: Final = 0.05
_MOST: Final = 24
"""Most branches of a surface."""
_FARTHEST_M: Final = 0.19
_NEAREST_M: Final = 0.05
"""Range of a fingertip's distance from the middle of the palm along the surface [m]."""
_ON_PALM_M: Final = 0.04
"""Greatest distance of the surface from the middle of the palm, whose flesh is 12 mm thick [m]."""
_OWN_M: Final = 0.02
"""Least length of a finger that is a branch of its own [m]."""
