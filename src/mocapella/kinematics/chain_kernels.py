"""Kernels of a kinematic tree: forward kinematics, the best small motion, and its covariance.

Every degree of freedom i is a twist ξ_i = (ω, v), which moves the point x by v + ω × x. Points, twists and motions
refer to one origin, with the axes of the world. Importing this module imports numba.

The best small motion δ minimises Σ_j w_j |J_j δ − r_j|² + Σ_i D_i (δ_i − e_i)². Its normal matrix is the joint-space
inertia matrix of a tree of point masses w_j with rotors of inertia D_i. The articulated-body algorithm therefore solves
it as forward dynamics, exactly, without forming the matrix, and in linear time (R. Featherstone, Rigid Body Dynamics
Algorithms, 2008, section 7.3). The algorithm is a Kalman filter towards the root and a smoother away from it
(G. Rodriguez, Kalman Filtering, Smoothing, and Recursive Robot Arm Forward and Inverse Dynamics, IEEE Journal of
Robotics and Automation 3, 1987), and the smoother's covariances are the marginal covariances of the estimate.

A symmetric (6, 6) matrix is stored as its upper triangle, row by row, in 21 numbers. The arithmetic on it is written
out, because loops over so few numbers take twice as long.
"""

# ruff: noqa: PLR0915, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST, turned
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL, BodyArrays

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_IDENTITY = np.eye(3).reshape(9)


class Elimination(NamedTuple):
    """Intermediate results of the articulated-body algorithm, which `solve` writes and `marginals` reads.

    Attributes:
        M: (joints, 27) articulated inertia, 21 numbers, and bias force, 6, of the subtree at each joint.
        U: (dofs, 6) the inertia's product with each twist.
        d: (dofs,) articulated inertia of each degree of freedom.
        u: (dofs,) force on each degree of freedom.
        a: (joints, 6) small motion of each bone, a twist.
    """

    M: Float64
    U: Float64
    d: Float64
    u: Float64
    a: Float64


@njit(cache=True, error_model="numpy")
def swing(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, out: Float64) -> None:
    """Write the shortest rotation from the unit direction o to the unit direction d into out (9,), row by row."""
    x, y, z = oy * dz - oz * dy, oz * dx - ox * dz, ox * dy - oy * dx
    sine, cosine = math.sqrt(x * x + y * y + z * z), ox * dx + oy * dy + oz * dz
    f = math.atan2(sine, cosine) / sine if sine > 1e-9 else 0.0
    if f == 0.0 and cosine < 0.0:  # opposite: half a turn about any axis across
        x, y, z = (-oy, ox, 0.0) if abs(oz) < 0.9 else (0.0, -oz, oy)
        f = math.pi / math.sqrt(x * x + y * y + z * z)
    turned(_IDENTITY, FIRST, f * x, f * y, f * z, out)


@njit(cache=True, error_model="numpy")
def limited(joint_values: Float64, j: int, slack: float, B: Float64, out: Float64) -> bool:
    """Clamp the rotation of a ball joint to its limits; return whether it was beyond them.

    The rotation is split into a twist of the bone about itself and then a swing, the shortest rotation of the bone from
    its rest direction. A swing beyond the cone returns to the nearest point of its edge.

    Args:
        joint_values: (joints, 13) of `ArticulatedModel`.
        j: index of the joint.
        slack: angle by which the cone and the twist's range are widened [rad].
        B: (9,) the rotation, row by row.
        out: (9,) written.
    """
    values = joint_values[j]
    cone = min(values[7] + slack, math.pi)
    ox, oy, oz = values[0], values[1], values[2]
    dx = B[0] * ox + B[1] * oy + B[2] * oz
    dy = B[3] * ox + B[4] * oy + B[5] * oz
    dz = B[6] * ox + B[7] * oy + B[8] * oz
    cx, cy, cz = values[4], values[5], values[6]
    along = dx * cx + dy * cy + dz * cz
    # The twist follows from the quaternion's component along the bone over its real part.
    twist = 2.0 * math.atan2((B[7] - B[5]) * ox + (B[2] - B[6]) * oy + (B[3] - B[1]) * oz, 1.0 + B[0] + B[4] + B[8])
    allowed = min(max(twist, values[8] - slack), values[9] + slack)
    cosine = math.cos(cone)
    for i in range(9):
        out[i] = B[i]
    if along >= cosine and allowed == twist:
        return False
    if along < cosine:
        px, py, pz = dx - along * cx, dy - along * cy, dz - along * cz
        n = math.sqrt(px * px + py * py + pz * pz)
        f = math.sin(cone) / n if n > 0.0 else 0.0
        dx, dy, dz = cosine * cx + f * px, cosine * cy + f * py, cosine * cz + f * pz
    S = np.empty(9)
    swing(ox, oy, oz, dx, dy, dz, S)
    turned(S, FIRST, allowed * ox, allowed * oy, allowed * oz, out)
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def _write_twist(xi: Float64, i: int, u: float, v: float, w: float, vx: float, vy: float, vz: float) -> None:
    """Write the twist (ω, v) of the degree of freedom i into xi (dofs, 6), if it has that row."""
    if i < len(xi):
        xi[i, 0], xi[i, 1], xi[i, 2] = u, v, w
        xi[i, 3], xi[i, 4], xi[i, 5] = vx, vy, vz


