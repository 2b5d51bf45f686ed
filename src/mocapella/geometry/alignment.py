"""Rigid alignment of paired points by their moments: batch, robust, and recursive at a constant cost.

The motion that minimises Σ w |p − (R (q + δ v) + t)|² depends on the points only through sums over them, the *moments*.
Moments of subsets add, and exponential forgetting multiplies the old moments by a factor, so the cost of a new frame
does not depend on the history. δ shifts every q along its velocity v: an offset of two clocks.

Moments are arrays (..., `MOMENTS`)::

    0       Σ w               16–18   Σ w v              37–42   Σ w q qᵀ, upper triangle by rows
    1–3     Σ w p             19–27   Σ w p vᵀ by rows   43–48   Σ w v vᵀ, likewise
    4–6     Σ w q             28–36   Σ w q vᵀ by rows   49      Σ w |p|²
    7–15    Σ w p qᵀ by rows

Sources: B. Horn, "Closed-form solution of absolute orientation using unit quaternions", J. Opt. Soc. Am. A 4 (1987),
section 4; W. Kabsch, Acta Cryst. A32 (1976) 922; S. Umeyama, IEEE PAMI 13 (1991) 376, for the sign that makes a
rotation of it. Robust weights: P. Huber, *Robust Statistics* (1981), section 7.8; S. Geman and D. McClure (1987).
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, rigid
from mocapella.settings import check

Float64 = NDArray[np.float64]
RobustKernel = Literal["squared", "l1", "huber", "geman-mcclure"]

MOMENTS: Final = 50
_UPPER: Final = np.triu_indices(3)


def moments(p: Any, q: Any, weights: Any = None, velocities: Any = None) -> Float64:
    """Return the moments of paired points.

    Args:
        p, q: (..., n, 3) [m]; pairs with a non-finite coordinate or velocity are ignored.
        weights: (..., n), by default 1; pairs with a weight of 0 or less, or NaN, are ignored.
        velocities: (..., n, 3) velocities of q [m/s], by default 0.

    Returns:
        (..., `MOMENTS`), in the order of the module's table; all 0 without a valid pair. Add them to join subsets.
    """
    p, q = np.broadcast_arrays(np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64))
    v = np.broadcast_to(np.asarray(0.0 if velocities is None else velocities, dtype=np.float64), p.shape)
    w = (
        np.ones(p.shape[:-1])
        if weights is None
        else np.broadcast_to(np.asarray(weights, dtype=np.float64), p.shape[:-1])
    )
    used = np.isfinite(np.concatenate([p, q, v], axis=-1)).all(axis=-1) & (w > 0)
    w = np.where(used, w, 0.0)
    p, q, v = (np.where(used[..., None], points, 0.0) for points in (p, q, v))
    wp, wq, wv = (w[..., None] * points for points in (p, q, v))

    def products(one: Float64, other: Float64) -> Float64:
        return np.asarray(np.swapaxes(one, -1, -2) @ other)

    def flat(matrices: Float64) -> Float64:
        return matrices.reshape(*matrices.shape[:-2], 9)

    parts = [
        w.sum(axis=-1)[..., None],
        wp.sum(axis=-2),
        wq.sum(axis=-2),
        flat(products(wp, q)),
        wv.sum(axis=-2),
        flat(products(wp, v)),
        flat(products(wq, v)),
        products(wq, q)[..., *_UPPER],
        products(wv, v)[..., *_UPPER],
        (wp * p).sum(axis=(-1, -2))[..., None],
    ]
    return np.concatenate(parts, axis=-1)


def align(M: Float64, offset: float = 0.0) -> Float64:
    """Return the least-squares rigid motion ``T_p_q`` of the moments: p ≈ T (q + offset·v).

    The rotation is the unit quaternion that is the eigenvector of the largest eigenvalue of Horn's symmetric matrix
    (1987, section 4.A): always a rotation, never a reflection. Of one point, or of collinear ones, it is one of many.

    Args:
        M: (..., `MOMENTS`) moments, of `moments`.
        offset: clock offset of q [s].

    Returns:
        (..., 4, 4); NaN where the moments are empty.
    """
    M = np.asarray(M, dtype=np.float64)
    W = np.where(M[..., 0] > 0, M[..., 0], np.nan)[..., None]
    mp, mq = M[..., 1:4] / W, (M[..., 4:7] + offset * M[..., 16:19]) / W
    R = _rotation(np.swapaxes(centred_products(M, offset), -1, -2))
    return rigid(R, mp - (R @ mq[..., None])[..., 0])


def centred_products(M: Float64, offset: float = 0.0) -> Float64:
    """Return the covariance-like sums Σ w (p − p̄)(q + δv − q̄)ᵀ from moments; p̄ and q̄ are weighted means.

    Their determinant is negative if q is a mirror image of p.

    Args:
        M: (..., `MOMENTS`) moments, of `moments`.
        offset: clock offset δ of q [s].

    Returns:
        (..., 3, 3) [m²]; NaN where the moments are empty.
    """
    W = np.where(M[..., 0] > 0, M[..., 0], np.nan)[..., None, None]
    shape = (*M.shape[:-1], 3, 3)
    pq = M[..., 7:16].reshape(shape) + offset * M[..., 19:28].reshape(shape)
    mq = M[..., 4:7] + offset * M[..., 16:19]
    return np.asarray(pq - M[..., 1:4, None] * mq[..., None, :] / W)


def _rotation(S: Float64) -> Float64:
    """Return R_p_q (..., 3, 3) that best maps q to p, from S = Σ w (q − q̄)(p − p̄)ᵀ (..., 3, 3)."""
    finite = np.asarray(np.isfinite(S).all(axis=(-1, -2)))
    S = np.where(finite[..., None, None], S, 0.0)
    N = np.empty((*S.shape[:-2], 4, 4))
    N[..., 0, 0] = np.trace(S, axis1=-2, axis2=-1)
    N[..., 1:, 1:] = S + np.swapaxes(S, -1, -2) - N[..., 0, 0, None, None] * np.eye(3)
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        N[..., 0, 1 + i] = N[..., 1 + i, 0] = S[..., j, k] - S[..., k, j]
    w, x, y, z = np.moveaxis(np.linalg.eigh(N)[1][..., -1], -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    R = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.where(finite[..., None, None], R, np.nan)


def shifted(M: Float64, by: Any) -> Float64:
    """Return the moments of the same pairs after moving every q along its velocity: q + by·v.

    Args:
        M: (..., `MOMENTS`) moments, not changed.
        by: (...) time along the velocity [s].

    Returns:
        (..., `MOMENTS`), a copy.
    """
    out = M.copy()
    shape = (*M.shape[:-1], 3, 3)
    by = np.asarray(by, dtype=np.float64)[..., None]
    qv, vv = M[..., 28:37].reshape(shape), _symmetric(M[..., 43:49])
    out[..., 4:7] += by * M[..., 16:19]
    out[..., 7:16] += by * M[..., 19:28]
    out[..., 28:37] += by * vv.reshape(*M.shape[:-1], 9)
    qq = by[..., None] * (qv + np.swapaxes(qv, -1, -2)) + by[..., None] ** 2 * vv
    out[..., 37:43] += qq[..., *_UPPER]
    return out


def _symmetric(upper: Float64) -> Float64:
    out = np.empty((*upper.shape[:-1], 3, 3))
    out[..., *_UPPER] = upper
    out[..., _UPPER[1], _UPPER[0]] = upper
    return out


def cross_matrix(x: Any) -> Float64:
    """Return the matrix [x]× (..., 3, 3) of vectors (..., 3), with [x]× y = x × y."""
    x = np.asarray(x, dtype=np.float64)
    out = np.zeros((*x.shape[:-1], 3, 3))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[..., k, j], out[..., j, k] = x[..., i], -x[..., i]
    return out


def normal_equations(M: Float64, T: Float64, offset: Any = 0.0) -> tuple[Float64, Float64]:
    """Return the Gauss–Newton equations H d = g of seven unknowns d at T and offset, from the moments alone.

    d is a twist in p's frame, translation [m] before rotation [rad] (T ← exp(d₁…₆) T), and a change of the offset [s].
    With x = T (q + offset·v) and u = R v, a point's derivative is J = [I, −[x]×, u]; H = Σ w JᵀJ, g = Σ w Jᵀ (p − x).
    H is singular where the points do not determine d, such as without velocities; that is no error here.

    Args:
        M: (..., `MOMENTS`) moments, of `moments`.
        T: (..., 4, 4) ``T_p_q``.
        offset: (...) clock offset δ of q [s].

    Returns:
        H (..., 7, 7) and g (..., 7).
    """
    M = shifted(M, offset)
    W, R, t = M[..., 0, None], T[..., :3, :3], T[..., :3, 3]
    R_back = np.swapaxes(R, -1, -2)

    def moved(vectors: Float64) -> Float64:
        return np.asarray((R @ vectors[..., None])[..., 0])

    def square(numbers: Float64) -> Float64:
        return numbers.reshape(*numbers.shape[:-1], 3, 3)

    Rq, u = moved(M[..., 4:7]), moved(M[..., 16:19])
    x = Rq + W * t
    pv = square(M[..., 19:28]) @ R_back
    xu = R @ square(M[..., 28:37]) @ R_back + _outer(t, u)
    Rqt = _outer(Rq, t)
    xx = R @ _symmetric(M[..., 37:43]) @ R_back + Rqt + np.swapaxes(Rqt, -1, -2) + W[..., None] * _outer(t, t)
    px = square(M[..., 7:16]) @ R_back + _outer(M[..., 1:4], t)
    cross = cross_matrix(x)
    H = np.empty((*M.shape[:-1], 7, 7))
    H[..., :3, :3] = W[..., None] * np.eye(3)
    H[..., :3, 3:6] = -cross
    H[..., 3:6, :3] = cross
    H[..., 3:6, 3:6] = _trace(xx)[..., None, None] * np.eye(3) - xx
    H[..., 6, :3] = H[..., :3, 6] = u
    H[..., 6, 3:6] = H[..., 3:6, 6] = _axial(xu)
    H[..., 6, 6] = M[..., 43] + M[..., 46] + M[..., 48]
    return H, np.concatenate([M[..., 1:4] - x, -_axial(px), (_trace(pv) - _trace(xu))[..., None]], axis=-1)


def _outer(a: Float64, b: Float64) -> Float64:
    return np.asarray(a[..., :, None] * b[..., None, :])


def _trace(matrices: Float64) -> Float64:
    return np.asarray(matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2])


def _axial(outer: Float64) -> Float64:
    """Return Σ a × b (..., 3), given Σ a bᵀ (..., 3, 3)."""
    skew = outer - np.swapaxes(outer, -1, -2)
    return np.stack([skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1]], axis=-1)


def robust_weights(residual: Any, kernel: RobustKernel, scale: float) -> Float64:
    """Return the weights of points by their residuals, for iteratively reweighted least squares.

    Args:
        residual: any shape, 0 or more [m].
        kernel: ``l1``: 1/r, no more than 1/scale. ``huber``: 1 up to the scale and scale/r beyond.
            ``geman-mcclure``: (scale²/(scale² + r²))². ``squared``: 1.
        scale: scale of the robust loss [m].

    Returns:
        The shape of ``residual``; NaN where the residual is, except with ``squared``.

    Raises:
        SettingsError: unknown kernel.
    """
    r = np.abs(np.asarray(residual, dtype=np.float64))
    if kernel == "l1":
        return np.asarray(1.0 / np.maximum(r, scale))
    if kernel == "huber":
        return np.asarray(scale / np.maximum(r, scale))
    if kernel == "geman-mcclure":
        return np.asarray((scale * scale / (scale * scale + r * r)) ** 2)
    check(kernel == "squared", "kernel", kernel, "squared, l1, huber or geman-mcclure")
    return np.ones(r.shape)


def robust_align(
    p: Any, q: Any, weights: Any = None, *, kernel: RobustKernel = "l1", scale: float = 0.02, iterations: int = 50
) -> Float64:
    """Estimate ``T_p_q`` by iteratively reweighted least squares; ``l1`` minimises Σ w |p − T q|, not the squares.

    ``geman-mcclure`` starts from the ``l1`` fit, because it has local minima.

    Args:
        p, q, weights: as in `moments`, one set of points: (n, 3), (n,).
        kernel, scale: robust loss (``l1``, ``huber``, ``geman-mcclure`` or ``squared``) and its scale [m], as in
            `robust_weights`.
        iterations: the most iterations; the last estimate is returned, converged or not.

    Returns:
        (4, 4); NaN if no pair is valid.

    Raises:
        SettingsError: a scale of 0 or less, or an unknown kernel.
    """
    check(scale > 0, "scale", scale, "greater than 0 m")
    w = np.ones(np.shape(p)[:-1]) if weights is None else np.asarray(weights, dtype=np.float64)
    T = align(moments(p, q, w))
    if kernel == "geman-mcclure":
        T = robust_align(p, q, w, kernel="l1", scale=scale, iterations=iterations)
    for _ in range(iterations):
        residual = np.linalg.norm(np.asarray(p) - apply(T, q), axis=-1)
        before, T = T, align(moments(p, q, w * robust_weights(residual, kernel, scale)))
        if not (np.abs(T - before) > 1e-12).any():
            break
    return T
