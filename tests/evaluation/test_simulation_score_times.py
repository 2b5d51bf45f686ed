"""When sensors count, who is expected, and what is compared, in the comparison with simulated truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.evaluation import simulation_score
from mocapella.evaluation.simulation_score import Score
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.observations import JointState, body_frame
from mocapella.model.skeleton import SKELETON
from mocapella.model.truth import Truth
from mocapella.sources.simulate import SimulatedFrame

STEP_S = 1 / 16
JOINTS = len(SKELETON)
MIRROR = list(SKELETON.mirror)
BODY = np.random.default_rng(0).normal(0.0, 0.1, (JOINTS, 3))
PLACES = {
    "main": rigid(np.eye(3), [0.0, 1.0, 0.0]),
    "side": rigid(rotation_about_y(0.7), [2.0, 1.0, 0.5]),
    "third": rigid(rotation_about_y(-0.4), [-2.0, 1.0, 0.5]),
}
LATE_S = {"main": 0.06, "side": 0.09, "third": 0.02}
SHIFT = np.array([0.0, 1.0, 0.0])
"""Direction of the errors."""
Who = Callable[[float], Iterable[int]]


def moved(T: np.ndarray, by_m: float) -> np.ndarray:
    """The pose, as much too high."""
    return rigid(np.eye(3), by_m * SHIFT) @ T


@dataclass
class Session:
    """Two people, a sensor or more, and a method that is as wrong as told; all by the time in the room [s].

    Attributes:
        sensors: names of the sensors, the main one first.
        speed: of each person [m/s].
        seen: numbers of those whom each sensor sees.
        sees_off_m: error of each sensor's skeletons [m].
        inferred: indices of the joints that the side sensor infers.
        after_s: time from the other sensors' frames to the main one's [s].
        found: (joints, 3) of the method, from the true ones.
        places: poses of the sensors as the method gives them; None for none.
        views: poses of the sensors in each person's views.
        offsets: of the sensors' clocks, as the method gives them [s].
    """

    sensors: tuple[str, ...] = ("main", "side")
    speed: tuple[float, float] = (0.0, 0.0)
    seen: Mapping[str, Who] = field(default_factory=dict)
    sees_off_m: Mapping[str, float] = field(default_factory=dict)
    inferred: tuple[int, ...] = ()
    after_s: float = 0.0
    found: Callable[[np.ndarray], np.ndarray] = lambda true: true
    places: Callable[[float], Mapping[str, np.ndarray] | None] = lambda at_s: PLACES
    views: Mapping[int, Mapping[str, np.ndarray]] = field(default_factory=dict)
    offsets: Mapping[str, float] = field(default_factory=dict)

    def score(self, seconds: float, silent: tuple[str, ...] = ()) -> Score:
        room: Any = SimpleNamespace(
            sensor_names=self.sensors,
            settings=SimpleNamespace(
                sensors=[
                    SimpleNamespace(name=n, T_world_sensor=PLACES[n], latency_s=LATE_S[n], range_m=(0.5, 9.0))
                    for n in self.sensors
                ]
            ),
            duration_ns=10**9,
            positions_at=lambda t: self._people(t / 1e9),
        )
        of = Score(room)
        for k in range(round(seconds / STEP_S)):
            for name in reversed(self.sensors):
                if name not in silent:
                    at_s = k * STEP_S + (self.after_s if name == "main" else 0.0)
                    of.update(self._frame(name, k, at_s), self._scene(at_s), self.offsets)
        return of

    def _people(self, at_s: float) -> np.ndarray:
        start = np.array([[-1.0, 1.0, 2.0], [1.0, 1.0, 2.5]]) + np.outer(self.speed, [0, 0, at_s])
        return np.asarray(BODY + start[:, None])

    def _frame(self, name: str, k: int, at_s: float) -> SimulatedFrame:
        true = self._people(at_s)
        who = np.array(list(self.seen.get(name, lambda _: (0, 1))(at_s)), dtype=np.int64)
        own = apply(inverse(PLACES[name]), true[who] + self.sees_off_m.get(name, 0.0) * SHIFT) if len(who) else []
        states = np.full((len(who), JOINTS), JointState.TRACKED)
        if name == "side":
            states[:, list(self.inferred)] = JointState.INFERRED
        frame = body_frame(name, SKELETON, time_ns=0, positions=own, states=states if len(who) else None)
        mirrored = np.zeros(len(who), dtype=np.bool_)
        truth = Truth(name, k, round(1e9 * at_s), SKELETON, np.arange(2), true, PLACES[name], who, mirrored)
        return SimulatedFrame(at_s, frame, truth)

    def _scene(self, at_s: float) -> Any:
        places = self.places(at_s)
        people = [
            SimpleNamespace(
                id=10 + person,
                positions=self.found(true),
                states=np.full(JOINTS, JointState.TRACKED, np.uint8),
                views=[
                    SimpleNamespace(sensor=name, T_world_sensor=T) for name, T in self.views.get(person, {}).items()
                ],
            )
            for person, true in enumerate(self._people(at_s))
        ]
        sensors = [SimpleNamespace(sensor=name, T_world_sensor=T) for name, T in (places or {}).items()]
        return SimpleNamespace(people=people, sensors=sensors)


def expected(of: Score) -> list[tuple[int, ...]]:
    """Who is expected at each frame of the main sensor, from its second on."""
    return [frame.true_ids for frame in of.identity]


@pytest.fixture
def every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identities are scored at all frames."""
    monkeypatch.setattr(simulation_score, "IDENTITY_EVERY", 1)


