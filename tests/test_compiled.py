"""What a kernel gives does not depend on whether a process compiles it, as the first run on a machine, or loads it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mocapella.compiled import njit
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.geometry.triangulation import triangulate, views

LENS = np.array([600.0, 600.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -1e-3, 0.0])
POINTS = 40


def points_as_hex() -> str:
    """The bits of points that four cameras see, of which some are wrong about some."""
    rng = np.random.default_rng(5)
    T = np.stack([rigid(rotation_about_y(0.3 + 1.5 * k), [0.0, 0.0, 3.0]) for k in range(4)])
    pixels = np.empty((POINTS, len(T), 2))
    truth = rng.uniform(-0.5, 0.5, (POINTS, 3))
    for k, T_camera_world in enumerate(T):
        seen = apply(T_camera_world, truth)
        pixels[:, k] = LENS[2:4] + LENS[:2] * seen[:, :2] / seen[:, 2:]
    pixels += rng.normal(0.0, 1.0, pixels.shape)
    pixels[::3, 0] += 50.0
    found = triangulate(pixels, views(np.tile(LENS, (len(T), 1)), T), 3.0)
    assert np.isfinite(found.points).all(axis=1).sum() > POINTS // 2
    return found.points.tobytes().hex() + found.covariances.tobytes().hex()


def a_process(cache: Path) -> str:
    """`points_as_hex` of a process that keeps what it compiles there."""
    done = subprocess.run(
        [sys.executable, "-c", "from test_compiled import points_as_hex; print(points_as_hex())"],
        cwd=Path(__file__).parent,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.slow
def test_the_first_run_on_a_machine_gives_to_the_bit_what_every_later_one_gives(tmp_path: Path) -> None:
    first = a_process(tmp_path)
    assert list(tmp_path.rglob("triangulation_kernels.triangulate-*.nbc"))
    assert a_process(tmp_path) == first
    assert points_as_hex() == first


@pytest.mark.parametrize("asked", [True, {"contract"}])
def test_a_kernel_that_may_round_otherwise_in_each_of_its_copies_is_refused(asked: object) -> None:
    with pytest.raises(ValueError, match=r"fastmath=.*IEEE arithmetic"):

        @njit(fastmath=asked)
        def total(x):  # type: ignore[no-untyped-def]
            return x.sum()


def test_without_it_it_is_compiled() -> None:
    @njit()
    def twice(x):  # type: ignore[no-untyped-def]
        return 2 * x

    @njit(error_model="numpy", fastmath=False)
    def inverse(x):  # type: ignore[no-untyped-def]
        return 1 / x

    assert twice(3) == 6
    assert inverse(0.0) == np.inf
