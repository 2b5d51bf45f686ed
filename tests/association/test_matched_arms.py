"""Laws of matching a camera's arms with tracked arms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.arms import ArmMatchSettings, match_arms

SETTINGS = ArmMatchSettings(within_m=0.25, follow_m=0.5, other_side_m=0.125, new_id_m=0.0625)


def matched(apart_m: float, *, followed: bool = False, other_side: bool = False, slack_m: float = 0.0) -> bool:
    """Whether an arm is matched with the only tracked arm, so far away from it."""
    side, known_side = np.array([1.0]), np.array([-1.0 if other_side else 1.0])
    (which,) = match_arms(
        np.array([[apart_m, 0.0, 0.0]]), side, np.zeros((1, 3)), known_side, np.array([[followed]]),
        np.array([slack_m]), SETTINGS,
    )  # fmt: skip
    return bool(which == 0)


@pytest.mark.parametrize("followed", [False, True])
@pytest.mark.parametrize("other_side", [False, True])
@pytest.mark.parametrize("slack_m", [0.0, 0.125])
def test_an_arm_is_matched_up_to_the_largest_distance_and_no_farther(
    followed: bool, other_side: bool, slack_m: float
) -> None:
    """All lengths are sums of powers of two, so that the largest distance is exact."""
    farthest = (0.5 if followed else 0.25) + slack_m - (0.125 if other_side else 0.0)
    assert matched(farthest, followed=followed, other_side=other_side, slack_m=slack_m)
    assert not matched(farthest + 1e-6, followed=followed, other_side=other_side, slack_m=slack_m)


def test_a_largest_distance_of_zero_matches_palms_that_coincide() -> None:
    nowhere = ArmMatchSettings(within_m=0.0)
    palms, sides, none = np.zeros((1, 3)), np.ones(1), np.zeros((1, 1), dtype=bool)
    assert match_arms(palms, sides, palms, sides, none, np.zeros(1), nowhere).tolist() == [0]
    assert match_arms(palms, sides, palms + 1e-9, sides, none, np.zeros(1), nowhere).tolist() == [-1]


@given(st.permutations(range(4)), st.integers(0, 2**32 - 1))
def test_arms_in_any_order_are_matched_with_their_own(order: list[int], seed: int) -> None:
    known = np.arange(4)[:, None] * [0.3, 0.0, 0.0]
    palms = known[order] + np.random.default_rng(seed).uniform(-0.05, 0.05, (4, 3))
    found = match_arms(palms, np.zeros(4), known, np.zeros(4), np.zeros((4, 4), dtype=bool), np.zeros(4))
    assert found.tolist() == order
    palms[0] = np.nan
    found = match_arms(palms, np.zeros(4), known, np.zeros(4), np.zeros((4, 4), dtype=bool), np.zeros(4))
    assert found.tolist() == [-1, *order[1:]]
