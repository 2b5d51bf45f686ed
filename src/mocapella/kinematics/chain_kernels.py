"""A tree of twists: where its joints are, and the small motion that fits measured joints best; compiled.

Every degree of freedom i is a twist ξ_i = (ω, v): it moves the point x by v + ω × x. Points, twists and motions are told
about one origin, with the axes of the world. Importing this module imports numba.

The best small motion δ minimises Σ_j w_j |J_j δ − r_j|² + Σ_i D_i (δ_i − e_i)². Its normal matrix is that of a tree of
rigid bodies: the w_j are the masses, D_i the inertia of the joints' rotors, r_j and e_i the forces. So it is solved,
exactly and without ever being written down, as forward dynamics are, by the articulated-body algorithm (R. Featherstone,
Rigid Body Dynamics Algorithms, 2008, section 7.3), in a time that is linear in the degrees of freedom. That this is a
Kalman filter inwards and a smoother outwards along the tree is due to G. Rodriguez, Kalman Filtering, Smoothing, and
Recursive Robot Arm Forward and Inverse Dynamics, IEEE Journal of Robotics and Automation 3 (1987): the smoother's
covariances are the marginal ones of the estimate.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np
from numba import njit

from mocapella.kinematics.articulated_model import ABOUT, OF_BALL


@njit(cache=True)
def times(A, B, C):  # type: ignore[no-untyped-def]
    """Write A·B into C, all (3, 3) and C neither of them."""
    for i in range(3):
        for k in range(3):
            C[i, k] = A[i, 0] * B[0, k] + A[i, 1] * B[1, k] + A[i, 2] * B[2, k]


@njit(cache=True)
def exp_rotation(x, y, z, R):  # type: ignore[no-untyped-def]
    """Write the rotation by the vector (x, y, z) [rad] into R (3, 3) (Rodrigues' formula)."""
    s = x * x + y * y + z * z
    if s < 1e-8:
        a, b = 1.0 - s / 6.0, 0.5 - s / 24.0
    else:
        angle = np.sqrt(s)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / s
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@njit(cache=True)
def log_rotation(R):  # type: ignore[no-untyped-def]
    """The vector [rad] of a rotation (3, 3), the inverse of `exp_rotation` for angles below π.

    At π the axis has two signs; one of them is taken.
    """
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-3 or cosine > 0.0:
        f = 0.5 + sine * sine / 12.0 if sine < 1e-4 else 0.5 * angle / sine
        return f * x, f * y, f * z
    k = 0  # close to π: the column of R + 1 that is longest
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    a, b, c = R[0, k], R[1, k], R[2, k]
    if k == 0:
        a += 1.0
    elif k == 1:
        b += 1.0
    else:
        c += 1.0
    f = angle / np.sqrt(a * a + b * b + c * c)
    if a * x + b * y + c * z < 0.0:
        f = -f
    return f * a, f * b, f * c


@njit(cache=True)
def orthonormal(R):  # type: ignore[no-untyped-def]
    """Take the rounding errors of many small turns out of R (3, 3): Gram–Schmidt."""
    n = 1.0 / np.sqrt(R[0, 0] ** 2 + R[1, 0] ** 2 + R[2, 0] ** 2)
    ax, ay, az = n * R[0, 0], n * R[1, 0], n * R[2, 0]
    d = ax * R[0, 1] + ay * R[1, 1] + az * R[2, 1]
    bx, by, bz = R[0, 1] - d * ax, R[1, 1] - d * ay, R[2, 1] - d * az
    n = 1.0 / np.sqrt(bx * bx + by * by + bz * bz)
    bx, by, bz = n * bx, n * by, n * bz
    R[0, 0], R[1, 0], R[2, 0] = ax, ay, az
    R[0, 1], R[1, 1], R[2, 1] = bx, by, bz
    R[0, 2], R[1, 2], R[2, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True)
def forward(dof_kind, joint_table, joint_values, order, angles, balls, lengths, origin, x, R, xi):  # type: ignore[no-untyped-def]
    """Forward kinematics: write the joints x (joints, 3), told from the origin, and the twists xi (dofs, 6).

    Args:
        dof_kind, joint_table, joint_values, order: of `ArticulatedModel`.
        angles: (dofs,) the root's position [m], then angles [rad]; those of balls are not read.
        balls: (balls, 3, 3) the rotations of the joints that turn every way, the root's first.
        lengths: (lengths,) [m].
        origin: (3,) [m].
        x, R, xi: (joints, 3) [m], (joints, 3, 3) frames of the bones, (dofs, 6).
    """
    for j in order:
        parent, first, count, ball = joint_table[j, 0], joint_table[j, 1], joint_table[j, 2], joint_table[j, 3]
        r = R[j]
        if parent < 0:
            r[:] = balls[0]
            ox, oy, oz = angles[0] - origin[0], angles[1] - origin[1], angles[2] - origin[2]
            for k in range(3):
                xi[k, 0] = xi[k, 1] = xi[k, 2] = 0.0
                xi[k, 3], xi[k, 4], xi[k, 5] = r[0, k], r[1, k], r[2, k]
            first += 3
            count = 3
        else:
            ox, oy, oz = x[parent, 0], x[parent, 1], x[parent, 2]
            if ball >= 0:
                times(R[parent], balls[ball], r)
            else:
                r[:] = R[parent]
        for i in range(first, first + count):
            kind = dof_kind[i]
            axis = kind - ABOUT if kind < OF_BALL else kind - OF_BALL
            ax, ay, az = r[0, axis], r[1, axis], r[2, axis]
            xi[i, 0], xi[i, 1], xi[i, 2] = ax, ay, az
            xi[i, 3], xi[i, 4], xi[i, 5] = oy * az - oz * ay, oz * ax - ox * az, ox * ay - oy * ax
            if kind < OF_BALL:
                c, s = np.cos(angles[i]), np.sin(angles[i])
                a = axis + 1 if axis < 2 else 0
                b = 3 - axis - a
                for k in range(3):
                    u, v = r[k, a], r[k, b]
                    r[k, a], r[k, b] = c * u + s * v, c * v - s * u
        if parent < 0:
            x[j, 0], x[j, 1], x[j, 2] = ox, oy, oz
        else:
            length = lengths[joint_table[j, 5]]
            dx, dy, dz = length * joint_values[j, 0], length * joint_values[j, 1], length * joint_values[j, 2]
            x[j, 0] = ox + r[0, 0] * dx + r[0, 1] * dy + r[0, 2] * dz
            x[j, 1] = oy + r[1, 0] * dx + r[1, 1] * dy + r[1, 2] * dz
            x[j, 2] = oz + r[2, 0] * dx + r[2, 1] * dy + r[2, 2] * dz


@njit(cache=True)
def attach(joint_table, x, residuals, weights, I, p):  # type: ignore[no-untyped-def]
    """Put the measured joints on the tree: write the information I (dofs, 6, 6) and its vector p (dofs, 6).

    Args:
        joint_table: of `ArticulatedModel`.
        x: (joints, 3) where they are estimated, from the origin [m].
        residuals: (joints, 3) measured − estimated [m]; read where the weight is above 0.
        weights: (joints,) 1/variance [1/m²].
        I, p: written.
    """
    I[:] = 0.0
    p[:] = 0.0
    for j in range(len(weights)):
        w = weights[j]
        if w <= 0.0:
            continue
        i = joint_table[j, 4]
        a, b, c = x[j]
        u, v, t = w * residuals[j, 0], w * residuals[j, 1], w * residuals[j, 2]
        p[i, 0] += b * t - c * v
        p[i, 1] += c * u - a * t
        p[i, 2] += a * v - b * u
        p[i, 3] += u
        p[i, 4] += v
        p[i, 5] += t
        M = I[i]
        wa, wb, wc = w * a, w * b, w * c
        M[0, 0] += wb * b + wc * c
        M[1, 1] += wa * a + wc * c
        M[2, 2] += wa * a + wb * b
        M[0, 1] -= wa * b
        M[0, 2] -= wa * c
        M[1, 2] -= wb * c
        M[1, 0], M[2, 0], M[2, 1] = M[0, 1], M[0, 2], M[1, 2]
        M[3, 3] += w
        M[4, 4] += w
        M[5, 5] += w
        M[0, 4] -= wc
        M[0, 5] += wb
        M[1, 3] += wc
        M[1, 5] -= wa
        M[2, 3] -= wb
        M[2, 4] += wa
        for r in range(3):
            for s in range(3, 6):
                M[s, r] = M[r, s]


@njit(cache=True)
def solve(dof_parent, xi, D, e, I, p, U, d, u, a, delta):  # type: ignore[no-untyped-def]
    """Write the best small motion delta (dofs,); the articulated-body algorithm, inwards and outwards.

    Args:
        dof_parent: (dofs,).
        xi: (dofs, 6) twists.
        D, e: (dofs,) information of each degree of freedom of its own, and about which value.
        I, p: of `attach`; overwritten.
        U, d, u, a: (dofs, 6), (dofs,), (dofs,), (dofs, 6): written; U and d are what `marginals` takes.
        delta: written.
    """
    n = len(dof_parent)
    for i in range(n - 1, -1, -1):
        M, q, t, V = I[i], p[i], xi[i], U[i]
        s, f = D[i], D[i] * e[i]
        for r in range(6):
            V[r] = M[r, 0] * t[0] + M[r, 1] * t[1] + M[r, 2] * t[2] + M[r, 3] * t[3] + M[r, 4] * t[4] + M[r, 5] * t[5]
            f += t[r] * q[r]
        for r in range(6):
            s += t[r] * V[r]
        d[i], u[i] = s, f
        k = dof_parent[i]
        if k >= 0:
            N, o = I[k], p[k]
            g = 1.0 / s
            h = f * g
            for r in range(6):
                o[r] += q[r] - V[r] * h
                w = V[r] * g
                for c in range(6):
                    N[r, c] += M[r, c] - w * V[c]
    for i in range(n):
        k, V, t, m = dof_parent[i], U[i], xi[i], a[i]
        f = u[i]
        if k >= 0:
            b = a[k]
            for r in range(6):
                f -= V[r] * b[r]
                m[r] = b[r]
        else:
            m[:] = 0.0
        f /= d[i]
        delta[i] = f
        for r in range(6):
            m[r] += t[r] * f


@njit(cache=True)
def marginals(dof_parent, xi, U, d, C, variances):  # type: ignore[no-untyped-def]
    """Write the marginal variances (dofs,) of the estimate, and the covariances C (dofs, 6, 6) of what they move.

    With U = 0 and d = 1/P they are those of independent degrees of freedom of variances P.
    """
    w = np.empty(6)
    for i in range(len(dof_parent)):
        k, V, t, B = dof_parent[i], U[i], xi[i], C[i]
        g = 1.0 / d[i]
        if k < 0:
            variances[i] = g
            for r in range(6):
                for c in range(6):
                    B[r, c] = t[r] * t[c] * g
            continue
        A = C[k]
        s = 0.0
        for r in range(6):
            w[r] = g * (
                A[r, 0] * V[0] + A[r, 1] * V[1] + A[r, 2] * V[2] + A[r, 3] * V[3] + A[r, 4] * V[4] + A[r, 5] * V[5]
            )
        for r in range(6):
            s += V[r] * w[r]
        s = g * s + g
        variances[i] = s
        for r in range(6):
            h = s * t[r] - w[r]
            for c in range(6):
                B[r, c] = A[r, c] + h * t[c] - t[r] * w[c]


@njit(cache=True)
def independent(dof_parent, xi, P, C):  # type: ignore[no-untyped-def]
    """Write the covariances C (dofs, 6, 6) of the motions of a tree with independent variances P (dofs,)."""
    for i in range(len(dof_parent)):
        k, t, B = dof_parent[i], xi[i], C[i]
        for r in range(6):
            h = P[i] * t[r]
            for c in range(6):
                B[r, c] = h * t[c] + (C[k, r, c] if k >= 0 else 0.0)


@njit(cache=True)
def joint_variances(joint_table, x, C, out):  # type: ignore[no-untyped-def]
    """Write the variance of a coordinate of each joint, (joints,) [m²]: a third of the trace of its covariance."""
    for j in range(len(out)):
        M = C[joint_table[j, 4]]
        a, b, c = x[j]
        turned = (
            (b * b + c * c) * M[0, 0] + (a * a + c * c) * M[1, 1] + (a * a + b * b) * M[2, 2]
            - 2.0 * (a * b * M[0, 1] + a * c * M[0, 2] + b * c * M[1, 2])
        )  # fmt: skip
        both = c * (M[0, 4] - M[1, 3]) + b * (M[2, 3] - M[0, 5]) + a * (M[1, 5] - M[2, 4])
        out[j] = (M[3, 3] + M[4, 4] + M[5, 5] + turned - 2.0 * both) / 3.0
