"""Kernels that fit an arm and a hand to the points of a depth image.

The flesh consists of tapered capsules about the bones. The fit minimises, over the palm's motion, the hand's angles,
the directions of forearm and upper arm, and the person's sizes,

    Σ ρ(distance of a point of the image from the flesh's visible side)
  + Σ ρ(distance of a piece of flesh beyond the silhouette, or in front of the measured surface)
  + Σ (overlap of digits)² + prior of sizes and angles + penalty beyond joint limits + prediction

by Gauss–Newton steps with points assigned anew before each: A. Tagliasacchi et al., "Robust Articulated-ICP for
Real-Time Hand Tracking", Computer Graphics Forum 34 (2015) 101, equations 1 to 8; the pieces of flesh as in A. Tkach,
M. Pauly, A. Tagliasacchi, "Sphere-Meshes for Real-Time Hand Modeling and Tracking", ACM Trans. Graph. 35 (2016) 222.
Residuals and derivatives are in the palm's frame. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, substitute
from mocapella.geometry.turn_kernels import FIRST, orthonormal, turn_between, turned
from mocapella.kinematics.hand_fit_kernels import _penalty, digit_angles, digit_points, within
from mocapella.kinematics.hand_kernels import BASE, DIGIT, L1

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Picture = tuple[Float64, Int64, Float64]
"""Front, opposite and lens of `ArmEvidence`."""

# Row of a piece: its axis from FROM along U for LENGTH, the radii at both ends, and numbers derived from these.
FROM, U, LENGTH, RA, RB = 0, 3, 6, 7, 8
TAN, MIDDLE, BOUND = 9, 10, 13
PIECE = 14
# Owner of a piece, whose dofs move it: a digit, or one of these.
OF_PALM, OF_FOREARM, OF_UPPER_ARM = -1, -2, -3

# Indices of the sizes and directions v.
SCALE, THICK, FOREARM_M, ARM_THICK = 0, 1, 2, 3  # hand's size and thickness over the shape's, length [m], thickness
FOREARM, UPPER = 4, 7  # unit vectors in the palm's frame: wrist to elbow, elbow to shoulder
DIGITS = 10  # (5,) lengths of the digits over the shape's, beside the hand's size
STATE = 15

# Indices of the other dofs, behind the palm's six and the free angles.
D_FOREARM, D_UPPER, D_LENGTH, D_SCALE, D_THICK, D_ARM_THICK, D_DIGITS = 0, 2, 4, 5, 6, 7, 8
BODY_DOFS = 13

COSTS = (1.0, 0.5, 0.1, 0.002)  # weights of points, flesh, overlapping digits (at most 2), deviations from the prior
MOVERS = 8  # dofs of one piece beside the palm's, at most
GROUPS = 18  # groups of pieces that the same dofs move
Q_R, Q_ALONG, ROW = 6, 7, 10  # indices in a residual's numbers, and their count
_UNMEASURED = 0.4  # factor of the cost of flesh where nothing was measured
_JUDGED = 0.7  # factor of the robust scales when a result is judged
_FAR_PX = 30  # reach of the search for edges
_REST_M, _REST_RAD = 0.0002, 0.004  # smaller steps count as convergence
_TARGET_SD = 0.004  # standard deviation of a fingertip detected as a branch's end [m]


@njit(cache=True)
def _piece(
    row: Float64, ax: float, ay: float, az: float, bx: float, by: float, bz: float, ra: float, rb: float,
) -> None:  # fmt: skip
    dx, dy, dz = bx - ax, by - ay, bz - az
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    f = 1.0 / max(length, 1e-6)
    row[FROM], row[FROM + 1], row[FROM + 2] = ax, ay, az
    row[U], row[U + 1], row[U + 2] = f * dx, f * dy, f * dz
    row[LENGTH], row[RA], row[RB] = length, ra, rb
    s = min(max((ra - rb) * f, -0.9), 0.9)
    row[TAN] = s / math.sqrt(1.0 - s * s)
    row[MIDDLE], row[MIDDLE + 1], row[MIDDLE + 2] = 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)
    row[BOUND] = 0.5 * length + max(ra, rb)


@njit(cache=True)
def _digit_pieces(d: int, outer: float, radii: Float64, thick: float, x: Float64, pieces: Float64) -> None:
    """Write the three pieces of a digit with joints x (4, 3) and an outer bone of length ``outer`` [m]."""
    for bone in range(3):
        bx, by, bz = x[bone + 1, 0], x[bone + 1, 1], x[bone + 1, 2]
        if bone == 2:  # the landmark is nearer to the flesh's end than a radius
            f = radii[5, 4] * thick / max(outer, 1e-6)
            bx -= f * (bx - x[2, 0])
            by -= f * (by - x[2, 1])
            bz -= f * (bz - x[2, 2])
        _piece(
            pieces[3 * d + bone], x[bone, 0], x[bone, 1], x[bone, 2], bx, by, bz,
            thick * radii[d, bone], thick * radii[d, bone + 1],
        )  # fmt: skip


@njit(cache=True)
def flesh(
    digits: Float64, mirror: float, radii: Float64, palm: Float64, columns: Int64, gains: Float64, z: Float64,
    v: Float64, rows: Float64, joints: Float64, axes: Float64, pieces: Float64,
) -> None:  # fmt: skip
    """Write the pieces (15 + palm + 3, PIECE) of an arm in the palm's frame, its digits' joints and axes.

    Args:
        digits: (5, DIGIT) of the shape.
        mirror: -1 of a left hand.
        radii: (5, 4) of the digits at their joints, and (5,) forearm and upper arm at wrist (2), elbow, shoulder [m].
        palm: (k, 8) two points and radii of a right hand's palm [m].
        z, v: free angles, and the state's other numbers.
        rows, joints, axes: (5, DIGIT), (5, 4, 3), (5, 5, 3), out.
    """
    s, thick, q = v[SCALE], v[THICK] * v[SCALE], np.empty(5)
    for d in range(5):
        for k in range(DIGIT):
            rows[d, k] = digits[d, k]
        for k in range(3):
            rows[d, L1 + k] *= s * v[DIGITS + d]
            rows[d, BASE + k] *= s
        digit_angles(z, columns, gains, d, q)
        digit_points(rows[d], mirror, q, joints[d], axes[d])
        _digit_pieces(d, rows[d, L1 + 2], radii, thick, joints[d], pieces)
    n = 15
    for k in range(len(palm)):
        _piece(
            pieces[n], mirror * s * palm[k, 0], s * palm[k, 1], s * palm[k, 2], mirror * s * palm[k, 3],
            s * palm[k, 4], s * palm[k, 5], thick * palm[k, 6], thick * palm[k, 7],
        )  # fmt: skip
        n += 1
    ex, ey, ez = v[FOREARM_M] * v[FOREARM], v[FOREARM_M] * v[FOREARM + 1], v[FOREARM_M] * v[FOREARM + 2]
    wide = radii[5, 1] * s * v[ARM_THICK]
    for side in range(2):
        w = wide if side == 0 else -wide
        _piece(
            pieces[n], w, 0.0, 0.0, ex + 0.4 * w, ey, ez, s * v[ARM_THICK] * radii[5, 0], s * v[ARM_THICK] * radii[5, 2]
        )
        n += 1
    ux, uy, uz = v[UPPER], v[UPPER + 1], v[UPPER + 2]
    _piece(
        pieces[n], ex, ey, ez, ex + 0.25 * ux, ey + 0.25 * uy, ez + 0.25 * uz, s * v[ARM_THICK] * radii[5, 2],
        s * v[ARM_THICK] * radii[5, 3],
    )  # fmt: skip


@njit(cache=True)
def balls(pieces: Float64, owners: Int64, R: Float64, t: Float64, spacing: float, out: Float64) -> int:
    """Write spheres along the flesh into out (k, 5), camera [m], with 0 in the last column for the arm's.

    Returns:
        Their number.
    """
    n = 0
    for i in range(len(pieces)):
        p = pieces[i]
        count = max(int(p[LENGTH] / spacing), 1) + 1
        for k in range(count):
            if n == len(out):
                return n
            f = k / (count - 1)
            c = f * p[LENGTH]
            x, y, z = p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2]
            for a in range(3):
                out[n, a] = R[3 * a] * x + R[3 * a + 1] * y + R[3 * a + 2] * z + t[a]
            out[n, 3] = p[RA] + f * (p[RB] - p[RA])
            out[n, 4] = 1.0 if owners[i, 0] >= OF_PALM else 0.0
            n += 1
    return n


@njit(cache=True)
def closest(
    pieces: Float64, few: int, first: int, x: float, y: float, z: float, vx: float, vy: float, vz: float,
    out: Float64,
) -> int:  # fmt: skip
    """Return the piece nearest to a point; write outward normal, position on the axis and distance into out (5,).

    On the side that faces away from the camera, the distance is that from the front, along the view (vx, vy, vz). For a
    capsule this equals the silhouette-aware correspondence of Tagliasacchi et al. (section 4.1).
    """
    best, which, nearest = 1e9, -1, 1e9
    for k in range(-1, few):
        i = first if k < 0 else k
        if k == first:
            continue
        p = pieces[i]
        mx, my, mz = x - p[MIDDLE], y - p[MIDDLE + 1], z - p[MIDDLE + 2]
        reach = nearest + p[BOUND]
        if mx * mx + my * my + mz * mz > reach * reach:
            continue
        dx, dy, dz = x - p[FROM], y - p[FROM + 1], z - p[FROM + 2]
        along = dx * p[U] + dy * p[U + 1] + dz * p[U + 2]
        across = math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
        c = min(max(along - across * p[TAN], 0.0), p[LENGTH])
        r = p[RA] + (p[RB] - p[RA]) * c / max(p[LENGTH], 1e-6)
        dx, dy, dz = dx - c * p[U], dy - c * p[U + 1], dz - c * p[U + 2]
        d = math.sqrt(dx * dx + dy * dy + dz * dz)
        f = 1.0 / max(d, 1e-9)
        nx, ny, nz = f * dx, f * dy, f * dz
        e = d - r
        facing = dx * vx + dy * vy + dz * vz
        if facing > 0.2 * d:
            e = facing + r
            nx, ny, nz = vx, vy, vz
        if abs(e) < nearest:
            nearest, best, which = abs(e), e, i
            out[0], out[1], out[2], out[3] = nx, ny, nz, c
    out[4] = best
    return which


@njit(cache=True)
def _across(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a unit vector perpendicular to a unit vector."""
    if abs(x) < 0.8:
        f = 1.0 / math.sqrt(y * y + z * z)
        return 0.0, f * z, -f * y
    f = 1.0 / math.sqrt(x * x + z * z)
    return -f * z, 0.0, f * x


