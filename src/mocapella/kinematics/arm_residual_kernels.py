"""Kernels of the residuals of an arm's capsules, and of the normal equations by groups of capsules.

`arm_flesh_kernels` defines the capsules (*pieces*) and the state v (`STATE`,). A group is the capsules that the same
degrees of freedom move: a digit's bone, the palm, the forearm or the upper arm. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.arm_arrays import FitParameters
from mocapella.kinematics.arm_fit import ArmEvidence
from mocapella.kinematics.arm_flesh_kernels import (
    D_ARM_THICK,
    D_DIGITS,
    D_FOREARM,
    D_LENGTH,
    D_SCALE,
    D_THICK,
    D_UPPER,
    FOREARM,
    FOREARM_M,
    FROM,
    LENGTH,
    OF_FOREARM,
    OF_UPPER_ARM,
    RA,
    RB,
    UPPER,
    U,
    across,
)  # fmt: skip

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MOVERS = 8  # dofs of one piece beside the palm's, at most
GROUPS = 18  # groups of pieces that the same dofs move
Q_R, Q_ALONG, ROW = 6, 7, 10  # indices in a residual's numbers, and their count
_UNMEASURED = 0.4  # factor of the cost of flesh where nothing was measured
_FAR_PX = 30  # reach of the search for edges
JUDGED = 0.7  # factor of the robust scales when a result is judged


@njit(cache=True)
def group_of(owner: int, bone: int) -> int:
    """Return the index of the group of a capsule: capsules of a group are moved by the same degrees of freedom.

    ``owner`` (digit, or a negative code of palm, forearm or upper arm) and ``bone`` are its row of `ArmArrays.owners`.
    """
    return 3 * owner + bone if owner >= 0 else 14 - owner


@njit(cache=True)
def group_derivatives(
    joints: Float64, axes: Float64, columns: Int64, gains: Float64, rising: Int64, v: Float64, nz_free: int,
    A: Float64, at: Int64, counts: Int64,
) -> None:  # fmt: skip
    """Write the derivatives of each group's residuals by its degrees of freedom (dofs), without the palm's six.

    The derivative of a residual with normal n at a surface point p + r·n is a linear function of a few numbers q:
    n, the moment p × n, r, and p·n for the hand, n times the position along the bone for the arm. So only Σ q qᵀ is
    accumulated for a group, and multiplied by the linear functions once (`add_groups`).

    Args:
        joints, axes: (5, 4, 3) and (5, 5, 3) of `arm_flesh_kernels.flesh`.
        columns, gains, rising: (5, 5) of `ArmArrays`.
        v: (STATE,) sizes and directions.
        nz_free: number of free angles.
        A: (GROUPS, MOVERS, ROW) written: the linear functions.
        at: (GROUPS, MOVERS) written: index of each dof among all, ascending.
        counts: (GROUPS,) written: number of dofs.
    """
    body = 6 + nz_free
    A[:] = 0.0
    for group in range(GROUPS):
        n, row = 0, A[group]
        if group <= 15:
            if group < 15:
                d, bone = group // 3, group % 3
                for i in range(5):
                    k = rising[d, i]
                    column = columns[d, k]
                    origin = 0 if k < 2 else (2 if k == 3 else 1)
                    if column < 0 or bone < origin:
                        continue
                    x, y, z = joints[d, origin, 0], joints[d, origin, 1], joints[d, origin, 2]
                    wx, wy, wz = gains[d, k] * axes[d, k, 0], gains[d, k] * axes[d, k, 1], gains[d, k] * axes[d, k, 2]
                    row[n, 0], row[n, 1], row[n, 2] = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
                    row[n, 3], row[n, 4], row[n, 5] = wx, wy, wz
                    at[group, n] = 6 + column
                    n += 1
            row[n, Q_R], row[n, Q_ALONG], at[group, n] = 1.0, 1.0, body + D_SCALE
            row[n + 1, Q_R], at[group, n + 1] = 1.0, body + D_THICK
            n += 2
            if group < 15:
                for k in range(3):
                    row[n, k] = -joints[group // 3, 0, k]
                row[n, Q_ALONG], at[group, n] = 1.0, body + D_DIGITS + group // 3
                n += 1
            counts[group] = n
            continue
        fx, fy, fz = v[FOREARM], v[FOREARM + 1], v[FOREARM + 2]
        ax, ay, az = across(fx, fy, fz)
        bx, by, bz = fy * az - fz * ay, fz * ax - fx * az, fx * ay - fy * ax
        # The forearm's points move in proportion to their distance from the wrist, the upper arm's all equally.
        first, reach = (Q_ALONG, 1.0) if group == 14 - OF_FOREARM else (0, v[FOREARM_M])
        row[0, first], row[0, first + 1], row[0, first + 2] = reach * ax, reach * ay, reach * az
        row[1, first], row[1, first + 1], row[1, first + 2] = reach * bx, reach * by, reach * bz
        at[group, 0], at[group, 1], n = body + D_FOREARM, body + D_FOREARM + 1, 2
        if group == 14 - OF_UPPER_ARM:
            ux, uy, uz = v[UPPER], v[UPPER + 1], v[UPPER + 2]
            ax, ay, az = across(ux, uy, uz)
            row[2, Q_ALONG], row[2, Q_ALONG + 1], row[2, Q_ALONG + 2] = ax, ay, az
            row[3, Q_ALONG], row[3, Q_ALONG + 1], row[3, Q_ALONG + 2] = (
                uy * az - uz * ay,
                uz * ax - ux * az,
                ux * ay - uy * ax,
            )
            at[group, 2], at[group, 3], n = body + D_UPPER, body + D_UPPER + 1, 4
        reach /= v[FOREARM_M]
        row[n, first], row[n, first + 1], row[n, first + 2] = reach * fx, reach * fy, reach * fz
        at[group, n] = body + D_LENGTH
        row[n + 1, Q_R], at[group, n + 1] = 1.0, body + D_ARM_THICK
        counts[group] = n + 2


@njit(cache=True)
def residual_numbers(
    group: int, nx: float, ny: float, nz: float, px: float, py: float, pz: float, r: float, v: Float64, q: Float64,
) -> None:  # fmt: skip
    """Write the monomials q (ROW,) of a residual, in which its derivatives are linear; see `group_derivatives`.

    Args:
        group: index of the group.
        nx, ny, nz: unit normal n in the palm's frame.
        px, py, pz: point p on the piece's axis, palm's frame [m].
        r: the residual is at the point p + r·n [m].
        v: (STATE,) sizes and directions.
        q: (ROW,) written.
    """
    q[0], q[1], q[2] = nx, ny, nz
    q[3], q[4], q[5] = py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx
    q[Q_R] = r
    if group <= 15:
        q[Q_ALONG], q[Q_ALONG + 1], q[Q_ALONG + 2] = px * nx + py * ny + pz * nz, 0.0, 0.0
        return
    length = v[FOREARM_M]
    if group == 14 - OF_FOREARM:
        along = min(max(px * v[FOREARM] + py * v[FOREARM + 1] + pz * v[FOREARM + 2], 0.0), length)
    else:
        along = (px - length * v[FOREARM]) * v[UPPER] + (py - length * v[FOREARM + 1]) * v[UPPER + 1]
        along += (pz - length * v[FOREARM + 2]) * v[UPPER + 2]
    q[Q_ALONG], q[Q_ALONG + 1], q[Q_ALONG + 2] = along * nx, along * ny, along * nz


@njit(cache=True)
def add_residual(q: Float64, w: float, e: float, Q: Float64, b: Float64) -> None:
    """Add a weighted residual to the sums of its group: q qᵀ for the normal matrix, q e for the gradient.

    Args:
        q: (ROW,) of `residual_numbers`.
        w: weight [1/m²].
        e: the residual [m].
        Q, b: (ROW, ROW) and (ROW,) sums of w q qᵀ and w q e, updated.
    """
    for i in range(ROW):
        a = w * q[i]
        b[i] += a * e
        for k in range(ROW):
            Q[i, k] += a * q[k]


@njit(cache=True)
def add_groups(A: Float64, at: Int64, counts: Int64, Q: Float64, b: Float64, H: Float64, g: Float64) -> None:
    """Add all groups' sums to the normal equations.

    Args:
        A, at, counts: (GROUPS, MOVERS, ROW), (GROUPS, MOVERS) and (GROUPS,) of `group_derivatives`.
        Q, b: (GROUPS, ROW, ROW) and (GROUPS, ROW) sums of `add_residual`.
        H, g: (dofs, dofs), its lower triangle only, and (dofs,); added to.
    """
    T = np.empty(ROW)
    for group in range(GROUPS):
        kept = Q[group]
        for i in range(6):
            g[i] += b[group, i]
            for k in range(i + 1):
                H[i, k] += kept[i, k]
        for i in range(counts[group]):
            row, to, e = A[group, i], at[group, i], 0.0
            T[:] = 0.0
            for k in range(ROW):
                if row[k] != 0.0:
                    e += row[k] * b[group, k]
                    for j in range(ROW):
                        T[j] += row[k] * kept[k, j]
            g[to] += e
            for k in range(6):
                H[to, k] += T[k]
            for k in range(i + 1):
                e = 0.0
                for j in range(ROW):
                    e += T[j] * A[group, k, j]
                H[to, at[group, k]] += e


@njit(cache=True)
def nearest_opposite(front: Float64, opposite: Int64, line: int, column: int) -> tuple[int, int]:
    """Return (line, column) of the nearest pixel across the silhouette's edge; the pixel itself if no edge is near.

    Args:
        front, opposite: (h, w) of `ArmEvidence`.
        line, column: the pixel.
    """
    height = front.shape[0]
    arm = front[line, column] > 0.0
    best, y, x = 1e9, line, column
    for away in range(_FAR_PX):
        if away * away >= best:
            break
        for side in range(1 if away == 0 else 2):
            i = line + away if side == 0 else line - away
            if not 0 <= i < height:
                continue
            j = column if (front[i, column] > 0.0) != arm else opposite[i, column]
            if j < 0:
                continue
            d = (j - column) ** 2 + away * away
            if d < best:
                best, y, x = d, i, j
    return y, x


@njit(cache=True)
def robust(e: float, scale: float) -> tuple[float, float]:
    """Return weight and cost of a residual e, each from 0 to 1, by the Geman–McClure loss with a scale in e's unit."""
    s = (e / scale) ** 2
    f = 1.0 / (1.0 + s)
    return f * f, s * f


