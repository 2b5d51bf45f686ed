"""Convert skeletons to strokes: one stretched instance of a small mesh for each bone and joint.

All skeletons of a stage become one set of strokes, so that a browser draws them in one go. Positions are in the view's
space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.topology import Topology

Float32 = NDArray[np.float32]

INFERRED_THICKNESS = 0.45
"""Thickness of an inferred bone, as a fraction of a tracked bone's."""
SURE_SD_M, UNSURE_SD_M = 0.03, 0.12
"""Standard deviations of a coordinate [m]: a joint below the first is drawn as certain, above the second as fully
uncertain. About 90 % of the tracked joints are below the first, half of the inferred ones above 0.08 m (simulated room,
method ``default``)."""
UNSURE_THICKNESS = 0.3
LARGEST_HALO_M = 0.3
HALO_OPACITY = 0.4
_SHORTEST = 1e-4


@dataclass(frozen=True, eq=False)
class Strokes:
    """Instances of one small mesh, a bone or a ball of unit size.

    Attributes:
        positions: (n, 3) positions of the mesh's origin [m].
        wxyzs: (n, 4) orientations as unit quaternions (w, x, y, z).
        scales: (n, 3) sizes along the mesh's own axes [m].
        colours: (n, 3) uint8, red, green and blue.
        opacities: (n,) 0 to 1; only a translucent `StrokeNode` shows them.
    """

    positions: Float32
    wxyzs: Float32
    scales: Float32
    colours: NDArray[np.uint8]
    opacities: Float32

    def __len__(self) -> int:
        return len(self.positions)


NO_STROKES = Strokes(
    np.zeros((0, 3), np.float32),
    np.zeros((0, 4), np.float32),
    np.zeros((0, 3), np.float32),
    np.zeros((0, 3), np.uint8),
    np.zeros(0, np.float32),
)


def join(parts: list[Strokes]) -> Strokes:
    """Return several sets of strokes concatenated into a new one; `NO_STROKES` for an empty list."""
    if not parts:
        return NO_STROKES
    return Strokes(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.wxyzs for part in parts]),
        np.concatenate([part.scales for part in parts]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.opacities for part in parts]),
    )


def checked(strokes: Strokes) -> Strokes:
    """Check strokes that a plug-in may have made, and return them unchanged.

    Raises:
        TypeError: the value is no `Strokes`.
        ValueError: an array has another shape, or a value that is not finite; names the array.
    """
    if not isinstance(strokes, Strokes):
        raise TypeError(f"{type(strokes).__name__} where Strokes are wanted")
    wanted = {"positions": (3,), "wxyzs": (4,), "scales": (3,), "colours": (3,), "opacities": ()}
    for name, shape in wanted.items():
        values = np.asarray(getattr(strokes, name))
        if values.shape != (len(strokes), *shape):
            raise ValueError(f"{name} are {values.shape}; {(len(strokes), *shape)} is wanted")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} have a value that is not finite")
    return strokes


def padded(strokes: Strokes, count: int) -> Strokes:
    """Return a copy with invisible strokes of scale 0 appended, ``count`` in total (at least as many as there are).

    A scene node has a fixed number of instances, and the unused ones must not be visible.
    """
    missing = count - len(strokes)
    identity = np.tile(np.array([1, 0, 0, 0], np.float32), (missing, 1))
    nothing = np.zeros((missing, 3), np.float32)
    blank = Strokes(nothing, identity, nothing, np.zeros((missing, 3), np.uint8), np.zeros(missing, np.float32))
    return join([strokes, blank])


def doubt(sd: Any) -> Float32:
    """Map the standard deviation of joints to how uncertain they are drawn, their *doubt*: 0 (certain) to 1.

    It rises linearly from `SURE_SD_M` to `UNSURE_SD_M`.

    Args:
        sd: standard deviations of a coordinate [m], of any shape; NaN gives 0.
    """
    span = UNSURE_SD_M - SURE_SD_M
    return np.asarray(np.clip(np.nan_to_num((np.asarray(sd, np.float32) - SURE_SD_M) / span), 0, 1), np.float32)


def bone_strokes(
    positions: Any, states: Any, topology: Topology, colours: Any, radii: Any, *, doubts: Any = None
) -> Strokes:
    """Return a stroke, along +y of the mesh, for every bone with two known joints.

    A bone is drawn thin if one of its joints is inferred or uncertain. It is left out if a joint is not tracked or has
    a NaN coordinate, or if both joints are at the same position.

    Args:
        positions: (skeletons, joints, 3) joint positions [m].
        states: (skeletons, joints) `JointState`.
        topology: topology of all the skeletons.
        colours: (skeletons, 3) or (skeletons, bones, 3), red, green and blue, 0 to 255.
        radii: (skeletons,) radius of a tracked bone [m].
        doubts: (skeletons, joints) results of `doubt`; the more uncertain joint of a bone counts. None: all certain.
    """
    p, s = np.asarray(positions, np.float32), np.asarray(states)
    bones = np.array(topology.bones)
    start, along = p[:, bones[:, 0]], p[:, bones[:, 1]] - p[:, bones[:, 0]]
    length = np.linalg.norm(along, axis=-1)
    weakest = np.minimum(s[:, bones[:, 0]], s[:, bones[:, 1]])
    there = np.isfinite(length) & (length > _SHORTEST) & (weakest != JointState.NOT_TRACKED)
    skeleton = np.nonzero(there)[0]
    radius = np.asarray(radii, np.float32)[skeleton] * _thickness(weakest[there])
    if doubts is not None:
        unsure = np.maximum(doubts[:, bones[:, 0]], doubts[:, bones[:, 1]])[there]
        radius = np.minimum(radius, np.asarray(radii, np.float32)[skeleton] * _by_doubt(unsure))
    direction = along[there] / length[there][:, None]
    return Strokes(
        positions=start[there],
        wxyzs=from_up_to(direction),
        scales=np.stack([radius, length[there], radius], axis=-1).astype(np.float32),
        colours=_colour_of_each(colours, there),
        opacities=np.ones(len(skeleton), np.float32),
    )


