"""A fingertip that the palm or another digit hides is not confirmed by the surface that hides it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.kinematics import arm_flesh_kernels as k

RADIUS_M = 0.008
INNER_M = 0.8 * RADIUS_M
OWNERS = np.array([[0, 2], [1, 2], [-1, 0], [-2, 0]])
seeds = st.integers(0, 2**32 - 1)


def capsules(other: int, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (4, PIECE): all are far away but the one of this index."""
    pieces = np.empty((4, k.PIECE))
    for i in range(4):
        a, b = (begin, end) if i == other else (np.array([9.0, i, 0.0]), np.array([9.0, i, 0.03]))
        k.write_piece(pieces[i], *a, *b, RADIUS_M, RADIUS_M)
    return pieces


def nearest_m(point: np.ndarray, way: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    """Return the distance of a half-line from a segment, by dense samples [m]."""
    line = point + np.linspace(0, 0.2, 2001)[:, None] * way
    axis = begin + np.linspace(0, 1, 101)[:, None] * (end - begin)
    return float(np.linalg.norm(line[:, None] - axis[None], axis=2).min())


@pytest.mark.slow
@settings(max_examples=40)
@given(seeds)
def test_it_is_covered_where_the_line_to_the_camera_meets_the_flesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    begin, end = rng.uniform(-0.03, 0.03, (2, 3))
    point, way = rng.uniform(-0.03, 0.03, 3), rng.normal(size=3)
    way /= np.linalg.norm(way)
    off_m = nearest_m(point, way, begin, end)
    if abs(off_m - INNER_M) > 0.0005:
        for other in (1, 2):
            assert k.covered(capsules(other, begin, end), OWNERS, 0, *point, *way) == (off_m < INNER_M)


@pytest.mark.slow
def test_neither_its_own_flesh_nor_the_arms_nor_what_is_behind_covers_it() -> None:
    point, way = np.zeros(3), np.array([0.0, 0.0, -1.0])
    begin, end = np.array([-0.02, 0.0, -0.03]), np.array([0.02, 0.0, -0.03])
    assert k.covered(capsules(1, begin, end), OWNERS, 0, *point, *way)
    assert not k.covered(capsules(0, begin, end), OWNERS, 0, *point, *way)
    assert not k.covered(capsules(3, begin, end), OWNERS, 0, *point, *way)
    assert not k.covered(capsules(1, -begin, -end), OWNERS, 0, *point, *way)
