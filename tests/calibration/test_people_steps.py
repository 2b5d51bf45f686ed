"""What the calibration from people does with a frame, and how a refresh is divided: one rule at a time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.walking_people import FRONT, Sensor, Walker

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import Floor, floor_of_pose
from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.people import (
    JUMPED_BACK_S,
    MOST_JUDGED,
    WORK_A_FRAME,
    WORK_PER_PAIR,
    PeopleCalibration,
    PeopleCalibrationSettings,
    _parts,
)
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, layout_pair
from mocapella.calibration.sensor_pair import BY_LAYOUT, GIVEN_SD, GIVEN_SD_M, PairOfSensors
from mocapella.calibration.stated_pose import ENOUGH_S
from mocapella.calibration.time_offset import TimeOffset
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.model import condition_texts as texts
from mocapella.model.session import SensorPose

AB, AC, BC = ("a", "b"), ("a", "c"), ("b", "c")
SETTINGS = PeopleCalibrationSettings()
UNKNOWN = TimeOffset(0.0, 0.1, False)


def frame(
    people: PeopleCalibration, name: str, at_s: float, *bodies: int, pose: SensorPose | None = None
) -> PeopleState:
    """A frame of a sensor with these bodies, which stand."""
    seen = Sensor(name, FRONT).see({body: Walker(speed=0.0) for body in bodies}, at_s)
    return people.update(seen, round(1e9 * at_s), pose=pose)


def estimate(problem: str = "", T: np.ndarray | None = None, offset: TimeOffset = UNKNOWN) -> PairEstimate:
    C = np.diag([1e-4] * 3 + [4e-4] * 3)
    return PairEstimate(np.eye(4) if T is None else T, C, 0.02, 0.03, 5.0, 9.0, 0.05, offset, offset, problem)


def pair(problem: str | None = "", **more: Any) -> PairOfSensors:
    calibration = PairCalibration()
    calibration.scalars[at.BLOCKS_CLOSED] = 99.0
    found = None if problem is None else estimate(problem)
    return PairOfSensors(calibration, ColdStart(SETTINGS.pair), estimate=found, **{"shown": True, **more})


def place(name: str = "a", T: np.ndarray | None = None, **more: Any) -> PlacedSensor:
    values = {"covariance": np.zeros((6, 6)), "offset": None, "root": name, "trusted": True, **more}
    return PlacedSensor(np.eye(4) if T is None else T, **values)


@pytest.mark.parametrize(("back_s", "jumps"), [(-1.0, False), (JUMPED_BACK_S, False), (JUMPED_BACK_S + 0.125, True)])
def test_a_clock_jumped_if_times_go_back_by_more_than_frames_are_out_of_order(back_s: float, jumps: bool) -> None:
    people = PeopleCalibration()
    frame(people, "a", 8.0, 1)
    assert set(people._tracks["a"].bodies) == {1}
    frame(people, "a", 8.0 - back_s, 2)
    assert set(people._tracks["a"].bodies) == ({2} if jumps else {1, 2})
    assert people._jumped == ({"a": -back_s} if jumps else {})


def test_times_are_seconds_since_the_first_frame_and_a_sensor_is_behind_the_newest() -> None:
    people = PeopleCalibration()
    frame(people, "a", 1000.0)
    frame(people, "b", 1002.5)
    frame(people, "c", 999.0)
    assert people._newest == {"a": 0.0, "b": 2.5, "c": -1.0}
    assert people._behind == {"a": 0.0, "b": 0.0, "c": 3.5}


@pytest.mark.parametrize(("behind_s", "told"), [(2.0, False), (2.25, True)])
def test_a_clock_is_told_of_if_it_is_farther_behind_than_is_allowed(behind_s: float, told: bool) -> None:
    assert SETTINGS.clock_jump_s == 2.0
    people = PeopleCalibration()
    frame(people, "a", 10.0)
    frame(people, "b", 10.0 - behind_s)
    condition = people._conditions_of({"b": place("b")})["b"]
    assert (condition == texts.CLOCK_BEHIND.format(seconds=behind_s)) == told


def test_a_stated_pose_counts_with_a_height_until_the_sensor_is_moved() -> None:
    people = PeopleCalibration()
    for height, known in ((0.0, False), (1.5, True)):
        frame(people, "a", 1.0 + height, pose=SensorPose(0.1, height))
        assert ("a" in people._poses) == known
    people._poses.clear()
    people._moved["a"] = 0.0
    frame(people, "a", 4.0, pose=SensorPose(0.1, 1.5))
    assert people._poses == {}


def test_whoever_turns_out_to_be_upside_down_is_shown_at_once() -> None:
    people = PeopleCalibration()
    nobody = Sensor("a", FRONT).see({}, 0.0)
    for before, after in ((0.0, -ENOUGH_S), (-ENOUGH_S, 0.0), (0.0, 0.0), (-ENOUGH_S, -ENOUGH_S)):
        people._refresh_s = 0.4
        people._head_up_s = {"a": before}
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("mocapella.calibration.people.head_up_s", lambda *_, after=after: after)
            people._orient(nobody, SensorPose(), 0.1)
        assert people._refresh_s == (0.4 if before == after else 0.0)
        assert people._head_up_s["a"] == after


class Planned(PeopleCalibration):
    """Notes when a refresh begins, and which pairs frames refine."""

    def reset(self) -> None:
        super().reset()
        self.begun, self.asked = list[float](), list[float]()

    def _begin_refresh(self, now: float) -> None:
        self.begun.append(now)
        super()._begin_refresh(now)

    def _refine(self, key: Any, people: Any, now: float) -> None:
        self.asked.append(now)


def test_poses_are_computed_when_a_sensor_joins_and_at_their_interval() -> None:
    people = Planned(PeopleCalibrationSettings(refresh_s=0.5))
    for k in range(9):
        frame(people, "a", 0.25 * k)
    assert people.begun == [0.0, 0.5, 1.0, 1.5, 2.0]
    frame(people, "b", 2.125)
    assert people.begun[5:] == [2.125]
    frame(people, "a", 2.0)  # before the last refresh: the clock was set back
    assert people.begun[6:] == [2.0]
    people._steps = [("results", ())]
    frame(people, "a", 9.0)
    assert people.begun[7:] == []


def test_a_pair_is_refined_again_when_it_is_due_or_was_due_too_far_ahead() -> None:
    people = Planned()
    frame(people, "a", 0.0)
    frame(people, "b", 0.0)
    people._refined = {"a": (AB,), "b": (AB,)}
    every_s = SETTINGS.pair.every_s
    for due_in_s, asked in ((0.0, 1), (-1.0, 1), (0.001, 0), (0.999 * every_s, 0), (1.001 * every_s, 1), (np.inf, 1)):
        people.asked, people._steps = [], [("results", ())]
        people._pairs[AB].due = 0.25 + due_in_s
        frame(people, "a", 0.25)
        assert len(people.asked) == asked


@pytest.mark.parametrize(("name", "most"), [("hypotheses", 4), ("forgotten", 4), ("calibrations", 16), ("moved", 48)])
def test_steps_are_divided_so_that_each_is_of_one_frame(name: str, most: int) -> None:
    assert most == WORK_A_FRAME // WORK_PER_PAIR.get(name, 1)
    keys = [("s", str(k)) for k in range(2 * most + 1)]
    parts = _parts(name, keys)
    assert [step for step, _ in parts] == [name] * 3
    assert [len(of) for _, of in parts] == [most, most, 1]
    assert [key for _, of in parts for key in of] == keys
    assert _parts(name, []) == []


def test_a_frame_takes_steps_up_to_its_work_or_one_that_is_larger() -> None:
    class Counted(PeopleCalibration):
        taken = 0

        def _take(self, name: str, keys: Any, now: float, people: Any) -> None:
            self.taken += 1

    def taken(steps: list[tuple[str, int]], left: int = WORK_A_FRAME, pairs: int = 5) -> int:
        people = Counted()
        people._pairs = dict.fromkeys([("s", str(k)) for k in range(pairs)])  # type: ignore[arg-type]
        people._steps = [(name, tuple(("s", str(k)) for k in range(count))) for name, count in steps]
        people._advance(0.0, None, left)
        assert len(people._steps) == len(steps) - people.taken
        return people.taken

    assert taken([("hypotheses", 4), ("moved", 0)]) == 1
    assert taken([("hypotheses", 3), ("calibrations", 4), ("moved", 0)]) == 2  # exactly all of it
    assert taken([("hypotheses", 3), ("calibrations", 3), ("moved", 0)]) == 2
    assert taken([("moved", 0)] * 12) == 9  # of five pairs each
    assert taken([("moved", 0)] * 3, pairs=60) == 1
    assert taken([("moved", 0)] * 3, left=WORK_A_FRAME - 1, pairs=60) == 0
    assert taken([("moved", 0)] * 3, left=10) == 2


def test_a_refresh_compares_some_hypotheses_in_turn_and_all_that_is_known() -> None:
    people = PeopleCalibration()
    names = [f"s{k}" for k in range(8)]
    keys = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for name in names:
        frame(people, name, 0.0)
    for count in (MOST_JUDGED, MOST_JUDGED + 4):
        for key in keys:
            people._pairs[key].cold.hypotheses = {}
        for key in keys[:count]:
            people._pairs[key].cold.hypotheses = {(1, 1, False): PairCalibration()}
        turns = []
        for _ in range(count // 4):
            people._begin_refresh(1.0)
            turns.append([key for name, part in people._steps if name == "hypotheses" for key in part])
        assert all(len(turn) == len(set(turn)) == MOST_JUDGED for turn in turns)
        often = {key: sum(key in turn for turn in turns) for key in keys[:count]}
        assert set(often.values()) == {len(turns) * MOST_JUDGED // count}
        if count == MOST_JUDGED:
            assert all(turn == [key for key in people._pairs if key in keys[:count]] for turn in turns)
    people._pairs[keys[-1]].calibration = PairCalibration()
    people._begin_refresh(1.0)
    judged = [key for name, part in people._steps if name == "calibrations" for key in part]
    hypotheses = {key for name, part in people._steps if name == "hypotheses" for key in part}
    assert judged == sorted(hypotheses | {keys[-1]})


def test_bodies_that_were_not_seen_for_long_and_those_of_silent_sensors_are_forgotten() -> None:
    gone_s = SETTINGS.gone_after_s
    people = PeopleCalibration()
    frame(people, "a", 0.0, 1, 2)
    frame(people, "b", 0.0, 3)
    frame(people, "a", gone_s, 2)
    people._begin_refresh(gone_s)
    assert set(people._tracks["a"].bodies) == {1, 2}
    assert set(people._tracks["b"].bodies) == {3}
    people._begin_refresh(gone_s + 0.001)
    assert set(people._tracks["b"].bodies) == set()
    frame(people, "a", gone_s + 0.001, 2)
    people._begin_refresh(gone_s + 0.001)
    assert set(people._tracks["a"].bodies) == {2}


def test_both_have_seen_somebody_since_the_first_refresh_at_which_they_did_or_since_a_pause() -> None:
    people = PeopleCalibration()
    frame(people, "a", 0.0, 1)
    frame(people, "b", 0.0, 2)
    seen = []
    gone_s = SETTINGS.gone_after_s
    for now in (0.25, 0.5, 0.5 + gone_s, 0.501 + 2 * gone_s):
        for name, body in (("a", 1), ("b", 2)):
            people._newest[name] = now
            people._tracks[name] = SimpleNamespace(  # type: ignore[assignment]
                frozen=np.nan, bodies={body: None}, forget_before=lambda at: None
            )
        people._refreshed = people._refreshed if seen else 0.0
        people._pairs[AB].seen_since = people._pairs[AB].seen_since if seen else np.inf
        people._begin_refresh(now)
        seen.append(people._pairs[AB].seen_since)
    assert seen == [0.25, 0.25, 0.25, 0.501 + 2 * gone_s]
    people._tracks["b"].bodies.clear()
    people._begin_refresh(0.6 + 2 * gone_s)
    assert people._pairs[AB].seen_since == np.inf


def layout(pairs: dict[tuple[str, str], PairOfSensors] | None = None, *, floor: bool = True) -> SensorLayout:
    places = {"c": 0.0, "a": 1.0, "b": 3.0}
    sensors = {
        name: LayoutSensor(rigid(rotation_about_y(x), [x, 1.5, 0.0]).tolist(), 1.0, 0.1) for name, x in places.items()
    }
    kept = [layout_pair(*key, "", one.calibration) for key, one in (pairs or {}).items() if one.calibration is not None]
    return SensorLayout(VERSION, floor, sensors, kept)


def test_a_sensor_that_joins_has_a_pair_with_each_other_one_by_the_layout_where_it_has_both() -> None:
    kept = pair()
    kept.calibration = PairCalibration.begun_from(np.eye(4), PairSettings(told_s=7.0))
    people = PeopleCalibration(layout=layout({BC: kept}))
    for name in ("b", "z", "a", "c"):
        frame(people, name, 0.0)
    assert set(people._pairs) == {AB, AC, BC, ("a", "z"), ("b", "z"), ("c", "z")}
    for key, one in people._pairs.items():
        known = "z" not in key
        assert (one.told, one.calibration is not None) == (BY_LAYOUT if known else "", known)
        if known and key != BC:
            T = {name: np.array(people.layout.sensors[name].T_world_sensor) for name in key}  # type: ignore[union-attr]
            assert one.calibration is not None
            np.testing.assert_allclose(one.calibration.T_a_b, inverse(T[key[0]]) @ T[key[1]], atol=1e-12)
    assert people._pairs[BC].calibration.moments[0] == kept.calibration.moments[0]  # type: ignore[union-attr]
    assert people._in_order(["z", "b", "a", "y", "c"]) == ["c", "a", "b", "y", "z"]
    assert PeopleCalibration()._in_order(["b", "c", "a"]) == ["a", "b", "c"]


def test_given_poses_are_a_layout_as_uncertain_as_such_are() -> None:
    people = PeopleCalibration()
    people.start_from({"a": np.eye(4)})
    assert people.layout is not None
    told = people.layout.sensors["a"]
    assert told.position_sd_mm == pytest.approx(1000 * GIVEN_SD_M)
    assert told.rotation_sd_deg == pytest.approx(np.degrees(GIVEN_SD))
    assert not people.layout.floor_known


def test_the_floor_of_a_layout_counts_if_it_is_known_until_the_sensor_is_moved() -> None:
    people = PeopleCalibration(layout=layout())
    for name in ("a", "z"):
        frame(people, name, 0.0)
    floor = people._layout_floor("a")
    assert floor is not None
    assert floor.height == 1.5
    assert people._layout_floor("z") is None
    assert PeopleCalibration(layout=layout(floor=False))._layout_floor("a") is None
    assert PeopleCalibration()._layout_floor("a") is None
    people._moved["a"] = 0.0
    assert people._layout_floor("a") is None


def test_a_world_stands_on_the_stated_floors_then_on_found_ones_of_trusted_sensors_of_its_root() -> None:
    people = PeopleCalibration()
    for name in "abc":
        frame(people, name, 0.0)
    placed = {"a": place("a"), "b": place("b", root="a"), "c": place("c", root="c")}
    T, known = people._world("a", placed)
    np.testing.assert_array_equal(T, np.eye(4))
    assert not known
    people._head_up_s["a"] = -ENOUGH_S
    np.testing.assert_allclose(people._world("a", placed)[0], np.diag([-1.0, -1, 1, 1]), atol=1e-12)
    people._head_up_s["a"] = 0.0
    for name, height in (("b", 2.0), ("c", 9.0)):
        people._floors[name].known = Floor(np.array([0.0, 1.0, 0.0]), height, 0.02, 0.03)
    T, known = people._world("a", placed)
    assert known
    assert T[1, 3] == pytest.approx(2.0)
    assert not people._world("a", {**placed, "b": place("b", root="a", trusted=False)})[1]
    people._poses["a"] = SensorPose(0.0, 1.25)
    assert people._world("a", placed)[0][1, 3] == pytest.approx(1.25)
    people._floors["a"].known = Floor(np.array([1.0, 0.0, 0.0]), 3.0, 0.02, 0.03)  # people walk on another floor
    assert people._stated_floor("a") is None
    assert people._conditions_of(placed)["a"] == texts.MISTILTED
    assert people._conditions_of(placed)["b"] == ""
    assert floor_of_pose(0.0, 1.25).height == 1.25


def test_a_result_is_in_the_world_and_tells_a_sensors_own_uncertainty() -> None:
    people = PeopleCalibration()
    for name in "abcd":
        frame(people, name, 0.0)
    T_a_b, T_world_a = rigid(rotation_about_y(0.6), [5.0, 0.0, 0.0]), rigid(rotation_about_y(-1.0), [0.0, 2.0, 0.0])
    turn = np.diag([0.0, 0.0, 0.0, 0.0, 0.01**2, 0.0])
    placed = {
        "a": place("a"), "b": place("b", T_a_b, covariance=turn, root="a"),
        "c": place("c", root="a", trusted=False), "d": place("d", T_a_b, root="a"),
    }  # fmt: skip
    people._moved["d"] = 0.0
    found = people._sensors(placed, {"a": T_world_a}, dict.fromkeys(placed, "told"))
    np.testing.assert_allclose(found["b"].T_world_sensor, T_world_a @ T_a_b, atol=1e-12)
    assert found["a"].quality == ""
    assert found["b"].quality == "50 mm, 0.6°"  # a turn of 0.01 rad about a sensor 5 m away
    assert {name: one.trusted for name, one in found.items()} == {"a": True, "b": True, "c": False, "d": False}
    for doubt in ("b", "a"):
        people._doubted = frozenset({doubt})
        found = people._sensors(placed, {"a": T_world_a}, dict.fromkeys(placed, ""))
        assert [name for name, one in found.items() if one.trusted] == [name for name in "ab" if name != doubt]
    people._doubted, people._tracks["b"].frozen = frozenset(), -9.0
    found = people._sensors(placed, {"a": T_world_a}, dict.fromkeys(placed, ""))
    assert [name for name, one in found.items() if one.trusted] == ["a"]


def shown(people: PeopleCalibration, trusted: str) -> None:
    sensors = {
        name: CalibratedSensor(
            name, np.eye(4), np.diag([1e-4, 2e-4, 6e-4, 1e-4, 1e-4, 2e-4]), "a", None, name in trusted, "", ""
        )
        for name in "abcd"
    }
    people.state = PeopleState(sensors, (), True, 0, 0)


def test_a_layout_to_save_has_what_people_confirmed_in_millimetres_and_degrees() -> None:
    people = PeopleCalibration()
    people._pairs = {
        AB: pair(), AC: pair(told=BY_LAYOUT), BC: pair(WALK, shown=False), ("b", "d"): pair(), ("a", "d"): pair(None),
    }  # fmt: skip
    shown(people, "abc")
    assert people.tied == {"a", "b"}
    saved = people.layout_now()
    assert list(saved.sensors) == ["a", "b"]
    assert [(one.a, one.b) for one in saved.pairs] == [AB]
    assert saved.floor_known
    assert saved.sensors["a"].position_sd_mm == pytest.approx(30.0)
    assert saved.sensors["a"].rotation_sd_deg == pytest.approx(np.degrees(0.02))
    shown(people, "abcd")
    assert people.tied == {"a", "b", "d"}
    assert [(one.a, one.b) for one in people.layout_now().pairs] == [AB, ("b", "d")]


def test_poses_come_from_pairs_with_an_estimate_of_their_own() -> None:
    people, nowhere = PeopleCalibration(), pair()
    nowhere.estimate = estimate(T=np.full((4, 4), np.nan))
    people._pairs = {
        AB: pair(),
        AC: pair(told="others"),
        BC: pair(None),
        ("b", "d"): nowhere,
        ("c", "d"): pair(WALK, shown=False),
    }
    people._find_edges()
    assert {(edge.a, edge.b): edge.trusted for edge in people._edges} == {AB: True, ("c", "d"): False}


def test_a_pair_without_an_estimate_begins_from_those_of_others() -> None:
    T = rigid(rotation_about_y(0.3), [2.0, 0.0, 1.0])
    early, late = TimeOffset(0.25, 0.01, True), TimeOffset(1.0, 0.01, True)
    placed = {"a": place("a", offset=early), "b": place("b", T, root="a", offset=late)}
    new = PairOfSensors(None, ColdStart(SETTINGS.pair))

    def begun(where: dict[str, PlacedSensor], one: PairOfSensors, moved: str = "", partners: int = 4) -> PairOfSensors:
        people = PeopleCalibration(PeopleCalibrationSettings(partners=partners))
        people._pairs, people._moved = {AB: one}, dict.fromkeys(moved, 0.0)
        people._begin_from_others(where)
        return one

    one = begun(placed, PairOfSensors(None, ColdStart(SETTINGS.pair)), partners=1)
    assert (one.told, one.trying) == ("others", False)
    assert one.calibration is not None
    np.testing.assert_allclose(one.calibration.T_a_b, T)
    assert one.calibration.scalars[at.REFERENCE_OFFSET] == 0.75
    one = begun({**placed, "a": place("a")}, PairOfSensors(None, ColdStart(SETTINGS.pair)))
    assert one.calibration is not None
    assert one.calibration.scalars[at.REFERENCE_OFFSET] == 1.0
    for unsure in ("a", "b"):
        assert begun({**placed, unsure: place(unsure, root="a", trusted=False)}, new).calibration is None
        assert begun(placed, new, moved=unsure).calibration is None
    assert begun({**placed, "b": place("b", T)}, new).calibration is None
    assert begun({**placed, "c": place("c", root="a")}, new, partners=1).calibration is None
    known = pair()
    kept = known.calibration
    assert begun(placed, known).calibration is kept


@pytest.mark.parametrize("partners", [0, 1])
def test_each_sensor_has_a_partner_at_least(partners: int) -> None:
    if partners:
        assert PeopleCalibrationSettings(partners=1).partners == 1
    else:
        with pytest.raises(SettingsError, match="partners"):
            PeopleCalibrationSettings(partners=0)


def test_the_bodies_of_a_pair_are_listed_again_when_any_of_them_changes() -> None:
    one, body = pair(), np.zeros(1)
    assert one.calibration is not None
    both: list[Any] = [dict.fromkeys((1, 2, 3)), dict.fromkeys((4, 5, 6))]
    one.matched = ((1, 4),)
    listed = one.bodies_of_both(*both)
    assert listed == [(1, 4)]
    assert one.bodies_of_both(*both) is listed
    one.calibration.bodies[2, 5] = body  # in place, as by `PairCalibration.update`
    assert one.bodies_of_both(*both) == [(1, 4), (2, 5)]
    one.matched = ((3, 6),)
    assert one.bodies_of_both(*both) == [(3, 6), (2, 5)]
    both[1] = dict.fromkeys((4, 6))
    assert one.bodies_of_both(*both) == [(3, 6)]


def test_the_bodies_that_a_sensor_has_no_more_are_forgotten() -> None:
    one, body = pair(), np.zeros(1)
    assert one.calibration is not None
    both: list[Any] = [dict.fromkeys((1, 2)), dict.fromkeys((4, 5))]
    one.calibration.bodies = {(1, 4): body, (2, 5): body}
    kept = one.calibration.bodies
    for _ in range(2):
        one.forget_bodies(*both)
        assert one.calibration.bodies is kept
    kept[3, 4] = body
    one.forget_bodies(*both)
    assert list(one.calibration.bodies) == [(1, 4), (2, 5)]
    both[0] = dict.fromkeys((2,))
    one.forget_bodies(*both)
    assert list(one.calibration.bodies) == [(2, 5)]
