"""BVH: forward kinematics of what is written gives the joints, with the error that is stated."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocapella.errors import SettingsError
from mocapella.exports import bvh_kernels
from mocapella.exports.bvh_file import CM_PER_M, write_bvh
from mocapella.geometry.bone_rotations import local_rotations, posed
from mocapella.model.bvh import read_bvh
from mocapella.model.rest_pose import RigidSkeleton, rigid_motion, skeleton_of
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

KIND = topology("kinect_v2")
FRAMES = 25


def rest_pose() -> RigidSkeleton:
    """A person of a Kinect v2 in a T pose."""
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(2, 1, len(KIND), 3)) * 0.3
    return skeleton_of(trajectories(positions[:, 0]))


def trajectories(positions: np.ndarray, names: tuple[str, ...] = ("anna",)) -> Trajectories:
    positions = positions[:, None]
    states = np.where(np.isfinite(positions).all(axis=3), 2, 0).astype(np.uint8)
    sd = np.full(states.shape, 0.01, np.float32)
    return Trajectories(
        "people", np.arange(len(positions)) / 30.0, np.zeros(len(positions), np.int64), names, KIND.joints, positions,
        states, sd, KIND.bones, rate_hz=30.0,
    )  # fmt: skip


def rigid_walk(seed: int, *, bend: float = 1.0) -> Trajectories:
    """A person of rigid bones, whose joints bend smoothly, each as a ball joint but where several bones meet."""
    rng = np.random.default_rng(seed)
    skeleton = rest_pose()
    joints = len(skeleton.parents)
    speed, phase = rng.normal(size=(joints, 3)) * bend, rng.uniform(0, 6, (joints, 1))
    t = np.arange(FRAMES)[:, None, None] / 30.0
    local = (
        Rotation.from_rotvec((speed * np.sin(4 * t + phase)).reshape(-1, 3)).as_matrix().reshape(FRAMES, joints, 3, 3)
    )
    R = np.empty_like(local)
    for joint, parent in enumerate(skeleton.parents):
        R[:, joint] = local[:, joint] if parent < 0 else R[:, parent] @ local[:, joint]
    root = np.array([0.2, 1.0, 2.0]) + np.cumsum(rng.normal(size=(FRAMES, 3)) * 0.02, axis=0)
    placed = posed(skeleton.parents, skeleton.offsets, root, R)
    positions = np.empty((FRAMES, len(KIND), 3))
    positions[:, list(skeleton.keypoints)] = placed
    return trajectories(positions)


def joints_in(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and world positions (frames, joints, 3) [m] of a BVH, without end sites."""
    bvh = read_bvh(path)
    own = [k for k, joint in enumerate(bvh.joints) if not joint.name.endswith(" end")]
    return [bvh.joints[k].name for k in own], bvh.positions()[:, own] / CM_PER_M


@settings(deadline=None, max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
def test_rigid_people_are_within_a_tenth_of_a_millimetre(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    own, path = rigid_walk(seed), tmp_path_factory.mktemp("bvh") / "walk.bvh"
    notes = write_bvh(own, path)
    names, found = joints_in(path)
    wanted = own.positions[:, 0, [own.keypoints.index(name) for name in names]]
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert notes == ["bones are rigid: joints are 0 mm off in the median, 0 mm at 95 %"]
    assert set(names) == set(KIND.joints)


def test_the_stated_error_is_that_of_the_file(tmp_path: Path) -> None:
    """Measured bones stretch; the file cannot."""
    own = rigid_walk(3)
    noise = np.random.default_rng(0).normal(size=own.positions.shape) * 0.02
    noisy = trajectories((own.positions + noise)[:, 0])
    notes = write_bvh(noisy, tmp_path / "a.bvh")
    names, found = joints_in(tmp_path / "a.bvh")
    far = 1000 * np.linalg.norm(found - noisy.positions[:, 0, [KIND.index(name) for name in names]], axis=2)
    stated = [int(number) for number in re.findall(r"(\d+) mm", notes[0])]
    assert stated == [round(float(np.median(far))), round(float(np.percentile(far, 95)))]
    assert stated[0] > 5


def test_angles_do_not_jump_by_a_turn(tmp_path: Path) -> None:
    own = rigid_walk(5, bend=0.3)
    angle = np.linspace(0.0, 4 * np.pi, FRAMES)
    turn = Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0])).as_matrix()
    spun = trajectories(np.einsum("fij,fkj->fki", turn, own.positions[:, 0]))
    write_bvh(spun, tmp_path / "a.bvh")
    channels = read_bvh(tmp_path / "a.bvh").channels
    assert np.abs(np.diff(channels[:, 5])).max() < 120.0
    assert abs(channels[-1, 5] - channels[0, 5]) > 600.0


def test_unknown_joints_keep_their_place_and_are_counted(tmp_path: Path) -> None:
    own = rigid_walk(7)
    positions = own.positions[:, 0].copy()
    wrist, elbow = KIND.index("WristLeft"), KIND.index("ElbowLeft")
    positions[10:, [wrist, KIND.index("HandLeft"), KIND.index("HandTipLeft"), KIND.index("ThumbLeft")]] = np.nan
    positions[:2] = np.nan
    hidden = trajectories(positions)
    motion = rigid_motion(hidden, skeleton_of(hidden))
    at = [list(skeleton_of(hidden).keypoints).index(k) for k in (elbow, wrist)]
    placed = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    relative = placed[:, at[1]] - placed[:, at[0]]
    np.testing.assert_allclose(relative[10:], np.broadcast_to(relative[9], relative[10:].shape), atol=1e-6)
    np.testing.assert_allclose(placed[0], placed[2], atol=1e-6)
    assert motion.held[:2].all()
    notes = write_bvh(hidden, tmp_path / "a.bvh")
    assert notes[1] == f"{motion.held.mean():.0%} of the joints are unknown and keep their last position"


