"""Meshes that joints move: the laws of skinning, and what a mesh may not be."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rigged_meshes import BOX_FACES, CORNERS, any_motion, any_pose, is_closed, volume, worm

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.model.rigged_mesh import (
    Landmark,
    at_rest,
    carried,
    farthest_apart_m,
    landmarks_at,
    posed,
    rest,
    rigid_mesh,
    smooth,
    strongest,
)
from mocapella.model.twist_tree import TreePose, motions, part_motions

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=25, deadline=None)


def test_at_rest_the_vertices_and_landmarks_are_where_they_were_built() -> None:
    mesh = worm()
    np.testing.assert_array_equal(posed(mesh, rest(mesh)), mesh.vertices)
    np.testing.assert_array_equal(
        landmarks_at(mesh, rest(mesh)), [landmark.point for landmark in mesh.landmarks.values()]
    )


@few
@given(seeds)
def test_a_motion_of_the_root_moves_everything_rigidly(seed: int) -> None:
    rng, mesh = np.random.default_rng(seed), worm()
    at, G = any_pose(rng, mesh), any_motion(rng)
    there = TreePose(G @ at.T_world_model, at.angles)
    np.testing.assert_allclose(posed(mesh, there), apply(G, posed(mesh, at)), atol=1e-12)
    np.testing.assert_allclose(landmarks_at(mesh, there), apply(G, landmarks_at(mesh, at)), atol=1e-12)


@few
@given(seeds)
def test_vertices_are_the_blend_of_where_their_parts_bring_them(seed: int) -> None:
    mesh = worm()
    at = any_pose(np.random.default_rng(seed), mesh)
    T = part_motions(mesh.tree, at)
    there = posed(mesh, at)
    np.testing.assert_allclose(there[8:12], apply(T[1], mesh.vertices[8:12]), atol=1e-12)
    blended = 0.75 * apply(T[1], mesh.vertices[4:8]) + 0.25 * apply(T[0], mesh.vertices[4:8])
    np.testing.assert_allclose(there[4:8], blended, atol=1e-12)
    points = [apply(T[landmark.part], landmark.point[None])[0] for landmark in mesh.landmarks.values()]
    np.testing.assert_allclose(landmarks_at(mesh, at), points, atol=1e-12)


@few
@given(seeds, st.integers(0, 9))
def test_points_that_one_part_carries_are_brought_back_to_where_they_are_at_rest(seed: int, count: int) -> None:
    rng, mesh = np.random.default_rng(seed), worm()
    points, part = rng.normal(size=(count, 3)), rng.integers(0, len(mesh.tree.parents), count)
    moved = motions(mesh.tree, any_pose(rng, mesh))
    there = carried(points, part[:, None].astype(np.int32), np.ones((count, 1)), moved)
    np.testing.assert_allclose(at_rest(there, part, moved), points, atol=1e-12)


def test_batches_are_what_each_alone_is() -> None:
    rng, mesh = np.random.default_rng(0), worm()
    poses = [any_pose(rng, mesh) for _ in range(3)]
    batch = TreePose(np.array([at.T_world_model for at in poses]), np.array([at.angles for at in poses]))
    assert posed(mesh, batch).shape == (3, 16, 3)
    np.testing.assert_array_equal(posed(mesh, batch)[2], posed(mesh, poses[2]))
    np.testing.assert_array_equal(landmarks_at(mesh, batch)[1], landmarks_at(mesh, poses[1]))
    bare = msgspec.structs.replace(mesh, landmarks={})
    assert landmarks_at(bare, batch).shape == (3, 0, 3)


@few
@given(seeds, st.integers(0, 50))
def test_two_sets_of_points_are_as_far_apart_as_the_farthest_two_are(seed: int, count: int) -> None:
    these, those = np.random.default_rng(seed).normal(size=(2, count, 3))
    assert farthest_apart_m(these, those) == pytest.approx(np.linalg.norm(these - those, axis=1).max(initial=0.0))


def test_a_rigid_object_has_six_degrees_of_freedom() -> None:
    mesh = rigid_mesh("box", CORNERS, BOX_FACES, {"corner": (0, 0, 0)})
    assert mesh.tree.dofs == 6
    assert mesh.part_names == ("box",)
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(6.0)
    np.testing.assert_allclose(mesh.tree.root, [0.5, 1.0, 1.5])
    T = any_motion(np.random.default_rng(0))
    at = TreePose(T, np.empty(0))
    np.testing.assert_allclose(posed(mesh, at), apply(T, CORNERS), atol=1e-12)
    np.testing.assert_allclose(landmarks_at(mesh, at), [T[:3, 3]], atol=1e-12)


def test_a_mesh_that_has_no_vertices_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"nothing: shape of vertices is \(0, 3\); it must be \(1 or more, 3\)"):
        rigid_mesh("nothing", np.empty((0, 3)), np.empty((0, 3)))


@few
@given(seeds, st.integers(1, 6))
def test_the_strongest_weights_fall_and_add_up_to_one(seed: int, most: int) -> None:
    weights = np.random.default_rng(seed).uniform(size=(20, 6)) ** 8
    bones, shares = strongest(weights, most)
    assert shares.shape == (20, most)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    assert (np.diff(shares, axis=1) <= 0).all()
    np.testing.assert_array_equal(bones[:, 0], weights.argmax(axis=1))
    ratio = np.take_along_axis(weights, bones.astype(np.int64), axis=1) / weights.max(axis=1)[:, None]
    np.testing.assert_array_equal(shares > 0, ratio >= 1e-3)


def changed(array: np.ndarray, where: tuple[int, ...], value: float) -> np.ndarray:
    out = array.copy()
    out[where] = value
    return out


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (lambda m: {"shares": changed(m.shares, (5, 0), 0.5)}, r"worm: shares of vertex \[5\] is \[\[0.5, 0.25\]\]"),
        (lambda m: {"shares": m.shares[:, ::-1]}, "worm: shares of vertex .* falling"),
        (lambda m: {"shares": m.shares * [1.25, -0.25] + [0.0, 0.0]}, "worm: shares of vertex"),
        (lambda m: {"bones": changed(m.bones, (3, 0), 3)}, r"worm: bones\[\[3, 0\]\] is \[3\]; it must be 0 to 2"),
        (lambda m: {"bones": changed(m.bones, (3, 0), -1)}, r"worm: bones\[\[3, 0\]\] is \[-1\]; it must be 0 to 2"),
        (lambda m: {"faces": changed(m.faces, (2, 1), 16)}, r"worm: faces\[\[2, 1\]\] is \[16\]; it must be 0 to 15"),
        (lambda m: {"vertices": changed(m.vertices, (0, 0), np.nan)}, "worm: vertices is 'not finite'"),
        (lambda m: {"vertices": m.vertices[:-1]}, "worm: shapes of vertices, faces, bones and shares"),
        (lambda m: {"bones": m.bones[:, :0], "shares": m.shares[:, :0]}, "a part for each vertex at least"),
        (lambda m: {"part_names": ("tail",)}, r"worm: names of parts and joints is \(1, 2\)"),
        (lambda m: {"joint_names": ("bend",)}, r"worm: names of parts and joints is \(3, 1\)"),
        (lambda m: {"part_names": ("a", "a", "b")}, r"worm: names of parts that are there twice is \['a'\]"),
        (lambda m: {"joint_names": ("a", "a")}, r"worm: names of joints that are there twice is \['a'\]"),
        (lambda m: {"landmarks": {"eye": Landmark(3, np.zeros(3))}}, "worm: landmark eye: part is 3"),
        (lambda m: {"landmarks": {"eye": Landmark(-1, np.zeros(3))}}, "worm: landmark eye: part is -1"),
        (lambda m: {"landmarks": {"eye": Landmark(0, np.zeros(2))}}, "worm: landmark eye: point"),
        (lambda m: {"landmarks": {"eye": Landmark(0, np.full(3, np.inf))}}, "worm: landmark eye: point"),
    ],
)  # fmt: skip
def test_a_mesh_that_cannot_be_says_what_is_wrong(changes, said) -> None:  # type: ignore[no-untyped-def]
    mesh = worm()
    with pytest.raises(SettingsError, match=said):
        msgspec.structs.replace(mesh, **changes(mesh))


@given(st.floats(-5, 5), st.floats(0.01, 5), st.floats(-1, 2))
def test_a_smooth_step_is_0_before_1_after_and_symmetric_about_its_middle(
    start: float, width: float, share: float
) -> None:
    end, x = start + width, start + share * width
    before, at_start, middle, at_end, after = smooth(
        np.array([start - width, start, start + width / 2, end, end + width]), start, end
    )
    assert (before, at_start, after) == (0, 0, 1)
    assert (middle, at_end) == (pytest.approx(0.5), pytest.approx(1))
    assert smooth(np.array(x), start, end) + smooth(np.array(start + end - x), start, end) == pytest.approx(1)


def test_a_smooth_step_rises_everywhere_and_has_no_slope_at_its_ends() -> None:
    x = np.linspace(2, 4, 201)
    rises = np.diff(smooth(x, 2, 4))
    assert (rises > 0).all()
    assert max(rises[0], rises[-1]) < 0.02 * rises.max()
    assert rises.max() == pytest.approx(1.5 / 200, rel=1e-3), "one and a half times the mean slope, in the middle"