@njit(cache=True, error_model="numpy")
def forward(model: BodyArrays, row: Float64, origin: Float64, x: Float64, R: Float64, xi: Float64) -> None:
    """Compute joints, bone frames and twists of the pose in a memory row, about an origin.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory.
        origin: (3,) world [m].
        x: (joints, 3) written: joints relative to the origin, with the world's axes [m].
        R: (joints, 9) written: rotations from the bones' frames to the world, row by row.
        xi: (dofs, 6) written: twists (ω, v) of the degrees of freedom about the origin; (0, 6) if none are wanted.
    """
    joint_table, joint_values, dof_kind = model.joint_table, model.joint_values, model.dof_kind
    angles, bones = model.layout.angles, model.layout.bones
    for o in range(len(model.order)):
        j = model.order[o]
        parent, first, ball = joint_table[j, 0], joint_table[j, 1], joint_table[j, 3]
        last = first + joint_table[j, 2]
        b = model.layout.rotations + 9 * ball
        if parent < 0:
            ox, oy, oz = row[angles] - origin[0], row[angles + 1] - origin[1], row[angles + 2] - origin[2]
            a0, a1, a2 = row[b], row[b + 1], row[b + 2]
            a3, a4, a5 = row[b + 3], row[b + 4], row[b + 5]
            a6, a7, a8 = row[b + 6], row[b + 7], row[b + 8]
            _write_twist(xi, 0, 0.0, 0.0, 0.0, a0, a3, a6)
            _write_twist(xi, 1, 0.0, 0.0, 0.0, a1, a4, a7)
            _write_twist(xi, 2, 0.0, 0.0, 0.0, a2, a5, a8)
            first = 3
        else:
            ox, oy, oz = x[parent, 0], x[parent, 1], x[parent, 2]
            a0, a1, a2 = R[parent, 0], R[parent, 1], R[parent, 2]
            a3, a4, a5 = R[parent, 3], R[parent, 4], R[parent, 5]
            a6, a7, a8 = R[parent, 6], R[parent, 7], R[parent, 8]
            if ball >= 0:
                b0, b1, b2 = row[b], row[b + 1], row[b + 2]
                b3, b4, b5 = row[b + 3], row[b + 4], row[b + 5]
                b6, b7, b8 = row[b + 6], row[b + 7], row[b + 8]
                a0, a1, a2 = a0 * b0 + a1 * b3 + a2 * b6, a0 * b1 + a1 * b4 + a2 * b7, a0 * b2 + a1 * b5 + a2 * b8
                a3, a4, a5 = a3 * b0 + a4 * b3 + a5 * b6, a3 * b1 + a4 * b4 + a5 * b7, a3 * b2 + a4 * b5 + a5 * b8
                a6, a7, a8 = a6 * b0 + a7 * b3 + a8 * b6, a6 * b1 + a7 * b4 + a8 * b7, a6 * b2 + a7 * b5 + a8 * b8
        for i in range(first, last):
            kind = dof_kind[i]
            axis, c, s = kind - OF_BALL, 1.0, 0.0
            if kind < OF_BALL:
                axis = kind - ABOUT
                c, s = math.cos(row[angles + i]), math.sin(row[angles + i])
            if axis == 0:
                u, v, w = a0, a3, a6
                a1, a2 = c * a1 + s * a2, c * a2 - s * a1
                a4, a5 = c * a4 + s * a5, c * a5 - s * a4
                a7, a8 = c * a7 + s * a8, c * a8 - s * a7
            elif axis == 1:
                u, v, w = a1, a4, a7
                a2, a0 = c * a2 + s * a0, c * a0 - s * a2
                a5, a3 = c * a5 + s * a3, c * a3 - s * a5
                a8, a6 = c * a8 + s * a6, c * a6 - s * a8
            else:
                u, v, w = a2, a5, a8
                a0, a1 = c * a0 + s * a1, c * a1 - s * a0
                a3, a4 = c * a3 + s * a4, c * a4 - s * a3
                a6, a7 = c * a6 + s * a7, c * a7 - s * a6
            _write_twist(xi, i, u, v, w, oy * w - oz * v, oz * u - ox * w, ox * v - oy * u)
        R[j, 0], R[j, 1], R[j, 2] = a0, a1, a2
        R[j, 3], R[j, 4], R[j, 5] = a3, a4, a5
        R[j, 6], R[j, 7], R[j, 8] = a6, a7, a8
        if parent >= 0:
            length = row[bones + joint_table[j, 4]]
            dx, dy, dz = length * joint_values[j, 0], length * joint_values[j, 1], length * joint_values[j, 2]
            ox += a0 * dx + a1 * dy + a2 * dz
            oy += a3 * dx + a4 * dy + a5 * dz
            oz += a6 * dx + a7 * dy + a8 * dz
        x[j, 0], x[j, 1], x[j, 2] = ox, oy, oz


