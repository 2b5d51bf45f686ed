"""Scores of legs that images hardly show."""

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.silhouette_seated import (
    FAR_M,
    HIDDEN,
    RIGHT_M,
    SEATED_SCENES,
    SeatedRun,
    doubt_score,
    follow_seated,
    misplaced,
    turned_rig,
    visible_share,
)
from mocapella.sources.simulate.later_things import SURROUNDINGS
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

MARKS = ("left knee", "right knee", "left ankle")


def run(errors_m, supported, visible=1.0):
    errors = np.array(errors_m)
    return SeatedRun(MARKS, errors, np.array(supported), np.broadcast_to(visible, errors.shape), 0.9, 0)


def test_a_score_is_of_the_joints_of_its_kind_alone():
    one = run([[0.01, 0.03, 0.5], [0.02, 0.04, 0.6]], [[True, True, False]] * 2)
    knee, ankle = one.score("knee"), one.score("ankle")
    assert (knee.median_mm, knee.worst_mm, knee.doubted, knee.unsaid) == pytest.approx((25.0, 40.0, 0.0, 0.0))
    assert (ankle.median_mm, ankle.worst_mm, ankle.doubted, ankle.unsaid) == pytest.approx((550.0, 600.0, 1.0, 0.0))


def test_large_errors_are_unsaid_unless_they_are_doubted():
    far = 2 * FAR_M
    one = run([[far, far, 0.0]] * 4, [[True, False, True]] * 4)
    assert one.score("knee").unsaid == 0.5
    assert run([[far, 0.9 * FAR_M, 0.0]], [[False, True, True]]).score("knee").unsaid == 0.0


def test_joints_that_no_image_shows_must_be_doubted():
    knees = run([[0.0] * 3] * 2, [[False, True, True], [True, False, True]], [[0.0, 0.0, 0.0], [0.5, 0.5, 0.0]])
    found = knees.score("knee")
    assert (found.hidden, found.hidden_unsaid, found.shown_doubted) == (0.5, 0.5, 0.5)
    assert knees.score("ankle").hidden_unsaid == 1.0
    shown = run([[0.0] * 3], [[True] * 3]).score("knee")
    assert (shown.hidden, shown.hidden_unsaid, shown.shown_doubted) == (0.0, 0.0, 0.0)


def test_doubt_is_scored_of_far_joints_and_of_right_ones_that_an_image_shows():
    far, right = 2 * FAR_M, 0.5 * RIGHT_M
    one = run([[far, far, 0.0], [right, right, 0.0]], [[True, False, True], [False, True, True]])
    other = run([[far, right, 0.0]], [[False, False, True]], [[1.0, 0.0, 1.0]])
    found = doubt_score([one, other], "knee")
    assert (found.far, found.right) == (3, 2)
    assert (found.far_doubted, found.right_doubted) == pytest.approx((2 / 3, 1 / 2))
    assert np.isnan(doubt_score([one], "ankle").far_doubted)
    with pytest.raises(SettingsError, match="joint"):
        doubt_score([one], "kne")


def test_misplaced_limbs_keep_the_trunk_and_the_limits():
    scene = silhouette_scene("sits", seed=3, size_px=(64, 48), fps=10, seconds=0.3)
    mesh, pose = scene.mesh, scene.pose(0)
    found = [misplaced(mesh, pose, 0.3, seed) for seed in range(4)]
    trunk = [name.startswith("waist") for name in mesh.joint_names]
    for one in found:
        assert np.array_equal(one.T_world_model, pose.T_world_model)
        assert np.array_equal(one.angles[trunk], pose.angles[trunk])
        assert (one.angles >= mesh.tree.limits[:, 0]).all()
        assert (one.angles <= mesh.tree.limits[:, 1]).all()
    assert max(np.abs(one.angles - pose.angles).max() for one in found) > 0.3
    assert np.array_equal(misplaced(mesh, pose, 0.0, 3).angles, np.clip(pose.angles, *mesh.tree.limits.T))


def test_what_a_screen_hides_is_not_visible():
    scenes = {
        name: silhouette_scene("sits", seed=110, size_px=(322, 243), seconds=0.1, surroundings=name)
        for name in ("chair", "screen", "table")
    }
    shown = {name: dict(zip(one.mesh.landmarks, visible_share(one, 0), strict=True)) for name, one in scenes.items()}
    for side in ("left", "right"):
        assert shown["screen"][f"{side} ankle"] < HIDDEN < 0.1 < shown["screen"][f"{side} knee"]
        assert shown["table"][f"{side} ankle"] < HIDDEN
        assert 0.3 < shown["chair"][f"{side} ankle"] <= 1.0
    assert all(one["nose"] == 1.0 for one in shown.values()), "which is on no limb"


def test_joints_and_scenes_that_do_not_exist_are_refused():
    with pytest.raises(SettingsError, match="joint"):
        run([[0.0, 0.0, 0.0]], [[True] * 3]).score("kne")
    with pytest.raises(SettingsError, match=r"'tabel'.*table"):
        follow_seated("tabel", 0)


def test_cameras_of_a_turned_rig_stay_where_they_are_and_look_elsewhere():
    rig = silhouette_scene("sits", seed=3, size_px=(64, 48), fps=10, seconds=0.3).rig
    turned = turned_rig(rig, 0.01, seed=3)
    for name, was in rig.cameras.items():
        before, after = (np.linalg.inv(one.T_camera_world) for one in (was, turned.cameras[name]))
        assert np.allclose(before[:3, 3], after[:3, 3])
        assert 0 < np.linalg.norm(before[:3, :3] - after[:3, :3]) < 0.1
        assert np.allclose(turned_rig(rig, 0.0, seed=3).cameras[name].T_camera_world, was.T_camera_world)


def test_all_surroundings_are_scored():
    assert {one.surroundings for one in SEATED_SCENES.values()} == set(SURROUNDINGS)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["table", "dark", "interlaced"])
def test_legs_stay_within_the_bounds_and_hidden_ones_are_doubted(name):
    found = follow_seated(name, 5, 0.4, size_px=(322, 243), fps=25)
    assert found.score("knee").worst_mm < 100
    assert found.score("ankle").worst_mm < 150
    assert found.score("ankle").doubted > 0.8 or name != "table"
    assert found.left_out == 0
