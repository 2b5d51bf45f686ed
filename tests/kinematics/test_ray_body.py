"""Laws of a body that cameras see along rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.ray_bodies import HALPE, JOINTS, MODEL, around, errors, follow, moving, nees, offsets, rays_to

from mocapella.errors import SettingsError
from mocapella.geometry.plucker import line, nearest_point
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.articulated_body import bone_lengths
from mocapella.kinematics.articulated_model import memory_size
from mocapella.kinematics.ray_body import RayBody, move_bodies

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
MIRROR = np.array(HALPE.mirror)
seeds = st.integers(0, 2**32 - 1)


def path(seed: int, frames: int, hz: float = 30.0, speed: float = 1.0, stature: float = 1.75) -> Float64:
    return np.stack([moving(k / hz, seed, speed, stature) for k in range(frames)])


def all_of(seen: Int64) -> Bool:
    return np.ones(len(seen), bool)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_exact_rays_of_a_pose_recover_it(seed: int) -> None:
    truth = np.repeat(moving(0.0, seed)[None], 20, axis=0)
    found = follow(truth, around(4), 0.0, seed)
    assert errors(found, truth)[-1].max() < 0.003
    assert (found[-1].support == 4).all()
    assert (found[-1].weights > 0.9).all()


@settings(max_examples=3, deadline=None)
@given(seeds, st.sampled_from([0.9, 1.4, 2.1]))
def test_children_and_tall_people_are_found_at_once_and_their_bones_learnt(seed: int, stature: float) -> None:
    body, truth = RayBody(), path(seed, 60, stature=stature)
    found = follow(truth, around(4), 0.001, seed, body=body)
    assert np.median(errors(found, truth)[0]) < 0.03
    assert body.pose is not None
    thigh = HALPE.index("LKnee")
    true = np.linalg.norm(truth[0, thigh] - truth[0, HALPE.index("LHip")])
    assert bone_lengths(body.model, body.pose)[thigh] == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("begun", [1.25, 2.4])
def test_a_body_begun_with_a_wrong_size_gets_the_right_one_within_a_second(begun: float) -> None:
    body, hip = RayBody(), HALPE.index("Hip")
    truth = path(4, 45)
    wrong = truth[:4, hip, None] + begun / 1.75 * (truth[:4] - truth[:4, hip, None])
    found = follow(np.concatenate([wrong, truth[4:]]), around(4), 0.003, 4, body=body)
    assert body.pose is not None
    thigh = HALPE.index("LKnee")
    true = np.linalg.norm(truth[0, thigh] - truth[0, HALPE.index("LHip")])
    assert bone_lengths(body.model, body.pose)[thigh] == pytest.approx(true, rel=0.2)
    assert errors(found, truth)[-5:].mean() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "most_m"), [(2, 0.018), (4, 0.0135), (8, 0.011)])
def test_covariances_are_those_of_the_errors(cameras: int, most_m: float) -> None:
    consistent, off = [], []
    for seed in range(3):
        truth = path(seed, 90) + offsets(90, np.random.default_rng(seed))
        found = follow(truth, around(cameras), 0.004, seed)
        consistent.append(nees(found, truth)[30:].mean())
        off.append(errors(found, truth)[30:].mean())
    assert 0.7 < np.mean(consistent) < 1.3
    assert np.mean(off) < most_m


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(seeds)
def test_a_wrong_ray_among_four_moves_a_joint_by_less_than_its_deviation(seed: int) -> None:
    truth, wrist = path(seed, 30), HALPE.index("LWrist")

    def wrong(k: int, seen: Int64, directions: Float64, cameras: Int64) -> tuple[Int64, Float64, Bool]:
        bent = directions.copy()
        if k == 29:
            bent[(cameras == 1) & (seen == wrist)] += 0.1
        return seen, bent, all_of(seen)

    right, bad = (follow(truth, around(4), 0.003, seed, change=change) for change in (None, wrong))
    moved = np.linalg.norm(bad[-1].positions - right[-1].positions, axis=-1)
    assert (moved < np.sqrt(np.trace(right[-1].covariances, axis1=1, axis2=2))).all()
    assert bad[-1].weights[JOINTS + wrist] < 0.05
    assert bad[-1].support[wrist] == 3


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(seeds)
def test_a_rigid_motion_of_world_and_cameras_moves_the_estimate(seed: int) -> None:
    T = rigid(Rotation.random(random_state=seed % 2**31).as_matrix(), np.random.default_rng(seed).uniform(-5, 5, 3))
    truth, centres = path(seed, 12), around(3)
    here, there, moved = RayBody(), RayBody(), RayBody()
    for k, x in enumerate(truth):
        seen, origins, d, _ = rays_to(x, centres, 0.003, np.random.default_rng(k))
        one = here.update(k / 30, seen, origins, d, 0.003)
        other = there.update(k / 30, seen, apply(T, origins), d @ T[:3, :3].T, 0.003)
        np.testing.assert_allclose(other.positions, apply(T, one.positions), atol=1e-6)
        np.testing.assert_allclose(other.covariances, T[:3, :3] @ one.covariances @ T[:3, :3].T, atol=1e-8)
        if k < 6:
            moved.memory[:] = here.memory
        elif k == 6:
            moved.move(T)
        if k >= 6:
            again = moved.update(k / 30, seen, apply(T, origins), d @ T[:3, :3].T, 0.003)
            np.testing.assert_allclose(again.positions, apply(T, one.positions), atol=1e-6)


def test_nobody_is_moved_nowhere() -> None:
    memory = np.full((2, memory_size(MODEL)), np.nan)
    move_bodies(MODEL, memory, np.eye(4))
    assert np.isnan(memory).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_camera_keeps_the_pose_for_a_second_and_says_that_it_is_less_sure_along_its_rays(seed: int) -> None:
    truth, centres = path(seed, 90, speed=0.3), around(4)

    def one(k: int, seen: Int64, directions: Float64, cameras: Int64) -> tuple[Int64, Float64, Bool]:
        return seen, directions, (cameras == 0) | (k < 60)

    found = follow(truth, centres, 0.003, seed, change=one)
    off = np.stack([estimate.positions for estimate in found]) - truth
    d = (truth - centres[0]) / np.linalg.norm(truth - centres[0], axis=-1, keepdims=True)
    along = np.abs((off * d).sum(-1))
    across = np.linalg.norm(off - (off * d).sum(-1)[..., None] * d, axis=-1)
    assert across[60:].mean() < 0.02
    assert along[60:].mean() < 0.1
    covariance = found[-1].covariances
    sd_along = np.sqrt(np.einsum("ji,jik,jk->j", d[-1], covariance, d[-1]))
    assert (sd_along > 3 * np.sqrt(np.trace(found[59].covariances, axis1=1, axis2=2) / 3)).all()
    assert (sd_along > 2 * np.sqrt((np.trace(covariance, axis1=1, axis2=2) - sd_along**2) / 2)).all()
    assert nees(found, truth)[60:].mean() < 2


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "most_m"), [(2, 0.05), (3, 0.03), (4, 0.02)])
def test_left_and_right_exchanged_in_one_image_are_exchanged_back(cameras: int, most_m: float) -> None:
    def exchanged(k: int, seen: Int64, directions: Float64, camera: Int64) -> tuple[Int64, Float64, Bool]:
        return np.where((camera == 1) & (k >= 30) & (k < 60), MIRROR[seen], seen), directions, all_of(seen)

    truth = path(1, 75)
    found = follow(truth, around(cameras), 0.003, 1, change=exchanged)
    assert errors(found, truth)[30:60].mean() < most_m
    assert errors(found, truth)[65:].mean() < 0.02
    assert np.mean([estimate.weights.mean() for estimate in found[30:60]]) > 0.8


def test_a_body_begun_with_left_and_right_exchanged_in_all_images_is_found_again() -> None:
    def exchanged(k: int, seen: Int64, directions: Float64, _: Int64) -> tuple[Int64, Float64, Bool]:
        return MIRROR[seen] if k < 5 else seen, directions, all_of(seen)

    truth = path(2, 40)
    found = follow(truth, around(3), 0.002, 2, change=exchanged)
    assert errors(found, truth)[-5:].mean() < 0.02


@pytest.mark.slow
def test_another_person_in_one_view_is_thrown_out_by_two_others() -> None:
    truth, centres = path(3, 75), around(3)
    beside = np.array([0.6, 0.0, 0.3])

    def other(k: int, seen: Int64, directions: Float64, camera: Int64) -> tuple[Int64, Float64, Bool]:
        bent, wrong = directions.copy(), (camera == 1) & (k >= 30) & (k < 60)
        at = truth[k][seen] + beside - centres[camera]
        bent[wrong] = (at / np.linalg.norm(at, axis=-1, keepdims=True))[wrong]
        return seen, bent, all_of(seen)

    found = follow(truth, centres, 0.003, 3, change=other)
    assert errors(found, truth)[30:60].mean() < 0.025
    assert np.mean([estimate.weights[JOINTS : 2 * JOINTS].mean() for estimate in found[30:60]]) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "most_m"), [(2, 0.04), (4, 0.02)])
def test_wrong_and_missing_keypoints_hardly_matter(cameras: int, most_m: float) -> None:
    rng = np.random.default_rng(4)

    def careless(_: int, seen: Int64, directions: Float64, __: Int64) -> tuple[Int64, Float64, Bool]:
        bent, wrong = directions.copy(), rng.random(len(seen)) < 0.15
        bent[wrong] += rng.normal(0, 0.3, (wrong.sum(), 3))
        return seen, bent, rng.random(len(seen)) > 0.2

    truth = path(4, 90)
    found = follow(truth, around(cameras), 0.003, 4, change=careless)
    assert errors(found, truth)[30:].mean() < most_m


def test_the_rays_of_each_camera_count_at_their_own_time() -> None:
    truth, centres, late = path(5, 60, speed=2.0), around(4), np.array([0.0, 0.005, 0.01, 0.016])
    body, naive, off = RayBody(), RayBody(), []
    for k, x in enumerate(truth):
        rows = [
            rays_to(moving(k / 30 + late[c], 5, 2.0), centres[c : c + 1], 0.0, np.random.default_rng(0))
            for c in range(4)
        ]
        seen, origins, directions = (np.concatenate([row[i] for row in rows]) for i in range(3))
        estimates = [
            one.update(k / 30, seen, origins, directions, 0.003, after_s=after)
            for one, after in ((body, np.repeat(late, JOINTS)), (naive, 0.0))
        ]
        off.append([np.linalg.norm(estimate.positions - x, axis=-1).mean() for estimate in estimates])
    timed, untimed = np.mean(off[20:], axis=0)
    assert timed < 0.008
    assert timed < 0.6 * untimed


def test_joints_of_coco_alone_give_neck_and_hip_and_uncertain_feet() -> None:
    def coco(_: int, seen: Int64, directions: Float64, __: Int64) -> tuple[Int64, Float64, Bool]:
        return seen, directions, seen < 17

    truth = path(6, 60)
    found = follow(truth, around(4), 0.002, 6, change=coco)
    off, last = errors(found, truth)[20:].mean(axis=0), found[-1]
    assert off[:17].max() < 0.02
    assert off[[HALPE.index("Neck"), HALPE.index("Hip")]].max() < 0.05
    sds = np.sqrt(np.trace(last.covariances, axis1=1, axis2=2) / 3)
    assert sds[HALPE.index("LBigToe")] > 5 * sds[HALPE.index("LAnkle")]
    assert (last.support[17:] == 0).all()


def test_somebody_behind_a_table_has_sensible_legs() -> None:
    def above(_: int, seen: Int64, directions: Float64, __: Int64) -> tuple[Int64, Float64, Bool]:
        return seen, directions, seen < 11

    body, truth = RayBody(), path(7, 45, stature=1.5)
    found = follow(truth, around(3), 0.002, 7, change=above, body=body)
    assert errors(found, truth)[20:, :11].mean() < 0.02
    assert body.pose is not None
    size = bone_lengths(body.model, body.pose) / np.where(
        MODEL.joint_values[:, 3] > 0, MODEL.joint_values[:, 3], np.nan
    )
    legs = [HALPE.index(name) for name in ("LKnee", "LAnkle", "LBigToe")]
    np.testing.assert_allclose(size[legs], 1.5, rtol=0.1)


def test_somebody_who_stands_still_becomes_steadier_than_the_rays() -> None:
    truth = np.repeat(moving(0.0, 8)[None], 90, axis=0)
    found = np.stack([one.positions for one in follow(truth, around(4), 0.003, 8)])[45:]
    rng, points = np.random.default_rng(8), []
    for x in truth[45:]:
        _, origins, directions, _ = rays_to(x, around(4), 0.003, rng)
        points.append(nearest_point(line(origins, directions).reshape(4, JOINTS, 6).swapaxes(0, 1)))
    restless, raw = (np.sqrt((np.diff(x, 2, axis=0) ** 2).sum(-1).mean()) for x in (found, np.array(points)))
    assert restless < 0.3 * raw


def test_equal_rays_give_equal_bits_in_any_process_and_from_a_kept_memory() -> None:
    truth = path(9, 20)
    one, other = RayBody(), RayBody()
    first, second = (follow(truth, around(3), 0.003, 9, body=body) for body in (one, other))
    np.testing.assert_array_equal(one.memory, other.memory)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        np.testing.assert_array_equal(a.covariances, b.covariances)
    kept = RayBody()
    kept.memory[:] = one.memory
    rays = rays_to(truth[-1], around(3), 0.003, np.random.default_rng(1))[:3]
    np.testing.assert_array_equal(kept.update(1.0, *rays, 0.003).positions, one.update(1.0, *rays, 0.003).positions)


def test_a_prediction_changes_nothing_grows_less_sure_and_ends() -> None:
    body = RayBody()
    assert not body.predict(0.0).known
    follow(path(10, 15), around(3), 0.003, 10, body=body)
    memory = body.memory.copy()
    ahead = [body.predict(14 / 30 + dt) for dt in (0.0, 0.05, 0.2, 0.6)]
    np.testing.assert_array_equal(body.memory, memory)
    sds = [np.trace(one.covariances, axis1=1, axis2=2).mean() for one in ahead]
    assert sds == sorted(sds)
    assert not body.predict(14 / 30 + 1.5).known
    nothing = body.update(14 / 30 + 0.2, [], np.empty((0, 3)), np.empty((0, 3)), 0.003)
    np.testing.assert_allclose(nothing.positions, ahead[2].positions, atol=1e-9)
    assert (nothing.support == 0).all()


def test_rays_that_cannot_be_used_are_left_out() -> None:
    truth, centres = path(11, 10), around(3)
    clean, soiled = RayBody(), RayBody()
    for k, x in enumerate(truth):
        seen, origins, directions, _ = rays_to(x, centres, 0.003, np.random.default_rng(k))
        one = clean.update(k / 30, seen, origins, directions, 0.003)
        more = np.concatenate([seen, [-1, JOINTS, 0, 1, 2]])
        o, d = np.vstack([origins, origins[:5]]), np.vstack([directions, directions[:5]])
        d[-3], sds = np.nan, np.full(len(more), 0.003)
        sds[-2:] = 0.0, np.nan
        other = soiled.update(k / 30, more, o, d, sds)
        np.testing.assert_array_equal(other.positions, one.positions)
        assert (other.weights[-5:] == 0.0).all()


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seeds)
def test_rays_of_any_numbers_break_nothing_for_long(seed: int) -> None:
    rng, body, truth = np.random.default_rng(seed), RayBody(), path(seed, 45)
    for k, x in enumerate(truth):
        seen, origins, directions, _ = rays_to(x, around(3), 0.003, rng)
        sds = np.full(len(seen), 0.003)
        if 8 <= k < 16:
            kind = rng.integers(5)
            if kind == 0:
                directions = rng.normal(size=directions.shape)
            elif kind == 1:
                sds = 10 ** rng.uniform(-14, 6, len(seen))
            elif kind == 2:
                origins = origins + rng.normal(0, 10 ** rng.uniform(0, 7), origins.shape)
            elif kind == 3:
                seen = rng.integers(-3, 30, len(seen))
            else:
                directions = directions * np.where(rng.random((len(seen), 1)) < 0.3, -1, 1)
        estimate = body.update(k / 30, seen, origins, directions, sds)
        if estimate.known:
            assert np.isfinite(estimate.positions).all()
            assert np.isfinite(estimate.covariances).all()
            assert np.linalg.eigvalsh(estimate.covariances).min() > -1e-9
    assert np.median(np.linalg.norm(estimate.positions - truth[-1], axis=1)) < 0.03


def test_one_camera_alone_begins_nobody_nor_do_cameras_in_one_place() -> None:
    truth, one = path(12, 3), around(3)[:1]
    for centres in (one, np.vstack([one, one + 1e-3])):
        body = RayBody()
        found = follow(truth, centres, 0.002, 12, body=body)
        assert not any(estimate.known for estimate in found)
        assert body.pose is None


@pytest.mark.slow
@pytest.mark.parametrize("apart", [1, 2])
def test_crossing_rays_of_two_cameras_in_turn_triangulate(apart: int) -> None:
    """Two cameras in turn know the body better than one; opposite ones see along the same line, and do not."""
    truth, centres = path(4, 90, speed=0.3), around(4)

    def in_turn(k: int, seen: Int64, directions: Float64, cameras: Int64) -> tuple[Int64, Float64, Bool]:
        return seen, directions, (cameras == apart * (k % 2)) | (k < 30)

    def one(k: int, seen: Int64, directions: Float64, cameras: Int64) -> tuple[Int64, Float64, Bool]:
        return seen, directions, (cameras == 0) | (k < 30)

    turns, alone = (follow(truth, centres, 0.003, 4, change=change)[-1] for change in (in_turn, one))
    ratio = np.trace(turns.covariances, axis1=1, axis2=2).mean() / np.trace(alone.covariances, axis1=1, axis2=2).mean()
    assert (ratio < 0.3) == (apart == 1)


def test_shapes_that_do_not_fit_are_refused() -> None:
    body = RayBody()
    with pytest.raises(SettingsError, match=r"origins.*\(2, 3\)"):
        body.update(0.0, [1, 2], np.zeros((1, 3)), np.zeros((2, 3)), 0.01)
    with pytest.raises(SettingsError, match=r"after_s.*\(2,\)"):
        body.update(0.0, [1, 2], np.zeros((2, 3)), np.ones((2, 3)), 0.01, after_s=[0.0])
