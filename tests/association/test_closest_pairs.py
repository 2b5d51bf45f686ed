from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.closest_pairs import HeldPairs, closest_pairs, skeleton_distances
from mocapella.model.scene import PotentialSkeleton


def skeleton(sensor: str, body: int, at_m: float, states: tuple[int, ...] = (2, 2)) -> PotentialSkeleton:
    """A skeleton of two joints, both at x = ``at_m`` where they are seen."""
    joint_states = np.array(states, dtype=np.uint8)
    positions = np.where((joint_states > 0)[:, None], [at_m, 0.0, 0.0], np.nan)
    return PotentialSkeleton(sensor, body, 0, 0.0, 0.0, np.eye(4), positions, joint_states)


def keys(groups: tuple[tuple[PotentialSkeleton, ...], ...]) -> list[list[tuple[str, int]]]:
    return [[(s.sensor, s.tracking_id) for s in group] for group in groups]


def test_the_distance_is_the_mean_over_the_joints_that_both_track() -> None:
    nan = [np.nan] * 3
    positions = np.array([[[0, 0, 0], [1, 0, 0], [5, 5, 5]], [[3, 4, 0], [1, 0, 1], nan], [nan, nan, [5, 5, 5]]])
    states = np.array([[2, 2, 2], [2, 2, 0], [0, 0, 1]], dtype=np.uint8)
    inf = np.inf
    # (5 + 1) / 2 = 3 between the first two; the third only infers the one joint it has.
    np.testing.assert_allclose(skeleton_distances(positions, states), [[0, 3, inf], [3, 0, inf], [inf, inf, inf]])


def test_the_closest_of_different_sensors_are_paired_first() -> None:
    # a1–b1 are 1 apart and go first, which leaves a2 and b2 to each other, though b2 is nearer to a1.
    seen = [skeleton("a", 1, 0.0), skeleton("a", 2, 9.0), skeleton("b", 1, 1.0), skeleton("b", 2, -2.0)]
    assert keys(closest_pairs(seen)) == [[("a", 1), ("b", 1)], [("a", 2), ("b", 2)]]


def test_two_skeletons_of_one_sensor_are_never_one_person_not_even_by_way_of_a_third() -> None:
    seen = [skeleton("a", 1, 0.0), skeleton("a", 2, 0.1), skeleton("b", 1, 0.05), skeleton("c", 1, 0.06)]
    assert keys(closest_pairs(seen)) == [[("a", 1)], [("a", 2), ("b", 1), ("c", 1)]]


def test_who_is_left_over_is_seen_by_one_sensor() -> None:
    seen = [skeleton("a", 1, 0.0), skeleton("b", 1, 0.1), skeleton("b", 2, 5.0)]
    assert keys(closest_pairs(seen)) == [[("a", 1), ("b", 1)], [("b", 2)]]


def test_without_a_limit_any_distance_pairs_and_with_one_it_does_not() -> None:
    seen = [skeleton("a", 1, 0.0), skeleton("b", 1, 7.0)]
    assert keys(closest_pairs(seen)) == [[("a", 1), ("b", 1)]]
    assert keys(closest_pairs(seen, max_distance_m=7.0)) == [[("a", 1), ("b", 1)]]
    assert keys(closest_pairs(seen, max_distance_m=6.9)) == [[("a", 1)], [("b", 1)]]


def test_skeletons_without_a_joint_in_common_cannot_be_paired() -> None:
    seen = [skeleton("a", 1, 0.0, (2, 0)), skeleton("b", 1, 0.0, (0, 2))]
    assert keys(closest_pairs(seen)) == [[("a", 1)], [("b", 1)]]


