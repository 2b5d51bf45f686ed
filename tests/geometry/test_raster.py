"""Which samples of a picture see which triangle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.geometry import raster_kernels as raster
from mocapella.geometry.lens import farthest_r2, undistort

SIZE = (160, 120)
LENS = np.array([140.0, 141.0, 80.3, 58.8, -0.15, 0.05, 1e-3, -5e-4, 0.0])
places = st.tuples(st.floats(-20, 60), st.floats(-20, 50))


def ball(middle: NDArray[np.float64], radius: float, around: int = 96) -> tuple[NDArray, NDArray]:
    """Vertices and faces, counter-clockwise as seen from outside, of a ball between its own inside and outside."""
    up = np.linspace(0, math.pi, around // 2 + 1)[1:-1]
    a = np.arange(around) * 2 * math.pi / around
    across = np.sin(up)[:, None]
    rings = np.stack(np.broadcast_arrays(across * np.cos(a), np.cos(up)[:, None], across * np.sin(a)), axis=-1)
    rings = rings.reshape(-1, 3)
    vertices = np.vstack([rings, [[0, 1, 0], [0, -1, 0]]])
    faces = []
    for i in range(len(up) - 1):
        for j in range(around):
            p, q, r, s = (
                i * around + j,
                i * around + (j + 1) % around,
                (i + 1) * around + j,
                (i + 1) * around + (j + 1) % around,
            )
            faces += [(p, q, r), (q, s, r)]
    for j in range(around):
        faces += [(len(rings), (j + 1) % around, j),
                  (len(rings) + 1, (len(up) - 1) * around + j, (len(up) - 1) * around + (j + 1) % around)]  # fmt: skip
    return middle + radius * vertices, np.array(faces, np.int32)


def drawn(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    seen = np.empty_like(vertices)
    raster.project(vertices, np.eye(4), LENS, farthest_r2(LENS), seen)
    near, which = np.zeros(SIZE[::-1]), np.full(SIZE[::-1], -1, np.int32)
    raster.cover(seen, faces, 0.0, 0.0, 1.0, near, which)
    return near, which


def rays() -> NDArray[np.float64]:
    """(height, width, 3) unit vectors of the pixels' middles."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    d = np.dstack(
        [undistort(np.dstack([x, y]).reshape(-1, 2).astype(float), LENS).reshape(*x.shape, 2), np.ones(x.shape)]
    )
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@pytest.mark.parametrize("middle", [(0.0, 0.0, 3.0), (0.7, -0.4, 2.5), (-0.9, 0.5, 3.0)])
def test_a_ball_covers_the_pixels_whose_rays_meet_it(middle: tuple[float, float, float]) -> None:
    centre, radius = np.array(middle), 0.5
    _, which = drawn(*ball(centre, radius))
    d = rays() @ centre
    beside = np.sqrt(centre @ centre - d * d) - radius  # of the rays, from the ball [m]; a pixel is about 2 cm
    assert (which[beside < -0.004] >= 0).all()  # the mesh is within the ball by 1 − cos(π/96) of its radius
    assert (which[beside > 0] < 0).all()
    assert (which >= 0).sum() > 500


def test_the_area_and_the_middle_of_a_ball_before_the_lens_follow_from_its_distance() -> None:
    _, which = drawn(*ball(np.array([0.0, 0.0, 4.0]), 0.5))
    y, x = np.nonzero(which >= 0)
    r = 0.5 / math.sqrt(16 - 0.25)
    r *= 1 - 0.15 * r * r
    assert len(x) == pytest.approx(math.pi * r * r * LENS[0] * LENS[1], rel=0.02)
    np.testing.assert_allclose([x.mean(), y.mean()], LENS[2:4], atol=0.1)


