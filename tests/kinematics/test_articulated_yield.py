"""A measurement that lasts is followed beyond every limit of the body model, and no longer than it lasts."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.kinematic_bodies import DOFS, KINECT, MODEL, VARIANCES, lengths

from mocapella.kinematics.articulated_body import LEAST_REPORTED, ArticulatedBody, Pose, conditions_of, joints

Float64 = NDArray[np.float64]
FPS = 30
BEYOND = np.radians(40.0)
LAYOUT = MODEL.layout


def upright(angle_of: dict[int, float], turn_of: dict[str, Rotation]) -> Pose:
    """Somebody with bent elbows and knees, so that turns of the arm and the thigh about themselves are seen."""
    angles = np.zeros(DOFS)
    for joint, angle in (("WristLeft", -1.2), ("AnkleLeft", 1.2), ("HandLeft", 0.3)):
        angles[MODEL.joint_table[KINECT.index(joint), 1]] = angle
    for dof, angle in angle_of.items():
        angles[dof] = angle
    rotations = np.tile(np.eye(3), (LAYOUT.balls, 1, 1))
    for joint, turn in turn_of.items():
        rotations[MODEL.joint_table[KINECT.index(joint), 3]] = turn.as_matrix()
    return Pose(np.array([0.1, 0.9, 2.5]), rotations, angles, lengths(1.75))


def to_cone(joint: str, around: float, beyond: float) -> Rotation:
    """Swing of a bone to a direction ``beyond`` its cone [rad], at an angle ``around`` the cone's axis [rad]."""
    values = MODEL.joint_values[KINECT.index(joint)]
    rest, axis = values[:3], values[4:7]
    side = np.cross(axis, rest)
    side = Rotation.from_rotvec(around * axis).apply(side / np.linalg.norm(side))
    goal = Rotation.from_rotvec((values[7] + beyond) * side).apply(axis)
    turn, _ = Rotation.align_vectors([goal], [rest])
    return turn


def limits() -> Iterator[Any]:
    """A function of an angle beyond each limit [rad] that gives the pose there."""
    for joint, bone in MODEL.body.bones.items():
        name = KINECT.joints[joint]
        if name.endswith("Right") or name in ("ShoulderLeft", "HipLeft"):  # see below
            continue
        for k, hinge in enumerate(bone.hinges):
            dof = int(MODEL.joint_table[joint, 1]) + k
            for side, limit in zip((-1, 1), np.radians(hinge.limits_deg), strict=True):
                yield pytest.param(
                    lambda beyond, dof=dof, side=side, limit=limit: upright({dof: limit + side * beyond}, {}),
                    id=f"{hinge.name} {'least' if side < 0 else 'most'}",
                )
        if bone.ball is not None:
            for quarter in range(4):
                yield pytest.param(
                    lambda beyond, name=name, quarter=quarter: upright(
                        {}, {name: to_cone(name, quarter * np.pi / 2, beyond)}
                    ),
                    id=f"{bone.ball.name} cone {90 * quarter}",
                )
            for side, limit in zip((-1, 1), np.radians(bone.ball.twist_deg), strict=True):
                rest = MODEL.joint_values[joint, :3]
                yield pytest.param(
                    lambda beyond, name=name, rest=rest, side=side, limit=limit: upright(
                        {}, {name: Rotation.from_rotvec((limit + side * beyond) * rest)}
                    ),
                    id=f"{bone.ball.name} twist {'least' if side < 0 else 'most'}",
                )


def follow(body: ArticulatedBody, poses: list[Pose], start_s: float, noise: float = 0.005) -> Float64:
    """Joints (frames, joints, 3) of the body that follows the noisy joints of poses, one a frame [m]."""
    rng = np.random.default_rng(1)
    seen = np.stack([joints(MODEL, pose) for pose in poses])
    seen += rng.normal(0.0, noise, seen.shape)
    return np.stack([body.update(x, VARIANCES, start_s + k / FPS).positions for k, x in enumerate(seen)])


def farthest(found: Float64, pose: Pose) -> float:
    """Largest distance of a joint from where it is, in the mean of the last frames [m]."""
    return float(np.linalg.norm(found[-8:].mean(axis=0) - joints(MODEL, pose), axis=-1).max())


