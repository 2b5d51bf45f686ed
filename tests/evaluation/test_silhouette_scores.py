"""Scores of bodies fitted to silhouettes: laws of the figures, and planted faults that are found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import EvaluationError, SettingsError
from mocapella.evaluation.silhouettes import (
    HINGES,
    JOINT_OF,
    Movement,
    joint_errors_deg,
    lag_frames,
    legs_swapped,
    outcome,
    peak_kept,
    rms_acceleration,
    score,
    through_itself_mm,
)
from mocapella.geometry.rigid import rotation_about_y
from mocapella.geometry.twists import exp_twist
from mocapella.model.body_meshes import body_mesh
from mocapella.model.twist_tree import TreePose

MESH = body_mesh("female", detail=0.8)
SUPPLE = body_mesh("male", 1.9, detail=0.8, supple=True)
FRAMES = 40
NAMES = MESH.joint_names
angles = st.floats(-60, 60).filter(lambda a: abs(a) > 1e-3)


def movement(mesh: Any = MESH, fps: float = 60.0, frames: int = FRAMES, **degrees: Any) -> Movement:
    """Standing, but for named angles (with _ for spaces), each a number or (frames,)."""
    poses = TreePose(np.tile(np.eye(4), (frames, 1, 1)), np.zeros((frames, len(mesh.joint_names))))
    for name, value in degrees.items():
        poses.angles[:, mesh.joint_names.index(name.replace("_", " "))] = np.radians(value)
    return Movement(mesh, poses, fps)


def shaken(seed: int, size: float = 0.3) -> Movement:
    rng = np.random.default_rng(seed)
    T = exp_twist(rng.normal(0, size, (FRAMES, 6)))
    return Movement(MESH, TreePose(T, rng.normal(0, size, (FRAMES, len(NAMES)))), 60.0)


WAVE = 45 + 40 * np.sin(2 * np.pi * np.arange(FRAMES) / 25)


def test_the_truth_itself_has_no_error() -> None:
    true = shaken(1)
    s, o = score(true, true), outcome(true, true)
    assert (s.angle_deg, s.angle_sd_deg, s.hinge_deg, s.hinge_sd_deg) == pytest.approx((0, 0, 0, 0), abs=1e-5)
    assert (s.near, s.median_mm, s.p95_mm, s.jitter, s.feet_jitter) == (1, 0, 0, 0, 0)
    assert s.acceleration == s.true_acceleration > 0
    assert s.feet == s.true_feet > 0
    assert (o.swapped, o.through_mm, o.problem) == (0, 0, "")


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_errors_are_the_same_both_ways(one: int, other: int) -> None:
    a, b = shaken(one), shaken(other)
    there, back = joint_errors_deg(a, b), joint_errors_deg(b, a)
    for joint, error in there.items():
        np.testing.assert_allclose(error, back[joint], atol=1e-6)
    assert set(there) == set(JOINT_OF.values())


@given(st.sampled_from(NAMES), angles)
def test_one_turn_gives_its_angle_in_its_joint_alone(name: str, degrees: float) -> None:
    errors = joint_errors_deg(movement(**{name: degrees}), movement())
    (own,) = (joint for joint in errors if name.startswith(joint))
    np.testing.assert_allclose(errors[own], abs(degrees), atol=1e-6)
    assert all(error.max() < 1e-5 for joint, error in errors.items() if joint != own)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-40, 40))
def test_a_joint_error_is_that_of_the_rotation_not_of_its_three_turns(swing: float, lift: float, turn: float) -> None:
    # Past the pole the same arm has other numbers: 180° more, 180° less, and mirrored about the pole of the raise.
    first = NAMES.index("left shoulder swing forwards")
    axes = MESH.tree.twists[first : first + 3, 3:]
    pole = np.degrees(np.arctan2(axes[0] @ np.cross(axes[1], axes[2]), axes[0] @ axes[2]))
    names = [f"left_shoulder_{word}" for word in ("swing_forwards", "raise_sidewards", "turn_outwards")]
    assert abs(axes[0] @ axes[1]) < 1e-9
    assert abs(axes[1] @ axes[2]) < 1e-9
    one = movement(**dict(zip(names, (swing, lift, turn), strict=True)))
    mirrored = 180 - 2 * pole - lift if abs(axes[0] @ axes[2]) > 1e-9 else 180 - lift
    other = movement(**dict(zip(names, (swing + 180, mirrored, turn + 180), strict=True)))
    apart = np.abs(np.degrees(one.poses.angles - other.poses.angles)).max()
    assert apart > 100
    np.testing.assert_allclose(joint_errors_deg(one, other)["left shoulder"], 0, atol=1e-4)


def test_how_a_body_stands_in_the_world_is_no_joint_error() -> None:
    true = shaken(3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_about_y(1.1), (3, 0, 1)
    moved = Movement(MESH, TreePose(T @ true.poses.T_world_model, true.poses.angles), 60.0)
    s = score(moved, true)
    assert s.angle_deg < 1e-5
    assert s.median_mm > 1000


def test_bodies_of_other_sizes_and_joints_are_compared_by_what_both_have() -> None:
    found, true = movement(SUPPLE, neck_nod=30, waist_turn_to_the_left=20), movement()
    errors = joint_errors_deg(found, true)
    assert "neck" not in errors
    np.testing.assert_allclose(errors["waist"], 20, atol=1e-6)
    s = score(found, true)
    assert s.hinge_deg < 1e-6
    assert s.angle_deg == pytest.approx(20 / 11)
    assert s.joints_deg["waist"] == pytest.approx(20)


def test_mean_and_spread_of_an_error_that_alternates() -> None:
    sign = np.where(np.arange(FRAMES) % 2, 1.0, -1.0)
    off = {f"{name.replace(' ', '_')}_flexion": 50 + 4 * sign for name in HINGES}
    right = {f"{name.replace(' ', '_')}_flexion": 50.0 for name in HINGES}
    s = score(movement(**off), movement(**right))
    assert s.hinge_deg == pytest.approx(4)
    assert s.hinge_sd_deg == pytest.approx(4)
    assert s.near == 1
    assert score(movement(**off), movement(**{k: v + 3 for k, v in right.items()})).near == pytest.approx(1 - 2 / 11)


@given(st.floats(1, 200), st.floats(-10, 10))
def test_acceleration_is_that_of_a_fall(fps: float, g: float) -> None:
    at = np.arange(20)[:, None, None] / fps
    places = 0.5 * g * at**2 * np.array([0.0, 1.0, 0.0]) + at * np.array([3.0, 0.0, 1.0])
    assert rms_acceleration(np.repeat(places, 3, axis=1), fps) == pytest.approx(abs(g), rel=1e-5, abs=1e-5)


@given(st.integers(-6, 6))
def test_a_shifted_curve_has_its_lag(frames: int) -> None:
    at = np.arange(120)
    assert lag_frames(np.sin((at - frames) / 9), np.sin(at / 9)) == pytest.approx(frames, abs=0.01)


@pytest.mark.parametrize("frames", [-5, 5, 7])
def test_the_longest_lag_that_is_tried_is_told_for_it_and_for_longer_ones(frames: int) -> None:
    at = np.arange(120)
    assert lag_frames(np.sin((at - frames) / 40), np.sin(at / 40), longest=5) == np.clip(frames, -5, 5)


def test_three_frames_are_enough_for_a_lag() -> None:
    assert lag_frames(np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0])) == pytest.approx(0)


def test_a_lag_is_found_between_frames() -> None:
    at = np.arange(120)
    assert lag_frames(np.sin((at - 0.4) / 9), np.sin(at / 9)) == pytest.approx(0.4, abs=0.02)


def test_what_does_not_move_has_no_lag() -> None:
    with pytest.raises(EvaluationError, match="no lag"):
        lag_frames(np.ones(30), np.ones(30))
    with pytest.raises(EvaluationError, match="curve of 2 frames"):
        lag_frames(np.arange(2.0), np.arange(2.0))


@given(st.floats(0.1, 2), st.floats(-30, 30))
def test_a_curve_pressed_together_keeps_so_much_of_its_peak(share: float, least: float) -> None:
    true = least + 50 * np.sin(np.arange(60) / 20) ** 2
    assert peak_kept(least + share * (true - least), true) == pytest.approx(share, abs=0.002)


def swapped_legs(true: Movement) -> Movement:
    """The same, each leg where the other one belongs."""
    mirrored = [NAMES.index(_other(name)) for name in NAMES]
    # Seen in a mirror and turned by half a turn: left and right have changed places, forwards is backwards.
    T = true.poses.T_world_model.copy()
    T[:, :3, :3] = rotation_about_y(np.pi)
    return Movement(MESH, TreePose(T, true.poses.angles[:, mirrored]), true.fps)


def _other(name: str) -> str:
    side = {"left": "right", "right": "left"}
    first, _, rest = name.partition(" ")
    return f"{side[first]} {rest}" if first in side else name


def test_planted_swapped_legs_are_found() -> None:
    true = movement(left_hip_abduction=10, right_hip_abduction=10)
    swapped = swapped_legs(true)
    assert legs_swapped(swapped, true).all()
    assert not legs_swapped(true, true).any()
    found = outcome(swapped, true)
    assert found.swapped == FRAMES
    assert "where the other one belongs" in found.problem


def test_one_leg_on_the_other_is_swapped_and_legs_together_are_not() -> None:
    true = movement(left_hip_abduction=20, right_hip_abduction=20)
    both_left = movement(left_hip_abduction=20, right_hip_abduction=-30)
    assert legs_swapped(both_left, true).all()
    together = movement(left_hip_abduction=-6, right_hip_abduction=-6)
    apart = [together.landmarks[f"left {name}"] - together.landmarks[f"right {name}"] for name in ("knee", "ankle")]
    assert np.linalg.norm(apart, axis=-1).max() < 0.1  # else the next line shows nothing
    assert not legs_swapped(swapped_legs(together), together).any()


def test_a_swap_of_two_frames_does_not_fail_a_run() -> None:
    true, k = movement(left_hip_abduction=10, right_hip_abduction=10), np.arange(FRAMES)
    for frames, fails in ((2, False), (3, True)):
        T = np.where((k < frames)[:, None, None], swapped_legs(true).poses.T_world_model, true.poses.T_world_model)
        found = outcome(Movement(MESH, TreePose(T, true.poses.angles), 60.0), true)
        assert found.swapped == frames
        assert bool(found.problem) is fails


def test_a_planted_hand_in_the_trunk_is_found() -> None:
    # An arm lowered by 45° and more goes into the thigh, or the trunk: the truth's does not.
    true = movement()
    through = movement(left_shoulder_raise_sidewards=-62)
    assert through_itself_mm(through, true).min() > 30
    assert through_itself_mm(true, true).max() == 0
    assert "deeper in each other" in outcome(through, true).problem
    # What the truth does, too, is no fault.
    assert through_itself_mm(through, through).max() == 0


def test_a_leg_in_the_other_is_found() -> None:
    crossed = movement(left_hip_abduction=-12, right_hip_abduction=-12)
    assert through_itself_mm(crossed, movement()).min() > 20


def test_a_run_fails_by_its_angles_in_the_mean_or_at_the_end() -> None:
    k, true = np.arange(FRAMES), movement(left_hip_abduction=10, right_hip_abduction=10)

    def off(degrees: Any) -> str:
        names = ("left_elbow_flexion", "right_elbow_flexion")
        spread = dict.fromkeys(names, degrees)
        return outcome(movement(left_hip_abduction=10, right_hip_abduction=10, **spread), true).problem

    assert "11° off" in off(11 * 11 / 2)
    assert off(9 * 11 / 2) == ""
    assert "11° at the end" in off(np.where(k >= FRAMES - 10, 11 * 11 / 2, 0.0))
    assert off(np.where(k < 10, 11 * 11 / 2, 0.0)) == ""


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(EvaluationError, match="40 frames at 60 Hz cannot be compared with 39 at 60 Hz"):
        score(movement(), movement().first(39))
    with pytest.raises(EvaluationError, match="at 30 Hz"):
        outcome(movement(), movement(fps=30.0))
    with pytest.raises(EvaluationError, match="three or more"):
        score(movement(frames=2), movement(frames=2))
    with pytest.raises(EvaluationError, match="no hinge 'left hip'"):
        movement().flexion_deg("left hip")
    with pytest.raises(SettingsError, match="fps"):
        movement(fps=0.0)
    with pytest.raises(SettingsError, match="shape of angles"):
        Movement(MESH, TreePose(np.eye(4), np.zeros(len(NAMES))), 60.0)
    with pytest.raises(SettingsError, match="shape of angles"):
        movement(frames=0)
    assert score(movement(frames=3), movement(frames=3)).frames == 3


def test_limbs_that_are_no_deeper_in_each_other_than_they_are_pass_the_strictest_limit() -> None:
    assert outcome(movement(frames=12), movement(frames=12), through_mm=0.0).problem == ""


def test_flexion_is_that_of_the_hinge() -> None:
    np.testing.assert_allclose(movement(left_knee_flexion=WAVE).flexion_deg("left knee"), WAVE)
