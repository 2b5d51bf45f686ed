"""A body of rays begins with its limbs bent as the rays show them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.ray_bodies import HALPE, MODEL, around, errors, follow, lengths, rays_to

from mocapella.kinematics.articulated_body import Pose, joints
from mocapella.kinematics.ray_body import RayBody
from mocapella.kinematics.ray_start_kernels import bone_frame, hinge_below

Float64 = NDArray[np.float64]
KNEES = HALPE.index("LKnee"), HALPE.index("RKnee")
ANKLES = HALPE.index("LAnkle"), HALPE.index("RAnkle")


def seated(flexed: float, apart: float, bent: float, turned: float) -> Float64:
    """(26, 3) joints of somebody with thighs raised forwards and apart, and bent knees, facing a direction [m]."""
    angles, position = np.zeros(MODEL.layout.dofs), np.array([0.2, 0.95, -0.1])
    angles[:3] = position
    rotations = np.repeat(np.eye(3)[None], MODEL.layout.balls, axis=0)
    rotations[0] = Rotation.from_rotvec((0.0, turned, 0.0)).as_matrix()
    for knee, ankle, side in zip(KNEES, ANKLES, (1.0, -1.0), strict=True):
        raised = Rotation.from_euler("yx", (side * apart, -flexed)).as_matrix()
        rotations[MODEL.joint_table[knee, 3]] = raised
        angles[MODEL.joint_table[ankle, 1]] = bent
    return joints(MODEL, Pose(position, rotations, angles, lengths(1.6)))


@settings(max_examples=8, deadline=None)
@given(st.floats(0.2, 1.8), st.floats(0.0, 0.8), st.floats(0.3, 2.5), st.floats(-3.1, 3.1))
def test_bent_legs_begin_where_their_rays_are(flexed: float, apart: float, bent: float, turned: float) -> None:
    truth = seated(flexed, apart, bent, turned)[None]
    found = follow(truth, around(4), 0.002, 1)
    assert errors(found, truth)[0, [*KNEES, *ANKLES]].max() < 0.06
    assert (found[0].support[[*KNEES, *ANKLES]] == 4).all()


def test_every_knee_and_elbow_has_a_hinge_below_it_and_nothing_else_has() -> None:
    balls = np.flatnonzero(MODEL.joint_table[:, 3] > 0).tolist()
    below = {HALPE.joints[j]: hinge_below(MODEL.arrays, j) for j in balls}
    found = {name: HALPE.joints[c] for name, c in below.items() if c >= 0}
    assert found == {"LKnee": "LAnkle", "RKnee": "RAnkle", "LElbow": "LWrist", "RElbow": "RWrist"}


@pytest.mark.slow
def test_the_frame_of_a_bone_turns_it_and_its_hinge_into_the_limb() -> None:
    knee, frame = KNEES[0], np.empty((3, 3))
    limb = np.array([[0.0, 1.0, 0.0], [0.0, 0.9, 0.4], [0.1, 0.5, 0.3]])
    bend = bone_frame(MODEL.arrays, knee, 0, 1.0, limb, frame)
    upper, lower = limb[1] - limb[0], limb[2] - limb[1]
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(frame @ MODEL.joint_values[knee, :3], upper / np.linalg.norm(upper), atol=1e-12)
    turned = Rotation.from_rotvec(frame[:, 0] * bend).apply(upper / np.linalg.norm(upper))
    np.testing.assert_allclose(turned, lower / np.linalg.norm(lower), atol=1e-12)
    assert bone_frame(MODEL.arrays, knee, 0, 1.0, np.zeros((3, 3)), frame) == 0.0


@pytest.mark.slow
def test_rays_that_the_pose_does_not_follow_do_not_triangulate_their_joint() -> None:
    body, knee, layout = RayBody(), KNEES[0], MODEL.layout
    truth = np.repeat(seated(0.2, 0.0, 0.3, 0.5)[None], 6, axis=0)
    truth[5, knee] += [0.0, 0.0, 2.0]  # four rays agree about a place where no leg reaches
    follow(truth[:5], around(4), 0.002, 1, body=body)
    ages = body.memory[0, layout.ages : layout.ages + 4 * layout.joints : 4]
    assert (ages == 0.0).all()
    seen, origins, directions, _ = rays_to(truth[5], around(4), 0.002, np.random.default_rng(2))
    found = body.update(5 / 30, seen, origins, directions, 0.002)
    assert np.linalg.norm(found.positions[knee] - truth[5, knee]) > 0.5
    assert ages[knee] == pytest.approx(1 / 30)
    assert (ages[[HALPE.index(name) for name in ("Neck", "LWrist", "RWrist")]] == 0.0).all()