@njit(cache=True)
def _group(owner: int, bone: int) -> int:
    """Return the group of a piece: a digit's bone, the palm, the forearm or the upper arm."""
    return 3 * owner + bone if owner >= 0 else 14 - owner


@njit(cache=True)
def _movers(
    joints: Float64, axes: Float64, columns: Int64, gains: Float64, rising: Int64, v: Float64, nz_free: int,
    A: Float64, at: Int64, counts: Int64,
) -> None:  # fmt: skip
    """Write each group's derivatives by its dofs, except the palm's six, which all groups share.

    The derivative of a residual with normal n at a point p + r·n of the flesh is a linear function of a few numbers q:
    n, the moment p × n, r, and p·n for the hand, n times the position along the bone for the arm. So only Σ q qᵀ is
    accumulated for a group, and multiplied by the linear functions once (`_add_groups`).

    Args:
        A: (GROUPS, MOVERS, ROW) the linear functions, written.
        at: (GROUPS, MOVERS) index of each dof, ascending, written.
        counts: (GROUPS,) number of dofs, written.
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
        ax, ay, az = _across(fx, fy, fz)
        bx, by, bz = fy * az - fz * ay, fz * ax - fx * az, fx * ay - fy * ax
        # The forearm's points move in proportion to their distance from the wrist, the upper arm's all equally.
        first, reach = (Q_ALONG, 1.0) if group == 14 - OF_FOREARM else (0, v[FOREARM_M])
        row[0, first], row[0, first + 1], row[0, first + 2] = reach * ax, reach * ay, reach * az
        row[1, first], row[1, first + 1], row[1, first + 2] = reach * bx, reach * by, reach * bz
        at[group, 0], at[group, 1], n = body + D_FOREARM, body + D_FOREARM + 1, 2
        if group == 14 - OF_UPPER_ARM:
            ux, uy, uz = v[UPPER], v[UPPER + 1], v[UPPER + 2]
            ax, ay, az = _across(ux, uy, uz)
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
def _numbers(
    group: int, nx: float, ny: float, nz: float, px: float, py: float, pz: float, r: float, v: Float64, q: Float64,
) -> None:  # fmt: skip
    """Write the numbers q (ROW,) of a residual, as `_movers` describes them."""
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
def _add(q: Float64, w: float, e: float, Q: Float64, b: Float64) -> None:
    """Add a residual to its group's sums Q (ROW, ROW) and b (ROW,)."""
    for i in range(ROW):
        a = w * q[i]
        b[i] += a * e
        for k in range(ROW):
            Q[i, k] += a * q[k]


