"""When the method webcams confirms a candidate, keeps a person, and doubts a camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import Matches, Rays
from mocapella.model.topology import topology
from mocapella.tracker.webcams import UNSURE_M, UNSURE_S, WebcamsTracker, _unsure
from mocapella.tracker.webcams_identity import FLOOR_M, STANDING_S, Identities, floor_of, ready
from mocapella.tracker.webcams_memory import (
    CANDIDATE,
    LIFTED_M,
    LONG_SEEN,
    MOST_MISSED,
    ROAMED_M,
    PeopleArrays,
    no_people,
)
from mocapella.tracker.webcams_people_kernels import DOUBLE_M, DOUBLE_S, LIFTED_S
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SETTINGS = WebcamsSettings()
FOUR = circle_of_cameras(4)
NONE_MISSED = np.zeros(4)
UP = np.array([0.0, 1.0, 0.0])
ANKLE = topology("halpe_26").index("LAnkle")


def person(number: int, *, hits: int = 100, walked_m: float = 0.0) -> PeopleArrays:
    """A person at the origin about whom two cameras agreed at the time 10 s."""
    people = no_people(10, 4)
    people.ids[0], people.hits[0], people.roamed[0] = number, hits, walked_m
    people.at_s[0] = people.seen_s[0] = people.agreed_s[0] = 10.0
    people.positions[0] = standing_person()
    people.agreed_place[0] = people.positions[0].mean(axis=0)
    people.covariances[0] = 1e-4 * np.eye(3)
    return people


def cameras_at(*degrees: float) -> Float64:
    """The centres (cameras, 3) of four cameras 3 m from the person; those that are not given are far away."""
    angles = np.radians([*degrees, *[180.0] * (4 - len(degrees))])
    return 3.0 * np.stack([np.sin(angles), np.zeros(4), np.cos(angles)], axis=1) + person(0).agreed_place[0]


def confirmed(
    people: PeopleArrays, origins: Float64, missed: Float64 = NONE_MISSED, *, known: bool = False,
    floor: float = float("nan"),
) -> bool:  # fmt: skip
    agreed = np.zeros((len(people.ids), 4), dtype=np.bool_)
    agreed[0, :2] = True
    return ready(people, SETTINGS, agreed, origins, missed=missed, floor=floor, up=UP, known=lambda _: known) == [0]


@pytest.mark.parametrize(
    ("degrees", "walked", "known", "expected"),
    [
        (60.0, False, False, True),
        (20.0, False, False, False),
        (20.0, True, False, True),
        (10.0, True, False, False),
        (160.0, True, False, False),
        (10.0, False, True, True),
    ],
)
def test_two_cameras_confirm_a_candidate_by_their_angle(
    degrees: float, walked: bool, known: bool, expected: bool
) -> None:
    people = person(CANDIDATE, walked_m=ROAMED_M if walked else 0.0)
    assert confirmed(people, cameras_at(0.0, degrees), known=known) == expected


ANKLES_M = float(standing_person()[ANKLE, 1])
"""Height of the ankles of a standing person [m]."""


@pytest.mark.parametrize(
    ("degrees", "floor", "after_s", "hits", "expected"),
    [
        (20.0, ANKLES_M, STANDING_S, LONG_SEEN, True),
        (20.0, ANKLES_M + 0.9 * FLOOR_M, STANDING_S, LONG_SEEN, True),
        (20.0, ANKLES_M - 2.0 * FLOOR_M, STANDING_S, LONG_SEEN, False),  # two strangers on one line
        (20.0, float("nan"), STANDING_S, LONG_SEEN, False),
        (20.0, ANKLES_M, 0.5 * STANDING_S, LONG_SEEN, False),
        (20.0, ANKLES_M, STANDING_S, LONG_SEEN - 1, False),
        (10.0, ANKLES_M, STANDING_S, LONG_SEEN, False),
        (160.0, ANKLES_M, STANDING_S, LONG_SEEN, False),
    ],
)
def test_a_candidate_who_stands_on_the_floor_may_be_seen_at_a_smaller_angle(
    degrees: float, floor: float, after_s: float, hits: int, expected: bool
) -> None:
    people = person(CANDIDATE, hits=hits)
    people.born_s[0] = people.at_s[0] - 1.01 * after_s
    assert confirmed(people, cameras_at(0.0, degrees), floor=floor) == expected
    people.refuted[0, 2:] = 1.0  # two other cameras see nobody there
    assert not confirmed(people, cameras_at(0.0, degrees), floor=floor)


@given(st.floats(-1.0, 3.0), st.floats(0.0, 0.1))
def test_the_floor_is_where_well_known_people_stand(height: float, sd_m: float) -> None:
    people = person(3)
    people.sure[0], people.heights[0], people.height_variances[0] = LONG_SEEN, height, sd_m**2
    assert floor_of(people, UP) == pytest.approx(height)


def test_the_floor_is_not_known_of_few_instants_moving_ankles_or_another_vertical() -> None:
    people = person(3)
    people.sure[0], people.heights[0] = LONG_SEEN, 0.1
    assert floor_of(people, UP) == pytest.approx(0.1)
    people.height_variances[0] = 0.2**2
    assert np.isnan(floor_of(people, UP))
    people.height_variances[0], people.sure[0] = 0.0, LONG_SEEN - 1
    assert np.isnan(floor_of(people, UP))
    people.sure[0], people.positions[0] = LONG_SEEN, people.positions[0][:, [0, 2, 1]]  # people stand along z
    assert np.isnan(floor_of(people, UP))
    assert np.isnan(floor_of(no_people(10, 4), UP))


def test_a_candidate_has_walked_only_after_enough_instants() -> None:
    people = person(CANDIDATE, hits=LONG_SEEN - 1, walked_m=ROAMED_M)
    assert not confirmed(people, cameras_at(0.0, 20.0))


def test_cameras_that_see_no_person_hold_back_a_candidate_who_stands() -> None:
    origins = cameras_at(0.0, 60.0)
    for walked_m, missed, expected in ((0.0, 0.0, False), (ROAMED_M, 0.0, True), (0.0, MOST_MISSED, True)):
        people = person(CANDIDATE, walked_m=walked_m)
        people.refuted[0, 2:] = 1.0
        assert confirmed(people, origins, np.array([0.0, 0.0, missed, missed])) == expected


def test_a_person_returns_within_the_stated_time_only() -> None:
    people, identities = person(7), Identities(SETTINGS)
    people.lengths[0] = 0.4
    identities.lose(people, 0)
    people.ids[0] = CANDIDATE
    assert identities.returns(people, 0, 10.5)
    assert identities.returns(people, 0, 10.0 + SETTINGS.remember_s)
    assert not identities.returns(people, 0, 10.1 + SETTINGS.remember_s)


def dropped(people: PeopleArrays, after_s: float, *, looking: int = 4) -> bool:
    """Whether a person is lost a time after two cameras agreed."""
    tracker, gone = WebcamsTracker(FOUR), np.zeros(len(people.ids), dtype=np.bool_)
    in_image = np.full(len(people.ids), looking)
    tracker._kernels.drop(people, 10.0 + after_s, tracker._limits, in_image, NONE_MISSED, UP, gone)
    return bool(gone[0])


@pytest.mark.slow
def test_an_unseen_person_is_kept_longer_where_others_hide_the_place() -> None:
    between = 0.5 * (SETTINGS.unseen_s + SETTINGS.hidden_s)
    assert not dropped(person(0), 0.9 * SETTINGS.unseen_s, looking=0)
    assert not dropped(person(0), between)
    assert dropped(person(0), 1.1 * SETTINGS.hidden_s)
    assert dropped(person(0), between, looking=0)  # out of all images
    assert dropped(person(0, hits=LONG_SEEN - 1), between)
    people = person(0)
    people.refuted[0, 0] = 1.0  # a camera sees that nobody is there
    assert dropped(people, between)


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "sd_m"), [(1.0, 0.05), (-1.0, 0.05), (1.0, 0.3)])
def test_a_body_far_above_or_below_its_height_is_lost_unless_two_cameras_agree(sign: float, sd_m: float) -> None:
    soon = 1.2 * LIFTED_S
    for height, views, hits, expected in (
        (0.9 * (LIFTED_M + sd_m), 1, 100, False),
        (1.1 * (LIFTED_M + sd_m), 1, 100, True),
        (1.1 * (LIFTED_M + sd_m), 2, 100, False),
        (1.1 * (LIFTED_M + sd_m), 1, LONG_SEEN - 1, False),
    ):
        people = person(0, hits=hits)
        people.heights[0], people.height_variances[0] = people.positions[0] @ UP, sd_m**2
        people.positions[0] += sign * height * UP
        people.agreed_place[0] = people.positions[0].mean(axis=0)
        people.seen_s[0], people.cameras[0] = 10.0 + soon, views
        assert dropped(people, soon) == expected
        assert not dropped(people, 0.5 * LIFTED_S)


@pytest.mark.parametrize(("above", "expected"), [(0.0, True), (0.9, True), (1.2, False), (-1.2, False), (np.nan, True)])
def test_two_cameras_confirm_no_candidate_in_the_air_or_below_the_floor(above: float, expected: bool) -> None:
    people = person(CANDIDATE)
    assert confirmed(people, cameras_at(0.0, 60.0), floor=ANKLES_M - above * LIFTED_M) == expected
    people.support[0] = 3  # three cameras agree: somebody on a stage
    assert confirmed(people, cameras_at(0.0, 60.0), floor=ANKLES_M - above * LIFTED_M)


def test_a_person_at_an_unknown_place_is_not_shown_and_comes_back_with_the_number() -> None:
    people = person(5)
    assert _unsure(people, np.array([0]), 10.0 + 2.0 * UNSURE_S).tolist() == [False]
    people.covariances[0] = UNSURE_M**2 * np.eye(3)
    assert _unsure(people, np.array([0]), 10.0 + 2.0 * UNSURE_S).tolist() == [True]
    assert _unsure(people, np.array([0]), 10.0 + 0.5 * UNSURE_S).tolist() == [False]
    assert _unsure(people, np.array([], dtype=np.intp), 10.0).tolist() == []


@pytest.mark.slow
def test_a_person_about_whom_two_cameras_hardly_agreed_is_soon_lost() -> None:
    for hits, after_s, expected in (
        (1, 0.4, False),
        (1, 0.5, True),
        (8, 1.0, False),
        (8, 2.0, True),
        (100, 9.0, False),
    ):
        people = person(0, hits=hits)
        people.seen_s[0], people.cameras[0] = 10.0 + after_s, 1
        assert dropped(people, after_s) == expected


@pytest.mark.slow
@given(st.integers(1, 100), st.integers(1, 100), st.floats(0.0, 0.8))
def test_the_second_track_of_a_person_ends_and_the_longer_number_stays(first: int, second: int, share: float) -> None:
    kernels, agreed = WebcamsTracker(FOUR)._kernels, np.zeros((32, 4), dtype=np.bool_)

    def ended(*, apart_m: float = 0.1, cameras: int = 1, after_s: float = 1.0, both: bool = False) -> tuple[bool, int]:
        people = person(4, hits=first)
        for array in people:
            array[1] = array[0]
        people.ids[1], people.hits[1], people.cameras[:2] = 9, second, (2, cameras)
        people.positions[1, :, 0] += apart_m
        people.agreed_s[1] = 11.0 - after_s
        agreed[0, :2] = True
        agreed[1] = both
        gone = np.zeros(len(people.ids), dtype=np.bool_)
        kernels.join_doubles(people, 11.0, agreed, gone)
        assert not gone[0]
        return bool(gone[1]), int(people.ids[0])

    assert ended(apart_m=share * DOUBLE_M) == (True, 9 if second > first else 4)
    for kept in ({"apart_m": 1.1 * DOUBLE_M}, {"cameras": 2}, {"after_s": 0.5 * DOUBLE_S}, {"both": True}):
        assert ended(**kept) == (False, 4)  # type: ignore[arg-type]


@pytest.mark.slow
def test_one_camera_keeps_a_person_until_the_place_is_vague() -> None:
    for sd_m, after_s, expected in ((0.1, 5.0, False), (0.1, 10.1, True), (0.4, 1.4, False), (0.4, 1.6, True)):
        people = person(0)
        people.seen_s[0], people.cameras[0] = 10.0 + after_s, 1
        people.covariances[0] = sd_m**2 / 3 * np.eye(3)
        assert dropped(people, after_s) == expected


@pytest.mark.slow
def test_a_person_about_whom_three_cameras_never_agreed_is_kept_after_walking() -> None:
    for walked_m in (0.0, ROAMED_M):
        people = person(0, walked_m=walked_m)
        people.cameras[0], people.refuted[0] = 2, 1.0
        assert dropped(people, 0.0) == (walked_m == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("owners", "grows"), [((-1, 3), True), ((3, 3), False), ((-1, -1), True), ((-1,), False)])
def test_a_camera_that_sees_only_strangers_is_doubted_if_others_see_people(
    owners: tuple[int, ...], grows: bool
) -> None:
    tracker, count = WebcamsTracker(FOUR), len(owners)
    nothing = np.full(count, -1)
    rays = Rays(
        np.arange(count), np.zeros(count), np.zeros((count, 26, 3)), np.ones((count, 26)), np.ones((count, 26))
    )  # fmt: skip
    matches = Matches(np.array(owners), np.zeros(count, dtype=np.bool_), nothing, np.full(count, np.nan))
    before = tracker._counts.spread.copy()
    for _ in range(100):
        tracker._kernels.doubt_unmatched(rays, matches, tracker._gates, tracker._counts)
    assert (tracker._counts.spread[0] > before[0]) == grows
    assert tracker._counts.spread[0] <= 12.0
    assert tracker._counts.spread[3] == before[3]


def test_a_body_with_left_and_right_exchanged_above_the_hips_is_twisted() -> None:
    from mocapella.tracker.webcams_bodies_kernels import SHOULDERS, twisted

    body = standing_person()
    assert not twisted(body)
    body[SHOULDERS] = body[SHOULDERS[::-1]]
    assert twisted(body)
    body[SHOULDERS] = np.nan
    assert not twisted(body)
