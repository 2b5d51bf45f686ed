"""The chain's derivatives and the linear-time solution, against finite differences and dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.kinematic_bodies import DOFS, KINECT, MODEL, pose

from mocapella.geometry.turn_kernels import turn_between, turned
from mocapella.kinematics.articulated_body import Pose, joints, row_of
from mocapella.kinematics.articulated_model import OF_BALL, ROOT_DOFS
from mocapella.kinematics.chain_kernels import (
    Elimination,
    forward,
    independent,
    limited,
    marginals,
    solve,
    swing,
)

Float64 = NDArray[np.float64]
JOINTS = len(KINECT)
seeds = st.integers(0, 2**32 - 1)


def chain(body: Pose) -> tuple[Float64, Float64]:
    """Joints about the root, and twists."""
    x, frames, twists = np.empty((JOINTS, 3)), np.empty((JOINTS, 9)), np.empty((DOFS, 6))
    forward(MODEL.arrays, row_of(MODEL, body), body.position, x, frames, twists)
    return x, twists


def before(joint: int) -> list[int]:
    """The degrees of freedom that move a joint."""
    moved: list[int] = []
    while joint >= 0:
        moved += range(MODEL.joint_table[joint, 1], MODEL.joint_table[joint, 1] + MODEL.joint_table[joint, 2])
        joint = int(MODEL.joint_table[joint, 0])
    return moved


def jacobian(x: Float64, twists: Float64) -> Float64:
    """(joints, 3, dofs)."""
    J = np.zeros((JOINTS, 3, DOFS))
    for joint in range(JOINTS):
        for i in before(joint):
            J[joint, :, i] = twists[i, 3:] + np.cross(twists[i, :3], x[joint])
    return J


def stepped(body: Pose, i: int, step: float) -> Pose:
    """The body with one degree of freedom moved."""
    position, rotations, angles = body.position.copy(), body.rotations.copy(), body.angles.copy()
    if i < 3:
        position += step * rotations[0][:, i]
    elif MODEL.dof_kind[i] < OF_BALL:
        angles[i] += step
    else:
        joint = next(j for j in range(JOINTS) if i in before(j)[: MODEL.joint_table[j, 2]])
        turn = np.eye(3)[MODEL.dof_kind[i] - OF_BALL] * step
        ball = MODEL.joint_table[joint, 3]
        rotations[ball] = rotations[ball] @ Rotation.from_rotvec(turn).as_matrix()
    return Pose(position, rotations, angles, body.lengths)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_twists_are_the_derivatives_of_the_joints(seed: int) -> None:
    body = pose(np.random.default_rng(seed))
    J = jacobian(*chain(body))
    for i in range(DOFS):
        difference = joints(MODEL, stepped(body, i, 1e-6)) - joints(MODEL, stepped(body, i, -1e-6))
        np.testing.assert_allclose(J[:, :, i], difference / 2e-6, atol=1e-8)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_without_room_for_twists_the_joints_are_the_same(seed: int) -> None:
    body = pose(np.random.default_rng(seed))
    np.testing.assert_allclose(joints(MODEL, body) - body.position, chain(body)[0], atol=1e-12)


def tree_problem(seed: int) -> tuple[Float64, ...]:
    """A body with some measured joints, and its dense Jacobian."""
    rng = np.random.default_rng(seed)
    x, twists = chain(pose(rng))
    weights = np.where(rng.random(JOINTS) < 0.7, rng.uniform(1e2, 1e5, JOINTS), 0.0)
    D, e = rng.uniform(1.0, 1e4, DOFS), rng.normal(0.0, 0.1, DOFS)
    return x, twists, rng.normal(0.0, 0.05, (JOINTS, 3)), weights, D, e, jacobian(x, twists)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seeds)
def test_the_linear_time_solution_is_the_dense_one(seed: int) -> None:
    x, twists, residuals, weights, D, e, J = tree_problem(seed)
    work = Elimination(
        np.empty((JOINTS, 27)), np.empty((DOFS, 6)), np.empty(DOFS), np.empty(DOFS), np.empty((JOINTS, 6))
    )
    delta = np.empty(DOFS)
    solve(MODEL.joint_table, MODEL.order, twists, D, e, x, residuals, weights, work, delta)
    H = np.einsum("jki,j,jkl->il", J, weights, J) + np.diag(D)
    g = np.einsum("jki,j,jk->i", J, weights, residuals) + D * e
    np.testing.assert_allclose(delta, np.linalg.solve(H, g), rtol=1e-6, atol=1e-8)

    C, dofs, coordinates = np.empty((JOINTS, 21)), np.empty(DOFS), np.empty(JOINTS)
    marginals(MODEL.joint_table, MODEL.order, twists, work.U, work.d, x, C, dofs, coordinates)
    covariance = np.linalg.inv(H)
    np.testing.assert_allclose(dofs, np.diag(covariance), rtol=1e-6)
    np.testing.assert_allclose(coordinates, np.einsum("jki,il,jkl->j", J, covariance, J) / 3, rtol=1e-6)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seeds)
def test_the_linear_time_solution_by_information_matrices_is_the_dense_one(seed: int) -> None:
    x, twists, residuals, weights, D, e, J = tree_problem(seed)
    rng = np.random.default_rng(seed)
    halves = rng.normal(0, 1, (JOINTS, 3, 2))  # of rank 2, as of one ray
    full = weights[:, None, None] * halves @ halves.swapaxes(1, 2)
    forces = np.einsum("jkl,jl->jk", full, residuals)
    packed = np.ascontiguousarray(full[:, *np.triu_indices(3)])
    work = Elimination(
        np.empty((JOINTS, 27)), np.empty((DOFS, 6)), np.empty(DOFS), np.empty(DOFS), np.empty((JOINTS, 6))
    )
    delta = np.empty(DOFS)
    solve(MODEL.joint_table, MODEL.order, twists, D, e, x, forces, packed, work, delta)
    H = np.einsum("jki,jkl,jlm->im", J, full, J) + np.diag(D)
    g = np.einsum("jki,jk->i", J, forces) + D * e
    np.testing.assert_allclose(delta, np.linalg.solve(H, g), rtol=1e-6, atol=1e-8)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(seeds)
def test_the_variances_of_a_tree_of_independent_angles(seed: int) -> None:
    x, twists, _, _, D, _, J = tree_problem(seed)
    out = np.empty(JOINTS)
    independent(MODEL.joint_table, MODEL.order, twists, 1.0 / D, 0, x, np.empty((JOINTS, 10)), out)
    np.testing.assert_allclose(out, np.einsum("jki,i,jki->j", J, 1.0 / D, J) / 3, rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds, st.sampled_from([1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-7]))
def test_a_turn_and_the_turn_between_are_inverses(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    A, B = Rotation.random(random_state=rng).as_matrix().reshape(9), np.empty(9)
    turned(A, 0, *vector, B)
    np.testing.assert_allclose(B.reshape(3, 3), A.reshape(3, 3) @ Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
    found = np.array(turn_between(A, 0, B))
    np.testing.assert_allclose(
        Rotation.from_rotvec(found).as_matrix(), Rotation.from_rotvec(vector).as_matrix(), atol=1e-6
    )


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_a_swing_turns_one_direction_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rng.normal(size=(2, 3))
    one, other = one / np.linalg.norm(one), other / np.linalg.norm(other)
    S = np.empty(9)
    for goal in (other, one, -one):
        swing(*one, *goal, S)
        np.testing.assert_allclose(S.reshape(3, 3) @ one, goal, atol=1e-9)
        np.testing.assert_allclose(S.reshape(3, 3) @ S.reshape(3, 3).T, np.eye(3), atol=1e-12)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(seeds)
def test_a_ball_is_brought_within_its_limits_and_stays_where_it_is_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joint = KINECT.index("ElbowLeft")
    values = MODEL.joint_values[joint]
    B, within, again = Rotation.random(random_state=rng).as_matrix().reshape(9), np.empty(9), np.empty(9)
    changed = limited(MODEL.joint_values, joint, 0.0, B, within)
    assert changed or (within == B).all()
    direction = within.reshape(3, 3) @ values[:3]
    assert direction @ values[4:7] >= np.cos(values[7]) - 1e-9
    limited(MODEL.joint_values, joint, 0.0, within, again)
    np.testing.assert_allclose(again, within, atol=1e-6)


def test_the_root_moves_everything_and_a_wrist_only_the_hand() -> None:
    assert before(KINECT.index("SpineBase")) == list(range(ROOT_DOFS))
    own = set(before(KINECT.index("HandLeft"))) - set(before(KINECT.index("WristLeft")))
    assert [j for j in range(JOINTS) if own & set(before(j))] == [KINECT.index("HandLeft"), KINECT.index("HandTipLeft")]