def line_strokes(points: Any, colour: Any, radius: float) -> Strokes:
    """Return a stroke for each segment of an open line through points, along +y of the mesh.

    Args:
        points: (n, 3) [m]; a segment with a NaN point, or of no length, is left out.
        colour: (3,) red, green and blue, 0 to 255.
        radius: half the line's thickness [m].
    """
    p = np.asarray(points, np.float32)
    along = p[1:] - p[:-1]
    length = np.linalg.norm(along, axis=-1)
    there = np.isfinite(length) & (length > _SHORTEST)
    size = np.full(int(there.sum()), radius, np.float32)
    return Strokes(
        positions=p[:-1][there],
        wxyzs=from_up_to(along[there] / length[there][:, None]),
        scales=np.stack([size, length[there], size], axis=-1).astype(np.float32),
        colours=np.tile(np.asarray(colour, np.uint8), (len(size), 1)),
        opacities=np.ones(len(size), np.float32),
    )


def joint_strokes(positions: Any, states: Any, colours: Any, radii: Any, *, doubts: Any = None) -> Strokes:
    """Return a ball for every joint with a position; inferred and uncertain joints are smaller.

    Args:
        positions: (skeletons, joints, 3) joint positions [m].
        states: (skeletons, joints) `JointState`.
        colours: (skeletons, 3) or (skeletons, joints, 3), red, green and blue, 0 to 255.
        radii: (joints,) radius of each joint if tracked [m]; a joint of radius 0 is left out.
        doubts: (skeletons, joints) results of `doubt`; None: all joints are certain.
    """
    p, s = np.asarray(positions, np.float32), np.asarray(states)
    size = np.broadcast_to(np.asarray(radii, np.float32), s.shape)
    there = _is_there(p, s) & (size > 0)
    radius = size[there] * _thickness(s[there])
    if doubts is not None:
        radius = np.minimum(radius, size[there] * _by_doubt(doubts[there]))
    return _balls(p[there], radius, _colour_of_each(colours, there))


def halo_strokes(positions: Any, states: Any, sds: Any, colours: Any) -> Strokes:
    """Return a translucent ball around every uncertain joint; its radius is one standard deviation of a coordinate.

    A joint is uncertain if its standard deviation is above `SURE_SD_M`, whether it is tracked or inferred. The ball is
    the more opaque the larger the deviation (`doubt`), and its radius is at most `LARGEST_HALO_M`.

    Args:
        positions: (skeletons, joints, 3) joint positions [m]; a joint with NaN gets no ball.
        states: (skeletons, joints) `JointState`; a joint that is not tracked gets no ball.
        sds: (skeletons, joints) standard deviation of a coordinate [m]; NaN if unknown, which gives no ball.
        colours: (skeletons, 3) red, green and blue, 0 to 255.
    """
    p, s, sd = np.asarray(positions, np.float32), np.asarray(states), np.asarray(sds, np.float32)
    unsure = doubt(sd)
    there = _is_there(p, s) & (unsure > 0)
    radius = np.minimum(sd[there], LARGEST_HALO_M)
    colour = np.asarray(colours, np.uint8).reshape(-1, 3)[np.nonzero(there)[0]]
    return replace(_balls(p[there], radius, colour), opacities=HALO_OPACITY * unsure[there])


def _colour_of_each(colours: Any, there: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(n, 3) colours of the bones or joints that are ``there`` (skeletons, bones or joints)."""
    one = np.asarray(colours, np.uint8)
    each = one if one.ndim == 3 else one.reshape(-1, 1, 3)
    return np.asarray(np.broadcast_to(each, (*there.shape, 3))[there])


def _is_there(positions: Float32, states: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(positions).all(axis=-1) & (states != JointState.NOT_TRACKED))


def _balls(positions: Float32, radii: Float32, colours: NDArray[np.uint8]) -> Strokes:
    count = len(radii)
    return Strokes(
        positions=positions,
        wxyzs=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.repeat(radii[:, None], 3, axis=1).astype(np.float32),
        colours=colours,
        opacities=np.ones(count, np.float32),
    )


def from_up_to(direction: Any) -> Float32:
    """Return the unit quaternions (…, 4) (w, x, y, z) that rotate +y into unit vectors (…, 3) by the smallest angle.

    For −y, it is half a turn about x.
    """
    d = np.asarray(direction, np.float64)
    q = np.stack([1 + d[..., 1], d[..., 2], np.zeros_like(d[..., 0]), -d[..., 0]], axis=-1)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    # Straight down, every half turn about a level axis is a shortest way.
    half_turn = np.array([0.0, 1.0, 0.0, 0.0])
    return np.where(norm > 1e-6, q / np.maximum(norm, 1e-6), half_turn).astype(np.float32)


def _thickness(states: NDArray[Any]) -> Float32:
    return np.where(states == JointState.TRACKED, np.float32(1), np.float32(INFERRED_THICKNESS))


def _by_doubt(doubts: Float32) -> Float32:
    return np.float32(1) - np.float32(1 - UNSURE_THICKNESS) * doubts