Limit = Callable[[float], Pose]


@pytest.mark.parametrize("limit", list(limits()))
def test_a_pose_beyond_a_limit_is_reached_and_left_again(limit: Limit) -> None:
    body = ArticulatedBody(KINECT)
    follow(body, [limit(-0.2)] * FPS, 0.0)
    moving = [limit(-0.2 + (BEYOND + 0.2) * share) for share in np.linspace(0, 1, FPS)]
    follow(body, moving, 1.0)
    found = follow(body, [limit(BEYOND)] * (2 * FPS), 2.0)
    assert farthest(found, limit(BEYOND)) < 0.04
    follow(body, [limit(BEYOND + (-0.2 - BEYOND) * share) for share in np.linspace(0, 1, FPS)], 4.0)
    found = follow(body, [limit(-0.2)] * (6 * FPS), 5.0)
    assert farthest(found, limit(-0.2)) < 0.02
    assert slack(body).max() < np.radians(3.0)
    assert conditions_of(body.model, body.memory) == [""]


@pytest.mark.parametrize(("joint", "side"), [("AnkleLeft", 0), ("FootLeft", 1)])
def test_the_limits_of_a_joint_that_no_other_can_stand_in_for_widen(joint: str, side: int) -> None:
    dof, beyond = int(MODEL.joint_table[KINECT.index(joint), 1]), np.radians(60.0)
    body = ArticulatedBody(KINECT)
    angle = MODEL.dof_values[dof, side] + (beyond if side else -beyond)
    follow(body, [upright({dof: angle}, {})] * (2 * FPS), 0.0)
    assert slack(body)[KINECT.index(joint)] > 0.5 * beyond
    assert (np.delete(slack(body), KINECT.index(joint)) < 0.2 * beyond).all()
    name = {"AnkleLeft": "left knee", "FootLeft": "left ankle"}[joint]
    (condition,) = conditions_of(body.model, body.memory)
    assert re.fullmatch(rf"{name}: sensors and body model disagree by (50|60)°", condition)


@pytest.mark.parametrize("joint", ["ShoulderLeft", "HipLeft"])
def test_shoulders_and_hips_that_a_sensor_reports_at_one_place_stay_apart(joint: str) -> None:
    """A Kinect that sees somebody from the side does so for seconds."""
    body, other = ArticulatedBody(KINECT), joint.replace("Left", "Right")
    seen = joints(MODEL, upright({}, {}))
    for k in range(FPS):
        body.update(seen, VARIANCES, k / FPS)
    seen[KINECT.index(joint)] = 0.9 * seen[KINECT.index(other)] + 0.1 * seen[KINECT.index(joint)]
    wide = np.linalg.norm(joints(MODEL, upright({}, {}))[[KINECT.index(joint)]] - seen[[KINECT.index(other)]])
    for k in range(3 * FPS):
        found = body.update(seen, VARIANCES, 1.0 + k / FPS).positions
    assert np.linalg.norm(found[KINECT.index(joint)] - found[KINECT.index(other)]) > 0.6 * wide
    assert slack(body)[KINECT.index(joint)] == 0.0


def test_a_measurement_beyond_a_limit_for_an_instant_is_held_back() -> None:
    """A wrist that flickers to the other side of the elbow for a tenth of a second does not bend it backwards."""
    body = ArticulatedBody(KINECT)
    elbow = int(MODEL.joint_table[KINECT.index("WristLeft"), 1])
    still, wrong = upright({elbow: -0.2}, {}), upright({elbow: MODEL.dof_values[elbow, 1] + BEYOND}, {})
    follow(body, [still] * FPS, 0.0)
    for second in range(1, 6):
        follow(body, [wrong] * 3 + [still] * (FPS - 3), second)
        assert slack(body).max() < np.radians(10.0)
        assert body.pose is not None
        assert body.pose.angles[elbow] < MODEL.dof_values[elbow, 1] + np.radians(1.0)


