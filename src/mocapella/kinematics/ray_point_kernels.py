"""Kernels that find the point that the rays of several cameras to one joint agree on.

A ray is a row (8,): its origin relative to the body's root and its unit direction, both with the world's axes [m], the
variance of its angle [rad²], and the variance of its distance from the joint apart from that angle [m²]. A point's
misfit to a ray is its squared distance from it over that distance's variance: about chi-square with two degrees of
freedom. The candidates are the points where two rays pass each other closest, and with a predicted point also the
nearest point of each single ray; the one with the least sum of truncated misfits is refined by the rays that agree with
it (M. Fischler, R. Bolles, Random Sample Consensus, Communications of the ACM 24, 1981, with all pairs for samples;
P. Torr, A. Zisserman, MLESAC, Computer Vision and Image Understanding 78, 2000, for the truncated sum). Importing this
module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

RAY = 8
"""Numbers of a ray."""
NEAREST_M = 0.05
"""Least distance of a joint from a camera along its ray; a ray sees nothing nearer, or behind the camera [m]."""
GATE = 16.0
"""Misfit above which a ray contradicts a point."""
CLEAR = 9.0
"""Misfit below which all rays are taken to agree, without a search for others that do."""
SLACK_M = 0.05
"""Standard deviation that is added to a predicted point while it votes about the rays [m]."""
PARALLEL = 0.003
"""Least squared sine of the angle between two rays that meet in a point: about 3°."""
PRIOR_OF_TWO, PRIOR_OF_MORE = 1.25, 0.75
"""Votes of a prediction about two rays, and about more. Where the two contradict it together, such as left and right
exchanged in one image, the ray that agrees with it is right; among more, two rays that agree are."""
FAR_M = 30.0
"""Standard deviation of an unknown point [m]."""
NU = 5.0
"""Degrees of freedom of a ray's Student-t weight."""


@njit(cache=True, error_model="numpy")
def misfit(rays: Float64, k: int, x: float, y: float, z: float) -> float:
    """Return the misfit of the point (x, y, z) to ray k of rays (n, 8); infinity behind the camera."""
    x, y, z = x - rays[k, 0], y - rays[k, 1], z - rays[k, 2]
    s = rays[k, 3] * x + rays[k, 4] * y + rays[k, 5] * z
    if not s > NEAREST_M:
        return math.inf
    x, y, z = x - s * rays[k, 3], y - s * rays[k, 4], z - s * rays[k, 5]
    return float((x * x + y * y + z * z) / (rays[k, 6] * s * s + rays[k, 7]))


@njit(cache=True, error_model="numpy")
def student(chi2: float, dofs: float, nu: float) -> float:
    """Return the Student-t weight, at most 1, of a squared residual ``chi2`` of ``dofs`` coordinates over its variance.

    ``nu`` are the degrees of freedom of the loss; infinity makes it quadratic.
    """
    if not math.isfinite(nu):
        return 1.0
    return min(1.0, (nu + dofs) / (nu + chi2))


