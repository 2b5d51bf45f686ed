"""Postures, bodies and mountings that are easily misread: nothing unknown is shown as measured.

Rooms are simulated, with sensors that have the errors of real ones; `spoil` adds what a sensor gets wrong.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest
from support.walking_people import FRONT, SIDE, Walker

from mocapella.conventions import NS_PER_S
from mocapella.evaluation.calibration_in_place import CENTRE_M, measured_sensor
from mocapella.evaluation.posture_sessions import score_postures
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.conditions import is_warning
from mocapella.model.observations import Arrival, BodyFrame, JointState
from mocapella.model.scene import Phase
from mocapella.model.skeleton import SKELETON
from mocapella.sources.simulate import Box, PersonSettings, SceneSettings, SimulatedSensor, build_room, merge
from mocapella.testing.walking import walking_arrivals
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.people import UNSURE
from mocapella.tracker.people_memory import GUESS_SD_M_S, MOST_GUESS_SD_M

MIRROR = np.array(SKELETON.mirror)
SIDED = np.arange(len(SKELETON)) != MIRROR
LEGS = [SKELETON.index(part + side) for part in ("Knee", "Ankle", "Foot") for side in ("Left", "Right")]
WALK = ("go 0.7 2.3", "go -0.7 3.3", "go -0.6 2.2", "go 0.6 3.2", "go 0.0 2.8", "turn 180")
Spoil = Callable[[BodyFrame, float], BodyFrame]


@dataclass
class Session:
    """What a tracker said of a room, at each frame of the main sensor.

    Attributes:
        at_s: room times [s].
        people: number of people.
        error_m, swapped: of each person in turn, mean error of the joints, and whether exchanging the sides lowers it.
        legs_m, legs_sd: of each person in turn, errors and stated standard deviations of knees, ankles and feet.
        legs: number of these joints with each state.
        conditions: conditions of persons, as (time, text).
        warnings: number of frames with each warning of a sensor, and with another phase after the first of tracking.
        ids: all ids of people.
    """

    at_s: list[float] = field(default_factory=list)
    people: list[int] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    swapped: list[bool] = field(default_factory=list)
    legs_m: list[float] = field(default_factory=list)
    legs_sd: list[float] = field(default_factory=list)
    legs: Counter[int] = field(default_factory=Counter)
    conditions: list[tuple[float, str]] = field(default_factory=list)
    warnings: Counter[str] = field(default_factory=Counter)
    ids: set[int] = field(default_factory=set)

    def said(self, text: str) -> list[float]:
        """Return the times at which a person had a condition [s]."""
        return [at for at, said in self.conditions if text in said]


def sensors_at(*azimuths_deg: float, height: float = 1.0, tilt_deg: float = 0.0, forget_s: float = 2.0) -> tuple:
    return tuple(
        dataclasses.replace(
            measured_sensor(
                f"sensor{k}", azimuth, height=height, tilt_deg=tilt_deg, phase_s=0.011 * k, latency_s=0.06 + 0.01 * k
            ),
            forget_s=forget_s,
        )
        for k, azimuth in enumerate(azimuths_deg)
    )


def follow(
    sensors: Sequence, people: Sequence[PersonSettings], *, seed: int = 1, spoil: Spoil | None = None,
    boxes: tuple[Box, ...] = (), end_s: float | None = None,
) -> Session:  # fmt: skip
    room = build_room(SceneSettings("unusual", tuple(sensors), tuple(people), boxes, seed=seed))
    tracker, session, tracks = DefaultTracker(sensors_expected=len(sensors)), Session(), False
    of = {sensor.name: sensor for sensor in sensors}
    main = sensors[0]
    for item in merge([SimulatedSensor(room, name) for name in of], 0.0, room.duration_s if end_s is None else end_s):
        at_s = item.truth.room_ns / NS_PER_S
        frame = item.frame if spoil is None else spoil(item.frame, at_s)
        scene = tracker.update(Arrival(frame, item.truth.room_ns + round(of[frame.sensor].latency_s * NS_PER_S)))
        tracks = tracks or scene.state.phase is Phase.TRACKING
        if tracks and scene.state.phase is not Phase.TRACKING:
            session.warnings[scene.state.phase] += 1
        session.warnings.update(place.problem for place in scene.sensors if is_warning(place.problem))
        place = next((place.T_world_sensor for place in scene.sensors if place.sensor == main.name), None)
        if frame.sensor != main.name or place is None:
            continue
        session.at_s.append(at_s)
        session.people.append(len(scene.people))
        for person in scene.people:
            found = apply(main.T_world_sensor @ inverse(place), person.positions)
            centres = np.linalg.norm(item.truth.positions.mean(axis=1) - np.nanmean(found, axis=0), axis=1)
            truth = item.truth.positions[centres.argmin()]
            error = np.linalg.norm(found - truth, axis=-1)
            exchanged = np.linalg.norm(found[MIRROR] - truth, axis=-1)
            session.ids.add(person.id)
            session.error_m.append(float(np.nanmean(error)))
            session.swapped.append(bool(np.nanmean(exchanged[SIDED]) < np.nanmean(error[SIDED])))
            session.legs.update(person.states[LEGS].tolist())
            known = person.states[LEGS] != JointState.NOT_TRACKED
            assert person.sd is not None
            assert (np.isfinite(person.positions[LEGS]).all(axis=-1) == known).all()
            assert (np.isfinite(person.sd[LEGS]) == known).all()
            session.legs_m += error[LEGS][known].tolist()
            session.legs_sd += person.sd[LEGS][known].tolist()
            if person.condition:
                session.conditions.append((at_s, person.condition))
    return session


def walker(*after: str, **how: float) -> PersonSettings:
    return PersonSettings(CENTRE_M, "route", route=("stand 1", *WALK, *after), **how)


# --- a sensor upside down -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("rolled", [(0.0, 180.0), (180.0, 0.0)])
def test_a_sensor_that_is_upside_down_is_as_good_as_an_upright_one(rolled: tuple[float, ...]) -> None:
    sensors = [
        dataclasses.replace(sensor, roll_deg=roll)
        for sensor, roll in zip(sensors_at(0.0, 90.0, tilt_deg=-5.0), rolled, strict=True)
    ]
    session = follow(sensors, [walker("stand 4")])
    assert not session.warnings
    assert np.mean(session.error_m) < 0.06
    assert np.mean(session.swapped) < 0.01


# --- half bodies --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_legs_that_a_sensor_guesses_behind_a_desk_are_never_measured_and_said_to_be_unsure() -> None:
    """Who sits behind a desk: the sensor draws the hidden legs as if the person stood."""
    sensors = sensors_at(0.0, height=1.4, tilt_deg=-10.0, forget_s=60.0)
    down = {sensor.name: sensor.T_world_sensor[:3, :3].T @ [0.0, -1.0, 0.0] for sensor in sensors}

    def standing_legs(frame: BodyFrame, at_s: float) -> BodyFrame:
        positions = frame.positions.copy()
        for side in ("Left", "Right"):
            for part, length_m in (("Knee", 0.42), ("Ankle", 0.84), ("Foot", 0.86)):
                j = SKELETON.index(part + side)
                hidden = frame.states[:, j] != JointState.TRACKED
                hip = positions[:, SKELETON.index("Hip" + side)]
                positions[hidden, j] = (hip + length_m * down[frame.sensor])[hidden]
        return msgspec.structs.replace(frame, positions=positions)

    desk = (Box((0.0, 2.0), (3.0, 0.74, 0.5)),)
    sitter = PersonSettings(CENTRE_M, "route", route=("seat 8",))
    session = follow(sensors, [sitter], seed=3, boxes=desk, spoil=standing_legs)
    assert set(session.people[6:]) == {1}
    assert not session.warnings
    assert session.legs[JointState.TRACKED] == 0
    assert np.mean(session.legs_m) > 0.4, "the guesses are wrong"
    assert min(session.legs_sd) >= 0.99 * MOST_GUESS_SD_M
    assert np.mean(session.swapped) < 0.01


def inferred_from(begin_s: float, states: dict[str, JointState]) -> list[Arrival]:
    """Frames of a person who walks before one sensor, whose named joints have other states from a time on."""
    arrivals = walking_arrivals({1: Walker()}, 4.0, {"front": FRONT}, noise=0.01)
    for arrival in arrivals:
        if arrival.at_ns / NS_PER_S >= begin_s:
            for joint, state in states.items():
                arrival.frame.states[:, SKELETON.index(joint)] = state
                if state == JointState.NOT_TRACKED:
                    arrival.frame.positions[:, SKELETON.index(joint)] = np.nan
    return arrivals


def test_the_stated_error_of_a_guess_grows_since_the_joint_was_measured_and_falls_at_once() -> None:
    tracker, (joint, other) = DefaultTracker(), (SKELETON.index("AnkleLeft"), SKELETON.index("AnkleRight"))
    arrivals = inferred_from(2.0, {"AnkleLeft": JointState.INFERRED})
    begin_s = arrivals[0].at_ns / NS_PER_S
    last = 0.0
    for arrival in arrivals:
        scene = tracker.update(arrival)
        if not scene.people:
            continue
        (person,) = scene.people
        assert person.sd is not None
        since_s = arrival.at_ns / NS_PER_S - max(2.0, begin_s)
        if person.states[joint] == JointState.INFERRED:
            assert person.sd[joint] >= min(GUESS_SD_M_S * since_s, MOST_GUESS_SD_M) - 1e-3
            assert person.sd[joint] >= last - 0.02
            last = float(person.sd[joint])
        assert person.sd[other] < 0.1
    assert last > 0.15
    arrival = arrivals[-1]
    arrival.frame.states[:] = JointState.TRACKED
    later = Arrival(msgspec.structs.replace(arrival.frame, sequence=10_000, time_ns=arrival.frame.time_ns + 33_000_000),
                    arrival.at_ns + 33_000_000)  # fmt: skip
    (person,) = tracker.update(later).people
    assert person.sd is not None
    assert person.sd[joint] < 0.1


def test_a_joint_that_no_sensor_has_seen_has_no_position() -> None:
    tracker = DefaultTracker()
    legs = {SKELETON.joints[j]: JointState.NOT_TRACKED for j in LEGS}
    for arrival in inferred_from(0.0, legs):
        for person in tracker.update(arrival).people:
            assert person.sd is not None
            assert (person.states[LEGS] == JointState.NOT_TRACKED).all()
            assert np.isnan(person.positions[LEGS]).all()
            assert np.isnan(person.sd[LEGS]).all()
            assert np.isfinite(person.positions[SKELETON.index("Head")]).all()


# --- left and right -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sensors_that_disagree_about_sides_for_minutes_are_told_of_and_the_known_side_is_kept() -> None:
    def exchanged(frame: BodyFrame, at_s: float) -> BodyFrame:
        if frame.sensor != "sensor1":
            return frame
        return msgspec.structs.replace(frame, positions=frame.positions[:, MIRROR], states=frame.states[:, MIRROR])

    session = follow(sensors_at(0.0, 60.0), [walker("crouch 21", "stand 4")], seed=3, spoil=exchanged)
    said = session.said(UNSURE)
    assert said, "in a crouch, nothing decides"
    assert max(said) < session.at_s[-1] - 3.0, "whoever stands up resolves it"
    assert not any(session.swapped[-25 * 30 :])
    assert not session.warnings


@pytest.mark.parametrize("places", [{"front": FRONT}, {"front": FRONT, "side": SIDE}])
def test_sensors_that_agree_are_not_told_that_they_disagree(places: dict[str, np.ndarray]) -> None:
    tracker = DefaultTracker(sensors_expected=len(places))
    for arrival in walking_arrivals({1: Walker()}, 5.0, places, noise=0.01):
        assert not any(UNSURE in person.condition for person in tracker.update(arrival).people)


@pytest.mark.slow
def test_who_lies_down_before_one_sensor_keeps_left_and_right() -> None:
    for result in score_postures(0.0, 0, ("lie-back", "lie-front", "crawl"), (0.0,)):
        assert (result.wrong, result.missing, result.warned) == (0, 0, 0)
        assert result.fused_m < 0.1


# --- mannequins, wheelchairs, short and tall ----------------------------------------------------------------------


@pytest.mark.slow
def test_a_mannequin_is_one_person_who_stands_and_disturbs_nobody() -> None:
    mannequin = PersonSettings((0.9, 3.2), "stand", lifeless=True)
    session = follow(sensors_at(0.0, 90.0), [mannequin, walker("stand 2")], end_s=16.0)
    assert len(session.ids) == 2
    assert np.mean(np.array(session.people[6:]) == 2) > 0.9, "one of them leaves the image for a moment"
    assert not session.warnings
    assert np.mean(session.error_m) < 0.06


@pytest.mark.slow
def test_who_is_pushed_on_a_wheelchair_and_who_pushes_are_two_people_throughout() -> None:
    rides = PersonSettings((0.3, 3.4), "route", route=("seat 2", "roll 0.3 2.0", "seat 1", "roll 0.3 3.4", "seat 2"))
    pushes = PersonSettings((0.3, 4.1), "route", route=("stand 2", "shift 0.3 2.7", "stand 1", "shift 0.3 4.1"))
    session = follow(sensors_at(0.0, 90.0), [rides, pushes])
    assert len(session.ids) == 2
    assert set(session.people[100:]) == {2}
    assert not session.warnings
    assert np.mean(session.error_m) < 0.06
    assert np.mean(session.swapped) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("stature", [0.9, 2.1])
def test_children_and_very_tall_people_are_tracked_as_others(stature: float) -> None:
    session = follow(sensors_at(0.0, 60.0), [walker("wave 3", stature=stature)])
    assert len(session.ids) == 1
    assert not session.warnings
    assert np.mean(session.error_m) < 0.06
    assert np.mean(session.swapped) < 0.02
