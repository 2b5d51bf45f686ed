"""Arms of capsules before a camera, with exact joints: small scenes of the line skeleton's tests.

A right hand whose palm faces the camera, its arm coming from below; the palm's middle lies on the optical axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.arms import ARM_JOINTS, ARM_POINTS
from mocapella.model.camera import Camera

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

CAMERA: Final = Camera("drawn", (640, 480), np.array([476.0, 476.0, 320.0, 240.0, 0, 0, 0, 0, 0]))
DISTANCE_M: Final = 0.8
ELBOW: Final = (0.0, -0.31, 0.0)
WRIST: Final = (0.0, -0.06, 0.0)
KNUCKLES: Final = ((0.03, 0.052, 0.0), (0.01, 0.06, 0.0), (-0.012, 0.055, 0.0), (-0.032, 0.044, 0.0))
PALM: Final = (0.005, 0.0, 0.0)
THUMB: Final = (0.028, -0.035, 0.0)
DEGREES: Final = (50.0, 10.0, 0.0, -9.0, -20.0)
LENGTHS: Final = (0.085, 0.075, 0.085, 0.078, 0.06)
RADII: Final = (0.01, 0.0085, 0.0085, 0.0085, 0.0075)


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """A depth image [m] and the truth (23, 3) in the camera's space; NaN of all but the eight joints."""

    depth: Float32
    truth: Float64


def arm(
    pose: str = "open", *, rotation_degrees: float = 0.0, behind_m: float = 0.0, camera: Camera = CAMERA
) -> DrawnArm:
    """An arm that is turned about the optical axis, clockwise as the camera sees it.

    Args:
        pose: ``open``; ``touching``: the ring finger beside the middle one, their tips level; ``before palm``: the
            index finger bent over the palm; ``fist``.
        rotation_degrees: 0 with the fingers upwards.
        behind_m: where a wall is; none at 0.
        camera: see there.
    """
    tips, capsules = [], [(ELBOW, WRIST, 0.03), ((0.0, -0.045, 0.0), WRIST, 0.026)]
    capsules += [(WRIST, knuckle, 0.014) for knuckle in (*KNUCKLES, THUMB)]
    capsules += [(KNUCKLES[k], KNUCKLES[k + 1], 0.013) for k in range(3)]
    capsules += [((0.02, 0.02, 0.0), (-0.02, 0.02, 0.0), 0.014), ((0.02, -0.01, 0.0), (-0.015, -0.01, 0.0), 0.014)]
    bases = (THUMB, *KNUCKLES)
    for k, (base, degrees, length, radius) in enumerate(zip(bases, DEGREES, LENGTHS, RADII, strict=True)):
        turn = math.radians(degrees)
        if pose == "touching" and k == 3:
            base, turn, length = (-0.007, 0.06, 0.0), 0.0, LENGTHS[2]  # noqa: PLW2901 - a finger's width beside
        if pose == "fist" or (pose == "before palm" and k == 1):
            out = (base[0], base[1], base[2] - 0.03)
            bend = (base[0] * 0.7, base[1] - 0.035, base[2] - 0.032)
            if k == 0:
                out, bend = (0.035, -0.005, -0.02), (0.005, 0.02, -0.045)
            capsules += [(base, out, radius), (out, bend, radius)]
            tips.append(bend)
        else:
            end = (base[0] + length * math.sin(turn), base[1] + length * math.cos(turn), base[2])
            capsules.append((base, end, radius))
            tips.append(end)
    c, s = math.cos(math.radians(rotation_degrees)), math.sin(math.radians(rotation_degrees))

    def placed(point: Any) -> Float64:
        u, v, z = point
        return np.array([c * u + s * v, s * u - c * v, z + DISTANCE_M])

    depth = drawn([(placed(a), placed(b), r) for a, b, r in capsules], camera)
    if behind_m:
        depth = np.where(depth > 0, depth, np.float32(behind_m))
    truth = np.full((len(ARM_POINTS), 3), np.nan)
    truth[list(ARM_JOINTS)] = [placed(point) for point in (ELBOW, WRIST, PALM, *tips)]
    return DrawnArm(depth, truth)


def drawn(capsules: list[tuple[Float64, Float64, float]], camera: Camera) -> Float32:
    """The depth of capsules (end, end, radius), by intersecting each with the pixels' rays; 0 beside them."""
    width, height = camera.size_px
    fx, fy, cx, cy = camera.lens[:4]
    out = np.full((height, width), np.inf)
    for a, b, radius in capsules:
        ends = np.stack([a, b])
        middle, reach = ends[:, :2] * [fx, fy] / ends[:, 2:] + [cx, cy], fx * radius / (ends[:, 2].min() - radius) + 3
        x0, y0 = np.clip(np.floor(middle.min(axis=0) - reach), 0, (width, height)).astype(int)
        x1, y1 = np.clip(np.ceil(middle.max(axis=0) + reach), 0, (width, height)).astype(int)
        x, y = np.meshgrid((np.arange(x0, x1) - cx) / fx, (np.arange(y0, y1) - cy) / fy)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1)
        out[y0:y1, x0:x1] = np.minimum(out[y0:y1, x0:x1], _distance(rays, a, b, radius))
    return np.where(np.isfinite(out), out, 0).astype(np.float32)


def _distance(rays: Float64, a: Float64, b: Float64, radius: float) -> Float64:
    """Along z to where rays from the origin first meet a capsule; infinite where they do not."""
    axis, dd = b - a, (rays**2).sum(axis=-1)
    ll, ld, la, da = axis @ axis, rays @ axis, -(a @ axis), -(rays @ a)
    A, B, C = ll * dd - ld * ld, ll * da - la * ld, ll * (a @ a) - la * la - radius * radius * ll
    h = B * B - A * C
    with np.errstate(divide="ignore", invalid="ignore"):
        side = (-B - np.sqrt(h)) / A
    along = la + side * ld
    found = np.where((h >= 0) & (along > 0) & (along < ll), side, np.inf)
    for end in (a, b):
        to = -(rays @ end)
        h = to * to - dd * (end @ end - radius * radius)
        cap = np.where(h >= 0, (-to - np.sqrt(np.maximum(h, 0))) / dd, np.inf)
        found = np.minimum(found, cap)
    return found
