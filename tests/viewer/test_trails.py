"""A trail is where somebody was: in that order, for so long, and nowhere that they did not go."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import KINECT, Room

from mocapella.viewer.palette import FLOOR, person_colour
from mocapella.viewer.trails import LONGEST_S, TrailChoice, TrailOf, Trails

ROOM = Room(people=2, sensors=1)
STILL = ROOM.scene(0.0, ROOM.frames(0.0))


def at(t, shift=(0.0, 0.0, 0.0), people=(1, 2)):
    """The room's people, all moved by ``shift``, at ``t`` seconds."""
    moved = tuple(
        msgspec.structs.replace(person, positions=person.positions + np.array(shift))
        for person in STILL.people
        if person.id in people
    )
    return msgspec.structs.replace(STILL.with_parts(people=moved), at_ns=round(t * 1e9))


def walked(seconds, rate=30, **more):
    trails = Trails()
    for k in range(round(seconds * rate)):
        trails.learn(at(k / rate, (0.5 * k / rate, 0, 0)), 0)
    return trails


def here(_):
    return np.eye(4)


@given(st.sampled_from(list(TrailOf)), st.floats(2.0, LONGEST_S))
def test_a_trail_goes_back_as_far_as_was_chosen_and_ends_where_the_person_is(of, seconds):
    trails = walked(8.0)
    points, colours = trails.lines(of, seconds, here)
    assert points.shape == colours.shape
    traced = {TrailOf.NOTHING: 0, TrailOf.FLOOR: 1, TrailOf.HEAD: 1, TrailOf.HANDS: 2, TrailOf.FEET: 2}[of]
    if not traced:
        assert len(points) == 0
        return
    assert len(points) == pytest.approx(2 * traced * min(seconds, 7.9) * 10, abs=4 * traced)
    length = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1).sum() / (2 * traced)
    assert length == pytest.approx(0.5 * min(seconds, 7.9), abs=0.1)


def test_the_trail_on_the_floor_is_on_it_and_each_person_has_their_colour():
    points, colours = walked(2.0).lines(TrailOf.FLOOR, 10.0, here)
    assert np.ptp(points[..., 1]) == 0
    ends = {tuple(shade) for shade in colours.reshape(-1, 3)}
    assert {tuple(person_colour(1)), tuple(person_colour(2))} <= ends


def test_a_trail_fades_into_the_floor():
    _, colours = walked(8.0).lines(TrailOf.HEAD, 4.0, here)
    one = colours[: len(colours) // 2, 0].astype(int)
    away = np.abs(one - np.array(FLOOR)).sum(axis=-1)
    assert (np.diff(away) >= 0).all()
    assert away[0] < 30


def test_a_leap_or_an_absence_leaves_a_gap():
    trails = Trails()
    for k in range(30):
        trails.learn(at(k / 10, (3.0 if k >= 10 else 0.0, 0, 0), people=(1, 2) if k < 15 or k >= 28 else (1,)), 0)
    points, _ = trails.lines(TrailOf.FLOOR, 10.0, here)
    assert np.linalg.norm(points[:, 1] - points[:, 0], axis=-1).max() < 0.01
    assert len(points) == 28 + 14  # of the second: 13 without the leap, and 1 after the absence


def test_nan_draws_nothing():
    trails, gone = Trails(), KINECT.index("HandLeft")
    for k in range(10):
        scene = at(k / 10)
        scene.people[0].positions[gone] = np.nan
        trails.learn(scene, 0)
    points, _ = trails.lines(TrailOf.HANDS, 10.0, here)
    assert np.isfinite(points).all()
    assert len(points) == 3 * 9


def test_who_is_not_there_or_not_on_the_stage_has_no_trail():
    trails = walked(2.0)
    points, _ = trails.lines(TrailOf.FLOOR, 10.0, lambda person: np.eye(4) if person.id == 1 else None)
    assert len(points) == 19
    trails.learn(at(2.1, people=(2,)), 0)
    assert len(trails.lines(TrailOf.FLOOR, 10.0, lambda person: np.eye(4) if person.id == 1 else None)[0]) == 0


def test_another_world_or_a_clock_that_was_set_back_begins_anew():
    trails = walked(3.0)
    trails.learn(at(3.1), 1)
    assert len(trails.lines(TrailOf.FLOOR, 10.0, here)[0]) == 0
    trails = walked(3.0)
    trails.learn(at(-2 * LONGEST_S), 0)
    assert len(trails.lines(TrailOf.FLOOR, 10.0, here)[0]) == 0


def test_what_is_remembered_is_bounded():
    trails = Trails()
    for k in range(900):
        trails.learn(at(k / 5, people=(1,) if k % 2 else (2,)), 0)
    assert set(trails._people) == {1, 2}
    assert all(len(steps.at_s) <= LONGEST_S * 10 for steps in trails._people.values())
    for k in range(900, 1300):
        trails.learn(at(k / 5, people=(1,)), 0)
    assert set(trails._people) == {1}


def test_nothing_is_shown_at_first():
    assert TrailChoice().of is TrailOf.NOTHING