def test_the_depth_is_that_of_the_ball() -> None:
    centre, radius = np.array([0.3, 0.2, 3.0]), 0.5
    near, which = drawn(*ball(centre, radius))
    d = rays()
    along = d @ centre
    inside = along**2 - (centre @ centre - radius**2)
    hit = (which >= 0) & (inside > 0.02)
    z = (along - np.sqrt(np.maximum(inside, 0)))[hit] * d[hit][:, 2]
    np.testing.assert_allclose(1 / near[hit], z, atol=0.004)


def test_what_is_nearer_is_seen_in_whatever_order_it_is_drawn() -> None:
    a, faces = ball(np.array([0.0, 0.0, 3.0]), 0.4)
    b, _ = ball(np.array([0.2, 0.0, 2.0]), 0.2)
    there = [
        drawn(np.vstack([a, b]), np.vstack([faces, faces + len(a)])),
        drawn(np.vstack([b, a]), np.vstack([faces, faces + len(a)])),
    ]
    first, second = there[0][1] >= len(faces), (there[1][1] >= 0) & (there[1][1] < len(faces))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, drawn(b, faces)[1] >= 0)


def test_what_is_seen_from_inside_is_not_drawn() -> None:
    vertices, faces = ball(np.array([0.0, 0.0, 3.0]), 0.5)
    inside = drawn(vertices, faces[:, ::-1].copy())
    outside = drawn(vertices, faces)
    assert inside[0].max() < outside[0].max()  # only the far side


def test_a_corner_behind_the_camera_takes_its_triangle_with_it() -> None:
    vertices = np.array([[-1.0, -1.0, 1.0], [0.0, 1.0, 1.0], [1.0, -1.0, -1.0]])
    for faces in ([[0, 1, 2]], [[0, 2, 1]]):
        assert (drawn(vertices, np.array(faces, np.int32))[1] < 0).all()


@given(st.tuples(places, places, places), st.floats(0.2, 2.0))
def test_samples_inside_a_triangle_are_covered(corners: tuple, step: float) -> None:
    p = np.array(corners)
    (ax, ay), (bx, by), (cx, cy) = p
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if abs(area) < 1e-3:
        return
    order = [0, 1, 2] if area < 0 else [0, 2, 1]
    near, which = np.zeros((40, 50)), np.full((40, 50), -1, np.int32)
    raster.cover(np.column_stack([p, [1.0, 0.5, 0.25]]), np.array([order], np.int32), -3.0, -2.0, step, near, which)
    x, y = np.meshgrid(-3.0 + step * np.arange(50), -2.0 + step * np.arange(40))
    M = np.vstack([p.T, np.ones(3)])
    shares = np.einsum("ij,jkl->ikl", np.linalg.inv(M), np.stack([x, y, np.ones_like(x)]))
    assert (which[(shares > 1e-6).all(axis=0)] == 0).all()
    assert (which[(shares < -1e-6).any(axis=0)] < 0).all()
    hit = which == 0
    np.testing.assert_allclose(near[hit], np.einsum("i,ij->j", [1.0, 0.5, 0.25], shares[:, hit]), atol=1e-6)


@given(st.tuples(places, places, places), st.lists(st.floats(0.05, 1.0), min_size=3, max_size=3))
def test_shares_find_the_point_again_that_is_seen(corners: tuple, shares: list[float]) -> None:
    p = np.array(corners)
    if abs(np.linalg.det(np.vstack([p.T, np.ones(3)]))) < 1.0:
        return
    w = np.array(shares) / sum(shares)
    z = np.array([1.0, 2.0, 4.0])
    X = np.column_stack([p * z[:, None], z])  # a camera of focal length 1
    seen = np.column_stack([p, 1 / z])
    at = w @ X
    np.testing.assert_allclose(raster.weights(seen, 0, 1, 2, at[0] / at[2], at[1] / at[2]), w, atol=1e-6)


def test_normals_of_a_ball_point_out_of_its_middle() -> None:
    vertices, faces = ball(np.zeros(3), 2.0)
    normals = np.empty_like(vertices)
    raster.vertex_normals(vertices, faces, normals)
    np.testing.assert_allclose(normals, vertices / 2.0, atol=0.02)
