"""Scenes become trajectories: nothing is lost or moved, and time rises whatever the order of arrival."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist
from mocapella.model.observations import JointState
from mocapella.model.scene import (
    Person,
    Phase,
    PotentialSkeleton,
    Scene,
    SensorPlace,
    TrackedArm,
    TrackedBody,
    TrackedHand,
    TrackedObject,
    TrackedPoints,
    TrackerState,
)  # fmt: skip
from mocapella.model.topology import topology
from mocapella.model.trajectories import PARTS, VIEWS, Trajectories, trajectories_of

KIND = topology("kinect_v2")
JOINTS = len(KIND)
TRACKING = TrackerState(Phase.TRACKING)
BEGIN = 1_700_000_000 * 10**9


def person(number: int, seed: int, name: str = "", views: tuple[PotentialSkeleton, ...] = ()) -> Person:
    rng = np.random.default_rng([number, seed])
    states = rng.integers(0, 3, JOINTS).astype(np.uint8)
    positions = np.where(states[:, None] > 0, rng.normal(size=(JOINTS, 3)), np.nan)
    return Person(number, positions, states, views, rng.uniform(0.001, 0.1, JOINTS).astype(np.float32), name)


def scene(step: int, at_ns: int, sensor: str = "front", **parts: tuple[Any, ...]) -> Scene:
    return Scene(step, at_ns, sensor, 1, step, KIND, TRACKING, parts)


people_over_time = st.lists(
    st.tuples(st.integers(0, 10**10), st.sets(st.integers(0, 3)), st.sampled_from(["front", "side"])), min_size=1,
    max_size=20,
)  # fmt: skip


@settings(deadline=None)
@given(people_over_time)
def test_each_person_is_at_its_time_and_nowhere_else(rows: list[tuple[int, set[int], str]]) -> None:
    scenes = [
        (0, BEGIN + at, scene(k, at, sensor, people=tuple(person(i, k) for i in sorted(who))))
        for k, (at, who, sensor) in enumerate(rows)
    ]
    newest = {at: (k, who) for k, (at, who, _) in enumerate(rows)}  # the last of equal times counts
    found = trajectories_of(scenes).get("people")
    if not any(who for _, who, _ in rows):
        assert found is None
        return
    assert found is not None
    times = sorted(newest)
    np.testing.assert_allclose(found.times_s, (np.array(times) - times[0]) / 1e9, atol=1e-12)
    assert found.began_unix_ns == BEGIN + times[0]
    assert set(found.individuals) == {f"person_{i}" for _, who, _ in rows for i in who}
    every = [at for at, _, _ in rows]
    alone = {at: sensor for at, _, sensor in rows if every.count(at) == 1}
    numbers = {(alone[at], number) for at, number in zip(times, found.sensors.tolist(), strict=True) if at in alone}
    assert len(numbers) == len({name for name, _ in numbers}) == len({number for _, number in numbers})
    np.testing.assert_array_equal(found.at(slice(1, None)).sensors, found.sensors[1:])
    for frame, at in enumerate(times):
        k, who = newest[at]
        for place, name in enumerate(found.individuals):
            number = int(name.removeprefix("person_"))
            own = person(number, k)
            here = number in who
            wanted = own.positions if here else np.full((JOINTS, 3), np.nan)
            np.testing.assert_array_equal(found.positions[frame, place], np.float32(wanted))
            np.testing.assert_array_equal(found.states[frame, place], own.states if here else 0)
            np.testing.assert_array_equal(found.sd[frame, place], own.sd if here else np.float32(np.nan))


def test_a_name_joins_runs_and_an_id_does_not() -> None:
    scenes = [
        (0, BEGIN, scene(0, 0, people=(person(1, 0), person(2, 1, "anna")))),
        (3, BEGIN + 10**9, scene(0, 0, people=(person(1, 2), person(5, 3, "anna")))),
    ]
    found = trajectories_of(scenes)["people"]
    assert set(found.individuals) == {"person_1", "anna", "run3_person_1"}
    assert found.runs.tolist() == [0, 3]
    assert found.of(["anna"]).present.all()


def everything() -> Scene:
    rng = np.random.default_rng(0)
    T = exp_twist(rng.normal(size=6))
    two, three, eight = np.full(21, 2, np.uint8), np.full(23, 1, np.uint8), np.full(8, 0.01, np.float32)
    hand = TrackedHand(4, True, rng.normal(size=(21, 3)), two, np.full(21, 0.01, np.float32), rng.normal(size=21), T)
    arm = TrackedArm(
        7, False, rng.normal(size=(23, 3)), three, np.full(23, 0.01, np.float32), rng.normal(size=21), None, "", 0.0,
        False,
    )  # fmt: skip
    body = TrackedBody(
        1, "anna", "", T, rng.normal(size=3), ("a", "b", "c"), ("head", "foot"), rng.normal(size=(2, 3)),
        np.array([2, 1], np.uint8), False,
    )  # fmt: skip
    cup, gone = TrackedObject("cup", T, np.empty((0, 3)), 2), TrackedObject("lid", None, np.empty((0, 3)), 0)
    places = rng.normal(size=(8, 3))
    places[3] = np.nan
    points = TrackedPoints(tuple("abcdefgh"), places, eight, np.full(8, 2, np.uint8))
    return scene(0, 5, hands=(hand,), arms=(arm,), bodies=(body,), objects=(cup, gone), points=(points,),
                 people=(person(0, 0),))  # fmt: skip


def test_all_kinds_of_parts_are_there_with_their_angles_and_poses() -> None:
    whole = everything()
    found = trajectories_of([(0, BEGIN, whole)])
    assert set(found) == set(PARTS)
    assert found["hands"].individuals == ("hand_4_left",)
    assert found["arms"].individuals == ("arm_7_right",)
    np.testing.assert_array_equal(found["hands"].angles[0, 0], whole.hands[0].angles)
    np.testing.assert_array_equal(found["hands"].poses[0, 0], whole.hands[0].T_world_palm)  # type: ignore[index]
    assert np.isnan(found["arms"].poses).all()  # type: ignore[arg-type]
    assert found["bodies"].individuals == ("anna",)
    assert found["bodies"].angle_names == ("a", "b", "c")
    assert found["objects"].individuals == ("cup", "lid")
    origin = whole.objects[0].T_world_object[:3, 3]
    np.testing.assert_array_equal(found["objects"].positions[0, 0, 0], np.float32(origin))
    assert np.isnan(found["objects"].positions[0, 1]).all()
    assert found["points"].states[0, 0].tolist() == [2, 2, 2, 0, 2, 2, 2, 2]
    for some in found.values():
        assert all(0 <= k < len(some.keypoints) for bone in some.bones for k in bone)


def test_parts_whose_keypoints_change_keep_their_names() -> None:
    """Markers come and go; each has one column."""
    rows = [("a", "b"), ("b", "c"), ("c",)]
    scenes = []
    for k, names in enumerate(rows):
        places = np.arange(3.0 * len(names)).reshape(-1, 3) + 100 * k
        one = TrackedPoints(names, places, np.full(len(names), 0.1, np.float32), np.full(len(names), 2, np.uint8))
        scenes.append((0, BEGIN + k, scene(k, k, points=(one,))))
    found = trajectories_of(scenes)["points"]
    assert set(found.keypoints) == {"a", "b", "c"}
    b = found.keypoints.index("b")
    np.testing.assert_array_equal(found.positions[:, 0, b], [[3, 4, 5], [100, 101, 102], [np.nan] * 3])


def view(sensor: str, T_world_sensor: np.ndarray, seed: int) -> PotentialSkeleton:
    points = np.random.default_rng(seed).normal(size=(JOINTS, 3))
    return PotentialSkeleton(sensor, 9, 0, 0.0, 1.0, T_world_sensor, points, np.full(JOINTS, 2, np.uint8))


def test_views_are_of_the_frame_they_are_from() -> None:
    """A scene repeats the newest views of other sensors; those would be samples of wrong times."""
    views = (view("front", np.eye(4), 0), view("side", np.eye(4), 1))
    scenes = [
        (0, BEGIN + k, scene(k, k, s, people=(person(0, k, views=views),))) for k, s in enumerate(("front", "side"))
    ]
    found = trajectories_of(scenes, (VIEWS,))[VIEWS]
    assert found.individuals == ("person_0@front", "person_0@side")
    np.testing.assert_array_equal(found.present, [[True, False], [False, True]])


def test_synchronous_sensors_keep_their_views() -> None:
    """Scenes of equal times are one frame; each has its own sensor's view."""
    views = (view("front", np.eye(4), 0), view("side", np.eye(4), 1))
    scenes = [
        (0, BEGIN + k, scene(2 * k + j, k, sensor, people=(person(0, k, views=views),)))
        for k in range(4)
        for j, sensor in enumerate(("front", "side"))
    ]
    found = trajectories_of(scenes, ("people", VIEWS))
    assert len(found[VIEWS]) == len(found["people"]) == 4
    assert found[VIEWS].present.all()


