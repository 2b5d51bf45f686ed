"""The cloth: mechanics that hold whatever it is made of, and hands that hold it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.arms import PALM
from mocapella.model.scene import TrackedArm
from mocapella.sources.simulate.cloth import Cloth, ClothBeforeHand, ClothSettings, HandInCloth, hand_in_cloth

pytestmark = pytest.mark.slow  # of kernels that are compiled for these tests alone

SMALL: dict[str, float] = {"width_m": 0.16, "height_m": 0.16, "mesh_m": 0.02}
HZ = 30.0
seeds = st.integers(0, 2**32 - 1)
NO_HANDS: tuple[HandInCloth, ...] = ()


def cloth(pinned: bool = True, **changed: Any) -> Cloth:
    return Cloth(np.eye(4), ClothSettings(**{**SMALL, **changed}), pinned=pinned)


def hand(at: Any, *, grabbing: bool = False, radius: float = 0.03, turn: float = 0.0, number: int = 0) -> HandInCloth:
    at = np.asarray(at, dtype=np.float64)
    return HandInCloth(number, rigid(rotation_about_x(turn), at), np.array([[*at, radius]]), at[None], grabbing)


def shaken(made: Cloth, seed: int, speed: float = 0.3) -> Cloth:
    made.velocities[:] = np.random.default_rng(seed).normal(0, speed, made.velocities.shape)
    made.velocities[made.pinned] = 0
    return made


def run(made: Cloth, seconds: float, hands: Any = NO_HANDS, start_s: float = 0.0, hz: float = HZ) -> Cloth:
    for k in range(round(seconds * hz) + 1):
        made.update(hands, start_s + k / hz)
    return made


@settings(max_examples=8)
@given(seeds)
def test_what_is_free_keeps_its_momentum_and_its_turning(seed: int) -> None:
    made = shaken(cloth(pinned=False, gravity_m_s2=0.0, damping_per_s=0.0), seed)
    p, L = made.velocities.sum(axis=0), np.cross(made.positions, made.velocities).sum(axis=0)
    run(made, 0.3)
    np.testing.assert_allclose(made.velocities.sum(axis=0), p, atol=1e-9)
    turning = np.cross(made.positions, made.velocities).sum(axis=0)
    np.testing.assert_allclose(turning, L, atol=0.02 * np.abs(L).max() + 1e-3)


def test_what_is_free_falls_as_everything_does() -> None:
    made = cloth(pinned=False, damping_per_s=0.0)
    before = made.positions.copy()
    run(made, 0.5)
    fell = np.tile([0, -0.5 * 9.81 * 0.25, 0], (len(before), 1))
    np.testing.assert_allclose(made.positions - before, fell, atol=4e-3)


@settings(max_examples=5)
@given(seeds)
def test_energy_does_not_grow(seed: int) -> None:
    made = shaken(cloth(damping_per_s=0.0), seed)
    energies = []
    for k in range(60):
        made.update(NO_HANDS, k / HZ)
        free = ~made.pinned
        energies.append(0.5 * (made.velocities**2).sum() + 9.81 * made.positions[free, 1].sum())
    kinetic = 0.5 * (made.velocities**2).sum()
    assert max(energies) <= energies[0] + 1e-6 * abs(energies[0]) + 1e-3 * kinetic
    assert energies[-1] < energies[0]


def test_it_hangs_still_and_hardly_stretches_under_its_own_weight() -> None:
    made = Cloth(np.eye(4), ClothSettings(damping_per_s=8.0))
    run(made, 3.0)
    assert np.abs(made.velocities).max() < 0.02
    length = np.linalg.norm(np.diff(made.positions[made.pairs], axis=1)[:, 0], axis=1)
    stretch = length / made.rest - 1
    assert stretch.max() < 0.02
    assert abs(float(stretch.mean())) < 0.01


@given(seeds)
@settings(max_examples=5)
def test_what_is_pinned_stays(seed: int) -> None:
    made = shaken(cloth(), seed, 2.0)
    where = made.positions[made.pinned].copy()
    run(made, 0.5, [hand([0, -0.03, 0.02], grabbing=True)])
    np.testing.assert_array_equal(made.positions[made.pinned], where)


def test_the_same_gives_the_same_to_the_bit_and_reset_is_as_newly_made() -> None:
    def once(made: Cloth) -> np.ndarray:
        for k in range(40):
            made.update([hand([0, -0.08, 0.05 - 0.004 * k], grabbing=k > 15, turn=0.02 * k)], k / HZ)
        return made.positions.copy()

    made = cloth()
    first = once(made)
    np.testing.assert_array_equal(once(cloth()), first)
    made.reset()
    np.testing.assert_array_equal(once(made), first)
    assert np.isfinite(first).all()


def test_neither_the_frames_rate_nor_the_step_matters_much() -> None:
    def after(hz: float, **changed: Any) -> np.ndarray:
        made = cloth(damping_per_s=3.0, **changed)
        made.positions[:, 2] += 0.3 * made.positions[:, 1]  # it swings
        made.positions[made.pinned, 2] = 0
        return run(made, 1.0, hz=hz).positions.copy()

    reference = after(60.0)
    np.testing.assert_allclose(after(30.0), reference, atol=1e-9)
    np.testing.assert_allclose(after(60.0, step_s=1 / 1920), reference, atol=0.006)


@given(st.floats(-0.06, 0.06), st.floats(-0.13, -0.10), st.floats(-0.4, 0.4))
@settings(max_examples=8)
def test_what_a_hand_holds_goes_exactly_with_it_and_falls_when_it_is_let_go(x: float, y: float, turn: float) -> None:
    made = run(cloth(damping_per_s=5.0), 0.2)
    made.update([hand([x, y, 0], grabbing=True)], 0.3)
    held = made.held.copy()
    assert held.any()
    assert not (held & made.pinned).any()
    T = rigid(np.eye(3), [x, y, 0.0])
    local = apply(np.linalg.inv(T), made.positions[held])
    for k in range(10):
        now = hand([x + 0.001 * k, y, 0.004 * k], grabbing=True, turn=turn * k / 10)
        made.update([now], 0.3 + (k + 1) / HZ)
        np.testing.assert_allclose(made.positions[held], apply(now.T_world_hand, local), atol=1e-12)
        np.testing.assert_array_equal(made.held, held)
    made.update([hand([x + 0.01, y, 0.04])], 0.3 + 11 / HZ)
    assert not made.held.any()
    assert np.linalg.norm(made.velocities, axis=1).max() < 5.001  # it does not burst out of the hand
    depth = made.positions[held, 2].mean()
    run(made, 2.0, start_s=0.3 + 12 / HZ)
    assert abs(made.positions[held, 2].mean()) < max(0.5 * depth, 0.02)


def test_a_hand_that_was_closed_before_it_came_takes_nothing_and_one_that_is_gone_lets_go() -> None:
    made = cloth()
    made.update([hand([0, -0.1, 0.5], grabbing=True)], 0.0)
    made.update([hand([0, -0.1, 0.0], grabbing=True)], 0.1)
    assert not made.held.any()
    made.update([hand([0, -0.1, 0.0])], 0.15)
    made.update([hand([0, -0.1, 0.0], grabbing=True)], 0.2)
    assert made.held.any()
    made.update(NO_HANDS, 0.25)
    assert not made.held.any()


def test_two_hands_hold_different_parts() -> None:
    made = cloth()
    made.update([hand([-0.06, -0.1, 0], grabbing=True), hand([0.06, -0.1, 0], grabbing=True, number=1)], 0.0)
    assert set(made._holder[made.held]) == {0, 1}
    made.update([hand([-0.06, -0.1, 0], grabbing=True), hand([0.06, -0.1, 0], number=1)], 0.1)
    assert set(made._holder[made.held]) == {0}


def test_a_hand_pushes_the_cloth_and_is_never_in_it() -> None:
    made, s = run(cloth(), 0.1), ClothSettings()
    for k in range(40):
        pusher = hand([0, -0.1, 0.06 - 0.004 * k])
        made.update([pusher], 0.1 + (k + 1) / HZ)
        apart = np.linalg.norm(made.positions - pusher.spheres[0, :3], axis=1)
        assert apart[~made.pinned].min() > 0.03 + s.thickness_m - 1e-3
    assert made.positions[:, 2].min() < -0.06


@given(st.floats(-math.pi, math.pi))
@settings(max_examples=5)
def test_it_is_the_same_wherever_it_hangs(turn: float) -> None:
    T = rigid(rotation_about_y(turn), [1.0, 0.5, -2.0])
    here, there = cloth(), Cloth(T, ClothSettings(**SMALL))
    for k in range(15):
        near = hand([0.01, -0.08, 0.05 - 0.006 * k])
        far = HandInCloth(0, T @ near.T_world_hand, np.array([[*apply(T, near.grips)[0], 0.03]]), near.grips, False)
        here.update([near], k / HZ)
        there.update([far], k / HZ)
    np.testing.assert_allclose(there.positions, apply(T, here.positions), atol=1e-7)


def test_a_gap_is_passed_over() -> None:
    made = run(cloth(), 0.3)
    before = made.positions.copy()
    made.update(NO_HANDS, 50.0)
    np.testing.assert_array_equal(made.positions, before)
    made.update(NO_HANDS, 50.1)
    assert np.isfinite(made.positions).all()


def arm(at: Any = (0.0, 0.0, 0.0), *, grabbing: bool = False) -> TrackedArm:
    points = np.random.default_rng(1).normal(0, 0.04, (23, 3)) + np.asarray(at)
    points[PALM] = at
    return TrackedArm(5, False, points, np.full(23, 2, np.uint8), np.zeros(23, np.float32), np.zeros(21), None, "", 0.0,
                      grabbing)  # fmt: skip


def test_an_arm_is_spheres_and_what_is_not_known_of_it_is_none() -> None:
    made = hand_in_cloth(arm([0.1, 0.2, 0.3]))
    assert made is not None
    np.testing.assert_array_equal(made.T_world_hand[:3, 3], [0.1, 0.2, 0.3])
    assert len(made.grips) == 6
    partly = arm()
    partly.points[[4, 8]] = np.nan
    known = hand_in_cloth(partly)
    assert known is not None
    assert known.spheres.shape == made.spheres.shape
    assert np.isfinite(known.spheres).all()
    assert (known.spheres[:, 3] == 0).sum() == 4  # two tips, and halves of the bones to them
    assert len(known.grips) == 4
    partly.points[PALM] = np.nan
    assert hand_in_cloth(partly) is None


def test_it_hangs_between_the_camera_and_the_first_hand_and_is_taken_away_when_nobody_is_there() -> None:
    before, eye, palm = ClothBeforeHand(), np.array([0.0, 0.3, 0.9]), np.array([0.1, 0.1, 0.0])
    assert before.update((), eye, 0.0) is None
    assert before.update((arm(palm, grabbing=True),), eye, 0.05) is None
    made = before.update((arm(palm),), eye, 0.1)
    assert made is not None
    middle = made.positions.mean(axis=0)
    assert 0.04 < np.linalg.norm((middle - palm) * [1, 0, 1]) < 0.3
    assert (middle - palm) @ (eye - palm) > 0
    assert made.positions[:, 1].max() > palm[1] + 0.1
    assert before.update((), eye, 3.0) is made
    assert before.update((), eye, 9.0) is None
    above = ClothBeforeHand().update((arm(palm),), None, 0.0)
    assert above is not None
    assert np.isfinite(above.positions).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("mesh_m", 0.0), ("width_m", 0.01), ("height_m", 9.0), ("gravity_m_s2", -1.0), ("damping_per_s", -1.0)),
        *(("bend_compliance", -1.0), ("shear_compliance", 2.0), ("step_s", 0.0), ("thickness_m", 1.0)),
        *(("friction", math.nan), ("reach_m", 0.0)),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} is {value}"):
        ClothSettings(**{name: value})
