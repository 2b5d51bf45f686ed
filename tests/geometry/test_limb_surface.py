"""The surface of limbs: closed, where the limbs end, and its own mirror image where it should be."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from mocapella.geometry.limb_surface import group_distances, polygonise

BALL = np.array([[0.0, 0, 0, 0, 0, 0, 0.1, 0.1, 0]])
DUMB_BELL = np.array([[0.1, 0, 0, 0.3, 0, 0, 0.05, 0.1, 0], [-0.3, 0, 0, -0.1, 0, 0, 0.1, 0.05, 0]])
WITHIN = np.array([0.02])


def grid(x: np.ndarray, step: float = 0.02) -> np.ndarray:
    y = np.arange(-0.15, 0.15 + step, step)
    return np.stack(np.meshgrid(x, y, y, indexing="ij"), axis=-1)


def closed(faces: np.ndarray) -> bool:
    edges = Counter(zip(faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist(), strict=True))
    return all(count == 1 and (b, a) in edges for (a, b), count in edges.items())


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_ball_is_round_and_has_its_volume(mirrored: bool) -> None:
    x = np.arange(0.01 if mirrored else -0.15, 0.15, 0.02)
    vertices, faces = polygonise(BALL, WITHIN, 1e-6, grid(x), mirrored=mirrored)
    assert closed(faces)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.1, atol=1e-4)
    assert volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.001, rel=0.03)


def test_a_mirrored_surface_is_its_own_mirror_image_also_in_two_pieces() -> None:
    vertices, faces = polygonise(DUMB_BELL, WITHIN, 1e-6, grid(np.arange(0.01, 0.45, 0.02)), mirrored=True)
    assert closed(faces)
    one = {tuple(vertex) for vertex in vertices.tolist()}
    assert {(-x, y, z) for x, y, z in one} == one
    assert volume(vertices, faces) > 0


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_limb_between_the_nodes_has_no_surface(mirrored: bool) -> None:
    speck = np.array([[0.0, 0, 0, 0, 0, 0, 0.005, 0.005, 0]])
    vertices, faces = polygonise(speck, WITHIN, 1e-6, grid(np.arange(0.01, 0.15, 0.02)), mirrored=mirrored)
    assert vertices.shape == faces.shape == (0, 3)


def test_distances_are_of_groups_apart() -> None:
    two = np.concatenate([BALL, DUMB_BELL[:1]])
    two[1, 8] = 1
    distance = group_distances(two, np.array([0.02, 0.02]), np.array([[0.0, 0.2, 0.0], [0.3, 0.0, 0.3]]))
    np.testing.assert_allclose(distance[:, 0], [0.1, np.hypot(0.3, 0.3) - 0.1])
    np.testing.assert_allclose(distance[:, 1], [np.hypot(0.1, 0.2) - 0.05, 0.2])