@njit(cache=True)
def compare(
    image: ArmEvidence, X: float, Y: float, Z: float, r: float, parameters: FitParameters,
    out: Float64,
) -> int:  # fmt: skip
    """Compute the residuals of a sphere in the model against the silhouette and the measured surface.

    A sphere is penalised outside the silhouette, and in front of the depth measured there: the camera would see it.
    Where an other object is nearer, the sphere is occluded and has no residual.

    Args:
        image: the measurements.
        X, Y, Z: centre of the sphere, camera frame [m].
        r: its radius [m].
        parameters: scales and allowances.
        out: (5,) written unless -1 is returned, 0 where there is no residual: distance of the sphere's surface beyond
            the silhouette [m]; its unit direction in the image (2), outwards; distance of its surface in front of the
            measured one, less the allowance [m]; the larger robust cost of both, 0 to 1.

    Returns:
        -1 if the centre is outside of the image or less than 5 cm deep, 0 where another object occludes it, else 1.
    """
    front, lens = image.front, image.lens
    if Z < 0.05:
        return -1
    height, width = front.shape
    px, py = lens[0] * X / Z + lens[2], lens[1] * Y / Z + lens[3]
    if not (-0.5 <= px < width - 0.5 and -0.5 <= py < height - 0.5):
        return -1
    column, line = int(px + 0.5), int(py + 0.5)
    there = front[line, column]
    surface = Z - r
    for k in range(5):
        out[k] = 0.0
    if there < 0.0 and -there < surface:
        return 0
    inside = there > 0.0
    edge_y, edge_x = nearest_opposite(front, image.opposite, line, column)
    if edge_y == line and edge_x == column:  # no edge is near: no cost inside, the full cost outside
        out[4] = 0.0 if inside else 1.0
    else:
        dx, dy = (edge_x - px) * Z / lens[0], (edge_y - py) * Z / lens[1]
        apart = math.sqrt(dx * dx + dy * dy)
        beyond = r - apart + parameters.edge_m if inside else r + apart - parameters.edge_m
        if beyond > 0.0 and apart > 1e-6:
            f = (-1.0 if inside else 1.0) / apart
            out[0], out[1], out[2] = beyond, f * dx, f * dy
            out[4] = robust(beyond, parameters.silhouette_scale_m)[1]
    ahead = there - surface - parameters.ahead_m
    if inside and ahead > 0.0:
        out[3] = ahead
        out[4] = max(out[4], robust(ahead, parameters.silhouette_scale_m)[1])
    if there == 0.0:  # flesh is possible where nothing was measured
        out[4] *= _UNMEASURED
    return 1


