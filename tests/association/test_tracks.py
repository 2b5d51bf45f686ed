"""Who is who: people enter, leave, cross, vanish and come back; sensors swap and change their ids."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.association.proportions import SD_M
from mocapella.association.tracks import TrackMemory, Tracks, TrackSettings, assign, distances
from mocapella.errors import SettingsError

DT = 1 / 30
SPINE = np.array([[0.0, 0.9, 0.0], [0.0, 1.2, 0.0], [0.0, 1.6, 0.0]])

Place = tuple[float, float]


def spine(place: Place) -> np.ndarray:
    return SPINE + np.array([place[0], 0.0, place[1]])


def owners(tracks: Tracks, sensor: str, ids: Sequence[int], middles: np.ndarray, at_s: float) -> list[int]:
    """The person of each body of a frame; −1 for nobody."""
    rows = tracks.update(sensor, ids, middles, None, at_s)
    return [-1 if row < 0 else tracks.people[row] for row in rows.tolist()]


class Room:
    """People on paths, seen by sensors that take turns."""

    def __init__(self, *paths: Callable[[float], Place | None], settings: TrackSettings | None = None) -> None:
        self.paths, self.tracks = paths, Tracks(settings)
        self.k = 0
        self.given: list[dict[int, int]] = []

    def run(
        self,
        seconds: float,
        sensors: Sequence[str] = ("front",),
        ids: Callable[[str, int, float], int | None] = lambda *_: 0,
    ) -> None:
        """``ids`` says under which tracking id (plus 100 for each body) a sensor sees a body; None: not."""
        for _ in range(round(seconds / DT)):
            for number, sensor in enumerate(sensors):
                at_s = self.k * DT + number * DT / len(sensors)
                seen = {}
                for body, path in enumerate(self.paths):
                    place, tracking_id = path(at_s), ids(sensor, body, at_s)
                    if place is not None and tracking_id is not None:
                        seen[body] = (tracking_id if tracking_id else 100 * (body + 1), spine(place))
                middles = np.stack([m for _, m in seen.values()]) if seen else np.empty((0, 3, 3))
                people = owners(self.tracks, sensor, [i for i, _ in seen.values()], middles, at_s)
                self.given.append(dict(zip(seen, people, strict=True)))
            self.k += 1

    def people(self, body: int) -> list[int]:
        """Whom the body was given to, once for each change."""
        numbers = [given[body] for given in self.given if body in given]
        return [n for k, n in enumerate(numbers) if k == 0 or n != numbers[k - 1]]


def stands(x: float, z: float = 3.0) -> Callable[[float], Place]:
    return lambda _: (x, z)


@given(arrays(np.float64, (3, 4), elements=st.floats(0, 10)), arrays(np.bool_, (3, 4)))
def test_no_other_assignment_has_more_pairs_or_costs_less(cost: np.ndarray, allowed: np.ndarray) -> None:
    pairs = [(row, column) for row, column in enumerate(assign(cost, allowed).tolist()) if column >= 0]
    assert all(allowed[pair] for pair in pairs)
    assert len({column for _, column in pairs}) == len(pairs)
    best = min(
        (-sum(allowed[r, c] for r, c in enumerate(p)), sum(cost[r, c] for r, c in enumerate(p) if allowed[r, c]))
        for p in permutations(range(4), 3)
    )
    assert len(pairs) == -best[0]
    assert sum(cost[pair] for pair in pairs) == pytest.approx(best[1])


def test_distances_are_means_over_what_both_have() -> None:
    gone = spine((0.5, 0.0))
    gone[1:] = np.nan
    both = distances(np.stack([spine((0.0, 0.0)), gone]), np.stack([spine((3.0, 4.0)), SPINE * np.nan]))
    np.testing.assert_allclose(both, [[5.0, np.inf], [np.hypot(2.5, 4.0), np.inf]])


def test_two_sensors_see_the_same_people_under_their_own_ids() -> None:
    room = Room(stands(-0.5), stands(0.5))
    room.run(1.0, ("front", "side"), lambda sensor, body, _: 7 + body if sensor == "front" else 90 - body)
    assert [room.people(0), room.people(1)] == [[0], [1]]


def test_people_who_cross_keep_their_numbers_though_each_hides_the_other_for_a_while() -> None:
    def hidden(sensor: str, body: int, at_s: float) -> int | None:
        return None if body == 1 and 1.3 < at_s < 1.7 else 0

    room = Room(lambda t: (-1.5 + t, 3.0), lambda t: (1.5 - t, 3.4))
    room.run(3.0, ("front",), hidden)
    assert [room.people(0), room.people(1)] == [[0], [1]]


def test_a_sensor_whose_ids_swap_does_not_swap_the_people() -> None:
    room = Room(stands(-0.5), stands(0.5))
    room.run(2.0, ("front", "side"), lambda _, body, t: 1 + (body + (t > 1.0)) % 2)
    assert [room.people(0), room.people(1)] == [[0], [1]]


def test_who_comes_back_nearby_is_the_same_and_who_comes_back_too_late_is_not() -> None:
    def away(begin: float, end: float) -> Callable[[float], Place | None]:
        return lambda t: None if begin < t < end else (0.0, 3.0)

    room = Room(away(1.0, 3.0), settings=TrackSettings(forget_after_s=5.0))
    room.run(4.0, ("front",), lambda _, body, t: 1 if t < 2.0 else 2)
    assert room.people(0) == [0]
    gone = Room(away(1.0, 8.0), settings=TrackSettings(forget_after_s=5.0))
    gone.run(9.0)
    assert gone.people(0) == [0, 1]


def test_people_enter_and_leave_and_nobody_gets_a_number_twice() -> None:
    room = Room(stands(0.0), lambda t: (1.0, 3.0) if t > 1.0 else None, lambda t: (-1.0, 3.0) if t > 2.0 else None)
    room.run(3.0)
    assert [room.people(body) for body in range(3)] == [[0], [1], [2]]


def test_a_phantom_is_never_confirmed_and_soon_forgotten() -> None:
    room = Room(stands(0.0), lambda t: (1.5, 3.0) if 1.0 < t < 1.1 else None)
    room.run(2.0)
    assert room.tracks.memory.person[room.tracks.memory.confirmed].tolist() == [0]
    assert len(room.tracks.people) == 1


def test_one_person_whom_each_sensor_took_for_another_becomes_one() -> None:
    own = lambda sensor, body, _: 0 if (sensor == "front") == (body == 0) else None  # noqa: E731
    room = Room(stands(0.0), lambda t: (max(0.1, 0.9 - 0.4 * t), 3.0))  # as a calibration that gets better shows them
    room.run(1.0, ("front", "side"), own)
    assert len(room.tracks.people) == 2
    room.run(3.0, ("front", "side"), own)
    assert {given[body] for given in room.given[-4:] for body in given} == {0}
    assert len(room.tracks.people) == 1


@given(
    arrays(np.float64, (3, 2), elements=st.floats(-1.5, 1.5)), arrays(np.float64, (4, 2), elements=st.floats(-1.5, 1.5))
)
def test_bodies_are_given_out_as_the_best_assignment_says(bodies: np.ndarray, people: np.ndarray) -> None:
    """What the compiled step decides by itself is what `assign` would."""
    there, middles = (np.stack([spine(tuple(place)) for place in places]) for places in (people, bodies))
    tracks = Tracks()
    tracks.update("side", range(4), there, None, 0.0)
    apart = distances(middles, there)
    best = assign(apart, apart <= tracks.settings.gate_m)
    given_out = tracks.update("front", range(3), middles, None, DT)
    total = [sum(apart[b, row] for b, row in enumerate(rows) if 0 <= row < 4) for rows in (best, given_out)]
    assert sum(0 <= row < 4 for row in given_out) == (best >= 0).sum()
    assert total[1] == pytest.approx(total[0])


def test_two_whom_one_sensor_sees_both_stay_two_however_close() -> None:
    room = Room(stands(0.0), stands(0.05))
    room.run(2.0, ("front",))
    assert [room.people(0), room.people(1)] == [[0], [1]]


def several(*places: float, seen_by: Sequence[Sequence[int]], settings: TrackSettings | None = None) -> Tracks:
    """Confirmed people 10, 11, … along a line, each seen by some of the sensors 0, 1, …"""
    tracks = Tracks(settings)
    m = tracks.memory = TrackMemory.empty(len(places), 1 + max(map(max, seen_by)), 3)
    m.person[:] = 10 + np.arange(len(places))
    m.middle[:] = [spine((x, 3.0)) for x in places]
    m.confirmed[:] = True
    m.size[:] = np.arange(len(places))[:, None, None]
    m.since_s[:], m.seen_s[:] = -10.0 + np.arange(len(places)), -np.arange(len(places))
    for k, sensors in enumerate(seen_by):
        m.body[k, list(sensors)] = [100 * k + sensor for sensor in sensors]
        m.body_s[k, list(sensors)] = -0.01 * (1 + np.array(sensors))
    return tracks


def joined(tracks: Tracks, *times: float) -> list[list[int]]:
    """The numbers of the people who are left after each time."""
    left = []
    for at_s in times:
        tracks._join(at_s)
        left.append(tracks.people)
    return left


@pytest.mark.parametrize("apart_m", [0.25, 0.3, 0.301])
def test_two_become_one_once_they_have_been_together_for_long_enough(apart_m: float) -> None:
    tracks = several(0.0, apart_m, seen_by=[[0], [1]], settings=TrackSettings(same_within_m=0.3, same_after_s=0.5))
    together = apart_m <= 0.3
    assert joined(tracks, 7.0, 7.499, 7.5) == [[10, 11], [10, 11], [10] if together else [10, 11]]
    assert tracks.merged == (((10, 11),) if together else ())
    joined(tracks, 8.0)
    assert tracks.merged == ()


def test_time_together_is_without_a_break() -> None:
    tracks = several(0.0, 0.25, seen_by=[[0], [1]])
    joined(tracks, 7.0, 7.4)
    tracks.memory.middle[1, :, 0] += 1.0
    joined(tracks, 7.45)
    tracks.memory.middle[1, :, 0] -= 1.0
    assert joined(tracks, 7.5, 7.75, 8.0) == [[10, 11], [10, 11], [10]]


@pytest.mark.parametrize(
    ("seen_by", "left"), [([[0], [1]], [10]), ([[0], [0, 1]], [10, 11]), ([[0, 1], [1]], [10, 11])]
)
def test_two_whom_a_sensor_sees_together_are_two(seen_by: list[list[int]], left: list[int]) -> None:
    assert joined(several(0.0, 0.1, seen_by=seen_by), 7.0, 9.0)[-1] == left


def test_one_whom_nobody_sees_is_joined_to_nobody() -> None:
    tracks = several(0.0, 0.1, seen_by=[[0], [1]])
    tracks.memory.body_s[1] = -np.inf
    assert joined(tracks, 7.0, 9.0)[-1] == [10, 11]


def test_who_is_joined_takes_nobody_along_who_is_only_near_him() -> None:
    """Of three in a row the outer ones are too far apart, so the third stays when the second becomes the first."""
    assert joined(several(0.0, 0.25, 0.5, seen_by=[[0], [1], [2]]), 7.0, 9.0)[-1] == [10, 12]
    assert joined(several(0.0, 0.1, 0.2, seen_by=[[0], [1], [2]]), 7.0, 9.0)[-1] == [10]


@pytest.mark.parametrize("confirmed", [(True, True), (True, False), (False, True), (False, False)])
def test_who_two_become_has_what_is_known_of_either(confirmed: tuple[bool, bool]) -> None:
    """The number and the place are those of the first, and the lengths are, unless only the second is confirmed."""
    for late in (0, 1):
        tracks = several(0.0, 0.1, seen_by=[[0, 3], [1]])
        m = tracks.memory
        m.confirmed[:], m.since_s[late], m.seen_s[late] = confirmed, -2.0, -0.5
        before = tracks.memory.taken(np.arange(2))
        joined(tracks, 7.0, 9.0)
        one = tracks.memory
        assert one.person.tolist() == [10]
        assert one.since_s.tolist() == [before.since_s.min()]
        assert one.seen_s.tolist() == [before.seen_s.max()]
        assert one.confirmed.tolist() == [any(confirmed)]
        assert (one.size == (1.0 if confirmed == (False, True) else 0.0)).all()
        np.testing.assert_array_equal(one.middle[0], before.middle[0])
        np.testing.assert_array_equal(one.body_s[0], before.body_s.max(axis=0))
        assert one.body[0, [0, 1, 3]].tolist() == [0, 101, 3]


def newcomer(*deviations: float, missing_since_s: float = 5.0, seen_for_s: float = 0.15) -> Tracks:
    """One who is new, where others were whose lengths are so many standard deviations longer."""
    count = len(deviations)
    tracks = several(*[0.0] * (count + 1), seen_by=[[0]] * (count + 1))
    m = tracks.memory
    m.size[:, 0], m.size[:, 1] = 0.5 + np.outer([*deviations, 0.0], SD_M), 9.0
    m.body_s[:count], m.seen_s[:count] = -np.inf, -missing_since_s
    m.confirmed[count], m.since_s[count], m.seen_s[count] = False, -seen_for_s, 0.0
    tracks._know_again(0.0)
    return tracks


@pytest.mark.parametrize(
    ("deviations", "at_once", "later"),
    [
        ((1.0,), (10,), (10,)),
        ((1.5,), None, (10,)),  # not half as different as one may be
        ((2.1,), None, None),
        ((1.0, 1.5), (10,), (10,)),
        ((1.5, 1.0), (11,), (11,)),
        ((1.0, 1.2), None, (10,)),  # nearly as like to the other
    ],
)
def test_a_newcomer_is_who_is_missing_and_most_alike_at_once_if_it_is_sure(
    deviations: tuple[float, ...], at_once: tuple[int] | None, later: tuple[int] | None
) -> None:
    new = 10 + len(deviations)
    for seen_for_s, who in ((0.15, at_once), (1.2, later)):
        tracks = newcomer(*deviations, seen_for_s=seen_for_s)
        assert tracks.merged == (((*who, new),) if who else ())
        waits = who is None and seen_for_s < tracks.settings.size_after_s
        assert tracks.memory.confirmed.all() == (not waits)
        assert (new in tracks.people) == (who is None)


@pytest.mark.parametrize(("missing_since_s", "missed"), [(0.2, False), (0.3, True)])
def test_who_was_seen_just_now_is_not_missing_so_that_nobody_else_becomes_him(
    missing_since_s: float, missed: bool
) -> None:
    tracks = newcomer(0.0, missing_since_s=missing_since_s)
    assert tracks.people == ([10] if missed else [10, 11])
    assert tracks.memory.confirmed.all()


def test_a_body_of_whose_middle_nothing_is_seen_is_who_it_was_and_nobody_new() -> None:
    tracks, nothing = Tracks(), np.full((1, 3, 3), np.nan)
    assert owners(tracks, "front", [5], spine((0, 3))[None], 0.0) == [0]
    assert owners(tracks, "front", [5], nothing, DT) == [0]
    assert owners(tracks, "front", [6], nothing, 2 * DT) == [-1]
    assert len(tracks.people) == 1


def test_owners_are_those_of_the_last_frames_of_all_sensors_also_after_people_are_joined_or_forgotten() -> None:
    tracks, told = Tracks(), dict[str, dict[int, int]]()
    assert tracks.owners("front") == {}  # before there is such a sensor
    joined = forgotten = False
    for k in range(240):
        # Each sensor takes one person for another until both are in one place; one more is seen at first.
        far = max(1.2 - 0.01 * k, 0.1)
        places = {"front": {2**64 - 1: -far / 2}, "side": {7: far / 2}}
        if k < 20:
            places["front"][5] = 4.0
        for sensor, bodies in places.items():
            middles = np.stack([spine((x, 3.0)) for x in bodies.values()])
            people = owners(tracks, sensor, list(bodies), middles, k * DT)
            told[sensor] = dict(zip(bodies, people, strict=True))
            for kept, dropped in tracks.merged:
                joined = True
                told = {name: {b: kept if n == dropped else n for b, n in of.items()} for name, of in told.items()}
            for name, of in told.items():
                assert tracks.owners(name).items() >= of.items()
                assert tracks.owners(name) is tracks.owners(name)
                assert set(tracks.owners(name).values()) <= set(tracks.people)
        forgotten = forgotten or 5 not in tracks.owners("front")
    assert joined
    assert forgotten


@given(st.permutations(range(4)), st.integers(0, 3))
def test_the_order_of_bodies_in_a_frame_does_not_matter(order: list[int], missing: int) -> None:
    one, other = Tracks(), Tracks()
    places = np.stack([spine((1.2 * k, 3.0)) for k in range(4)])
    for tracks in (one, other):
        tracks.update("front", range(4), places, None, 0.0)
    order = [body for body in order if body != missing]
    ids = [body + 10 for body in order]
    straight = sorted(order)
    first = dict(zip(straight, owners(one, "front", [b + 10 for b in straight], places[straight], DT), strict=True))
    assert dict(zip(order, owners(other, "front", ids, places[order], DT), strict=True)) == first
    assert first == {body: body for body in straight}


@pytest.mark.parametrize("wait_s", [0.0, 0.125])
def test_a_new_person_is_confirmed_once_the_wait_is_over_without_one_at_the_first_sight(wait_s: float) -> None:
    tracks = Tracks(TrackSettings(confirm_after_s=wait_s))
    tracks.update("front", [5], spine((0.0, 3.0))[None], None, 0.0)
    assert tracks.memory.confirmed.tolist() == [wait_s == 0.0]
    tracks.update("front", [5], spine((0.0, 3.0))[None], None, 0.125)
    assert tracks.memory.confirmed.tolist() == [True]


@pytest.mark.parametrize("name", ["gate_m", "forget_after_s"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        TrackSettings(**{name: 0.0})
