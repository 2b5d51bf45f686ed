"""Kernels that exchange the rays of a limb and its mirror image where a detector took left for right.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.kinematics.ray_point_kernels import GATE, misfit
from mocapella.kinematics.ray_sight_kernels import Sight, spread

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


EXCHANGED = 9.0
"""Least difference of the sums of truncated misfits for a limb's rays to count as left and right exchanged."""
MOST_CAMERAS = 32
"""Largest number of cameras that are searched for exchanged limbs."""


@njit(cache=True, error_model="numpy")
def exchange_limbs(
    model: BodyArrays, sight: Sight, joints: Int64, origins: Float64, positions: Float64, variances: Float64
) -> None:
    """Exchange the rays of a limb and its mirror image where a camera sees left as right.

    That is so if its rays agree better with the predicted joints of the other side, and if no more than half of the
    cameras that see the limb say so: else the prediction is wrong. A limb is a chain of mirrored joints, such as a leg.
    """
    n = model.layout.joints
    mirror, limb, camera = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(len(joints), np.int64)
    cameras = _name_cameras(sight, origins, camera)
    _find_limbs(model.joint_table, model.order, mirror, limb)
    if cameras < 2 or cameras > MOST_CAMERAS:
        return
    own, exchanged = np.zeros((n, cameras)), np.zeros((n, cameras))
    for i in range(sight.first[n]):
        k = sight.order[i]
        j = joints[k]
        if mirror[j] != j:
            own[limb[j], camera[k]] += _wide_misfit(sight.rays, k, positions, j, variances[j]) + 1e-12
            exchanged[limb[j], camera[k]] += _wide_misfit(sight.rays, k, positions, mirror[j], variances[mirror[j]])
    wrong, swapped = np.zeros((n, cameras), np.bool_), 0
    for j in range(n):
        votes, seeing = 0, 0
        for c in range(cameras):
            wrong[j, c] = exchanged[j, c] + EXCHANGED < own[j, c]
            votes += wrong[j, c]
            seeing += own[j, c] > 0.0
        if 2 * votes > seeing:
            for c in range(cameras):
                wrong[j, c] = False
        else:
            swapped += votes
    if swapped > 0:
        _sort_again(sight, joints, mirror, limb, camera, wrong)


@njit(cache=True, error_model="numpy")
def _find_limbs(joint_table: Int64, order: Int64, mirror: Int64, limb: Int64) -> None:
    """Write each joint's mirror image, itself for central joints, and the first joint of its limb's pair: (joints,)."""
    for o in range(len(order)):
        j = order[o]
        mirror[j] = limb[j] = j
        for other in range(len(order)):
            if other != j and joint_table[j, 4] >= 0 and joint_table[other, 4] == joint_table[j, 4]:
                mirror[j], limb[j] = other, min(j, other)
        parent = joint_table[j, 0]
        if parent >= 0 and mirror[j] != j and mirror[parent] != parent:
            limb[j] = limb[parent]


@njit(cache=True, error_model="numpy")
def _wide_misfit(rays: Float64, k: int, positions: Float64, j: int, variance: float) -> float:
    """Return the truncated misfit of ray k to joint j of a prediction, whose variance counts, too."""
    own = spread(rays, k, positions, j)
    chi2 = misfit(rays, k, positions[j, 0], positions[j, 1], positions[j, 2])
    return float(min(chi2 * own / (own + variance), GATE))


@njit(cache=True, error_model="numpy")
def _name_cameras(sight: Sight, origins: Float64, camera: Int64) -> int:
    """Number the rays' cameras by their origins (n, 3), into camera (n,); return the number of cameras."""
    firsts, count = np.empty(MOST_CAMERAS, np.int64), 0
    for i in range(sight.first[len(sight.first) - 1]):
        k = sight.order[i]
        c = 0
        while c < count:
            o = firsts[c]
            if origins[o, 0] == origins[k, 0] and origins[o, 1] == origins[k, 1] and origins[o, 2] == origins[k, 2]:
                break
            c += 1
        if c == count:
            if count == MOST_CAMERAS:
                return MOST_CAMERAS + 1
            firsts[c] = k
            count += 1
        camera[k] = c
    return count


@njit(cache=True, error_model="numpy")
def _sort_again(
    sight: Sight, joints: Int64, mirror: Int64, limb: Int64, camera: Int64, wrong: NDArray[np.bool_]
) -> None:
    """Sort the valid rays by joint anew, where wrong (joints, cameras) limbs of cameras are of the other side."""
    order, first = sight.order, sight.first
    n, rays = len(first) - 1, sight.first[len(first) - 1]
    old, to = order[:rays].copy(), np.empty(len(joints), np.int64)
    for j in range(n + 1):
        first[j] = 0
    for i in range(rays):
        k = old[i]
        j = joints[k]
        to[k] = mirror[j] if wrong[limb[j], camera[k]] else j
        first[to[k] + 1] += 1
    for j in range(n):
        first[j + 1] += first[j]
    for i in range(rays):
        k = old[i]
        order[first[to[k]]] = k
        first[to[k]] += 1
    for j in range(n, 0, -1):
        first[j] = first[j - 1]
    first[0] = 0
