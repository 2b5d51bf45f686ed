"""Somebody who comes back is found wherever they are, by what is not in the empty room."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y
from mocapella.kinematics.silhouette_fit import eye, see
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.body_reacquisition import STEP_PX, _on_grid, reacquire
from mocapella.tracker.silhouette_body import SilhouetteBody

MESH = somebody()
RIG = ring(3, size_px=(640, 480), far_m=5.0)
EYES = {name: eye(placed) for name, placed in RIG.cameras.items()}
BODY = SilhouetteBody(MESH)
BEFORE = pose_at(MESH)


def standing(x=0.0, z=0.0, turned=0.0):
    """There, turned from `BEFORE` about itself."""
    T = rigid(rotation_about_y(turned), np.array([x, 0.0, z]))
    return TreePose(T @ BEFORE.T_world_model, BEFORE.angles)


def missed_m(found, true):
    return np.linalg.norm(landmarks_at(MESH, found) - landmarks_at(MESH, true), axis=1)


@settings(max_examples=25, deadline=None)
@given(x=st.floats(-0.9, 0.9), z=st.floats(-0.9, 0.9), turned=st.floats(-0.35, 0.35))
@example(x=0.025, z=0.25, turned=-0.25)  # was found turned round
@example(x=0.1, z=0.25, turned=-0.25)
def test_who_stands_elsewhere_is_found_there(x, z, turned):
    true = standing(x, z, turned)
    found = reacquire(silhouettes_of(MESH, RIG, true), BODY, [BEFORE], EYES)
    assert found is not None
    assert np.median(missed_m(found, true)) < 0.1
    # About the body's axis a turn hardly shows; along it and across it does.
    middles = (landmarks_at(MESH, one).mean(axis=0) for one in (found, true))
    assert np.linalg.norm(np.subtract(*middles)) < 0.08


@settings(max_examples=25, deadline=None)
@given(x=st.floats(-4, 4), y=st.floats(-2, 2), z=st.floats(-3, 3))
def test_on_the_grid_an_outline_covers_what_its_silhouette_does(x, y, z):
    """Also where it reaches beyond the image."""
    true = standing(x, z)
    true.T_world_model[1, 3] += y
    for by in EYES.values():
        outline = see(BODY.figure, BODY.standing(true).vertices, by, step_px=STEP_PX, margin_px=0)
        if outline is not None:
            covered = outline.silhouette.mask(by.size_px)[::STEP_PX, ::STEP_PX]
            np.testing.assert_array_equal(_on_grid(outline, covered.shape), covered)


def test_who_turned_aside_is_found_turned():
    angles = BEFORE.angles.copy()
    for side in ("left", "right"):
        angles[MESH.joint_names.index(f"{side} shoulder swing forwards")] = np.radians(80)
    before = TreePose(BEFORE.T_world_model, angles)
    true = TreePose(standing(0.4, -0.3, np.pi / 2).T_world_model, angles)
    found = reacquire(silhouettes_of(MESH, RIG, true), BODY, [before], EYES)
    assert np.median(missed_m(found, true)) < 0.1


def test_one_camera_that_sees_something_else_is_not_asked():
    true = standing(0.3, 0.2)
    seen = silhouettes_of(MESH, RIG, true)
    seen["c2"] = Silhouette((10, 10), 1, np.ones((120, 60), np.float32))
    found = reacquire(seen, BODY, [BEFORE], EYES)
    assert np.linalg.norm(found.T_world_model[:3, 3] - true.T_world_model[:3, 3]) < 0.15


@pytest.mark.parametrize("kept", [[], ["c1"], ["c3"]])
def test_fewer_than_two_cameras_say_nothing(kept):
    seen = silhouettes_of(MESH, RIG, standing(0.3))
    assert reacquire({name: seen[name] for name in kept}, BODY, [BEFORE], EYES) is None


def test_what_is_no_body_is_none():
    """A lamp that all cameras see, and things that do not meet."""
    lamp = standing(0.2)
    seen = silhouettes_of(MESH, RIG, lamp)
    small = {}
    for name, one in seen.items():
        phi = np.full(one.phi.shape, -0.5, np.float32)
        phi[:30] = one.phi[:30]
        small[name] = Silhouette(one.origin_px, one.step_px, phi)
    assert reacquire(small, BODY, [BEFORE], EYES) is None
    above_and_below = {"c1": (290, 0), "c3": (290, 380)}
    apart = {name: Silhouette(at, 1, np.ones((100, 60), np.float32)) for name, at in above_and_below.items()}
    assert reacquire(apart, BODY, [BEFORE], EYES) is None
    assert reacquire({"c1": Silhouette((0, 0), 1, np.ones((8, 8), np.float32))}, BODY, [BEFORE], EYES) is None


def test_after_a_wrong_posture_the_initial_one_is_tried():
    """A body may be lost in a posture that nobody ever had."""
    fallen = BEFORE.T_world_model @ rigid(rotation_about_x(np.pi / 2), np.zeros(3))
    wrong = TreePose(fallen, np.array([high for _, high in MESH.tree.limits]))
    true = standing(0.4, -0.3)
    seen = silhouettes_of(MESH, RIG, true)
    assert reacquire(seen, BODY, [wrong], EYES) is None
    found = reacquire(seen, BODY, [wrong, BEFORE], EYES)
    assert np.median(missed_m(found, true)) < 0.15
