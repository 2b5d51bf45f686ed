"""Humanoids: rotations reproduce rigid joints, twists are those that were made, and what is unknown is held."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.humanoid_people import MIRROR, joints, mirrored, observable_pose, people, random_pose, world_rotations

from mocapella.errors import SettingsError
from mocapella.geometry.bone_rotations import local_rotations, posed
from mocapella.geometry.swing_twist import quaternions
from mocapella.model.body_meshes import body_mesh
from mocapella.model.humanoid_bones import BONES, FINGERS, HUMANOIDS
from mocapella.model.humanoid_joints import JOINTS, average_joints
from mocapella.model.humanoid_motion import HumanoidMotion, humanoid_motion
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.skeleton import SKELETON
from mocapella.model.topology import topology, topology_names
from mocapella.model.twist_tree import TreePose, part_motions

seeds = st.integers(0, 2**32 - 1)
WITH_SHOULDERS = [name for name in HUMANOIDS if name != "kinect"]
"""Humanoids whose shoulders move, so that every joint can be reached."""
MAPPED = [name for name in topology_names() if name == SKELETON.name or SKELETON.name in topology(name).mappings]


def turned(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def walk(seed: int, **pose: np.ndarray) -> np.ndarray:
    made = random_pose(seed)
    root = np.random.default_rng(seed).normal(size=(6, 3))
    return joints(world_rotations(made | pose, 6), root)


def local(motion: HumanoidMotion) -> dict[str, np.ndarray]:
    R = local_rotations(motion.skeleton.parents, motion.R)
    return {part: R[:, k] for k, part in enumerate(motion.parts)}


@settings(deadline=None, max_examples=10)
@given(seed=seeds, humanoid=st.sampled_from(WITH_SHOULDERS))
def test_forward_kinematics_reproduces_rigid_joints(seed: int, humanoid: str) -> None:
    positions = walk(seed)
    motion = humanoid_motion(people(positions), humanoid)
    placed = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    for k, joint in enumerate(motion.skeleton.keypoints):
        if joint >= 0:
            np.testing.assert_allclose(placed[:, k], positions[:, joint], atol=1e-9)
    assert motion.error_m.max() < 1e-9
    np.testing.assert_allclose(
        motion.R @ np.swapaxes(motion.R, -1, -2), np.broadcast_to(np.eye(3), motion.R.shape), atol=1e-9
    )
    assert not motion.held.any()


@settings(deadline=None, max_examples=10)
@given(seed=seeds, humanoid=st.sampled_from(sorted(HUMANOIDS)))
def test_turning_the_person_turns_the_root_alone(seed: int, humanoid: str) -> None:
    positions, G = walk(seed), turned(seed)
    one, other = (local(humanoid_motion(people(p), humanoid)) for p in (positions, positions @ G.T + [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(other["hips"], G @ one["hips"], atol=1e-9)
    for part in one.keys() - {"hips"}:
        np.testing.assert_allclose(other[part], one[part], atol=1e-7)


@settings(deadline=None, max_examples=10)
@given(seed=seeds, humanoid=st.sampled_from(sorted(HUMANOIDS)))
def test_the_mirror_image_has_mirrored_rotations(seed: int, humanoid: str) -> None:
    positions = joints(world_rotations(observable_pose(seed), 6), np.zeros((6, 3)))
    one, other = (local(humanoid_motion(people(p), humanoid)) for p in (positions, mirrored(positions)))
    for part, R in one.items():
        swapped = {"left": "right", "right": "left"}
        first, _, rest = part.partition(" ")
        image = f"{swapped[first]} {rest}" if first in swapped else part
        np.testing.assert_allclose(other[image], MIRROR @ R @ MIRROR, atol=1e-7, err_msg=part)


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_observed_twists_are_those_that_were_made(seed: int) -> None:
    truth = world_rotations(observable_pose(seed), 6)
    motion = humanoid_motion(people(joints(truth, np.zeros((6, 3)))), "vrm")
    for k, part in enumerate(motion.parts):
        np.testing.assert_allclose(motion.R[:, k], truth[part], atol=1e-6, err_msg=part)
    seen = dict(zip(motion.parts, motion.observed.all(axis=0), strict=True))
    assert all(seen[f"{side} {limb}"] for side in ("left", "right") for limb in ("upper arm", "lower arm", "upper leg"))
    assert not seen["head"]


@pytest.mark.parametrize("humanoid", HUMANOIDS)
def test_a_t_pose_has_identities(humanoid: str) -> None:
    motion = humanoid_motion(people(np.tile(average_joints()[: len(SKELETON)], (3, 1, 1))), humanoid)
    np.testing.assert_allclose(motion.R, np.broadcast_to(np.eye(3), motion.R.shape), atol=1e-12)


def test_a_t_pose_with_hands_has_identities() -> None:
    motion = humanoid_motion(people(np.tile(average_joints(), (3, 1, 1)), JOINTS), "vrm")
    np.testing.assert_allclose(motion.R, np.broadcast_to(np.eye(3), motion.R.shape), atol=1e-9)
    assert set(FINGERS) <= set(motion.parts)


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_fingers_and_the_whole_rotation_of_a_hand_are_observed_with_its_landmarks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = observable_pose(seed)
    for side in ("left", "right"):
        pose[f"{side} hand"] = rng.uniform(-0.3, 0.3, (6, 3))
        for part in FINGERS:
            axis = np.array(BONES[part].rest)
            turn = rng.uniform(-0.7, 0.7, (6, 3))
            pose[part] = turn - (turn @ axis)[:, None] * axis
    truth = world_rotations(pose, 6)
    positions = joints(truth, np.zeros((6, 3)), hands=True)
    positions[:, [JOINTS.index(name) for name in ("HandLeft", "ThumbLeft", "HandTipRight")]] = np.nan
    motion = humanoid_motion(people(positions, JOINTS), "mixamo")
    for part in ("left hand", "right hand", *FINGERS):
        k = motion.parts.index(part)
        np.testing.assert_allclose(motion.R[:, k], truth[part], atol=1e-6, err_msg=part)
        np.testing.assert_allclose(motion.error_m[:, k], 0.0, atol=1e-6)
    assert motion.observed[:, motion.parts.index("left hand")].all()


def test_hands_that_are_not_seen_have_no_fingers() -> None:
    positions = np.concatenate([walk(1), np.full((6, len(JOINTS) - len(SKELETON), 3), np.nan)], axis=1)
    positions[2, JOINTS.index("left hand wrist") :][:21] = walk(1)[2, 0] + np.arange(21)[:, None] * 0.02
    parts = humanoid_motion(people(positions, JOINTS), "vrm").parts
    assert set(FINGERS) & set(parts) == {part for part in FINGERS if part.startswith("left")}


def test_rotations_are_continuous_where_an_elbow_straightens() -> None:
    """The weight of the elbow's plane goes to zero before the plane is undefined."""
    frames = 600
    bend = np.abs(np.linspace(-1.2, 1.2, frames))
    pose = {
        "left upper arm": np.outer(np.linspace(1.0, 1.4, frames), [0.6, 0.2, -0.5]),
        "left lower arm": np.outer(bend, BONES["left upper arm"].rest_side),
    }
    positions = joints(world_rotations(pose, frames), np.zeros((frames, 3)))
    positions[:, [SKELETON.index("ThumbLeft")]] = np.nan
    motion = humanoid_motion(people(positions), "vrm")
    q = quaternions(local_rotations(motion.skeleton.parents, motion.R))
    steps = 2 * np.arccos(np.clip(np.sum(q[1:] * q[:-1], axis=-1), -1.0, 1.0))
    assert steps.max() < 0.05
    at = motion.parts.index("left upper arm")
    assert motion.observed[0, at]
    assert not motion.observed[frames // 2, at]


def test_a_twist_beyond_reach_fades_out() -> None:
    """A thumb that is measured on the wrong side of the hand does not turn the forearm by half a turn, nor flip it."""
    frames = 361
    angle = np.linspace(-np.pi, np.pi, frames)
    pose = {
        "left lower arm": Rotation.from_rotvec(np.tile([0.0, -1.0, 0.0], (frames, 1))) * Rotation.from_rotvec(
            np.outer(angle, BONES["left lower arm"].rest))}  # fmt: skip
    pose = {part: turn.as_rotvec() for part, turn in pose.items()}
    motion = humanoid_motion(people(joints(world_rotations(pose, frames), np.zeros((frames, 3)))), "vrm")
    k = motion.parts.index("left lower arm")
    straight = world_rotations({"left lower arm": np.array([[0.0, -1.0, 0.0]])}, 1)["left lower arm"]
    np.testing.assert_allclose(motion.R[[0, -1], k], np.repeat(straight, 2, axis=0), atol=1e-9)
    assert motion.observed[np.abs(angle) < np.radians(134.5), k].all()
    assert not motion.observed[np.abs(angle) > np.radians(135.5), k].any()
    steps = Rotation.from_matrix(motion.R[1:, k] @ np.swapaxes(motion.R[:-1, k], 1, 2)).magnitude()
    assert steps.max() < np.radians(8.0)


def test_an_exactly_straight_arm_has_no_twist_whatever_was_before() -> None:
    pose = {
        "left upper arm": np.outer([0.6, 0.6, 0.6], [1.0, 0, 0]),
        "left lower arm": np.outer([1, 1, 0], [0, -1.0, 0]),
    }
    motion = humanoid_motion(people(joints(world_rotations(pose, 3), np.zeros((3, 3)))), "vrm")
    k = motion.parts.index("left upper arm")
    np.testing.assert_allclose(motion.R[2, k], np.eye(3), atol=1e-9)
    assert motion.observed[:, k].tolist() == [True, True, False]


def test_a_thumb_along_the_hand_tells_nothing() -> None:
    """A Kinect often has thumb and hand in one line, and noise then is a direction."""
    positions = np.tile(average_joints()[: len(SKELETON)], (2, 1, 1))
    wrist, hand, thumb = (SKELETON.index(f"{joint}Left") for joint in ("Wrist", "Hand", "Thumb"))
    positions[:, hand] = positions[:, wrist] + [0.05, -0.05, 0.0]
    positions[:, thumb] = positions[:, wrist] + [0.04, -0.04, 0.0]
    positions[1, thumb] += [0.004, 0.004, 0.003]
    motion = humanoid_motion(people(positions), "vrm")
    k = motion.parts.index("left lower arm")
    np.testing.assert_allclose(motion.R[:, k], np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)
    assert not motion.observed[:, k].any()


def test_an_unknown_thumb_is_marked_where_the_hand_is_known() -> None:
    positions = walk(3)
    positions[2, SKELETON.index("ThumbLeft")] = np.nan
    motion = humanoid_motion(people(positions), "kinect")
    assert np.argwhere(motion.held).tolist() == [[2, motion.parts.index("left thumb")]]


def test_a_twist_is_held_while_its_hinge_is_unknown() -> None:
    """The hand leaves the image: the upper arm does not spin."""
    pose = {part: np.repeat(turn, 4, axis=0) for part, turn in observable_pose(5, 1).items()}
    positions = joints(world_rotations(pose, 4), np.zeros((4, 3)))
    whole = humanoid_motion(people(positions), "vrm")
    positions[2:, [SKELETON.index(f"{joint}Left") for joint in ("Wrist", "Hand", "HandTip", "Thumb")]] = np.nan
    hidden = humanoid_motion(people(positions), "vrm")
    k = whole.parts.index("left upper arm")
    np.testing.assert_allclose(hidden.R[:, k], whole.R[:, k], atol=1e-9)
    assert hidden.observed[:, k].tolist() == [True, True, False, False]
    assert not hidden.held[:, k].any()


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_quaternions_do_not_change_their_sign(seed: int) -> None:
    R = np.cumsum(np.random.default_rng(seed).normal(size=(50, 3)) * 0.3, axis=0)
    turns = Rotation.from_rotvec(R).as_matrix()[:, None]
    q = quaternions(turns)
    assert (np.sum(q[1:] * q[:-1], axis=-1) > 0).all()
    np.testing.assert_allclose(Rotation.from_quat(q[:, 0]).as_matrix(), turns[:, 0], atol=1e-9)


def test_unknown_joints_keep_their_rotation_and_are_marked() -> None:
    """Also while the person turns: the held arm turns with the body."""
    frames = 8
    pose = observable_pose(3, 1)
    pose = {part: np.repeat(turn, frames, axis=0) for part, turn in pose.items()}
    pose["hips"] = np.outer(np.linspace(0, 3, frames), [0.0, 1.0, 0.0])
    whole = joints(world_rotations(pose, frames), np.zeros((frames, 3)))
    hidden = whole.copy()
    gone = [SKELETON.index(f"{joint}Left") for joint in ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")]
    hidden[2:5, gone] = np.nan
    hidden[6:] = np.nan
    motion = humanoid_motion(people(hidden), "vrm")
    placed = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    at = motion.parts.index("left hand")
    np.testing.assert_allclose(placed[:6, at], whole[:6, SKELETON.index("WristLeft")], atol=1e-9)
    np.testing.assert_allclose(placed[6:], np.broadcast_to(placed[5], placed[6:].shape), atol=1e-12)
    for part in ("left upper arm", "left lower arm", "left hand"):
        assert motion.held[:, motion.parts.index(part)].tolist() == [False, False, True, True, True, False, True, True]
    assert motion.held[6:].all()
    assert not motion.held[:6, motion.parts.index("right hand")].any()


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_an_articulated_body_has_the_rotations_of_its_model(seed: int) -> None:
    """Bodies of silhouettes: with bent elbows and knees, their twists are observed."""
    mesh, rng = body_mesh("female", 1.66, detail=0.8), np.random.default_rng(seed)
    angles = rng.uniform(-0.4, 0.4, (5, len(mesh.joint_names)))
    for k, name in enumerate(mesh.joint_names):
        if name.endswith(("elbow flexion", "knee flexion")):
            angles[:, k] = rng.uniform(0.7, 1.8, 5)
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, :3, :3] = turned(seed)
    pose = TreePose(T, angles)
    motion = humanoid_motion(people(landmarks_at(mesh, pose), tuple(mesh.landmarks), "bodies"), "smpl")
    assert motion.error_m[:, [k for k, p in enumerate(motion.parts) if "fingers" not in p]].max() < 1e-6
    model = part_motions(mesh.tree, pose)[..., :3, :3]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        c = np.sqrt(0.5)
        down = np.array([[c, sign * c, 0.0], [-sign * c, c, 0.0], [0.0, 0.0, 1.0]])  # from the T pose to its rest pose
        for own, part, rest in (("upper arm", "upper arm", down), ("upper leg", "thigh", np.eye(3))):
            wanted = model[:, mesh.part_names.index(f"{side} {part}")] @ rest
            np.testing.assert_allclose(motion.R[:, motion.parts.index(f"{side} {own}")], wanted, atol=1e-6)


@pytest.mark.parametrize("name", MAPPED)
def test_a_topology_either_suffices_or_is_refused_with_the_missing_joint(name: str) -> None:
    kind = topology(name)
    positions = np.random.default_rng(1).normal(size=(4, len(kind), 3))
    if name == "nite":
        with pytest.raises(SettingsError, match="anna: vrm needs WristLeft, which the keypoints do not determine"):
            humanoid_motion(people(positions, kind.joints), "vrm")
    else:
        motion = humanoid_motion(people(positions, kind.joints), "vrm")
        assert np.isfinite(motion.R).all()


def test_a_nose_tells_the_turn_of_the_head() -> None:
    """Its keypoints are those of tracked people, and a nose."""
    pose = {"head": np.outer([0.3, -0.6], [0.0, 1.0, 0.0])}
    R = world_rotations(pose, 2)
    positions = joints(R, np.zeros((2, 3)))
    nose = positions[:, SKELETON.index("Neck")] + R["head"] @ np.array([0.0, 0.08, 0.12])
    own = people(np.concatenate([positions, nose[:, None]], axis=1), (*SKELETON.joints, "nose"))
    motion = humanoid_motion(own, "vrm")
    np.testing.assert_allclose(motion.R[:, motion.parts.index("head")], R["head"], atol=1e-9)
    assert motion.observed[:, motion.parts.index("head")].all()


@pytest.mark.parametrize(
    ("keypoints", "humanoid", "why"),
    [
        (SKELETON.joints, "robot", "--humanoid 'robot': known: vrm, unity, mixamo, kinect, smpl"),
        (("a", "b", "c", "d"), "vrm", "anna is no humanoid: people with the keypoints a, b, c, … have none of the"),
    ],
)
def test_what_is_no_humanoid_is_refused(keypoints: tuple[str, ...], humanoid: str, why: str) -> None:
    with pytest.raises(SettingsError, match=why):
        humanoid_motion(people(np.zeros((2, len(keypoints), 3)), keypoints), humanoid)


def test_hips_that_are_never_known_are_refused() -> None:
    positions = walk(1)
    positions[:, SKELETON.index("HipLeft")] = np.nan
    with pytest.raises(SettingsError, match="anna: hips, SpineBase and SpineMid are never known together"):
        humanoid_motion(people(positions), "vrm")


def test_a_leg_that_is_never_known_is_as_long_as_usual() -> None:
    positions = walk(2) * 1.2
    positions[:, [SKELETON.index(f"{joint}Left") for joint in ("Knee", "Ankle", "Foot")]] = np.nan
    motion = humanoid_motion(people(positions), "vrm")
    lengths = np.linalg.norm(motion.skeleton.offsets, axis=1)
    left, right = (lengths[motion.parts.index(f"{side} lower leg")] for side in ("left", "right"))
    np.testing.assert_allclose(left, right, rtol=1e-6)
    assert motion.held[:, motion.parts.index("left upper leg")].all()