def test_an_elbow_bends_on_the_other_side_after_it_was_straight_without_a_condition() -> None:
    """The upper arm turned about itself; an elbow bent backwards has the same joints."""
    elbow, shoulder = int(MODEL.joint_table[KINECT.index("WristLeft"), 1]), "ElbowLeft"
    body = ArticulatedBody(KINECT)
    turned = Rotation.from_rotvec((2.0, 0.0, 0.0))
    follow(body, [upright({elbow: -1.5}, {})] * FPS, 0.0)
    follow(body, [upright({elbow: 0.0}, {})] * FPS, 1.0)
    found = follow(body, [upright({elbow: -1.5}, {shoulder: turned})] * (3 * FPS), 2.0)
    assert farthest(found, upright({elbow: -1.5}, {shoulder: turned})) < 0.05
    assert conditions_of(body.model, body.memory) == [""]


def test_noise_at_a_limit_does_not_widen_it() -> None:
    body = ArticulatedBody(KINECT)
    knee = int(MODEL.joint_table[KINECT.index("AnkleLeft"), 1])
    follow(body, [upright({knee: MODEL.dof_values[knee, 0]}, {})] * (4 * FPS), 0.0, noise=0.02)
    assert slack(body)[KINECT.index("AnkleLeft")] < np.radians(3.0)


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_bone_of_another_length_is_learnt_within_seconds(factor: float) -> None:
    """As when another person is taken for the one whose bones were learnt."""
    body = ArticulatedBody(KINECT)
    before = upright({}, {})
    after = Pose(before.position, before.rotations, before.angles, before.lengths.copy())
    shank = MODEL.joint_table[KINECT.index("AnkleLeft"), 4]
    after.lengths[shank] *= factor
    follow(body, [before] * (20 * FPS), 0.0)
    follow(body, [after] * (4 * FPS), 20.0)
    assert body.pose is not None
    np.testing.assert_allclose(body.pose.lengths[shank], after.lengths[shank], atol=0.02)


def slack(body: ArticulatedBody) -> Float64:
    """Angle by which the limits of each joint are widened (joints,) [rad]."""
    return np.array(body.memory[0, LAYOUT.slack : LAYOUT.demands])


def test_limits_are_reported_that_widened_by_more_than_the_least_except_at_shoulders_hips_and_elbows() -> None:
    """Each joint at the end of a bone, alone."""
    row = ArticulatedBody(KINECT).memory[0]
    said = {}
    for joint, name in enumerate(KINECT.joints):
        memory = np.tile(row, (3, 1))
        memory[:, LAYOUT.slack : LAYOUT.demands] = 0.0
        memory[0, LAYOUT.slack + joint] = LEAST_REPORTED
        memory[1, LAYOUT.slack + joint] = np.nextafter(LEAST_REPORTED, 1)
        memory[2, LAYOUT.slack + joint] = np.nan
        at, beyond, unknown = conditions_of(MODEL, memory)
        assert (at, unknown) == ("", "")
        said[name] = beyond.partition(":")[0]
    for side in ("Left", "Right"):
        assert said[f"Ankle{side}"] == f"{side.lower()} knee"
        assert said[f"Foot{side}"] == f"{side.lower()} ankle"
        assert said[f"Hand{side}"] == f"{side.lower()} wrist"
        assert [said[f"{bone}{side}"] for bone in ("Elbow", "Knee", "Wrist")] == ["", "", ""]
    assert said["SpineMid"] == said["HipLeft"] == "spine base", "hinges there, though the body as a whole turns freely"
    assert said[KINECT.joints[KINECT.parts["root"]]] == "", "it ends no bone"


@pytest.mark.parametrize(("slack_deg", "said"), [(41, 40), (44.9, 40), (45.1, 50), (54.9, 50), (64, 60)])
def test_a_condition_tells_degrees_in_tens_of_each_joint_of_each_body(slack_deg: float, said: int) -> None:
    memory = np.tile(ArticulatedBody(KINECT).memory[0], (2, 1))
    memory[:, LAYOUT.slack : LAYOUT.demands] = 0.0
    assert conditions_of(MODEL, memory) == ["", ""]
    for joint in ("AnkleLeft", "FootRight"):
        memory[1, LAYOUT.slack + KINECT.index(joint)] = np.radians(slack_deg)
    text = "sensors and body model disagree by"
    assert conditions_of(MODEL, memory) == ["", f"left knee: {text} {said}°, right ankle: {text} {said}°"]
