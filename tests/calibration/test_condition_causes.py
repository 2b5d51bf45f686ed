"""Each condition is raised by its one cause, and clears without it; a condition without such a case fails here."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.walking_people import BACK, FRONT, LEFT, RATE_HZ, SIDE, Sensor, Walker, standing_at

from mocapella import calibration
from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import PairCalibration, PairSettings
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.calibration.people_state import PeopleState
from mocapella.calibration.sensor_conditions import contradicts, pose_condition
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.sensor_pair import PairOfSensors
from mocapella.calibration.shared_people import SURE_FIELD, missed_people
from mocapella.model import condition_texts as texts
from mocapella.model.bodies import Bodies
from mocapella.model.conditions import is_warning, trouble
from mocapella.model.session import SensorPose

People = Mapping[int, Walker]
ONE: People = {1: Walker()}
TWO: People = {1: Walker((-0.7, 2.6)), 2: Walker((0.7, 3.0), phase=1.9, speed=0.9)}
OTHER: People = {2: Walker((0.9, 3.2), phase=2.5, speed=0.9)}
STANDING: People = {1: Walker(speed=0.0)}
STEADY_S = 8.0
"""Time of the calibrated session before some causes, and of walking after each [s]."""


class Session:
    """Two sensors; what is wrong with them is set between calls of `go`, as is what they see."""

    def __init__(self, settings: PeopleCalibrationSettings | None = None) -> None:
        self.a, self.b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.011)
        self.calibration = PeopleCalibration(settings)
        self.spoil: Callable[[Sensor, Bodies], Bodies] = lambda sensor, bodies: bodies
        self.pose: SensorPose | None = None
        self.state = PeopleState({}, (), False, 0, 0)
        self.now = 0.0

    def go(self, seconds: float, a: People = ONE, b: People | None = None) -> set[str]:
        """Feed frames of what each sensor sees, ``a`` if ``b`` is None; return the conditions of both so far."""
        said = set()
        begin, self.now = self.now, self.now + seconds
        for k in range(round(seconds * RATE_HZ)):
            for sensor, people in ((self.a, a), (self.b, a if b is None else b)):
                t = begin + k / RATE_HZ + sensor.phase
                bodies = self.spoil(sensor, sensor.see(people, t))
                self.state = self.calibration.update(
                    bodies,
                    round(1e9 * (100 + t + sensor.clock)),
                    pose=self.pose if sensor is self.a else None,
                )
                said |= {trouble(known.condition) for known in self.state.sensors.values() if known.condition}
        return said

    def relative(self) -> np.ndarray:
        """Return the pose of b in a's frame (4, 4)."""
        a, b = (self.state.sensors[name].T_world_sensor for name in "ab")
        return np.linalg.inv(a) @ b

    def calibrate(self) -> Session:
        self.go(STEADY_S)
        assert self.state.conditions == ()
        return self


@dataclass(frozen=True)
class Case:
    """A condition: a session in which it is raised, and the remedy; people walk afterwards."""

    cause: Callable[[], tuple[Session, set[str]]]
    remedy: Callable[[Session], object] = lambda session: None


def _sees_nobody() -> tuple[Session, set[str]]:
    session = Session()
    return session, session.go(2, ONE, {})


def _stands() -> tuple[Session, set[str]]:
    session = Session()
    return session, session.go(1.5, STANDING)


def _one_direction() -> tuple[Session, set[str]]:
    session = Session(PeopleCalibrationSettings(PairSettings(position_sd_wanted_m=0.03, rotation_sd_wanted=0.03)))
    session.a.noise = session.b.noise = 0.1
    return session, session.go(8)


def _clear(session: Session) -> None:
    session.a.noise = session.b.noise = 0.01
    session.go(STEADY_S)


def _on_a_line() -> tuple[Session, set[str]]:
    session = Session()

    def straight(sensor: Sensor, bodies: Bodies) -> Bodies:
        bodies.positions[:] = bodies.positions[:, :1] + np.linspace(-0.3, 0.3, 25)[:, None] * [0.0, 1.0, 0.0]
        return bodies

    session.spoil = straight
    return session, session.go(3, STANDING)


