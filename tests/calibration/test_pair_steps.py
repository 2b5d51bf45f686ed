"""What a frame and a refresh do with each pair of sensors: one rule at a time, with stand-ins for the rest."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.calibration import pair_memory as at
from mocapella.calibration import pairs_from_people
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import (
    MIRRORED_STREAM,
    NOT_ONE_BODY,
    WALK,
    WALK_ACROSS,
    PairCalibration,
    PairEstimate,
)
from mocapella.calibration.pair_memory import new_body
from mocapella.calibration.pairs_from_people import MOST_TURNS, REFRESH_PART, by_sensor
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.sensor_pair import BY_LAYOUT, NO_OWNERS, PairOfSensors
from mocapella.calibration.time_offset import TimeOffset

AB, AC, BC = ("a", "b"), ("a", "c"), ("b", "c")
SETTINGS = PeopleCalibration().settings
UNKNOWN = TimeOffset(0.0, 0.1, False)


def estimate(problem: str = "", motion_s: float = 5.0) -> PairEstimate:
    return PairEstimate(np.eye(4), np.eye(6), 0.02, 0.03, motion_s, 9.0, 0.05, UNKNOWN, UNKNOWN, problem)


def pair(problem: str | None = "", *, walked: bool = True, **more: Any) -> PairOfSensors:
    calibration = PairCalibration()
    calibration.scalars[at.BLOCKS_CLOSED] = 99.0 * walked
    found = None if problem is None else estimate(problem)
    return PairOfSensors(calibration, ColdStart(SETTINGS.pair), estimate=found, **{"shown": True, **more})


def watching(pairs: dict[tuple[str, str], PairOfSensors], **bodies: list[int]) -> PeopleCalibration:
    """Sensors with these bodies, which move; no frame is there."""
    people = PeopleCalibration()
    for name in sorted({name for key in pairs for name in key} | set(bodies)):
        mine = {body: f"{name}{body}" for body in bodies.get(name, [1])}
        people._tracks[name] = SimpleNamespace(frozen=np.nan, bodies=mine)  # type: ignore[assignment]
        people._newest[name] = 0.0
    people._pairs = pairs
    people._choose_pairs(None)
    return people


def test_frames_refine_what_is_known_and_try_what_is_not_among_the_chosen_pairs() -> None:
    known, new, doubted = pair(trying=False), PairOfSensors(None, ColdStart(SETTINGS.pair)), pair(trying=True)
    people = watching({AB: known, AC: new, BC: doubted})
    assert people._refined == {"a": (AB,), "b": (AB, BC), "c": (BC,)}
    assert people._tried == {"a": (AC,), "b": (BC,), "c": (AC, BC)}
    people._choose_pairs(frozenset({AB, AC}))
    assert people._refined == {"a": (AB,), "b": (AB,), "c": ()}
    assert people._tried == {"a": (AC,), "b": (), "c": (AC,)}
    assert by_sensor("abc", [BC, AB]) == {"a": (AB,), "b": (BC, AB), "c": (BC,)}


class Refined:
    """Notes which bodies a pair is refined by; some of them have no new frame."""

    def __init__(self, *bodies: tuple[int, int], old: tuple[tuple[int, int], ...] = ()) -> None:
        self.bodies: dict[tuple[int, int], Any] = dict.fromkeys(bodies)
        self.walked, self.old, self.asked = True, old, list[tuple[int, int]]()

    def update(self, ids: tuple[int, int], a: str, b: str, *_: Any) -> bool:
        assert (a, b) == (f"a{ids[0]}", f"b{ids[1]}")
        self.asked.append(ids)
        return ids not in self.old


def refined(one: PairOfSensors, calls: int = 1, people: Any = None, **bodies: list[int]) -> list[tuple[int, int]]:
    where = {"a": [1, 2, 3, 4, 5], "b": [1, 2, 3, 4, 5], **bodies}
    watched = watching({AB: one}, **where)
    for _ in range(calls):
        watched._refine(AB, people, 10.0)
    return getattr(one.calibration, "asked", [])


def test_people_refine_a_pair_in_turn_the_matched_ones_first_and_each_once() -> None:
    one = pair(matched=((2, 3), (1, 1)))
    one.calibration = Refined((1, 1), (4, 4))  # type: ignore[assignment]
    assert refined(one, 7) == [(2, 3), (1, 1), (4, 4), (2, 3), (1, 1), (4, 4), (2, 3)]
    assert one.due == 10.0 + SETTINGS.pair.every_s


def test_a_person_without_a_new_frame_gives_way_to_the_next_up_to_a_limit() -> None:
    four = ((1, 1), (2, 2), (3, 3), (4, 4))
    one = pair(matched=four)
    one.calibration = Refined(old=four[:2])  # type: ignore[assignment]
    assert refined(one) == [*four[:3]]
    assert one.due > 0
    idle = pair(matched=four)
    idle.calibration = Refined(old=four)  # type: ignore[assignment]
    assert refined(idle, 2) == [four[k % 4] for k in range(2 * MOST_TURNS)]
    assert idle.due == -np.inf


def test_whom_either_sensor_sees_no_more_refines_nothing() -> None:
    for gone in ({"a": [2, 4]}, {"b": [2, 4]}):
        one = pair(matched=((1, 1), (2, 2)))
        one.calibration = Refined((3, 3), (4, 4))  # type: ignore[assignment]
        assert refined(one, 3, **gone) == [(2, 2), (4, 4), (2, 2)]
    for nobody in ({"a": []}, {"b": []}):
        one = pair(matched=((1, 1),))
        one.calibration = Refined((1, 1))  # type: ignore[assignment]
        assert refined(one, **nobody) == []


def test_people_that_are_told_match_bodies_where_the_pose_is_trusted_and_only_when_they_change() -> None:
    told: dict[str, Mapping[int, int]] = {"a": {1: 7, 2: 8}, "b": {4: 8, 5: 7}}
    for problem, matched in (("", ((1, 5), (2, 4))), (NOT_ONE_BODY, ((3, 3),))):
        one = pair(problem, matched=((3, 3),))
        one.calibration = Refined()  # type: ignore[assignment]
        refined(one, people=told.__getitem__)
        assert one.matched == matched
    one.estimate, one.matched = estimate(), ((3, 3),)
    one.owners = (told["a"], told["b"])
    refined(one, people=told.__getitem__)
    assert one.matched == ((3, 3),)
    for name in "ab":
        told = {**told, name: dict(told[name])}
        one.matched = ((3, 3),)
        refined(one, people=told.__getitem__)
        assert one.matched == ((1, 5), (2, 4))
        assert one.owners == (told["a"], told["b"])


def test_hypotheses_of_a_sensors_pairs_are_tried_in_turn_where_both_see_somebody() -> None:
    tried = []

    class Cold(ColdStart):
        def update(self, a: Any, b: Any, *_: Any) -> None:
            tried.append((min(a.bodies.values()), min(b.bodies.values())))

    people = watching({key: PairOfSensors(None, Cold(SETTINGS.pair)) for key in (AB, AC, BC)}, c=[])
    for _ in range(6):
        people._try((AB, AC, BC))
    assert tried == [("a1", "b1")] * 2
    people = watching({key: PairOfSensors(None, Cold(SETTINGS.pair)) for key in (AB, AC, BC)})
    tried.clear()
    for _ in range(6):
        people._try((AB, AC, BC))
    assert tried == [("a1", "c1"), ("b1", "c1"), ("a1", "b1")] * 2


class Judged:
    """A hypothesis, and what most agree on, with notes of what is asked."""

    def __init__(self, problem: str, agreed: PairCalibration | None = None) -> None:
        self.pair, self.problem, self.result, self.wary = PairCalibration(), problem, agreed, list[bool]()
        self.hypotheses: dict[Any, PairCalibration] = {}

    def likeliest(self) -> Judged:
        return self

    def judged(self, raw: PairEstimate, *, wary: bool) -> PairEstimate:
        self.wary.append(wary)
        return msgspec.structs.replace(raw, problem=self.problem)

    def agreed(self, a: Any, b: Any, believed: PairCalibration | None) -> PairCalibration | None:
        return self.result or believed


def judge(monkeypatch: pytest.MonkeyPatch, one: PairOfSensors, cold: Judged, **bodies: list[int]) -> PeopleCalibration:
    monkeypatch.setattr(pairs_from_people, "estimates", lambda pairs: [estimate("raw") for _ in pairs])
    one.cold = cold  # type: ignore[assignment]
    people = watching({AB: one}, **bodies)
    people._judge_hypotheses([AB], 3.0)
    return people


def test_a_hypothesis_needs_more_where_others_could_be_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(**more: Any) -> PairOfSensors:
        return PairOfSensors(None, ColdStart(SETTINGS.pair), **more)

    for one, bodies, wary in (
        (nothing(), {}, False), (nothing(), {"a": [1, 2]}, True), (nothing(), {"b": [1, 2]}, True),
        (nothing(wary=True), {}, True), (pair(walked=True), {}, True), (pair(walked=False), {}, False),
    ):  # fmt: skip
        cold = Judged(WALK)
        judge(monkeypatch, one, cold, **bodies)
        assert cold.wary == [wary]


def test_a_trusted_hypothesis_is_accepted_and_what_most_agree_on_is_tried_until_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    new, cold = PairOfSensors(None, ColdStart(SETTINGS.pair)), Judged("")
    people = judge(monkeypatch, new, cold)
    assert new.calibration is cold.pair
    assert (new.shown, new.agreed_at, people._completed, people._moves) == (True, 3.0, 1, 0)
    agreed = PairCalibration()
    new = PairOfSensors(None, ColdStart(SETTINGS.pair))
    judge(monkeypatch, new, Judged(WALK, agreed))
    assert new.calibration is agreed
    assert new.estimate is not None
    assert (new.estimate.problem, new.agreed_at, new.judged_steps) == (WALK, 3.0, -1.0)
    assert new.quality.startswith("a–b: ")
    unproven = pair(shown=False, judged_steps=5.0)
    before, kept = unproven.estimate, unproven.calibration
    judge(monkeypatch, unproven, Judged(WALK))
    assert (unproven.estimate, unproven.calibration, unproven.judged_steps) == (before, kept, 5.0)
    judge(monkeypatch, unproven, Judged(WALK, agreed))
    assert (unproven.estimate, unproven.calibration) == (before, agreed)
    for proven in (pair(), pair(told=BY_LAYOUT, shown=False)):
        kept = proven.calibration
        judge(monkeypatch, proven, Judged(WALK, agreed))
        assert proven.calibration is kept


@pytest.mark.parametrize(
    ("one", "moved"),
    [
        (pair(), 1), (pair(walked=False), 0), (pair(told=BY_LAYOUT), 0), (pair(shown=False), 0),
        (PairOfSensors(None, ColdStart(SETTINGS.pair)), 0),
    ],
)  # fmt: skip
def test_what_replaces_a_confirmed_pose_of_people_who_walked_means_that_a_sensor_was_moved(
    one: PairOfSensors, moved: int
) -> None:
    people, found = watching({AB: one}), PairCalibration()
    people._poses = {"a": None, "b": None}  # type: ignore[dict-item]
    people._head_up_s = {"a": 1.0, "b": 1.0}
    people._believe(AB, found, 4.0)
    assert (people._moves, people._completed) == (moved, 1)
    assert people._moved == ({"b": 4.0} if moved else {})
    assert set(people._poses) == set(people._head_up_s) == ({"a"} if moved else {"a", "b"})
    assert (one.calibration, one.told, one.shown, one.judged_steps, one.agreed_at) == (found, "", True, -1.0, 4.0)


def judged(
    monkeypatch: pytest.MonkeyPatch, one: PairOfSensors, found: PairEstimate, now: float = 8.0, *,
    refresh_s: float = 9.0, **bodies: list[int],
) -> PeopleCalibration:  # fmt: skip
    monkeypatch.setattr(pairs_from_people, "estimates", lambda pairs: [found for _ in pairs])
    monkeypatch.setattr(pairs_from_people, "nearest_bodies", lambda *_: ((1, 1),))
    people = watching({AB: one}, **bodies)
    people._refresh_s = refresh_s
    people._judge_calibrations([AB], now, lambda name: {})
    return people


def body(since: float = np.nan, seen_at: float = 7.5) -> np.ndarray:
    state = new_body()
    state[[at.DISAGREES_SINCE, at.STEP_AT]] = since, seen_at
    return state


def test_an_estimate_is_computed_anew_after_new_frames_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for steps, before, new in ((5.0, True, False), (6.0, True, True), (5.0, False, True)):
        one = pair("" if before else None, judged_steps=5.0)
        assert one.calibration is not None
        one.calibration.scalars[at.STEPS] = steps
        found = estimate()
        judged(monkeypatch, one, found)
        assert (one.estimate is found) == new
        assert one.judged_steps == (steps if new else 5.0)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ({"walked": False, "shown": False}, WALK),
        ({"walked": False, "told": BY_LAYOUT}, WALK),
        ({"walked": True, "shown": False}, ""),
        ({"walked": True, "told": BY_LAYOUT}, ""),
        ({"walked": False}, ""),
    ],
)
def test_what_was_told_or_is_a_hypothesis_is_not_trusted_before_people_walk(
    more: dict[str, Any], problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = pair(None, **more)
    assert one.calibration is not None
    one.calibration.bodies[1, 1] = body()
    judged(monkeypatch, one, estimate())
    assert one.estimate is not None
    assert one.estimate.problem == problem
    assert one.agreed_at == 8.0
    assert (one.told, one.shown) == (("", True) if not problem else (more.get("told", ""), more.get("shown", True)))


@pytest.mark.parametrize("problem", [NOT_ONE_BODY, MIRRORED_STREAM, WALK_ACROSS])
def test_a_hypothesis_that_is_refuted_is_dropped_and_another_estimate_is_not(
    problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for shown in (False, True):
        one = pair(None, shown=shown, matched=((1, 1),))
        judged(monkeypatch, one, estimate(problem))
        dropped = not shown and problem != WALK_ACROSS
        assert (one.calibration is None) == dropped
        assert not dropped or (one.matched, one.owners) == ((), NO_OWNERS)


@pytest.mark.parametrize(
    ("bodies", "agrees"),
    [
        ({(1, 1): body()}, True),
        ({(1, 1): body(since=7.0)}, False),
        ({(1, 1): body(seen_at=8.0 - SETTINGS.gone_after_s)}, False),
        ({(1, 1): body(seen_at=8.001 - SETTINGS.gone_after_s)}, True),
        ({(1, 1): body(since=7.0), (2, 2): body()}, True),
        ({}, False),
        ({(3, 1): body()}, False),
        ({(1, 3): body()}, False),
    ],
)
def test_a_pair_agrees_while_a_person_whom_both_see_does(
    bodies: dict[tuple[int, int], np.ndarray], agrees: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = pair(None)
    assert one.calibration is not None
    one.calibration.bodies.update(bodies)
    judged(monkeypatch, one, estimate(), a=[1, 2], b=[1, 2])
    assert (one.agreed_at == 8.0) == agrees
    assert all(a in (1, 2) and b in (1, 2) for a, b in one.calibration.bodies)


def test_a_frozen_stream_disagrees_with_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairs_from_people, "estimates", lambda pairs: [estimate() for _ in pairs])
    for frozen in ("", "a", "b"):
        one = pair()
        assert one.calibration is not None
        one.calibration.bodies[1, 1] = body(since=5.0)
        people = watching({AB: one})
        if frozen:
            people._tracks[frozen].frozen = -9.0
        people._judge_calibrations([AB], 8.0, lambda name: {})
        assert np.isnan(one.calibration.bodies[1, 1][at.DISAGREES_SINCE]) == bool(frozen)


@pytest.mark.parametrize("motion_s", [0.0, 1.0, 4.0, 40.0, 1000.0])
def test_poses_are_renewed_sooner_while_little_motion_was_seen(
    motion_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    soon = max(SETTINGS.first_refresh_s, REFRESH_PART * motion_s)
    for refresh_s in (0.5, 0.05):
        people = judged(monkeypatch, pair(None), estimate("", motion_s), refresh_s=refresh_s)
        assert people._refresh_s == pytest.approx(min(refresh_s, soon))
    assert judged(monkeypatch, pair(None), estimate("", motion_s), refresh_s=0.5, b=[])._refresh_s == 0.5


def test_bodies_are_matched_by_place_where_nobody_tells_who_they_are_or_the_pose_is_unsure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pairs_from_people, "nearest_bodies", lambda *_: ((4, 4),))
    for problem, everybody, matched in (("", True, True), ("", False, False), (WALK, False, False)):
        one = pair(problem, matched=((1, 1),), owners=({}, {1: 1}))
        watching({AB: one})._match([AB], everybody)
        assert one.matched == (((4, 4),) if matched else ((1, 1),))
        assert (one.owners is NO_OWNERS) == matched
    unsure = pair(NOT_ONE_BODY, matched=((1, 1),))
    people = watching({AB: unsure})
    people._match([AB], False)
    assert unsure.matched == ((4, 4),)
    unsure.matched = ()
    people._choose_pairs(frozenset())
    people._match([AB], True)
    assert unsure.matched == ()


def moved(monkeypatch: pytest.MonkeyPatch, now: float = 50.0, **disagreeing_s: PairOfSensors) -> PeopleCalibration:
    """Sensors after a search for those that were moved; pairs by their name, such as ab."""
    monkeypatch.setattr(pairs_from_people, "disagrees_for", lambda calibration, _: calibration.scalars[at.MOTION])
    people = watching({(name[0], name[1]): one for name, one in disagreeing_s.items()})
    people._find_moved(now)
    return people


def disagrees(seconds: float, problem: str = "", **more: Any) -> PairOfSensors:
    one = pair(problem, **more)
    assert one.calibration is not None
    one.calibration.scalars[at.MOTION] = seconds
    return one


def test_a_sensor_that_others_contradict_for_long_was_moved_and_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    long_s = float(np.nextafter(SETTINGS.moved_after_s, 9))
    for seconds, count in ((SETTINGS.moved_after_s, 0), (long_s, 1)):
        people = moved(monkeypatch, ab=disagrees(seconds), ac=disagrees(0.0), bc=disagrees(seconds))
        assert list(people._moved) == ["b"] * count
        assert people._moves == count
        begun = {key for key, one in people._pairs.items() if one.calibration is None}
        assert begun == ({AB, BC} if count else set())
        assert not any(one.wary for one in people._pairs.values())
    for ignored in (disagrees(long_s, NOT_ONE_BODY), PairOfSensors(None, ColdStart(SETTINGS.pair))):
        assert moved(monkeypatch, ab=ignored)._moved == {}


def test_a_contradicted_posture_was_wrong_and_no_sensor_was_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    for more, was_moved in (({"walked": False}, False), ({"walked": False, "told": BY_LAYOUT}, True), ({}, True)):
        people = moved(monkeypatch, ab=disagrees(9.0, **more))
        assert (people._moved != {}) == was_moved
        assert people._pairs[AB].calibration is None
        assert people._pairs[AB].wary is not was_moved


def test_hypotheses_are_tried_where_there_is_no_pose_or_it_is_in_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    compared: list[tuple[bool, float]] = []
    monkeypatch.setattr(
        PairOfSensors, "compare", lambda self, seen, now, lasts_s: compared.append((seen is not None, lasts_s))
    )
    long_ago, lately = {"agreed_at": -np.inf, "seen_since": 0.0}, {"agreed_at": 99.0, "seen_since": 0.0}
    cases = [
        (PairOfSensors(None, ColdStart(SETTINGS.pair), **lately), True, False),
        (pair(trying=True, **lately), False, False),
        (pair(**long_ago), True, True),
        (pair(shown=False, **lately), True, False),
    ]
    for one, tries, doubtful in cases:
        compared.clear()
        people = watching({AB: one})
        people._find_doubts(now)
        assert one.trying is tries
        assert compared == [(doubtful, SETTINGS.gone_after_s)]
    elsewhere = {"ac": pair(**lately), "bd": pair(**lately)}
    one = pair(**long_ago)
    watching({AB: one, AC: elsewhere["ac"], ("b", "d"): elsewhere["bd"]})._find_doubts(now)
    assert not one.trying


def test_a_sensor_is_doubted_if_an_unconfirmed_pose_is_contradicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PairOfSensors, "compare", lambda *_: None)
    for more, doubted in (({"told": BY_LAYOUT}, {"b"}), ({}, set())):
        for contradicted in (True, False):
            people = watching({AB: pair(contradicted=contradicted, **more)})
            people._find_doubts(100.0)
            assert people._doubted == (doubted if contradicted else set())
