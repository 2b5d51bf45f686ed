"""What a sensor sees of a person: the same geometry and the same errors as the simulated room's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.sources.simulate.body import BODY, JOINT, body_template
from mocapella.sources.simulate.measured import measured_errors
from mocapella.sources.simulate.occlusion import Box, Cylinder, hidden, obstacles
from mocapella.studies.planner.person_views import (
    LEVELS,
    ON_AXIS,
    SCORED,
    SCORED_JOINTS,
    TURNS,
    PersonTables,
    body_points,
    standing_body,
    turned,
)
from mocapella.studies.planner.sight import blocked

AT = st.floats(-3, 3)
BOXES = st.builds(Box, st.tuples(AT, AT), st.tuples(*[st.floats(0.1, 2.0)] * 3), st.floats(-180, 180))
PILLARS = st.builds(Cylinder, st.tuples(AT, AT), st.floats(0.05, 1.0), st.floats(0.1, 2.5))


@settings(max_examples=50)
@given(st.lists(BOXES, max_size=2), st.lists(PILLARS, max_size=2), st.tuples(AT, st.floats(0.1, 2.5), AT),
       st.integers(0, 2**32 - 1))  # fmt: skip
def test_lines_of_sight_are_those_of_the_simulated_room(
    boxes: list[Box], pillars: list[Cylinder], eye: tuple[float, float, float], seed: int
) -> None:
    things = obstacles(tuple(boxes), tuple(pillars))
    rng = np.random.default_rng(seed)
    targets = rng.uniform((-3, 0.01, -3), (3, 2.4, 3), (len(BODY), 3))
    without_limbs = np.zeros((1, len(BODY)))
    expected = hidden(np.array(eye), targets[None], without_limbs, things)[0]
    assert (blocked(np.array(eye), targets, things) == expected).all()


@pytest.fixture(scope="module")
def person() -> PersonTables:
    return PersonTables(("stand", "arms-out"), 1.75)


def test_a_standing_body_faces_along_z_above_the_origin() -> None:
    body = standing_body("stand", 1.8)
    left, right = body[JOINT["ShoulderLeft"]], body[JOINT["ShoulderRight"]]
    assert left[0] > 0.2 > -0.2 > right[0]
    assert body[JOINT["FootLeft"], 2] > 0.1
    assert np.abs(body[JOINT["SpineBase"], [0, 2]]).max() < 0.05
    assert body[JOINT["Head"], 1] == pytest.approx(0.936 * 1.8, abs=0.03)


@given(st.floats(-7, 7))
def test_a_turn_keeps_lengths_and_heights(yaw: float) -> None:
    body = standing_body("stand", 1.7)
    now = turned(body, np.float64(yaw))
    assert now[:, 1] == pytest.approx(body[:, 1])
    assert np.linalg.norm(now - now[0], axis=1) == pytest.approx(np.linalg.norm(body - body[0], axis=1))


def test_errors_are_the_mean_squares_of_simulated_views(person: PersonTables) -> None:
    errors, rng = measured_errors(), np.random.default_rng(3)
    body, count = standing_body("stand", 1.75), 20_000
    for k in (0, TURNS // 6, TURNS // 2):
        world = np.repeat(turned(body, np.float64(2 * np.pi * k / TURNS))[None], count, axis=0)
        white = rng.standard_normal((count, len(BODY), 3)) * np.sqrt(1 + errors.white**2)[:, None]
        noise = (white, rng.standard_normal(count), rng.random(count))
        seen = np.ones(world.shape[:2], dtype=bool)
        away = errors.put_on(world, np.array([0.0, 1.0, 1e6]), seen, noise)[0] - world
        simulated = np.sqrt((away[:, SCORED_JOINTS] ** 2).mean(axis=0))
        expected = np.sqrt(np.diagonal(person.moments[0, k, :, 0], axis1=-2, axis2=-1))
        assert expected == pytest.approx(simulated, rel=0.05, abs=2e-3)


def test_a_hidden_joint_has_the_larger_error(person: PersonTables) -> None:
    trace = np.trace(person.moments, axis1=-2, axis2=-1)
    assert trace[..., 1].mean() > 1.5 * trace[..., 0].mean()
    assert (np.linalg.eigvalsh(person.moments) > 0).all()


def test_the_own_body_hides_what_is_behind_it(person: PersonTables) -> None:
    level = 6  # elevation 0
    left, right = SCORED.index("WristLeft"), SCORED.index("WristRight")
    quarter = TURNS // 4
    # Facing 90° to the left of the line of sight: the right side is towards the sensor, if it is towards −α.
    sides = person.hides[0, level, [quarter, -quarter]][:, [left, right]]
    assert sides.any(axis=1).all()
    assert (sides[0] == sides[1][::-1]).all()
    assert not person.hides[1, level, 0][[left, right]].any()


def test_hidden_joints_are_those_of_the_simulated_room(person: PersonTables) -> None:
    body = standing_body("stand", 1.75)
    radii = (body_template().radii * 1.75)[None]
    middle, k = body[JOINT["SpineMid"]], 20
    there = turned(body - middle, np.float64(2 * np.pi * k / TURNS)) + middle
    eye = middle + np.array([0.0, 0.0, 3.0])
    found = hidden(eye, there[None], radii, obstacles((), ()))[0, SCORED_JOINTS]
    assert (person.hides[0, 6, k] == found).all()


def test_each_joint_has_the_test_point_next_to_it(person: PersonTables) -> None:
    points = body_points(1.75)
    body = standing_body("stand", 1.75)
    for k in (0, 11, 50):
        joints = turned(body, np.float64(2 * np.pi * k / TURNS))[SCORED_JOINTS][:, [0, 1]]
        near = np.linalg.norm(points[person.point[0, k]] - joints, axis=1)
        assert near.max() < 0.3
    assert (points[ON_AXIS, 0] == 0).all()
    assert points[ON_AXIS, 1] == pytest.approx(LEVELS * 1.75)
