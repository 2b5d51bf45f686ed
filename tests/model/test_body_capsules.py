"""Limbs as capsules: distances of segments, thick as the flesh is, and how deep they are in each other."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.rigged_meshes import any_pose, worm

from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist
from mocapella.model.body_capsules import capsules_of, depths_m, segment_distance
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, rest
from mocapella.model.twist_tree import TreePose, part_motions

MESH = body_mesh("female", detail=0.8)
SUPPLE = body_mesh("male", 1.9, detail=0.8, supple=True)
LEGS = legs_mesh(detail=0.8)
seeds = st.integers(0, 2**32 - 1)
OF_PART = {
    (False, "trunk"): "torso", (False, "head"): "torso", (True, "head"): "head",
    (False, "left hand"): "left forearm", (False, "right hand"): "right forearm",
}  # fmt: skip


points = st.lists(st.floats(-2, 2), min_size=12, max_size=12).map(lambda x: np.array(x).reshape(4, 3))


@given(points)
def test_the_distance_of_segments_is_the_least_between_their_points(ends: Any) -> None:
    a, b, c, d = ends
    t = np.linspace(0, 1, 81)[:, None]
    x, y = a + t * (b - a), c + t * (d - c)
    tried = np.linalg.norm(x[:, None] - y[None], axis=-1).min()
    found = float(segment_distance(a, b, c, d))
    step = 0.5 * (np.linalg.norm(b - a) + np.linalg.norm(d - c)) / 80
    assert found <= tried + 1e-9
    assert tried <= found + step
    assert float(segment_distance(c, d, b, a)) == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("shift", [0.0, 0.3, 2.0])
def test_parallel_segments_and_points_have_their_distance(shift: float) -> None:
    a, b = np.zeros(3), np.array([1.0, 0, 0])
    aside = np.array([shift, 0.5, 0])
    c, d = a + aside, b + aside
    assert float(segment_distance(a, b, c, d)) == pytest.approx(np.hypot(0.5, max(shift - 1, 0)))
    assert float(segment_distance(c, c, a, b)) == pytest.approx(np.hypot(0.5, max(shift - 1, 0)))


@pytest.mark.parametrize("mesh", [MESH, SUPPLE, LEGS], ids=["usual", "supple", "legs"])
def test_a_capsule_is_within_the_flesh_and_both_sides_are_alike(mesh: RiggedMesh) -> None:
    solid = capsules_of(mesh)
    radii = dict(zip(solid.names, solid.radii, strict=True))
    assert all(0.01 < radius < 0.15 for radius in radii.values())
    assert radii["left thigh"] > radii["left shank"] > radii["left foot"]
    for name, radius in radii.items():
        if name.startswith("left"):
            assert radii[name.replace("left", "right")] == pytest.approx(radius, rel=1e-9)


@pytest.mark.parametrize("mesh", [MESH, SUPPLE], ids=["usual", "supple"])
def test_three_quarters_of_the_skin_are_outside_of_all_capsules(mesh: RiggedMesh) -> None:
    solid, marks = capsules_of(mesh), landmarks_at(mesh, rest(mesh))
    x = mesh.vertices
    a, b = marks[solid.ends].transpose(1, 0, 2)
    inside = segment_distance(x, x, a[:, None], b[:, None]) < solid.radii[:, None]
    assert 0.1 < inside.any(axis=0).mean() < 0.4


@given(seeds)
def test_the_part_of_a_limb_moves_its_far_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = (MESH, SUPPLE, LEGS)[seed % 3]
    solid, pose = capsules_of(mesh), any_pose(rng, mesh, 0.5)
    far = solid.ends[:, 1]
    moved = apply(part_motions(mesh.tree, pose)[solid.part], landmarks_at(mesh, rest(mesh))[far][:, None])[:, 0]
    np.testing.assert_allclose(landmarks_at(mesh, pose)[far], moved, atol=1e-12)
    for name, part in zip(solid.names, solid.part, strict=True):
        assert mesh.part_names[part] == OF_PART.get((mesh is SUPPLE, name), OF_PART.get((False, name), name))


@given(seeds)
def test_moving_the_body_as_a_whole_changes_no_depth_and_none_is_below_0(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid, pose = capsules_of(MESH), any_pose(rng, MESH)
    deep = depths_m(solid, landmarks_at(MESH, pose))
    assert deep.shape == (len(solid.pairs),)
    assert (deep >= 0).all()
    G = exp_twist(2 * rng.normal(size=6))
    there = depths_m(solid, landmarks_at(MESH, TreePose(G @ pose.T_world_model, pose.angles)))
    np.testing.assert_allclose(there, deep, atol=1e-9)


def test_poses_in_batches_have_the_depths_that_each_has_alone() -> None:
    rng = np.random.default_rng(0)
    solid = capsules_of(MESH)
    marks = np.array([[landmarks_at(MESH, any_pose(rng, MESH)) for _ in range(3)] for _ in range(2)])
    deep = depths_m(solid, marks)
    assert deep.shape == (2, 3, len(solid.pairs))
    assert deep.max() > 0
    np.testing.assert_array_equal(deep[1, 2], depths_m(solid, marks[1, 2]))


@pytest.mark.parametrize("mesh", [MESH, SUPPLE, LEGS], ids=["usual", "supple", "legs"])
def test_no_limb_of_somebody_who_stands_is_in_another(mesh: RiggedMesh) -> None:
    assert depths_m(capsules_of(mesh), landmarks_at(mesh, rest(mesh))).max() == 0


def test_a_limb_is_so_deep_in_another_as_their_axes_are_too_near() -> None:
    solid, marks = capsules_of(MESH), list(MESH.landmarks)
    pair = [solid.names.index(name) for name in ("left forearm", "right forearm")]
    (q,) = np.flatnonzero((solid.pairs == pair).all(axis=1))
    places = landmarks_at(MESH, rest(MESH)).copy()
    left, right = (places[[marks.index(f"{side} {end}") for end in ("elbow", "wrist")]] for side in ("left", "right"))
    aside = np.cross(left[1] - left[0], [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    thick = 2 * solid.radii[pair[0]]
    for far in (0.0, 0.01, 0.9 * thick, 1.1 * thick):
        moved = places.copy()
        for name, at in zip(("elbow", "wrist"), left + far * aside, strict=True):
            moved[marks.index(f"right {name}")] = at
        assert depths_m(solid, moved)[q] == pytest.approx(max(thick - far, 0.0), abs=1e-9)
    assert np.linalg.norm(left - right, axis=1).min() > thick  # it is moved there, not found there


def test_limbs_that_hang_on_each_other_do_not_meet_and_others_do() -> None:
    solid = capsules_of(MESH)
    pairs = {frozenset({solid.names[i], solid.names[j]}) for i, j in solid.pairs}
    assert len(pairs) == len(solid.pairs)
    assert (solid.pairs[:, 0] < solid.pairs[:, 1]).all()
    for one, other in (
        ("trunk", "head"), ("trunk", "left upper arm"), ("head", "right upper arm"), ("trunk", "right thigh"),
        ("left thigh", "right thigh"), ("left thigh", "left shank"), ("left shank", "left foot"),
        ("right upper arm", "right forearm"), ("left forearm", "left hand"),
    ):  # fmt: skip
        assert frozenset({one, other}) not in pairs
    for one, other in (
        ("trunk", "left forearm"), ("left shank", "right shank"), ("left shank", "right foot"),
        ("left foot", "right foot"), ("left hand", "left thigh"), ("left upper arm", "right forearm"),
        ("left thigh", "right shank"), ("head", "left hand"),
    ):  # fmt: skip
        assert frozenset({one, other}) in pairs


def test_legs_alone_have_legs_and_what_is_no_body_has_no_limbs() -> None:
    assert set(capsules_of(LEGS).names) == {f"{s} {n}" for s in ("left", "right") for n in ("thigh", "shank", "foot")}
    none = capsules_of(worm())
    assert none.names == ()
    assert (none.ends.shape, none.part.shape, none.radii.shape, none.pairs.shape) == ((0, 2), (0,), (0,), (0, 2))
    assert depths_m(none, landmarks_at(worm(), rest(worm()))).shape == (0,)


@pytest.mark.parametrize("marks", [("left elbow", "left wrist"), ("left wrist", "left elbow"), ("left elbow",), ()])
def test_both_ends_of_a_limb_are_enough_for_its_capsule(marks: tuple[str, ...]) -> None:
    bare = msgspec.structs.replace(MESH, landmarks={name: MESH.landmarks[name] for name in marks})
    solid = capsules_of(bare)
    if len(marks) < 2:
        assert solid.names == ()
        return
    assert solid.names == ("left forearm",)
    assert [marks[k] for k in solid.ends[0]] == ["left elbow", "left wrist"]
    assert MESH.part_names[solid.part[0]] == "left forearm"
    assert (solid.radii > 0).all()
    assert solid.pairs.shape == (0, 2)


def test_a_limb_that_no_vertex_is_next_to_is_a_line() -> None:
    above = MESH.vertices[:, 1] > np.median(MESH.vertices[:, 1]) + 0.5
    head = msgspec.structs.replace(
        MESH, vertices=MESH.vertices[above], faces=np.empty((0, 3), np.int32), bones=MESH.bones[above],
        shares=MESH.shares[above],
    )  # fmt: skip
    solid = capsules_of(head)
    assert solid.radii[solid.names.index("left foot")] == 0
    assert solid.radii[solid.names.index("head")] > 0.05
