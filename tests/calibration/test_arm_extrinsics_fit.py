"""The pose of a camera from paired arms: exact without noise, and as uncertain as it says."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from mocapella.calibration.arm_extrinsics import (
    ArmExtrinsicsResult,
    ArmExtrinsicsSettings,
    Instant,
    _missing,
    _space,
    extrinsics_from_arm,
)
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion

POSE = rigid(exp_twist([0, 0, 0, 0.4, -1.0, 0.2])[:3, :3], [1.0, -2.0, 3.0])
SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
WEIGHTS = np.full(8, 1e4)


def seen(
    count: int = 60, *, delay_s: float = 0.0, noise_m: float = 0.0, seed: int = 0, middle: Sequence[float] = (0, 0, 0),
    every_s: float = 0.1, begin_s: float = 0.0,
) -> list[Instant]:  # fmt: skip
    """Instants of an arm that is moved about in all directions, at any speed."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        world, velocity = np.asarray(middle) + rng.uniform(-0.4, 0.4, (8, 3)), rng.normal(0, 0.5, (8, 3))
        own = apply(inverse(POSE), world) - delay_s * velocity
        found.append(
            Instant(begin_s + k * every_s, world + rng.normal(0, noise_m, (8, 3)), own, velocity, WEIGHTS.copy())
        )
    return found


def sds(instants: Sequence[Instant]) -> np.ndarray:
    found = extrinsics_from_arm(instants)
    return np.array([found.position_sd_m, found.rotation_sd_rad])


@pytest.mark.parametrize("delay_s", [-0.08, 0.0, 0.05])
@pytest.mark.parametrize("middle", [(0, 0, 0), (50.0, -30.0, 20.0)])
def test_without_noise_pose_and_delay_come_back_wherever_the_world_begins(
    delay_s: float, middle: tuple[float, ...]
) -> None:
    instants = seen(delay_s=delay_s, middle=middle)
    found = extrinsics_from_arm(instants)
    for one in instants[::10]:
        own = one.own + delay_s * one.velocity
        np.testing.assert_allclose(apply(found.T_world_camera, own), one.world, atol=1e-4)
    assert found.delay_s == pytest.approx(delay_s, rel=1e-3, abs=1e-6)
    assert found.residual_m < 1e-4
    assert found.missing == ""


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_delay_is_at_most_a_tenth_of_a_second(sign: int) -> None:
    assert extrinsics_from_arm(seen(delay_s=0.3 * sign)).delay_s == pytest.approx(0.1 * sign)


def test_a_delay_that_is_known_no_better_than_expected_is_halved() -> None:
    """The arm's velocity is such that its motion shows the delay as well as what is expected of it does."""
    instants = seen(200, delay_s=0.03)
    known = sum(float((one.weights[:, None] * one.velocity**2).sum()) for one in instants)
    s = ArmExtrinsicsSettings(delay_sd_s=1 / np.sqrt(known), scale_m=1000.0)
    assert extrinsics_from_arm(instants, s).delay_s == pytest.approx(0.015, rel=0.03)


def test_two_fifths_of_the_arms_elsewhere_do_not_matter() -> None:
    instants = [
        msgspec.structs.replace(one, own=one.own + np.array([0.5, 0.8, -0.4])) if k % 5 in (0, 2) else one
        for k, one in enumerate(seen(80, middle=(5.0, 0.0, 0.0)))
    ]
    found = extrinsics_from_arm(instants)
    np.testing.assert_allclose(found.T_world_camera, POSE, atol=0.005)


def test_joints_that_are_not_measured_change_nothing() -> None:
    """Wherever they seem to be, and though they are the most."""
    instants, weights = seen(noise_m=0.002), np.array([1e4, 0, 0, 1e4, 0, 0, 1e4, 0])
    few = [msgspec.structs.replace(one, weights=weights) for one in instants]
    for away in (0.0, 0.7, np.nan):
        moved = [
            msgspec.structs.replace(one, own=np.where(weights[:, None] > 0, one.own, one.own + away)) for one in few
        ]
        one, other = extrinsics_from_arm(few), extrinsics_from_arm(moved)
        np.testing.assert_array_equal(other.T_world_camera, one.T_world_camera)
        assert msgspec.structs.astuple(other)[1:] == msgspec.structs.astuple(one)[1:]


def test_errors_of_a_pose_are_as_large_as_it_says() -> None:
    squares = []
    for seed in range(20, 36):
        found = extrinsics_from_arm(seen(noise_m=0.004, seed=seed, every_s=0.5, middle=(1.0, 2.0, 3.0)))
        middle = np.array([[1.0, 2.0, 3.0]])
        off = apply(found.T_world_camera @ inverse(POSE), middle) - middle
        turn = log_motion(found.T_world_camera @ inverse(POSE))[3:]
        squares.append([(off**2).sum() / found.position_sd_m**2, (turn**2).sum() / found.rotation_sd_rad**2])
        assert found.residual_m == pytest.approx(0.004 * 1.54, rel=0.2)
    rms = np.sqrt(np.mean(squares, axis=0))
    assert (rms > 0.7).all()
    assert (rms < 1.4).all()