def test_a_run_has_one_number_in_all_kinds() -> None:
    views = (view("front", np.eye(4), 0),)
    scenes = [
        (0, BEGIN, scene(0, 0, people=(person(1, 0),))),
        (2, BEGIN + 9, scene(0, 9, people=(person(1, 1, views=views),))),
    ]
    found = trajectories_of(scenes, ("people", VIEWS))
    assert found["people"].individuals == ("person_1", "run2_person_1")
    assert found[VIEWS].individuals == ("run2_person_1@front",)


def test_two_people_of_one_name_stay_two() -> None:
    scenes = [(0, BEGIN + k, scene(k, k, people=(person(1, k, "anna"), person(2, k, "anna")))) for k in range(3)]
    found = trajectories_of(scenes)["people"]
    assert found.individuals == ("anna", "anna (2)")
    np.testing.assert_array_equal(found.positions[1, 1], np.float32(person(2, 1).positions))


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_in_a_sensors_space_the_sensor_is_at_the_origin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = [exp_twist(rng.normal(size=6)), exp_twist(rng.normal(size=6))]
    scenes = [
        (0, BEGIN + k, msgspec.structs.replace(scene(k, k, people=(person(0, k),)), sensors=places))
        for k, places in enumerate(((SensorPlace("front", T[0]),), (), (SensorPlace("front", T[1]),)))
    ]
    found = trajectories_of(scenes, sensor="front")["people"]
    for frame, pose in ((0, T[0]), (2, T[1])):
        np.testing.assert_allclose(
            found.positions[frame, 0], apply(inverse(pose), person(0, frame).positions), atol=1e-6
        )
    assert not found.present[1].any()
    assert (found.states[1] == JointState.NOT_TRACKED).all()
    with pytest.raises(SettingsError, match="no pose of a sensor 'side'; sensors: front"):
        trajectories_of(scenes, sensor="side")


