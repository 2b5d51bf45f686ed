"""Steps between a frame and a person: who is no longer seen, who is turned, whose labels change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.walking_people import KINECT_V2

from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, rigid, rotation_about_y, rotation_about_z
from mocapella.model.anatomy import MOST_STRAY
from mocapella.tracker import people_kernels as kernels
from mocapella.tracker.people import MISPLACED, UNSURE, People, PeopleSettings
from mocapella.tracker.people_memory import (
    REPORTED_STRAY,
    STRAY_S,
    UNSURE_S,
    UNSURE_SD,
    FacingResults,
    PeopleMemory,
    PeopleParameters,
    PointArrays,
    ViewArrays,
)
from mocapella.tracker.people_step_kernels import note_unsure
from mocapella.tracker.people_view_kernels import WALKS_COS, doubt_limbs, to_level, turn_views, upright

DT = 1 / 30
LINES = np.array([[1, 2], [3, 4]])
"""Left and right of the shoulders, and of the hips, of a body of five joints; the first is the root."""
PARAMETERS = PeopleParameters(8.0, 1.0, 1.0, 5.0, 1.0, 0.12, 0.2, 0.02, 0.1, 0.05, 0.1, 0.6, 0.2)
UP = np.array([0.0, 1.0, 0.0])
angles = st.floats(-3.0, 3.0)


def moved(seconds: float, speed_memory_s: float) -> float:
    """How far a joint goes that was last seen at 1 m/s [m]."""
    at_s, positions, velocities = np.zeros(1), np.zeros((1, 1, 3)), np.array([[[1.0, 0.0, 0.0]]])
    variances, seen_s = np.full((1, 1, 3), 1e-4), np.zeros((1, 1))
    for k in range(1, round(seconds / DT) + 1):
        points = PointArrays(at_s, positions, velocities, variances, seen_s)
        kernels.bring(k * DT, points, PARAMETERS._replace(forget_after_s=10.0, speed_memory_s=speed_memory_s))
    return float(positions[0, 0, 0])


def test_who_is_no_longer_seen_comes_to_rest() -> None:
    assert moved(0.1, 0.2) == pytest.approx(0.1)  # a view is used for so long
    assert 0.25 < moved(3.0, 0.2) < 0.12 + 2 * DT + 0.2
    assert moved(3.0, 1e9) == pytest.approx(3.0)


def body(shoulders: float, hips: float) -> np.ndarray:
    """(5, 3) whose lines face so [rad]."""
    across = [np.array([np.cos(yaw), 0.0, -np.sin(yaw)]) for yaw in (shoulders, hips)]
    sides = [side * width * line for line, width in zip(across, (0.2, 0.1), strict=True) for side in (1, -1)]
    return np.vstack([np.zeros(3), *sides])


class View:
    """One view of one person, and what is kept of it."""

    def __init__(self) -> None:
        self.yaw, self.mirrored = np.zeros(1), np.zeros((1, 1), dtype=np.bool_)
        self.toward, self.reported, self.turn = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 2))
        self.offsets = np.zeros((1, 1, 5, 3))

    def face(  # noqa: PLR0917 - the results have as many parts
        self, joints: np.ndarray, yaw: float, sd: float = 0.3, mirrored: bool = False, speed: float = 0.0,
        unlike: float = 0.0,
    ) -> None:  # fmt: skip
        reported = np.arctan2(-(joints[1] - joints[2])[2], (joints[1] - joints[2])[0]) + np.pi * mirrored
        facing = FacingResults(
            joints[None], np.array([yaw]), np.array([sd]), np.array([mirrored]), np.array([reported]),
            np.array([unlike]), np.zeros(1), np.array([[speed, 0.0, 0.0]]),
        )  # fmt: skip
        turn_views(np.arange(1), 0, np.full(1, DT), PARAMETERS, LINES, facing, self.yaw, view_arrays(**vars(self)))


def view_arrays(**arrays: np.ndarray) -> ViewArrays:
    """Views of which only these arrays are used."""
    unused = dict.fromkeys(ViewArrays._fields, np.zeros((1, 1)))
    return ViewArrays(**{name: arrays.get(name, value) for name, value in unused.items()})


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(angles, angles, angles, st.booleans())
def test_shoulders_and_hips_both_come_to_face_as_the_person_does(
    shoulders: float, hips: float, yaw: float, mirrored: bool
) -> None:
    view, joints = View(), body(shoulders, hips)
    for _ in range(60):
        view.face(joints, yaw, mirrored=mirrored)
    turned = joints[[0, 2, 1, 4, 3]] if mirrored else joints.copy()
    kernels.turn(turned, np.array([-1, 0, 0, 1, 1]), 0, UP, view.turn[0, 0])
    for left, right in LINES:
        across = turned[left] - turned[right]
        assert abs(wrap(np.arctan2(-across[2], across[0]) - yaw)) < 1e-3


def test_a_facing_that_is_not_sure_turns_nobody_and_changes_no_labels() -> None:
    view = View()
    view.face(body(0.5, 0.2), 1.5, sd=1.2, mirrored=True)
    assert not view.turn.any()
    assert not view.mirrored.any()


def test_a_view_unlike_the_training_data_is_not_turned() -> None:
    view, half, like = View(), View(), View()
    view.face(body(0.5, 0.2), 1.0, unlike=1.0)
    assert not view.turn.any()
    half.face(body(0.5, 0.2), 1.0, unlike=0.5)
    like.face(body(0.5, 0.2), 1.0)
    np.testing.assert_allclose(2 * half.turn, like.turn)


@given(st.floats(0.0, np.pi), angles)
def test_the_more_a_trunk_leans_the_less_the_yaw_of_its_shoulders_counts(lean: float, yaw: float) -> None:
    trunk = 0.5 * np.array([np.sin(lean) * np.sin(yaw), np.cos(lean), np.sin(lean) * np.cos(yaw)])
    joints = body(yaw, yaw)
    joints[1:3] += trunk
    share = upright(joints, LINES)
    wanted = np.clip((np.cos(lean) - 0.5) / (WALKS_COS - 0.5), 0.0, 1.0)
    assert share == pytest.approx(wanted, abs=1e-9)
    joints[1] = np.nan
    assert upright(joints, LINES) == 1.0


def test_the_shoulders_of_who_bows_are_not_turned() -> None:
    """A trunk that is not known counts as upright."""
    bows, stands = View(), View()
    joints = body(0.5, 0.2)
    stands.face(joints, 1.0)
    joints[1:3] += [0.0, 0.1, 0.5]
    bows.face(joints, 1.0)
    assert stands.turn.any()
    assert not bows.turn.any()


@pytest.mark.parametrize(("speed", "glides"), [(0.0, True), (0.09, True), (0.5, False)])
def test_where_labels_change_the_view_goes_on_where_the_person_stands(speed: float, glides: bool) -> None:
    view = View()
    view.face(body(0.0, 0.0), np.pi, mirrored=True, speed=speed)
    assert view.mirrored.all()
    assert np.isnan(view.offsets).all() == glides
    expected, seen = np.ones((5, 3)), np.full((5, 3), 1.2)
    seen[2] = np.nan
    apart, offsets = np.empty((2, 3, 5, 1))
    variances, there = np.ones((5, 1)), np.empty((5, 1))
    kernels.place_view(seen, expected, view.offsets, 0, 0, 0, apart, offsets, variances, there)
    known = np.array([0, 1, 3, 4])
    np.testing.assert_allclose(offsets[:, known], 0.2 if glides else 0.0)
    np.testing.assert_array_equal(offsets[:, 2], 0.0)
    np.testing.assert_array_equal(there[:, 0], [1, 1, 0, 1, 1])


@given(st.booleans(), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5))
def test_a_sensor_whose_place_becomes_better_known_moves_its_views_and_nobody_jumps(
    mirrored: bool, yaw: float, x: float
) -> None:
    people = People(PeopleSettings(), KINECT_V2)
    people.sensors, people.numbers = ["front", "side"], [7]
    people.memory = people.memory.resized([], 1, 2)
    m, rng = people.memory, np.random.default_rng(0)
    m.view_positions[:] = rng.normal(size=m.view_positions.shape)
    m.view_positions[0, 1, 3] = np.nan
    m.view_mirrored[0, 1] = mirrored
    labels = people.mirror if mirrored else slice(None)
    T = rigid(rotation_about_y(yaw), (x, 0.0, 0.1))
    before = m.view_positions[0].copy()
    people.move_sensors(["nobody's", "side"], np.array([np.diag([2.0, 2.0, 2.0, 1.0]), T]))
    np.testing.assert_allclose(m.view_positions[0, 1], apply(T, before[1]))
    np.testing.assert_allclose((m.view_positions[0, 1][labels] - m.view_offsets[0, 1]), before[1][labels], atol=1e-12)
    np.testing.assert_array_equal(m.view_positions[0, 0], before[0])
    assert (m.view_offsets[0, 0] == 0).all()


@given(st.floats(0.121, 100.0))
def test_a_person_whose_views_are_all_too_old_is_measured_nowhere(age_s: float) -> None:
    """A frame that comes so late that it is not used must not correct anybody by what the memory held before."""
    people = People(PeopleSettings(), KINECT_V2)
    people.sensors, people.numbers = ["front", "side"], [7]
    people.memory = people.memory.resized([], 1, 2)
    m = people.memory
    m.view_at[:], m.view_positions[:] = 0.0, 1.0
    measured, variances = kernels.make(
        np.zeros(1, np.int64), 2, age_s, people._parameters, people.settings.fusion.parameters, people._layout,
        people.R_level[1], m.points, m.views, m.skeletons,
    )  # fmt: skip
    assert np.isnan(measured).all()
    assert np.isposinf(variances).all()


@given(
    ages=st.lists(st.floats(0.0, 0.3), min_size=2, max_size=2),
    rigidity=st.lists(st.tuples(st.floats(0.1, 2.0), st.floats(0.0, 0.1)), min_size=2, max_size=2),
)
def test_a_person_is_as_rigid_as_the_least_rigid_view_in_use(
    ages: list[float], rigidity: list[tuple[float, float]]
) -> None:
    people = People(PeopleSettings(), KINECT_V2)
    people.sensors, people.numbers = ["front", "side"], [7]
    people.memory = people.memory.resized([], 1, 2)
    m = people.memory
    m.view_at[0], m.view_rigidity[0] = 1.0 - np.array(ages), rigidity
    used = [one for one, age in zip(rigidity, ages, strict=True) if 1.0 - (1.0 - age) <= 0.12]
    found = kernels.rigidity_of(np.zeros(1, np.int64), 1.0, 0.12, m.views)
    np.testing.assert_array_equal(found, [np.max(used, axis=0) if used else np.zeros(2)])


def test_the_memory_of_an_older_version_is_taken() -> None:
    memory = People(PeopleSettings(), KINECT_V2).memory.resized([], 2, 3)
    newer = {"view_rigidity", "view_strays", "unsure_s", "measured_s"}
    older = PeopleMemory(**{name: value for name, value in vars(memory).items() if name not in newer})
    older.check(2, 3, len(KINECT_V2), memory.body.shape[1])
    np.testing.assert_array_equal(older.view_rigidity[..., 0], np.ones((2, 3)))  # 0 would make measurements exact
    np.testing.assert_array_equal(older.view_rigidity[..., 1], np.zeros((2, 3)))
    np.testing.assert_array_equal(older.view_strays, np.zeros((2, 3, len(KINECT_V2))))
    assert np.isposinf(older.unsure_s).all()
    assert older.unsure_s.shape == (2,)
    assert np.isneginf(older.measured_s).all()


@pytest.mark.parametrize("R_level", [np.eye(2), np.eye(3, dtype=np.float32), np.zeros(9)])
def test_a_memory_with_another_upward_direction_than_a_rotation_is_refused(R_level: np.ndarray) -> None:
    people = People(PeopleSettings(), KINECT_V2)
    *others, level = people.state()
    people.restore((*others, level.T))
    np.testing.assert_array_equal(people.R_level, level.T)
    with pytest.raises(ValueError, match="R_level is"):
        people.restore((*others, R_level))


@given(st.floats(0.0, 180.0), st.floats(-180.0, 180.0))
def test_only_who_is_upright_walks(lean_deg: float, yaw_deg: float) -> None:
    """A body that leans has no horizontal velocity, its other results do not depend on it."""
    assume(abs(np.cos(np.radians(lean_deg)) - WALKS_COS) > 1e-6)
    root, head = KINECT_V2.parts["root"], KINECT_V2.parts["head"]
    body = np.zeros((1, len(KINECT_V2), 3))
    lean, yaw = np.radians(lean_deg), np.radians(yaw_deg)
    body[0, head] = 0.6 * np.array([np.sin(lean) * np.sin(yaw), np.cos(lean), np.sin(lean) * np.cos(yaw)])
    velocities = np.broadcast_to([0.7, -0.2, 0.4], body.shape).copy()
    level, toward, speeds = to_level(
        np.eye(3), body, np.array([0.0, 0.0, 2.0]), root, head, np.zeros(1, np.int64), velocities
    )
    walks = np.cos(lean) > WALKS_COS
    np.testing.assert_array_equal(speeds[0], [0.7, -0.2, 0.4] if walks else [0.0, -0.2, 0.0])
    np.testing.assert_array_equal(level, body)
    assert toward[0] == 0.0
    body[0, head] = np.nan
    assert to_level(np.eye(3), body, np.zeros(3), root, head, np.zeros(1, np.int64), velocities)[2][0, 0] == 0.7


def unsure_people(mirrored: tuple[bool, bool], ages: tuple[float, float] = (0.0, 0.0)) -> People:
    """One person whom two sensors see, with exchanged labels or not, at 10 s."""
    people = People(PeopleSettings(), KINECT_V2)
    people.sensors, people.numbers = ["front", "side"], [7]
    people.memory = people.memory.resized([], 1, 2)
    people.memory.view_mirrored[0], people.memory.view_at[0] = mirrored, 10.0 - np.array(ages)
    return people


def judge(people: People, sd: float, at_s: float) -> None:
    """Note whether the sensors disagree, with a facing of this standard deviation [rad]."""
    m = people.memory
    note_unsure(np.zeros(1, np.int64), np.array([sd]), at_s, people.settings.view_age_s, m.views, m.unsure_s)


def conditions(people: People) -> list[str]:
    return people.conditions(people.results(np.eye(4), float(people.memory.fused_s[0])))


def says(people: People, sd: float) -> bool:
    """Whether the person has the condition after the sensors have disagreed for longer than it takes."""
    for at_s in (10.0, 10.0 + 1.1 * UNSURE_S):
        ages = 10.0 - people.memory.view_at if at_s == 10.0 else people.memory.view_at * 0
        people.memory.view_at[:] = at_s - ages
        judge(people, sd, at_s)
        people.memory.fused_s[:] = at_s
    return conditions(people) == [UNSURE]


@pytest.mark.parametrize(
    ("mirrored", "sd", "said"),
    [
        ((True, False), 1.01 * UNSURE_SD, True),
        ((False, True), 1.01 * UNSURE_SD, True),
        ((True, False), 0.99 * UNSURE_SD, False),  # the facing decides
        ((True, True), 9.0, False),  # they agree
        ((False, False), 9.0, False),
    ],
)
def test_a_person_says_that_sensors_disagree_about_sides_only_while_nothing_decides(
    mirrored: tuple[bool, bool], sd: float, said: bool
) -> None:
    people = unsure_people(mirrored)
    assert conditions(people) == [""]
    assert says(people, sd) is said
    judge(people, 0.3, 20.0)
    assert conditions(people) == [""], "it clears at once"


def test_an_old_view_disagrees_with_nobody() -> None:
    people = unsure_people((True, False), (0.0, 1.0))
    judge(people, 9.0, 10.0)
    assert np.isposinf(people.memory.unsure_s).all()


@pytest.mark.parametrize(("angle_deg", "forgets"), [(0.0, False), (20.0, False), (180.0, True)])
def test_facings_that_were_seen_upside_down_are_forgotten(angle_deg: float, forgets: bool) -> None:
    people = People(PeopleSettings(), KINECT_V2)
    assert people._facing is not None
    people._facing.update("front", [7], np.zeros((1, len(KINECT_V2), 3)), np.zeros(1), 1.0, np.zeros((1, 3)))
    people.level(rotation_about_z(np.radians(angle_deg)))
    assert (7 not in people._facing.memory.people) is forgets
    unaided = People(PeopleSettings(facing=None), KINECT_V2)
    unaided.level(rotation_about_z(np.pi))
    np.testing.assert_allclose(unaided.R_level[1], [0.0, -1.0, 0.0], atol=1e-12)


LIMBS, SHARES = np.array([[0, 1, 2]]), np.array([0.5])
"""Hip, knee and ankle of a body of three joints, whose thigh is as long as the shin."""


def doubted(seen: np.ndarray, seconds: float, before: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Strays (3,) and added variances (3,) [m²] of a view that looked so for that long."""
    strays, added = np.array([0.0, before, 0.0]), np.zeros(3)
    for dt in [np.inf, *[DT] * round(seconds / DT)]:
        added[:] = 0.0
        doubt_limbs(seen, dt, LIMBS, SHARES, strays, added)
    return strays, added


