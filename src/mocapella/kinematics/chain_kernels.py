"""A tree of twists: where its joints are, and the small motion that fits measured joints best; compiled.

Every degree of freedom i is a twist ξ_i = (ω, v): it moves the point x by v + ω × x. Points, twists and motions are
told about one origin, with the axes of the world. Importing this module imports numba.

The best small motion δ minimises Σ_j w_j |J_j δ − r_j|² + Σ_i D_i (δ_i − e_i)². Its normal matrix is the joint-space
inertia matrix of a tree of point masses w_j with rotors of inertia D_i. So it is solved as forward dynamics are,
exactly and without being written down, by the articulated-body algorithm (R. Featherstone, Rigid Body Dynamics
Algorithms, 2008, section 7.3), in a time that is linear in the degrees of freedom. That this is a Kalman filter inwards
along the tree, and a smoother outwards, is due to G. Rodriguez (Kalman Filtering, Smoothing, and Recursive Robot Arm
Forward and Inverse Dynamics, IEEE Journal of Robotics and Automation 3, 1987): the smoother's covariances are the
marginal ones of the estimate.

A symmetric (6, 6) matrix is held as its upper triangle, row by row, in 21 numbers, and written out: loops over so few
numbers take twice as long.
"""

# ruff: noqa: PLR0915, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST, turned
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL

_IDENTITY = np.eye(3).reshape(9)


@njit(cache=True)
def swing(ox, oy, oz, dx, dy, dz, out):
    """Write the shortest rotation from the unit direction o to the unit direction d into out (9,)."""
    x, y, z = oy * dz - oz * dy, oz * dx - ox * dz, ox * dy - oy * dx
    sine, cosine = np.sqrt(x * x + y * y + z * z), ox * dx + oy * dy + oz * dz
    f = np.arctan2(sine, cosine) / sine if sine > 1e-9 else 0.0
    if f == 0.0 and cosine < 0.0:  # opposite: half a turn about any axis across
        x, y, z = (-oy, ox, 0.0) if abs(oz) < 0.9 else (0.0, -oz, oy)
        f = np.pi / np.sqrt(x * x + y * y + z * z)
    turned(_IDENTITY, FIRST, f * x, f * y, f * z, out)


@njit(cache=True)
def limited(values, B, out):
    """Write the rotation B (9,) of a ball, brought within its limits, into out (9,); whether it was not.

    Swing and twist: the shortest turn of the bone from its rest direction to where it is, after a turn about itself.
    The swing goes straight back to the edge of the cone.

    Args:
        values: (10,) the joint's of `ArticulatedModel.joint_values`.
        B: as it is.
        out: B itself where it is within.
    """
    ox, oy, oz = values[0], values[1], values[2]
    dx = B[0] * ox + B[1] * oy + B[2] * oz
    dy = B[3] * ox + B[4] * oy + B[5] * oz
    dz = B[6] * ox + B[7] * oy + B[8] * oz
    cx, cy, cz = values[4], values[5], values[6]
    along = dx * cx + dy * cy + dz * cz
    # Of the quaternion, the part along the bone over the real part.
    twist = 2.0 * np.arctan2((B[7] - B[5]) * ox + (B[2] - B[6]) * oy + (B[3] - B[1]) * oz, 1.0 + B[0] + B[4] + B[8])
    allowed = min(max(twist, values[8]), values[9])
    cosine = np.cos(values[7])
    for i in range(9):
        out[i] = B[i]
    if along >= cosine and allowed == twist:
        return False
    if along < cosine:
        px, py, pz = dx - along * cx, dy - along * cy, dz - along * cz
        n = np.sqrt(px * px + py * py + pz * pz)
        f = np.sin(values[7]) / n if n > 0.0 else 0.0
        dx, dy, dz = cosine * cx + f * px, cosine * cy + f * py, cosine * cz + f * pz
    S = np.empty(9)
    swing(ox, oy, oz, dx, dy, dz, S)
    turned(S, FIRST, allowed * ox, allowed * oy, allowed * oz, out)
    return True


