"""Compiled kernels of `mocapella.sources.simulate.cloth`; importing this module imports numba.

Position-based dynamics: a step predicts the particles, then projects them onto distance constraints and out of spheres.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MOST_M_S = 1.0
"""Greatest speed at which a particle is pushed out of a sphere, beyond the sphere's own [m/s]."""
FASTEST_M_S = 5.0
"""Greatest speed of a particle: stiff threads that a hand has stretched would snap back without limit [m/s]."""


class Threads(NamedTuple):
    """The distance constraints of a cloth.

    Attributes:
        pairs: (k, 2) indices of the particles.
        rest: (k,) distance of the particles at rest [m].
        compliance: (k,) compliance of the constraint, times a particle's mass [s²]; 0 is rigid.
    """

    pairs: Int64
    rest: Float64
    compliance: Float64


class CollisionSpheres(NamedTuple):
    """The spheres that the cloth collides with.

    Attributes:
        before, after: (m, 4) centre and radius before and after the steps [m].
        thickness: distance that the cloth keeps from a sphere [m].
        friction: Coulomb's friction coefficient.
    """

    before: Float64
    after: Float64
    thickness: float
    friction: float


class TimeSteps(NamedTuple):
    """The time integration.

    Attributes:
        gravity: (3,) acceleration [m/s²].
        damping: rate at which motion decays [1/s].
        step_s: length of a step [s].
        number: number of steps.
    """

    gravity: Float64
    damping: float
    step_s: float
    number: int


@njit(cache=True)
def advance(
    x: Float64,
    v: Float64,
    fixed: Float64,
    target: Float64,
    threads: Threads,
    obstacles: CollisionSpheres,
    steps: TimeSteps,
) -> None:
    """Advance the cloth by a number of steps of extended position-based dynamics.

    Args:
        x, v: (n, 3) positions [m] and velocities [m/s], in and out.
        fixed: (n,) 0 for a free particle, 1 for one that moves straight to its target in these steps.
        target: (n, 3) positions after the steps of the particles that are not free [m].
        threads, obstacles, steps: constraints, collision spheres, and time integration.
    """
    pairs, rest, compliance = threads.pairs, threads.rest, threads.compliance
    spheres_from, spheres_to = obstacles.before, obstacles.after
    thickness, friction = obstacles.thickness, obstacles.friction
    gravity, step_s, count = steps.gravity, steps.step_s, steps.number
    n, before = len(x), np.empty_like(x)
    begin = x.copy()
    spheres, moved = np.empty_like(spheres_from), (spheres_to - spheres_from) / count
    slower = math.exp(-steps.damping * step_s)
    for k in range(count):
        part = (k + 1) / count
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
def hold_apart(x: Float64, fixed: Float64, pairs: Int64, rest: Float64, compliance: Float64, step_s: float) -> None:
    """Sweep once over the distance constraints, in place.

    Macklin, Müller, Chentanez 2016, equations 17 and 18, from λ = 0.

    Args:
        x: (n, 3) positions, updated [m].
        fixed: (n,) as in `advance`.
        pairs, rest, compliance: (k, 2), (k,), (k,) see `Threads`.
        step_s: length of the step [s].
    """
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
def collide(
    x: Float64, before: Float64, fixed: Float64, spheres: Float64, moved: Float64, thickness: float, friction: float,
    most: float,
) -> None:  # fmt: skip
    """Push particles out of spheres, in place, with Coulomb friction on the spheres' surfaces.

    Args:
        x: (n, 3) positions, updated [m].
        before: (n, 3) positions before this step [m].
        fixed: (n,) as in `advance`.
        spheres: (m, 4) centre and radius [m].
        moved: (m, 4) change of ``spheres`` in this step [m].
        thickness: distance that the cloth keeps from a sphere [m].
        friction: Coulomb's friction coefficient.
        most: a particle is pushed out by at most this plus the sphere's own motion, so that one that a hand held inside
            a sphere does not jump [m].
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
            # The particle's slip on the sphere in this step, which friction reduces.
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
