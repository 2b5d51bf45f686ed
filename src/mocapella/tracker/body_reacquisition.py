"""Where somebody who is looked for is, of whom only what is not in the empty room is known.

The middles of what two or more cameras see are triangulated; the body is set there as it stood before, turned about
itself in several ways, and moved as long as it covers more of what the cameras see.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.plucker import camera_rays, residual
from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.kinematics.silhouette_fit import Eye, Outline, see
from mocapella.model.silhouettes import Silhouette, overlap
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.silhouette_body import SilhouetteBody

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

STEP_PX: Final = 8
"""Coarse samples do: what is found is where a tracker begins."""
FEWEST: Final = 8
"""A thing of fewer samples is none."""
MEETING_M: Final = 0.4
"""Cameras see one thing if its middles' lines of sight are so near to each other [m]: some see only a part of it."""
COVERED: Final = 0.45
"""Share of what is covered or seen, in the mean of the cameras, that is both; below, it is something else."""
TURNS_RAD: Final = tuple(np.radians(range(45, 360, 45)).tolist())
"""About the body's own axis, of the way it stood."""
STEPS_M: Final = (0.2, 0.1, 0.05)
"""By which the body is moved [m]."""
BETTER_TURNED: Final = 0.02
"""A turn has to be worth so much more: from before and from behind bodies are hardly different."""


def reacquire(
    seen: Mapping[str, Silhouette], body: SilhouetteBody, before: TreePose, eyes: Mapping[str, Eye]
) -> TreePose | None:
    """The pose ``before``, moved and turned to where cameras see something; None where no two see one body.

    Args:
        seen: what is not in the empty room, by camera.
        body: who is looked for.
        before: how it stood last, upright.
        eyes: of the cameras.
    """
    masks = {name: _coarse(one, eyes[name].size_px) for name, one in seen.items()}
    masks = {name: mask for name, mask in masks.items() if np.count_nonzero(mask) >= FEWEST}
    met = _met({name: _middle_line(mask, eyes[name]) for name, mask in masks.items()})
    if met is None:
        return None
    point, names = met
    shown = [(eyes[name], masks[name]) for name in names]
    pose, most = _nearer(body, _moved(before, point - body.standing(before).vertices.mean(axis=0)), shown)
    turned = [TreePose(pose.T_world_model @ rigid(rotation_about_y(by), np.zeros(3)), pose.angles) for by in TURNS_RAD]
    values = [_covers(body, one, shown) for one in turned]
    if max(values) > most + BETTER_TURNED:
        pose, most = _nearer(body, turned[int(np.argmax(values))], shown)
    return pose if most >= COVERED else None


def _nearer(body: SilhouetteBody, pose: TreePose, shown: Sequence[tuple[Eye, Bool]]) -> tuple[TreePose, float]:
    """The pose moved to where it covers most, and how much that is."""
    most = _covers(body, pose, shown)
    for step_m in STEPS_M:
        for way in (*np.eye(3), *-np.eye(3)):
            tried = _moved(pose, step_m * way)
            if (value := _covers(body, tried, shown)) > most:
                pose, most = tried, value
    return pose, most


def _covers(body: SilhouetteBody, pose: TreePose, shown: Sequence[tuple[Eye, Bool]]) -> float:
    """Intersection over union of the body and what is seen, the mean of the cameras."""
    shares, vertices = [], body.standing(pose).vertices
    for by, mask in shown:
        outline = see(body.figure, vertices, by, step_px=STEP_PX, margin_px=0, spacing_px=STEP_PX)
        shares.append(0.0 if outline is None else overlap(_on_grid(outline, mask.shape), mask))
    return float(np.mean(shares))


def _moved(pose: TreePose, by_m: Float64) -> TreePose:
    T = pose.T_world_model.copy()
    T[:3, 3] += by_m
    return TreePose(T, pose.angles)


def _met(lines: Mapping[str, Float64]) -> tuple[Float64, Sequence[str]] | None:
    """The point (3,) that most lines of sight are near to, and whose these are; None where no two meet."""
    best: tuple[Float64, Sequence[str]] | None = None
    for pair in combinations(lines, 2):
        point = _nearest([lines[name] for name in pair])
        near = [name for name, line in lines.items() if np.linalg.norm(residual(point, line)) <= MEETING_M]
        if set(pair) <= set(near) and (best is None or len(near) > len(best[1])):
            best = _nearest([lines[name] for name in near]), near
    return best


def _nearest(lines: Sequence[Float64]) -> Float64:
    """The point (3,) nearest to lines (6,), in the sum of squares; of parallel ones, the one nearest to the origin."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for line in lines:
        A, b = A + np.eye(3) - np.outer(line[:3], line[:3]), b + np.cross(line[:3], line[3:])
    return np.asarray(np.linalg.lstsq(A, b, rcond=1e-9)[0])


def _middle_line(mask: Bool, by: Eye) -> Float64:
    """(6,) the line of sight of the middle of a coarse mask."""
    pixels = STEP_PX * np.argwhere(mask).mean(axis=0)[::-1]
    return camera_rays(pixels, by.lens, by.T_camera_world)


def _on_grid(outline: Outline, shape: tuple[int, ...]) -> Bool:
    """(rows, columns) what an outline covers, of whose window a sample is one of the grid's."""
    x, y = (at // STEP_PX for at in outline.origin_px)
    left, top = max(x, 0), max(y, 0)
    part, out = outline.mask[top - y :, left - x :], np.zeros(shape, np.bool_)
    part = part[: shape[0] - top, : shape[1] - left]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


def _coarse(silhouette: Silhouette, size_px: tuple[int, int]) -> Bool:
    """(rows, columns) every `STEP_PX` px of an image, what a silhouette covers."""
    return silhouette.mask(size_px)[::STEP_PX, ::STEP_PX]
