"""Kernels of a tree of rigid parts and revolute joints: forward kinematics and the Gauss–Newton step of a fit.

Every constraint on a point x of a part costs (x − y)ᵀW(x − y): for a line along n, W = (n·n)1 − n nᵀ, which makes it
|x × n − m|²; for a point, W = 1; for a plane with the normal n, W = n nᵀ. With x = T·(1, x₀), where x₀ is the point at
rest and T the part's motion (translation, then the columns of its rotation), this is a polynomial of the second degree
in T's twelve numbers. So only this polynomial's coefficients are kept for a part: Σ w (1, x₀)(1, x₀)ᵀ ⊗ W, and those of
Wy and yᵀWy. Points are read once, whatever the number of steps.

In a step these sums give each part's symmetric (6, 6) matrix Q and vector b of a small twist. They are added from the
leaves to the root, as inertias of composite bodies are. If i is an ancestor of j, the normal equations are
H_ij = ξ_iᵀ Q ξ_j with the Q of the subtree of j
(R. Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2). Elsewhere H_ij = 0. Factorised
from the leaves to the root, H keeps these zeros (R. Featherstone, Efficient Factorization of the Joint-Space Inertia
Matrix for Branched Kinematic Trees, Int. J. Robotics Research 24, 2005).

Twists are (v, ω): they move the point x by v + ω × x. Points, twists and motions refer to one origin, ``about``,
with the axes of the world. Degrees of freedom are the root's twist, six numbers, and then the joints' angles. Importing
this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST, orthonormal, turn_between, turned
from mocapella.geometry.twist_tree_kernels import forward
from mocapella.kinematics.twist_step_kernels import ROOT, path, step

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

Bool = NDArray[np.bool_]

SUMS = 73
"""Numbers of a part's polynomial.

They are ten products of (1, x₀) by six of W (upper triangles, by rows), then four by Wy, then yᵀWy.
"""
MOTION = 27
"""Numbers of a part's quadratic form of a small twist.

They are the upper triangle of Q's block vv, the block vω, the upper triangle of ωω, and b.
"""
LINES, POINTS, PLANES = np.int64(0), np.int64(1), np.int64(2)
"""Kinds of constraint: a point lies on a line, at a point, or in a plane."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-7, 1e12
_ROUNDING = 1e-13  # of the constant term: costs that differ by less are equal


@njit(cache=True)
def _add_weight(S: Float64, o: int, a: float, s0: float, s1: float, s2: float, s3: float, s4: float, s5: float) -> None:
    S[o] += a * s0
    S[o + 1] += a * s1
    S[o + 2] += a * s2
    S[o + 3] += a * s3
    S[o + 4] += a * s4
    S[o + 5] += a * s5


@njit(cache=True)
def _add_target(S: Float64, o: int, a: float, t0: float, t1: float, t2: float) -> None:
    S[o] += a * t0
    S[o + 1] += a * t1
    S[o + 2] += a * t2


@njit(cache=True)
def add_constraints(
    kind: int, part: Int64, points: Float64, targets: Float64, weights: Float64, about: Float64, sums: Float64,
) -> int:  # fmt: skip
    """Add constraints of one kind to the sums of their parts.

    Args:
        kind: `LINES`, `POINTS` or `PLANES`.
        part: (n,) index of each point's part.
        points: (n, 3) at rest [m].
        targets: in the world: Plücker lines (n, 6), points (n, 3) [m], or planes n·x = d (n, 4), n and then d [m].
        weights: (n,) [1/m²]; points without a positive weight, or with a number that is not finite, are left out.
        about: (3,) origin of the sums, world [m].
        sums: (parts, SUMS) updated.

    Returns:
        Index of the first point with an invalid part, -1 if all are valid.
    """
    f, g, h = about[0], about[1], about[2]
    for k in range(len(part)):
        p, w = part[k], weights[k]
        if p < 0 or p >= len(sums):
            return k
        a, b, c = targets[k, 0], targets[k, 1], targets[k, 2]
        s0, s1, s2, s3, s4, s5 = a * a, a * b, a * c, b * b, b * c, c * c
        if kind == LINES:
            d0, d1, d2 = targets[k, 3] - g * c + h * b, targets[k, 4] - h * a + f * c, targets[k, 5] - f * b + g * a
            t0, t1, t2, t3 = b * d2 - c * d1, c * d0 - a * d2, a * d1 - b * d0, d0 * d0 + d1 * d1 + d2 * d2
            s0, s1, s2, s3, s4, s5 = s3 + s5, -s1, -s2, s0 + s5, -s4, s0 + s3
        elif kind == POINTS:
            s0, s1, s2, s3, s4, s5 = 1.0, 0.0, 0.0, 1.0, 0.0, 1.0
            t0, t1, t2 = a - f, b - g, c - h
            t3 = t0 * t0 + t1 * t1 + t2 * t2
        else:
            d = targets[k, 3] - a * f - b * g - c * h
            t0, t1, t2, t3 = a * d, b * d, c * d, d * d
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if not w > 0.0 or not math.isfinite(w + x + y + z + a + b + c + t3):
            continue
        S, wx, wy, wz = sums[p], w * x, w * y, w * z
        _add_weight(S, 0, w, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 6, wx, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 12, wy, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 18, wz, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 24, wx * x, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 30, wx * y, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 36, wx * z, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 42, wy * y, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 48, wy * z, s0, s1, s2, s3, s4, s5)
        _add_weight(S, 54, wz * z, s0, s1, s2, s3, s4, s5)
        _add_target(S, 60, w, t0, t1, t2)
        _add_target(S, 63, wx, t0, t1, t2)
        _add_target(S, 66, wy, t0, t1, t2)
        _add_target(S, 69, wz, t0, t1, t2)
        S[72] += w * t3
    return -1