def during(*stays: tuple[float, float]) -> Who:
    """Person 0 always, and person 1 at these times, both ends among them [s]."""
    return lambda at_s: (0, 1) if any(begin <= at_s <= end for begin, end in stays) else (0,)


@pytest.mark.usefixtures("every_frame")
def test_somebody_is_expected_from_half_a_second_in_view_until_a_quarter_after() -> None:
    both = dict.fromkeys(("main", "side"), during((0.5, 2.0)))
    times = [STEP_S * (k + 1) for k, who in enumerate(expected(Session(seen=both).score(3.0))) if 1 in who]
    assert (times[0], times[-1], len(times)) == (1.0, 2.25, round(1.25 / STEP_S) + 1)


@pytest.mark.usefixtures("every_frame")
@pytest.mark.parametrize(("gap_s", "anew"), [(0.25, False), (0.3125, True), (0.75, True)])
def test_who_was_out_of_view_for_more_than_a_quarter_of_a_second_is_expected_anew(gap_s: float, anew: bool) -> None:
    """Only after half a second."""
    both = dict.fromkeys(("main", "side"), during((0.0, 2.0), (2.0 + gap_s, 4.0)))
    who = expected(Session(seen=both).score(4.0))
    at_s = 2.0 + gap_s + 0.25
    assert (1 in who[round(at_s / STEP_S) - 1]) is not anew
    assert 1 in who[round((at_s + 0.25) / STEP_S) - 1]


@pytest.mark.usefixtures("every_frame")
@pytest.mark.parametrize(("speed", "tied"), [(0.0, False), (0.28, False), (0.32, True)])
def test_who_only_the_side_sensor_sees_is_expected_after_eight_seconds_of_walking_before_both(
    speed: float, tied: bool
) -> None:
    """Until then the method cannot know where the side sensor stands."""
    who = expected(Session(speed=(speed, 0.0), seen={"main": lambda _: (0,)}).score(9.5))
    assert {both for both in who if both} == ({(0,), (0, 1)} if tied else {(0,)})
    assert {1 in both for both in who[: round(8.5 / STEP_S) - 1]} == {False}
    assert (1 in who[round(8.5 / STEP_S)]) is tied


