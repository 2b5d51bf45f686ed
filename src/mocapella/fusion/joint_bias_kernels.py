"""Compiled regression of the joint bias, see `mocapella.fusion.joint_bias`; importing this module imports numba.

It evaluates the learnt harmonic series in the facing, linear in its coefficients, and computes the correction to add to
each joint of a view.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.fusion.joint_bias import (
    FAR,
    FARTHEST_M,
    FASTEST_M_S,
    HARMONICS,
    MIDDLE_M,
    NEAREST_M,
    TERMS,
    BiasInputs,
)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True)
def terms_of(alpha: float, distance_m: float, ahead_m_s: float, left_m_s: float) -> Float64:
    """Return the regressors (TERMS,) of one view, as `mocapella.fusion.joint_bias.terms`.

    Args:
        alpha: the facing from the direction towards the sensor [rad].
        distance_m: horizontal distance of the person from the sensor [m].
        ahead_m_s, left_m_s: the person's velocity ahead and to the left of the body [m/s].
    """
    out = np.empty(TERMS)
    for h in range(HARMONICS):
        out[2 * h], out[2 * h + 1] = np.cos((h + 1) * alpha), np.sin((h + 1) * alpha)
    slower = FASTEST_M_S / max(np.sqrt(ahead_m_s**2 + left_m_s**2), FASTEST_M_S)
    far = min(max(distance_m, NEAREST_M), FARTHEST_M) - MIDDLE_M
    waves, moving = 2 * HARMONICS, 2 * (HARMONICS + FAR)
    for i in range(2 * FAR):
        out[waves + i] = far * out[i]
    for i in range(waves):
        out[moving + i] = slower * ahead_m_s * out[i]
        out[moving + waves + i] = slower * left_m_s * out[i]
    return out


@njit(cache=True)
def across_body(
    view_positions: Float64,
    view_at: Float64,
    view_swapped: NDArray[np.bool_],
    lines: Int64,
    now_s: float,
    view_age_s: float,
) -> Float64:
    """Return the vector (3,) from a person's right to left, summed over ``lines`` and over the views in use [m].

    Args:
        view_positions, view_at, view_swapped: (sensors, joints, 3) [m], (sensors,) capture time [s] and (sensors,)
            swapped labels of the person's views.
        lines: (lines, 2) indices of left and right joints that give the facing.
        now_s: present time on the common clock [s].
        view_age_s: oldest age of a used view [s].
    """
    across = np.zeros(3)
    for c in range(len(view_at)):
        if now_s - view_at[c] > view_age_s:
            continue
        sign = -1.0 if view_swapped[c] else 1.0
        for n in range(len(lines)):
            left, right = view_positions[c, lines[n, 0]], view_positions[c, lines[n, 1]]
            x, y, z = left[0] - right[0], left[1] - right[1], left[2] - right[2]
            if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
                across[0] += sign * x
                across[1] += sign * y
                across[2] += sign * z
    return across


@njit(cache=True)
def _turned(R: Float64, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@njit(cache=True)
def corrections(
    rows: Int64, column: int, weights: Float64, T: Float64, R_level: Float64, now_s: float, view_age_s: float,
    mirror: Int64, lines: Int64, root: int, people: BiasInputs, out: Float64,
) -> None:  # fmt: skip
    """Compute the corrections of a frame's bodies, which are to be added to their joints.

    Args:
        rows: (bodies,) row of each body's person; −1 for a body without a person. The correction is 0 for such a body,
            and for a person whose position, velocity or facing is unknown.
        column: column of the sensor in the arrays of ``people``.
        weights: (TERMS, joints · 3) of `JointBiasModel.flat`.
        T: (4, 4) from the sensor's space to the frame of ``people``.
        R_level: (3, 3) rotation from the frame of ``people`` to one with y up.
        now_s, view_age_s: present time on the common clock, and oldest age of a used view [s].
        mirror: (joints,) index of each joint's counterpart on the other side of the body.
        lines: (lines, 2) indices of left and right joints that give the facing.
        root: index of the root joint.
        people: state of the tracked people.
        out: (bodies, joints, 3) written: corrections in the sensor's space, with its labels [m].
    """
    out[:] = 0.0
    positions, velocities, view_swapped = people.positions, people.velocities, people.view_swapped
    R, joints = np.empty((3, 3)), np.empty(weights.shape[1])
    for k in range(3):
        R[0, k], R[1, k], R[2, k] = _turned(R_level, T[0, k], T[1, k], T[2, k])
    for b in range(len(rows)):
        r = rows[b]
        if r < 0:
            continue
        line = across_body(people.view_positions[r], people.view_at[r], view_swapped[r], lines, now_s, view_age_s)
        p, v = positions[r, root], velocities[r, root]
        across = _turned(R_level, line[0], line[1], line[2])
        place = _turned(R_level, p[0] - T[0, 3], p[1] - T[1, 3], p[2] - T[2, 3])
        moving = _turned(R_level, v[0], v[1], v[2])
        known = np.isfinite(place[0] + place[1] + place[2]) and np.isfinite(moving[0] + moving[1] + moving[2])
        if not known or (across[0] == 0.0 and across[2] == 0.0):
            continue
        yaw = np.arctan2(-across[2], across[0])
        sine, cosine = np.sin(yaw), np.cos(yaw)
        of_view = terms_of(
            yaw - np.arctan2(-place[0], -place[2]),
            np.sqrt(place[0] ** 2 + place[2] ** 2),
            moving[0] * sine + moving[2] * cosine,
            moving[0] * cosine - moving[2] * sine,
        )
        joints[:] = 0.0
        for i in range(len(of_view)):  # along the rows of the weights, which are contiguous
            for k in range(len(joints)):
                joints[k] += of_view[i] * weights[i, k]
        swapped = view_swapped[r, column]
        for j in range(len(mirror)):
            k = 3 * (mirror[j] if swapped else j)
            x = cosine * joints[k] + sine * joints[k + 2]
            y = joints[k + 1]
            z = cosine * joints[k + 2] - sine * joints[k]
            for i in range(3):
                out[b, j, i] = R[0, i] * x + R[1, i] * y + R[2, i] * z