@njit(cache=True, error_model="numpy")
def _add_point(M: Float64, j: int, w: float, x: Float64, residuals: Float64) -> None:
    """Add the point mass w at joint j to its subtree's inertia, and the residual to its force."""
    f, g, h = x[j, 0], x[j, 1], x[j, 2]
    wf, wg, wh = w * f, w * g, w * h
    r0, r1, r2 = w * residuals[j, 0], w * residuals[j, 1], w * residuals[j, 2]
    M[j, 0] += wg * g + wh * h
    M[j, 6] += wf * f + wh * h
    M[j, 11] += wf * f + wg * g
    M[j, 1] -= wf * g
    M[j, 2] -= wf * h
    M[j, 7] -= wg * h
    M[j, 4] -= wh
    M[j, 5] += wg
    M[j, 8] += wh
    M[j, 10] -= wf
    M[j, 12] -= wg
    M[j, 13] += wf
    M[j, 15] += w
    M[j, 18] += w
    M[j, 20] += w
    M[j, 21] += g * r2 - h * r1
    M[j, 22] += h * r0 - f * r2
    M[j, 23] += f * r1 - g * r0
    M[j, 24] += r0
    M[j, 25] += r1
    M[j, 26] += r2


@njit(cache=True, error_model="numpy")
def _add_information(M: Float64, j: int, information: Float64, x: Float64, forces: Float64) -> None:
    """Add the information matrix Λ of joint j to its subtree's inertia, and the force Λ r to its force.

    With J = (−[x]×, I), the velocity of the joint under a twist (ω, v), they are Jᵀ Λ J and Jᵀ Λ r.
    """
    f, g, h = x[j, 0], x[j, 1], x[j, 2]
    a, b, c = information[j, 0], information[j, 1], information[j, 2]
    d, e, i = information[j, 3], information[j, 4], information[j, 5]
    # [x]× Λ, row by row
    p00, p01, p02 = g * c - h * b, g * e - h * d, g * i - h * e
    p10, p11, p12 = h * a - f * c, h * b - f * e, h * c - f * i
    p20, p21, p22 = f * b - g * a, f * d - g * b, f * e - g * c
    # −[x]× Λ [x]×
    M[j, 0] += g * p02 - h * p01
    M[j, 1] += h * p00 - f * p02
    M[j, 2] += f * p01 - g * p00
    M[j, 6] += h * p10 - f * p12
    M[j, 7] += f * p11 - g * p10
    M[j, 11] += f * p21 - g * p20
    M[j, 3] += p00
    M[j, 4] += p01
    M[j, 5] += p02
    M[j, 8] += p10
    M[j, 9] += p11
    M[j, 10] += p12
    M[j, 12] += p20
    M[j, 13] += p21
    M[j, 14] += p22
    M[j, 15] += a
    M[j, 16] += b
    M[j, 17] += c
    M[j, 18] += d
    M[j, 19] += e
    M[j, 20] += i
    r0, r1, r2 = forces[j, 0], forces[j, 1], forces[j, 2]
    M[j, 21] += g * r2 - h * r1
    M[j, 22] += h * r0 - f * r2
    M[j, 23] += f * r1 - g * r0
    M[j, 24] += r0
    M[j, 25] += r1
    M[j, 26] += r2