@njit(cache=True, error_model="numpy")
def fit_point(
    rays: Float64, order: Int64, first: int, last: int, weights: Float64, x: float, y: float, z: float, prior: float,
    out: Float64,
) -> None:  # fmt: skip
    """Compute the weighted least-squares point of rays: of least sum of squared distances over their variances.

    Args:
        rays, order, first, last: (n, 8), and the indices order[first:last] of the joint's rays.
        weights: (n,) weight of each ray.
        x, y, z: about where the point is, for the distances that give the variances [m].
        prior: information of this place [1/m²].
        out: (9,) written: the point, and the upper triangle of its covariance, row by row [m²].
    """
    a00 = a11 = a22 = prior
    a01 = a02 = a12 = b0 = b1 = b2 = 0.0
    for i in range(first, last):
        k = order[i]
        if not weights[k] > 0.0:
            continue
        o0, o1, o2 = rays[k, 0] - x, rays[k, 1] - y, rays[k, 2] - z
        d0, d1, d2 = rays[k, 3], rays[k, 4], rays[k, 5]
        s = d0 * o0 + d1 * o1 + d2 * o2
        w = weights[k] / (rays[k, 6] * max(s * s, NEAREST_M * NEAREST_M) + rays[k, 7])
        a00 += w * (1.0 - d0 * d0)
        a11 += w * (1.0 - d1 * d1)
        a22 += w * (1.0 - d2 * d2)
        a01 -= w * d0 * d1
        a02 -= w * d0 * d2
        a12 -= w * d1 * d2
        b0 += w * (o0 - s * d0)
        b1 += w * (o1 - s * d1)
        b2 += w * (o2 - s * d2)
    invert(a00, a01, a02, a11, a12, a22, out, 3)
    out[0] = x + out[3] * b0 + out[4] * b1 + out[5] * b2
    out[1] = y + out[4] * b0 + out[6] * b1 + out[7] * b2
    out[2] = z + out[5] * b0 + out[7] * b1 + out[8] * b2


@njit(cache=True, error_model="numpy")
def invert(a00: float, a01: float, a02: float, a11: float, a12: float, a22: float, out: Float64, at: int) -> None:
    """Write the inverse of a symmetric positive definite (3, 3) matrix to out[at:at + 6], as its upper triangle."""
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    f = 1.0 / (a00 * c00 + a01 * c01 + a02 * c02)
    out[at], out[at + 1], out[at + 2] = f * c00, f * c01, f * c02
    out[at + 3] = f * (a00 * a22 - a02 * a02)
    out[at + 4] = f * (a01 * a02 - a00 * a12)
    out[at + 5] = f * (a00 * a11 - a01 * a01)


@njit(cache=True, error_model="numpy")
def _total(rays: Float64, order: Int64, first: int, last: int, prior: float, predicted: Float64, p: Float64) -> float:
    """Return the sum of the truncated misfits of the point p (3,) to rays, and to a predicted point."""
    total = 0.0
    for i in range(first, last):
        total += min(misfit(rays, order[i], p[0], p[1], p[2]), GATE)
    if prior > 0.0:
        vote = PRIOR_OF_TWO if last - first == 2 else PRIOR_OF_MORE
        total += vote * min(prior * _apart(p, predicted), GATE)
    return total


