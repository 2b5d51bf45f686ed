"""Keep labels of the 3D scene apart: a label that would cover another one is moved up on the screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.viewer.drawing import Tag

Float64 = NDArray[np.float64]
Box = tuple[float, float, float, float]

_CHARACTER_PX, _LINE_PX, _PADDING_PX = 6.3, 18.0, 6.0
"""Size of a label of font scale 1 in viser's font: width of a character, height, and both borders together [px]."""
_GAP_PX: Final = 2.0
_NEAREST_M: Final = 0.05
_DECIMALS: Final = 3


@dataclass(frozen=True, eq=False)
class LabelCamera:
    """The camera of a browser, for the layout of labels.

    Attributes:
        position: (3,) position in the view's space [m].
        R: (3, 3) orthonormal; its rows are the camera's directions to the right, up and forwards in the view's space,
            so its determinant is −1. A point p has the camera coordinates R @ (p − position).
        px_per_m: size on the screen of 1 m at a distance of 1 m [px].
    """

    position: Float64
    R: Float64
    px_per_m: float

    @classmethod
    def looking(
        cls, position: Float64, target: Float64, up: Float64, fov: float, height_px: float
    ) -> LabelCamera | None:
        """Return a camera from its position and target.

        None if the two are equal or on a line along ``up``, or if ``fov`` or ``height_px`` is out of range.

        Args:
            position: (3,) position of the camera [m].
            target: (3,) point that it looks at [m].
            up: (3,) upward direction.
            fov: vertical field of view [rad].
            height_px: height of the canvas [px].
        """
        forward = np.asarray(target, np.float64) - position
        right = np.cross(forward, up)
        length, across = np.linalg.norm(forward), np.linalg.norm(right)
        if not (length > 0 and across > 0 and height_px > 0 and 0 < fov < np.pi):
            return None
        forward, right = forward / length, right / across
        return cls(
            np.asarray(position, np.float64),
            np.stack([right, np.cross(right, forward), forward]),
            float(height_px / 2 / np.tan(fov / 2)),
        )


def apart(groups: Sequence[tuple[float, Sequence[Tag]]], camera: LabelCamera) -> list[list[Tag]]:
    """Move labels up on the screen until none covers another; return the groups with the new positions.

    Earlier labels take precedence and stay. Invisible labels, and labels behind the camera, are unchanged.

    Args:
        groups: font scale and labels of each group; a label's position is the middle of its lower border.
        camera: camera of the browser.
    """
    taken: list[Box] = []
    return [[_placed(tag, size, taken, camera) for tag in tags] for size, tags in groups]


def _placed(tag: Tag, size: float, taken: list[Box], camera: LabelCamera) -> Tag:
    right, up, depth = camera.R @ (np.asarray(tag.position) - camera.position)
    if not tag.visible or not tag.text or not depth > _NEAREST_M:
        return tag
    scale = camera.px_per_m / depth
    x, y = right * scale, up * scale
    half, high = size * 0.5 * (len(tag.text) * _CHARACTER_PX + _PADDING_PX), size * _LINE_PX
    low = y
    for _ in range(len(taken)):
        covered = [box for box in taken if _overlap(box, (x - half, low, x + half, low + high))]
        if not covered:
            break
        low = max(box[3] for box in covered) + _GAP_PX
    taken.append((x - half, low, x + half, low + high))
    if low == y:
        return tag
    position = np.asarray(tag.position) + (low - y) / scale * camera.R[1]
    a, b, c = position.round(_DECIMALS).tolist()
    return replace(tag, position=(a, b, c))


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
