"""Who is matched with whom, and the error of a layout, in the comparison with simulated truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.evaluation.simulation import scene_room
from mocapella.evaluation.simulation_score import ALIKE, Score, _greatest, _matches, _middle
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist
from mocapella.model.observations import JointState, body_frame
from mocapella.model.skeleton import SKELETON
from mocapella.model.truth import Truth
from mocapella.sources.simulate import SimulatedFrame


@given(arrays(np.float64, st.tuples(*[st.integers(0, 4)] * 2), elements=st.floats(0, 1)))
def test_as_many_people_are_matched_as_can_be_and_then_the_most_similar(alike: np.ndarray) -> None:
    found = _matches(alike)
    assert len({row for row, _ in found}) == len({column for _, column in found}) == len(found)
    assert all(alike[at] >= ALIKE for at in found)
    wide = alike if alike.shape[0] <= alike.shape[1] else alike.T
    best = (0, 0.0)
    for columns in permutations(range(wide.shape[1]), wide.shape[0]):
        likenesses = [wide[k, column] for k, column in enumerate(columns) if wide[k, column] >= ALIKE]
        best = max(best, (len(likenesses), sum(likenesses)))
    assert (len(found), sum(alike[at] for at in found)) == (best[0], pytest.approx(best[1]))


def test_people_match_who_are_just_similar_enough() -> None:
    assert _matches(np.array([[ALIKE]])) == [(0, 0)]
    assert _matches(np.array([[np.nextafter(ALIKE, 0.0)]])) == []


@pytest.mark.parametrize(("errors", "largest"), [
    ([], (None, None)), ([None], (None, None)), ([(1.0, 4.0)], (1.0, 4.0)), ([(1.0, 4.0), None], (None, None)),
    ([(1.0, 4.0), (3.0, 2.0)], (3.0, 4.0)),
])  # fmt: skip
def test_the_largest_errors_of_sensors_are_known_if_all_are(errors: Any, largest: Any) -> None:
    assert _greatest(errors) == largest


@pytest.mark.parametrize(("far_m", "middle_x"), [(5.9, 7.95), (6.0, 5.0), (6.1, 5.0)])
def test_the_middle_of_the_room_is_that_of_the_people_within_reach_of_the_main_sensor(
    far_m: float, middle_x: float
) -> None:
    """Or else that of everybody."""
    T = np.eye(4)
    T[:3, 3] = [5.0, 1.0, 0.0]
    places = np.array([[[5.0, 1.0, 0.0]], [[5.0 + far_m, 1.0, 0.0]]])
    main = SimpleNamespace(T_world_sensor=T, range_m=(0.5, 6.0))
    room: Any = SimpleNamespace(
        settings=SimpleNamespace(sensors=[main]), duration_ns=10**9, positions_at=lambda _: places
    )
    assert _middle(room) == pytest.approx([middle_x, 1.0, 0.0])
    main.range_m = (0.0, 0.0)
    assert _middle(room) == pytest.approx(places.mean(axis=(0, 1)))


@cache
def score() -> Score:
    return Score(scene_room("walk-45", 0))


turns = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))  # together less than half a turn


@given(turns, st.sampled_from([0, 1]))
def test_the_error_of_a_rotation_is_its_angle_about_whichever_axis(turn: np.ndarray, which: int) -> None:
    places = score()._T_world_sensor
    sensor = score().sensors[which]
    true = inverse(places[score().main]) @ places[sensor]
    _, deg = score()._layout_error(exp_twist(np.r_[0, 0, 0, turn]) @ true, sensor)
    assert deg == pytest.approx(np.degrees(np.linalg.norm(turn)), abs=1e-5)


@given(arrays(np.float64, 3, elements=st.floats(-10, 10)))
def test_the_error_of_a_translation_is_its_length(step: np.ndarray) -> None:
    places = score()._T_world_sensor
    sensor = score().sensors[1]
    true = inverse(places[score().main]) @ places[sensor]
    moved, deg = score()._layout_error(exp_twist(np.r_[step, 0, 0, 0]) @ true, sensor)
    assert moved == pytest.approx(np.linalg.norm(step), abs=1e-9)
    assert deg == pytest.approx(0, abs=1e-5)


STEP_S = 1 / 16
BODIES = np.random.default_rng(0).normal(0.0, 0.3, (2, 25, 3)) + np.array([[[-1.0, 1.0, 2.0]], [[1.0, 1.0, 2.5]]])
"""Two people who stand 2 m apart."""


def scored(
    seconds: float,
    seen: Callable[[float], Iterable[int]] = lambda _: (0, 1),
    found: Callable[[float], Iterable[int]] = lambda _: (0, 1),
    off_m: float = 0.0,
) -> Score:
    """The score of a method that finds some of those whom both sensors see, as wrong as that in one direction."""
    of = Score(scene_room("walk-45", 0))
    for k in range(round(seconds / STEP_S)):
        at_s = k * STEP_S
        who = np.array(list(seen(at_s)), dtype=np.int64)
        people = [
            SimpleNamespace(
                id=10 + person,
                positions=BODIES[person] + [0.0, off_m, 0.0],
                states=np.full(25, JointState.TRACKED, np.uint8),
                views=(),
            )
            for person in found(at_s)
        ]
        places = [SimpleNamespace(sensor=name, T_world_sensor=T) for name, T in of._T_world_sensor.items()]
        for name, T in reversed(of._T_world_sensor.items()):
            own = apply(inverse(T), BODIES[who]) if len(who) else []
            frame = body_frame(name, SKELETON, time_ns=0, positions=own)
            truth = Truth(
                name, k, round(1e9 * at_s), SKELETON, np.arange(2), BODIES, T, who, np.zeros(len(who), dtype=np.bool_)
            )
            scene: Any = SimpleNamespace(people=people, sensors=places)
            of.update(SimulatedFrame(at_s, frame, truth), scene, {})
    return of


def test_who_is_seen_and_not_found_is_lost_once_after_a_second() -> None:
    """A person is expected after half a second in view, and lost a second later; the time is that of the room [s]."""
    lost = scored(4.0, found=lambda _: (1,)).lost
    assert lost == [(pytest.approx(1.5, abs=STEP_S), 0)]


def test_who_is_found_again_can_be_lost_again() -> None:
    lost = scored(4.0, found=lambda t: (0, 1) if 1.0 < t < 2.0 else (0,)).lost
    assert lost == [(pytest.approx(3.0, abs=STEP_S), 1)]
    lost = scored(4.0, found=lambda t: (0, 1) if 1.75 < t < 2.25 else (0,)).lost
    assert lost == [(pytest.approx(1.5, abs=STEP_S), 1), (pytest.approx(3.25, abs=STEP_S), 1)]


@pytest.mark.parametrize(("until_s", "lost"), [(1.125, False), (1.375, True)])
def test_nobody_is_expected_who_was_not_seen_for_a_quarter_of_a_second(until_s: float, lost: bool) -> None:
    of = scored(3.0, seen=lambda t: (0, 1) if t < until_s else (1,), found=lambda _: (1,))
    assert bool(of.lost) == lost


def test_a_method_that_is_right_has_no_errors_and_loses_nobody() -> None:
    """Although it finds people before they are expected, and after."""
    of = scored(3.0, seen=lambda t: (0, 1) if t < 2.0 else (1,))
    figures = of.figures()
    assert of.lost == []
    assert (figures["hota"], figures["idf1"], figures["identity_switches"]) == (1.0, 1.0, 0.0)
    assert figures["fused_cm"] == pytest.approx(0, abs=1e-9)
    assert (figures["lost_people"], figures["wrong_left_right_percent"]) == (0.0, 0.0)


def test_an_error_is_in_centimetres() -> None:
    figures = scored(1.0, off_m=0.02).figures()
    assert figures["fused_cm"] == figures["measured_cm"] == pytest.approx(2.0)
    assert figures["inferred_cm"] is None


def test_ids_are_scored_at_every_third_frame_of_those_who_are_expected() -> None:
    of = scored(3.0)
    frames = round(3.0 / STEP_S) - 1  # the first has none before it
    assert len(of.identity) == -(-frames // 3)
    expected = [frame for frame in of.identity if frame.true_ids]
    assert {(frame.true_ids, frame.found_ids) for frame in expected} == {((0, 1), (10, 11))}
    assert len(expected) == pytest.approx((3.0 - 0.5) / STEP_S / 3, abs=1)