@njit(cache=True, error_model="numpy")
def _eliminate(
    joint_table: Int64, order: Int64, xi: Float64, D: Float64, e: Float64, x: Float64, residuals: Float64,
    weights: Float64, work: Elimination,
) -> None:  # fmt: skip
    """Accumulate articulated inertias and forces from the leaves to the root: the first pass of `solve`."""
    M, U = work.M, work.U
    for j in range(len(M)):
        for i in range(27):
            M[j, i] = 0.0
    for o in range(len(order) - 1, -1, -1):
        j = order[o]
        if weights.ndim == 2:  # decided when the kernel is compiled
            _add_information(M, j, weights, x, residuals)
        elif weights[j] > 0.0:
            _add_point(M, j, weights[j], x, residuals)
        m00, m01, m02 = M[j, 0], M[j, 1], M[j, 2]
        m03, m04, m05 = M[j, 3], M[j, 4], M[j, 5]
        m11, m12, m13 = M[j, 6], M[j, 7], M[j, 8]
        m14, m15, m22 = M[j, 9], M[j, 10], M[j, 11]
        m23, m24, m25 = M[j, 12], M[j, 13], M[j, 14]
        m33, m34, m35 = M[j, 15], M[j, 16], M[j, 17]
        m44, m45, m55 = M[j, 18], M[j, 19], M[j, 20]
        q0, q1, q2 = M[j, 21], M[j, 22], M[j, 23]
        q3, q4, q5 = M[j, 24], M[j, 25], M[j, 26]
        first = joint_table[j, 1]
        for i in range(first + joint_table[j, 2] - 1, first - 1, -1):
            t0, t1, t2 = xi[i, 0], xi[i, 1], xi[i, 2]
            t3, t4, t5 = xi[i, 3], xi[i, 4], xi[i, 5]
            u0 = m00 * t0 + m01 * t1 + m02 * t2 + m03 * t3 + m04 * t4 + m05 * t5
            u1 = m01 * t0 + m11 * t1 + m12 * t2 + m13 * t3 + m14 * t4 + m15 * t5
            u2 = m02 * t0 + m12 * t1 + m22 * t2 + m23 * t3 + m24 * t4 + m25 * t5
            u3 = m03 * t0 + m13 * t1 + m23 * t2 + m33 * t3 + m34 * t4 + m35 * t5
            u4 = m04 * t0 + m14 * t1 + m24 * t2 + m34 * t3 + m44 * t4 + m45 * t5
            u5 = m05 * t0 + m15 * t1 + m25 * t2 + m35 * t3 + m45 * t4 + m55 * t5
            s = D[i] + t0 * u0 + t1 * u1 + t2 * u2 + t3 * u3 + t4 * u4 + t5 * u5
            f = D[i] * e[i] + t0 * q0 + t1 * q1 + t2 * q2 + t3 * q3 + t4 * q4 + t5 * q5
            work.d[i], work.u[i] = s, f
            U[i, 0], U[i, 1], U[i, 2] = u0, u1, u2
            U[i, 3], U[i, 4], U[i, 5] = u3, u4, u5
            g = 1.0 / s
            f *= g
            q0 -= u0 * f
            q1 -= u1 * f
            q2 -= u2 * f
            q3 -= u3 * f
            q4 -= u4 * f
            q5 -= u5 * f
            w0, w1, w2 = g * u0, g * u1, g * u2
            w3, w4 = g * u3, g * u4
            m00, m01, m02 = m00 - w0 * u0, m01 - w0 * u1, m02 - w0 * u2
            m03, m04, m05 = m03 - w0 * u3, m04 - w0 * u4, m05 - w0 * u5
            m11, m12, m13 = m11 - w1 * u1, m12 - w1 * u2, m13 - w1 * u3
            m14, m15 = m14 - w1 * u4, m15 - w1 * u5
            m22, m23 = m22 - w2 * u2, m23 - w2 * u3
            m24, m25 = m24 - w2 * u4, m25 - w2 * u5
            m33, m34, m35 = m33 - w3 * u3, m34 - w3 * u4, m35 - w3 * u5
            m44, m45, m55 = m44 - w4 * u4, m45 - w4 * u5, m55 - g * u5 * u5
        k = joint_table[j, 0]
        if k >= 0:
            M[k, 0], M[k, 1], M[k, 2] = M[k, 0] + m00, M[k, 1] + m01, M[k, 2] + m02
            M[k, 3], M[k, 4], M[k, 5] = M[k, 3] + m03, M[k, 4] + m04, M[k, 5] + m05
            M[k, 6], M[k, 7], M[k, 8] = M[k, 6] + m11, M[k, 7] + m12, M[k, 8] + m13
            M[k, 9], M[k, 10], M[k, 11] = M[k, 9] + m14, M[k, 10] + m15, M[k, 11] + m22
            M[k, 12], M[k, 13], M[k, 14] = M[k, 12] + m23, M[k, 13] + m24, M[k, 14] + m25
            M[k, 15], M[k, 16], M[k, 17] = M[k, 15] + m33, M[k, 16] + m34, M[k, 17] + m35
            M[k, 18], M[k, 19], M[k, 20] = M[k, 18] + m44, M[k, 19] + m45, M[k, 20] + m55
            M[k, 21], M[k, 22], M[k, 23] = M[k, 21] + q0, M[k, 22] + q1, M[k, 23] + q2
            M[k, 24], M[k, 25], M[k, 26] = M[k, 24] + q3, M[k, 25] + q4, M[k, 26] + q5