def leg(share: float, bend: float = 0.0, length: float = 0.9) -> np.ndarray:
    """Hip, knee and ankle (3, 3) of a leg with this share of the thigh, bent by an angle [rad] [m]."""
    knee = np.array([0.0, -share * length, 0.0])
    return np.array([np.zeros(3), knee, knee - (1 - share) * length * np.array([0.0, np.cos(bend), np.sin(bend)])])


@given(st.floats(0.2, 0.8), st.floats(0.0, 2.5))
def test_a_knee_that_is_long_at_a_wrong_place_along_the_leg_counts_less_and_hip_and_ankle_do_not(
    share: float, bend: float
) -> None:
    strays, added = doubted(leg(share, bend), 6 * STRAY_S)
    assert strays[1] == pytest.approx(share - 0.5, abs=2e-3)
    beyond = max(0.0, abs(strays[1]) - MOST_STRAY) * 0.9
    np.testing.assert_allclose(added, [0.0, beyond**2, 0.0], atol=1e-12)


@given(st.floats(0.2, 0.8))
def test_a_knee_that_is_misplaced_for_a_second_counts_as_before(share: float) -> None:
    assert not doubted(leg(share), 0.2 * STRAY_S)[1].any()


@pytest.mark.parametrize("broken", [np.nan, 0.0])
def test_a_leg_that_is_not_seen_keeps_its_stray_and_its_weight(broken: float) -> None:
    seen = leg(0.2)
    seen[:2] = broken
    if broken == 0.0:
        seen[:] = 0.0  # no leg has this length
    strays, added = doubted(seen, STRAY_S, before=0.3)
    assert strays[1] == 0.3
    assert not added.any()


