"""Orientations of joints as quaternions, from the bone's axis and the body's forward direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]


def bone_ends(topology: Topology) -> NDArray[np.int64]:
    """Return indices (joints, 2) of the start and end joint of each joint's bone, from the parent to the joint.

    The root has the first bone that starts at it.
    """
    root = topology.parts["root"]
    ends = {child: (parent, child) for parent, child in topology.bones}
    ends[root] = next(bone for bone in topology.bones if bone[0] == root)
    return np.array([ends[joint] for joint in range(len(topology))])


def bone_orientations(positions: Float64, bones: NDArray[np.int64], forward: Float64) -> Float64:
    """Return quaternions (bodies, joints, 4) w, x, y, z, w ≥ 0, from a joint's own axes to the positions' frame.

    A joint's y axis is along its bone, as with the Kinect; z is the body's forward direction, made perpendicular to y;
    x completes the right-handed axes. NaN if either end of the bone is NaN, or the bone has no length or is parallel to
    ``forward``.

    Args:
        positions: (bodies, joints, 3) in any frame [m]; NaN where not known.
        bones: (joints, 2) of `bone_ends`.
        forward: (bodies, 3) direction that the chest faces, in the same frame.
    """
    from mocapella.sources.simulate import orientation_kernels

    return np.asarray(orientation_kernels.bone_orientations(positions, bones, forward))
