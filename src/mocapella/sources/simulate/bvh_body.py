"""Retarget a BVH file to a body of 26 degrees of freedom, in closed form from the directions of its bones.

Only the positions of the file's joints are used, so the rest pose of its skeleton does not matter. A shoulder's and a
hip's first two angles follow from the direction of the bone below, the third and the next joint's flexion from the
direction of the bone after that, and a foot's flexion from the position of its toes. Motions without a degree of
freedom are lost: the trunk's twist, and wrists, neck and collar bones. Angles are clamped to the joint limits and
smoothed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.geometry.rigid import rotation_about_x
from mocapella.model.bvh import Bvh
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.settings import check
from mocapella.sources.simulate.body_motion import GRID_HZ, BodyMotion, smoothed, splined
from mocapella.sources.simulate.retarget import joint_columns

Float64 = NDArray[np.float64]

_DOWN = float(np.sqrt(0.5))
"""Arms in the rest pose are 45° below the horizontal."""
_STRAIGHT = 0.12
"""Sine of a flexion below which a bone hardly determines the axial rotation of the bone above it."""


def body_motion_of(
    bvh: Bvh, mesh: RiggedMesh, seconds: float | None = None, *, start_s: float = 0.0, file: object = None
) -> BodyMotion:
    """Retarget a file's motion to a body: feet on the floor, and the path scaled by the length of the legs.

    Args:
        bvh: content of the file.
        mesh: the body, made by `body_meshes.body_mesh`.
        seconds: duration [s]; None for all until the file's end.
        start_s: time in the file at which the motion starts [s].
        file: named in errors; None leaves it out.

    Raises:
        InputError: joints are missing, or the legs have no length.
        SettingsError: ``start_s`` or ``seconds`` is outside the file's duration.
    """
    lasts = (len(bvh.channels) - 1) * bvh.frame_s
    check(0 <= start_s < lasts, "start_s", start_s, f"from 0 to {lasts:.2f} s, the file's end")
    seconds = lasts - start_s if seconds is None else seconds
    check(0 < seconds <= lasts - start_s + 1e-9, "seconds", seconds, f"above 0, to {lasts - start_s:.2f} s")
    angles, turns, path = body_angles(bvh, mesh, file)
    at = start_s + np.arange(int(seconds * GRID_HZ) + 1) / GRID_HZ
    frames = np.arange(len(angles)) * bvh.frame_s

    def on_grid(values: Float64) -> Float64:
        return smoothed(np.stack([np.interp(at, frames, column) for column in values.T], axis=1))

    return splined(mesh, on_grid(angles), on_grid(turns), np.zeros(len(at)), path=on_grid(path))


def body_angles(bvh: Bvh, mesh: RiggedMesh, file: object = None) -> tuple[Float64, Float64, Float64]:
    """Compute the body's poses in the file's frames, before smoothing and ground contact.

    Args:
        bvh: content of the file.
        mesh: the body, made by `body_meshes.body_mesh`.
        file: named in errors; None leaves it out.

    Returns:
        Joint angles (frames, joints) in the order of ``mesh.joint_names``, within the joint limits [rad]; yaw, pitch
        and roll of the whole body (frames, 3), without leaps of 2π [rad]; and x and z of the hips' path on the floor
        (frames, 2), scaled by the ratio of the mesh's legs to the file's [m].

    Raises:
        InputError: joints are missing, or the legs have no length.
    """
    columns = joint_columns(bvh, file)
    at = bvh.positions()
    joints = {name: at[:, column] for name, column in columns.items()}
    hips = 0.5 * (joints["HipLeft"] + joints["HipRight"])
    shoulders = 0.5 * (joints["ShoulderLeft"] + joints["ShoulderRight"])
    middle = joints.get("SpineMid", 0.5 * (hips + shoulders))
    pelvis = _frame(joints["HipLeft"] - joints["HipRight"], middle - hips)
    up = _unit(_into(pelvis, shoulders - middle))
    left = np.arcsin(np.clip(up[:, 0], -1, 1))
    forwards = np.arctan2(up[:, 2], up[:, 1])
    about_z = np.zeros((len(left), 3, 3))
    about_z[:, 0, 0] = about_z[:, 1, 1] = np.cos(left)
    about_z[:, 0, 1], about_z[:, 1, 0], about_z[:, 2, 2] = np.sin(left), -np.sin(left), 1.0
    found = {"waist bend forwards": forwards, "waist bend to the left": left}
    limits = dict(zip(mesh.joint_names, mesh.tree.limits, strict=True))
    for name in ("waist bend forwards", "waist bend to the left"):
        found[name] = np.clip(found[name], *limits[name])
    torso = pelvis @ rotation_about_x(forwards) @ about_z
    legs = 0.0
    for side, capital in (("left", "Left"), ("right", "Right")):
        mirror = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
        bones = {
            bone: joints[f"{end}{capital}"] - joints[f"{begin}{capital}"]
            for bone, begin, end in (
                ("upper arm", "Shoulder", "Elbow"), ("forearm", "Elbow", "Wrist"), ("thigh", "Hip", "Knee"),
                ("shank", "Knee", "Ankle"),
            )
        }  # fmt: skip
        legs += float(np.median(np.linalg.norm(bones["thigh"], axis=1) + np.linalg.norm(bones["shank"], axis=1)))
        upper, fore = (_unit(_into(torso, bones[bone])) * mirror for bone in ("upper arm", "forearm"))
        arm = _arm(upper, fore)
        toes = None
        if f"Foot{capital}" in joints:
            toes = _into(pelvis, joints[f"Foot{capital}"] - joints[f"Ankle{capital}"]) * mirror
        thigh, shank = (_unit(_into(pelvis, bones[bone])) * mirror for bone in ("thigh", "shank"))
        leg = _leg(thigh, shank, toes)
        if toes is None:
            leg["ankle flexion"] = np.zeros(len(at))
        else:
            rest = mesh.landmarks[f"{side} toe"].point - mesh.landmarks[f"{side} ankle"].point
            # Files differ in the position of the toes: their median slope, on the floor, is that of the rest pose.
            slope = leg["ankle flexion"] - np.arctan2(rest[1], rest[2])
            leg["ankle flexion"] = slope - np.median(slope)
        found |= {f"{side} {name}": values for name, values in (arm | leg).items()}
    if not legs > 0:
        raise InputError("the legs have no length", file=file, field="OFFSET", fix="export the file with its skeleton")
    own = sum(
        float(np.linalg.norm(mesh.landmarks[f"{side} {a}"].point - mesh.landmarks[f"{side} {b}"].point))
        for side in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    )
    angles = np.stack([_kept(found[name], limits[name]) for name in mesh.joint_names], axis=1)
    path = (own / legs) * hips[:, [0, 2]]
    return angles, np.unwrap(_yaw_pitch_roll(pelvis), axis=0), path


def _arm(upper: Float64, fore: Float64) -> dict[str, Float64]:
    """Angles of a left arm from its bones' directions (n, 3) in the trunk's frame.

    With u down the arm in the rest pose, n the axis of its swing and z forwards, a right-handed basis (z, n, u), the
    direction of an arm swung by s and raised by r is cos r cos s u + cos r sin s z − sin r n.
    """
    u, n, z = np.array([_DOWN, -_DOWN, 0.0]), np.array([-_DOWN, -_DOWN, 0.0]), np.array([0.0, 0.0, 1.0])
    raised = np.arcsin(np.clip(-upper @ n, -1, 1))
    swing = np.arctan2(upper @ z, upper @ u)
    swing = np.where(swing < -0.6 * np.pi, swing + 2 * np.pi, swing)  # arms rise in front rather than behind
    # The forearm's direction relative to the upper arm's rest pose.
    along = np.stack([fore @ u, fore @ n, fore @ z], axis=1)
    a = np.cos(swing) * along[:, 0] + np.sin(swing) * along[:, 2]
    c = -np.sin(swing) * along[:, 0] + np.cos(swing) * along[:, 2]
    along_u = np.cos(raised) * a - np.sin(raised) * along[:, 1]
    along_n = np.sin(raised) * a + np.cos(raised) * along[:, 1]
    flexed = np.arccos(np.clip(along_u, -1, 1))
    turned = _trusted(np.arctan2(-along_n, c), np.sin(flexed))
    return {
        "shoulder swing forwards": swing,
        "shoulder raise sidewards": raised,
        "shoulder turn outwards": turned,
        "elbow flexion": flexed,
    }


def _leg(thigh: Float64, shank: Float64, toes: Float64 | None) -> dict[str, Float64]:
    """Angles of a left leg from its bones' directions (n, 3) in the pelvis' frame; the ankle's is the toes' slope."""
    open_, flexed = np.arcsin(np.clip(thigh[:, 0], -1, 1)), np.arctan2(thigh[:, 2], -thigh[:, 1])

    def at_rest(v: Float64) -> Float64:
        """Direction relative to a thigh that points straight down."""
        y = np.cos(flexed) * v[:, 1] - np.sin(flexed) * v[:, 2]
        z = np.sin(flexed) * v[:, 1] + np.cos(flexed) * v[:, 2]
        return np.stack(
            [np.cos(open_) * v[:, 0] + np.sin(open_) * y, np.cos(open_) * y - np.sin(open_) * v[:, 0], z], 1
        )

    f = at_rest(shank)
    knee = np.arccos(np.clip(-f[:, 1], -1, 1))
    turn = _trusted(np.arctan2(-f[:, 0], -f[:, 2]), np.sin(knee))
    slope = np.zeros(len(f))
    if toes is not None:
        g = at_rest(toes)
        z = np.sin(turn) * g[:, 0] + np.cos(turn) * g[:, 2]
        y, z = np.cos(knee) * g[:, 1] + np.sin(knee) * z, np.cos(knee) * z - np.sin(knee) * g[:, 1]
        slope = np.arctan2(y, z)
    return {
        "hip flexion": flexed,
        "hip abduction": open_,
        "hip turn outwards": turn,
        "knee flexion": knee,
        "ankle flexion": slope,
    }


def _trusted(angle: Float64, sine: Float64) -> Float64:
    """Attenuate an axial rotation (n,) of a bone where the limb is nearly straight, since it is then undetermined."""
    return np.asarray(angle * np.clip(sine / _STRAIGHT, 0.0, 1.0) ** 2 * (np.abs(angle) < 0.75 * np.pi))


def _kept(angles: Float64, limits: Float64) -> Float64:
    return np.clip(np.unwrap(angles) if np.abs(np.diff(angles)).max(initial=0) > np.pi else angles, *limits)


def _frame(x: Float64, y: Float64) -> Float64:
    """Frames (n, 3, 3) with columns x, y and z = x × y, from vectors (n, 3) made orthonormal; x keeps its direction."""
    x = _unit(x)
    y = _unit(y - (y * x).sum(axis=1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _unit(v: Float64) -> Float64:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _into(R: Float64, v: Float64) -> Float64:
    """Transform world vectors (n, 3) into the frames R (n, 3, 3)."""
    return np.asarray(np.einsum("nji,nj->ni", R, v))


def _yaw_pitch_roll(R: Float64) -> Float64:
    """Yaw, pitch and roll (n, 3) with R = R_y(yaw) · R_x(pitch) · R_z(roll)."""
    return np.stack(
        [
            np.arctan2(R[:, 0, 2], R[:, 2, 2]),
            np.arcsin(np.clip(-R[:, 1, 2], -1, 1)),
            np.arctan2(R[:, 1, 0], R[:, 1, 1]),
        ],
        axis=1,
    )
