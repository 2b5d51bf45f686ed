"""Laws of the live check: what it says is what the views and the block say."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import status

from mocapella.geometry.rigid import apply
from mocapella.live.live_check import LEAST_PLACES, OVER_S, LiveChecker, views_apart
from mocapella.model.observations import JointState
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.session import SessionStatus
from mocapella.model.study_status import FloorMap, LiveCheck, MapPoint, StudyStatus
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
BODY = np.random.default_rng(0).normal(0.0, 0.3, (25, 3)) + np.array([0.0, 1.0, 0.0])
BODY[KINECT.parts["root"]] = [0.0, 1.0, 0.0]
BLOCK = FloorMap(
    1.0, 4.0, (MapPoint("middle", 0.0, 0.0), MapPoint("front", 0.2, 1.5)), "middle", ("middle",), ("",)
)  # fmt: skip


def motion(R: list[list[float]], t: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def view(sensor: str, positions: np.ndarray, states: np.ndarray | None = None) -> PotentialSkeleton:
    tracked = np.full(25, JointState.TRACKED, np.uint8)
    return PotentialSkeleton(sensor, 1, 0, 0.0, 1.0, np.eye(4), positions, tracked if states is None else states)


def person(*views: PotentialSkeleton, at: np.ndarray | None = None) -> Person:
    positions = views[0].positions if at is None else at
    return Person(0, positions, np.full(25, JointState.TRACKED, np.uint8), views)


def scene(*people: Person, T: np.ndarray | None = None) -> Scene:
    places = (SensorPlace("front", np.eye(4) if T is None else T),)
    return Scene(0, 0, "front", 1, 0, KINECT, TrackerState(Phase.TRACKING), {"people": people}, places)


def study(block: FloorMap | None = BLOCK, phase: str = "running") -> SessionStatus:
    return status(study=StudyStatus("t", ("P01",), phase=phase, block=block))  # type: ignore[arg-type]


@given(moved=st.tuples(*[st.floats(-1, 1)] * 3))
def test_views_that_are_moved_are_as_far_apart_as_they_were_moved(moved: tuple[float, float, float]) -> None:
    other = view("side", BODY + np.array(moved))
    assert views_apart(person(view("front", BODY), other)) == pytest.approx([math.dist(moved, (0, 0, 0))])


def test_joints_that_a_view_lacks_are_not_counted() -> None:
    states = np.full(25, JointState.TRACKED, np.uint8)
    states[3] = JointState.NOT_TRACKED
    lacks = BODY.copy()
    lacks[3] = 100.0
    assert views_apart(person(view("a", BODY), view("b", lacks, states))) == pytest.approx([0.0])
    nothing = np.full(25, JointState.NOT_TRACKED, np.uint8)
    assert views_apart(person(view("a", BODY), view("b", BODY, nothing))) == []
    assert views_apart(person(view("a", BODY))) == []


def checked(checker: LiveChecker, *scenes: Scene, block: FloorMap | None = BLOCK, start_s: float = 0.0) -> LiveCheck:
    found = None
    for number, one in enumerate(scenes):
        found = checker.update(one, study(block), start_s + number / 30)
    assert found is not None
    return found


def test_the_check_is_of_the_last_second() -> None:
    checker = LiveChecker()
    apart = scene(person(view("front", BODY), view("side", BODY + np.array([0.3, 0.0, 0.0]))))
    assert checked(checker, apart).apart_cm == pytest.approx(30.0)
    assert checked(checker, apart).whole_percent == 100.0
    half = np.full(25, JointState.TRACKED, np.uint8)
    half[0] = JointState.INFERRED
    near = scene(person(view("front", BODY), view("side", BODY, half)))
    found = checked(checker, near, start_s=OVER_S + 0.2)
    assert found.apart_cm == pytest.approx(0.0)
    assert found.whole_percent == 50.0
    alone = checked(checker, scene(person(view("front", BODY))), start_s=3 * OVER_S)
    assert alone.apart_cm is None
    assert checker.update(None, study(), 9 * OVER_S).people == 0  # type: ignore[union-attr]
    assert checker.update(None, status(), 9 * OVER_S) is None


@given(
    turn=st.floats(-math.pi, math.pi),
    x=st.floats(-2.0, 2.0),
    y=st.floats(-4.0, 4.0),
    stood=st.sampled_from(["middle", "front"]),
)
def test_somebody_is_inside_where_the_block_is_however_the_sensor_stands(
    turn: float, x: float, y: float, stood: str
) -> None:
    # The sensor's camera space has x to its left, which is the right of a person who faces it, and z ahead of it.
    T = motion([[math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)]], [3.0, 0.0, -2.0])

    def at(x: float, y: float) -> Person:
        return person(view("front", BODY), at=apply(T, BODY + np.array([x, 0.0, 5.0 - y])))

    point = next(one for one in BLOCK.points if one.name == stood)
    block = msgspec.structs.replace(BLOCK, here=(stood,))
    checker = LiveChecker()
    assert checked(checker, scene(at(point.x, point.y), T=T), block=block).inside is None
    checked(checker, *[scene(at(point.x, point.y), T=T) for _ in range(LEAST_PLACES)], block=block)
    found = checked(checker, scene(at(x, y), T=T), block=block)
    outside = max(abs(x) - 0.5, abs(y) - 2.0)
    if abs(outside - 0.3) > 1e-6:
        assert found.inside == int(outside < 0.3)


def test_the_block_is_not_found_while_somebody_walks_or_two_stand() -> None:
    walking = msgspec.structs.replace(BLOCK, next=("front",))
    for block, people in ((walking, 1), (BLOCK, 2), (msgspec.structs.replace(BLOCK, here=("",)), 1), (None, 1)):
        checker = LiveChecker()
        found = checked(checker, *[scene(*[person(view("front", BODY))] * people)] * 1, block=block)
        for number in range(2 * LEAST_PLACES):
            found = checked(checker, scene(*[person(view("front", BODY))] * people), block=block, start_s=number / 30)
        assert found.inside is None
        assert found.people == people


def test_a_sensor_without_a_pose_leaves_the_block_unknown() -> None:
    checker = LiveChecker()
    unplaced = msgspec.structs.replace(scene(person(view("front", BODY))), sensors=(SensorPlace("front", None),))
    for number in range(2 * LEAST_PLACES):
        found = checked(checker, msgspec.structs.replace(unplaced, step=number))
    assert found.inside is None
