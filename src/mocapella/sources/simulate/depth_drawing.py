"""Drawing of depth images: meshes with a depth buffer, the person's body, and the background of a scene.

A depth buffer keeps the nearest surface at each pixel, with its label and angle of incidence, before sensor noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.limb_surface import polygonise
from mocapella.geometry.rigid import apply

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

NOTHING, BEHIND, BODY, FIRST_ARM = 0, 1, 2, 3
"""Labels in `DepthShot.parts`: no surface, background, person; part p of arm n is `FIRST_ARM` + n · len(PARTS) + p."""


@dataclass(frozen=True, eq=False)
class DepthImages:
    """The images drawn so far; `draw` changes the arrays in place.

    Attributes:
        depth: (height, width) float32 distance along the optical axis [m], infinite without a surface.
        parts: (height, width) uint8 label of each pixel, see `NOTHING`.
        slope: (height, width) float32 cosine of the angle of incidence; 0 without a surface.
    """

    depth: Float32
    parts: UInt8
    slope: Float32

    def copy(self) -> DepthImages:
        """Return images with copies of the arrays."""
        return DepthImages(self.depth.copy(), self.parts.copy(), self.slope.copy())

    def draw(self, vertices: Float64, triangles: Int64, labels: UInt8, first: int, lens: Any) -> Float64:
        """Draw triangles with the depth buffer, in place; those seen from the back are not drawn.

        Args:
            vertices: (n, 3) in the camera frame [m].
            triangles: (m, 3) indices of vertices, anticlockwise as seen from outside.
            labels: (m,) label of each triangle, relative to ``first``.
            first: added to the labels in ``parts``.
            lens: fx, fy, cx, cy [px].

        Returns:
            The projected vertices (n, 3), x, y [px] and 1/z [1/m], of `depth_scene_kernels.project`.
        """
        seen, k = np.empty_like(vertices), _kernels()
        k.project(vertices, np.array(lens), seen)
        k.draw(seen, triangles, labels, np.uint8(first), vertices, self.depth, self.parts, self.slope)
        return seen


@cache
def body_mesh(arms: int) -> tuple[Float64, Int64]:
    """Return the vertices (n, 3) [m] and triangles (m, 3) of the body of a person whose right arm is in the scene.

    Torso, neck and head; if ``arms``, the number of arms in the scene, is 1, also the left arm without its hand. The
    origin is the right shoulder, x to the person's left, y down, z backwards. The arrays are cached: do not change
    them.
    """
    rows = [
        [0.055, 0.03, 0.02, 0.305, 0.03, 0.02, 0.065, 0.065],
        [0.09, 0.10, 0.02, 0.10, 0.45, 0.02, 0.10, 0.10],
        [0.27, 0.10, 0.02, 0.26, 0.45, 0.02, 0.10, 0.10],
        [0.18, 0.10, 0.01, 0.18, 0.45, 0.0, 0.105, 0.11],
        [0.10, 0.45, 0.02, 0.09, 0.85, 0.02, 0.10, 0.115],
        [0.26, 0.45, 0.02, 0.27, 0.85, 0.02, 0.10, 0.115],
        [0.18, 0.02, 0.03, 0.18, -0.10, 0.01, 0.06, 0.052],
        [0.18, -0.155, -0.01, 0.18, -0.225, 0.005, 0.066, 0.088],
        [0.18, -0.165, -0.085, 0.18, -0.18, -0.088, 0.012, 0.01],
    ]
    if arms == 1:
        rows += [
            [0.355, 0.03, 0.02, 0.40, 0.30, 0.04, 0.056, 0.044],
            [0.40, 0.30, 0.04, 0.33, 0.42, -0.14, 0.042, 0.034],
        ]
    limbs = np.array([[*row, 0] for row in rows])
    step = 0.016
    axes = [np.arange(a, b, step) for a, b in ((-0.1, 0.52), (-0.36, 1.04), (-0.24, 0.2))]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return polygonise(limbs, np.array([0.04]), 1e-6, np.ascontiguousarray(nodes))


def draw_background(
    kind: str, size_px: tuple[int, int], lens: tuple[float, ...], rng: np.random.Generator, T_camera_first: Float64
) -> DepthImages:
    """Draw the background of a scene.

    Args:
        kind: ``empty``, ``wall`` or ``desk``.
        size_px: (width, height) of the image.
        lens: fx, fy, cx, cy [px].
        rng: random numbers for the wall's distance and tilt, and for the objects on the desk.
        T_camera_first: (4, 4) from the frame of the scene's first camera to this camera's.
    """
    width, height = size_px
    depth = np.full((height, width), np.inf, np.float32)
    parts, slope = np.zeros((height, width), np.uint8), np.zeros((height, width), np.float32)
    wall_m = float(rng.uniform(2.3, 3.0))
    tilt = rng.normal(0, 0.15, 2)
    desk_m = float(rng.uniform(0.4, 0.55))
    boxes = [(*rng.uniform([-0.8, 1.7], [0.6, 2.0]), *rng.uniform(0.08, 0.3, 2)) for _ in range(4)]
    images = DepthImages(depth, parts, slope)
    if kind == "empty":
        return images
    fx, fy, cx, cy = lens
    x, y = np.meshgrid((np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy)
    planes = [(np.array([tilt[0], 0.3 * tilt[1], 1.0]), wall_m)]
    if kind == "desk":
        planes.append((np.array([0.0, 1.0, 0.12]), desk_m))
    for of_first, from_first in planes:
        table = of_first[1] == 1.0
        normal = T_camera_first[:3, :3] @ of_first
        offset = from_first + float(normal @ T_camera_first[:3, 3])
        towards = normal[0] * x + normal[1] * y + normal[2]
        z = np.where(towards > 1e-3, offset / np.maximum(towards, 1e-3), np.inf)
        cosine = towards / np.linalg.norm(normal) / np.sqrt(x * x + y * y + 1.0)
        nearer = (z < depth) & (z > (1.65 if table else 0.0))
        depth[nearer], parts[nearer], slope[nearer] = z[nearer], BEHIND, cosine[nearer]
    if kind == "desk":
        for left, near, wide, high in boxes:
            corner = np.array([left, desk_m - high - 0.12 * near, near])
            vertices = corner + np.array([wide, high, wide]) * np.array(list(np.ndindex(2, 2, 2)), dtype=float)
            vertices = np.ascontiguousarray(apply(T_camera_first, vertices))
            images.draw(vertices, _BOX, np.zeros(len(_BOX), np.uint8), BEHIND, lens)
    return images


_BOX: Final = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
    [1, 5, 7], [1, 7, 3],
])  # fmt: skip


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sources.simulate import depth_scene_kernels

    return depth_scene_kernels