@njit(cache=True, error_model="numpy")
def solve(
    joint_table: Int64, order: Int64, xi: Float64, D: Float64, e: Float64, x: Float64, residuals: Float64,
    weights: Float64, work: Elimination, delta: Float64,
) -> None:  # fmt: skip
    """Compute the best small motion of a tree towards measured joints, by the articulated-body algorithm.

    Args:
        joint_table, order: (joints, 6), (joints,) of `ArticulatedModel`.
        xi: (dofs, 6) twists of `forward`.
        D, e: (dofs,) prior information [1/m², 1/rad²] and prior mean [m, rad] of each degree of freedom's small motion.
        x: (joints, 3) estimated joints of `forward` [m].
        residuals: (joints, 3) measured − estimated [m]; read where the weight is above 0. With information matrices Λ:
            their products Λ r with these residuals [1/m].
        weights: (joints,) 1/variance [1/m²]; or (joints, 6) information matrices Λ, upper triangles, row by row; 0
            where not measured.
        work: written; `marginals` reads its U and d.
        delta: (dofs,) written: the small motion [m, rad].
    """
    _eliminate(joint_table, order, xi, D, e, x, residuals, weights, work)
    U, a = work.U, work.a
    for o in range(len(order)):
        j = order[o]
        k, first = joint_table[j, 0], joint_table[j, 1]
        a0 = a1 = a2 = a3 = a4 = a5 = 0.0
        if k >= 0:
            a0, a1, a2 = a[k, 0], a[k, 1], a[k, 2]
            a3, a4, a5 = a[k, 3], a[k, 4], a[k, 5]
        for i in range(first, first + joint_table[j, 2]):
            moved = U[i, 0] * a0 + U[i, 1] * a1 + U[i, 2] * a2 + U[i, 3] * a3 + U[i, 4] * a4 + U[i, 5] * a5
            f = (work.u[i] - moved) / work.d[i]
            delta[i] = f
            a0, a1, a2 = a0 + xi[i, 0] * f, a1 + xi[i, 1] * f, a2 + xi[i, 2] * f
            a3, a4, a5 = a3 + xi[i, 3] * f, a4 + xi[i, 4] * f, a5 + xi[i, 5] * f
        a[j, 0], a[j, 1], a[j, 2] = a0, a1, a2
        a[j, 3], a[j, 4], a[j, 5] = a3, a4, a5