@st.composite
def rooms(draw: st.DrawFn) -> list[PotentialSkeleton]:
    """Up to four sensors with up to four bodies each, no two pairs equally far apart."""
    counts = draw(st.lists(st.integers(0, 4), min_size=1, max_size=4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return [skeleton(f"s{i}", body, float(rng.normal())) for i, n in enumerate(counts) for body in range(n)]


@given(rooms(), st.randoms(use_true_random=False))
def test_the_order_of_sensors_and_bodies_does_not_change_the_grouping(seen: list[PotentialSkeleton], r: object) -> None:
    shuffled = list(seen)
    r.shuffle(shuffled)  # type: ignore[attr-defined]
    assert keys(closest_pairs(shuffled)) == keys(closest_pairs(seen))


@given(rooms())
def test_every_skeleton_is_in_one_group_and_nothing_more_can_be_joined(seen: list[PotentialSkeleton]) -> None:
    groups = keys(closest_pairs(seen))
    assert sorted(key for group in groups for key in group) == sorted((s.sensor, s.tracking_id) for s in seen)
    sensors = [{sensor for sensor, _ in group} for group in groups]
    assert all(len(names) == len(group) for names, group in zip(sensors, groups, strict=True))
    assert all(a & b for i, a in enumerate(sensors) for b in sensors[:i])


def test_pairs_are_held_until_the_next_calibration() -> None:
    pairs = HeldPairs()
    near = [skeleton("a", 1, 0.0), skeleton("a", 2, 9.0), skeleton("b", 1, 0.1), skeleton("b", 2, 9.1)]
    swapped = [skeleton("a", 1, 9.0), skeleton("a", 2, 0.0), skeleton("b", 1, 0.1), skeleton("b", 2, 9.1)]
    held = [("a", 1), ("b", 1)]
    assert keys(tuple(p.views for p in pairs.update(near, 1)))[0] == held
    assert keys(tuple(p.views for p in pairs.update(swapped, 1)))[0] == held
    assert keys(tuple(p.views for p in pairs.update(swapped, 2)))[0] == [("a", 1), ("b", 2)]


def test_numbers_are_kept_by_those_who_stay_and_never_given_to_others() -> None:
    pairs = HeldPairs()
    assert [p.person for p in pairs.update([skeleton("a", 1, 0.0), skeleton("a", 2, 9.0)], 1)] == [0, 1]
    again = pairs.update([skeleton("a", 2, 9.0), skeleton("a", 5, 0.0)], 2)
    assert [(p.person, p.views[0].tracking_id) for p in again] == [(1, 2), (2, 5)]
    assert [p.person for p in pairs.update([skeleton("a", 6, 0.0)], 3)] == [3]
    pairs.reset()
    assert [p.person for p in pairs.update([skeleton("a", 6, 0.0)], 1)] == [0]


@pytest.mark.parametrize("joined", [True, False])
def test_when_two_people_become_one_or_one_becomes_two_each_number_is_given_once(joined: bool) -> None:
    apart = [skeleton("a", 1, 0.0), skeleton("b", 1, 0.0, (0, 0))]
    together = [skeleton("a", 1, 0.0), skeleton("b", 1, 0.1)]
    two = [skeleton("a", 1, 0.0, (2, 0)), skeleton("b", 1, 0.0, (0, 2))]
    pairs = HeldPairs()
    first, then = (two, together) if joined else (together, two)
    before = [p.person for p in pairs.update(first, 1)]
    after = [p.person for p in pairs.update(then, 2)]
    assert (before, after) == (([0, 1], [0]) if joined else ([0], [0, 1]))
    assert [p.person for p in HeldPairs().update(apart, 1)] == [0]  # of whom nothing is seen is not there


def test_a_new_tracking_id_does_not_change_who_it_is() -> None:
    pairs = HeldPairs()
    pairs.update([skeleton("a", 1, 0.0), skeleton("a", 2, 9.0)], 1)
    pairs.rename("a", {1: 2, 2: 1, 5: 6})
    people = pairs.update([skeleton("a", 1, 0.0), skeleton("a", 2, 9.0)], 1)
    assert [(p.person, p.views[0].tracking_id) for p in people] == [(0, 2), (1, 1)]


def test_nobody_makes_no_groups() -> None:
    assert closest_pairs([]) == ()
    assert HeldPairs().update([], 1) == ()
