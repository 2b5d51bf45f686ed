"""Laws of a body that is followed through time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.kinematic_bodies import DOFS, KINECT, MODEL, VARIANCES, pose, standing

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.articulated_body import (
    ArticulatedBody,
    Estimate,
    ball_rotations,
    bone_lengths,
    hinge_angles,
    joints,
)
from mocapella.kinematics.articulated_memory import SCALE
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL, ArticulatedSettings
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
MIRROR = list(KINECT.mirror)
BONES = np.array(KINECT.bones)
seeds = st.integers(0, 2**32 - 1)


def swaying(frames: int, seed: int, noise: float = 0.01) -> tuple[Float64, Float64]:
    """Times [s] and noisy joints (frames, 25, 3) of somebody who turns on the spot and loses a joint now and then."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(frames) / 30 + rng.uniform(0, 0.01, frames)
    seen = np.stack([standing(yaw=0.5 * np.sin(2 * t)) for t in at_s]) + rng.normal(0, noise, (frames, 25, 3))
    lost = rng.random((frames, 25)) < 0.1
    lost[0] = False
    seen[lost] = np.nan
    return at_s, seen


def follow(body: ArticulatedBody, at_s: Float64, seen: Float64) -> list[Estimate]:
    return [body.update(positions, VARIANCES, t) for t, positions in zip(at_s, seen, strict=True)]


def error(estimate: Estimate, truth: Float64) -> float:
    return float(np.sqrt(((estimate.positions - truth) ** 2).sum(axis=-1).mean()))


def anywhere(rng: np.random.Generator, reach: float = 20.0) -> Float64:
    return rigid(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-reach, reach, 3))


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(seeds)
def test_a_rigid_motion_of_all_that_is_seen_moves_what_is_estimated(seed: int) -> None:
    T = anywhere(np.random.default_rng(seed))
    at_s, seen = swaying(20, seed)
    here, there = ArticulatedBody(KINECT), ArticulatedBody(KINECT)
    for one, other in zip(follow(here, at_s, seen), follow(there, at_s, apply(T, seen)), strict=True):
        np.testing.assert_allclose(other.positions, apply(T, one.positions), atol=1e-6)
        np.testing.assert_allclose(other.variances, one.variances, rtol=1e-5)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_a_memory_that_is_moved_goes_on_as_if_it_had_always_been_there(seed: int) -> None:
    T = anywhere(np.random.default_rng(seed))
    at_s, seen = swaying(24, seed)
    here, moved = ArticulatedBody(KINECT), ArticulatedBody(KINECT)
    follow(here, at_s[:12], seen[:12])
    follow(moved, at_s[:12], seen[:12])
    moved.move(T)
    for one, other in zip(
        follow(here, at_s[12:], seen[12:]), follow(moved, at_s[12:], apply(T, seen[12:])), strict=True
    ):
        np.testing.assert_allclose(other.positions, apply(T, one.positions), atol=1e-6)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_bones_have_their_learnt_lengths_and_joints_are_within_their_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body, before = ArticulatedBody(KINECT, ArticulatedSettings(scale_sd=0.0)), np.empty(0)
    at_s, seen = swaying(12, seed, noise=0.08)
    hinge = (MODEL.dof_kind >= ABOUT) & (MODEL.dof_kind < OF_BALL)
    for t, positions in zip(at_s, seen, strict=True):
        estimate = body.update(positions + rng.normal(0, 0.05, 3), VARIANCES, t)
        found = body.pose
        assert found is not None
        measured = np.linalg.norm(estimate.positions[BONES[:, 0]] - estimate.positions[BONES[:, 1]], axis=1)
        # Learnt after the joints were placed, so the lengths of this instant are those before it.
        if t > at_s[0]:
            np.testing.assert_allclose(measured, before, rtol=1e-9)
        before = bone_lengths(body.model, found)[BONES[:, 1]]
        np.testing.assert_allclose(before, bone_lengths(body.model, found)[np.array(MIRROR)[BONES[:, 1]]])
        assert (found.angles[hinge] >= MODEL.dof_values[hinge, 0] - 1e-12).all()
        assert (found.angles[hinge] <= MODEL.dof_values[hinge, 1] + 1e-12).all()
        for joint, bone in body.model.body.bones.items():
            if bone.ball is not None:
                direction = found.rotations[MODEL.joint_table[joint, 3]] @ MODEL.joint_values[joint, :3]
                assert direction @ MODEL.joint_values[joint, 4:7] >= np.cos(np.radians(bone.ball.cone_deg)) - 1e-9


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_any_pose_is_found_from_its_joints(seed: int) -> None:
    truth = joints(MODEL, pose(np.random.default_rng(seed)))
    body = ArticulatedBody(KINECT)
    for k in range(30):
        estimate = body.update(truth, VARIANCES, k / 30)
    assert error(estimate, truth) < 0.02