@njit(cache=True, error_model="numpy")
def marginals(
    joint_table: Int64, order: Int64, xi: Float64, U: Float64, d: Float64, x: Float64, C: Float64, dofs: Float64,
    joints: Float64,
) -> None:  # fmt: skip
    """Compute the marginal variances of an estimate's degrees of freedom and joints.

    U = 0 and d = 1/P give the variances of a tree whose degrees of freedom are independent, of variances P.

    Args:
        joint_table, order: (joints, 6), (joints,) of `ArticulatedModel`.
        xi, U, d: (dofs, 6), (dofs, 6), (dofs,) of `solve`.
        x: (joints, 3) estimated joints of `forward` [m].
        C: (joints, 21) written: covariance of the small motion of each bone, a twist; upper triangle, row by row.
        dofs: (dofs,) written: variances [m², rad²].
        joints: (joints,) written: variance of a coordinate, a third of the trace of the joint's covariance [m²].
    """
    for o in range(len(order)):
        j = order[o]
        k, first = joint_table[j, 0], joint_table[j, 1]
        c00 = c01 = c02 = c03 = c04 = c05 = c11 = c12 = c13 = c14 = c15 = 0.0
        c22 = c23 = c24 = c25 = c33 = c34 = c35 = c44 = c45 = c55 = 0.0
        if k >= 0:
            c00, c01, c02 = C[k, 0], C[k, 1], C[k, 2]
            c03, c04, c05 = C[k, 3], C[k, 4], C[k, 5]
            c11, c12, c13 = C[k, 6], C[k, 7], C[k, 8]
            c14, c15 = C[k, 9], C[k, 10]
            c22, c23, c24 = C[k, 11], C[k, 12], C[k, 13]
            c25, c33, c34 = C[k, 14], C[k, 15], C[k, 16]
            c35, c44, c45 = C[k, 17], C[k, 18], C[k, 19]
            c55 = C[k, 20]
        for i in range(first, first + joint_table[j, 2]):
            t0, t1, t2 = xi[i, 0], xi[i, 1], xi[i, 2]
            t3, t4, t5 = xi[i, 3], xi[i, 4], xi[i, 5]
            u0, u1, u2 = U[i, 0], U[i, 1], U[i, 2]
            u3, u4, u5 = U[i, 3], U[i, 4], U[i, 5]
            g = 1.0 / d[i]
            w0 = g * (c00 * u0 + c01 * u1 + c02 * u2 + c03 * u3 + c04 * u4 + c05 * u5)
            w1 = g * (c01 * u0 + c11 * u1 + c12 * u2 + c13 * u3 + c14 * u4 + c15 * u5)
            w2 = g * (c02 * u0 + c12 * u1 + c22 * u2 + c23 * u3 + c24 * u4 + c25 * u5)
            w3 = g * (c03 * u0 + c13 * u1 + c23 * u2 + c33 * u3 + c34 * u4 + c35 * u5)
            w4 = g * (c04 * u0 + c14 * u1 + c24 * u2 + c34 * u3 + c44 * u4 + c45 * u5)
            w5 = g * (c05 * u0 + c15 * u1 + c25 * u2 + c35 * u3 + c45 * u4 + c55 * u5)
            s = g * (1.0 + u0 * w0 + u1 * w1 + u2 * w2 + u3 * w3 + u4 * w4 + u5 * w5)
            dofs[i] = s
            h0, h1, h2 = s * t0 - w0, s * t1 - w1, s * t2 - w2
            h3, h4, h5 = s * t3 - w3, s * t4 - w4, s * t5 - w5
            c00 += h0 * t0 - t0 * w0
            c01 += h0 * t1 - t0 * w1
            c02 += h0 * t2 - t0 * w2
            c03 += h0 * t3 - t0 * w3
            c04 += h0 * t4 - t0 * w4
            c05 += h0 * t5 - t0 * w5
            c11 += h1 * t1 - t1 * w1
            c12 += h1 * t2 - t1 * w2
            c13 += h1 * t3 - t1 * w3
            c14 += h1 * t4 - t1 * w4
            c15 += h1 * t5 - t1 * w5
            c22 += h2 * t2 - t2 * w2
            c23 += h2 * t3 - t2 * w3
            c24 += h2 * t4 - t2 * w4
            c25 += h2 * t5 - t2 * w5
            c33 += h3 * t3 - t3 * w3
            c34 += h3 * t4 - t3 * w4
            c35 += h3 * t5 - t3 * w5
            c44 += h4 * t4 - t4 * w4
            c45 += h4 * t5 - t4 * w5
            c55 += h5 * t5 - t5 * w5
        C[j, 0], C[j, 1], C[j, 2] = c00, c01, c02
        C[j, 3], C[j, 4], C[j, 5] = c03, c04, c05
        C[j, 6], C[j, 7], C[j, 8] = c11, c12, c13
        C[j, 9], C[j, 10] = c14, c15
        C[j, 11], C[j, 12], C[j, 13] = c22, c23, c24
        C[j, 14], C[j, 15], C[j, 16] = c25, c33, c34
        C[j, 17], C[j, 18], C[j, 19] = c35, c44, c45
        C[j, 20] = c55
        f, g, h = x[j, 0], x[j, 1], x[j, 2]
        turned = (g * g + h * h) * c00 + (f * f + h * h) * c11 + (f * f + g * g) * c22
        turned -= 2.0 * (f * g * c01 + f * h * c02 + g * h * c12)
        both = h * (c04 - c13) + g * (c23 - c05) + f * (c15 - c24)
        joints[j] = (c33 + c44 + c55 + turned - 2.0 * both) / 3.0