@njit(cache=True)
def forward(dof_kind, joint_table, joint_values, order, angles, balls, lengths, origin, x, R, xi):
    """Forward kinematics: write the joints x (joints, 3), told from the origin, and the twists xi (dofs, 6).

    Args:
        dof_kind, joint_table, joint_values, order: of `ArticulatedModel`.
        angles: (dofs,) the root's position [m], then angles [rad]; those of balls are not read.
        balls: (balls, 9) the rotations of the joints that turn every way, the root's first.
        lengths: (lengths,) [m].
        origin: (3,) [m].
        x, R, xi: (joints, 3) [m], (joints, 9) frames of the bones row by row, (dofs, 6).
    """
    for j in order:
        parent, first, ball = joint_table[j, 0], joint_table[j, 1], joint_table[j, 3]
        last = first + joint_table[j, 2]
        if parent < 0:
            ox, oy, oz = angles[0] - origin[0], angles[1] - origin[1], angles[2] - origin[2]
            a0, a1, a2, a3, a4 = balls[0, 0], balls[0, 1], balls[0, 2], balls[0, 3], balls[0, 4]
            a5, a6, a7, a8 = balls[0, 5], balls[0, 6], balls[0, 7], balls[0, 8]
            for i in range(3):
                xi[i, 0] = xi[i, 1] = xi[i, 2] = 0.0
            xi[0, 3], xi[0, 4], xi[0, 5] = a0, a3, a6
            xi[1, 3], xi[1, 4], xi[1, 5] = a1, a4, a7
            xi[2, 3], xi[2, 4], xi[2, 5] = a2, a5, a8
            first = 3
        else:
            ox, oy, oz = x[parent, 0], x[parent, 1], x[parent, 2]
            a0, a1, a2 = R[parent, 0], R[parent, 1], R[parent, 2]
            a3, a4, a5 = R[parent, 3], R[parent, 4], R[parent, 5]
            a6, a7, a8 = R[parent, 6], R[parent, 7], R[parent, 8]
            if ball >= 0:
                b0, b1, b2, b3 = balls[ball, 0], balls[ball, 1], balls[ball, 2], balls[ball, 3]
                b4, b5, b6, b7, b8 = balls[ball, 4], balls[ball, 5], balls[ball, 6], balls[ball, 7], balls[ball, 8]
                a0, a1, a2 = a0 * b0 + a1 * b3 + a2 * b6, a0 * b1 + a1 * b4 + a2 * b7, a0 * b2 + a1 * b5 + a2 * b8
                a3, a4, a5 = a3 * b0 + a4 * b3 + a5 * b6, a3 * b1 + a4 * b4 + a5 * b7, a3 * b2 + a4 * b5 + a5 * b8
                a6, a7, a8 = a6 * b0 + a7 * b3 + a8 * b6, a6 * b1 + a7 * b4 + a8 * b7, a6 * b2 + a7 * b5 + a8 * b8
        for i in range(first, last):
            kind = dof_kind[i]
            hinge = kind < OF_BALL
            axis = kind - ABOUT if hinge else kind - OF_BALL
            c, s = (np.cos(angles[i]), np.sin(angles[i])) if hinge else (1.0, 0.0)
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
            xi[i, 0], xi[i, 1], xi[i, 2] = u, v, w
            xi[i, 3], xi[i, 4], xi[i, 5] = oy * w - oz * v, oz * u - ox * w, ox * v - oy * u
        R[j, 0], R[j, 1], R[j, 2], R[j, 3], R[j, 4], R[j, 5], R[j, 6], R[j, 7], R[j, 8] = (
            a0, a1, a2, a3, a4, a5, a6, a7, a8
        )  # fmt: skip
        if parent >= 0:
            length = lengths[joint_table[j, 4]]
            dx, dy, dz = length * joint_values[j, 0], length * joint_values[j, 1], length * joint_values[j, 2]
            ox += a0 * dx + a1 * dy + a2 * dz
            oy += a3 * dx + a4 * dy + a5 * dz
            oz += a6 * dx + a7 * dy + a8 * dz
        x[j, 0], x[j, 1], x[j, 2] = ox, oy, oz