def _unmirrored(session: Session) -> None:
    _whole(session)
    session.go(2 * STEADY_S)  # until what was seen mirrored is forgotten


def _whole(session: Session) -> None:
    session.spoil = lambda sensor, bodies: bodies


def _two_for_one() -> tuple[Session, set[str]]:
    session = Session()
    return session, session.go(10, ONE, OTHER)


def _front_or_back() -> tuple[Session, set[str]]:
    session = Session()
    session.b.T_world_sensor = BACK
    session.a.noise = session.b.noise = 0.05
    return session, session.go(4, STANDING)


def _in_step() -> tuple[Session, set[str]]:
    session = Session()
    return session, session.go(6, {1: Walker((-0.8, 2.8)), 2: Walker((0.4, 2.8))})


def _one_alone(session: Session) -> None:
    session.go(STEADY_S, {1: Walker((-0.8, 2.8)), 2: Walker((0.4, 2.8), speed=0.0)})


def _frozen() -> tuple[Session, set[str]]:
    session = Session().calibrate()
    still = session.b.see(ONE, session.now)
    session.spoil = lambda sensor, bodies: still if sensor is session.b else bodies
    return session, session.go(2)


def _clock(seconds: float) -> tuple[Session, set[str]]:
    session = Session().calibrate()
    session.b.clock = -seconds
    return session, session.go(0.5)


def _set_alike(session: Session) -> None:
    session.b.clock = 0.0


def _moved() -> tuple[Session, set[str]]:
    session = Session().calibrate()
    session.b.T_world_sensor = LEFT
    return session, session.go(3)


def _same_place() -> tuple[Session, set[str]]:
    session = Session()
    session.b.T_world_sensor = FRONT
    return session, session.go(STEADY_S)


def _aside(session: Session) -> None:
    session.b.T_world_sensor = SIDE
    session.go(STEADY_S)


def _moved_unseen() -> tuple[Session, set[str]]:
    session = Session().calibrate()
    session.go(2, {})
    session.b.T_world_sensor = SIDE @ standing_at(0.6, 0.0, 15.0, height=0.0)
    return session, session.go(5, {7: Walker(speed=0.0)})


def _wrong_layout() -> tuple[Session, set[str]]:
    before, session = Session().calibrate(), Session()
    session.calibration.layout = before.calibration.layout_now()
    session.b.T_world_sensor = SIDE @ standing_at(0.9, 0.0, 40.0, height=0.0)
    return session, session.go(5, STANDING)


def _mirrored() -> tuple[Session, set[str]]:
    session = Session()

    def mirror(sensor: Sensor, bodies: Bodies) -> Bodies:
        if sensor is session.b:
            bodies.positions[..., 0] *= -1
        return bodies

    session.spoil = mirror
    return session, session.go(15)