@njit(cache=True)
def _add_groups(A: Float64, at: Int64, counts: Int64, Q: Float64, b: Float64, H: Float64, g: Float64) -> None:
    """Add the groups' sums to the lower triangle of H and to g."""
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
def _nearest_opposite(front: Float64, opposite: Int64, line: int, column: int) -> tuple[int, int]:
    """Return the nearest pixel across the silhouette's edge, or the pixel itself where no edge is near."""
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
def _robust(e: float, scale: float) -> tuple[float, float]:
    """Return weight and cost, from 0 to 1, of the Geman–McClure loss."""
    s = (e / scale) ** 2
    f = 1.0 / (1.0 + s)
    return f * f, s * f


@njit(cache=True)
def _beside(
    front: Float64, opposite: Int64, lens: Float64, X: float, Y: float, Z: float, r: float, numbers: Float64,
    out: Float64,
) -> int:  # fmt: skip
    """Compare a sphere of flesh at (X, Y, Z), camera frame, with the silhouette and the measured surface.

    Args:
        out: (5,) written: distance beyond the silhouette [m], 0 within it; its direction in the image, outwards from
            the edge; distance in front of the measured surface; the larger robust cost of both.

    Returns:
        -1 outside of the image, 0 where another object occludes it, else 1.
    """
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
    edge_y, edge_x = _nearest_opposite(front, opposite, line, column)
    if edge_y == line and edge_x == column:  # no edge is near: no cost inside, the full cost outside
        out[4] = 0.0 if inside else 1.0
    else:
        dx, dy = (edge_x - px) * Z / lens[0], (edge_y - py) * Z / lens[1]
        apart = math.sqrt(dx * dx + dy * dy)
        beyond = r - apart + numbers[8] if inside else r + apart - numbers[8]
        if beyond > 0.0 and apart > 1e-6:
            f = (-1.0 if inside else 1.0) / apart
            out[0], out[1], out[2] = beyond, f * dx, f * dy
            out[4] = _robust(beyond, numbers[1])[1]
    ahead = there - surface - numbers[5]
    if inside and ahead > 0.0:
        out[3] = ahead
        out[4] = max(out[4], _robust(ahead, numbers[1])[1])
    if there == 0.0:  # flesh is possible where nothing was measured
        out[4] *= _UNMEASURED
    return 1