@pytest.mark.usefixtures("every_frame")
def test_walking_counts_only_before_both_sensors() -> None:
    """Here each of the two sees somebody else, who walks."""
    apart = {"main": lambda _: (0,), "side": lambda _: (1,)}
    of = Session(speed=(1.0, 1.0), seen=apart, places=lambda at_s: PLACES).score(9.5)
    assert {both for both in expected(of) if both} == set()
    assert of.figures()["calibration_mm"] is None


@pytest.mark.usefixtures("every_frame")
def test_a_third_sensor_is_tied_by_one_that_is_tied_and_its_people_are_not_expected_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It shares no walking with the main one."""
    monkeypatch.setattr(simulation_score, "SHARED_WALKING", 1.0)
    seen: dict[str, Who] = {"main": lambda _: (0,), "side": lambda _: (0, 1), "third": lambda _: (1,)}
    of = Session(("main", "side", "third"), (1.0, 0.0), seen).score(2.0)
    assert of.figures()["calibration_mm"] is None  # not of all sensors yet
    assert of._tied() == {"main", "side"}
    then = Session(("main", "side", "third"), (1.0, 1.0), seen).score(3.0)
    assert then._tied() == {"main", "side", "third"}
    alone: dict[str, Who] = {"main": lambda _: (0,), "side": lambda _: (0,), "third": lambda _: (1,)}
    assert {who for who in expected(Session(("main", "side", "third"), (1.0, 1.0), alone).score(2.5)) if who} == {(0,)}


@pytest.mark.usefixtures("every_frame")
def test_nobody_is_expected_while_a_sensor_has_sent_nothing() -> None:
    assert set(expected(Session().score(2.0, silent=("side",)))) == {()}


@pytest.mark.usefixtures("every_frame")
def test_everybody_before_a_single_sensor_is_expected() -> None:
    assert expected(Session(("main",)).score(2.0))[-1] == (0, 1)


def test_a_calibration_is_scored_when_eight_seconds_were_walked_and_at_the_end() -> None:
    """An error of a sensor's place is that of the middle of the room, too."""

    def places(at_s: float) -> Mapping[str, np.ndarray]:
        off_m = 0.05 if at_s < 4 else 0.03 if at_s < 8.03 else 0.01
        return {"main": PLACES["main"], "side": moved(PLACES["side"], off_m)}

    figures = Session(speed=(1.0, 0.0), places=places).score(9.0).figures()
    assert (figures["calibration_mm"], figures["calibration_end_mm"]) == pytest.approx((30.0, 10.0))
    assert figures["calibration_deg"] == pytest.approx(0.0, abs=1e-5)
    assert Session(places=places).score(1.0).figures()["calibration_mm"] is None


@pytest.mark.parametrize("known", ["main", "side"])
def test_a_layout_without_one_of_its_sensors_has_no_error(known: str) -> None:
    of = Session(speed=(1.0, 0.0), places=lambda at_s: {known: PLACES[known]}).score(1.0)
    assert of.figures()["calibration_end_mm"] is None


def test_the_errors_of_the_best_sensor_are_compared_with_those_of_the_fused_skeleton() -> None:
    """The joints that a sensor only infers are compared apart, with that sensor's."""
    off = {"main": 0.06, "side": 0.04}
    session = Session(sees_off_m=off, inferred=(3, 7), found=lambda true: true + 0.01 * SHIFT)
    figures = session.score(1.0).figures()
    assert figures["best_sensor_cm"] == pytest.approx(4.0)
    assert figures["fused_of_best_sensor_percent"] == pytest.approx(25.0)
    assert (figures["hidden_cm"], figures["hidden_by_sensor_cm"]) == pytest.approx((1.0, 4.0))
    assert figures["hidden_of_sensor_percent"] == pytest.approx(25.0)
    assert figures["fused_cm"] == pytest.approx(1.0)


def test_nothing_is_compared_with_sensors_that_see_nobody() -> None:
    nobody = dict.fromkeys(("main", "side"), lambda _: ())
    figures = Session(seen=nobody).score(1.0).figures()
    names = ("best_sensor_cm", "fused_of_best_sensor_percent", "hidden_of_sensor_percent")
    assert [figures[name] for name in names] == [None] * 3


