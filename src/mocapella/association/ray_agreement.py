"""How far the rays of two cameras to one person are from crossing.

The rays of one person in two cameras lie joint by joint in a plane with the line between the cameras (the epipolar
constraint: R. Hartley, A. Zisserman, *Multiple View Geometry in Computer Vision*, 2nd ed., 2004, section 9.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import PlacedCamera
from mocapella.model.keypoints import KeypointFrame

Float64 = NDArray[np.float64]

CONFIDENT: Final = 0.3
"""Keypoints with a higher confidence are used."""
INSTANTS: Final = 12
"""Number of instants that are compared."""
SHARED: Final = 5
"""Least number of keypoints that two detections share."""
AGREES: Final = 0.2
"""Largest angle between two cameras' rays where the rig is right, as part of the spread of the person's rays."""


def shared_instants(frames: Mapping[str, Sequence[KeypointFrame]]) -> list[dict[str, KeypointFrame]]:
    """Return frames with people, by camera, of at most `INSTANTS` instants that two cameras or more see."""
    at: dict[int, dict[str, KeypointFrame]] = {}
    for name, some in frames.items():
        for one in some:
            if one.bodies:
                at.setdefault(one.sequence, {})[name] = one
    several = [seen for _, seen in sorted(at.items()) if len(seen) > 1]
    return several[:: max(1, -(-len(several) // INSTANTS))]


def apart(some: Float64, others: Float64, between: Float64) -> Float64:
    """Return how far people's rays in two cameras are from crossing (…, detections, others) [rad]; infinite if unknown.

    Args:
        some: (…, detections, keypoints, 3) directions of one camera, world.
        others: (…, others, keypoints, 3) of the other camera.
        between: (3,) from the one camera's centre to the other's [m].
    """
    normals = np.cross(some, between)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    angles = np.sort(np.abs(np.einsum("...ijk,...ljk->...ilj", normals, others)), axis=-1)  # NaN last
    count = np.isfinite(angles).sum(axis=-1)
    last = np.maximum(count - 1, 0)[..., None]
    middle = np.take_along_axis(angles, np.concatenate([last // 2, (last + 1) // 2], axis=-1), axis=-1).mean(axis=-1)
    return np.asarray(np.where(count >= SHARED, middle, np.inf))


def disagreement(
    instants: Sequence[Mapping[str, KeypointFrame]],
    cameras: Mapping[str, PlacedCamera],
    *,
    scale: float = 1.0,
    only: str | None = None,
) -> float:
    """Return the median angle of people's rays out of the planes of another camera's rays; NaN without pairs.

    Angles are parts of the spread of the person's rays, which a scale changes, too. Of the detections in the other
    image, the best one counts.

    Args:
        instants: frames by the camera's name.
        cameras: the cameras.
        scale: factor of the keypoints.
        only: name of a camera that each pair has; None for all pairs.
    """
    found: list[float] = []
    for seen in instants:
        rays = {name: rays_of(frame, cameras[name], scale) for name, frame in seen.items()}
        for one, other in combinations(rays, 2):
            (o, some), (p, others) = rays[one], rays[other]
            if only in (None, one, other) and some.shape[1] == others.shape[1]:  # of one topology
                best = apart(some, others, p - o).min(axis=1) / np.maximum(spread_of(some), 1e-9)
                found += best[np.isfinite(best)].tolist()
    return float(np.median(found)) if found else float("nan")


def spread_of(rays: Float64) -> Float64:
    """Return the standard deviation (detections,) of each detection's directions (detections, keypoints, 3) [rad]."""
    known: Any = np.isfinite(rays).all(axis=-1)
    count = np.maximum(known.sum(axis=-1), 1)[:, None]
    mean = np.where(known[..., None], rays, 0.0).sum(axis=1) / count
    off = np.where(known[..., None], rays - mean[:, None], 0.0)
    spread: Float64 = np.sqrt((off**2).sum(axis=(1, 2)) / count[:, 0])
    return spread


def rays_of(frame: KeypointFrame, placed: PlacedCamera, scale: float = 1.0) -> tuple[Float64, Any]:
    """Return a camera's centre (3,) and the directions (detections, keypoints, 3) of its keypoints, NaN if not sure."""
    sure = (frame.confidences > CONFIDENT)[..., None]
    return cast(np.where(sure, scale * np.asarray(frame.positions_px, np.float64), np.nan), placed)


def cast(pixels: Float64, placed: PlacedCamera) -> tuple[Float64, Any]:
    """Return a camera's centre (3,) and the unit directions (…, 3) of pixels (…, 2), world; NaN for NaN."""
    flat = undistort(pixels, placed.camera.lens)
    directions = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    T_world_camera = inverse(placed.T_camera_world)
    return T_world_camera[:3, 3], directions @ T_world_camera[:3, :3].T
