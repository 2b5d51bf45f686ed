"""A person made of joint angles by forward kinematics, written apart from the code that measures angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mocapella.geometry.rigid import rotation_about_x, rotation_about_y, rotation_about_z
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

LENGTHS = {
    "hip": 0.09, "lumbar": 0.22, "chest": 0.3, "shoulder_up": 0.27, "shoulder": 0.18, "thigh": 0.42, "shank": 0.41,
    "foot": 0.16, "arm": 0.29, "forearm": 0.25, "hand": 0.08,
}  # fmt: skip
KINECT = {
    "pelvis": "SpineBase", "lumbar": "SpineMid", "chest": "SpineShoulder",
    **{f"{point}_{side}": joint + end for side, end in (("r", "Right"), ("l", "Left")) for point, joint in (
        ("hip", "Hip"), ("knee", "Knee"), ("ankle", "Ankle"), ("toe", "Foot"), ("shoulder", "Shoulder"),
        ("elbow", "Elbow"), ("wrist", "Wrist"))},
}  # fmt: skip
HALPE = {
    "pelvis": "Hip", "chest": "Neck",
    **{f"{point}_{side}": end + joint for side, end in (("r", "R"), ("l", "L")) for point, joint in (
        ("hip", "Hip"), ("knee", "Knee"), ("ankle", "Ankle"), ("toe", "BigToe"), ("heel", "Heel"),
        ("shoulder", "Shoulder"), ("elbow", "Elbow"), ("wrist", "Wrist"))},
}  # fmt: skip
MEDIAPIPE = {
    f"{point}_{side}": f"{end}_{joint}" for side, end in (("r", "RIGHT"), ("l", "LEFT")) for point, joint in (
        ("hip", "HIP"), ("knee", "KNEE"), ("ankle", "ANKLE"), ("toe", "FOOT_INDEX"), ("heel", "HEEL"),
        ("shoulder", "SHOULDER"), ("elbow", "ELBOW"), ("wrist", "WRIST"), ("index", "INDEX"), ("little", "PINKY"))
}  # fmt: skip


def points_of(
    angles: Mapping[str, np.ndarray], frames: int, lengths: Mapping[str, float] = LENGTHS, foot_drop: float = 0.0
) -> dict[str, np.ndarray]:
    """Return anatomical points (frames, 3), of angles (frames,) [rad]; missing ones are 0.

    ``foot_drop`` is the height of the ankle above the line from heel to toe.
    """

    def at(name: str) -> np.ndarray:
        return np.broadcast_to(np.asarray(angles.get(name, 0.0), dtype=np.float64), (frames,))

    def zxy(z: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return rotation_about_z(z) @ rotation_about_x(x) @ rotation_about_y(y)

    own = lengths
    pelvis = zxy(at("pelvis_tilt"), at("pelvis_list"), at("pelvis_rotation"))
    origin = np.stack([at("pelvis_tx"), at("pelvis_ty"), at("pelvis_tz")], axis=-1)
    chest = pelvis @ zxy(at("lumbar_extension"), at("lumbar_bending"), at("lumbar_rotation"))
    p = {"pelvis": origin + pelvis @ [0.0, 0.02, 0.0], "lumbar": origin + pelvis @ [0.0, own["lumbar"], 0.0]}
    p["chest"] = p["lumbar"] + chest @ [0.0, own["chest"], 0.0]
    for side, s in (("r", 1.0), ("l", -1.0)):
        p[f"hip_{side}"] = origin + pelvis @ [0.0, 0.0, s * own["hip"]]
        thigh = pelvis @ zxy(at(f"hip_flexion_{side}"), s * at(f"hip_adduction_{side}"), s * at(f"hip_rotation_{side}"))
        p[f"knee_{side}"] = p[f"hip_{side}"] + thigh @ [0.0, -own["thigh"], 0.0]
        shank = thigh @ rotation_about_z(-at(f"knee_angle_{side}"))
        p[f"ankle_{side}"] = p[f"knee_{side}"] + shank @ [0.0, -own["shank"], 0.0]
        foot = shank @ rotation_about_z(at(f"ankle_angle_{side}"))
        p[f"toe_{side}"] = p[f"ankle_{side}"] + foot @ [own["foot"], -foot_drop, 0.0]
        p[f"heel_{side}"] = p[f"ankle_{side}"] + foot @ [-0.06, -foot_drop, 0.0]
        p[f"shoulder_{side}"] = p["lumbar"] + chest @ [0.0, own["shoulder_up"], s * own["shoulder"]]
        arm = chest @ zxy(at(f"arm_flex_{side}"), s * at(f"arm_add_{side}"), s * at(f"arm_rot_{side}"))
        p[f"elbow_{side}"] = p[f"shoulder_{side}"] + arm @ [0.0, -own["arm"], 0.0]
        forearm = (
            arm @ rotation_about_z(at(f"elbow_flex_{side}")) @ rotation_about_y(s * at(f"forearm_pronation_{side}"))
        )
        p[f"wrist_{side}"] = p[f"elbow_{side}"] + forearm @ [0.0, -own["forearm"], 0.0]
        hand = (
            forearm
            @ rotation_about_z(at(f"wrist_flexion_{side}"))
            @ rotation_about_x(-s * at(f"wrist_deviation_{side}"))
        )
        p[f"index_{side}"] = p[f"wrist_{side}"] + hand @ [0.0, -own["hand"], s * 0.035]
        p[f"little_{side}"] = p[f"wrist_{side}"] + hand @ [0.0, -own["hand"], -s * 0.035]
    return p


def person(
    points: Mapping[str, np.ndarray], kind: str = "kinect_v2", names: Mapping[str, str] = KINECT, *, sd: float = 0.004
) -> Trajectories:
    """Return trajectories at 30 Hz with the joints of a topology; those that are no anatomical point are unknown."""
    joints = topology(kind).joints
    frames = len(next(iter(points.values())))
    positions = np.full((frames, 1, len(joints), 3), np.nan)
    for point, joint in names.items():
        positions[:, 0, joints.index(joint)] = points[point]
    known = np.isfinite(positions).all(axis=3)
    return Trajectories(
        "people", np.arange(frames) / 30.0, np.zeros(frames, np.int64), ("anna",), joints, positions,
        np.where(known, 2, 0).astype(np.uint8), np.where(known, sd, np.nan).astype(np.float32), topology(kind).bones,
        rate_hz=30.0,
    )  # fmt: skip