def test_limbs_are_arms_and_legs_and_there_are_none_without_a_body_model() -> None:
    names = KINECT_V2.joints
    people = People(PeopleSettings(), KINECT_V2)
    assert sorted(names[j] for j in people._layout.limbs[:, 1]) == ["ElbowLeft", "ElbowRight", "KneeLeft", "KneeRight"]
    assert {names[j].removesuffix("Left") for j in people._layout.limbs[0]} == {"Shoulder", "Elbow", "Wrist"}
    assert ((people._layout.shares > 0.45) & (people._layout.shares < 0.6)).all()
    assert not len(People(PeopleSettings(smoothing="kalman"), KINECT_V2)._layout.limbs)


@pytest.mark.parametrize(("mirrored", "side"), [(False, "left"), (True, "right")])
def test_a_person_names_the_sensor_and_the_joint_that_it_sees_at_a_wrong_place(mirrored: bool, side: str) -> None:
    people = unsure_people((False, mirrored))
    people.memory.fused_s[:] = 10.0
    knee = KINECT_V2.index("KneeLeft")
    people.memory.view_strays[0, 1, knee] = -0.99 * REPORTED_STRAY
    assert conditions(people) == [""]
    people.memory.view_strays[0, 1, knee] = -1.01 * REPORTED_STRAY
    assert conditions(people) == [f"side: {side} knee {MISPLACED}"]
    people.memory.view_at[0, 1] = 9.0
    assert conditions(people) == [""], "a view that is not in use has no condition"
