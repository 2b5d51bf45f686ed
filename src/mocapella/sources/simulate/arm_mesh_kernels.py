"""The loops of `mocapella.sources.simulate.arm_mesh`, compiled; importing this module imports numba.

A limb is a row of 9 numbers: ends a and b [m], the radii there [m], and the group it belongs to.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

LIMB = 9
# Plain numbers where a kernel is called would be types of their own, and the kernel compiled once for each.
_X, _Y, _Z = np.int64(0), np.int64(1), np.int64(2)


@njit(cache=True)
def smooth_min(a, b, k):
    """The lesser of both, rounded off where they differ by less than ``k`` (quadratic: lower by k/4 where equal)."""
    h = k - abs(a - b)
    return min(a, b) - (h * h / (4.0 * k) if h > 0.0 else 0.0)


@njit(cache=True)
def limb_distance(limb, x, y, z):
    """Distance of a point from a tapered limb with round ends [m]; negative inside."""
    ux, uy, uz = limb[3] - limb[0], limb[4] - limb[1], limb[5] - limb[2]
    px, py, pz = x - limb[0], y - limb[1], z - limb[2]
    uu = ux * ux + uy * uy + uz * uz
    t = min(max((px * ux + py * uy + pz * uz) / max(uu, 1e-18), 0.0), 1.0)
    dx, dy, dz = px - t * ux, py - t * uy, pz - t * uz
    return math.sqrt(dx * dx + dy * dy + dz * dz) - limb[6] - t * (limb[7] - limb[6])


@njit(cache=True)
def flesh(limbs, within, between, x, y, z, by_group):
    """The smooth union of all limbs at a point: negative inside; and each group's own, out.

    Args:
        limbs: (n, `LIMB`), sorted by group.
        within: (groups,) how far limbs of a group flow into each other [m]; between: and groups [m].
        by_group: (groups,) out.
    """
    by_group[:] = 1e3
    for i in range(len(limbs)):
        g = int(limbs[i, 8])
        by_group[g] = smooth_min(by_group[g], limb_distance(limbs[i], x, y, z), within[g])
    out = 1e3
    for g in range(len(by_group)):
        out = smooth_min(out, by_group[g], between)
    return out


@njit(cache=True)
def sample(limbs, within, between, nodes, out):
    """Write `flesh` (a, b, c) at the nodes (a, b, c, 3)."""
    by_group = np.empty(len(within))
    for i in range(nodes.shape[0]):
        for j in range(nodes.shape[1]):
            for k in range(nodes.shape[2]):
                p = nodes[i, j, k]
                out[i, j, k] = flesh(limbs, within, between, p[0], p[1], p[2], by_group)


@njit(cache=True)
def separate(values):
    """Change signs until no face of a cell has inside and outside in its opposite corners; whether none is left.

    There the surface would touch itself along an edge. The corner nearest to the surface goes outside.
    """
    shape = values.shape
    for _ in range(50):
        changed = 0
        for i in range(shape[0]):
            for j in range(shape[1]):
                for k in range(shape[2]):
                    for axis in range(3):
                        i1, j1, k1, i2, j2, k2 = i, j, k, i, j, k
                        if axis == 0:
                            j1, k2 = j + 1, k + 1
                        elif axis == 1:
                            i1, k2 = i + 1, k + 1
                        else:
                            i1, j2 = i + 1, j + 1
                        i3, j3, k3 = max(i1, i2), max(j1, j2), max(k1, k2)
                        if i3 >= shape[0] or j3 >= shape[1] or k3 >= shape[2]:
                            continue
                        a, b = values[i, j, k] < 0.0, values[i3, j3, k3] < 0.0
                        c, d = values[i1, j1, k1] < 0.0, values[i2, j2, k2] < 0.0
                        if a != b or c != d or a == c:
                            continue
                        changed += 1
                        if a:
                            if values[i, j, k] > values[i3, j3, k3]:
                                values[i, j, k] = 1e-6
                            else:
                                values[i3, j3, k3] = 1e-6
                        elif values[i1, j1, k1] > values[i2, j2, k2]:
                            values[i1, j1, k1] = 1e-6
                        else:
                            values[i2, j2, k2] = 1e-6
        if changed == 0:
            return True
    return False


@njit(cache=True)
def surface_net(values, nodes, vertices, triangles):
    """The surface where ``values`` change their sign; (vertices, triangles) that were written, outwards anticlockwise.

    S. Gibson, "Constrained elastic surface nets" (MICCAI 1998): a vertex in each cell that the surface crosses, at the
    mean of the crossings of its edges; a quadrilateral about each edge that it crosses.
    """
    a, b, c = values.shape
    cell = np.full((a, b, c), -1, np.int64)
    n = 0
    for i in range(a - 1):
        for j in range(b - 1):
            for k in range(c - 1):
                x, y, z, crossings = 0.0, 0.0, 0.0, 0
                for e in range(12):
                    axis, u, v = e // 4, e & 1, (e >> 1) & 1
                    if axis == 0:
                        i0, j0, k0 = i, j + u, k + v
                        i1, j1, k1 = i + 1, j0, k0
                    elif axis == 1:
                        i0, j0, k0 = i + u, j, k + v
                        i1, j1, k1 = i0, j + 1, k0
                    else:
                        i0, j0, k0 = i + u, j + v, k
                        i1, j1, k1 = i0, j0, k + 1
                    p, q = values[i0, j0, k0], values[i1, j1, k1]
                    if (p < 0.0) == (q < 0.0):
                        continue
                    t = p / (p - q)
                    x += nodes[i0, j0, k0, 0] + t * (nodes[i1, j1, k1, 0] - nodes[i0, j0, k0, 0])
                    y += nodes[i0, j0, k0, 1] + t * (nodes[i1, j1, k1, 1] - nodes[i0, j0, k0, 1])
                    z += nodes[i0, j0, k0, 2] + t * (nodes[i1, j1, k1, 2] - nodes[i0, j0, k0, 2])
                    crossings += 1
                if crossings:
                    vertices[n, 0], vertices[n, 1], vertices[n, 2] = x / crossings, y / crossings, z / crossings
                    cell[i, j, k] = n
                    n += 1
    m = 0
    for i in range(1, a - 1):
        for j in range(1, b - 1):
            for k in range(1, c - 1):
                for axis in range(3):
                    inside = values[i, j, k] < 0.0
                    if axis == 0:
                        other = values[i + 1, j, k] < 0.0
                        q0, q1, q2, q3 = cell[i, j - 1, k - 1], cell[i, j, k - 1], cell[i, j, k], cell[i, j - 1, k]
                    elif axis == 1:
                        other = values[i, j + 1, k] < 0.0
                        q0, q1, q2, q3 = cell[i - 1, j, k - 1], cell[i - 1, j, k], cell[i, j, k], cell[i, j, k - 1]
                    else:
                        other = values[i, j, k + 1] < 0.0
                        q0, q1, q2, q3 = cell[i - 1, j - 1, k], cell[i, j - 1, k], cell[i, j, k], cell[i - 1, j, k]
                    if inside == other:
                        continue
                    if other:
                        q1, q3 = q3, q1
                    triangles[m, 0], triangles[m, 1], triangles[m, 2] = q0, q1, q2
                    triangles[m + 1, 0], triangles[m + 1, 1], triangles[m + 1, 2] = q0, q2, q3
                    m += 2
    return n, m


@njit(cache=True)
def settle(limbs, within, between, vertices, most_m):
    """Move vertices onto the surface, in place, along its gradient and by at most ``most_m`` a step."""
    by_group, e = np.empty(len(within)), 2e-4
    for i in range(len(vertices)):
        p = vertices[i]
        for _ in range(3):
            f = flesh(limbs, within, between, p[0], p[1], p[2], by_group)
            gx = (flesh(limbs, within, between, p[0] + e, p[1], p[2], by_group) - f) / e
            gy = (flesh(limbs, within, between, p[0], p[1] + e, p[2], by_group) - f) / e
            gz = (flesh(limbs, within, between, p[0], p[1], p[2] + e, by_group) - f) / e
            step = -f / max(gx * gx + gy * gy + gz * gz, 0.25)
            step = min(max(step, -most_m), most_m)
            p[0], p[1], p[2] = p[0] + step * gx, p[1] + step * gy, p[2] + step * gz


@njit(cache=True)
def group_distances(limbs, within, points, out):
    """Write each group's own distance (n, groups) at points (n, 3)."""
    for i in range(len(points)):
        flesh(limbs, within, 1e-6, points[i, 0], points[i, 1], points[i, 2], out[i])


