"""Forward kinematics in twists: products of exponentials, and twists that are derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import twist_trees as trees

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import revolute
from mocapella.model.twist_tree import TreePose, joint_twists, limbs_of, part_motions, twist_tree

seeds = st.integers(0, 2**32 - 1)
AXES = revolute(np.eye(3), np.ones((3, 3)))


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 8), st.integers(0, 4))
def test_parts_are_where_the_product_of_exponentials_brings_them(seed: int, parts: int, more: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng, parts, parts - 1 + more if parts > 1 else 0)
    at = trees.pose(rng, model, bent=2.0)
    T, xi = trees.motions(model, at)
    np.testing.assert_allclose(part_motions(model, at), T, atol=1e-13)
    np.testing.assert_allclose(joint_twists(model, at), xi, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_twists_are_the_derivatives_of_the_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = trees.tree(rng)
    at, step, moved = trees.pose(rng, model), 1e-6, trees.moves(model)
    x0 = rng.normal(size=(1, 3))
    x = apply(part_motions(model, at), x0)[:, 0]
    for j, twist in enumerate(joint_twists(model, at)):
        there, back = (TreePose(at.T_world_model, at.angles + s * np.eye(len(at.angles))[j]) for s in (step, -step))
        difference = (apply(part_motions(model, there), x0) - apply(part_motions(model, back), x0))[:, 0] / (2 * step)
        np.testing.assert_allclose(
            difference[moved[:, j]], (twist[:3] + np.cross(twist[3:], x))[moved[:, j]], atol=1e-8
        )
        np.testing.assert_array_equal(difference[~moved[:, j]], 0)


def test_batches_are_what_each_alone_is() -> None:
    rng = np.random.default_rng(0)
    model = trees.tree(rng)
    poses = [[trees.pose(rng, model) for _ in range(3)] for _ in range(2)]
    T = np.array([[one.T_world_model for one in row] for row in poses])
    angles = np.array([[one.angles for one in row] for row in poses])
    there = part_motions(model, TreePose(T, angles))
    assert there.shape == (2, 3, 6, 4, 4)
    np.testing.assert_array_equal(there[1, 2], part_motions(model, poses[1][2]))
    np.testing.assert_array_equal(
        part_motions(model, TreePose(T[0, 0], angles))[1, 2], part_motions(model, TreePose(T[0, 0], angles[1, 2]))
    )
    np.testing.assert_array_equal(joint_twists(model, TreePose(T, angles))[0, 1], joint_twists(model, poses[0][1]))


@given(seeds, st.integers(1, 8))
def test_limbs_are_chains_that_begin_where_the_tree_divides(seed: int, parts: int) -> None:
    model = trees.tree(np.random.default_rng(seed), parts, 2 * parts - 2)
    limbs, parents = limbs_of(model), model.parents.tolist()
    assert sorted(p for _, of_it in limbs for p in of_it) == list(range(1, parts))
    for joints, of_it in limbs:
        first, *rest = of_it.tolist()
        assert parents[first] == 0 or parents.count(parents[first]) > 1
        for before, part in zip(of_it.tolist(), rest, strict=False):
            assert parents[part] == before
            assert parents.count(before) == 1
        assert joints.tolist() == [j for j, part in enumerate(model.joint_parts) if part in of_it]


def test_a_rigid_object_is_a_tree_of_one_part() -> None:
    rng = np.random.default_rng(0)
    model = twist_tree([-1])
    at = trees.pose(rng, model)
    assert model.dofs == 6
    np.testing.assert_array_equal(part_motions(model, at), at.T_world_model[None])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"parents": [0, 0, 1]}, "parents"),
        ({"parents": [-1, 2, 1]}, "parents"),
        ({"parents": [-1, 0, -1]}, "parents"),
        ({"parents": []}, "parents"),
        ({"joint_parts": [1, 2, 1]}, "joint_parts"),
        ({"joint_parts": [0, 1, 2]}, "joint_parts"),
        ({"joint_parts": [1, 2, 3]}, "joint_parts"),
        ({"twists": AXES[:2]}, "shapes"),
        ({"limits": np.zeros((2, 2))}, "shapes"),
        ({"root": [0.0, 0.0]}, "shapes"),
        ({"twists": 2 * AXES}, "twists"),
        ({"twists": AXES + np.r_[np.eye(3)[0], np.zeros(3)]}, "without pitch"),
        ({"twists": revolute(np.zeros((3, 3)), np.ones((3, 3)))}, "twists"),
        ({"limits": [[0, 1], [1, 0], [0, 1]]}, "limits"),
        ({"limits": [[0, 1], [np.nan, 0], [0, 1]]}, "limits"),
        ({"root": [0.0, 0.0, np.nan]}, "root"),
    ],
)
def test_what_is_no_tree_is_refused(changes: dict[str, object], said: str) -> None:
    good = {"parents": [-1, 0, 1], "joint_parts": [1, 2, 2], "twists": AXES, "limits": np.tile([-1.0, 1.0], (3, 1))}
    assert twist_tree(**good).dofs == 9
    with pytest.raises(SettingsError, match=said):
        twist_tree(**(good | changes))