def test_somebody_who_stands_still_becomes_steadier_than_what_is_seen() -> None:
    rng, truth, body = np.random.default_rng(1), standing(), ArticulatedBody(KINECT)
    seen = truth + rng.normal(0, 0.004, (150, 25, 3))
    found = np.stack([e.positions for e in follow(body, np.arange(150) / 30, seen)])[60:]
    assert np.sqrt(((found - truth) ** 2).sum(-1).mean()) < 0.7 * np.sqrt(((seen - truth) ** 2).sum(-1).mean())
    restless = [np.sqrt((np.diff(x, 2, axis=0) ** 2).sum(-1).mean()) for x in (found, seen[60:])]
    assert restless[0] < 0.3 * restless[1]


def test_hands_that_flicker_are_steadier_the_later_arms_follow() -> None:
    rng, at_s = np.random.default_rng(3), np.arange(150) / 30
    seen = standing() + rng.normal(0, 0.002, (150, 25, 3))
    hands = [KINECT.index(name) for name in ("HandLeft", "HandTipLeft", "HandRight", "HandTipRight")]
    seen[:, hands] += rng.normal(0, 0.03, (150, 4, 3))
    restless = []
    for surprise in (0.1, 1.0):
        body = ArticulatedBody(KINECT, ArticulatedSettings(full_surprise=0.1, arm_surprise=surprise))
        found = np.stack([e.positions for e in follow(body, at_s, seen)])[60:]
        restless.append(np.sqrt((np.diff(found[:, hands], 2, axis=0) ** 2).sum(-1).mean()))
    assert restless[1] < 0.8 * restless[0]


def test_more_noise_of_motion_is_less_late_and_less_steady() -> None:
    rng, at_s = np.random.default_rng(2), np.arange(60) / 30
    truth = np.stack([standing() + np.array((0.3 * np.sin(6 * t), 0, 0)) for t in at_s])
    noise = rng.normal(0, 0.005, truth.shape)
    late, restless = [], []
    for factor in (0.003, 1.0):
        quick = ArticulatedSettings(root_acceleration=30 * factor, stand_diffusion=np.inf, calm=1.0)
        found = follow(ArticulatedBody(KINECT, quick), at_s, truth)
        late.append(np.mean([error(e, x) for e, x in zip(found[20:], truth[20:], strict=True)]))
        still = np.stack([e.positions for e in follow(ArticulatedBody(KINECT, quick), at_s, truth[:1] + noise)])
        restless.append(np.abs(np.diff(still[20:].mean(axis=1), 2, axis=0)).mean())
    assert late[1] < late[0]
    assert restless[1] > restless[0]