@pytest.mark.parametrize(("after_s", "fresh"), [(0.05, True), (0.051, False)])
def test_a_sensors_frame_is_compared_for_fifty_milliseconds(after_s: float, fresh: bool) -> None:
    session = Session(sees_off_m={"main": 0.06, "side": 0.04}, after_s=after_s)
    assert session.score(1.0).figures()["best_sensor_cm"] == pytest.approx(4.0 if fresh else 6.0)


def test_a_skeleton_whose_left_and_right_are_swapped_is_wrong_and_right_with_its_labels_aside() -> None:
    figures = Session(found=lambda true: true[MIRROR]).score(1.0).figures()
    assert figures["wrong_left_right_percent"] == 100.0
    assert figures["fused_labels_aside_cm"] == pytest.approx(0.0, abs=1e-6)
    assert figures["fused_cm"] is not None
    assert figures["fused_cm"] > 1
    shifted = Session(found=lambda true: true + 0.02 * SHIFT).score(1.0).figures()
    assert shifted["wrong_left_right_percent"] == 0.0
    assert shifted["fused_labels_aside_cm"] == shifted["fused_cm"] == pytest.approx(2.0)


def test_a_skeleton_without_width_has_neither_the_right_nor_the_wrong_labels_swapped() -> None:
    """All its joints are in one place, so that exchanging them changes nothing."""
    figures = Session(found=lambda true: 0 * true + true.mean(axis=0)).score(1.0).figures()
    assert figures["wrong_left_right_percent"] == 0.0


@pytest.mark.parametrize("names", [("main", "side"), ("main", "side", "third")])
def test_the_error_of_the_clocks_is_the_largest_against_the_main_sensor(names: tuple[str, ...]) -> None:
    """What is added to all clocks alike is none; the right offset takes a sensor's latency off."""
    for every_s in (0.0, 0.7):
        right = {name: every_s - LATE_S[name] for name in names}
        assert Session(names, offsets=right).score(0.25).figures()["time_offset_ms"] == pytest.approx(0.0, abs=1e-9)
        for wrong_s in (0.005, -0.005):
            wrong = right | {"side": right["side"] + wrong_s}
            assert Session(names, offsets=wrong).score(0.25).figures()["time_offset_ms"] == pytest.approx(5.0)
    assert Session(names, offsets={"main": 0.0}).score(0.25).figures()["time_offset_ms"] is None
    assert Session(("main",), offsets={"main": 0.0}).score(0.25).figures()["time_offset_ms"] is None


WORLD = rigid(rotation_about_y(2.0), [5.0, -1.0, 3.0])
"""From the room's frame to the method's own."""


def test_a_method_without_poses_is_aligned_by_the_main_sensors_view_or_else_another() -> None:
    """A person without any view cannot be compared."""
    own = {name: WORLD @ T for name, T in PLACES.items()}
    wrong = {name: moved(T, 0.2) for name, T in own.items()}
    session = Session(found=lambda true: apply(WORLD, true), places=lambda at_s: None)
    session.views = {0: {"side": own["side"]}, 1: {"side": wrong["side"], "main": own["main"]}}
    of = session.score(1.0)
    assert of.figures()["fused_cm"] == pytest.approx(0.0, abs=1e-6)
    assert {frame.found_ids for frame in of.identity} >= {(10, 11)}
    session.views = {0: {"side": own["side"]}}
    assert {frame.found_ids for frame in session.score(1.0).identity if frame.true_ids} == {(10,)}


def test_a_method_with_poses_may_choose_its_world() -> None:
    own = {name: WORLD @ T for name, T in PLACES.items()}
    figures = Session(found=lambda true: apply(WORLD, true), places=lambda at_s: own).score(1.0).figures()
    assert (figures["fused_cm"], figures["calibration_end_mm"]) == pytest.approx((0.0, 0.0), abs=1e-6)
