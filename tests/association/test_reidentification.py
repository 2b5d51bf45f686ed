from __future__ import annotations

import numpy as np
from support.standing_people import HEAD, bodies, inverse, sensor_at, somebody, without

from mocapella.association.reidentification import reidentified
from mocapella.model.scene import Person, PotentialSkeleton

ME, YOU = somebody(0), somebody(1)
FRONT = inverse(sensor_at(0.0))
TRACKED = np.full(25, 2, dtype=np.uint8)


def person(number: int, at: np.ndarray, lost: int, T_world_sensor: np.ndarray = FRONT) -> Person:
    """A person whom others see there, and of whom the front sensor has a view under this id."""
    view = PotentialSkeleton("front", lost, 0, 0.0, 0.0, T_world_sensor, np.full((25, 3), np.nan), TRACKED * 0)
    return Person(number, at, TRACKED, (view,))


def test_who_is_where_the_others_see_somebody_lost_is_that_person() -> None:
    now = bodies("front", [ME + np.array([0.3, 0, 0])], ids=[9])
    assert reidentified(now, [person(0, ME, 1)], 0.31) == {1: 9}
    assert reidentified(now, [person(0, ME, 1)], 0.29) == {}
    assert reidentified(now, [person(0, ME, 1)], 0.0) == {}


def test_the_closest_go_first_and_each_only_once() -> None:
    now = bodies("front", [YOU, ME + np.array([0.1, 0, 0]), ME], ids=[7, 8, 9])
    people = [person(0, ME, 1), person(1, YOU + np.array([0, 0.1, 0]), 2)]
    assert reidentified(now, people, 5.0) == {1: 9, 2: 7}


def test_each_is_brought_to_the_world_in_the_lost_ones_own_way() -> None:
    aside = FRONT.copy()
    aside[0, 3] += 2.0
    now = bodies("front", [ME - np.array([2.0, 0, 0])], ids=[9])
    assert reidentified(now, [person(0, ME, 1), person(1, ME, 2, aside)], 0.2) == {2: 9}


def test_whom_the_sensor_still_sees_is_not_lost_and_who_is_known_is_not_new() -> None:
    assert reidentified(bodies("front", [ME, ME], ids=[1, 9]), [person(0, ME, 1)], 1.0) == {}
    people = [person(0, ME, 1), person(1, YOU, 2)]
    assert reidentified(bodies("front", [ME], ids=[2]), people, 1.0) == {}
    assert reidentified(bodies("side", [ME], ids=[9]), people, 1.0) == {}


def test_without_a_joint_that_both_track_nobody_can_be_told() -> None:
    only_head = 2 - without(HEAD)
    now = bodies("front", [ME], ids=[9], states=only_head)
    seen = person(0, ME, 1)
    assert reidentified(now, [seen], 1.0) == {1: 9}
    others = Person(0, ME, without(HEAD)[0], seen.views)
    assert reidentified(now, [others], 1.0) == {}
