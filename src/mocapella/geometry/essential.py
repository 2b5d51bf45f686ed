"""Essential matrices: the relative pose of two cameras from directions to the same points, up to its scale.

Sources: D. Nistér, "An efficient solution to the five-point relative pose problem", IEEE PAMI 26 (2004) 756, for the
constraints; H. Stewénius, C. Engels, D. Nistér, "Recent developments on direct relative orientation", ISPRS J. 60
(2006) 284, section 3.3, for the solution by an action matrix; R. Hartley, A. Zisserman, *Multiple View Geometry* (2nd
ed. 2004), sections 9.6.2 (poses of an essential matrix) and 11.4.3 (Sampson distance).

Directions are (..., 2): x/z and y/z in the camera's frame. An essential matrix E of the cameras a and b has
``[b, 1] E [a, 1] = 0``; ``E = [t]× R`` for ``T_b_a``.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist

Float64 = NDArray[np.float64]

POINTS: Final = 5
"""Number of points that determine an essential matrix."""
_DEGREES: Final = (
    (3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0), (2, 0, 1), (1, 1, 1), (0, 2, 1), (1, 0, 2), (0, 1, 2), (0, 0, 3),
    (2, 0, 0), (1, 1, 0), (0, 2, 0), (1, 0, 1), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0),
)  # fmt: skip
"""Exponents of x, y, z in the monomials of a cubic polynomial: degree 3 first."""
_TIMES_X: Final = ((0, 0), (1, 1), (2, 2), (3, 4), (4, 5), (5, 7))
"""Row of the action matrix, and the cubic monomial that x makes of that row's monomial."""
_REAL: Final = 1e-6
"""Largest imaginary part of a real root, relative to the root."""


def _collect() -> Float64:
    """Return (64, 20): the monomial of each product of three of x, y, z, 1."""
    out = np.zeros((4, 4, 4, 20))
    for i in range(4):
        for j in range(4):
            for k in range(4):
                degree = tuple((i, j, k).count(n) for n in range(3))
                out[i, j, k, _DEGREES.index(degree)] = 1.0
    return out.reshape(64, 20)


_COLLECT: Final = _collect()
_LEVI: Final = np.linalg.det(np.eye(3)[np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1)])


def five_point(a: Any, b: Any) -> tuple[Float64, NDArray[np.int64]]:
    """Return all essential matrices through five pairs of directions, for each of several samples.

    Args:
        a: (samples, 5, 2) directions in the first camera.
        b: (samples, 5, 2) directions in the second camera.

    Returns:
        (solutions, 3, 3) essential matrices of norm 1, and (solutions,) the sample of each. A sample has up to ten
        solutions; a degenerate one, such as five equal points, has none.
    """
    basis = _null_space(_rows(np.asarray(a, np.float64), np.asarray(b, np.float64)))
    cubic = np.einsum("nika,njkb,njlc->nilabc", basis, basis, basis).reshape(-1, 9, 64) * 2.0
    trace = np.einsum("njka,njkb,nilc->nilabc", basis, basis, basis).reshape(-1, 9, 64)
    det = np.einsum("ijk,nia,njb,nkc->nabc", _LEVI, basis[:, 0], basis[:, 1], basis[:, 2]).reshape(-1, 1, 64)
    system = np.concatenate([cubic - trace, det], axis=1) @ _COLLECT
    usable = np.flatnonzero(np.linalg.cond(system[:, :, :10]) < 1e12)
    if not len(usable):
        return np.zeros((0, 3, 3)), np.zeros(0, np.int64)
    reduced = np.linalg.solve(system[usable, :, :10], system[usable, :, 10:])
    action = np.zeros((len(usable), 10, 10))
    for row, cube in _TIMES_X:
        action[:, row] = -reduced[:, cube]
    action[:, 6, 0] = action[:, 7, 1] = action[:, 8, 3] = action[:, 9, 6] = 1.0
    values, vectors = np.linalg.eig(action)
    last = np.where(np.abs(vectors[:, 9]) > 1e-12, vectors[:, 9], np.nan)
    with np.errstate(invalid="ignore"):  # roots at infinity are NaN
        roots = np.moveaxis(vectors[:, 6:9] / last[:, None], 1, 2)  # (samples, 10, 3)
    real = (np.abs(values.imag) <= _REAL * (1 + np.abs(values))) & np.isfinite(roots).all(axis=-1)
    sample, which = np.nonzero(real)
    xyz = np.concatenate([roots[sample, which].real, np.ones((len(sample), 1))], axis=1)
    E = np.einsum("nija,na->nij", basis[usable[sample]], xyz)
    return E / np.linalg.norm(E, axis=(1, 2))[:, None, None], usable[sample]


def _rows(a: Float64, b: Float64) -> Float64:
    """Return (..., points, 9): the coefficients of ``[b, 1] E [a, 1]`` of each point."""
    one = np.ones((*a.shape[:-1], 1))
    rows = np.concatenate([b, one], axis=-1)[..., :, None] * np.concatenate([a, one], axis=-1)[..., None, :]
    return np.asarray(rows.reshape(*a.shape[:-1], 9))


def _null_space(rows: Float64) -> Float64:
    """Return (samples, 3, 3, 4): the matrices that the five rows leave free."""
    _, _, right = np.linalg.svd(rows, full_matrices=True)
    return np.asarray(np.moveaxis(right[:, 5:], 1, 2).reshape(-1, 3, 3, 4))