@njit(cache=True)
def sphere(pieces: Float64, digit: int, i: int, out: Float64) -> None:
    """Write one of six spheres along a digit's two outer bones.

    Args:
        pieces: (pieces, PIECE) of `arm_flesh_kernels.flesh`.
        digit: index of the digit.
        i: index of the sphere, 0 to 5.
        out: (4,) written: centre in the palm's frame, and radius [m].
    """
    p, f = pieces[3 * digit + 1 + i // 3], 0.5 * (i % 3)
    c = f * p[LENGTH]
    out[0], out[1], out[2] = p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2]
    out[3] = p[RA] + f * (p[RB] - p[RA])


@njit(cache=True)
def add_collisions(
    pieces: Float64, A: Float64, at: Int64, counts: Int64, v: Float64, parameters: FitParameters, only_costs: bool,
    H: Float64, g: Float64, costs: Float64,
) -> None:  # fmt: skip
    """Add the repulsion of digits whose spheres along the two outer bones overlap to the normal equations and costs.

    Args:
        pieces: (pieces, PIECE) of `arm_flesh_kernels.flesh`.
        A, at, counts: (GROUPS, MOVERS, ROW), (GROUPS, MOVERS) and (GROUPS,) of `group_derivatives`.
        v: (STATE,) sizes and directions.
        parameters: weight and allowed overlap.
        only_costs: do not change H and g.
        H, g: (dofs, dofs), its lower triangle only, and (dofs,); added to.
        costs: (`COST_TERMS`,) of `arm_fit_kernels.system`; element 2, the sum of squared overlaps [cm²], is added to.
    """
    K, to, q = np.empty(2 * MOVERS), np.empty(2 * MOVERS, dtype=np.int64), np.empty(ROW)
    p, o = np.empty(4), np.empty(4)
    for one in range(5):
        for other in range(one + 1, 5):
            for i in range(6):
                sphere(pieces, one, i, p)
                for k in range(6):
                    sphere(pieces, other, k, o)
                    within_m = p[3] + o[3] - parameters.overlap_m
                    dx, dy, dz = o[0] - p[0], o[1] - p[1], o[2] - p[2]
                    d2 = dx * dx + dy * dy + dz * dz
                    if d2 >= within_m * within_m or d2 < 1e-12:
                        continue
                    d = math.sqrt(d2)
                    over = within_m - d
                    costs[2] += (over / 0.01) ** 2
                    if only_costs:
                        continue
                    m = 0
                    for side in range(2):
                        digit, bone, ball = (other, 1 + k // 3, o) if side == 0 else (one, 1 + i // 3, p)
                        group, f = group_of(digit, bone), (1.0 if side == 0 else -1.0) / d
                        residual_numbers(group, f * dx, f * dy, f * dz, ball[0], ball[1], ball[2], 0.0, v, q)
                        for j in range(counts[group]):  # the palm moves both
                            moved = 0.0
                            for c in range(ROW):
                                moved += A[group, j, c] * q[c]
                            K[m], to[m] = moved, at[group, j]
                            m += 1
                    for a in range(m):
                        w = parameters.collision_information * K[a]
                        g[to[a]] += w * over
                        for b in range(m):
                            if to[b] <= to[a]:
                                H[to[a], to[b]] += w * K[b]
