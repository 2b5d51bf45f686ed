"""A followed body beside the truth: the truth itself is perfect, and what is off is off by what it is."""

from __future__ import annotations

import numpy as np
import pytest
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.evaluation.silhouette_truth import TruthMeter, rough_start
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.rigged_mesh import landmarks_at, posed
from mocapella.model.twist_tree import TreePose

MESH, RIG = somebody(), ring(2)


def scored(pose, true_pose):
    meter = TruthMeter(MESH.joint_names)
    assert meter.score is None
    vertices, body = posed(MESH, pose), figure(MESH)
    outlines = {name: see(body, vertices, eye(placed), step_px=1) for name, placed in RIG.cameras.items()}
    masks = {
        name: one.mask(RIG.cameras[name].camera.size_px) for name, one in silhouettes_of(MESH, RIG, true_pose).items()
    }
    meter.update(pose, landmarks_at(MESH, pose), outlines, (true_pose, landmarks_at(MESH, true_pose), masks))
    return meter.score


def test_the_truth_is_perfect():
    score = scored(pose_at(MESH), pose_at(MESH))
    assert (score.frames, score.angle_deg, score.angle_mean_deg, score.joints_mm) == (1, 0.0, 0.0, 0.0)
    assert score.overlap == 1.0


def test_what_is_off_is_off_by_so_much():
    pose = pose_at(MESH, aside_m=0.1, elbow=0.5)
    score = scored(pose, pose_at(MESH, elbow=0.4))
    assert score.angles_deg["left elbow flexion"] == pytest.approx(np.degrees(0.1))
    assert score.angle_mean_deg == pytest.approx(np.degrees(0.1) * 2 / len(MESH.joint_names))
    assert score.joints_mm == pytest.approx(100.0, abs=10.0)
    assert 0.2 < score.overlap < 0.8


def test_a_rough_start_is_near_within_the_limits_and_the_same_for_a_seed():
    pose = TreePose(np.eye(4), np.clip(np.zeros(len(MESH.joint_names)), *MESH.tree.limits.T))
    first, again, other = (rough_start(pose, MESH.tree.limits, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.angles, again.angles)
    assert not np.array_equal(first.angles, other.angles)
    assert (first.angles >= MESH.tree.limits[:, 0]).all()
    assert (first.angles <= MESH.tree.limits[:, 1]).all()
    assert 0 < np.abs(first.T_world_model[:3, 3]).max() < 0.15
