"""Kernels that solve a tree's normal equations, with angles within their limits.

The factorisation along the paths keeps the zeros of H (R. Featherstone, Efficient Factorization of the Joint-Space
Inertia Matrix for Branched Kinematic Trees, Int. J. Robotics Research 24, 2005). Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

ROOT = 6
"""Number of degrees of freedom of the root."""
_RELATIVE_FLOOR = 1e-12  # of the largest diagonal element; unconstrained degrees of freedom do not move


@njit(cache=True)
def path(parents: Int64, joint_parts: Int64, above: Int64) -> None:
    """Write the parent of each degree of freedom, the next one towards the root, for the sparse factorisation.

    Args:
        parents, joint_parts: (parts,), (joints,) of `TwistTree`.
        above: (dofs,) written: its index; −1 for none.
    """
    last, j = np.empty(len(parents), dtype=np.int64), 0
    for i in range(ROOT):
        above[i] = i - 1
    for p in range(len(parents)):
        last[p] = ROOT - 1 if parents[p] < 0 else last[parents[p]]
        while j < len(joint_parts) and joint_parts[j] == p:
            above[ROOT + j] = last[p]
            last[p] = ROOT + j
            j += 1


@njit(cache=True, error_model="numpy")
def factorise(above: Int64, H: Float64) -> bool:
    """Factorise H (n, n) into LᵀL = H, in place, along the tree's paths only; the lower half is used.

    Args:
        above: (n,) of `path`.
        H: (n, n) symmetric; its lower triangle is overwritten with L.

    Returns:
        Whether H is positive definite.
    """
    for k in range(len(H) - 1, -1, -1):
        row = H[k]
        if not row[k] > 0.0:
            return False
        row[k] = math.sqrt(row[k])
        f = 1.0 / row[k]
        i = above[k]
        while i >= 0:
            row[i] *= f
            i = above[i]
        i = above[k]
        while i >= 0:
            f, other, j = row[i], H[i], i
            while j >= 0:
                other[j] -= f * row[j]
                j = above[j]
            i = above[i]
    return True


@njit(cache=True, error_model="numpy")
def substitute(above: Int64, L: Float64, b: Float64) -> None:
    """Solve LᵀL x = b by back substitution along the tree's paths: replace b (n,) by x.

    Args:
        above: (n,) of `path`.
        L: (n, n) lower triangular, of `factorise`.
        b: (n,) the right-hand side, overwritten with the solution.
    """
    for i in range(len(b) - 1, -1, -1):
        b[i] /= L[i, i]
        j = above[i]
        while j >= 0:
            b[j] -= L[i, j] * b[i]
            j = above[j]
    for i in range(len(b)):
        j = above[i]
        while j >= 0:
            b[i] -= L[i, j] * b[j]
            j = above[j]
        b[i] /= L[i, i]


@njit(cache=True)
def _equations_of_free(
    above: Int64, H: Float64, g: Float64, damping: float, floor: float, held: Bool, L: Float64, delta: Float64,
) -> None:  # fmt: skip
    """Write the damped equations of the degrees of freedom that are not ``held``: their matrix into L, their right-hand
    side into delta."""
    for i in range(len(g)):
        fixed = i >= ROOT and held[i - ROOT]
        L[i, i] = 1.0 if fixed else H[i, i] * (1.0 + damping) + floor
        if not fixed:
            delta[i] = g[i]
        k = above[i]
        while k >= 0:
            other = k >= ROOT and held[k - ROOT]
            L[i, k] = 0.0 if fixed or other else H[i, k]
            if other and not fixed:
                delta[i] -= H[i, k] * delta[k]
            elif fixed and not other:
                delta[k] -= H[i, k] * delta[i]
            k = above[k]


@njit(cache=True)
def step(
    above: Int64, H: Float64, g: Float64, damping: float, angles: Float64, limits: Float64, L: Float64, held: Bool,
    delta: Float64,
) -> bool:  # fmt: skip
    """Solve H δ = g for a step that keeps the angles within their limits; return whether damped H is positive definite.

    An angle at a limit is held there if g points beyond it, and so is an angle that the step would take beyond a limit;
    the others are solved again (D. Bertsekas, Projected Newton Methods for Optimization Problems with Simple
    Constraints, SIAM J. Control and Optimization 20, 1982).

    Args:
        above: (dofs,) of `path`.
        H, g: (dofs, dofs), (dofs,) of `twist_fit_kernels.normal_equations`.
        damping: relative increase of the diagonal of H (Levenberg and Marquardt).
        angles: (joints,) within the limits [rad].
        limits: (joints, 2) [rad].
        L: (dofs, dofs) workspace.
        held: (joints,) written: whether the angle is held at a limit.
        delta: (dofs,) written: the step, the root's twist and then the angles.
    """
    largest = 0.0
    for i in range(len(g)):
        largest = max(largest, H[i, i])
    floor = _RELATIVE_FLOOR * largest if largest > 0.0 else 1.0
    for j in range(len(angles)):
        push = g[ROOT + j]
        held[j] = (angles[j] <= limits[j, 0] and push <= 0.0) or (angles[j] >= limits[j, 1] and push >= 0.0)
        delta[ROOT + j] = 0.0
    within = False
    while not within:
        _equations_of_free(above, H, g, damping, floor, held, L, delta)
        if not factorise(above, L):
            return False
        substitute(above, L, delta)
        within = True
        for j in range(len(angles)):
            least, most = limits[j, 0] - angles[j], limits[j, 1] - angles[j]
            if not held[j] and not least <= delta[ROOT + j] <= most:
                delta[ROOT + j] = min(max(delta[ROOT + j], least), most)
                held[j], within = True, False
    return True