@njit(cache=True)
def system(
    digits: Float64, mirror: float, radii: Float64, palm: Float64, owners: Int64, columns: Int64, gains: Float64,
    rising: Int64, points: Float64, weights: Float64, which: Int64, picture: Picture, R: Float64, t: Float64,
    z: Float64, v: Float64, numbers: Float64, H: Float64, g: Float64, costs: Float64, targets: Float64,
    only_costs: bool,
) -> None:  # fmt: skip
    """Add the normal equations of the fit's geometric terms to the lower triangle of H and to g.

    Args:
        owners: (pieces, 2) digit or other owner of a piece, and bone.
        rising: (5, 5) indices that sort each digit's `columns`.
        points, weights: (m, 3) of the image, camera [m], and their weights (m,).
        which: (m,) the piece last assigned to each point, in and out.
        picture: (front, opposite, lens): `front` (h, w) [m] the surface of what may be the arm, minus that of other
            things, 0 where nothing was measured; the nearest column in a line that is the arm's where a pixel is not,
            and the other way round; lens (4,) of these pixels.
        numbers: (10,) scale of the points' robust cost [m], of the silhouette's [m], variances' inverses of points,
            silhouette and collisions, how far before the surface flesh may stand [m], how far digits may overlap [m],
            how many pieces may explain points, half a pixel's side [m], how many times as sure the silhouette is in the
            last third of a fit.
        costs: (5,) sums of robust costs from 0 to 1: of points, of the silhouette by its area [m²], of collisions; and
            that area, and what of it other things hide, out.
        targets: (5, 3) where fingertips should be, camera [m]; NaN where that is not known.
        only_costs: do not change H and g.
    """
    front, opposite, lens = picture
    nz_free = len(z)
    rows, joints, axes = np.empty((5, DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    pieces = np.empty((len(owners), PIECE))
    flesh(digits, mirror, radii, palm, columns, gains, z, v, rows, joints, axes, pieces)
    q, hit, beside = np.empty(ROW), np.empty(5), np.empty(5)
    A, at, counts = np.empty((GROUPS, MOVERS, ROW)), np.empty((GROUPS, MOVERS), np.int64), np.empty(GROUPS, np.int64)
    Q, b = np.zeros((GROUPS, ROW, ROW)), np.zeros((GROUPS, ROW))
    if not only_costs:
        _movers(joints, axes, columns, gains, rising, v, nz_free, A, at, counts)
    ox = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
    oy = -(R[1] * t[0] + R[4] * t[1] + R[7] * t[2])
    oz = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
    few = int(numbers[7])
    for k in range(len(costs)):
        costs[k] = 0.0
    for i in range(len(points)):
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        vx, vy, vz = x - ox, y - oy, w - oz
        f = 1.0 / math.sqrt(vx * vx + vy * vy + vz * vz)
        piece = closest(pieces, few, which[i], x, y, w, f * vx, f * vy, f * vz, hit)
        which[i] = piece
        weight, cost = _robust(hit[4], numbers[0])
        costs[0] += weights[i] * cost
        if only_costs or weight < 0.01:
            continue
        p, c = pieces[piece], hit[3]
        r = p[RA] + (p[RB] - p[RA]) * c / max(p[LENGTH], 1e-6)
        group = _group(owners[piece, 0], owners[piece, 1])
        _numbers(
            group, hit[0], hit[1], hit[2], p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2],
            r, v, q,
        )  # fmt: skip
        _add(q, weights[i] * weight * numbers[2], hit[4], Q[group], b[group])
    for i in range(few):
        owner, bone = owners[i, 0], owners[i, 1]
        p = pieces[i]
        steps = 3 if owner >= 0 else (3 if owner == OF_PALM else 6)
        for step in range(steps):
            if owner >= 0 and bone < 2 and step == steps - 1:
                continue  # the next bone's first
            c = p[LENGTH] * step / (steps - 1)
            r = p[RA] + (p[RB] - p[RA]) * step / (steps - 1)
            x, y, w = p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2]
            X = R[0] * x + R[1] * y + R[2] * w + t[0]
            Y = R[3] * x + R[4] * y + R[5] * w + t[1]
            Z = R[6] * x + R[7] * y + R[8] * w + t[2]
            # Palm and forearm overlap themselves.
            area = 2.0 * r * max(p[LENGTH] / (steps - 1), 0.005) * (1.0 if owner >= 0 else 0.4)
            if owner == OF_UPPER_ARM:
                area *= 0.1  # often hidden, and then it may be anywhere
            said = _beside(front, opposite, lens, X, Y, Z, r, numbers, beside)
            costs[3] += area * (said >= 0)
            costs[4] += area * (said == 0)
            if said <= 0:
                continue
            costs[1] += area * beside[4]
            if only_costs:
                continue
            group = _group(owner, bone)
            # Flesh beyond the silhouette is moved inwards, sideways.
            if beside[0] > 0.0:
                ux, uy = beside[1], beside[2]
                nx, ny, nz = R[0] * ux + R[3] * uy, R[1] * ux + R[4] * uy, R[2] * ux + R[5] * uy
                weight = _robust(beside[0], numbers[1])[0]
                _numbers(group, nx, ny, nz, x, y, w, -r, v, q)  # it stands out less as it gets thinner
                _add(q, max(weight, 0.1) * numbers[3], min(beside[0], 0.03), Q[group], b[group])
            if beside[3] > 0.0:  # in front of the measured surface: move it back along the view
                f = 1.0 / math.sqrt(X * X + Y * Y + Z * Z)
                nx = f * (R[0] * X + R[3] * Y + R[6] * Z)
                ny = f * (R[1] * X + R[4] * Y + R[7] * Z)
                nz = f * (R[2] * X + R[5] * Y + R[8] * Z)
                weight = _robust(beside[3], numbers[1])[0]
                _numbers(group, nx, ny, nz, x, y, w, 0.0, v, q)
                _add(q, weight * numbers[3], beside[3], Q[group], b[group])
    _collisions(pieces, A, at, counts, v, numbers, only_costs, H, g, costs)
    if only_costs:
        return
    for d in range(5):
        X, Y, Z = targets[d, 0], targets[d, 1], targets[d, 2]
        if not math.isfinite(X):
            continue
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        px, py, pz = joints[d, 3, 0], joints[d, 3, 1], joints[d, 3, 2]
        for k in range(3):
            nx, ny, nz = 1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2)
            e = nx * (x - px) + ny * (y - py) + nz * (w - pz)
            _numbers(3 * d + 2, nx, ny, nz, px, py, pz, 0.0, v, q)
            _add(q, 1.0 / _TARGET_SD**2, e, Q[3 * d + 2], b[3 * d + 2])
    _add_groups(A, at, counts, Q, b, H, g)


