"""Re-acquire a lost body from foreground masks.

The centres of the foreground in two or more cameras are triangulated. The body is placed there in its last posture, in
several rotations about its own axis, and moved while its overlap with the foreground increases; if that stays
small, the same is tried in other postures that it had.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.plucker import camera_rays, residual
from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y, rotation_about_z
from mocapella.kinematics.silhouette_fit import Eye, Outline, see
from mocapella.model.silhouettes import Silhouette, overlap
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.silhouette_body import SilhouetteBody

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

STEP_PX: Final = 8
"""Sampling step; coarse, because the result is only the tracker's initial pose."""
FEWEST: Final = 8
"""Fewest samples of a foreground object."""
MEETING_M: Final = 0.4
"""Largest distance of a line of sight from the object's centre [m]; some cameras see only a part of the object."""
COVERED: Final = 0.45
"""Least overlap of body and foreground, as a mean over cameras; below, the object is something else."""
WELL_COVERED: Final = 0.75
"""Least overlap for trying no further posture."""
TURNS_RAD: Final = tuple(np.radians(range(45, 360, 45)).tolist())
"""Rotations that are tried, about the body's own axis, relative to its last orientation."""
TILTS: Final = np.radians([(90, 0), (180, 0), (270, 0), (0, 90), (0, 270), (135, 0), (225, 0), (0, 135), (0, 225)])
"""Rotations about the body's own x and z axes that are tried, for bodies that are any way up."""
ALIKE: Final = 0.08
"""Difference in overlap below which front and back views are not told apart."""
STEPS: Final = ((0.2, 0.3), (0.1, 0.15), (0.05, 0.08))
"""Step sizes of the search for the position [m], and for the rotation about the body's own axis [rad]."""
BETTER_TURNED: Final = 0.02
"""Gain in overlap that a rotation needs, because front and back views of bodies hardly differ."""
BETTER_PLACED: Final = 0.1
"""Gain in overlap that a pose needs over a likelier one: a later posture, or another pose than a doubted body's."""


def reacquire(
    seen: Mapping[str, Silhouette], body: SilhouetteBody, before: Sequence[TreePose], eyes: Mapping[str, Eye],
    doubted: TreePose | None = None, *, any_way_up: bool = False,
) -> TreePose | None:  # fmt: skip
    """Return one of the poses ``before``, moved and rotated to the foreground, to restart tracking there.

    None is returned if no two cameras see one object, or if every posture's overlap with it is below `COVERED`. The
    overlap is the intersection over union of body and foreground, as a mean over the cameras that see the object.

    Args:
        seen: foreground relative to the empty room, by camera.
        body: the lost body.
        before: poses whose postures are tried in this order; a later one is taken only if its overlap is larger by
            `BETTER_PLACED`, because the earlier ones are likelier. Not changed. The body is rotated only about
            its own long axis, so that its inclination stays that of the pose.
        eyes: the cameras of ``seen``, by name.
        any_way_up: whether the first posture is also tried upside down and lying, where none covers the foreground
            well.
        doubted: pose of a body that is not lost, but may be wrong; only a pose whose overlap is larger than this one's
            by `BETTER_PLACED` is returned. None for a lost body.
    """
    masks = {name: _coarse(one, eyes[name].size_px) for name, one in seen.items()}
    masks = {name: mask for name, mask in masks.items() if np.count_nonzero(mask) >= FEWEST}
    met = _met({name: _middle_line(mask, eyes[name]) for name, mask in masks.items()})
    if met is None:
        return None
    point, names = met
    shown = [(eyes[name], masks[name]) for name in names]
    least = COVERED if doubted is None else max(COVERED, _covers(body, doubted, shown) + BETTER_PLACED)
    best: TreePose | None = None
    for one in before:
        pose, most = _nearer(body, _moved(one, point - body.standing(one).vertices.mean(axis=0)), shown)
        turned = [_turned(pose, by) for by in TURNS_RAD]
        values = [_covers(body, other, shown) for other in turned]
        if max(values) > most + BETTER_TURNED:
            pose, most = _nearer(body, turned[int(np.argmax(values))], shown)
        if most >= least:
            best, least = pose, most + BETTER_PLACED
        if best is not None and most >= WELL_COVERED:
            break
    if any_way_up and before and least < WELL_COVERED:
        there = _moved(before[0], point - body.standing(before[0]).vertices.mean(axis=0))
        tilted, most = _tilted_best(body, there, shown)
        if most >= (least if best is None else least - BETTER_PLACED + BETTER_TURNED):
            best = tilted
    return best