@njit(cache=True)
def turned(R, axis, angle):
    """``R`` (3, 3) turned about its own x (0), y (1) or z (2), in place: R · rotation(angle)."""
    c, s = math.cos(angle), math.sin(angle)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    for i in range(3):
        a, b = R[i, u], R[i, v]
        R[i, u], R[i, v] = c * a + s * b, c * b - s * a


@njit(cache=True)
def _place(point, p):
    """Write a point (3,)."""
    for i in range(3):
        point[i] = p[i]


@njit(cache=True)
def _stand(bone, R, p):
    """Write how a bone (3, 4) stands."""
    for i in range(3):
        for k in range(3):
            bone[i, k] = R[i, k]
        bone[i, 3] = p[i]


@njit(cache=True)
def arm_frames(digit_frames, which, bases, lengths, upper_m, forearm_m, joints, angles, bones, points):
    """Where the bones and joints of a right arm are, in the shoulder's frame.

    Args:
        digit_frames: (5, 3, 3) of `HandModel.frames`; which: (5, 5) `DIGIT_ANGLES`.
        bases, lengths: of `HandShape`.
        upper_m, forearm_m: lengths.
        joints: (4,) elbow flexion, pronation, wrist flexion, wrist deviation [rad].
        angles: (21,) [rad].
        bones: (19, 3, 4) ``T_shoulder_bone``, out: upper arm, forearm at the elbow, forearm at the wrist, palm, then
            three of each digit. A bone's origin is the joint it begins with; of the second part of the forearm, the
            wrist.
        points: (24, 3) out: 21 landmarks, middle of the palm, elbow, shoulder [m].
    """
    R, p = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        R[i, i] = 1.0
    _place(points[23], p)
    p[2] = upper_m
    _place(points[22], p)
    _stand(bones[0], R, p)
    turned(R, _Y, joints[0])
    _stand(bones[1], R, p)
    turned(R, _Z, -joints[1])
    for i in range(3):
        p[i] += forearm_m * R[i, 2]
    _stand(bones[2], R, p)
    turned(R, _Y, joints[3])
    turned(R, _X, joints[2])
    _stand(bones[3], R, p)
    _place(points[0], p)
    Q, q = np.empty((3, 3)), np.empty(3)
    for d in range(5):
        for i in range(3):
            q[i] = p[i]
            for k in range(3):
                q[i] += R[i, k] * bases[d, k]
                Q[i, k] = R[i, 0] * digit_frames[d, 0, k] + R[i, 1] * digit_frames[d, 1, k]
                Q[i, k] += R[i, 2] * digit_frames[d, 2, k]
        for bone in range(3):
            _place(points[1 + 4 * d + bone], q)
            if bone == 0:
                turned(Q, _Y, angles[which[d, 1]])
            elif bone == 1 and which[d, 4] >= 0:
                turned(Q, _Y, angles[which[d, 4]])
            turned(Q, _X, angles[which[d, 0 if bone == 0 else bone + 1]])
            _stand(bones[4 + 3 * d + bone], Q, q)
            for i in range(3):
                q[i] += lengths[d, bone] * Q[i, 2]
        _place(points[4 + 4 * d], q)
    for i in range(3):
        points[21, i] = 0.5 * (points[0, i] + points[9, i])


