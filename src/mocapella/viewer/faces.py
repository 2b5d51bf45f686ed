"""Draw faces: eyes and a nose on a skeleton's head, on the side of the person's facing."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology
from mocapella.viewer.bones import NO_STROKES, Float32, Strokes, from_up_to, join
from mocapella.viewer.palette import EYE

_SHOULDERS: Final = "shoulder_left", "shoulder_right"
_EYE_RIGHT, _EYE_UP, _EYE_M = 0.42, 0.2, 0.24
"""Offset of an eye from the face's middle to the side and upwards, and its radius, in radii of the head."""
_NOSE_LONG, _NOSE_WIDE = 0.32, 0.2
"""Half the length and half the width of the nose, in radii of the head."""
_SHORTEST: Final = 1e-3


def facings(positions: Any, topology: Topology) -> Float32:
    """Return each person's facing from the shoulders: (skeletons, 3) float32 horizontal unit vectors.

    NaN where a shoulder is unknown, where one is above the other, and for a topology without shoulders. The facing is
    used for the head, because a skeleton has no orientation of the head itself.

    Args:
        positions: (skeletons, joints, 3) joint positions in a frame with y up [m].
        topology: topology of all the skeletons.
    """
    p = np.asarray(positions, np.float32)
    if any(part not in topology.parts for part in _SHOULDERS):
        return np.full((len(p), 3), np.nan, np.float32)
    left, right = (p[:, topology.parts[part]] for part in _SHOULDERS)
    across = right - left
    forward = np.stack([across[:, 2], np.zeros(len(p), np.float32), -across[:, 0]], axis=-1)
    length = np.linalg.norm(forward, axis=-1, keepdims=True)
    return (forward / np.where(length > _SHORTEST, length, np.nan)).astype(np.float32, copy=False)


def face_strokes(heads: Any, forward: Any, radius: float, colours: Any) -> Strokes:
    """Return strokes for the noses and eyes of heads, as stretched balls.

    Args:
        heads: (n, 3) centres of the heads in the view's space [m].
        forward: (n, 3) results of `facings`; a head with NaN gets no face.
        radius: radius of a head [m].
        colours: (n, 3) red, green and blue of the noses, 0 to 255.
    """
    at, ahead = np.asarray(heads, np.float32), np.asarray(forward, np.float32)
    there = np.isfinite(at).all(axis=-1) & np.isfinite(ahead).all(axis=-1)
    if not there.any():
        return NO_STROKES
    at, ahead = at[there], ahead[there]
    up = np.array([0.0, 1.0, 0.0], np.float32)
    aside = np.cross(up, ahead)
    depth = np.sqrt(1.0 - _EYE_RIGHT**2 - _EYE_UP**2)
    eyes = [
        _strokes(
            at + radius * (depth * ahead + _EYE_UP * up + side * _EYE_RIGHT * aside),
            np.broadcast_to(up, at.shape),
            np.array([_EYE_M, _EYE_M, _EYE_M]) * radius,
            np.broadcast_to(np.array(EYE.paint, np.uint8), at.shape),
        )
        for side in (-1.0, 1.0)
    ]
    size = np.array([_NOSE_WIDE, _NOSE_LONG, _NOSE_WIDE]) * radius
    noses = _strokes(at + radius * ahead, ahead, size, np.asarray(colours, np.uint8).reshape(-1, 3)[there])
    return join([noses, *eyes])


def _strokes(positions: Float32, direction: Float32, scale: NDArray[Any], colours: NDArray[np.uint8]) -> Strokes:
    count = len(positions)
    return Strokes(
        positions=positions.astype(np.float32),
        wxyzs=from_up_to(direction),
        scales=np.tile(scale.astype(np.float32), (count, 1)),
        colours=np.ascontiguousarray(colours),
        opacities=np.ones(count, np.float32),
    )
