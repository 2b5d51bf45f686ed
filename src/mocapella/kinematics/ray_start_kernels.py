"""Kernels that bend the limbs of a body in its first frame, as its measured joints show them.

`articulated_start_kernels` points a thigh or an upper arm along the measured bone, and starts the hinge below it at one
angle for all. A limb that is bent much farther, or to another side, then fits its rays only in a distant pose, which
Gauss–Newton steps do not reach. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL, BodyArrays
from mocapella.kinematics.articulated_start_kernels import is_measured
from mocapella.kinematics.chain_kernels import forward, limited

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LEAST_BEND = math.radians(30.0)
"""Angle between two bones above which three joints show the plane of the hinge between them [rad]."""
PERPENDICULAR = 0.1
"""Largest cosine between a bone and the axis of the hinge at its end."""


@njit(cache=True, error_model="numpy")
def hinge_below(model: BodyArrays, j: int) -> int:
    """Return the joint at the end of a hinge that hangs at joint j, across its axis; −1 if there is none.

    Args:
        model: the body model.
        j: index of the joint, such as a knee; the ankle is returned.
    """
    table, values = model.joint_table, model.joint_values
    for c in range(model.layout.joints):
        if table[c, 0] != j or table[c, 2] != 1 or table[c, 3] >= 0:
            continue
        kind = model.dof_kind[table[c, 1]]
        if ABOUT <= kind < OF_BALL and abs(values[j, kind - ABOUT]) < PERPENDICULAR:
            return c
    return -1


@njit(cache=True, error_model="numpy")
def bend_limbs(model: BodyArrays, row: Float64, measured: Float64, variances: Float64) -> None:
    """Turn balls and hinges of bent limbs so that both bones point along the measured ones, from the root outwards.

    Limbs that are bent by less than `LEAST_BEND`, or not measured, stay as they are.

    Args:
        model: the body model.
        row: (memory_size,) the memory of an initialised body, changed.
        measured: (joints, 3) world [m]; NaN where not measured.
        variances: (joints,) variance of a coordinate [m²]; not finite where not measured.
    """
    layout, table = model.layout, model.joint_table
    x, R, xi, origin = np.empty((layout.joints, 3)), np.empty((layout.joints, 9)), np.empty((0, 6)), np.zeros(3)
    frame, limb, B, within = np.empty((3, 3)), np.empty((3, 3)), np.empty(9), np.empty(9)
    for o in range(layout.joints):
        j = model.order[o]
        c, parent = hinge_below(model, j), table[j, 0]
        if not (table[j, 3] > 0 and c >= 0 and is_measured(measured, variances, j)):
            continue
        if not (is_measured(measured, variances, c) and is_measured(measured, variances, parent)):
            continue
        for k in range(3):
            limb[0, k], limb[1, k], limb[2, k] = measured[parent, k], measured[j, k], measured[c, k]
        i = table[c, 1]
        least, most = model.dof_values[i, 0], model.dof_values[i, 1]
        bend = bone_frame(model, j, model.dof_kind[i] - ABOUT, least + most, limb, frame)
        if bend < LEAST_BEND:
            continue
        forward(model, row, origin, x, R, xi)
        for r in range(3):
            for k in range(3):
                B[3 * r + k] = 0.0
                for m in range(3):
                    B[3 * r + k] += R[parent, 3 * m + r] * frame[m, k]
        limited(model.joint_values, j, row[layout.slack + j], B, within)
        for k in range(9):
            row[layout.rotations + 9 * table[j, 3] + k] = within[k]
        row[layout.angles + i] = min(max(bend if least + most > 0.0 else -bend, least), most)


@njit(cache=True, error_model="numpy")
def bone_frame(model: BodyArrays, j: int, axis: int, side: float, limb: Float64, frame: Float64) -> float:
    """Write the rotation of a limb's upper bone that makes it, and the axis of the hinge at its end, as measured.

    Args:
        model: the body model.
        j: the joint at the end of the upper bone.
        axis: axis of the hinge in the bone's frame, 0 to 2.
        side: positive for a hinge that bends about the positive axis.
        limb: (3, 3) beginning of the upper bone, its end, and the end of the lower bone, world [m].
        frame: (3, 3) written: rotation from the bone's frame to the world.

    Returns:
        Angle between the two bones [rad]; 0 if a bone has no length, and nothing is known of the axis.
    """
    u, w, n, a, o = np.empty(3), np.empty(3), np.empty(3), np.zeros(3), np.empty(3)
    for k in range(3):
        u[k], w[k], o[k] = limb[1, k] - limb[0, k], limb[2, k] - limb[1, k], model.joint_values[j, k]
    a[axis] = 1.0 if side > 0.0 else -1.0
    upper, lower = math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2), math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if not upper * lower > 0.0:
        return 0.0
    cross(u, w, n)
    across = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    bend = math.atan2(across, u[0] * w[0] + u[1] * w[1] + u[2] * w[2])
    if not across > 0.0:
        return 0.0
    for k in range(3):
        u[k], n[k] = u[k] / upper, n[k] / across
    # The bone o becomes u, the axis a becomes n, and their product b becomes v.
    b, v = np.empty(3), np.empty(3)
    cross(o, a, b)
    cross(u, n, v)
    for r in range(3):
        for k in range(3):
            frame[r, k] = u[r] * o[k] + n[r] * a[k] + v[r] * b[k]
    return bend


@njit(cache=True, error_model="numpy")
def cross(a: Float64, b: Float64, out: Float64) -> None:
    """Write the cross product of two vectors (3,) to out (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