@njit(cache=True)
def dual_quaternions(bones, at_rest, out):
    """Write the motions (b, 8) from the rest to now, bones (b, 3, 4) both: quaternion w x y z, then its dual part."""
    M = np.empty((3, 3))
    for n in range(len(bones)):
        T, S = bones[n], at_rest[n]
        for i in range(3):
            for k in range(3):
                M[i, k] = T[i, 0] * S[k, 0] + T[i, 1] * S[k, 1] + T[i, 2] * S[k, 2]
        t0 = T[0, 3] - M[0, 0] * S[0, 3] - M[0, 1] * S[1, 3] - M[0, 2] * S[2, 3]
        t1 = T[1, 3] - M[1, 0] * S[0, 3] - M[1, 1] * S[1, 3] - M[1, 2] * S[2, 3]
        t2 = T[2, 3] - M[2, 0] * S[0, 3] - M[2, 1] * S[1, 3] - M[2, 2] * S[2, 3]
        trace = M[0, 0] + M[1, 1] + M[2, 2]
        if trace > 0.0:  # Shepperd 1978: divide by a large one of the four
            s = 2.0 * math.sqrt(trace + 1.0)
            w, x, y, z = 0.25 * s, (M[2, 1] - M[1, 2]) / s, (M[0, 2] - M[2, 0]) / s, (M[1, 0] - M[0, 1]) / s
        elif M[0, 0] >= M[1, 1] and M[0, 0] >= M[2, 2]:
            s = 2.0 * math.sqrt(1.0 + M[0, 0] - M[1, 1] - M[2, 2])
            w, x, y, z = (M[2, 1] - M[1, 2]) / s, 0.25 * s, (M[0, 1] + M[1, 0]) / s, (M[0, 2] + M[2, 0]) / s
        elif M[1, 1] >= M[2, 2]:
            s = 2.0 * math.sqrt(1.0 + M[1, 1] - M[0, 0] - M[2, 2])
            w, x, y, z = (M[0, 2] - M[2, 0]) / s, (M[0, 1] + M[1, 0]) / s, 0.25 * s, (M[1, 2] + M[2, 1]) / s
        else:
            s = 2.0 * math.sqrt(1.0 + M[2, 2] - M[0, 0] - M[1, 1])
            w, x, y, z = (M[1, 0] - M[0, 1]) / s, (M[0, 2] + M[2, 0]) / s, (M[1, 2] + M[2, 1]) / s, 0.25 * s
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = w, x, y, z
        out[n, 4] = -0.5 * (t0 * x + t1 * y + t2 * z)
        out[n, 5] = 0.5 * (t0 * w + t1 * z - t2 * y)
        out[n, 6] = 0.5 * (t1 * w + t2 * x - t0 * z)
        out[n, 7] = 0.5 * (t2 * w + t0 * y - t1 * x)