@njit(cache=True)
def _ball(pieces: Float64, digit: int, i: int, out: Float64) -> None:
    """Write the middle and the radius of the i-th of six balls along a digit's two outer bones into out (4,)."""
    p, f = pieces[3 * digit + 1 + i // 3], 0.5 * (i % 3)
    c = f * p[LENGTH]
    out[0], out[1], out[2] = p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2]
    out[3] = p[RA] + f * (p[RB] - p[RA])


@njit(cache=True)
def _collisions(
    pieces: Float64, A: Float64, at: Int64, counts: Int64, v: Float64, numbers: Float64, only_costs: bool,
    H: Float64, g: Float64, costs: Float64,
) -> None:  # fmt: skip
    """Add the repulsion of digits whose spheres along the two outer bones overlap."""
    K, to, q = np.empty(2 * MOVERS), np.empty(2 * MOVERS, dtype=np.int64), np.empty(ROW)
    p, o = np.empty(4), np.empty(4)
    for one in range(5):
        for other in range(one + 1, 5):
            for i in range(6):
                _ball(pieces, one, i, p)
                for k in range(6):
                    _ball(pieces, other, k, o)
                    within_m = p[3] + o[3] - numbers[6]
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
                        group, f = _group(digit, bone), (1.0 if side == 0 else -1.0) / d
                        _numbers(group, f * dx, f * dy, f * dz, ball[0], ball[1], ball[2], 0.0, v, q)
                        for j in range(counts[group]):  # the palm moves both
                            moved = 0.0
                            for c in range(ROW):
                                moved += A[group, j, c] * q[c]
                            K[m], to[m] = moved, at[group, j]
                            m += 1
                    for a in range(m):
                        w = numbers[4] * K[a]
                        g[to[a]] += w * over
                        for b in range(m):
                            if to[b] <= to[a]:
                                H[to[a], to[b]] += w * K[b]


