from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np
import pytest
from support.walking_people import BACK, FRONT, KINECT_V2, LEFT, RATE_HZ, SIDE, Sensor, Walker, errors, standing_at

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import PairCalibration
from mocapella.calibration.people import PeopleCalibration, PeopleCalibrationSettings
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.sensor_pair import PairOfSensors, used_pairs
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import inverse
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.session import SensorPose

Seen = Callable[[Sensor, float], Bodies]
ONE = {0: Walker()}
STANDING = {0: Walker(speed=0.0)}


def walks(  # noqa: PLR0917 - what happens, in order
    calibration: PeopleCalibration,
    sensors: Sequence[Sensor],
    see: Mapping[int, Walker] | Seen,
    seconds: float,
    begin: float = 0.0,
    each: Callable[[float, PeopleState], None] = lambda t, state: None,
) -> PeopleState:
    """Feed what the sensors see, as it comes; `each` is called after every frame."""
    frames = [
        (begin + sensor.phase + i / RATE_HZ, sensor.name, sensor)
        for sensor in sensors
        for i in range(round(seconds * RATE_HZ))
    ]
    for t, _, sensor in sorted(frames, key=lambda frame: frame[:2]):
        bodies = see(sensor, t) if callable(see) else sensor.see(dict(see), t)
        each(t, calibration.update(bodies, round((100 + t + sensor.clock) * 1e9)))
    return calibration.state


def two(noise: float = 0.01) -> tuple[Sensor, Sensor]:
    return Sensor("a", FRONT, noise=noise), Sensor("b", SIDE, noise=noise, phase=0.011)


def relative(state: PeopleState, a: str = "a", b: str = "b") -> np.ndarray:
    one, other = state.sensors[a], state.sensors[b]
    assert one.root == other.root
    return inverse(one.T_world_sensor) @ other.T_world_sensor


def wrong_by(state: PeopleState, a: Sensor, b: Sensor) -> tuple[float, float]:
    return errors(relative(state, a.name, b.name), inverse(a.T_world_sensor) @ b.T_world_sensor)


def test_eight_seconds_of_walking_place_three_sensors_and_their_clocks() -> None:
    sensors = [
        Sensor("a", FRONT, noise=0.01),
        Sensor("b", SIDE, noise=0.01, phase=0.011, clock=0.03),
        Sensor("c", LEFT, noise=0.01, phase=0.023, clock=-0.045),
    ]
    state = walks(PeopleCalibration(), sensors, ONE, 8)
    for other in sensors[1:]:
        metres, radians = wrong_by(state, sensors[0], other)
        assert metres < 0.010
        assert radians < np.radians(0.3)
        known = state.sensors[other.name]
        assert known.trusted
        assert known.clock is not None
        assert known.clock.seconds == pytest.approx(other.clock, abs=0.005)
    assert any(text.startswith("a–b: ") and "of shared motion" in text for text in state.qualities)
    assert state.conditions == ()


def test_sensors_that_never_see_the_same_person_are_tied_through_others() -> None:
    a, b, c = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01), Sensor("c", BACK, noise=0.01)
    left, right = Walker((-0.8, 2.6)), Walker((0.8, 3.0), phase=1.9, speed=0.9)
    sees = {"a": {1: left}, "b": {1: left, 2: right}, "c": {2: right}}
    state = walks(PeopleCalibration(), [a, b, c], lambda sensor, t: sensor.see(sees[sensor.name], t), 15)
    metres, radians = wrong_by(state, a, c)
    assert metres < 0.03
    assert radians < np.radians(1.0)
    assert all(sensor.trusted and sensor.root == "a" for sensor in state.sensors.values())


