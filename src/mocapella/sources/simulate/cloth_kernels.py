"""The hot steps of `mocapella.sources.simulate.cloth`, compiled and in place; importing this module imports numba."""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

MOST_M_S = 1.0
FASTEST_M_S = 5.0
"""Threads that do not give snap back without limit when a hand pulled them longer than they are, and lets go."""


@njit(cache=True)
def advance(
    x, v, fixed, pairs, rest, compliance, gravity, damping, step_s, steps, spheres_from, spheres_to, thickness,
    friction, target,
):  # fmt: skip
    """Go on by ``steps`` steps of extended position-based dynamics.

    Args:
        x, v: (n, 3) places [m] and velocities [m/s]; changed.
        fixed: (n,) 0 for what is free; what is not goes straight to its ``target`` (n, 3) in these steps.
        pairs: (k, 2) particles that are ``rest`` (k,) apart, as compliantly as ``compliance`` (k,) [m/N] of a
            particle's mass says.
        gravity: (3,) [m/s²].
        damping: [1/s].
        spheres_from, spheres_to: (m, 4) middle and radius of what is in the way, before and after the steps.
        thickness: of the cloth [m].
        friction: coefficient.
    """
    n, before = len(x), np.empty_like(x)
    begin = x.copy()
    spheres, moved = np.empty_like(spheres_from), (spheres_to - spheres_from) / steps
    slower = math.exp(-damping * step_s)
    for k in range(steps):
        part = (k + 1) / steps
        for j in range(len(spheres)):
            for c in range(4):
                spheres[j, c] = spheres_from[j, c] + part * (spheres_to[j, c] - spheres_from[j, c])
        for i in range(n):
            for c in range(3):
                before[i, c] = x[i, c]
                if fixed[i]:
                    x[i, c] = begin[i, c] + part * (target[i, c] - begin[i, c])
                else:
                    v[i, c] = slower * (v[i, c] + step_s * gravity[c])
                    x[i, c] += step_s * v[i, c]
        hold_apart(x, fixed, pairs, rest, compliance, step_s)
        collide(x, before, fixed, spheres, moved, thickness, friction, MOST_M_S * step_s)
        for i in range(n):
            fast = 0.0
            for c in range(3):
                v[i, c] = (x[i, c] - before[i, c]) / step_s
                fast += v[i, c] ** 2
            if fast > FASTEST_M_S * FASTEST_M_S:
                for c in range(3):
                    v[i, c] *= FASTEST_M_S / math.sqrt(fast)


@njit(cache=True)
def hold_apart(x, fixed, pairs, rest, compliance, step_s):
    """One sweep over the distances (Macklin, Müller, Chentanez 2016, equations 17 and 18, from λ = 0)."""
    for e in range(len(pairs)):
        i, j = pairs[e, 0], pairs[e, 1]
        w_i, w_j = 1.0 - fixed[i], 1.0 - fixed[j]
        if w_i + w_j == 0.0:
            continue
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length < 1e-12:
            continue
        change = (rest[e] - length) / ((w_i + w_j + compliance[e] / (step_s * step_s)) * length)
        x[i, 0] += w_i * change * dx
        x[i, 1] += w_i * change * dy
        x[i, 2] += w_i * change * dz
        x[j, 0] -= w_j * change * dx
        x[j, 1] -= w_j * change * dy
        x[j, 2] -= w_j * change * dz


@njit(cache=True)
def collide(x, before, fixed, spheres, moved, thickness, friction, most):
    """Push particles out of spheres; on their surface they go along with them as friction says (Coulomb).

    What was inside, since a hand held it there, is pushed out by no more than ``most`` [m] beyond the sphere's motion.
    """
    for i in range(len(x)):
        if fixed[i]:
            continue
        for j in range(len(spheres)):
            out = spheres[j, 3] + thickness
            dx, dy, dz = x[i, 0] - spheres[j, 0], x[i, 1] - spheres[j, 1], x[i, 2] - spheres[j, 2]
            square = dx * dx + dy * dy + dz * dz
            if square >= out * out or square < 1e-18:
                continue
            length = math.sqrt(square)
            nx, ny, nz = dx / length, dy / length, dz / length
            own = math.sqrt(moved[j, 0] ** 2 + moved[j, 1] ** 2 + moved[j, 2] ** 2)
            deep = min(out - length, most + own)
            x[i, 0] += deep * nx
            x[i, 1] += deep * ny
            x[i, 2] += deep * nz
            # How the particle slid on the sphere in this step; friction takes back as much as it can.
            sx = x[i, 0] - before[i, 0] - moved[j, 0]
            sy = x[i, 1] - before[i, 1] - moved[j, 1]
            sz = x[i, 2] - before[i, 2] - moved[j, 2]
            along = sx * nx + sy * ny + sz * nz
            sx, sy, sz = sx - along * nx, sy - along * ny, sz - along * nz
            slid = math.sqrt(sx * sx + sy * sy + sz * sz)
            if slid > 1e-12:
                back = min(1.0, friction * deep / slid)
                x[i, 0] -= back * sx
                x[i, 1] -= back * sy
                x[i, 2] -= back * sz
