"""How far the rays of two cameras to one person are from crossing.

The rays of one person in two cameras lie joint by joint in a plane with the line between the cameras (the epipolar
constraint: R. Hartley, A. Zisserman, *Multiple View Geometry in Computer Vision*, 2nd ed., 2004, section 9.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    """Return how far people's rays in two cameras are from crossing (detections, others) [rad]; infinite if unknown.

    Args:
        some: (detections, keypoints, 3) directions of one camera, world.
        others: (others, keypoints, 3) of the other camera.
        between: (3,) from the one camera's centre to the other's [m].
    """
    normals = np.cross(some, between)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    angles = np.abs(np.einsum("ijk,ljk->ilj", normals, others))  # detections, others, keypoints
    enough: Any = np.isfinite(angles).sum(axis=-1) >= SHARED
    medians = np.full(enough.shape, np.inf)
    medians[enough] = np.nanmedian(angles[enough], axis=-1)
    return medians


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