@pytest.mark.slow
def test_who_is_who_may_be_told_and_is_found_where_it_is_not() -> None:
    crowd = {0: Walker((-0.7, 2.6)), 1: Walker((0.7, 3.0), phase=1.9, speed=0.9)}
    for people in (None, lambda _: {0: 7, 1: 9}):
        a, b = two()
        calibration = PeopleCalibration()
        for i in range(round(15 * RATE_HZ)):
            for sensor in (a, b):
                calibration.update(sensor.see(crowd, i / RATE_HZ), round(i / RATE_HZ * 1e9), people)
        metres, radians = wrong_by(calibration.state, a, b)
        assert metres < 0.010
        assert radians < np.radians(0.3)


def test_the_floor_is_found_under_all_of_them_and_a_given_pose_is_believed() -> None:
    class Stepper(Walker):
        def at(self, t: float) -> np.ndarray:
            return super().at(0.6 * (t // 1.2) + min(t % 1.2, 0.6))

    a, b = two(0.005)
    state = walks(PeopleCalibration(), (a, b), {0: Stepper(speed=0.8)}, 12)
    assert state.floor_known
    for sensor in (a, b):
        found, truth = state.sensors[sensor.name].T_world_sensor, sensor.T_world_sensor
        assert found[1, 3] == pytest.approx(truth[1, 3], abs=0.06)
        assert np.arccos(np.clip(found[1, :3] @ truth[1, :3], -1, 1)) < np.radians(2.5)
    given = PeopleCalibration()
    for i in range(60):
        given.update(a.see(ONE, i / RATE_HZ), round(i / RATE_HZ * 1e9), None, SensorPose(0.1, 1.7))
    assert given.state.floor_known
    assert given.state.sensors["a"].T_world_sensor[1, 3] == pytest.approx(1.7)


# What is wrong is said.


def test_a_single_sensor_has_no_problem() -> None:
    state = walks(PeopleCalibration(), [Sensor("a", FRONT)], ONE, 2)
    assert state.sensors["a"].trusted
    assert state.conditions == ()


def test_sensors_that_never_share_a_person_stay_apart_and_say_so() -> None:
    a, b = two()
    one, other = {1: Walker((-1.0, 2.5))}, {2: Walker((1.0, 3.2), phase=2.0, speed=1.0)}
    state = walks(PeopleCalibration(), (a, b), lambda s, t: s.see(one if s is a else other, t), 12)
    assert state.sensors["a"].root != state.sensors["b"].root or not state.sensors["b"].trusted
    assert state.sensors["b"].condition
    nobody = walks(PeopleCalibration(), (a, b), lambda s, t: s.see(one if s is a else {}, t), 3)
    assert "walk where two sensors see you" in nobody.sensors["b"].condition


def test_everybody_standing_still_is_not_enough_and_walking_then_is() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    state = walks(calibration, (a, b), {0: Walker(speed=0.0), 1: Walker((0.8, 3.0), speed=0.0)}, 8)
    assert not state.sensors["b"].trusted
    assert "walk" in state.sensors["b"].condition
    state = walks(calibration, (a, b), {0: Walker(), 1: Walker((0.8, 3.0), phase=2.0, speed=0.5)}, 10, begin=8.0)
    assert state.sensors["b"].trusted
    assert wrong_by(state, a, b)[0] < 0.02


def test_two_who_stand_and_are_taken_for_one_are_told_apart_once_they_walk() -> None:
    a, b = two()
    still = {1: Walker((-0.8, 2.6), speed=0.0)}, {2: Walker((0.8, 3.2), speed=0.0)}
    walk = {1: Walker((-0.8, 2.6)), 2: Walker((0.8, 3.2), phase=2.0, speed=0.6)}
    calibration, said = PeopleCalibration(), set()
    state = walks(calibration, (a, b), lambda s, t: s.see(still[s is b], t), 4)
    assert state.sensors["b"].trusted, "nothing speaks against it yet"
    state = walks(
        calibration, (a, b), walk, 14, begin=4.0, each=lambda t, state: said.update(c for c in state.conditions)
    )
    assert wrong_by(state, a, b)[0] < 0.03
    assert state.moved == 0
    assert not any("it was moved" in condition for condition in said)


@pytest.mark.parametrize("again", [1, 3])
def test_a_contradicted_posture_moves_no_sensor_and_is_not_believed_twice(again: int) -> None:
    """Two stand before one sensor each; one of them then stands elsewhere, with the same tracking id or a new one."""
    a, b = two()
    there, elsewhere, other = (Walker(at, speed=0.0) for at in ((-0.8, 2.6), (0.4, 2.6), (0.8, 3.2)))
    calibration = PeopleCalibration()
    state = walks(calibration, (a, b), lambda s, t: s.see({1: there} if s is a else {2: other}, t), 4)
    assert state.sensors["b"].trusted
    state = walks(
        calibration, (a, b), lambda s, t: s.see({again: elsewhere} if s is a else {2: other}, t), 8, begin=4.0
    )
    assert state.moved == 0
    if again == 1:
        assert not state.sensors["b"].trusted
        assert "walk" in state.sensors["b"].condition


def test_one_posture_is_not_believed_while_a_sensor_sees_several_people() -> None:
    a, b = two()
    both, shape = {1: Walker(speed=0.0), 2: Walker((0.8, 3.0), speed=0.0)}, np.random.default_rng(0)
    unlike = shape.normal(size=(25, 3)) * 0.3

    def see(sensor: Sensor, t: float) -> Bodies:
        seen = sensor.see(both if sensor is a else {1: both[1]}, t)
        if sensor is a:
            seen.positions[1] += unlike
        return seen

    state = walks(PeopleCalibration(), (a, b), see, 4)
    assert not state.sensors["b"].trusted
    assert "walk" in state.sensors["b"].condition


def test_single_postures_tie_only_sensors_that_nothing_better_ties() -> None:
    def pair(*, walked: bool) -> PairOfSensors:
        made = PairOfSensors(PairCalibration(), ColdStart())
        made.calibration.scalars[at.BLOCKS_CLOSED] = 9.0 * walked
        made.estimate = msgspec.structs.replace(PairCalibration().estimate(), problem="")
        return made

    pairs = {("a", "b"): pair(walked=True), ("b", "c"): pair(walked=True), ("a", "c"): pair(walked=False)}
    assert used_pairs(pairs) == {("a", "b"), ("b", "c")}
    pairs[("b", "c")] = pair(walked=False)
    assert used_pairs(pairs) == pairs.keys()


def test_two_sensors_in_one_place_are_told_of() -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", FRONT, noise=0.01, phase=0.011)
    state = walks(PeopleCalibration(), (a, b), ONE, 8)
    assert wrong_by(state, a, b)[0] < 0.01
    assert state.sensors["b"].condition == "it stands where a stands, and sees no more: move one of them"


def test_a_clock_that_jumps_back_is_told_of_and_the_calibration_goes_on() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    walks(calibration, (a, b), ONE, 8)
    b.clock = -4.0
    state = walks(calibration, (a, b), ONE, 2, begin=8.0)
    assert state.sensors["b"].condition == "its clock is 4 s behind another sensor's: set the clocks alike"
    b.clock = 0.0
    state = walks(calibration, (a, b), ONE, 4, begin=10.0)
    assert state.sensors["b"].condition == ""
    assert state.sensors["b"].trusted
    assert wrong_by(state, a, b)[0] < 0.01
    b.clock = -1.0
    state = walks(calibration, (a, b), ONE, 0.5, begin=14.0)
    assert state.sensors["b"].condition == "its clock jumped back: start the sensor again if this returns"


def test_a_mirrored_picture_is_not_believed() -> None:
    a, b = two()

    def see(sensor: Sensor, t: float) -> Bodies:
        seen = sensor.see(ONE, t)
        if sensor is b:
            seen.positions[..., 0] *= -1
        return seen

    state = walks(PeopleCalibration(), (a, b), see, 15)
    assert not state.sensors["b"].trusted
    assert state.sensors["b"].condition in (
        "with a: one of the two images is mirrored: switch mirroring off",
        "with a: their skeletons do not move as one body: walk a few steps where both see you",
    )


def test_a_picture_that_stands_still_is_not_believed_and_spoils_nothing() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    before = walks(calibration, (a, b), ONE, 8)
    still = b.see(ONE, 8.0)
    state = walks(calibration, (a, b), lambda s, t: still if s is b else s.see(ONE, t), 4, begin=8.0)
    assert state.sensors["b"].condition == "its picture stands still: start the sensor again"
    assert not state.sensors["b"].trusted
    assert state.sensors["a"].trusted
    np.testing.assert_allclose(relative(state), relative(before), atol=5e-3)
    state = walks(calibration, (a, b), ONE, 3, begin=12.0)
    assert state.sensors["b"].trusted
    assert state.sensors["b"].condition == ""


def test_a_picture_that_stands_still_refines_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = two()
    calibration, updates, usual = PeopleCalibration(), list[object](), PairCalibration.update
    monkeypatch.setattr(PairCalibration, "update", lambda *args: updates.append(args) or usual(*args))
    walks(calibration, (a, b), ONE, 8)
    assert updates
    still = b.see(ONE, 8.0)

    def see(sensor: Sensor, t: float) -> Bodies:
        return still if sensor is b else sensor.see(ONE, t)

    walks(calibration, (a, b), see, 2, begin=8.0)  # until it is known to stand still
    before = len(updates)
    walks(calibration, (a, b), see, 2, begin=10.0)
    assert len(updates) == before


@pytest.mark.parametrize("blind", ["a", "b"])
def test_somebody_whom_one_sensor_sees_no_more_refines_nothing(blind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker may name a person for longer than the calibration keeps the body."""
    sensors, both = two(), {0: Walker((-0.7, 2.6)), 1: Walker((0.7, 3.0), phase=1.9)}
    numbers = {0: 7, 1: 9}
    calibration, refined, usual = PeopleCalibration(), set[object](), PairCalibration.update
    monkeypatch.setattr(PairCalibration, "update", lambda *args: refined.add(args[1]) or usual(*args))
    calibration.start_from({sensor.name: sensor.T_world_sensor for sensor in sensors})

    def go_on(begin: float, end: float, lost: str = "") -> set[object]:
        refined.clear()
        for k in range(round(begin * RATE_HZ), round(end * RATE_HZ)):
            for sensor in sensors:
                seen = sensor.see({0: both[0]} if sensor.name == lost else both, k / RATE_HZ)
                calibration.update(seen, round(1e9 * k / RATE_HZ), lambda name: numbers)
        return refined.copy()

    gone_s = 1.0 + 2 * calibration.settings.gone_after_s
    assert go_on(0.0, 1.0) == {(0, 0), (1, 1)}
    go_on(1.0, gone_s, blind)
    assert go_on(gone_s, gone_s + 0.5, blind) == {(0, 0)}


def test_joints_at_the_lens_or_nowhere_do_not_count() -> None:
    a, b = two()
    rng = np.random.default_rng(3)

    def see(sensor: Sensor, t: float) -> Bodies:
        seen = sensor.see(ONE, t)
        for value in (0.0, np.nan, np.inf):
            seen.positions[:, rng.integers(0, 25)] = value
        return seen

    state = walks(PeopleCalibration(), (a, b), see, 8)
    assert wrong_by(state, a, b)[0] < 0.015
    empty = walks(
        PeopleCalibration(),
        (a, b),
        lambda s, t: Bodies(s.name, KINECT_V2, (0,), np.zeros((1, 25, 3)), np.full((1, 25), JointState.TRACKED, "u1")),
        2,
    )
    assert all(np.isfinite(sensor.T_world_sensor).all() for sensor in empty.sensors.values())
    assert empty.sensors["b"].root == "b"
    assert empty.sensors["b"].condition


def test_bodies_that_flicker_under_new_ids_still_place_the_sensors() -> None:
    a, b = two()

    def see(sensor: Sensor, t: float) -> Bodies:
        number = int(t / 0.9) + (0 if sensor is a else 1000)
        return sensor.see({number: Walker()} if t % 0.9 < 0.7 else {}, t)

    calibration = PeopleCalibration()
    state = walks(calibration, (a, b), ONE, 6)
    assert state.sensors["b"].trusted
    state = walks(calibration, (a, b), see, 10, begin=6.0)
    assert state.sensors["b"].trusted
    assert wrong_by(state, a, b)[0] < 0.01
    never = walks(PeopleCalibration(), (a, b), see, 10)
    assert never.sensors["b"].trusted or never.sensors["b"].condition


# Sensors that are moved, and layouts.


@pytest.mark.parametrize("others", [[], [Sensor("c", LEFT, noise=0.01, phase=0.02)]])
def test_a_moved_sensor_is_noticed_within_three_seconds_and_finds_its_place_again(others: list[Sensor]) -> None:
    a, b = two()
    sensors = [a, b, *others]
    calibration = PeopleCalibration()
    assert walks(calibration, sensors, ONE, 10).moved == 0
    b.T_world_sensor = SIDE @ standing_at(0.1, 0.0, 8.0, height=0.0)
    noticed: list[float] = []

    def watch(t: float, state: PeopleState) -> None:
        if state.moved and not noticed:
            noticed.append(t)
            assert not state.sensors["b"].trusted
            assert state.sensors["b"].condition.startswith("it was moved")
            assert state.sensors["a"].trusted

    state = walks(calibration, sensors, ONE, 14, 10.0, watch)
    assert noticed
    assert noticed[0] - 10.0 < 3.0
    assert state.moved == 1
    assert state.sensors["b"].trusted
    metres, radians = wrong_by(state, a, b)
    assert metres < 0.010
    assert radians < np.radians(0.3)


def test_a_place_that_is_told_is_used_at_once_and_soon_put_right() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    wrong = SIDE @ standing_at(0.1, 0.0, 6.0, height=0.0)
    calibration.start_from({"a": FRONT, "b": wrong})
    state = walks(calibration, (a, b), ONE, 0.2)
    assert state.sensors["b"].trusted
    np.testing.assert_allclose(relative(state), inverse(FRONT) @ wrong, atol=0.2)
    assert "unknown" not in str(walks(calibration, (a, b), ONE, 8, begin=0.2).sensors["b"].condition)
    assert wrong_by(calibration.state, a, b)[0] < 0.01


@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
def test_the_first_sensor_of_a_layout_is_the_root_whoever_is_heard_first(names: tuple[str, str]) -> None:
    calibration = PeopleCalibration()
    calibration.start_from({name: {"a": FRONT, "b": SIDE}[name] for name in names})
    for sensors in (two(), two()[::-1]):
        state = walks(calibration, sensors, ONE, 3)
        assert tuple(state.sensors) == names
        assert {sensor.root for sensor in state.sensors.values()} == {names[0]}


def test_a_layout_goes_on_where_it_was_saved() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    saved = walks(calibration, (a, b), ONE, 10)
    again = PeopleCalibration(layout=calibration.layout_now())
    state = walks(again, (a, b), STANDING, 0.5)
    assert state.sensors["b"].trusted
    np.testing.assert_allclose(relative(state), relative(saved), atol=5e-3)
    assert state.floor_known == saved.floor_known


def test_a_layout_that_does_not_fit_is_said_not_used_and_made_anew() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    walks(calibration, (a, b), ONE, 10)
    layout = calibration.layout_now()
    b.T_world_sensor = SIDE @ standing_at(0.9, 0.0, 40.0, height=0.0)
    again, said = PeopleCalibration(layout=layout), set()

    def watch(t: float, state: PeopleState) -> None:
        if t > 3.0 and "b" in state.sensors and not state.sensors["b"].trusted:
            said.add(state.sensors["b"].condition)

    state = walks(again, (a, b), {0: Walker(speed=0.5)}, 20, each=watch)
    assert "it does not see people where the layout says: walk a few steps where both see you" in said
    assert state.sensors["b"].trusted
    assert wrong_by(state, a, b)[0] < 0.02
    assert state.moved == 0


# What is remembered.


def test_the_same_frames_give_the_same_bits_and_what_was_remembered_goes_on() -> None:
    from mocapella.model.memory import pack, unpack
    from mocapella.tracker.default import _REMEMBERED

    def run(upto: float, restored: bool = False) -> PeopleCalibration:
        a, b = two()
        calibration = PeopleCalibration()
        walks(calibration, (a, b), ONE, 5)
        if restored:
            memory = unpack(pack(vars(calibration), _REMEMBERED), _REMEMBERED)
            calibration = PeopleCalibration()
            vars(calibration).update(memory)
        walks(calibration, (a, b), ONE, upto - 5, begin=5.0)
        return calibration

    first, second, restored = run(9), run(9), run(9, restored=True)
    for other in (second, restored):
        assert pack(vars(other), _REMEMBERED) == pack(vars(first), _REMEMBERED)


def test_memory_does_not_grow_with_time_nor_with_people_who_are_gone() -> None:
    from mocapella.model.memory import pack
    from mocapella.tracker.default import _REMEMBERED

    a, b = two()
    calibration, sizes = PeopleCalibration(), []
    for k in range(6):
        # Somebody else comes every five seconds.
        walks(calibration, (a, b), {k: Walker(phase=0.3 * k)}, 5, begin=5.0 * k)
        sizes.append(len(pack(vars(calibration), _REMEMBERED)))
    assert max(sizes[2:]) < 1.3 * sizes[1]


@pytest.mark.parametrize("setting", ["match_within_m", "refresh_s", "first_refresh_s", "moved_after_s"])
def test_settings_out_of_range_are_refused(setting: str) -> None:
    with pytest.raises(SettingsError, match=setting):
        PeopleCalibrationSettings(**{setting: 0.0})  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="partners"):
        PeopleCalibrationSettings(partners=0)


def test_many_sensors_are_each_refined_against_a_few() -> None:
    turns = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    ring = [
        Sensor(f"s{i}", standing_at(2.6 * np.sin(a), 2.8 - 2.6 * np.cos(a), -np.degrees(a)), noise=0.01, phase=i / 210)
        for i, a in enumerate(turns)
    ]
    calibration = PeopleCalibration(PeopleCalibrationSettings(partners=2))
    state = walks(calibration, ring, ONE, 10)
    assert all(sensor.trusted and sensor.root == "s0" for sensor in state.sensors.values())
    for sensor in ring[1:]:
        assert wrong_by(state, ring[0], sensor)[0] < 0.02
    refined = [len(keys) for keys in calibration._refined.values()]
    assert max(refined) < len(ring) - 1


def test_the_state_is_a_value() -> None:
    state = walks(PeopleCalibration(), two(), ONE, 1)
    assert isinstance(state.sensors["a"], CalibratedSensor)
    with pytest.raises(AttributeError):
        state.moved = 3  # type: ignore[misc]


def test_a_pause_is_no_disagreement() -> None:
    a, b = two()
    calibration = PeopleCalibration()
    calibration.start_from({"a": FRONT, "b": SIDE})
    walks(calibration, (a, b), STANDING, 3)

    def watch(t: float, state: PeopleState) -> None:
        assert state.sensors["b"].trusted, t

    walks(calibration, (a, b), STANDING, 1, 20.0, watch)