def test_what_is_not_seen_follows_the_chain_and_becomes_less_sure() -> None:
    body, at_s, before = ArticulatedBody(KINECT), np.arange(60) / 30, np.empty(0)
    hidden = [KINECT.index(name) for name in ("ElbowLeft", "WristLeft", "HandLeft", "HandTipLeft", "ThumbLeft")]
    for k, t in enumerate(at_s):
        truth = standing() + np.array((0.3 * t, 0.0, 0.0))
        seen = truth.copy()
        if k >= 40:
            seen[hidden] = np.nan
        estimate = body.update(seen, VARIANCES, t)
        if k >= 40:
            assert (estimate.variances[hidden] > before[hidden]).all()
            assert error(Estimate(t, estimate.positions[hidden], VARIANCES[:1]), truth[hidden]) < 0.05
        if k == 39:
            before = estimate.variances
    assert estimate.variances[hidden].mean() > 4 * before[hidden].mean()


@pytest.mark.slow
def test_a_prediction_changes_nothing_grows_less_sure_and_ends() -> None:
    body = ArticulatedBody(KINECT)
    at_s, seen = swaying(20, 3)
    follow(body, at_s, seen)
    memory = body.memory.copy()
    ahead = [body.predict(at_s[-1] + dt) for dt in (0.0, 0.05, 0.2, 0.6)]
    np.testing.assert_array_equal(body.memory, memory)
    means = [estimate.variances.mean() for estimate in ahead]
    assert means == sorted(means)
    assert np.isnan(body.predict(at_s[-1] + 1.5).positions).all()
    nothing = np.full((25, 3), np.nan)
    np.testing.assert_allclose(
        body.update(nothing, VARIANCES, at_s[-1] + 0.2).positions, ahead[2].positions, atol=1e-12
    )


def test_a_time_before_the_last_update_counts_as_that_one_and_the_estimate_says_so() -> None:
    body = ArticulatedBody(KINECT)
    assert body.predict(1.0).at_s == 1.0
    at_s, seen = swaying(20, 3)
    newest = follow(body, at_s, seen)[-1]
    assert newest.at_s == at_s[-1]
    earlier = body.predict(at_s[-1] - 0.1)
    np.testing.assert_array_equal(earlier.positions, body.predict(at_s[-1]).positions)
    assert earlier.at_s == at_s[-1]
    assert body.update(seen[-1], VARIANCES, at_s[-1] - 0.1).at_s == at_s[-1]
    assert body.predict(at_s[-1] + 0.1).at_s == at_s[-1] + 0.1