def test_the_rate_is_the_fastest_sensors_and_not_the_results() -> None:
    scenes = [
        (0, BEGIN + round(k * 1e9 / 60), scene(k, k, ("a", "b")[k % 2], people=(person(0, k),))) for k in range(40)
    ]
    assert trajectories_of(scenes)["people"].rate_hz == pytest.approx(30.0, rel=1e-6)
    assert np.isnan(trajectories_of(scenes[:1])["people"].rate_hz)
    assert trajectories_of([]) == {}


def test_an_unknown_individual_is_refused_with_the_known_ones() -> None:
    found = trajectories_of([(0, BEGIN, scene(0, 0, people=(person(1, 0), person(2, 0))))])["people"]
    with pytest.raises(SettingsError, match=r"no 'person_3' among people; known: person_1, person_2"):
        found.of(["person_3"])


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_moving_there_and_back_changes_nothing(seed: int) -> None:
    found = trajectories_of([(0, BEGIN, everything())])
    T = exp_twist(np.random.default_rng(seed).normal(size=6))
    for single in found.values():
        some = replace(single, positions=single.positions.astype(np.float64))
        back = some.moved(T).moved(inverse(T))
        np.testing.assert_allclose(back.positions, some.positions, atol=1e-9)
        np.testing.assert_array_equal(back.states, np.where(np.isfinite(some.positions).all(axis=3), some.states, 0))
        if some.poses is not None:
            np.testing.assert_allclose(back.poses, some.poses, atol=1e-9)


def test_frames_can_be_chosen() -> None:
    scenes = [(0, BEGIN + k, scene(k, k, people=(person(0, k),))) for k in range(5)]
    found = trajectories_of(scenes)["people"]
    some: Trajectories = found.at(slice(1, 4))
    assert len(some) == 3
    np.testing.assert_array_equal(some.positions, found.positions[1:4])
    assert replace(some, kind="x").individuals == ("person_0",)
    assert found.at(slice(None, None, 2)).rate_hz == pytest.approx(found.rate_hz / 2)
    assert found.of("person_0").individuals == found.of(["person_0", "person_0"]).individuals == ("person_0",)