def test_errors_within_half_a_second_are_one_and_those_of_different_half_seconds_are_not() -> None:
    """An instant that is repeated within it makes nobody surer; one that contradicts it takes all of its error away."""
    once = seen(40, noise_m=0.003, every_s=0.5)
    apart_s = np.arange(3) * 0.15
    often = [msgspec.structs.replace(one, at_s=one.at_s + s) for one in once for s in apart_s]
    np.testing.assert_allclose(sds(often), sds(once), rtol=0.01)
    later = [msgspec.structs.replace(one, at_s=one.at_s + 20.0 * k) for k in range(4) for one in once]
    np.testing.assert_allclose(sds(later), sds(once) / 2, rtol=0.01)
    exact = seen(40, every_s=0.5)
    opposite = [
        msgspec.structs.replace(one, at_s=one.at_s + s, world=one.world + sign * (one.world - own.world))
        for own, one in zip(exact, once, strict=True)
        for s, sign in ((0.0, 0.0), (0.2, -2.0))
    ]
    assert (sds(opposite) < 0.2 * sds(once)).all()


def test_uncertainty_does_not_depend_on_when_it_began_nor_on_the_order_of_half_seconds() -> None:
    instants = seen(40, noise_m=0.003, every_s=0.25)
    for begin_s in (0.375, 100.0, 1e6 + 0.25):
        moved = [msgspec.structs.replace(one, at_s=begin_s + one.at_s) for one in instants]
        np.testing.assert_allclose(sds(moved), sds(instants), rtol=1e-9)
    apart = seen(40, noise_m=0.003, every_s=0.5)
    order = np.random.default_rng(1).permutation(40)
    shuffled = [msgspec.structs.replace(apart[k], at_s=one.at_s) for k, one in zip(order, apart, strict=True)]
    np.testing.assert_allclose(sds(shuffled), sds(apart), rtol=1e-6)


def test_the_space_is_the_second_largest_spread_of_the_joints_about_their_own_means() -> None:
    motion = SIGNS * [0.3, 0.1, 0.02] @ exp_twist([0, 0, 0, 0.5, 0.3, 1.0])[:3, :3]
    p = motion[:, None] + np.random.default_rng(0).uniform(-5, 5, (8, 3))
    every = np.ones((8, 8))
    assert _space(p, every) == pytest.approx(0.1)
    assert _space(np.tile(p, (3, 1, 1)), np.tile(every, (3, 1))) == pytest.approx(0.1)
    unseen = every.copy()
    unseen[:, 4:] = 0
    for away in (np.nan, 7.0):
        wild = p.copy()
        wild[::2, 4:] += away
        assert _space(wild, unseen) == pytest.approx(0.1)
    assert _space(p, np.zeros((8, 8))) == 0.0


S = ArmExtrinsicsSettings()
AT_ITS_LIMITS = ArmExtrinsicsResult(np.eye(4), 0.0, S.largest_sd_m, S.largest_sd_rad, S.largest_residual_m)


def test_a_pose_at_all_its_limits_can_be_used() -> None:
    assert _missing(AT_ITS_LIMITS, S.space_m, S) == ""
    assert "farther about" in _missing(AT_ITS_LIMITS, float(np.nextafter(S.space_m, 0)), S)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("residual_m", 0.123, "its joints are 12 cm from another camera's"),
        ("position_sd_m", 0.0234, "its position is known to 23 mm only"),
        ("rotation_sd_rad", 0.1, "its position is known to 10 mm only"),
    ],
)
def test_a_pose_beyond_one_limit_says_what_to_do(name: str, value: float, told: str) -> None:
    assert told in _missing(msgspec.structs.replace(AT_ITS_LIMITS, **{name: value}), 1.0, S)
    just = float(np.nextafter(getattr(AT_ITS_LIMITS, name), 1))
    assert _missing(msgspec.structs.replace(AT_ITS_LIMITS, **{name: just}), 1.0, S) != ""


def test_the_settings_that_are_given_decide() -> None:
    instants = seen(noise_m=0.004)
    assert extrinsics_from_arm(instants).missing == extrinsics_from_arm(instants, S).missing == ""
    assert "known to" in extrinsics_from_arm(instants, ArmExtrinsicsSettings(largest_sd_m=1e-6)).missing


@pytest.mark.parametrize("limits", [(9, 300), (20, 19), (60, 10_001)])
def test_numbers_of_frames_beyond_their_limits_are_refused(limits: tuple[int, int]) -> None:
    for good in ((10, 10), (10, 10_000), (10_000, 10_000)):
        assert ArmExtrinsicsSettings(instants=good).instants == good
    with pytest.raises(SettingsError, match="instants"):
        ArmExtrinsicsSettings(instants=limits)
