"""Compiled Gauss–Newton correction of `mocapella.fusion.object_poses`; importing this module imports numba.

The iterated extended Kalman filter's update: the 6-DoF pose and twist that minimise the squared Mahalanobis distance
from the prediction plus the markers' squared reprojection errors over their variance.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: loops in place, arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.fusion.object_pose_values import MarkerPixels, PosePrediction, PoseResult
from mocapella.geometry.cholesky_kernels import factorise, substitute
from mocapella.geometry.triangulation_lane_kernels import linearised, numbers_of

Float64 = NDArray[np.float64]

N = 12
_UNDAMPED = np.float64(0.0)
STEPS = 15
SMALL_STEP = 1e-6
FARTHEST_STEP = 10.0


@njit(cache=True, error_model="numpy")
def turn(R: Float64, x: float, y: float, z: float) -> None:
    """Rotate R (3, 3) in place by the rotation vector (x, y, z) [rad]: R ← exp([x y z]×) R, by Rodrigues' formula."""
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = 1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0
    if angle > 1e-4:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    for j in range(3):
        p, q, r = R[0, j], R[1, j], R[2, j]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        R[0, j] = p + a * u + b * (y * w - z * v)
        R[1, j] = q + a * v + b * (z * u - x * w)
        R[2, j] = r + a * w + b * (x * v - y * u)


@njit(cache=True, error_model="numpy")
def rotation_between(R: Float64, R_0: Float64, out: Float64) -> None:
    """Write the rotation vector of R R_0ᵀ into ``out`` (3,) [rad]; valid below a half turn. R and R_0 are (3, 3)."""
    M = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            M[i, j] = R[i, 0] * R_0[j, 0] + R[i, 1] * R_0[j, 1] + R[i, 2] * R_0[j, 2]
    x, y, z = 0.5 * (M[2, 1] - M[1, 2]), 0.5 * (M[0, 2] - M[2, 0]), 0.5 * (M[1, 0] - M[0, 1])
    sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (M[0, 0] + M[1, 1] + M[2, 2] - 1.0)
    scale = 1.0 if sine < 1e-9 else math.atan2(sine, cosine) / sine
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit(cache=True, error_model="numpy")
def add_pixels(
    views: Float64, seen: MarkerPixels, R: Float64, x: Float64, A: Float64, g: Float64, J: Float64, cost: float
) -> float:
    """Add the normal equations of a frame's markers at a pose to A (12, 12), lower half, and g (12,).

    Args:
        views: (views, 25) the rig's cameras, see `geometry.triangulation.Views`.
        seen: the markers' pixels.
        R, x: (3, 3), (9,) rotation; position, velocity and angular velocity, as in `PosePrediction`.
        A, g: updated; the parameters are position [m], rotation from the left [rad], velocity [m/s] and angular
            velocity [rad/s].
        J: (2, 12) workspace.
        cost: cost so far.

    Returns:
        ``cost`` plus the squared residuals over their variance; infinite if a marker cannot be projected.
    """
    for m in range(len(seen.places)):
        if not seen.chosen[m]:
            continue
        q, s = seen.places[m], seen.later_s[m]
        a = R[0, 0] * q[0] + R[0, 1] * q[1] + R[0, 2] * q[2]
        b = R[1, 0] * q[0] + R[1, 1] * q[1] + R[1, 2] * q[2]
        c = R[2, 0] * q[0] + R[2, 1] * q[1] + R[2, 2] * q[2]
        # A readout is short: the rotation in it to first order.
        ar, br, cr = a + s * (x[7] * c - x[8] * b), b + s * (x[8] * a - x[6] * c), c + s * (x[6] * b - x[7] * a)
        px, py, pz = x[0] + s * x[3] + ar, x[1] + s * x[4] + br, x[2] + s * x[5] + cr
        du, dv, ux, uy, uz, vx, vy, vz = linearised(
            numbers_of(views, seen.camera), px, py, pz, seen.pixels[m, 0], seen.pixels[m, 1]
        )
        if not math.isfinite(du + dv):
            return math.inf
        for k, (dx, dy, dz) in enumerate(((ux, uy, uz), (vx, vy, vz))):
            J[k, 0], J[k, 1], J[k, 2] = dx, dy, dz
            J[k, 3], J[k, 4], J[k, 5] = br * dz - cr * dy, cr * dx - ar * dz, ar * dy - br * dx
            J[k, 6], J[k, 7], J[k, 8] = s * dx, s * dy, s * dz
            J[k, 9], J[k, 10], J[k, 11] = s * (b * dz - c * dy), s * (c * dx - a * dz), s * (a * dy - b * dx)
        weight = 1.0 / (seen.sd_px[m] * seen.sd_px[m])
        cost += weight * (du * du + dv * dv)
        for i in range(N):
            g[i] += weight * (J[0, i] * du + J[1, i] * dv)
            for j in range(i + 1):
                A[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j])
    return cost


@njit(cache=True, error_model="numpy")
def correct(views: Float64, seen: MarkerPixels, prediction: PosePrediction, result: PoseResult) -> float:
    """Minimise the cost of a pose and twist over a frame's pixels, from a prediction, by Gauss–Newton.

    Args:
        views: (views, 25) the rig's cameras, see `geometry.triangulation.Views`.
        seen, prediction: the frame's pixels, and the predicted pose and twist.
        result: the posterior, written.

    Returns:
        The smallest cost; infinite if the minimisation fails: then ``result`` is not valid.
    """
    R, x, R_0, x_0 = result.R, result.x, prediction.R, prediction.x
    information = prediction.information
    for i in range(3):
        for j in range(3):
            R[i, j] = R_0[i, j]
    for i in range(len(x_0)):
        x[i] = x_0[i]
    A, L, g, off, J = np.empty((N, N)), np.zeros((N, N)), np.empty(N), np.zeros(N), np.empty((2, N))
    cost = math.inf
    for step in range(STEPS):
        cost = 0.0
        for i in range(N):
            g[i] = 0.0
            for j in range(N):
                A[i, j] = information[i, j]
                g[i] -= information[i, j] * off[j]
            cost -= g[i] * off[i]
        cost = add_pixels(views, seen, R, x, A, g, J, cost)
        if not (math.isfinite(cost) and factorise(A, _UNDAMPED, L)):
            return math.inf
        substitute(L, g)
        size = 0.0
        for i in range(6):
            size = max(size, abs(g[i]))
        if not size < FARTHEST_STEP:
            return math.inf
        if size < SMALL_STEP and step > 0:
            break
        for i in range(3):
            x[i] += g[i]
            x[3 + i] += g[6 + i]
            x[6 + i] += g[9 + i]
        turn(R, g[3], g[4], g[5])
        rotation_between(R, R_0, off[3:6])
        for i in range(3):
            off[i] = x[i] - x_0[i]
            off[6 + i] = x[3 + i] - x_0[3 + i]
            off[9 + i] = x[6 + i] - x_0[6 + i]
    for j in range(N):
        for i in range(N):
            g[i] = 1.0 if i == j else 0.0
        substitute(L, g)
        for i in range(N):
            result.covariance[i, j] = g[i]
    return cost