@njit(cache=True)
def swept(
    digits: Float64, mirror: float, radii: Float64, palm: Float64, owners: Int64, columns: Int64, gains: Float64,
    c_max: float, points: Float64, weights: Float64, picture: Picture, prior_mean: Float64, prior: Float64, R: Float64,
    t: Float64, z: Float64, v: Float64, numbers: Float64, digit: int, tries: Float64, out: Float64,
) -> None:  # fmt: skip
    """Write into out (k,) the cost of a fit for each of some postures of a digit, up to a common constant.

    Only the terms that depend on the digit are computed: points that no other piece explains, the digit's own flesh and
    its overlaps. So dozens of postures cost no more than a step of the fit.

    Args:
        tries: (k, 5) free angles of the digit, in the order of `columns`; brought within the limits in place.
        Others: as of `system`.
    """
    front, opposite, lens = picture
    rows, joints, axes = np.empty((5, DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    pieces = np.empty((len(owners), PIECE))
    flesh(digits, mirror, radii, palm, columns, gains, z, v, rows, joints, axes, pieces)
    now, hit, beside, q = numbers.copy(), np.empty(5), np.empty(5), np.empty(5)
    now[0], now[1] = _JUDGED * numbers[0], _JUDGED * numbers[1]
    ox = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
    oy = -(R[1] * t[0] + R[4] * t[1] + R[7] * t[2])
    oz = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
    for bone in range(3):  # away
        for k in range(3):
            pieces[3 * digit + bone, MIDDLE + k] = 1e9
    reach = 0.03
    for k in range(3):
        reach += rows[digit, L1 + k]
    kept, few, total, first = np.empty((len(points), 8)), 0, 0.0, np.int64(15)
    for i in range(len(points)):
        total += weights[i]
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        dx, dy, dz = x - joints[digit, 0, 0], y - joints[digit, 0, 1], w - joints[digit, 0, 2]
        if weights[i] <= 0.0 or dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        vx, vy, vz = x - ox, y - oy, w - oz
        f = 1.0 / math.sqrt(vx * vx + vy * vy + vz * vz)
        first = closest(pieces, len(pieces), first, x, y, w, f * vx, f * vy, f * vz, hit)
        cost = _robust(hit[4], now[0])[1]
        if cost < 0.05:
            continue
        kept[few, 0], kept[few, 1], kept[few, 2] = x, y, w
        kept[few, 3], kept[few, 4], kept[few, 5] = f * vx, f * vy, f * vz
        kept[few, 6], kept[few, 7] = weights[i], cost
        few += 1
    area = 0.0
    for i in range(len(pieces)):
        p = pieces[i]
        area += (p[RA] + p[RB]) * max(p[LENGTH], 0.005) * (1.0 if owners[i, 0] >= 0 else 0.4)
    own, one, other, angles = np.empty((3, PIECE)), np.empty(4), np.empty(4), z.copy()
    for c in range(len(tries)):
        for k in range(5):
            if columns[digit, k] >= 0:
                angles[columns[digit, k]] = tries[c, k]
        within(digits, columns, gains, angles, c_max)
        unusual = 0.0
        for i in range(len(angles)):
            for k in range(len(angles)):
                unusual += (angles[i] - prior_mean[i]) * prior[i, k] * (angles[k] - prior_mean[k])
        for k in range(5):
            if columns[digit, k] >= 0:
                tries[c, k] = angles[columns[digit, k]]
        digit_angles(angles, columns, gains, digit, q)
        digit_points(rows[digit], mirror, q, joints[digit], axes[digit])
        _digit_pieces(digit, rows[digit, L1 + 2], radii, v[THICK] * v[SCALE], joints[digit], pieces)
        for k in range(3):
            for i in range(PIECE):
                own[k, i] = pieces[3 * digit + k, i]
        unexplained = 0.0
        for i in range(few):
            closest(own, len(own), FIRST, kept[i, 0], kept[i, 1], kept[i, 2], kept[i, 3], kept[i, 4], kept[i, 5], hit)
            unexplained += kept[i, 6] * min(_robust(hit[4], now[0])[1], kept[i, 7])
        outside = 0.0
        for bone in range(3):
            p = own[bone]
            for step in range(3):
                if bone < 2 and step == 2:
                    continue  # the next bone's first
                a, r = 0.5 * step * p[LENGTH], p[RA] + (p[RB] - p[RA]) * 0.5 * step
                x, y, w = p[FROM] + a * p[U], p[FROM + 1] + a * p[U + 1], p[FROM + 2] + a * p[U + 2]
                X = R[0] * x + R[1] * y + R[2] * w + t[0]
                Y = R[3] * x + R[4] * y + R[5] * w + t[1]
                Z = R[6] * x + R[7] * y + R[8] * w + t[2]
                if _beside(front, opposite, lens, X, Y, Z, r, now, beside) > 0:
                    outside += 2.0 * r * max(0.5 * p[LENGTH], 0.005) * beside[4]
        overlap = 0.0
        for rival in range(5):
            if rival == digit:
                continue
            for i in range(6):
                _ball(pieces, digit, i, one)
                for k in range(6):
                    _ball(pieces, rival, k, other)
                    within_m = one[3] + other[3] - now[6]
                    d2 = (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 + (one[2] - other[2]) ** 2
                    if d2 < within_m * within_m:
                        overlap += ((within_m - math.sqrt(d2)) / 0.01) ** 2
        out[c] = (
            unexplained / max(total, 1.0) + COSTS[1] * outside / area + COSTS[2] * min(overlap, 2.0)
            + COSTS[3] * unusual
        )  # fmt: skip


@njit(cache=True)
def relevance(
    points: Float64, R: Float64, t: Float64, v: Float64, length: float, forearm: float, beyond: float, out: Float64,
) -> None:  # fmt: skip
    """Write the weight of each point (m, 3) into out (m,), as `ArmModel.relevance` describes."""
    for i in range(len(points)):
        X, Y, Z = points[i, 0] - t[0], points[i, 1] - t[1], points[i, 2] - t[2]
        x = (R[0] * X + R[3] * Y + R[6] * Z) / v[SCALE]
        y = (R[1] * X + R[4] * Y + R[7] * Z) / v[SCALE]
        z = (R[2] * X + R[5] * Y + R[8] * Z) / v[SCALE]
        along = x * v[FOREARM] + y * v[FOREARM + 1] + z * v[FOREARM + 2]
        across = x * x + y * y + z * z - along * along
        if 0.0 < along < forearm + 0.05 and across < 0.07**2:
            out[i] = 0.5
        elif x * x + y * y + (z - 0.45 * length) ** 2 < (0.85 * length) ** 2:
            out[i] = 1.0
        else:
            out[i] = beyond


@njit(cache=True)
def _shows(front: Float64, lens: Float64, X: float, Y: float, Z: float, near: float) -> bool:
    """Return whether the image's surface is near a point, at its pixel or one beside it."""
    column, line = int(lens[0] * X / Z + lens[2] + 0.5), int(lens[1] * Y / Z + lens[3] + 0.5)
    for i in range(max(line - 1, 0), min(line + 2, front.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, front.shape[1])):
            if abs(front[i, j] - Z) < near:
                return True
    return False


@njit(cache=True)
def visible(
    pieces: Float64, places: Float64, R: Float64, t: Float64, front: Float64, lens: Float64, near: float,
    out: Float64,
) -> None:  # fmt: skip
    """Write the share of the camera-facing flesh about each landmark that the image confirms, into out (k,).

    The flesh is sampled in rings about its axis: before the landmark, at it and beyond it; at a fingertip, before it
    and on the round end.

    Args:
        pieces: of `flesh`.
        places: (k, 3) of each landmark the piece, the position along it from 0 to 1, and whether it ends there.
        near: largest distance of the image's surface from the flesh's [m].
    """
    for i in range(len(places)):
        p, f = pieces[int(places[i, 0])], places[i, 1]
        r = p[RA] + f * (p[RB] - p[RA])
        ax, ay, az = _across(p[U], p[U + 1], p[U + 2])
        bx, by, bz = p[U + 1] * az - p[U + 2] * ay, p[U + 2] * ax - p[U] * az, p[U] * ay - p[U + 1] * ax
        facing, agree, ends = 0, 0, places[i, 2] > 0.0
        for ring in range(5 if ends else 3):
            along, sine = f * p[LENGTH] + (ring - 1) * r, 0.0
            if ends:
                along = f * p[LENGTH] + min(0.5 * ring - 1.0, 0.0) * r
                sine = 0.0 if ring < 3 else (0.5 if ring == 3 else 0.9)
            cosine = math.sqrt(1.0 - sine * sine)
            for k in range(12):
                c, s = cosine * math.cos(k * math.pi / 6), cosine * math.sin(k * math.pi / 6)
                nx, ny, nz = (
                    c * ax + s * bx + sine * p[U],
                    c * ay + s * by + sine * p[U + 1],
                    c * az + s * bz + sine * p[U + 2],
                )
                x, y, w = (
                    p[FROM] + along * p[U] + r * nx,
                    p[FROM + 1] + along * p[U + 1] + r * ny,
                    p[FROM + 2] + along * p[U + 2] + r * nz,
                )
                X = R[0] * x + R[1] * y + R[2] * w + t[0]
                Y = R[3] * x + R[4] * y + R[5] * w + t[1]
                Z = R[6] * x + R[7] * y + R[8] * w + t[2]
                away = nx * (R[0] * X + R[3] * Y + R[6] * Z) + ny * (R[1] * X + R[4] * Y + R[7] * Z)
                away += nz * (R[2] * X + R[5] * Y + R[8] * Z)
                if Z < 0.05 or away > -0.1 * math.sqrt(X * X + Y * Y + Z * Z):
                    continue
                facing += 1
                agree += _shows(front, lens, X, Y, Z, near)
        out[i] = agree / max(facing, 1)


@njit(cache=True)
def _turn(v: Float64, first: int, d1: float, d2: float) -> None:
    """Rotate a unit vector of v by small motions perpendicular to it."""
    x, y, z = v[first], v[first + 1], v[first + 2]
    ax, ay, az = _across(x, y, z)
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    x, y, z = x + d1 * ax + d2 * bx, y + d1 * ay + d2 * by, z + d1 * az + d2 * bz
    f = 1.0 / math.sqrt(x * x + y * y + z * z)
    v[first], v[first + 1], v[first + 2] = f * x, f * y, f * z


@njit(cache=True)
def _expected_body(expected: Float64, information: Float64, v: Float64, first: int, H: Float64, g: Float64) -> None:
    """Add the prior of directions and sizes to H and g."""
    for k in range(2):
        at = FOREARM if k == 0 else UPPER
        x, y, z = v[at], v[at + 1], v[at + 2]
        ax, ay, az = _across(x, y, z)
        bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
        # The information is along the palm's axes.
        for c in range(3):
            w = information[at + c]
            e = expected[at + c] - v[at + c]
            p, q = (ax, bx) if c == 0 else ((ay, by) if c == 1 else (az, bz))
            i = first + (D_FOREARM if k == 0 else D_UPPER)
            H[i, i] += w * p * p
            H[i + 1, i + 1] += w * q * q
            H[i + 1, i] += w * p * q
            g[i] += w * p * e
            g[i + 1] += w * q * e
        i = first + (D_FOREARM if k == 0 else D_UPPER)
        H[i, i] += 1e-6
        H[i + 1, i + 1] += 1e-6
    for j in range(9):
        k = j if j < 4 else DIGITS + j - 4
        i = first + D_DIGITS + j - 4
        if j < 4:
            i = first + (
                D_SCALE if k == SCALE else (D_THICK if k == THICK else (D_LENGTH if k == FOREARM_M else D_ARM_THICK))
            )
        # Sizes are logarithmic, the forearm's length is in metres.
        factor = 1.0 if k == FOREARM_M else v[k]
        # The forearm's length is proportional to the hand's size.
        e = (expected[k] * (v[SCALE] if k == FOREARM_M else 1.0) - v[k]) / factor
        w = information[k] * factor * factor
        H[i, i] += w
        g[i] += w * e


@njit(cache=True)
def fit(
    digits: Float64, mirror: float, radii: Float64, palm: Float64, owners: Int64, columns: Int64, gains: Float64,
    rising: Int64, c_max: float, points: Float64, weights: Float64, picture: Picture, prior_mean: Float64,
    prior: Float64, predicted_R: Float64, predicted_t: Float64, predicted_z: Float64, certainty: Float64,
    expected: Float64, information: Float64, R: Float64, t: Float64, z: Float64, v: Float64, numbers: Float64,
    loose: float, iterations: int, costs: Float64, targets: Float64, keep: float,
) -> None:  # fmt: skip
    """Bring R (9,), t (3,), z (n,), v (STATE,) to the best fit near where they are, in place.

    Args:
        certainty: (6 + n,) inverse variances of the palm's twist and of the angles about the prediction.
        expected, information: (STATE,) prior mean of v, and inverse variances.
        loose: factor of the robust scales in the first iteration; it falls to 1.
        iterations: their largest number.
        costs: of `system`, for the result.
        targets: of `system`; used in the first share `keep` of the iterations.
    """
    n = 6 + len(z)
    full = n + BODY_DOFS
    H, g, M, d = np.empty((full, full)), np.empty(full), np.empty((full, full)), np.empty(full)
    Ha, ga = np.empty((n, n)), np.empty(n)
    nowhere = np.full((5, 3), math.nan)
    which = np.zeros(len(points), np.int64)
    now, new_R = numbers.copy(), np.empty(9)
    turn, sharp = 0, (2 * iterations + 2) // 3
    while True:
        last = turn == iterations
        f = 1.0 if last or iterations < 2 else max(loose * (1.0 - 1.5 * turn / (iterations - 1)), 1.0)
        f *= _JUDGED if last else 1.0
        now[0], now[1] = f * numbers[0], f * numbers[1]
        # Edges locate the flesh's ends more sharply than points, but mislead far from the solution.
        now[3] = numbers[3] * (numbers[9] if turn >= sharp else 1.0)
        for i in range(full):
            g[i] = 0.0
            for k in range(full):
                H[i, k] = 0.0
        system(
            digits, mirror, radii, palm, owners, columns, gains, rising, points, weights, which, picture, R, t, z, v,
            now, H, g, costs, targets if turn < keep * iterations else nowhere, last,
        )  # fmt: skip
        for i in range(n):
            ga[i] = 0.0
            for k in range(n):
                Ha[i, k] = 0.0
        _usual(prior_mean, prior, predicted_R, predicted_t, predicted_z, certainty, R, t, z, Ha, ga)
        _penalty(digits, columns, gains, z, c_max, Ha, ga)
        for i in range(n):
            g[i] += ga[i]
            for k in range(i + 1):
                H[i, k] += Ha[i, k]
        _expected_body(expected, information, v, n, H, g)
        for i in range(full):
            H[i, i] += 1e-6
        if last:
            break
        if not factorise(H, 1e-3, M):
            break
        for i in range(full):
            d[i] = g[i]
        substitute(M, d)
        most = 0.0
        for i in range(3, n):
            most = max(most, abs(d[i]))
        if most > 0.5:
            for i in range(full):
                d[i] *= 0.5 / most
        turned(R, FIRST, d[3], d[4], d[5], new_R)
        orthonormal(new_R)
        for k in range(3):
            t[k] += R[3 * k] * d[0] + R[3 * k + 1] * d[1] + R[3 * k + 2] * d[2]
        for k in range(9):
            R[k] = new_R[k]
        for k in range(n - 6):
            z[k] += d[6 + k]
        _turn(v, FOREARM, d[n + D_FOREARM], d[n + D_FOREARM + 1])
        _turn(v, UPPER, d[n + D_UPPER], d[n + D_UPPER + 1])
        v[FOREARM_M] = min(max(v[FOREARM_M] + d[n + D_LENGTH], 0.12), 0.4)
        v[SCALE] = min(max(v[SCALE] * math.exp(min(max(d[n + D_SCALE], -0.1), 0.1)), 0.6), 1.4)
        v[THICK] = min(max(v[THICK] * math.exp(min(max(d[n + D_THICK], -0.1), 0.1)), 0.7), 1.4)
        v[ARM_THICK] = min(max(v[ARM_THICK] * math.exp(min(max(d[n + D_ARM_THICK], -0.1), 0.1)), 0.7), 1.6)
        for k in range(5):
            v[DIGITS + k] = min(max(v[DIGITS + k] * math.exp(min(max(d[n + D_DIGITS + k], -0.1), 0.1)), 0.75), 1.3)
        within(digits, columns, gains, z, c_max)
        # After convergence the next stage begins.
        rests = most < _REST_RAD and max(abs(d[0]), abs(d[1]), abs(d[2])) < _REST_M
        turn = (sharp if turn < sharp else iterations) if rests else turn + 1


@njit(cache=True)
def _usual(
    prior_mean: Float64, prior: Float64, predicted_R: Float64, predicted_t: Float64, predicted_z: Float64,
    certainty: Float64, R: Float64, t: Float64, z: Float64, H: Float64, g: Float64,
) -> None:  # fmt: skip
    """Add the prior of the angles and the prediction to H and g."""
    n = len(z)
    for i in range(n):
        v = 0.0
        for k in range(n):
            v += prior[i, k] * (z[k] - prior_mean[k])
            H[6 + i, 6 + k] += prior[i, k]
        g[6 + i] -= v
        H[6 + i, 6 + i] += certainty[6 + i]
        g[6 + i] -= certainty[6 + i] * (z[i] - predicted_z[i])
    if certainty[0] > 0.0 or certainty[3] > 0.0:
        d = np.empty(6)
        d[3], d[4], d[5] = turn_between(predicted_R, FIRST, R)
        dx, dy, dz = t[0] - predicted_t[0], t[1] - predicted_t[1], t[2] - predicted_t[2]
        for k in range(3):
            d[k] = R[k] * dx + R[3 + k] * dy + R[6 + k] * dz
        for k in range(6):
            H[k, k] += certainty[k]
            g[k] -= certainty[k] * d[k]