@njit(cache=True, error_model="numpy")
def independent(
    joint_table: Int64, order: Int64, xi: Float64, row: Float64, variance: int, x: Float64, C: Float64, joints: Float64
) -> None:
    """Compute the joint variances of `marginals` for independent degrees of freedom.

    Args:
        joint_table, order, xi, x, joints: (joints, 6), (joints,), (dofs, 6), (joints, 3) [m] and (joints,) result [m²],
            as in `marginals`.
        row, variance: the variance of degree of freedom i is row[variance + i], as in a body's memory.
        C: (joints, 10) written: intermediate sums.
    """
    for o in range(len(order)):
        j = order[o]
        k, first = joint_table[j, 0], joint_table[j, 1]
        c00 = c01 = c02 = c11 = c12 = c22 = b0 = b1 = b2 = v = 0.0
        if k >= 0:
            c00, c01, c02 = C[k, 0], C[k, 1], C[k, 2]
            c11, c12, c22 = C[k, 3], C[k, 4], C[k, 5]
            b0, b1, b2 = C[k, 6], C[k, 7], C[k, 8]
            v = C[k, 9]
        for i in range(first, first + joint_table[j, 2]):
            t0, t1, t2 = xi[i, 0], xi[i, 1], xi[i, 2]
            t3, t4, t5 = xi[i, 3], xi[i, 4], xi[i, 5]
            s = row[variance + i]
            w0, w1, w2 = s * t0, s * t1, s * t2
            c00 += w0 * t0
            c01 += w0 * t1
            c02 += w0 * t2
            c11 += w1 * t1
            c12 += w1 * t2
            c22 += w2 * t2
            b0 += w1 * t5 - w2 * t4
            b1 += w2 * t3 - w0 * t5
            b2 += w0 * t4 - w1 * t3
            v += s * (t3 * t3 + t4 * t4 + t5 * t5)
        C[j, 0], C[j, 1], C[j, 2] = c00, c01, c02
        C[j, 3], C[j, 4], C[j, 5] = c11, c12, c22
        C[j, 6], C[j, 7], C[j, 8] = b0, b1, b2
        C[j, 9] = v
        f, g, h = x[j, 0], x[j, 1], x[j, 2]
        turned = (g * g + h * h) * c00 + (f * f + h * h) * c11 + (f * f + g * g) * c22
        turned -= 2.0 * (f * g * c01 + f * h * c02 + g * h * c12)
        joints[j] = (v + turned - 2.0 * (f * b0 + g * b1 + h * b2)) / 3.0