class Stepper(Walker):
    """Walks and stands in turn, for 0.6 s each, so that feet stand."""

    def at(self, t: float) -> np.ndarray:
        return super().at(0.6 * (t // 1.2) + min(t % 1.2, 0.6))


def _mistilted() -> tuple[Session, set[str]]:
    session = Session()
    session.pose = SensorPose(np.radians(60.0), 1.0)
    return session, session.go(STEADY_S, {1: Stepper(speed=0.8)})


def _tilt_corrected(session: Session) -> None:
    session.pose = SensorPose(0.0, 1.0)


CASES = {
    texts.SEES_NOBODY: Case(_sees_nobody),
    texts.NOBODY_SHARED: Case(_sees_nobody),
    texts.WALK: Case(_stands),
    texts.WALK_ACROSS: Case(_one_direction, _clear),
    texts.ON_A_LINE: Case(_on_a_line, _whole),
    texts.NOT_ONE_BODY: Case(_two_for_one),
    texts.WHICH_SIDE: Case(_front_or_back),
    texts.WHO_IS_WHO: Case(_in_step, _one_alone),
    texts.FROZEN: Case(_frozen, _whole),
    texts.CLOCK_BEHIND: Case(lambda: _clock(4.0), _set_alike),
    texts.CLOCK_JUMPED: Case(lambda: _clock(1.0), _set_alike),
    texts.MOVED: Case(_moved),
    texts.ONE_PLACE: Case(_same_place, _aside),
    texts.UNSEEN: Case(_moved_unseen),
    texts.UNSEEN_BY_LAYOUT: Case(_wrong_layout),
    texts.MIRRORED_STREAM: Case(_mirrored, _unmirrored),
    texts.MISTILTED: Case(_mistilted, _tilt_corrected),
}


@pytest.mark.parametrize("text", CASES)
def test_a_condition_is_raised_by_its_cause_and_clears_without_it(text: str) -> None:
    session, said = CASES[text].cause()
    assert said & {text.format(seconds=4, other=other) for other in "ab"}
    CASES[text].remedy(session)
    session.go(STEADY_S)
    assert session.state.conditions == ()
    assert all(known.trusted for known in session.state.sensors.values())


def test_before_a_person_is_seen_a_pair_says_so_and_not_afterwards() -> None:
    """The one text that a pair says, and no sensor: a pair without a person is not judged."""
    assert PairCalibration().estimate().problem == texts.NO_PERSON
    session = Session()
    assert texts.NO_PERSON not in session.go(1, {}) | session.go(1)


def test_every_condition_has_a_case() -> None:
    assert {*CASES, texts.NO_PERSON} == {*texts.UNFINISHED, *texts.WARNINGS}
    written = {value for name, value in vars(texts).items() if name.isupper() and isinstance(value, str)}
    assert written == {*texts.UNFINISHED, *texts.WARNINGS}


def conditions_written_in(source: str) -> list[str]:
    """Texts of a module that a user could read as a condition: literals of three words, other than docstrings."""
    tree = ast.parse(source)
    aside = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    checks = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "check"]
    aside |= {id(node) for call in checks for node in ast.walk(call)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in aside
        and len(node.value.split()) > 2
    ]


@pytest.mark.parametrize(
    "module", ["sensor_conditions", "pair_calibration", "cold_start", "sensor_pair", "people", "moved_sensor"]
)
def test_conditions_are_written_in_one_place_only(module: str) -> None:
    folder = Path(calibration.__file__).parent
    assert conditions_written_in((folder / f"{module}.py").read_text(encoding="utf-8")) == []


def test_a_condition_that_is_written_elsewhere_is_found() -> None:
    assert conditions_written_in('"""Doc of it."""\nX = "it is upside down: turn it"\n') == [
        "it is upside down: turn it"
    ]


def test_only_an_unfinished_calibration_is_no_warning() -> None:
    assert not is_warning("")
    assert not any(is_warning(text) or is_warning(f"with a: {text}") for text in texts.UNFINISHED)
    assert all(is_warning(text) and is_warning(f"with a: {text}") for text in texts.WARNINGS)
    assert is_warning("what a plug-in says")


def test_the_documentation_lists_every_condition() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "health.md").read_text(encoding="utf-8")
    for text in (*texts.UNFINISHED, *texts.WARNINGS):
        assert f"`{text.format(seconds=4, other='front')}`" in page, text


P, Q = (-0.5, 2.4), (0.8, 2.4)
"""Two positions (x, z) in the middle of both sensors' images [m]."""


def test_a_sensor_that_falls_silent_leaves_the_others_without_a_condition() -> None:
    session = Session().calibrate()
    session.go(2, {5: Walker(P, speed=0.0)})
    for k in range(round(6 * RATE_HZ)):
        t = session.now + k / RATE_HZ
        bodies = session.a.see({6: Walker(Q, speed=0.0)}, t)
        session.state = session.calibration.update(bodies, round(1e9 * (100 + t)))
    assert session.state.conditions == ()


