"""Noise and misdetections of arms: planted ones are counted, and nothing else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.kinematic_hands import random_motion

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.kinematics.arm_quality import ArmQualityMeter, ArmQualitySettings, _still, misdetected, swapped_pairs
from mocapella.model.arm_quality import ArmQuality, Misdetections
from mocapella.model.arms import ARM_JOINTS, SeenArm
from mocapella.model.hand import HandPose, hand_model
from mocapella.sources.simulate.depth_scene import load_depth_scene
from mocapella.sources.simulate.hand_motion import landmarks_of

HZ = 30.0
MODEL = hand_model("full")
HAND = landmarks_of(MODEL, MODEL.shape("right"), HandPose(np.zeros(21), np.eye(4)))
POINTS = np.concatenate([HAND, [0.5 * (HAND[0] + HAND[9])], [HAND[0] - [0, 0, 0.25]]]) + np.array([0.0, 0.0, 0.8])
JOINTS = POINTS[list(ARM_JOINTS)]
seeds = st.integers(0, 2**32 - 1)
TIP = [4, 8, 12, 16, 20]


def arm(points: Any = POINTS, number: int = 0, left: bool = False) -> SeenArm:
    return SeenArm(number, left, 1.0, np.asarray(points), np.full(23, 2, np.uint8), np.zeros(23, np.float32),
                   np.zeros(21))  # fmt: skip


def measured(frames: list[Any], meter: ArmQualityMeter | None = None) -> ArmQuality:
    meter = meter or ArmQualityMeter()
    for k, points in enumerate(frames):
        quality = meter.update([] if points is None else [arm(points)], k / HZ)
    return quality


@pytest.mark.slow
@settings(max_examples=8)
@given(seeds, st.floats(1e-4, 0.0025))
def test_the_noise_of_a_still_arm_is_what_was_added(seed: int, sd: float) -> None:
    rng = np.random.default_rng(seed)
    quality = measured([POINTS + rng.normal(0, sd, POINTS.shape) for _ in range(300)])
    np.testing.assert_allclose(quality.noise_whole_m, math.sqrt(3) * sd, rtol=0.25)
    np.testing.assert_allclose(quality.noise_m, math.sqrt(3) * sd, rtol=0.4)
    assert quality.still
    assert quality.whole == Misdetections()
    assert quality.per_minute == 0
    assert quality.seen_s == pytest.approx(299 / HZ)
    assert quality.still_s > 7


@settings(max_examples=25)
@given(seeds)
def test_where_the_camera_stands_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, now = JOINTS, JOINTS + rng.normal(0, 0.05, JOINTS.shape)
    now[rng.integers(3, 8)] = np.nan
    T = random_motion(rng)
    # The median is of coordinates, so that a turn may change what is near the threshold.
    moved = T[:3, 3]
    assert misdetected(before + moved, now + moved, 0.05) == misdetected(before, now, 0.05)
    assert swapped_pairs(apply(T, before), apply(T, now)) == swapped_pairs(before, now)


@given(st.floats(0, 0.15), seeds)
def test_an_arm_that_moves_as_a_whole_does_not_jump(speed: float, seed: int) -> None:
    step = np.random.default_rng(seed).normal(size=3)
    step *= speed / np.linalg.norm(step)
    assert misdetected(JOINTS, JOINTS + step, 0.05) == Misdetections()


@given(st.integers(0, 7), st.floats(0.052, 0.5), st.booleans())
def test_a_joint_that_jumps_counts_once_and_one_that_hardly_does_not(joint: int, far: float, moving: bool) -> None:
    now = JOINTS + np.array([0.06 * moving, 0, 0])
    now[joint] += [0, far, 0]
    assert misdetected(JOINTS, now, 0.05) == Misdetections(jumped=1)
    now[joint] -= [0, far - 0.049, 0]
    assert misdetected(JOINTS, now, 0.05) == Misdetections()


@given(st.integers(0, 4), st.integers(0, 4))
def test_fingers_that_change_places_are_a_swap_and_no_jumps(i: int, j: int) -> None:
    now = JOINTS.copy()
    now[[3 + i, 3 + j]] = JOINTS[[3 + j, 3 + i]]
    found = misdetected(JOINTS, now, 0.05)
    assert found == Misdetections(swapped=int(i != j))
    assert swapped_pairs(JOINTS[3:], now[3:]) == ([(min(i, j), max(i, j))] if i != j else [])


def test_fingers_that_appear_and_vanish_are_counted_and_the_first_frame_is_not() -> None:
    gone = POINTS.copy()
    gone[[8, 12]] = np.nan
    quality = measured([gone, POINTS, POINTS, gone, POINTS])
    assert quality.whole == Misdetections(appeared=4, vanished=2)
    assert quality.lately == quality.whole


def test_an_arm_that_is_gone_is_lost_and_not_its_fingers() -> None:
    quality = measured([POINTS, POINTS, None, None, POINTS])
    assert quality.whole == Misdetections(lost=1)
    assert quality.whole.of_joints == 0


def test_an_arm_that_changes_its_side_is_a_swap() -> None:
    meter = ArmQualityMeter()
    meter.update([arm()], 0.0)
    assert meter.update([arm(left=True)], 0.03).whole == Misdetections(swapped=1)


def test_arms_are_told_apart_by_their_ids() -> None:
    meter = ArmQualityMeter()
    for k in range(90):
        other = POINTS + np.array([0.3, 0, 0])
        arms = [arm(number=1), arm(other, number=2)]
        quality = meter.update(arms if k % 2 else arms[::-1], k / HZ)
    assert quality.whole == Misdetections()
    assert quality.seen_s == pytest.approx(2 * 89 / HZ)


def test_a_rate_is_of_the_last_minute_and_a_sum_of_all() -> None:
    jump = POINTS.copy()
    jump[8] += [0, 0.2, 0]
    meter = ArmQualityMeter()
    for k in range(900):
        quality = meter.update([arm(jump if k in (30, 31) else POINTS)], k / 10)
        if k == 60:
            assert quality.per_minute == pytest.approx(2 * 60 / 6.0)
    assert quality.whole.jumped == 2
    assert quality.lately.jumped == 0
    assert quality.per_minute == 0.0
    assert quality.as_json()["misdetections_per_minute"] == pytest.approx(2 * 60 / 89.9, abs=0.01)


@given(st.floats(1 / 120, 0.19), st.floats(0.1, 10.0), st.integers(0, 7))
def test_a_joint_jumps_if_it_is_faster_than_a_finger_by_five_centimetres_or_farther_than_one_reaches(
    step_s: float, speed_m_s: float, joint: int
) -> None:
    far = speed_m_s * step_s
    assume(abs(far - 0.05) > 1e-6)
    assume(abs(speed_m_s - 3.0) > 1e-6)
    assume(abs(far - 0.15) > 1e-6)
    meter, now = ArmQualityMeter(), POINTS.copy()
    now[ARM_JOINTS[joint]] += [0, far, 0]
    meter.update([arm()], 5.0)
    assert meter.update([arm(now)], 5.0 + step_s).whole.jumped == (far > 0.15 or (speed_m_s > 3.0 and far > 0.05))


@given(seeds)
def test_what_the_joints_truly_did_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, true = JOINTS, rng.normal(0, 0.2, JOINTS.shape)
    now = JOINTS + rng.normal(0, 0.03, JOINTS.shape)
    assert misdetected(before, now + true, 0.05, true) == misdetected(before, now, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("hz", [30.0, 15.0, 7.5])
def test_the_true_arms_of_the_demo_are_no_misdetections(hz: float) -> None:
    """Their fingers come farther than 5 cm from image to image."""
    scene, meter, farthest = load_depth_scene("cloth", seed=0), ArmQualityMeter(), 0.0
    mesh, before = scene.meshes[0], None
    for k in range(int(scene.period_s * hz)):
        pose = scene.poses(k / hz)[0]
        points = mesh.points(pose)[: len(POINTS)]
        quality = meter.update([arm(points)], k / hz)
        joints = points[list(ARM_JOINTS)]
        if before is not None:
            moved = joints - before
            farthest = max(farthest, float(np.linalg.norm(moved - np.median(moved, axis=0), axis=-1).max()))
        before = joints
    assert quality.whole == Misdetections()
    assert farthest > 0.05


def test_an_arm_that_moves_has_no_noise_and_of_one_that_moves_a_finger_that_finger_has_none() -> None:
    away = [POINTS + np.array([0.02 * k / HZ, 0, 0]) for k in range(90)]
    quality = measured(away)
    assert not quality.still
    assert np.isnan(quality.noise_m).all()
    bends = []
    for k in range(90):
        bends.append(POINTS.copy())
        bends[-1][8] -= [0, 0.0005 * k, 0]
    noise = measured(bends).noise_m
    np.testing.assert_array_equal(np.isnan(noise), [joint == 8 for joint in ARM_JOINTS])
    known = measured([np.where(np.arange(23)[:, None] == 8, np.nan, POINTS)] * 90).noise_m
    np.testing.assert_array_equal(np.isnan(known), [joint == 8 for joint in ARM_JOINTS])


@pytest.mark.parametrize("seed", range(3))
def test_noise_does_not_hide_a_drift_that_is_ten_times_as_large(seed: int) -> None:
    """The means of seven frames are known to a fifth of a millimetre, and an arm may move by two."""
    noise = 0.0005 * np.random.default_rng(seed).normal(size=(70, *POINTS.shape))
    assert measured([POINTS + one for one in noise]).still
    drift = measured([POINTS + one + [0.003 * k / HZ, 0, 0] for k, one in enumerate(noise)])
    assert drift.still_s == 0
    assert np.isnan(drift.noise_m).all()


def test_an_arm_that_sways_is_not_noisy() -> None:
    sways = [POINTS + np.array([0.02 * np.sin(2 * np.pi * 0.4 * k / HZ), 0, 0]) for k in range(200)]
    quality = measured(sways)
    assert quality.still_s == 0
    assert np.isnan(quality.noise_whole_m).all()


def test_frames_with_a_gap_between_them_are_not_compared() -> None:
    meter, moved = ArmQualityMeter(), POINTS.copy()
    moved[8] += 0.3
    for at_s, points in ((0.0, POINTS), (1.0, moved), (0.5, POINTS)):
        quality = meter.update([arm(points)], at_s)
    assert quality.whole == Misdetections()
    assert quality.seen_s == 0.0
    assert math.isnan(quality.per_minute)
    assert quality.as_json()["misdetections_per_minute"] is None


@given(*[st.lists(st.integers(0, 10**6), min_size=5, max_size=5)] * 2)
def test_the_sum_of_misdetections_has_those_of_both_by_kind(one: list[int], other: list[int]) -> None:
    both = Misdetections(*one).plus(Misdetections(*other))
    assert both == Misdetections(*map(sum, zip(one, other, strict=True)))
    assert both.of_joints + both.lost == sum(one) + sum(other)


def test_reset_is_as_newly_made() -> None:
    rng, meter = np.random.default_rng(3), ArmQualityMeter()
    frames = [POINTS + rng.normal(0, 0.02, POINTS.shape) for _ in range(80)]
    first = measured(frames, meter)
    meter.reset()
    again = measured(frames, meter)
    assert again.as_json() == first.as_json()
    assert first.as_json()["noise_mm"]["palm"] is None or first.whole.jumped > 0  # type: ignore[index]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("jump_m_s", -1.0),
        ("still_window_s", 0.0),
        ("still_m", 0.0),
        ("least_frames", 3),
        ("jump_m", math.nan),
        ("gap_s", 0.0),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} is {value}"):
        ArmQualitySettings(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("frames", [55, 56, 114, 115, 116, 240])
def test_no_frame_counts_twice_in_the_noise_of_the_whole_and_most_count(frames: int) -> None:
    """A window of two seconds at 30 Hz is full after 55 frames, nine tenths; each next one begins after it."""
    meter = ArmQualityMeter()
    measured([POINTS] * frames, meter)
    counts = set(meter._squared.tolist())
    assert len(counts) == 1
    assert frames - 61 <= counts.pop() <= frames


def steps(apart_m: float, swing_m: float = 0.0, frames: int = 64) -> np.ndarray:
    """(frames, 1, 3) positions that move once, halfway, and swing to both sides of their mean in each frame [m]."""
    k = np.arange(frames)
    found = np.zeros((frames, 1, 3))
    found[:, 0, 0], found[:, 0, 1] = apart_m * (k >= frames // 2), swing_m * (-1.0) ** k
    return found


def most_that_is_still(swing_m: float, frames: int = 64) -> float:
    """The longest step of a joint that swings so and counts as still, beyond what would be still without [m]."""
    low, high = 0.0, 1.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _still(steps(middle, swing_m, frames), 0.002)[0] else (low, middle)
    return low - 0.002


def test_a_joint_without_noise_is_still_up_to_the_limit_itself() -> None:
    limit = 2.0**-9
    assert _still(steps(limit), limit)[0]
    assert not _still(steps(np.nextafter(limit, 1)), limit)[0]


@pytest.mark.parametrize("swing_m", [1e-4, 5e-4])
def test_noise_widens_what_is_still_in_proportion_and_by_less_in_longer_windows(swing_m: float) -> None:
    once = most_that_is_still(swing_m)
    assert once > swing_m
    assert most_that_is_still(2 * swing_m) == pytest.approx(2 * once, rel=1e-3)
    assert most_that_is_still(swing_m, 4 * 64) == pytest.approx(once / 2, rel=1e-3)
    assert most_that_is_still(1.0) == pytest.approx(0.006, rel=1e-3), "but not without limit"


def test_of_normal_noise_four_standard_deviations_of_the_mean_of_an_eighth_are_still() -> None:
    sd, frames = 0.0005, 8000
    noise = np.random.default_rng(0).normal(0, sd, (frames, 1, 3))
    allowed = [
        apart for apart in np.linspace(0, 2e-4, 401) if _still(noise - _means(noise) + steps(apart, 0, frames), 0)
    ]
    assert max(allowed) == pytest.approx(4 * math.sqrt(3) * sd / math.sqrt(frames / 8), rel=0.03)


def _means(noise: np.ndarray) -> np.ndarray:
    """The mean of each eighth, at each of its frames, so that only steps are left between eighths."""
    eighths = noise.reshape(8, -1, 1, 3)
    return np.broadcast_to(eighths.mean(axis=1, keepdims=True), eighths.shape).reshape(noise.shape)


STEP_S = 1 / 64
"""Exact in binary, as are its multiples."""


def swinging(swing_m: float, k: int) -> np.ndarray:
    """All points, to one side or the other of their mean, in turns."""
    return np.asarray(POINTS + np.array([0, swing_m * (-1.0) ** k, 0]))


@pytest.mark.parametrize(("least_frames", "first"), [(20, 72), (73, 72), (74, 73), (80, 79)])
@pytest.mark.parametrize("start_s", [0.0, 4096.0])
def test_an_arm_is_still_from_nine_tenths_of_the_window_on_if_it_has_enough_frames(
    least_frames: int, first: int, start_s: float
) -> None:
    """Nine tenths of this window are 72 steps, between 73 frames."""
    meter = ArmQualityMeter(ArmQualitySettings(still_window_s=1.25, least_frames=least_frames))
    for k in range(90):
        quality = meter.update([arm()], start_s + k * STEP_S)
        assert quality.still == (k >= first)
        assert quality.still_s == max(0, k - first + 1) * STEP_S


def test_noise_is_the_root_mean_square_of_all_arms_and_of_those_points_that_are_still() -> None:
    meter, swings_m = ArmQualityMeter(), (3e-4, 4e-4)
    for k in range(400):
        arms = [swinging(swing_m, k) for swing_m in swings_m]
        arms[0][8] += [0, 0.0005 * k, 0]
        quality = meter.update([arm(points, number) for number, points in enumerate(arms)], k * STEP_S)
    usual, of_one = np.sqrt(np.mean(np.square(swings_m))), swings_m[1]
    for found in (quality.noise_m, quality.noise_whole_m):
        np.testing.assert_allclose(found, [of_one if joint == 8 else usual for joint in ARM_JOINTS], rtol=0.01)