@njit(cache=True)
def linearised(sums: Float64, R: Float64, t: Float64, Q: Float64) -> float:
    """Compute the quadratic form of each part's constraints about its present motion; return the constraints' cost.

    Args:
        sums: (parts, SUMS) of `add_constraints`.
        R, t: (parts, 9), (parts, 3) the parts' motions: rotations row by row, translations about the sums' origin [m].
        Q: (parts, MOTION) written.
    """
    cost, T = 0.0, np.empty((4, 3))
    for p in range(len(sums)):
        S, out = sums[p], Q[p]
        for i in range(MOTION):
            out[i] = 0.0
        for i in range(3):
            T[0, i] = t[p, i]
            T[1, i], T[2, i], T[3, i] = R[p, 3 * i], R[p, 3 * i + 1], R[p, 3 * i + 2]
        cost += S[72]
        for i in range(4):
            # M = Σ S_ij [T_j]× and f = h_i − Σ S_ij T_j
            m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0
            f0, f1, f2 = S[60 + 3 * i], S[61 + 3 * i], S[62 + 3 * i]
            h0, h1, h2 = f0, f1, f2
            for j in range(4):
                low, high = min(i, j), max(i, j)
                o = 6 * (low * (7 - low) // 2 + high)
                s0, s1, s2, s3, s4, s5 = S[o], S[o + 1], S[o + 2], S[o + 3], S[o + 4], S[o + 5]
                a, b, c = T[j, 0], T[j, 1], T[j, 2]
                m00, m01, m02 = m00 + s1 * c - s2 * b, m01 + s2 * a - s0 * c, m02 + s0 * b - s1 * a
                m10, m11, m12 = m10 + s3 * c - s4 * b, m11 + s4 * a - s1 * c, m12 + s1 * b - s3 * a
                m20, m21, m22 = m20 + s4 * c - s5 * b, m21 + s5 * a - s2 * c, m22 + s2 * b - s4 * a
                f0 -= s0 * a + s1 * b + s2 * c
                f1 -= s1 * a + s3 * b + s4 * c
                f2 -= s2 * a + s4 * b + s5 * c
            a, b, c = T[i, 0], T[i, 1], T[i, 2]
            cost -= a * (h0 + f0) + b * (h1 + f1) + c * (h2 + f2)
            out[15] += c * m10 - b * m20
            out[16] += c * m11 - b * m21
            out[17] += c * m12 - b * m22
            out[18] += a * m21 - c * m01
            out[19] += a * m22 - c * m02
            out[20] += b * m02 - a * m12
            out[24] += b * f2 - c * f1
            out[25] += c * f0 - a * f2
            out[26] += a * f1 - b * f0
            if i == 0:
                for k in range(6):
                    out[k] = S[k]
                out[6], out[7], out[8] = -m00, -m01, -m02
                out[9], out[10], out[11] = -m10, -m11, -m12
                out[12], out[13], out[14] = -m20, -m21, -m22
                out[21], out[22], out[23] = f0, f1, f2
    return cost


@njit(cache=True)
def expect_root(
    expected: Float64, per_m: float, per_rad: float, root: Float64, about: Float64, R: Float64, t: Float64,
    out: Float64,
) -> float:  # fmt: skip
    """Add the prior of the root's pose to its quadratic form; return the prior's cost.

    The cost is (per_m·|p − p̂|)² of the point ``root`` and (per_rad·φ)² of the angle φ: neither depends on the
    world's origin. The derivative of φ² equals that of |ω|² for the rotation vector ω, because the Jacobian of the
    logarithm does not change the vector's own direction.

    Args:
        expected: (4, 4) expected motion of the root from rest into the world.
        per_m, per_rad: inverse standard deviations [1/m], [1/rad].
        root: (3,) reference point of the root part at rest [m].
        about: (3,) origin of the twists, world [m].
        R, t: (9,), (3,) motion of the root about that origin.
        out: (MOTION,) updated.
    """
    E = np.empty(9)
    w, f, cost = per_m * per_m, np.empty(3), 0.0
    p = np.empty(3)
    for i in range(3):
        p[i] = R[3 * i] * root[0] + R[3 * i + 1] * root[1] + R[3 * i + 2] * root[2] + t[i]
        f[i] = expected[i, 3] - about[i] - p[i]
        for k in range(3):
            E[3 * i + k] = expected[i, k]
            f[i] += expected[i, k] * root[k]
        cost += w * f[i] * f[i]
        f[i] *= w
    x, y, z = p[0], p[1], p[2]
    out[0] += w
    out[3] += w
    out[5] += w
    out[7] += w * z
    out[8] -= w * y
    out[9] -= w * z
    out[11] += w * x
    out[12] += w * y
    out[13] -= w * x
    a, b, c = turn_between(R, FIRST, E)
    u = per_rad * per_rad
    cost += u * (a * a + b * b + c * c)
    out[15] += w * (y * y + z * z) + u
    out[16] -= w * x * y
    out[17] -= w * x * z
    out[18] += w * (x * x + z * z) + u
    out[19] -= w * y * z
    out[20] += w * (x * x + y * y) + u
    out[21] += f[0]
    out[22] += f[1]
    out[23] += f[2]
    out[24] += y * f[2] - z * f[1] + u * (R[0] * a + R[1] * b + R[2] * c)
    out[25] += z * f[0] - x * f[2] + u * (R[3] * a + R[4] * b + R[5] * c)
    out[26] += x * f[1] - y * f[0] + u * (R[6] * a + R[7] * b + R[8] * c)
    return float(cost)


@njit(cache=True)
def normal_equations(
    parents: Int64, joint_parts: Int64, above: Int64, xi: Float64, Q: Float64, H: Float64, g: Float64,
) -> None:  # fmt: skip
    """Write the lower triangle of H (dofs, dofs) and g (dofs,) of the Gauss–Newton step.

    Args:
        parents, joint_parts: (parts,), (joints,) of `TwistTree`.
        above: (dofs,) of `twist_step_kernels.path`.
        xi: (joints, 6) the joints' twists in the pose.
        Q: (parts, MOTION) of `linearised`; overwritten with that of each part's subtree.
        H, g: written.
    """
    for p in range(len(parents) - 1, 0, -1):
        k = parents[p]
        for i in range(MOTION):
            Q[k, i] += Q[p, i]
    q = Q[0]
    for i in range(3):
        for k in range(3):
            H[3 + i, k] = q[6 + 3 * k + i]
    H[0, 0], H[1, 0], H[2, 0], H[1, 1], H[2, 1], H[2, 2] = q[0], q[1], q[2], q[3], q[4], q[5]
    H[3, 3], H[4, 3], H[5, 3], H[4, 4], H[5, 4], H[5, 5] = q[15], q[16], q[17], q[18], q[19], q[20]
    for i in range(ROOT):
        g[i] = q[21 + i]
    for j in range(len(joint_parts)):
        q, row = Q[joint_parts[j]], H[ROOT + j]
        x, y, z, a, b, c = xi[j, 0], xi[j, 1], xi[j, 2], xi[j, 3], xi[j, 4], xi[j, 5]
        g[ROOT + j] = x * q[21] + y * q[22] + z * q[23] + a * q[24] + b * q[25] + c * q[26]
        u0 = q[0] * x + q[1] * y + q[2] * z + q[6] * a + q[7] * b + q[8] * c
        u1 = q[1] * x + q[3] * y + q[4] * z + q[9] * a + q[10] * b + q[11] * c
        u2 = q[2] * x + q[4] * y + q[5] * z + q[12] * a + q[13] * b + q[14] * c
        u3 = q[6] * x + q[9] * y + q[12] * z + q[15] * a + q[16] * b + q[17] * c
        u4 = q[7] * x + q[10] * y + q[13] * z + q[16] * a + q[18] * b + q[19] * c
        u5 = q[8] * x + q[11] * y + q[14] * z + q[17] * a + q[19] * b + q[20] * c
        for i in range(ROOT, ROOT + j):
            row[i] = 0.0
        row[0], row[1], row[2], row[3], row[4], row[5] = u0, u1, u2, u3, u4, u5
        i = ROOT + j
        while i >= ROOT:
            k = i - ROOT
            row[i] = u0 * xi[k, 0] + u1 * xi[k, 1] + u2 * xi[k, 2] + u3 * xi[k, 3] + u4 * xi[k, 4] + u5 * xi[k, 5]
            i = above[i]


@njit(cache=True)
def measure(
    parents: Int64, joint_parts: Int64, twists: Float64, root: Float64, sums: Float64, about: Float64,
    prior_T: Float64, prior_root: Float64, prior_angles: Float64, prior_joints: Float64, T: Float64, angles: Float64,
    R: Float64, t: Float64, xi: Float64, Q: Float64, D: Float64, e: Float64,
) -> tuple[float, float]:  # fmt: skip
    """Compute the tree's motions, the costs of constraints and priors, and their derivatives.

    Args:
        parents, joint_parts, twists, root: (parts,), (joints,), (joints, 6), (3,) [m] of `TwistTree`.
        sums, about: (parts, SUMS) and (3,) origin, world [m], of `add_constraints`.
        prior_T, prior_root: (priors, 4, 4) and (priors, 2) [1/m], [1/rad]; see `expect_root`.
        prior_angles, prior_joints: (priors, joints) expected angles [rad], and inverse standard deviations [1/rad].
        T, angles: (4, 4), (joints,) the pose: motion of the root, and angles [rad].
        R, t, xi, Q: written: (parts, 9), (parts, 3) [m] motions of the parts; (joints, 6) twists in this pose; (parts,
            MOTION) quadratic forms of the constraints, of `linearised`.
        D, e: (joints,) written: the priors' terms in the diagonal of H and in g.

    Returns:
        The costs of the constraints and of the priors.
    """
    forward(parents, joint_parts, twists, T, angles, about, R, t, xi)
    cost, expected = linearised(sums, R, t, Q), 0.0
    for j in range(len(angles)):
        D[j] = e[j] = 0.0
    for k in range(len(prior_T)):
        expected += expect_root(prior_T[k], prior_root[k, 0], prior_root[k, 1], root, about, R[0], t[0], Q[0])
        for j in range(len(angles)):
            w, d = prior_joints[k, j] * prior_joints[k, j], prior_angles[k, j] - angles[j]
            D[j] += w
            e[j] += w * d
            expected += w * d * d
    return cost, expected


@njit(cache=True)
def _moved(T: Float64, delta: Float64, root: Float64, about: Float64, new: Float64) -> float:
    """Write T after the root's twist delta: a rotation by ω, with its point ``root`` moved by v + ω × x."""
    B, C = np.empty(9), np.empty(9)
    for i in range(3):
        for k in range(3):
            B[3 * i + k] = T[i, k]
    x = T[0, 3] - about[0] + B[0] * root[0] + B[1] * root[1] + B[2] * root[2]
    y = T[1, 3] - about[1] + B[3] * root[0] + B[4] * root[1] + B[5] * root[2]
    z = T[2, 3] - about[2] + B[6] * root[0] + B[7] * root[1] + B[8] * root[2]
    a, b, c = delta[3], delta[4], delta[5]
    dx, dy, dz = delta[0] + b * z - c * y, delta[1] + c * x - a * z, delta[2] + a * y - b * x
    u, v, w = B[0] * a + B[3] * b + B[6] * c, B[1] * a + B[4] * b + B[7] * c, B[2] * a + B[5] * b + B[8] * c
    turned(B, FIRST, u, v, w, C)
    orthonormal(C)
    new[0, 3] = about[0] + x + dx - (C[0] * root[0] + C[1] * root[1] + C[2] * root[2])
    new[1, 3] = about[1] + y + dy - (C[3] * root[0] + C[4] * root[1] + C[5] * root[2])
    new[2, 3] = about[2] + z + dz - (C[6] * root[0] + C[7] * root[1] + C[8] * root[2])
    for i in range(3):
        for k in range(3):
            new[i, k] = C[3 * i + k]
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True)
def fit(
    parents: Int64, joint_parts: Int64, twists: Float64, limits: Float64, root: Float64, sums: Float64,
    about: Float64, prior_T: Float64, prior_root: Float64, prior_angles: Float64, prior_joints: Float64,
    most_steps: int, rest_m: float, rest_rad: float, T: Float64, angles: Float64, held: Bool,
) -> tuple[int, bool, float, float]:  # fmt: skip
    """Fit a tree's pose by Gauss–Newton steps, damped where the cost would rise (Levenberg and Marquardt).

    Rejected steps do not count: where limbs penetrate each other deeply, many are rejected before the first.

    Args:
        parents, joint_parts, twists, limits, root: (parts,), (joints,), (joints, 6), (joints, 2) [rad], (3,) [m] of
            `TwistTree`.
        sums, about, prior_T, prior_root, prior_angles, prior_joints: constraints, their origin and priors, as in
            `measure`.
        most_steps, rest_m, rest_rad: stopping criteria: number of steps, and size of the last step [m], [rad].
        T, angles: (4, 4), (joints,) [rad] the initial pose, overwritten with the result.
        held: (joints,) written: whether the angle is at a limit.

    Returns:
        Number of steps, whether the fit converged, and the costs of constraints and priors.
    """
    parts, joints = len(parents), len(angles)
    n = ROOT + joints
    above = np.empty(n, dtype=np.int64)
    path(parents, joint_parts, above)
    R, t, xi, Q = np.empty((parts, 9)), np.empty((parts, 3)), np.empty((joints, 6)), np.empty((parts, MOTION))
    D, e, H, g, L, delta = (
        np.empty(joints),
        np.empty(joints),
        np.empty((n, n)),
        np.empty(n),
        np.empty((n, n)),
        np.empty(n),
    )
    new_T, new_angles = np.eye(4), np.empty(joints)
    for j in range(joints):
        angles[j] = min(max(angles[j], limits[j, 0]), limits[j, 1])
        held[j] = False
    rounding = 0.0
    for p in range(parts):
        rounding += _ROUNDING * sums[p, 72]
    cost, expected = measure(
        parents, joint_parts, twists, root, sums, about, prior_T, prior_root, prior_angles, prior_joints, T, angles, R,
        t, xi, Q, D, e,
    )  # fmt: skip
    steps, rests, damping, better = 0, False, 0.0, True
    while steps < most_steps and not rests and damping < _MOST_DAMPING:
        if better:
            normal_equations(parents, joint_parts, above, xi, Q, H, g)
            for j in range(joints):
                H[ROOT + j, ROOT + j] += D[j]
                g[ROOT + j] += e[j]
        better = step(above, H, g, damping, angles, limits, L, held, delta)
        if better:
            far = _moved(T, delta, root, about, new_T)
            turn = math.sqrt(delta[3] * delta[3] + delta[4] * delta[4] + delta[5] * delta[5])
            for j in range(joints):
                turn = max(turn, abs(delta[ROOT + j]))
                new_angles[j] = min(max(angles[j] + delta[ROOT + j], limits[j, 0]), limits[j, 1])
            new_cost, new_expected = measure(
                parents, joint_parts, twists, root, sums, about, prior_T, prior_root, prior_angles, prior_joints, new_T,
                new_angles, R, t, xi, Q, D, e,
            )  # fmt: skip
            better = new_cost + new_expected <= cost + expected + rounding
            rests = far < rest_m and turn < rest_rad
        if better:
            steps += 1
            cost, expected = new_cost, new_expected
            for i in range(3):
                for k in range(4):
                    T[i, k] = new_T[i, k]
            for j in range(joints):
                angles[j] = new_angles[j]
            damping = damping / 10.0 if damping > _LEAST_DAMPING else 0.0
        else:
            damping = max(10.0 * damping, _FIRST_DAMPING)
    for j in range(joints):
        held[j] = angles[j] <= limits[j, 0] or angles[j] >= limits[j, 1]
    return steps, rests, max(cost, 0.0), expected  # below 0 by rounding only
