"""Symmetric 3 × 3 matrices as six arrays: xx, yy, zz, xy, xz, yz, along the first axis."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_ROWS = np.array([0, 1, 2, 0, 0, 1])
_COLUMNS = np.array([0, 1, 2, 1, 2, 2])


def six_of(matrices: NDArray[Any]) -> NDArray[Any]:
    """Return the six different elements (6, ...) of symmetric matrices (..., 3, 3)."""
    return np.moveaxis(matrices[..., _ROWS, _COLUMNS], -1, 0)


def trace_of_inverse(six: NDArray[Any]) -> NDArray[Any]:
    """Return the traces (...,) of the inverses of positive definite matrices (6, ...), by their cofactors."""
    xx, yy, zz, xy, xz, yz = six
    first, second, third = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    determinant = xx * first - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    return np.asarray((first + second + third) / determinant)