def _tilted_best(body: SilhouetteBody, pose: TreePose, shown: Sequence[tuple[Eye, Bool]]) -> tuple[TreePose, float]:
    """Return the pose's best rotation, any way up, moved and turned to its largest overlap.

    Of front and back, which are alike in outlines, it faces more like the pose.
    """
    middle = body.standing(pose).vertices.mean(axis=0)
    tried = [_turned(_tilted(pose, tilt, middle), by) for tilt in TILTS for by in (0.0, *TURNS_RAD)]
    values = [_covers(body, one, shown) for one in tried]
    best, most = _nearer(body, tried[int(np.argmax(values))], shown, tilting=True)
    other, value = _nearer(body, _turned(best, np.pi), shown, tilting=True)
    faced = pose.T_world_model[:3, 2]
    if value >= most - ALIKE and other.T_world_model[:3, 2] @ faced > best.T_world_model[:3, 2] @ faced:
        return other, most  # the fit brings it nearer
    return best, most


def _nearer(
    body: SilhouetteBody, pose: TreePose, shown: Sequence[tuple[Eye, Bool]], *, tilting: bool = False
) -> tuple[TreePose, float]:
    """Return the pose moved and turned to its largest overlap, with ``tilting`` about all axes, and that overlap."""
    axes = 6 if tilting else 4
    most = _covers(body, pose, shown)
    for step_m, step_rad in STEPS:
        for change in (*np.eye(6)[:axes], *-np.eye(6)[:axes]):
            tried = _turned(_moved(pose, step_m * change[:3]), step_rad * change[3])
            if tilting:
                middle = body.standing(tried).vertices.mean(axis=0)
                tried = _tilted(tried, step_rad * change[4:], middle)
            if (value := _covers(body, tried, shown)) > most:
                pose, most = tried, value
    return pose, most


def _covers(body: SilhouetteBody, pose: TreePose, shown: Sequence[tuple[Eye, Bool]]) -> float:
    """Return the intersection over union of body and foreground, the mean over the cameras."""
    shares, vertices = [], body.standing(pose).vertices
    for by, mask in shown:
        outline = see(body.figure, vertices, by, step_px=STEP_PX, margin_px=0, spacing_px=STEP_PX)
        shares.append(0.0 if outline is None else overlap(_on_grid(outline, mask.shape), mask))
    return float(np.mean(shares))


def _moved(pose: TreePose, by_m: Float64) -> TreePose:
    T = pose.T_world_model.copy()
    T[:3, 3] += by_m
    return TreePose(T, pose.angles)


def _turned(pose: TreePose, by_rad: float) -> TreePose:
    return TreePose(pose.T_world_model @ rigid(rotation_about_y(by_rad), np.zeros(3)), pose.angles)


def _tilted(pose: TreePose, by_rad: Float64, about: Float64) -> TreePose:
    """Return the pose rotated about its own x and z axes through a point (3,) of the world.

    ``by_rad`` (2,) are the angles [rad].
    """
    T = pose.T_world_model.copy()
    R = T[:3, :3] @ rotation_about_x(float(by_rad[0])) @ rotation_about_z(float(by_rad[1])) @ T[:3, :3].T
    T[:3, :3], T[:3, 3] = R @ T[:3, :3], about + R @ (T[:3, 3] - about)
    return TreePose(T, pose.angles)


def _met(lines: Mapping[str, Float64]) -> tuple[Float64, Sequence[str]] | None:
    """Return the point (3,) that most lines of sight pass near, and their cameras; None if no two meet."""
    best: tuple[Float64, Sequence[str]] | None = None
    for pair in combinations(lines, 2):
        point = _nearest([lines[name] for name in pair])
        near = [name for name, line in lines.items() if np.linalg.norm(residual(point, line)) <= MEETING_M]
        if set(pair) <= set(near) and (best is None or len(near) > len(best[1])):
            best = _nearest([lines[name] for name in near]), near
    return best


def _nearest(lines: Sequence[Float64]) -> Float64:
    """Return the point (3,) nearest to lines (6,) in the sum of squares; nearest to the origin if they are parallel."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for line in lines:
        A, b = A + np.eye(3) - np.outer(line[:3], line[:3]), b + np.cross(line[:3], line[3:])
    return np.asarray(np.linalg.lstsq(A, b, rcond=1e-9)[0])


def _middle_line(mask: Bool, by: Eye) -> Float64:
    """Return the line of sight (6,) of a coarse mask's centre."""
    pixels = STEP_PX * np.argwhere(mask).mean(axis=0)[::-1]
    return camera_rays(pixels, by.lens, by.T_camera_world)


def _on_grid(outline: Outline, shape: tuple[int, ...]) -> Bool:
    """Return the samples (rows, columns) of the grid that an outline covers; its window is aligned with the grid."""
    x, y = (at // STEP_PX for at in outline.origin_px)
    left, top = max(x, 0), max(y, 0)
    part, out = outline.mask[top - y :, left - x :], np.zeros(shape, np.bool_)
    part = part[: shape[0] - top, : shape[1] - left]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


def _coarse(silhouette: Silhouette, size_px: tuple[int, int]) -> Bool:
    """Return the mask (rows, columns) of a silhouette in the image, sampled every `STEP_PX` px."""
    return silhouette.mask(size_px)[::STEP_PX, ::STEP_PX]