def test_a_memory_that_was_kept_goes_on_to_the_bit() -> None:
    at_s, seen = swaying(20, 4)
    body, copy = ArticulatedBody(KINECT), ArticulatedBody(KINECT)
    follow(body, at_s[:10], seen[:10])
    copy.memory[:] = body.memory
    for one, other in zip(follow(body, at_s[10:], seen[10:]), follow(copy, at_s[10:], seen[10:]), strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
    body.reset()
    assert body.pose is None


@pytest.mark.parametrize("frames", [1, 5, 20])
def test_a_body_begun_with_left_and_right_exchanged_is_found_again(frames: int) -> None:
    body, truth = ArticulatedBody(KINECT), standing()
    for k in range(frames + 25):
        estimate = body.update(truth[MIRROR] if k < frames else truth, VARIANCES, k / 30)
    assert error(estimate, truth) < 0.03
    found = body.pose
    assert found is not None
    assert abs(hinge_angles(body.model, found)["spine rotation"]) < np.radians(20)


def test_too_few_joints_begin_nobody() -> None:
    body, truth = ArticulatedBody(KINECT), standing()
    few = np.full((25, 3), np.nan)
    torso = [KINECT.index(name) for name in ("SpineBase", "SpineMid", "ShoulderLeft", "HipRight", "Head", "WristLeft")]
    for count in range(len(torso)):
        few[torso[:count]] = truth[torso[:count]]
        assert np.isnan(body.update(few, VARIANCES, count / 30).positions).all()
        assert body.pose is None
    few[torso] = truth[torso]
    assert np.isfinite(body.update(few, VARIANCES, 1.0).positions).all()


def test_bone_lengths_are_learnt() -> None:
    rng, body = np.random.default_rng(5), ArticulatedBody(KINECT)
    truth = standing()
    elbow, wrist = KINECT.index("ElbowLeft"), KINECT.index("WristLeft")
    beyond = [wrist, *(KINECT.index(name) for name in ("HandLeft", "HandTipLeft", "ThumbLeft"))]
    longer = 0.04 * (truth[wrist] - truth[elbow]) / np.linalg.norm(truth[wrist] - truth[elbow])
    for side in (1, -1):
        truth[beyond if side > 0 else [MIRROR[j] for j in beyond]] += longer * (side, 1, 1)
    follow(body, np.arange(120) / 30, truth + rng.normal(0, 0.005, (120, 25, 3)))
    found = body.pose
    assert found is not None
    assert bone_lengths(body.model, found)[wrist] == pytest.approx(
        np.linalg.norm(truth[wrist] - truth[elbow]), abs=0.01
    )


def resized(positions: Float64, factor: Float64) -> Float64:
    """Skeletons (frames, 25, 3) that a sensor reports larger or smaller, with the feet in place, as Azure Kinect's."""
    feet = positions[:, [KINECT.index("AnkleLeft"), KINECT.index("AnkleRight")]].mean(axis=1, keepdims=True)
    return np.asarray(feet + factor[:, None, None] * (positions - feet))


def squatting(frames: int) -> tuple[Float64, Float64, Float64]:
    """Times [s], joints (frames, 25, 3), and knee flexion (frames,) [rad] of somebody who squats every two seconds."""
    at_s = np.arange(frames) / 30
    down, upright = 0.5 - 0.5 * np.cos(np.pi * at_s), standing()
    hip, knee, ankle = (upright[KINECT.index(name)] for name in ("HipLeft", "KneeLeft", "AnkleLeft"))
    thigh, shank = np.linalg.norm(hip - knee), np.linalg.norm(knee - ankle)
    bodies, flexions = [], []
    for flexion in 0.2 + 1.2 * down:
        body = upright.copy()
        # Over the ankle, the knee goes forward by as much as the hip's height then asks for.
        reach = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(flexion))
        lean = np.arccos((shank**2 + reach**2 - thigh**2) / (2 * shank * reach))
        lower = hip[1] - ankle[1] - reach
        for side in ("Left", "Right"):
            foot = body[KINECT.index(f"Ankle{side}")]
            for name, at in (("Knee", shank * np.array((0, np.cos(lean), np.sin(lean)))), ("Hip", (0, reach, 0))):
                body[KINECT.index(f"{name}{side}")] = foot + at
        above = [j for j, name in enumerate(KINECT.joints) if not name.startswith(("Hip", "Knee", "Ankle", "Foot"))]
        body[above, 1] -= lower
        bodies.append(body)
        flexions.append(flexion)
    return at_s, np.array(bodies), np.array(flexions)


def knee_error(found: list[Estimate], flexion: Float64) -> float:
    positions = np.stack([estimate.positions for estimate in found])
    hip, knee, ankle = (positions[:, KINECT.index(name)] for name in ("HipLeft", "KneeLeft", "AnkleLeft"))
    thigh, shank = knee - hip, ankle - knee
    cos = (thigh * shank).sum(-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shank, axis=-1)
    return float(np.degrees(np.sqrt(np.mean((np.arccos(np.clip(cos, -1, 1)) - flexion)[60:] ** 2))))


def test_knees_bend_as_far_as_a_sensor_says_whose_skeletons_change_their_size_with_the_posture() -> None:
    at_s, bodies, flexion = squatting(240)
    seen = resized(bodies, 1.05 - 0.15 * (flexion - flexion.min()) / np.ptp(flexion))
    errors = [
        knee_error(follow(ArticulatedBody(KINECT, ArticulatedSettings(scale_sd=sd)), at_s, seen), flexion)
        for sd in (0.05, 0.0)
    ]
    assert errors[0] < 4
    assert errors[0] < 0.6 * errors[1]