def test_errors_do_not_depend_on_the_rotations_that_were_asked_for() -> None:
    own = rigid_walk(3)
    noise = np.random.default_rng(3).normal(scale=0.02, size=own.positions[:, 0].shape)
    stretched = trajectories(own.positions[:, 0] + noise)
    skeleton = skeleton_of(stretched)
    whole, partly = (rigid_motion(stretched, skeleton) for _ in range(2))
    partly.rotations(slice(3, 9))
    partly.rotations(slice(5, 7))
    placed = posed(skeleton.parents, skeleton.offsets, whole.root, whole.R)
    wanted = np.linalg.norm(placed - stretched.positions[:, 0, list(skeleton.keypoints)], axis=2)
    assert wanted.max() > 0.01
    for motion in (partly, whole):
        np.testing.assert_allclose(motion.error_m, wanted, atol=1e-6)


def test_the_rest_pose_is_a_t(tmp_path: Path) -> None:
    write_bvh(rigid_walk(1), tmp_path / "a.bvh")
    offsets = {joint.name: np.array(joint.offset) for joint in read_bvh(tmp_path / "a.bvh").joints}
    assert offsets["WristLeft"][0] > 0.9 * np.linalg.norm(offsets["WristLeft"])
    assert offsets["WristRight"][0] < -0.9 * np.linalg.norm(offsets["WristRight"])
    assert offsets["KneeLeft"][1] < -0.9 * np.linalg.norm(offsets["KneeLeft"])


@pytest.mark.parametrize("bones", [(), ((0, 1), (2, 3)), ((0, 1), (2, 1))])
def test_what_has_no_tree_of_bones_is_refused(tmp_path: Path, bones: tuple[tuple[int, int], ...]) -> None:
    own = rigid_walk(1)
    with pytest.raises(SettingsError, match="anna has no skeleton"):
        write_bvh(Trajectories(**{**vars(own), "bones": bones}), tmp_path / "a.bvh")


def test_somebody_who_is_never_known_is_refused(tmp_path: Path) -> None:
    own = trajectories(np.full((3, len(KIND), 3), np.nan))
    with pytest.raises(SettingsError, match="anna: SpineBase is never known"):
        write_bvh(own, tmp_path / "a.bvh")


numbers = st.floats(-1e6, 1e6) | st.floats(-1e-6, 1e-6) | st.sampled_from([0.0, -0.0, 0.9999999, -9.9999996, 8.9e9])


@settings(deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=5), st.integers(1, 6))
def test_decimals_are_those_of_python(rows: list[tuple[float, float, float]], digits: int) -> None:
    text = np.empty(20 * 3 * len(rows), np.uint8)
    size = bvh_kernels.write_decimals(np.array(rows), digits, text)
    found = [line.split(" ") for line in text[:size].tobytes().decode().splitlines()]
    for row, texts in zip(rows, found, strict=True):
        for value, one in zip(row, texts, strict=True):
            assert re.fullmatch(rf"-?\d+\.\d{{{digits}}}", one)
            assert float(one) == pytest.approx(value, abs=0.5 * 10.0**-digits + 4e-16 * abs(value))
            assert not one.startswith("-") or float(one) < 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -9e9, 1e300])
def test_numbers_without_a_decimal_of_full_precision_are_refused(value: float) -> None:
    assert bvh_kernels.write_decimals(np.array([[1.0, value]]), 6, np.empty(40, np.uint8)) == -1


def test_a_place_too_far_for_the_format_is_refused(tmp_path: Path) -> None:
    own = rigid_walk(1)
    with pytest.raises(SettingsError, match="too large for a BVH"):
        write_bvh(trajectories(own.positions[:, 0] + 1e8), tmp_path / "a.bvh")


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_turns_give_the_local_rotations_and_do_not_jump(seed: int, at_a_right_angle: bool) -> None:
    parents, order = np.array([-1, 0, 1, 0]), np.array([0, 3, 1, 2])
    rng = np.random.default_rng(seed)
    R = Rotation.random(20, random_state=rng).as_matrix().reshape(5, 4, 3, 3)
    if at_a_right_angle:
        R[:, 3] = R[:, 0] @ Rotation.from_euler("ZXY", [30, 90, 20], degrees=True).as_matrix()
    last, angles = np.full((4, 3), 400.0), np.empty((5, 12))
    bvh_kernels.turns(parents, order, R, last, angles)
    found = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_matrix().reshape(5, 4, 3, 3)
    np.testing.assert_allclose(found, local_rotations(parents, R)[:, order], atol=1e-6)
    steps = np.diff(np.concatenate([np.full((1, 12), 400.0), angles]), axis=0)
    assert np.abs(steps).max() <= 180.0 + 1e-9
    np.testing.assert_array_equal(last.ravel(), angles[-1])