def sampson_distance(E: Float64, a: Any, b: Any) -> Float64:
    """Return the signed first-order distance of pairs of directions from an epipolar geometry.

    Args:
        E: (..., 3, 3) essential matrices.
        a: (points, 2) directions in the first camera.
        b: (points, 2) directions in the second camera.

    Returns:
        (..., points) distance over both cameras together, in the unit of the directions [rad]; NaN where one is NaN.
    """
    a, b = (np.asarray(d, np.float64) for d in (a, b))
    Ea = np.einsum("...ij,nj->...in", E[..., :2], a) + E[..., 2:]
    Eb = np.einsum("...ji,nj->...in", E[..., :2, :], b) + E[..., 2, :, None]
    error = b[:, 0] * Ea[..., 0, :] + b[:, 1] * Ea[..., 1, :] + Ea[..., 2, :]
    size = np.sqrt(Ea[..., 0, :] ** 2 + Ea[..., 1, :] ** 2 + Eb[..., 0, :] ** 2 + Eb[..., 1, :] ** 2)
    return np.asarray(error / np.maximum(size, 1e-12))


def essential_of(T_b_a: Float64) -> Float64:
    """Return the essential matrix (..., 3, 3) of relative poses (..., 4, 4)."""
    return np.asarray(cross_matrix(T_b_a[..., :3, 3]) @ T_b_a[..., :3, :3])


def poses_of(E: Float64) -> Float64:
    """Return the four poses ``T_b_a`` (4, 4, 4) of an essential matrix (3, 3), each with a translation of length 1."""
    U, _, Vt = np.linalg.svd(E)
    U, Vt = U * np.linalg.det(U), Vt * np.linalg.det(Vt)
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns = [U @ W @ Vt, U @ W.T @ Vt]
    return np.stack([rigid(R, sign * U[:, 2]) for R in turns for sign in (1.0, -1.0)])


def triangulate_pair(T_b_a: Float64, a: Any, b: Any) -> tuple[Float64, Float64]:
    """Triangulate pairs of directions by the middle of their rays.

    Args:
        T_b_a: (4, 4) relative pose of the cameras.
        a: (points, 2) directions in the first camera.
        b: (points, 2) directions in the second camera.

    Returns:
        (points, 3) in the first camera's frame, in the unit of the translation; NaN for parallel rays. And (points, 2)
        the depths along both rays; both are above 0 for a point in front of both cameras.
    """
    one = np.ones((len(a), 1))
    da, db = (np.concatenate([np.asarray(d, np.float64), one], axis=1) for d in (a, b))
    R, t = T_b_a[:3, :3], T_b_a[:3, 3]
    db, centre = db @ R, -R.T @ t
    aa, bb, ab = (da * da).sum(axis=1), (db * db).sum(axis=1), (da * db).sum(axis=1)
    det = aa * bb - ab * ab
    det = np.where(det > 1e-12 * aa * bb, det, np.nan)
    ca, cb = da @ centre, db @ centre
    depth_a, depth_b = (bb * ca - ab * cb) / det, (ab * ca - aa * cb) / det
    middle = 0.5 * (da * depth_a[:, None] + centre + db * depth_b[:, None])
    return middle, np.stack([depth_a, depth_b], axis=1)


def best_pose(E: Float64, a: Any, b: Any) -> tuple[Float64, float]:
    """Return the pose of an essential matrix that has most points in front of both cameras, and their share.

    Args:
        E: (3, 3) essential matrix.
        a: (points, 2) directions in the first camera.
        b: (points, 2) directions in the second camera.
    """
    poses = poses_of(E)
    shares = [float((triangulate_pair(T, a, b)[1] > 0).all(axis=1).mean()) for T in poses]
    best = int(np.argmax(shares))
    return poses[best], shares[best]


def refine_pose(T_b_a: Float64, a: Any, b: Any, scale: float, steps: int = 10) -> Float64:
    """Minimise a robust sum of squared Sampson distances over the relative pose, whose translation keeps length 1.

    Args:
        T_b_a: (4, 4) start, with a translation of length 1.
        a: (points, 2) directions in the first camera.
        b: (points, 2) directions in the second camera.
        scale: distance at which a point weighs half (Cauchy) [rad].
        steps: number of Gauss–Newton steps.
    """
    T, small = T_b_a, 1e-6
    for _ in range(steps):
        base = sampson_distance(essential_of(T), a, b)
        weight = 1.0 / (1.0 + (base / scale) ** 2)
        moved = np.stack([sampson_distance(essential_of(_moved(T, small * np.eye(5)[k])), a, b) for k in range(5)])
        J = ((moved - base) / small).T
        H = J.T @ (J * weight[:, None])
        step = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(5), J.T @ (weight * base))
        longest = np.abs(step).max()
        T = _moved(T, step * min(1.0, 0.2 / max(longest, 1e-12)))
        if longest < 1e-7:
            break
    return T


def _moved(T: Float64, x: Float64) -> Float64:
    """Turn a pose by x[:3] [rad], and its direction of translation by x[3:] [rad]."""
    t = T[:3, 3]
    across = np.linalg.svd(t[None])[2][1:]
    turned = t + x[3:] @ across
    R = exp_twist(np.concatenate([np.zeros(3), x[:3]]))[:3, :3] @ T[:3, :3]
    return rigid(R, turned / np.linalg.norm(turned))


def angles_between(T_b_a: Float64, points_a: Float64) -> Float64:
    """Return the angle (points,) at which the rays of two cameras meet in points (points, 3) of the first's frame."""
    other = points_a - inverse(T_b_a)[:3, 3]
    cosine = (points_a * other).sum(axis=1) / (np.linalg.norm(points_a, axis=1) * np.linalg.norm(other, axis=1))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))