def test_bones_that_change_one_by_one_do_not_change_the_size_of_the_body() -> None:
    rng, body = np.random.default_rng(4), ArticulatedBody(KINECT, ArticulatedSettings(scale_sd=0.05))
    seen = standing() + rng.normal(0, 0.02, (90, 25, 3))
    follow(body, np.arange(90) / 30, seen)
    assert abs(body.memory[0, SCALE] - 1) < 0.03


def test_a_size_without_measurements_becomes_that_of_the_learnt_bones() -> None:
    body = ArticulatedBody(KINECT, ArticulatedSettings(scale_sd=0.05))
    truth = np.broadcast_to(standing(), (60, 25, 3))
    follow(body, np.arange(60) / 30, resized(truth, np.where(np.arange(60) < 40, 1.0, 1.08)))
    assert body.memory[0, SCALE] > 1.03
    body.update(np.full((25, 3), np.nan), VARIANCES, 59 / 30 + 0.9)
    assert body.memory[0, SCALE] < 1.04


def test_a_foot_that_stands_is_held_and_one_that_walks_is_not() -> None:
    rng, at_s = np.random.default_rng(6), np.arange(90) / 30
    ankle = KINECT.index("AnkleLeft")
    for speed, held in ((0.0, True), (1.2, False)):
        seen = np.stack([standing() + np.array((speed * t, 0, 0)) for t in at_s]) + rng.normal(0, 0.01, (90, 25, 3))
        slide = []
        for diffusion in (np.inf, 1e-4):
            found = follow(ArticulatedBody(KINECT, ArticulatedSettings(stand_diffusion=diffusion)), at_s, seen)
            track = np.stack([e.positions[ankle] for e in found])[30:]
            slide.append(np.linalg.norm(np.diff(track, axis=0), axis=1).mean())
        assert (slide[1] < 0.7 * slide[0]) == held
        assert not held or slide[1] > 0
        if not held:
            assert slide[1] == pytest.approx(slide[0], rel=0.1)


def test_angles_have_names_and_a_topology_without_a_model_is_refused() -> None:
    with pytest.raises(SettingsError, match="topology 'kinect_v1' has no body model; there are halpe_26, kinect_v2"):
        ArticulatedBody(topology("kinect_v1"))
    assert ArticulatedBody(KINECT).pose is None
    own = ArticulatedBody(KINECT)
    own.update(standing(), VARIANCES, 0.0)
    found = own.pose
    assert found is not None
    np.testing.assert_allclose(joints(own.model, found), own.predict(0.0).positions, atol=1e-12)
    assert (
        hinge_angles(own.model, found)["left elbow flexion"] < 0 < hinge_angles(own.model, found)["right elbow flexion"]
    )
    assert set(ball_rotations(own.model, found)) == {"root", "left shoulder", "right shoulder", "left hip", "right hip"}
    assert len(hinge_angles(own.model, found)) == DOFS - 6 - 3 * 4


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("root_acceleration", 0.0), ("root_turn", -1.0), ("trunk_turn", 0.0), ("arm_turn", np.inf), ("leg_turn", 0.0),
        ("hand_turn", 0.0), ("arm_surprise", 0.0),
        ("velocity_memory_s", 0.0), ("surprise_s", 0.0), ("length_memory_s", 0.0), ("full_surprise", 0.0),
        ("calm", 2.0), ("rest_sd", 0.0), ("degrees_of_freedom", 0.0), ("stand_diffusion", 0.0), ("stand_speed", 0.0),
        ("least_joints", 3), ("lost_m", 0.0), ("lost_s", -1.0), ("forget_after_s", -1.0),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match=field):
        ArticulatedSettings(**{field: value})  # type: ignore[arg-type]