def tracked(sensor: Sensor, *places: tuple[float, float]) -> SensorTracks:
    seen = sensor.see({k: Walker(place, speed=0.0, phase=0.0) for k, place in enumerate(places)}, 0.0)
    tracks = SensorTracks.empty(25)
    tracks.add(0.0, seen.ids, seen.positions, seen.states, 0.2)
    return tracks


@pytest.mark.parametrize(
    ("a", "b", "missed"),
    [
        ([P], [Q], True),
        ([P], [(1.4, 2.4)], False),  # at the border of a's image
        ([P], [(0.8, 1.0)], False),  # too near to a
        ([P], [(1.5, 4.1)], False),  # too far from both
        ([P, (1.6, 2.2)], [Q], True),
        ([P, (0.55, 1.65)], [Q], False),  # hidden from a
        ([(0.6, 3.2)], [P], False),  # hidden from b
        ([P], [(0.6, 3.2)], True),  # b sees past the place where a sees a person
    ],
)
def test_a_person_is_missed_only_where_each_sensor_should_see_the_other_ones(
    a: list[tuple[float, float]], b: list[tuple[float, float]], missed: bool
) -> None:
    T_a_b = np.linalg.inv(FRONT) @ SIDE
    ours, theirs = (tracked(Sensor("a", FRONT), *a).newest_centres(), tracked(Sensor("b", SIDE), *b).newest_centres())
    assert missed_people(T_a_b, ours, theirs, SURE_FIELD) is missed
    assert missed_people(np.linalg.inv(T_a_b), theirs, ours, SURE_FIELD) is missed


@pytest.mark.parametrize(
    ("walked", "sd_m", "sd", "said"),
    [(True, 0.01, 0.01, True), (False, 0.01, 0.01, False), (True, 0.05, 0.01, False), (True, 0.01, 0.05, False)],
)
def test_two_sensors_are_said_to_be_at_one_place_only_if_that_is_known(
    walked: bool, sd_m: float, sd: float, said: bool
) -> None:
    pair = PairOfSensors(PairCalibration(), ColdStart(), trying=False)
    pair.calibration.scalars[at.BLOCKS_CLOSED] = 9.0 * walked
    C = np.diag([sd_m**2 / 3] * 3 + [sd**2 / 3] * 3)
    pair.estimate = msgspec.structs.replace(PairCalibration().estimate(), problem="", T_a_b=np.eye(4), covariance=C)
    placed = {name: PlacedSensor(np.eye(4), C, None, "a", True) for name in "ab"}
    pairs = {("a", "b"): pair}
    contradicted = pairs if contradicts(pair) else {}
    condition = pose_condition("b", pairs, contradicted, placed, seeing=True)
    assert condition == (texts.ONE_PLACE.format(other="a") if said else "")


def test_two_people_whom_one_sensor_sees_each_are_no_contradiction() -> None:
    """With a calibrated pair, and with poses from a layout alone."""
    left, right = {1: Walker((-2.6, 3.6), speed=0.0)}, {2: Walker((2.6, 3.6), speed=0.0)}
    fresh = Session()
    fresh.calibration.start_from({"a": FRONT, "b": standing_at(9.0, 0.0)})
    fresh.b.T_world_sensor = standing_at(9.0, 0.0)
    assert fresh.go(8, {1: Walker(speed=0.0)}, {2: Walker((9.3, 2.8), speed=0.0)}) == set()
    session = Session().calibrate()
    assert session.go(8, left, right) == set()


def test_two_people_who_stand_apart_do_not_replace_a_pose_from_walking() -> None:
    session = Session().calibrate()
    before = session.relative()
    lifted = {1: Walker((-0.9, 2.4), speed=0.0)}, {2: Walker((0.5, 3.2), speed=0.0)}

    def lift(sensor: Sensor, bodies: Bodies) -> Bodies:
        bodies.positions[:, 8:12] += [0.2, 0.5, 0.1] @ sensor.T_world_sensor[:3, :3]
        return bodies

    session.spoil = lift
    session.go(8, *lifted)
    assert session.state.moved == 0
    np.testing.assert_allclose(session.relative(), before, atol=0.02)
