"""Check whether the silhouettes of two cameras can belong to one object: whether their visual cones meet.

The rays through a silhouette's pixels fill a cone. Planes through both cameras cut both cones, and if an object is
entirely visible to both, the first and the last plane that touch it are the same for both (R. Cipolla, K. Åström,
P. Giblin, "Motion from the frontier of curved surfaces", ICCV 1995). So each silhouette covers an interval of angles
about the line through the cameras. If the intervals differ, a camera is not at its calibrated pose, its video is
another camera's, or the segmentation is not one object.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry import lens as lenses
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.silhouettes import Silhouette

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

MEET_FROM: Final = 0.6
"""Least overlap of the two intervals of an object that is entirely visible to both cameras."""
_FEWEST: Final = 30
"""Fewest samples of a silhouette."""


class Meeting(msgspec.Struct, frozen=True):
    """Comparison of two cameras' silhouettes.

    Attributes:
        cameras: their names.
        overlap: intersection over union of the intervals of angles about the line through both cameras; NaN if
            undefined, for example if one camera sees the other behind the body, or only part of the body.
    """

    cameras: tuple[str, str]
    overlap: float


def meetings(silhouettes: Mapping[str, Silhouette], rig: CameraRig) -> list[Meeting]:
    """Compare every pair of cameras that have a silhouette.

    Args:
        silhouettes: silhouettes of one time, by camera.
        rig: the calibrated cameras, including all of these.
    """
    rays = {name: _rays(silhouette, rig.cameras[name]) for name, silhouette in silhouettes.items()}
    centres = {name: inverse(rig.cameras[name].T_camera_world)[:3, 3] for name in silhouettes}
    found = []
    for a, b in combinations(silhouettes, 2):
        ra, rb = rays[a], rays[b]
        overlap = float("nan") if ra is None or rb is None else _overlap(ra, rb, centres[b] - centres[a])
        found.append(Meeting((a, b), overlap))
    return found


def disagreements(found: list[Meeting], least: float = MEET_FROM) -> list[str]:
    """Describe, in one line, the pairs of cameras whose silhouettes overlap less than ``least``, and the likely cause.

    Undefined overlaps (NaN) do not count. The list is empty if no pair contradicts.
    """
    bad = [one for one in found if one.overlap < least]
    if not bad:
        return []
    pairs = ", ".join(f"{a} and {b} ({one.overlap:.0%})" for one in bad for a, b in [one.cameras])
    compared = {name for one in found if np.isfinite(one.overlap) for name in one.cameras}
    # If all other cameras agree, the one in contradiction with all is wrong.
    alone = [
        name for name in sorted(compared)
        if all(name in one.cameras for one in bad)
        and all(one.overlap < least for one in found if name in one.cameras and np.isfinite(one.overlap))
    ]  # fmt: skip
    cause = f": {alone[0]} stands elsewhere, or its video is another camera's" if len(alone) == 1 else (
        ": are the videos of these cameras, in this order, and is the rig theirs?"
    )  # fmt: skip
    return [f"the silhouettes of {pairs} do not meet in space as those of one body would{cause}"]


def _rays(silhouette: Silhouette, placed: PlacedCamera) -> Float64 | None:
    """Return directions (n, 3) of the outline's samples in the world; None if it is too small or cut off."""
    inside = silhouette.phi > 0
    if np.count_nonzero(inside) < _FEWEST:
        return None
    rows, columns = np.nonzero(inside & ~_eroded(inside))
    pixels = np.stack([columns, rows], axis=-1) * silhouette.step_px + np.array(silhouette.origin_px, np.float64)
    edge, (width, height) = 2.0 * silhouette.step_px, placed.camera.size_px
    if (pixels < edge).any() or (pixels[:, 0] > width - 1 - edge).any() or (pixels[:, 1] > height - 1 - edge).any():
        return None
    normalised = lenses.undistort(pixels, placed.camera.lens)
    directions = np.concatenate([normalised, np.ones((len(normalised), 1))], axis=1)
    return np.asarray(directions @ placed.T_camera_world[:3, :3])


def _eroded(inside: Bool) -> Bool:
    padded = np.pad(inside, 1)
    inner = padded[1:-1, :-2] & padded[1:-1, 2:] & padded[:-2, 1:-1] & padded[2:, 1:-1]
    return np.asarray(inner)


def _overlap(a: Float64, b: Float64, baseline: Float64) -> float:
    """Return the intersection over union of the intervals of angles about the baseline (3,)."""
    length = np.linalg.norm(baseline)
    if length < 1e-6:
        return float("nan")
    axis = baseline / length
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    of_a, of_b = _span(a, u, v), _span(b, u, v)
    if of_a is None or of_b is None:
        return float("nan")
    (middle_a, low_a, high_a), (middle_b, low_b, high_b) = of_a, of_b
    between = float(_wrapped(middle_b - middle_a))
    low_b, high_b = low_b + between, high_b + between
    both = max(0.0, min(high_a, high_b) - max(low_a, low_b))
    return both / max(max(high_a, high_b) - min(low_a, low_b), 1e-12)


def _span(rays: Float64, u: Float64, v: Float64) -> tuple[float, float, float] | None:
    """Return the angle of the centre, and the extent to both sides; None if the rays are all around."""
    mean = rays.mean(axis=0)
    middle = float(np.arctan2(mean @ v, mean @ u))
    off = _wrapped(np.arctan2(rays @ v, rays @ u) - middle)
    low, high = float(np.min(off)), float(np.max(off))
    return None if high - low > 0.9 * np.pi else (middle, low, high)


def _wrapped(angle: Any) -> Any:
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi
