"""Kernels of an arm's surface: tapered capsules about its bones, here called *flesh*. Importing this imports numba.

A *piece* is one capsule, a row of `PIECE` numbers: one end (3), unit axis (3), length, radii at both ends, tangent of
its taper's angle, middle (3), and radius of a sphere around it [m]. Pieces are in the palm's frame: three for each
digit, then the palm's, two for the forearm, one for the upper arm. The state v (`STATE`,) holds an arm's sizes and
the directions of forearm and upper arm.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.hand_fit_kernels import digit_angles, digit_points
from mocapella.kinematics.hand_kernels import BASE, DIGIT, L1

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

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

_INNER = 0.8  # share of the radius of flesh that hides what is behind its axis or in it, see `covered`


@njit(cache=True)
def write_piece(
    row: Float64, ax: float, ay: float, az: float, bx: float, by: float, bz: float, ra: float, rb: float,
) -> None:  # fmt: skip
    """Write the row (PIECE,) of a tapered capsule from the point a to the point b.

    The sine of the taper, (ra − rb) / length, is limited to ±0.9, so that its tangent stays finite.

    Args:
        row: (PIECE,) written.
        ax, ay, az: point a [m], in the frame of the row.
        bx, by, bz: point b [m], in the same frame.
        ra, rb: radii at a and b [m].
    """
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
def digit_pieces(d: int, outer: float, radii: Float64, thick: float, x: Float64, pieces: Float64) -> None:
    """Write the three capsules of a digit, in the palm's frame.

    Args:
        d: index of the digit, 0 for the thumb.
        outer: length of its outermost bone [m].
        radii: (6, 5) of `ArmArrays` [m].
        thick: factor of the radii.
        x: (4, 3) its joints and tip [m].
        pieces: (pieces, PIECE); rows 3 d to 3 d + 2 are written.
    """
    for bone in range(3):
        bx, by, bz = x[bone + 1, 0], x[bone + 1, 1], x[bone + 1, 2]
        if bone == 2:  # the landmark is nearer to the flesh's end than a radius
            f = radii[5, 4] * thick / max(outer, 1e-6)
            bx -= f * (bx - x[2, 0])
            by -= f * (by - x[2, 1])
            bz -= f * (bz - x[2, 2])
        write_piece(
            pieces[3 * d + bone], x[bone, 0], x[bone, 1], x[bone, 2], bx, by, bz,
            thick * radii[d, bone], thick * radii[d, bone + 1],
        )  # fmt: skip


@njit(cache=True)
def flesh(
    digits: Float64, mirror: float, radii: Float64, palm: Float64, columns: Int64, gains: Float64, z: Float64,
    v: Float64, rows: Float64, joints: Float64, axes: Float64, pieces: Float64,
) -> None:  # fmt: skip
    """Compute an arm's capsules in the palm's frame, and its digits' joints and axes, by forward kinematics.

    Args:
        digits: (5, DIGIT) of the hand's shape, see `hand_kernels`.
        mirror: -1 for a left hand, else 1.
        radii: (6, 5) radii of `ArmArrays` [m].
        palm: (k, 8) two points and radii of each capsule of a right hand's palm [m].
        columns, gains: (5, 5) index and factor of the free angle that a digit's angle follows, see `ArmArrays`.
        z: (n,) free angles [rad].
        v: (STATE,) the arm's sizes, and directions of forearm and upper arm in the palm's frame.
        rows: (5, DIGIT) written: ``digits`` scaled to the arm's sizes.
        joints: (5, 4, 3) written: joints and tip of each digit [m].
        axes: (5, 5, 3) written: unit axis of each of a digit's angles.
        pieces: (15 + k + 3, PIECE) written: capsules of the digits, the palm, the forearm (2) and the upper arm [m].
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
        digit_pieces(d, rows[d, L1 + 2], radii, thick, joints[d], pieces)
    n = 15
    for k in range(len(palm)):
        write_piece(
            pieces[n], mirror * s * palm[k, 0], s * palm[k, 1], s * palm[k, 2], mirror * s * palm[k, 3],
            s * palm[k, 4], s * palm[k, 5], thick * palm[k, 6], thick * palm[k, 7],
        )  # fmt: skip
        n += 1
    ex, ey, ez = v[FOREARM_M] * v[FOREARM], v[FOREARM_M] * v[FOREARM + 1], v[FOREARM_M] * v[FOREARM + 2]
    wide = radii[5, 1] * s * v[ARM_THICK]
    for side in range(2):
        w = wide if side == 0 else -wide
        write_piece(
            pieces[n], w, 0.0, 0.0, ex + 0.4 * w, ey, ez, s * v[ARM_THICK] * radii[5, 0], s * v[ARM_THICK] * radii[5, 2]
        )
        n += 1
    ux, uy, uz = v[UPPER], v[UPPER + 1], v[UPPER + 2]
    write_piece(
        pieces[n], ex, ey, ez, ex + 0.25 * ux, ey + 0.25 * uy, ez + 0.25 * uz, s * v[ARM_THICK] * radii[5, 2],
        s * v[ARM_THICK] * radii[5, 3],
    )  # fmt: skip


@njit(cache=True)
def balls(pieces: Float64, owners: Int64, R: Float64, t: Float64, spacing: float, out: Float64) -> int:
    """Sample the capsules by spheres, in the camera frame, to gate depth images around an arm; return their number.

    Args:
        pieces: (pieces, PIECE) capsules in the palm's frame, of `flesh`.
        owners: (pieces, 2) digit or body part, and bone, of each capsule, of `ArmArrays`.
        R, t: (9,), (3,) rotation row by row, and translation [m], from the palm's frame to the camera frame.
        spacing: least distance between the spheres' centres along a capsule, except that both its ends have one [m].
        out: (capacity, 5) the first rows are written: centre (3) and radius [m], 1 for the hand or 0 for the arm.
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
    """Return the index of the capsule nearest to a point, in the palm's frame; −1 if there is none.

    A point behind the capsule's axis, as the camera sees it, cannot be on the visible side: its distance is measured
    from the front along the direction of view. For a capsule this equals the silhouette-aware correspondence of
    Tagliasacchi et al. (section 4.1).

    Args:
        pieces: (pieces, PIECE) of `flesh`.
        few: number of pieces that are searched, from index 0 on.
        first: index of the piece that is tried first, such as the last nearest one, to save time; −1 for none.
        x, y, z: the point [m].
        vx, vy, vz: unit direction of view.
        out: (5,) written: outward normal (3), position along the piece's axis and distance from the surface [m].
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
def across(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a unit vector perpendicular to the unit vector (x, y, z)."""
    if abs(x) < 0.8:
        f = 1.0 / math.sqrt(y * y + z * z)
        return 0.0, f * z, -f * y
    f = 1.0 / math.sqrt(x * x + z * z)
    return -f * z, 0.0, f * x


@njit(cache=True)
def relevance(
    points: Float64, R: Float64, t: Float64, v: Float64, length: float, forearm: float, beyond: float, out: Float64,
) -> None:  # fmt: skip
    """Write the weight of each point by its distance from a predicted arm, as `ArmModel.relevance` describes.

    Args:
        points: (m, 3) camera frame [m].
        R, t: (9,), (3,) motion from the palm's frame to the camera frame, rotation by rows; translation [m].
        v: (STATE,) sizes and directions.
        length: length of the shape's hand, before its size factor [m].
        forearm: length of the shape's forearm, before its size factor [m].
        beyond: weight of points away from hand and forearm, 0 to 1.
        out: (m,) written: 1 near the hand, 0.5 near the forearm, else ``beyond``.
    """
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
    """Return whether the measured surface is within ``near`` of a point (X, Y, Z), camera frame [m], in its pixel or an
    adjacent one."""
    column, line = int(lens[0] * X / Z + lens[2] + 0.5), int(lens[1] * Y / Z + lens[3] + 0.5)
    for i in range(max(line - 1, 0), min(line + 2, front.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, front.shape[1])):
            if abs(front[i, j] - Z) < near:
                return True
    return False


@njit(cache=True)
def covered(
    pieces: Float64, owners: Int64, digit: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Return whether the palm or another digit hides a point of a digit's surface from the camera.

    They do if the line from the point to the camera passes through the inner part of their flesh (`_INNER`), or if the
    point is in it.

    Args:
        pieces: (pieces, PIECE) of `flesh`.
        owners: (pieces, 2) digit or body part, and bone, of each capsule, of `ArmArrays`.
        digit: index of the digit, whose own capsules do not count.
        x, y, z: the point, palm's frame [m].
        dx, dy, dz: unit vector from it to the camera, palm's frame.
    """
    for i in range(len(pieces)):
        owner = owners[i, 0]
        if owner == digit or owner < OF_PALM:
            continue
        p = pieces[i]
        # Nearest points of the line of sight, from the point on, and of the capsule's axis: each is clamped in turn.
        ax, ay, az = x - p[FROM], y - p[FROM + 1], z - p[FROM + 2]
        a_u = ax * p[U] + ay * p[U + 1] + az * p[U + 2]
        a_d = ax * dx + ay * dy + az * dz
        u_d = p[U] * dx + p[U + 1] * dy + p[U + 2] * dz
        along = max((u_d * a_u - a_d) / max(1.0 - u_d * u_d, 1e-6), 0.0)
        c = min(max(a_u + along * u_d, 0.0), p[LENGTH])
        along = max(c * u_d - a_d, 0.0)
        ox = ax + along * dx - c * p[U]
        oy = ay + along * dy - c * p[U + 1]
        oz = az + along * dz - c * p[U + 2]
        r = _INNER * (p[RA] + (p[RB] - p[RA]) * c / max(p[LENGTH], 1e-6))
        if ox * ox + oy * oy + oz * oz < r * r:
            return True
    return False


@njit(cache=True)
def visible(
    pieces: Float64, owners: Int64, places: Float64, R: Float64, t: Float64, front: Float64, lens: Float64, near: float,
    out: Float64,
) -> None:  # fmt: skip
    """Write for each landmark the fraction of the camera-facing surface around it that the image confirms.

    The capsules are sampled in rings about their axes: before the landmark, at it and beyond it; at a fingertip, before
    it and on the round end. Of a fingertip, the image does not confirm what the palm or another digit covers: the
    measured surface is theirs.

    Args:
        pieces: (pieces, PIECE) of `flesh`.
        owners: (pieces, 2) digit or body part, and bone, of each capsule, of `ArmArrays`.
        places: (k, 3) for each landmark the index of its piece, the position along it from 0 to 1, and 1 if the piece
            ends there, else 0.
        R, t: (9,), (3,) motion from the palm's frame to the camera frame, rotation by rows; translation [m].
        front, lens: (h, w) [m] and (4,) [px] of `ArmEvidence`.
        near: largest distance of the image's surface from the flesh's [m].
        out: (k,) written, 0 to 1; 0 if no surface around the landmark faces the camera.
    """
    for i in range(len(places)):
        p, f = pieces[int(places[i, 0])], places[i, 1]
        r = p[RA] + f * (p[RB] - p[RA])
        ax, ay, az = across(p[U], p[U + 1], p[U + 2])
        bx, by, bz = p[U + 1] * az - p[U + 2] * ay, p[U + 2] * ax - p[U] * az, p[U] * ay - p[U + 1] * ax
        facing, agree, ends, digit = 0, 0, places[i, 2] > 0.0, owners[int(places[i, 0]), 0]
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
                if _shows(front, lens, X, Y, Z, near):
                    g = -1.0 / math.sqrt(X * X + Y * Y + Z * Z)
                    dx = g * (R[0] * X + R[3] * Y + R[6] * Z)
                    dy = g * (R[1] * X + R[4] * Y + R[7] * Z)
                    dz = g * (R[2] * X + R[5] * Y + R[8] * Z)
                    if not ends or not covered(pieces, owners, digit, x, y, w, dx, dy, dz):
                        agree += 1
        out[i] = agree / max(facing, 1)