@njit(cache=True, error_model="numpy")
def solve(joint_table, order, xi, D, e, x, residuals, weights, M, U, d, u, a, delta):
    """Write the best small motion delta (dofs,); the articulated-body algorithm, inwards and outwards.

    Args:
        joint_table, order: of `ArticulatedModel`.
        xi: (dofs, 6) twists.
        D, e: (dofs,) information of each degree of freedom of its own, and about which value.
        x: (joints, 3) where the joints are estimated [m].
        residuals: (joints, 3) measured − estimated [m]; read where the weight is above 0.
        weights: (joints,) 1/variance [1/m²].
        M, a: (joints, 27), (joints, 6): written.
        U, d, u: (dofs, 6), (dofs,), (dofs,): written; U and d are what `marginals` takes.
        delta: written.
    """
    for j in range(len(M)):
        for i in range(27):
            M[j, i] = 0.0
    for o in range(len(order) - 1, -1, -1):
        j = order[o]
        m00, m01, m02, m03, m04, m05 = M[j, 0], M[j, 1], M[j, 2], M[j, 3], M[j, 4], M[j, 5]
        m11, m12, m13, m14, m15 = M[j, 6], M[j, 7], M[j, 8], M[j, 9], M[j, 10]
        m22, m23, m24, m25, m33, m34 = M[j, 11], M[j, 12], M[j, 13], M[j, 14], M[j, 15], M[j, 16]
        m35, m44, m45, m55 = M[j, 17], M[j, 18], M[j, 19], M[j, 20]
        q0, q1, q2, q3, q4, q5 = M[j, 21], M[j, 22], M[j, 23], M[j, 24], M[j, 25], M[j, 26]
        w = weights[j]
        if w > 0.0:  # the point: [x]× on the one hand, 1 on the other
            f, g, h = x[j, 0], x[j, 1], x[j, 2]
            wf, wg, wh = w * f, w * g, w * h
            r0, r1, r2 = w * residuals[j, 0], w * residuals[j, 1], w * residuals[j, 2]
            m00 += wg * g + wh * h
            m11 += wf * f + wh * h
            m22 += wf * f + wg * g
            m01 -= wf * g
            m02 -= wf * h
            m12 -= wg * h
            m04 -= wh
            m05 += wg
            m13 += wh
            m15 -= wf
            m23 -= wg
            m24 += wf
            m33 += w
            m44 += w
            m55 += w
            q0 += g * r2 - h * r1
            q1 += h * r0 - f * r2
            q2 += f * r1 - g * r0
            q3 += r0
            q4 += r1
            q5 += r2
        first = joint_table[j, 1]
        for i in range(first + joint_table[j, 2] - 1, first - 1, -1):
            t0, t1, t2, t3, t4, t5 = xi[i, 0], xi[i, 1], xi[i, 2], xi[i, 3], xi[i, 4], xi[i, 5]
            u0 = m00 * t0 + m01 * t1 + m02 * t2 + m03 * t3 + m04 * t4 + m05 * t5
            u1 = m01 * t0 + m11 * t1 + m12 * t2 + m13 * t3 + m14 * t4 + m15 * t5
            u2 = m02 * t0 + m12 * t1 + m22 * t2 + m23 * t3 + m24 * t4 + m25 * t5
            u3 = m03 * t0 + m13 * t1 + m23 * t2 + m33 * t3 + m34 * t4 + m35 * t5
            u4 = m04 * t0 + m14 * t1 + m24 * t2 + m34 * t3 + m44 * t4 + m45 * t5
            u5 = m05 * t0 + m15 * t1 + m25 * t2 + m35 * t3 + m45 * t4 + m55 * t5
            s = D[i] + t0 * u0 + t1 * u1 + t2 * u2 + t3 * u3 + t4 * u4 + t5 * u5
            f = D[i] * e[i] + t0 * q0 + t1 * q1 + t2 * q2 + t3 * q3 + t4 * q4 + t5 * q5
            d[i], u[i] = s, f
            U[i, 0], U[i, 1], U[i, 2], U[i, 3], U[i, 4], U[i, 5] = u0, u1, u2, u3, u4, u5
            g = 1.0 / s
            f *= g
            q0 -= u0 * f
            q1 -= u1 * f
            q2 -= u2 * f
            q3 -= u3 * f
            q4 -= u4 * f
            q5 -= u5 * f
            w0, w1, w2, w3, w4 = g * u0, g * u1, g * u2, g * u3, g * u4
            m00, m01, m02 = m00 - w0 * u0, m01 - w0 * u1, m02 - w0 * u2
            m03, m04, m05 = m03 - w0 * u3, m04 - w0 * u4, m05 - w0 * u5
            m11, m12, m13, m14, m15 = m11 - w1 * u1, m12 - w1 * u2, m13 - w1 * u3, m14 - w1 * u4, m15 - w1 * u5
            m22, m23, m24, m25 = m22 - w2 * u2, m23 - w2 * u3, m24 - w2 * u4, m25 - w2 * u5
            m33, m34, m35 = m33 - w3 * u3, m34 - w3 * u4, m35 - w3 * u5
            m44, m45, m55 = m44 - w4 * u4, m45 - w4 * u5, m55 - g * u5 * u5
        k = joint_table[j, 0]
        if k >= 0:
            M[k, 0] += m00
            M[k, 1] += m01
            M[k, 2] += m02
            M[k, 3] += m03
            M[k, 4] += m04
            M[k, 5] += m05
            M[k, 6] += m11
            M[k, 7] += m12
            M[k, 8] += m13
            M[k, 9] += m14
            M[k, 10] += m15
            M[k, 11] += m22
            M[k, 12] += m23
            M[k, 13] += m24
            M[k, 14] += m25
            M[k, 15] += m33
            M[k, 16] += m34
            M[k, 17] += m35
            M[k, 18] += m44
            M[k, 19] += m45
            M[k, 20] += m55
            M[k, 21] += q0
            M[k, 22] += q1
            M[k, 23] += q2
            M[k, 24] += q3
            M[k, 25] += q4
            M[k, 26] += q5
    for j in order:
        k, first = joint_table[j, 0], joint_table[j, 1]
        a0 = a1 = a2 = a3 = a4 = a5 = 0.0
        if k >= 0:
            a0, a1, a2, a3, a4, a5 = a[k, 0], a[k, 1], a[k, 2], a[k, 3], a[k, 4], a[k, 5]
        for i in range(first, first + joint_table[j, 2]):
            moved = U[i, 0] * a0 + U[i, 1] * a1 + U[i, 2] * a2 + U[i, 3] * a3 + U[i, 4] * a4 + U[i, 5] * a5
            f = (u[i] - moved) / d[i]
            delta[i] = f
            a0, a1, a2 = a0 + xi[i, 0] * f, a1 + xi[i, 1] * f, a2 + xi[i, 2] * f
            a3, a4, a5 = a3 + xi[i, 3] * f, a4 + xi[i, 4] * f, a5 + xi[i, 5] * f
        a[j, 0], a[j, 1], a[j, 2], a[j, 3], a[j, 4], a[j, 5] = a0, a1, a2, a3, a4, a5


