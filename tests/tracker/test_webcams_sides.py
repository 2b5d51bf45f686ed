"""Exchanged sides are told by cameras that see them apart, and a person before one camera does not leap."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import Matches, Rays
from mocapella.model.topology import topology
from mocapella.tracker.webcams_bodies_kernels import MOST_APART, SIDES_APART, limit_approach, sides_apart, turn
from mocapella.tracker.webcams_memory import PeopleArrays, no_people
from mocapella.tracker.webcams_warmup import standing_person

Float64 = NDArray[np.float64]

BODY = standing_person()
MIRROR = np.array(topology("halpe_26").mirror)
FRONT, ASIDE = np.array([0.0, 1.0, 4.0]), np.array([4.0, 1.0, 0.6])
SD_RAD = 0.004


def seen(positions: Float64, origins: Float64) -> Rays:
    """Rays of one detection in each camera, of a body."""
    directions = positions[None] - origins[:, None]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    count = len(origins)
    return Rays(np.arange(count), np.zeros(count), directions, np.full((count, 26), SD_RAD), np.full((count, 26), 0.9))


def someone() -> PeopleArrays:
    people = no_people(10, 2)
    people.ids[0], people.hits[0], people.positions[0] = 0, 100, BODY
    return people


def matches(*swapped: bool) -> Matches:
    count = len(swapped)
    return Matches(np.zeros(count, np.int64), np.array(swapped), np.full(count, -1, np.int64), np.zeros(count))


def test_a_camera_in_front_sees_the_sides_apart_and_one_beside_does_not() -> None:
    rays = seen(BODY, np.stack([FRONT, ASIDE]))
    front, aside = (sides_apart(BODY, rays, d, origin) for d, origin in enumerate((FRONT, ASIDE)))
    assert front > MOST_APART
    assert front > 4.0 * aside
    rays.confidences[:] = 0.0
    assert sides_apart(BODY, rays, 0, FRONT) == 0.0


def turned_after(origins: Float64, *swapped: bool) -> int:
    """Number of instants after which the person begins anew with the sides exchanged; 100 for never."""
    people, rays = someone(), seen(BODY, origins)
    for k in range(1, 100):
        if turn(people, 0, rays, origins, matches(*swapped)) == 1:
            return k
    return 100


def test_a_clear_camera_outvotes_one_that_hardly_sees_the_sides() -> None:
    origins = np.stack([FRONT, ASIDE])
    aside = sides_apart(BODY, seen(BODY, origins), 1, ASIDE)
    assert aside > SIDES_APART  # it has a vote
    assert turned_after(origins, True, False) < 25
    assert turned_after(origins, False, True) == 100
    assert turned_after(np.stack([FRONT, FRONT + 0.5]), True, False) == 100  # two clear cameras that disagree


MODEL: Any = SimpleNamespace(layout=SimpleNamespace(angles=0))


@pytest.mark.parametrize("away_m", [-0.5, -0.01, 0.02, 0.3])
def test_a_person_before_one_camera_moves_along_its_line_by_a_limited_distance(away_m: float) -> None:
    people, before = someone(), np.array([0.0, 1.0, 0.0])
    step = np.array([0.2, 0.0, 0.0]) + away_m * (before - FRONT) / 4.0
    people.rows[0, :3], people.positions[0] = before + step, BODY + step
    limit_approach.py_func(MODEL, people, 0, FRONT, before, 0.08)
    moved = people.rows[0, :3] - before
    assert moved[0] == pytest.approx(0.2)  # across, it moves as far as the camera sees
    assert -moved[2] == pytest.approx(np.clip(away_m, -0.08, 0.08))
    np.testing.assert_allclose(people.positions[0], BODY + moved, atol=1e-12)
