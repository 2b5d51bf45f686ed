"""The percentage of correct parts: its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.evaluation.body_parts import JOINTS, LIMBS, PARTS, correct_limbs, joints_of_halpe, pcp
from mocapella.sources.simulate.keypoint_body import HALPE

SEEDS = st.integers(0, 2**31)


def skeletons(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.5, (*shape, len(JOINTS), 3))


@given(SEEDS)
@settings(max_examples=20)
def test_every_limb_of_the_truth_is_correct(seed: int) -> None:
    true = skeletons(seed, 3)
    right, known = correct_limbs(true, true)
    assert right.all()
    assert known.all()
    assert right.shape == (3, len(LIMBS))


@given(SEEDS, st.floats(0.05, 20.0))
@settings(max_examples=20)
def test_scale_changes_nothing(seed: int, scale: float) -> None:
    true, found = skeletons(seed, 3), skeletons(seed, 3) + skeletons(seed + 1, 3) * 0.4
    assert (correct_limbs(true, found)[0] == correct_limbs(scale * true, scale * found)[0]).all()


@given(SEEDS, st.floats(0.0, 0.99), st.floats(1.01, 3.0))
@settings(max_examples=20)
def test_half_the_length_is_the_limit(seed: int, within: float, beyond: float) -> None:
    """Both ends of a limb, moved by the same distance: correct up to half of its length."""
    true = skeletons(seed, 1)
    ends, last = LIMBS[0]
    length = np.linalg.norm(true[0, ends[0]] - true[0, last])
    for factor, right in ((within, True), (beyond, False)):
        found = true.copy()
        found[0, [ends[0], last]] += factor * 0.5 * length * np.array([1.0, 0.0, 0.0])
        assert bool(correct_limbs(true, found)[0][0, 0]) is right


def test_one_end_may_be_off_by_the_whole_length() -> None:
    true = skeletons(3, 1)
    ends, last = LIMBS[2]
    found = true.copy()
    found[0, last] += 0.99 * (true[0, last] - true[0, ends[0]])
    assert correct_limbs(true, found)[0][0, 2]


def test_a_limb_that_is_missing_is_wrong_and_one_without_reference_does_not_count() -> None:
    true, found = skeletons(4, 1), skeletons(4, 1)
    found[0, 7] = np.nan
    right, known = correct_limbs(true, found)
    assert known.all()
    assert right.sum() == len(LIMBS) - 2
    true[0, 13] = np.nan
    assert correct_limbs(true, found)[1].sum() == len(LIMBS) - 1


@given(SEEDS, st.permutations(range(4)))
@settings(max_examples=10)
def test_the_order_of_found_people_changes_nothing(seed: int, order: list[int]) -> None:
    true = skeletons(seed, 3, 5)
    found = [np.concatenate([true[:, t], skeletons(seed + 9, 1)]) for t in range(5)]
    same = [people[list(order)] for people in found]
    assert pcp(true, found) == pcp(true, same)
    assert pcp(true, found).mean == 1.0


def test_absent_actors_and_missing_people() -> None:
    true = skeletons(5, 2, 4)
    true[1, 2:] = np.nan
    found = [true[:1, t] for t in range(4)]
    scored = pcp(true, found)
    assert scored.actors == (1.0, 0.0)
    assert scored.mean == 0.5
    assert set(scored.parts) == set(PARTS)
    assert np.isnan(pcp(np.full((1, 2, 14, 3), np.nan), [np.zeros((0, 14, 3))] * 2).mean)


def test_wrong_shapes_and_shares_are_refused() -> None:
    with pytest.raises(SettingsError, match="14"):
        correct_limbs(np.zeros((2, 13, 3)), np.zeros((2, 14, 3)))
    with pytest.raises(SettingsError, match="share"):
        correct_limbs(np.zeros((2, 14, 3)), np.zeros((2, 14, 3)), share=0.0)
    with pytest.raises(SettingsError, match="actors"):
        pcp(np.zeros((1, 3, 14, 3)), [])


def test_the_joints_are_halpes() -> None:
    positions = np.arange(len(HALPE) * 3, dtype=float).reshape(1, len(HALPE), 3)
    found = joints_of_halpe(positions)
    assert (found[0, 13] == positions[0, HALPE.index("Head")]).all()
    assert found.shape == (1, 14, 3)