@njit(cache=True, error_model="numpy")
def marginals(joint_table, order, xi, U, d, x, C, dofs, joints):
    """Write the marginal variances of an estimate: of its degrees of freedom and of its joints.

    With U = 0 and d = 1/P they are those of a tree whose degrees of freedom are independent, of variances P.

    Args:
        joint_table, order: of `ArticulatedModel`.
        xi, U, d: (dofs, 6), (dofs, 6), (dofs,) of `solve`.
        x: (joints, 3) [m].
        C: (joints, 21) written: the covariance of the motion of each bone.
        dofs: (dofs,) written.
        joints: (joints,) written: the variance of a coordinate, a third of the trace of the joint's covariance [m²].
    """
    for j in order:
        k, first = joint_table[j, 0], joint_table[j, 1]
        c00 = c01 = c02 = c03 = c04 = c05 = c11 = c12 = c13 = c14 = c15 = 0.0
        c22 = c23 = c24 = c25 = c33 = c34 = c35 = c44 = c45 = c55 = 0.0
        if k >= 0:
            c00, c01, c02, c03, c04, c05 = C[k, 0], C[k, 1], C[k, 2], C[k, 3], C[k, 4], C[k, 5]
            c11, c12, c13, c14, c15 = C[k, 6], C[k, 7], C[k, 8], C[k, 9], C[k, 10]
            c22, c23, c24, c25, c33, c34 = C[k, 11], C[k, 12], C[k, 13], C[k, 14], C[k, 15], C[k, 16]
            c35, c44, c45, c55 = C[k, 17], C[k, 18], C[k, 19], C[k, 20]
        for i in range(first, first + joint_table[j, 2]):
            t0, t1, t2, t3, t4, t5 = xi[i, 0], xi[i, 1], xi[i, 2], xi[i, 3], xi[i, 4], xi[i, 5]
            u0, u1, u2, u3, u4, u5 = U[i, 0], U[i, 1], U[i, 2], U[i, 3], U[i, 4], U[i, 5]
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
        C[j, 0], C[j, 1], C[j, 2], C[j, 3], C[j, 4], C[j, 5] = c00, c01, c02, c03, c04, c05
        C[j, 6], C[j, 7], C[j, 8], C[j, 9], C[j, 10] = c11, c12, c13, c14, c15
        C[j, 11], C[j, 12], C[j, 13], C[j, 14], C[j, 15], C[j, 16] = c22, c23, c24, c25, c33, c34
        C[j, 17], C[j, 18], C[j, 19], C[j, 20] = c35, c44, c45, c55
        f, g, h = x[j, 0], x[j, 1], x[j, 2]
        turned = (g * g + h * h) * c00 + (f * f + h * h) * c11 + (f * f + g * g) * c22
        turned -= 2.0 * (f * g * c01 + f * h * c02 + g * h * c12)
        both = h * (c04 - c13) + g * (c23 - c05) + f * (c15 - c24)
        joints[j] = (c33 + c44 + c55 + turned - 2.0 * both) / 3.0


