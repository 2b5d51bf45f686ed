"""Whose arm it is: the nearest limb's, one to one, with patience."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.association.arm_owners import ArmOwners, ArmOwnerSettings
from mocapella.errors import SettingsError

Float64 = NDArray[np.float64]
LIMB = np.array([[0.0, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.33, 0.0]])


def limb(x: float, y: float = 0.0) -> Float64:
    """(3, 3) elbow, wrist and hand."""
    return np.asarray(LIMB + np.array([x, y, 0.0]))


def person(x: float) -> Float64:
    """(2, 3, 3) elbow, wrist and hand of both limbs, 60 cm apart."""
    return np.stack([limb(x - 0.3), limb(x + 0.3)])


@given(st.permutations(range(4)), st.permutations([5, 7]), st.integers(0, 99))
@settings(max_examples=30)
def test_the_order_of_arms_and_people_does_not_matter(order: list[int], people: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = {5: 0.0, 7: 1.5}
    owners, sides = [5, 5, 7, 7], np.array([True, False, True, False])
    joints = np.array([person(x[who])[0 if left else 1] for who, left in zip(owners, sides, strict=True)])
    joints += rng.normal(scale=0.03, size=joints.shape)
    limbs = np.array([person(x[who]) for who in people])
    found = ArmOwners().update([10 + k for k in order], sides[order], joints[order], people, limbs)
    assert found == [owners[k] for k in order]


def one(
    owners: ArmOwners, x: float, people: dict[int, float], *, left: bool = True, height: float = 0.0, joints: int = 3
) -> int:
    arm = limb(x, height)
    arm[joints:] = np.nan
    limbs = np.array([person(at) for at in people.values()]).reshape(-1, 2, 3, 3)
    return owners.update([3], np.array([left]), arm[None], list(people), limbs)[0]


def test_nobody_near_is_nobody() -> None:
    assert one(ArmOwners(), 0.5, {1: 0.0}) == -1
    assert one(ArmOwners(), -0.3, {}) == -1
    assert one(ArmOwners(), -0.3, {1: np.nan}) == -1
    assert one(ArmOwners(), -0.3, {1: 0.0}, joints=0) == -1
    assert ArmOwners().update([], np.zeros(0, np.bool_), np.empty((0, 3, 3)), [1], person(0.0)[None]) == []


def test_one_joint_is_enough() -> None:
    assert one(ArmOwners(), -0.3, {1: 0.0}, joints=1) == 1


def test_the_wrong_side_will_do_where_it_is_nearer_by_far() -> None:
    assert one(ArmOwners(), 0.3, {1: 0.0}, left=True) == 1
    owners = ArmOwners()
    assert one(owners, 0.0, {1: -0.38, 2: 0.32}, left=True) == 2  # 2's left is 2 cm away, 1's right 8 cm
    assert one(ArmOwners(), 0.0, {1: -0.3, 2: 0.36}, left=True) == 2  # 1's right is at 0, but is its right


def test_an_arm_stays_with_its_person_until_it_is_nearer_to_another_by_the_margin() -> None:
    owners = ArmOwners(ArmOwnerSettings(switch_m=0.1))
    two = {1: 0.0, 2: 0.3}
    assert one(owners, -0.3, two) == 1
    assert one(owners, -0.12, two) == 1  # 18 cm from 1's limb, 12 cm from 2's
    assert one(ArmOwners(), -0.12, two) == 2
    assert one(owners, -0.02, two) == 2
    assert one(owners, -0.12, two) == 2


def test_it_is_kept_farther_than_it_is_taken() -> None:
    owners = ArmOwners()
    assert one(owners, -0.3, {1: 0.0}, height=0.25) == -1
    assert one(owners, -0.3, {1: 0.0}) == 1
    assert one(owners, -0.3, {1: 0.0}, height=0.25) == 1
    assert one(owners, -0.3, {1: 0.0}, height=0.4) == -1
    assert one(owners, -0.3, {1: 0.0}, height=0.25) == -1


def test_somebody_who_is_back_has_the_arm_back() -> None:
    owners = ArmOwners()
    assert one(owners, -0.3, {1: 0.0, 2: 0.3}) == 1
    assert one(owners, -0.3, {2: 0.5}) == -1
    assert one(owners, -0.14, {1: 0.0, 2: 0.3}) == 1


def test_two_arms_are_not_of_one_limb() -> None:
    arms = np.array([limb(-0.3), limb(-0.25)])
    found = ArmOwners().update([0, 1], np.array([True, True]), arms, [4], person(0.0)[None])
    assert found == [4, -1]


@pytest.mark.parametrize("changed", [{"take_m": 0.5}, {"take_m": 0.0}, {"keep_m": 6.0}, {"switch_m": -1.0}])
def test_settings_out_of_range_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(SettingsError):
        ArmOwnerSettings(**changed)
