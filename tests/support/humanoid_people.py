"""People of rigid bones with known rotations, for tests of humanoids."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from mocapella.model.humanoid_bones import BONES, FINGERS
from mocapella.model.humanoid_joints import INDEX, JOINTS, average_joints
from mocapella.model.skeleton import SKELETON
from mocapella.model.trajectories import Trajectories

MIRROR = np.diag([-1.0, 1.0, 1.0])


def people(positions: np.ndarray, keypoints: tuple[str, ...] = SKELETON.joints, kind: str = "people") -> Trajectories:
    """One person, anna, at positions (frames, keypoints, 3); NaN is unknown."""
    positions = positions[:, None]
    states = np.where(np.isfinite(positions).all(axis=3), 2, 0).astype(np.uint8)
    bones = SKELETON.bones if keypoints == SKELETON.joints else ()
    return Trajectories(
        kind, np.arange(len(positions)) / 30.0, np.zeros(len(positions), np.int64), ("anna",), keypoints, positions,
        states, np.full(states.shape, 0.01, np.float32), bones, rate_hz=30.0,
    )  # fmt: skip


def world_rotations(local: Mapping[str, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    """Rotations (frames, 3, 3) of all bones from local rotation vectors (frames, 3) by part; others follow."""
    R: dict[str, np.ndarray] = {}
    for part, bone in BONES.items():
        own = Rotation.from_rotvec(local.get(part, np.zeros((frames, 3)))).as_matrix()
        R[part] = R[bone.parent] @ own if bone.parent else own
    return R


def joints(R: Mapping[str, np.ndarray], root: np.ndarray, *, hands: bool = False) -> np.ndarray:
    """Joints (frames, 25 or 67, 3) of an average man whose bones have rotations, by forward kinematics."""
    rest = average_joints()
    out = np.full((len(root), len(JOINTS), 3), np.nan)
    out[:, INDEX["SpineBase"]] = root
    for part, bone in BONES.items():
        steps = [(BONES[bone.parent].joint, bone.joint, bone.parent)] if bone.parent else []
        for start, end, mover in [*steps, *([(bone.joint, bone.end, part)] if bone.end else [])]:
            a, b = INDEX[start], INDEX[end]
            if np.isnan(out[:, b]).any():
                out[:, b] = out[:, a] + R[mover] @ (rest[b] - rest[a])
    for side in ("Left", "Right"):
        out[:, INDEX[f"{side.lower()} hand wrist"]] = out[:, INDEX[f"Wrist{side}"]]
    return out if hands else out[:, : len(SKELETON)]


def random_pose(seed: int, frames: int = 6, most: float = 0.8) -> dict[str, np.ndarray]:
    """Random rotation vectors (frames, 3) of all bones that point somewhere."""
    rng = np.random.default_rng(seed)
    parts = [part for part, bone in BONES.items() if bone.end and not bone.share and part not in FINGERS] + ["hips"]
    return {part: rng.uniform(-most, most, (frames, 3)) for part in parts}


def observable_pose(seed: int, frames: int = 6) -> dict[str, np.ndarray]:
    """Rotation vectors of a person whose twists are all observed.

    Elbows and knees bend, wrists and ankles only flex, the lower spine bends sidewards, shoulders are lifted alike.
    """
    rng = np.random.default_rng(seed)
    sideways, lift = np.array([0.0, 0.0, 1.0]), rng.uniform(-0.4, 0.4, (frames, 3)) * [0.0, 1.0, 1.0]
    pose = {part: rng.uniform(-0.4, 0.4, (frames, 3)) * [1.0, 0.0, 1.0] for part in ("neck", "head")}
    pose |= {"hips": rng.uniform(-1.5, 1.5, (frames, 3)), "chest": rng.uniform(-0.4, 0.4, (frames, 3))}
    pose |= {"spine": np.outer(rng.uniform(-0.4, 0.4, frames), sideways)}
    pose |= {"left shoulder": lift, "right shoulder": -lift}
    for side in ("left", "right"):
        for limb, below, twist, end in (
            ("upper arm", "lower arm", 1.4, "hand"),
            ("upper leg", "lower leg", 0.7, "foot"),
        ):
            upper, lower = BONES[f"{side} {limb}"], BONES[f"{side} {below}"]
            pose[upper.part] = rng.uniform(-0.7, 0.7, (frames, 3))
            bend = Rotation.from_rotvec(np.outer(rng.uniform(0.6, 2.2, frames), upper.rest_side))
            turn = Rotation.from_rotvec(np.outer(rng.uniform(-twist, twist, frames), lower.rest))
            pose[lower.part] = (bend * turn).as_rotvec()
            flex = np.array([0.0, 0.0, 1.0]) if end == "hand" else np.array([1.0, 0.0, 0.0])
            pose[f"{side} {end}"] = np.outer(rng.uniform(-0.5, 0.5, frames), flex)
    return pose


def mirrored(positions: np.ndarray) -> np.ndarray:
    """The mirror image of joints (frames, 25, 3) in x, with left and right exchanged."""
    return positions[:, list(SKELETON.mirror)] @ MIRROR
