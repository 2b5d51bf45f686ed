"""Which pairs of sensors are believed, used, refined and doubted: rules without frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import (
    MIRRORED_STREAM,
    NOT_ONE_BODY,
    WALK,
    WALK_ACROSS,
    PairCalibration,
    PairEstimate,
    PairSettings,
)
from mocapella.calibration.sensor_conditions import (
    ONE_PLACE_M,
    ONE_PLACE_SD,
    ONE_PLACE_TURN,
    StreamFaults,
    contradicts,
    pose_condition,
)
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.sensor_pair import (
    BY_LAYOUT,
    GIVEN_SD,
    GIVEN_SD_M,
    PairOfSensors,
    agree_elsewhere,
    best_pairs,
    covariance_of,
    used_pairs,
)
from mocapella.calibration.shared_people import (
    BEHIND_M,
    DOUBTED_FIELD,
    HIDES,
    SURE_FIELD,
    Field,
    _misses,
    missed_people,
    same_people,
)
from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model import condition_texts as texts

UNKNOWN = TimeOffset(0.0, 0.1, False)


def estimate(
    problem: str = "", T: np.ndarray | None = None, sd_m: float = 0.01, sd: float = 0.01, position_sd: float = 0.01
) -> PairEstimate:
    C = np.diag([sd_m**2 / 3] * 3 + [sd**2 / 3] * 3)
    T = rigid(np.eye(3), [2.0, 0, 0]) if T is None else T
    return PairEstimate(T, C, position_sd, 0.01, 5.0, 9.0, 0.05, UNKNOWN, UNKNOWN, problem)


def pair(
    problem: str | None = "", *, walked: bool = True, T: np.ndarray | None = None, sd_m: float = 0.01, sd: float = 0.01,
    position_sd: float = 0.01, **more: Any,
) -> PairOfSensors:  # fmt: skip
    """An estimate with this problem, or none; from people who walked or only stood."""
    found = None if problem is None else estimate(problem, T, sd_m, sd, position_sd)
    calibration = PairCalibration(T_a_b=np.eye(4) if T is None else T)
    calibration.scalars[at.BLOCKS_CLOSED] = 99.0 * walked
    return PairOfSensors(calibration, ColdStart(PairSettings()), estimate=found, **{"shown": True, **more})


@pytest.mark.parametrize(
    ("problem", "by_people", "confirmed", "by_layout", "by_others"),
    [
        ("", True, True, True, True),
        (WALK, False, True, True, False),
        (WALK_ACROSS, False, True, True, False),
        (NOT_ONE_BODY, False, False, True, False),
        (MIRRORED_STREAM, False, False, False, False),
        (None, False, False, False, False),
    ],
)
def test_a_pose_is_used_without_a_problem_or_while_what_is_known_is_no_contradiction(
    problem: str | None, by_people: bool, confirmed: bool, by_layout: bool, by_others: bool
) -> None:
    assert pair(problem, shown=False).trusted is by_people
    assert pair(problem, shown=True).trusted is confirmed
    assert pair(problem, shown=False, told=BY_LAYOUT).trusted is by_layout
    assert pair(problem, shown=False, told="others").trusted is by_others
    nothing = pair(problem)
    nothing.calibration = None
    assert not nothing.trusted
    assert not nothing.walked


def test_a_hypothesis_is_unproven_until_it_is_shown_or_if_it_was_told() -> None:
    assert pair(shown=False).unproven
    assert not pair(shown=True).unproven
    assert not pair(shown=False, told=BY_LAYOUT).unproven
    assert not PairOfSensors(None, ColdStart(PairSettings())).unproven
    assert [pair(walked=walked).walked for walked in (True, False)] == [True, False]


def test_a_layouts_pose_is_as_uncertain_as_such_are_until_people_confirm_it() -> None:
    for one in (pair(WALK), pair(""), pair("", told=BY_LAYOUT), pair(WALK, told="others")):
        assert one.estimate is not None
        assert covariance_of(one) is one.estimate.covariance
    given = covariance_of(pair(WALK, told=BY_LAYOUT))
    assert np.trace(given[:3, :3]) == pytest.approx(GIVEN_SD_M**2)
    assert np.trace(given[3:, 3:]) == pytest.approx(GIVEN_SD**2)
    np.testing.assert_array_equal(given, np.diag(np.diag(given)))


def test_a_pose_from_postures_is_used_only_where_no_better_ones_tie_its_sensors() -> None:
    """However many better ones there are in between, and in whatever order they join."""
    walk = {key: pair() for key in (("a", "b"), ("c", "d"), ("b", "c"), ("a", "c"))}
    stand = {key: pair(walked=False) for key in (("a", "d"), ("b", "d"), ("d", "e"), ("e", "f"))}
    bad = {("a", "f"): pair(NOT_ONE_BODY)}
    assert used_pairs({**walk, **stand, **bad}) == {*walk, ("d", "e"), ("e", "f")}
    del walk["b", "c"], walk["a", "c"]
    assert used_pairs({**walk, **stand, **bad}) == {*walk, *stand}
    told = {("a", "b"): pair(walked=False, told=BY_LAYOUT), ("b", "c"): pair(walked=False, told=BY_LAYOUT)}
    assert used_pairs({**told, ("a", "c"): pair(walked=False)}) == set(told)
    assert used_pairs({}) == set()


@pytest.mark.parametrize(
    ("agreeing", "elsewhere"),
    [
        ([], False),
        ([("a", "c")], False),
        ([("a", "c"), ("b", "c")], True),
        ([("a", "b")], False),
        ([("a", "b"), ("a", "c")], False),
        ([("a", "b"), ("a", "c"), ("b", "d")], True),
    ],
)
def test_two_sensors_agree_elsewhere_if_each_agrees_with_a_third(
    agreeing: list[tuple[str, str]], elsewhere: bool
) -> None:
    agree = {name: sum(name in key for key in agreeing) for name in "abcd"}
    assert agree_elsewhere(("a", "b"), agreeing, {name: n for name, n in agree.items() if n}) is elsewhere


def placed(**roots: str | None) -> dict[str, PlacedSensor]:
    """Sensors by the root that they are tied to; None if they are not."""
    return {
        name: PlacedSensor(np.eye(4), np.zeros((6, 6)), None, root or name, root is not None)
        for name, root in roots.items()
    }


def test_each_sensor_has_its_best_pairs_and_whom_nothing_ties_has_all() -> None:
    ring = placed(a="a", b="a", c="a", d="a")
    ranked = [("a", "b"), ("b", "c"), ("a", "c"), ("c", "d"), ("a", "d"), ("b", "d")]
    assert best_pairs(ring, ranked, 3) is None
    assert best_pairs(ring, ranked, 2) == {*ranked[:5]}
    assert best_pairs(ring, ranked, 1) == {("a", "b"), ("b", "c"), ("c", "d")}
    apart = placed(a="a", b="a", c="c", d="c", e=None)
    between = {("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("a", "e"), ("b", "e"), ("c", "e"), ("d", "e")}
    assert best_pairs(apart, [("a", "b")], 1) == {*between, ("a", "b")}


def seen(*centres: list[float]) -> Any:
    """Tracks of bodies at these places."""
    return SimpleNamespace(bodies=dict(enumerate(centres)), newest_centres=lambda: np.array(centres).reshape(-1, 3))


def test_a_pair_is_contradicted_once_both_have_missed_somebody_for_long_and_no_longer_after_a_frame() -> None:
    one = pair(T=np.eye(4))
    there, elsewhere = seen([0.0, 0.0, 2.0]), seen([0.5, 0.0, 2.2])
    for now, contradicted in ((1.0, False), (1.5, False), (2.0, False), (2.001, True), (3.0, True)):
        one.compare((there, elsewhere), now, 1.0)
        assert one.contradicted is contradicted
    for nothing in (None, (seen(), elsewhere), (there, seen())):
        one.compare(nothing, 3.1, 1.0)
        assert not one.contradicted
        one.compare((there, elsewhere), 3.2, 1.0)
        one.compare((there, elsewhere), 4.3, 1.0)
        assert one.contradicted
    one.calibration = None
    one.compare((there, elsewhere), 9.0, 1.0)
    assert not one.contradicted


def test_a_given_pose_may_be_off_so_that_people_are_missed_in_a_wider_field() -> None:
    there, elsewhere = seen([1.5, 0.0, 2.0]), seen([-1.5, 0.0, 2.2])  # 37 degrees aside
    for told, missed in ((BY_LAYOUT, True), ("others", False), ("", False)):
        one = pair(T=np.eye(4), told=told)
        one.compare((there, elsewhere), 1.0, 1.0)
        one.compare((there, elsewhere), 3.0, 1.0)
        assert one.contradicted is missed


@pytest.mark.parametrize("field", [SURE_FIELD, DOUBTED_FIELD, Field(1.0, 2.0, 0.3)])
def test_a_sensor_should_see_who_is_in_its_field_and_not_behind_somebody(field: Field) -> None:
    middle, aside = 0.5 * (field.nearest_m + field.farthest_m), [50.0, 0.0, 1.0]
    for at_m, within in ((0.99 * field.nearest_m, False), (1.01 * field.nearest_m, True)):
        assert _alone(field, [0.0, 0.0, at_m], aside) is within
    for at_m, within in ((0.99 * field.farthest_m, True), (1.01 * field.farthest_m, False)):
        assert _alone(field, [0.0, 0.0, at_m], aside) is within
    for part, within in ((0.99, True), (1.01, False)):
        angle = part * field.half_angle
        for x, y in ((1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)):
            person = [middle * np.tan(angle) * x, middle * np.tan(angle) * y, middle]
            assert _alone(field, person, aside) is within
    person = [0.0, 0.0, middle]
    for part, hidden in ((0.99, True), (1.01, False)):
        near = 0.2 * np.array([np.sin(part * HIDES), 0.0, np.cos(part * HIDES)])
        assert _alone(field, person, near.tolist()) is not hidden
    for before_m, hidden in ((1.01 * BEHIND_M, True), (0.99 * BEHIND_M, False), (-1.0, False)):
        assert _alone(field, person, [0.0, 0.0, middle - before_m]) is not hidden
    assert _alone(field, [np.nan] * 3, aside) is False


def _alone(field: Field, person: list[float], body: list[float]) -> bool:
    """Whether a sensor that sees a body misses a person.

    The other sensor is far away and turned round; it sees that person, and misses somebody whom the first sees far off.
    """
    T_a_b = rigid(rotation_about_y(np.pi), [0.0, 0.0, 100.0])
    lonely = np.array([[0.0, 0.0, 100.0 - 0.5 * (field.nearest_m + field.farthest_m)]])
    theirs = (np.array([person]) - T_a_b[:3, 3]) @ T_a_b[:3, :3]
    return missed_people(T_a_b, np.vstack([lonely, [body]]), theirs, field)


def test_a_field_ends_before_its_limits() -> None:
    field, aside = Field(1.0, 2.0, np.pi / 4), np.array([[9.0, 0.0, 0.1]])
    for person, within in (
        ([0.0, 0.0, 1.0], False),
        ([0.0, 0.0, 2.0], False),
        ([1.5, 0.0, 1.5], False),
        ([1.4, 0, 1.5], True),
    ):
        assert _misses(field, np.array([person]), aside) is within
    assert _misses(field, np.array([[0.0, 0.0, 1.5]]), np.array([[0.0, 0.0, 1.5 - BEHIND_M]]))


def test_bodies_of_one_person_are_paired_in_the_order_of_the_first_sensor() -> None:
    assert same_people({3: 30, 1: 10, 2: 20}, {7: 10, 8: 40, 9: 30}) == ((3, 9), (1, 7))
    assert same_people({}, {7: 10}) == same_people({1: 10}, {}) == ()


@pytest.mark.parametrize(
    ("faults", "condition"),
    [
        ({}, ""),
        ({"mistilted": True}, texts.MISTILTED),
        ({"mistilted": True, "moved": True}, texts.MOVED),
        ({"moved": True, "jumped_s": 0.0}, texts.CLOCK_JUMPED),
        ({"jumped_s": 4.999}, texts.CLOCK_JUMPED),
        ({"jumped_s": 5.0}, ""),
        ({"jumped_s": -0.001}, ""),
        ({"jumped_s": 1.0, "behind_s": 3.2}, texts.CLOCK_BEHIND.format(seconds=3.2)),
        ({"behind_s": 3.2, "frozen": True}, texts.FROZEN),
    ],
)
def test_the_worst_fault_of_a_stream_is_told(faults: dict[str, Any], condition: str) -> None:
    none = {"frozen": False, "behind_s": 0.0, "jumped_s": np.inf, "moved": False, "mistilted": False}
    assert StreamFaults(**{**none, **faults}).condition == condition


def test_two_sensors_are_at_one_place_if_this_is_known_well_and_people_walked() -> None:
    def told(at_m: list[float], turn: float = 0.0, **more: Any) -> bool:
        return contradicts(pair(T=rigid(rotation_about_y(turn), at_m), **more))

    diagonal = 0.999 * ONE_PLACE_M / np.sqrt(3)
    assert told([0.0, 0.0, 0.0])
    for at_m in (
        [0.999 * ONE_PLACE_M, 0, 0],
        [0, -0.999 * ONE_PLACE_M, 0],
        [0, 0, 0.099],
        [diagonal, -diagonal, diagonal],
    ):
        assert told(at_m)  # type: ignore[arg-type]
        assert not told((1.02 * np.array(at_m)).tolist())
    assert not told([-ONE_PLACE_M, 0.0, 0.0])
    assert not told([0.07, 0.08, 0.0])
    assert not told([0.0, ONE_PLACE_M, 0.0])
    for turn, same in ((0.99, True), (-0.99, True), (1.01, False), (30.0, False)):
        assert told([0.0, 0.0, 0.0], turn * ONE_PLACE_TURN) is same
    assert not told([0.0, 0.0, 0.0], np.pi)
    for part, sure in ((0.99, True), (1.01, False)):
        assert told([0.0, 0.0, 0.0], sd_m=part * ONE_PLACE_SD * ONE_PLACE_M) is sure
        assert told([0.0, 0.0, 0.0], sd=part * ONE_PLACE_SD * ONE_PLACE_TURN) is sure
    assert not told([0.0, 0.0, 0.0], walked=False)
    assert not told([0.0, 0.0, 0.0], problem=NOT_ONE_BODY)
    assert not told([0.0, 0.0, 0.0], problem=None)


def test_what_is_contradicted_is_told_unless_it_is_a_hypothesis() -> None:
    assert contradicts(pair(contradicted=True))
    assert not contradicts(pair())
    assert not contradicts(pair(contradicted=True, shown=False))
    assert contradicts(pair(contradicted=True, shown=False, told=BY_LAYOUT))


def test_a_sensors_condition_is_that_of_its_pose() -> None:
    both, apart = placed(a="a", b="a"), placed(a="a", b="b")

    def told(pairs: dict[tuple[str, str], PairOfSensors], where: dict[str, PlacedSensor], **more: bool) -> str:
        contradicted = {key: one for key, one in pairs.items() if contradicts(one)}
        return pose_condition("b", pairs, contradicted, where, **{"seeing": True, **more})

    assert told({}, both) == told({("a", "c"): pair()}, both) == ""
    assert told({("a", "b"): pair()}, both) == ""
    assert told({("a", "b"): pair(T=np.eye(4))}, both) == texts.ONE_PLACE.format(other="a")
    assert told({("a", "b"): pair(contradicted=True)}, both) == texts.UNSEEN.format(other="a")
    assert told({("b", "c"): pair(contradicted=True)}, both) == texts.UNSEEN.format(other="c")
    assert told({("a", "b"): pair(contradicted=True, told=BY_LAYOUT)}, both) == texts.UNSEEN_BY_LAYOUT
    assert told({("a", "b"): pair(), ("a", "c"): pair(contradicted=True)}, both) == ""
    assert told({("a", "b"): pair(None)}, apart) == texts.NOBODY_SHARED
    assert told({("a", "b"): pair(None)}, apart, seeing=False) == texts.SEES_NOBODY
    unsure = {("a", "b"): pair(WALK, position_sd=0.2), ("b", "c"): pair(NOT_ONE_BODY, position_sd=0.1)}
    assert told(unsure, apart) == f"with c: {NOT_ONE_BODY}"
    assert told({("a", "b"): pair()}, apart) == ""
    half = {**both, "a": PlacedSensor(np.eye(4), np.zeros((6, 6)), None, "a", False)}
    assert told({("a", "b"): pair(WALK, contradicted=True)}, half) == f"with a: {WALK}"