@njit(cache=True)
def independent(joint_table, order, xi, P, x, C, joints):
    """The joint variances of `marginals` for degrees of freedom that are independent, of variances P (dofs,).

    Only the sums that the joints need are carried along: C (joints, 10) is written.
    """
    for j in order:
        k, first = joint_table[j, 0], joint_table[j, 1]
        c00 = c01 = c02 = c11 = c12 = c22 = b0 = b1 = b2 = v = 0.0
        if k >= 0:
            c00, c01, c02, c11, c12, c22 = C[k, 0], C[k, 1], C[k, 2], C[k, 3], C[k, 4], C[k, 5]
            b0, b1, b2, v = C[k, 6], C[k, 7], C[k, 8], C[k, 9]
        for i in range(first, first + joint_table[j, 2]):
            t0, t1, t2, t3, t4, t5 = xi[i, 0], xi[i, 1], xi[i, 2], xi[i, 3], xi[i, 4], xi[i, 5]
            s = P[i]
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
        C[j, 0], C[j, 1], C[j, 2], C[j, 3], C[j, 4], C[j, 5] = c00, c01, c02, c11, c12, c22
        C[j, 6], C[j, 7], C[j, 8], C[j, 9] = b0, b1, b2, v
        f, g, h = x[j, 0], x[j, 1], x[j, 2]
        turned = (g * g + h * h) * c00 + (f * f + h * h) * c11 + (f * f + g * g) * c22
        turned -= 2.0 * (f * g * c01 + f * h * c02 + g * h * c12)
        joints[j] = (v + turned - 2.0 * (f * b0 + g * b1 + h * b2)) / 3.0