@njit(cache=True)
def skin(vertices, bones_of, weights, motions, T, out):
    """Write where the vertices (n, 3) are, blended by dual quaternions, then moved by ``T`` (3, 4).

    L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with dual quaternions" (I3D 2007), section 4.

    Args:
        bones_of, weights: (n, 4) which bones move a vertex, and how much each.
        motions: (bones, 8) of `dual_quaternions`.
    """
    q = np.empty(8)
    for i in range(len(vertices)):
        q[:] = 0.0
        first = motions[bones_of[i, 0]]
        for k in range(4):
            weight = weights[i, k]
            if weight == 0.0:
                continue
            m = motions[bones_of[i, k]]
            if first[0] * m[0] + first[1] * m[1] + first[2] * m[2] + first[3] * m[3] < 0.0:
                weight = -weight  # of both quaternions of the rotation, the nearer
            for c in range(8):
                q[c] += weight * m[c]
        size = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        w, x, y, z = q[0] * size, q[1] * size, q[2] * size, q[3] * size
        dw, dx, dy, dz = q[4] * size, q[5] * size, q[6] * size, q[7] * size
        px, py, pz = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        cx, cy, cz = y * pz - z * py + w * px, z * px - x * pz + w * py, x * py - y * px + w * pz
        a = px + 2.0 * (y * cz - z * cy + w * dx - dw * x + y * dz - z * dy)
        b = py + 2.0 * (z * cx - x * cz + w * dy - dw * y + z * dx - x * dz)
        c = pz + 2.0 * (x * cy - y * cx + w * dz - dw * z + x * dy - y * dx)
        for r in range(3):
            out[i, r] = T[r, 0] * a + T[r, 1] * b + T[r, 2] * c + T[r, 3]
