"""What a camera sees of a closed surface: what it covers and where its outline is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.geometry import lens as lenses
from mocapella.geometry.outline_kernels import (
    NEAREST_M,
    alike,
    border,
    cover,
    cover_by_edges,
    face_sides,
    one_way,
    outline,
    outline_edges,
    see,
    window,
)
from mocapella.model.silhouettes import overlap

pytestmark = pytest.mark.slow  # of kernels that are compiled for these tests alone

Float64 = NDArray[np.float64]

PINHOLE = np.array([600.0, 610.0, 320.0, 240.0, 0, 0, 0, 0, 0])
BENT = np.array([600.0, 610.0, 310.0, 250.0, -0.2, 0.05, 0.002, -0.001, 0])
MOST = 5000


@given(st.tuples(st.integers(0, 9), st.integers(0, 40)), st.floats(0, 1), st.integers(0, 10_000))
def test_masks_are_as_alike_as_their_intersection_over_union(shape: tuple[int, int], share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask, phi = rng.random(shape) < share, rng.normal(share - 0.5, 0.5, shape).astype(np.float32)
    assert alike(mask.astype(np.uint8), phi) == overlap(mask, phi > 0)


def ball(rings: int = 24, around: int = 40) -> tuple[Float64, NDArray[np.int32]]:
    """A closed surface of radius 1, corners counter-clockwise as seen from outside."""
    tilt, turn = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(around) / around
    body = np.stack(
        [
            np.outer(np.sin(tilt), np.cos(turn)),
            np.outer(np.sin(tilt), np.sin(turn)),
            np.outer(np.cos(tilt), turn * 0 + 1),
        ],
        axis=-1,
    )
    vertices = np.concatenate([[[0, 0, 1]], body.reshape(-1, 3), [[0, 0, -1]]])
    k, j = np.arange(around), (np.arange(around) + 1) % around
    faces = [np.c_[0 * k, 1 + k, 1 + j]]
    for ring in range(rings - 2):
        a, b = 1 + ring * around, 1 + (ring + 1) * around
        faces += [np.c_[a + k, b + k, b + j], np.c_[a + k, b + j, a + j]]
    last = len(vertices) - 1 - around
    faces.append(np.c_[last + j, last + k, 0 * k + len(vertices) - 1])
    return vertices, np.concatenate(faces).astype(np.int32)


BALL, FACES = ball()
EDGES = outline_edges(FACES)


def seen(
    vertices: Float64, lens: Float64 = PINHOLE, step: int = 1, spacing: float = 4.0, T: Any = None
) -> dict[str, Any]:
    """Everything of one look, window of 640 × 480 and all."""
    pixels, depth = np.empty((len(vertices), 2)), np.empty(len(vertices))
    see(vertices, np.eye(4) if T is None else T, lens, lenses.farthest_r2(lens), pixels, depth)
    x, y, columns, rows = window(pixels, depth, 640, 480, step, 10)
    sides, mask = np.empty(len(FACES), np.int8), np.zeros((rows, columns), np.uint8)
    face_sides(pixels, depth, FACES, sides)
    cover(pixels, FACES, sides, x, y, step, mask)
    at, normals, points = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 3))
    bone, far = np.empty(MOST, np.int32), np.empty(MOST)
    bones = np.arange(len(vertices), dtype=np.int32)
    n = outline(
        vertices, pixels, depth, border(FACES, EDGES, sides), mask, x, y, step, spacing, bones, at, normals, points,
        bone, far,
    )  # fmt: skip
    return {
        "pixels": pixels, "depth": depth, "mask": mask, "origin": (x, y), "at": at[:n], "normals": normals[:n],
        "points": points[:n], "bone": bone[:n], "far": far[:n], "sides": sides,
    }  # fmt: skip


@given(st.floats(-1, 1), st.floats(-0.7, 0.7), st.floats(3, 8))
@settings(deadline=None, max_examples=30)
def test_points_are_seen_where_the_lens_shows_them(x: float, y: float, z: float) -> None:
    vertices = 0.3 * BALL + [x, y, z]
    pixels, depth = np.empty((len(vertices), 2)), np.empty(len(vertices))
    see(vertices, np.eye(4), BENT, lenses.farthest_r2(BENT), pixels, depth)
    assert depth == pytest.approx(vertices[:, 2])
    assert pixels == pytest.approx(lenses.project(vertices, BENT))


@given(st.floats(-0.8, 0.8), st.floats(-0.6, 0.6), st.floats(4, 8), st.floats(0.2, 0.5))
@settings(deadline=None, max_examples=25)
def test_the_outline_of_a_ball_is_where_lines_of_sight_touch_it(x: float, y: float, z: float, radius: float) -> None:
    centre = np.array([x, y, z])
    look = seen(radius * BALL + centre)
    # The faces' corners are on the ball: its edges are within it by the sagitta of half a face.
    sagitta = 1 - np.cos(np.pi / 24)
    off = np.linalg.norm(look["points"] - centre, axis=1) / radius
    assert off.max() <= 1 + 1e-9
    assert off.min() > 1 - 2 * sagitta
    rays = look["points"] / np.linalg.norm(look["points"], axis=1, keepdims=True)
    missed = np.linalg.norm(np.cross(rays, centre), axis=1) / radius  # of the line of sight from the centre
    assert missed.min() > 1 - 3 * sagitta
    assert missed.max() <= 1 + 1e-9
    # All of it: the lengths add up to the circumference of the ellipse that a ball is, and normals to none.
    lengths = np.linalg.norm(look["normals"], axis=1)
    angle = np.arcsin(radius / np.linalg.norm(centre))
    least = 2 * np.pi * 600 * np.tan(angle) * 0.95
    assert lengths.sum() > least
    assert abs(look["normals"].sum(axis=0)).max() < 0.03 * lengths.sum()
    outwards = look["at"] - look["at"].mean(axis=0)
    assert ((outwards * look["normals"]).sum(axis=1) > 0).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
@settings(deadline=None, max_examples=25)
def test_what_is_covered_is_what_any_face_covers(seed: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = BALL * rng.uniform(0.1, 0.6, 3) + [*rng.uniform(-0.5, 0.5, 2), rng.uniform(3, 6)]
    look = seen(vertices, step=step)
    x0, y0 = look["origin"]
    rows, columns = look["mask"].shape
    chosen = rng.integers([rows, columns], size=(200, 2))
    points = chosen[:, ::-1] * step + [x0, y0]
    a, b, c = (look["pixels"][FACES[:, k]][:, None] for k in range(3))

    def turn(p: Float64, q: Float64, r: Float64) -> Float64:
        return np.asarray((q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0])

    sides = np.stack([turn(a, b, points[None]), turn(b, c, points[None]), turn(c, a, points[None])])
    inside = ((sides > 1e-9).all(axis=0) | (sides < -1e-9).all(axis=0)).any(axis=0)
    covered = look["mask"][chosen[:, 0], chosen[:, 1]] > 0
    assert (covered[inside]).all()
    assert np.mean(covered != inside) < 0.02  # samples on an edge itself


def test_every_edge_of_a_closed_surface_has_two_faces() -> None:
    assert len(EDGES) == 3 * len(FACES) // 2
    assert (EDGES[:, 2:] >= 0).all()
    for edge in EDGES[::37]:
        for face in edge[2:]:
            assert set(edge[:2]) <= set(FACES[face])


def test_an_edge_of_one_face_is_of_the_outline() -> None:
    edges = outline_edges(np.array([[0, 1, 2]], np.int32))
    assert edges[:, 2:].tolist() == [[0, -1]] * 3


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
@settings(deadline=None, max_examples=25)
def test_the_edges_between_front_and_back_say_what_is_covered(seed: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = BALL * rng.uniform(0.1, 0.6, 3) + [*rng.uniform(-2.5, 2.5, 2), rng.uniform(3, 6)]
    pixels, depth = np.empty((len(vertices), 2)), np.empty(len(vertices))
    see(vertices, np.eye(4), PINHOLE, lenses.farthest_r2(PINHOLE), pixels, depth)
    sides = np.empty(len(FACES), np.int8)
    face_sides(pixels, depth, FACES, sides)
    whole, by_edges = np.zeros((80, 90), np.uint8), np.ones((80, 90), np.uint8)
    cover(pixels, FACES, sides, 200, 150, step, whole)
    cover_by_edges(pixels, border(FACES, EDGES, sides), 200, 150, step, by_edges)
    np.testing.assert_array_equal(by_edges, whole)


def test_faces_of_one_way_are_told_from_others() -> None:
    assert one_way(FACES)
    assert one_way(FACES[1:])
    assert not one_way(np.concatenate([FACES, FACES[:1]]))
    assert not one_way(np.concatenate([FACES[1:], FACES[:1, ::-1]]))


def test_an_outline_within_what_is_covered_is_none() -> None:
    """A small ball before a large one."""
    small, large = 0.1 * BALL + [0, 0, 3], 0.6 * BALL + [0, 0, 4]
    vertices, faces = np.concatenate([small, large]), np.concatenate([FACES, FACES + len(BALL)]).astype(np.int32)
    pixels, depth, sides = np.empty((len(vertices), 2)), np.empty(len(vertices)), np.empty(len(faces), np.int8)
    see(vertices, np.eye(4), PINHOLE, 0.0, pixels, depth)
    face_sides(pixels, depth, faces, sides)
    x, y, columns, rows = window(pixels, depth, 640, 480, 1, 10)
    mask = np.zeros((rows, columns), np.uint8)
    cover(pixels, faces, sides, x, y, 1, mask)
    at, normals, points = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 3))
    bone, far = np.empty(MOST, np.int32), np.empty(MOST)
    bones = (np.arange(len(vertices)) >= len(BALL)).astype(np.int32)
    edges = border(faces, outline_edges(faces), sides)
    n = outline(vertices, pixels, depth, edges, mask, x, y, 1, 4.0, bones, at, normals, points, bone, far)
    assert n > 50
    assert (bone[:n] == 1).all()


def test_where_there_is_no_room_the_rest_is_left_out() -> None:
    look = seen(0.5 * BALL + [0, 0, 4])
    pixels, depth, sides, mask = look["pixels"], look["depth"], look["sides"], look["mask"]
    x, y = look["origin"]
    at, normals, points = np.empty((7, 2)), np.empty((7, 2)), np.empty((7, 3))
    bones = np.zeros(len(BALL), np.int32)
    n = outline(
        0.5 * BALL + [0, 0, 4], pixels, depth, border(FACES, EDGES, sides), mask, x, y, 1, 4.0, bones, at, normals,
        points, np.empty(7, np.int32), np.empty(7),
    )  # fmt: skip
    assert n == 7
    assert at == pytest.approx(look["at"][:7])


def test_what_is_behind_the_camera_or_too_near_is_not_drawn() -> None:
    for centre in ([0, 0, -3], [0, 0, NEAREST_M / 2]):
        pixels, depth = np.empty((len(BALL), 2)), np.empty(len(BALL))
        see(0.02 * BALL + centre, np.eye(4), PINHOLE, 0.0, pixels, depth)
        assert (depth == 0).all()
        assert window(pixels, depth, 640, 480, 1, 10) == (0, 0, 0, 0)
        sides = np.empty(len(FACES), np.int8)
        face_sides(pixels, depth, FACES, sides)
        assert (sides == 0).all()


@pytest.mark.parametrize("step", [1, 2, 3])
def test_windows_begin_at_multiples_of_the_step_and_reach_as_far_as_the_margin(step: int) -> None:
    pixels, depth = np.array([[100.3, 50.2], [130.7, 90.9]]), np.ones(2)
    x, y, columns, rows = window(pixels, depth, 640, 480, step, 10)
    assert x % step == y % step == 0
    assert x <= 90.3
    assert y <= 40.2
    assert x + step * (columns - 1) >= 140.7
    assert y + step * (rows - 1) >= 100.9
    beyond = window(pixels - 1000, depth, 640, 480, step, 10)
    assert beyond == (0, 0, 0, 0)


def test_a_window_ends_a_margin_beyond_the_image() -> None:
    pixels, depth = np.array([[-5000.0, 50.0], [5000.0, 90.0]]), np.ones(2)
    x, _, columns, _ = window(pixels, depth, 640, 480, 1, 10)
    assert (x, columns) == (-10, 660)