@njit(cache=True, error_model="numpy")
def _apart(p: Float64, q: Float64) -> float:
    """Return the squared distance of two points (3,) [m²]."""
    return float((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@njit(cache=True, error_model="numpy")
def _meeting(rays: Float64, k: int, m: int, p: Float64) -> bool:
    """Write where rays k and m pass each other closest into p (3,); return whether they do, in front of both."""
    w0, w1, w2 = rays[k, 0] - rays[m, 0], rays[k, 1] - rays[m, 1], rays[k, 2] - rays[m, 2]
    b = rays[k, 3] * rays[m, 3] + rays[k, 4] * rays[m, 4] + rays[k, 5] * rays[m, 5]
    d = rays[k, 3] * w0 + rays[k, 4] * w1 + rays[k, 5] * w2
    e = rays[m, 3] * w0 + rays[m, 4] * w1 + rays[m, 5] * w2
    square = 1.0 - b * b
    if square < PARALLEL:
        return False
    s, t = (b * e - d) / square, (e - b * d) / square
    if not (s > NEAREST_M and t > NEAREST_M):
        return False
    u, v = 1.0 / (rays[k, 6] * s * s + rays[k, 7]), 1.0 / (rays[m, 6] * t * t + rays[m, 7])
    u, v = u / (u + v), v / (u + v)
    for i in range(3):
        p[i] = u * (rays[k, i] + s * rays[k, 3 + i]) + v * (rays[m, i] + t * rays[m, 3 + i])
    return True


@njit(cache=True, error_model="numpy")
def _search(
    rays: Float64, order: Int64, first: int, last: int, prior: float, predicted: Float64, best: Float64
) -> bool:
    """Write the candidate with the least total misfit into best (3,); return whether there is one."""
    p, found, least = np.empty(3), False, math.inf
    if prior > 0.0:
        for i in range(3):
            best[i] = predicted[i]
        least, found = _total(rays, order, first, last, prior, predicted, best), True
    for a in range(first, last):
        k = order[a]
        for b in range(a if prior > 0.0 else a + 1, last):
            if a == b:
                s = 0.0
                for i in range(3):
                    s += rays[k, 3 + i] * (predicted[i] - rays[k, i])
                for i in range(3):
                    p[i] = rays[k, i] + max(s, NEAREST_M) * rays[k, 3 + i]
            elif not _meeting(rays, k, order[b], p):
                continue
            total = _total(rays, order, first, last, prior, predicted, p)
            if total < least:
                least, found = total, True
                for i in range(3):
                    best[i] = p[i]
    return found


@njit(cache=True, error_model="numpy")
def _clear(
    rays: Float64, order: Int64, first: int, last: int, prior: float, predicted: Float64, weights: Float64,
    out: Float64,
) -> bool:  # fmt: skip
    """Write the point of all rays and the prediction to out (9,); return whether they all agree."""
    if last - first < 2:
        return False
    for i in range(first, last):
        weights[order[i]] = 1.0
    fit_point(rays, order, first, last, weights, predicted[0], predicted[1], predicted[2], prior, out)
    worst = 0.0 if last - first > 2 else prior * _apart(out, predicted)
    for i in range(first, last):
        worst = max(worst, misfit(rays, order[i], out[0], out[1], out[2]))
    return worst < CLEAR


@njit(cache=True, error_model="numpy")
def agree(
    rays: Float64, order: Int64, first: int, last: int, variance: float, predicted: Float64, weights: Float64,
    out: Float64,
) -> int:  # fmt: skip
    """Find the point that the rays of a joint agree on, and weight the rays by their misfits to it.

    Args:
        rays, order, first, last: (n, 8), and the indices order[first:last] of the joint's rays.
        variance: of a coordinate of the predicted point [m²]; infinity without a prediction.
        predicted: (3,) predicted point [m].
        weights: (n,) written for these rays: Student-t weights, 0 for rays that contradict two that agree.
        out: (9,) written if two rays or more agree: the point, and the upper triangle of its covariance [m²].

    Returns:
        The number of rays that agree. With less than two, the point is unknown and the weights are about the
        prediction.
    """
    known = math.isfinite(variance)
    prior = 1.0 / (variance + SLACK_M * SLACK_M) if known else 0.0
    agreeing, best = 0, np.empty(3)
    clear = known and _clear(rays, order, first, last, prior, predicted, weights, out)
    for i in range(3):
        best[i] = out[i] if clear else predicted[i]
    if not clear and not _search(rays, order, first, last, prior, predicted, best):
        for i in range(first, last):
            weights[order[i]] = 0.0
        return 0
    for _turn in range(2):
        agreeing = 0
        for i in range(first, last):
            k = order[i]
            chi2 = misfit(rays, k, best[0], best[1], best[2])
            agreeing += chi2 < GATE
            weights[k] = student(chi2, 2.0, NU) if chi2 < GATE else 0.0
        if agreeing < 2:
            break
        fit_point(rays, order, first, last, weights, best[0], best[1], best[2], 1.0 / (FAR_M * FAR_M), out)
        for i in range(3):
            best[i] = out[i]
    if agreeing < 2:
        for i in range(first, last):
            k = order[i]
            chi2 = misfit(rays, k, predicted[0], predicted[1], predicted[2])
            weights[k] = student(chi2, 2.0, NU) if known and math.isfinite(chi2) else 0.0
    return agreeing
