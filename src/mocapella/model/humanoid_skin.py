"""The skin of a named humanoid: the body mesh of an average man, fitted to a person's joints at rest.

The mesh of `mocapella.model.body_meshes` is posed in the T pose. Each bone then carries its vertices to the person's
bone, stretched to its length; near a joint, the results of both bones are blended by the weights that also skin it.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.bone_rotations import shortest
from mocapella.model.body_meshes import body_mesh
from mocapella.model.hand import DIGITS, hand_model
from mocapella.model.hand_mesh import hand_mesh
from mocapella.model.humanoid_bones import BONES, FINGERS, carrier_of
from mocapella.model.humanoid_joints import INDEX, average_joints
from mocapella.model.humanoid_motion import HumanoidMotion
from mocapella.model.rigged_mesh import posed, rest, smooth, strongest
from mocapella.model.skeleton import SKELETON
from mocapella.model.skin import SkinnedSurface, joined
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]

_Piece = tuple[Float64, Int32, tuple[str, ...], Float64]
"""Vertices (n, 3), faces, names of bones, and their weights (n, bones)."""
_AS_LARGE: Final = ("head", "left hand", "right hand", "left foot", "right foot")
"""Bones whose joints do not tell their length: the skin has the person's size there."""
_SHRUNK: Final = 0.7
"""By how much a mitten shrinks where a hand has fingers [ratio]."""
_STRETCH: Final = (0.4, 2.5)
"""Limits of a bone's length relative to the average, for the skin."""


def humanoid_skin(motion: HumanoidMotion) -> SkinnedSurface:
    """Return a skinned body with the lengths of a humanoid's bones; girths grow with the person's size.

    A hand with fingers has the mesh of `mocapella.model.hand_mesh`; the others have mittens.
    """
    usual, own = average_joints(), motion.joints
    size = _size(usual, own)
    pieces = [_average_body()]
    for side in ("left", "right"):
        if f"{side} index 1" in motion.parts:
            pieces = [_without_hand(pieces[0], side), *pieces[1:], _average_hand(side)]
    surfaces = []
    for vertices, faces, parts, weights in pieces:
        fitted, dense = np.zeros_like(vertices), np.zeros((len(vertices), len(motion.parts)))
        for k, part in enumerate(parts):
            fitted += weights[:, k, None] * _carried(vertices, part, usual, own, size)
            dense[:, motion.parts.index(carrier_of(motion.humanoid, part))] += weights[:, k]
        surfaces.append(SkinnedSurface(fitted, faces, *strongest(dense)))
    return joined(surfaces)


def _carried(vertices: Float64, part: str, usual: Float64, own: Float64, size: float) -> Float64:
    """Return where a bone carries vertices (n, 3), from the average person to one with other joints at rest."""

    def at(joints: Float64, name: str) -> Float64:
        return np.asarray(joints[INDEX[name]])

    def width(name: str) -> float:
        usual_m, own_m = (np.linalg.norm(at(j, f"{name}Left") - at(j, f"{name}Right")) for j in (usual, own))
        return float(np.clip(own_m / usual_m, *_STRETCH))

    if part == "hips":
        start, to = (0.5 * (at(joints, "HipLeft") + at(joints, "HipRight")) for joints in (usual, own))
        return np.asarray(to + (vertices - start) * [0.5 * (width("Hip") + size), size, size])
    bone = BONES[part]
    start, to = at(usual, bone.joint), at(own, bone.joint)
    before, after = at(usual, bone.end) - start, at(own, bone.end) - to
    length = float(np.linalg.norm(before))
    along = before / length
    stretch = size if part in _AS_LARGE else float(np.clip(np.linalg.norm(after) / length, *_STRETCH))
    sizes = np.full(3, size)
    if part in ("spine", "chest"):
        sizes[0] = 0.5 * (width("Shoulder") + size)
    local = vertices - start
    down = local @ along
    stretched = (local - down[:, None] * along) * sizes + (stretch * down)[:, None] * along
    reached = float(np.linalg.norm(after))
    turn = shortest(along, after / reached) if reached > 1e-6 else np.eye(3)
    return np.asarray(to + stretched @ turn.T)


def _size(usual: Float64, own: Float64) -> float:
    """Return the person's size relative to the average: the median over the bones between known joints."""
    pairs = np.array([(INDEX[bone.joint], INDEX[bone.end]) for bone in BONES.values()
                      if bone.end and not bone.share and bone.part not in (*_AS_LARGE, *FINGERS)])  # fmt: skip
    ratios = [np.linalg.norm(joints[pairs[:, 1]] - joints[pairs[:, 0]], axis=1) for joints in (own, usual)]
    return float(np.clip(np.median(ratios[0] / ratios[1]), 0.3, 3.0))


@cache
def _average_body() -> _Piece:
    """Return an average man's mesh in the T pose."""
    mesh = body_mesh("male", supple=True)
    angles = rest(mesh).angles.copy()
    for side in ("left", "right"):
        angles[mesh.joint_names.index(f"{side} shoulder raise sidewards")] = np.pi / 4
    vertices = posed(mesh, TreePose(np.eye(4), angles))
    dense = np.zeros((len(vertices), len(mesh.part_names)))
    np.put_along_axis(dense, mesh.bones.astype(np.int64), mesh.shares, axis=1)
    of = dict(zip(mesh.part_names, dense.T, strict=True))
    weights = _weights(vertices, of)
    return vertices, mesh.faces, tuple(weights), np.column_stack(list(weights.values()))


def _without_hand(piece: _Piece, side: str) -> _Piece:
    """Return the mesh of a body whose mitten shrinks into the palm, so that the forearm stays closed."""
    vertices, faces, parts, weights = piece
    wrist = average_joints()[INDEX[f"Wrist{side.title()}"]]
    share = weights[:, parts.index(f"{side} hand"), None]
    return vertices - _SHRUNK * share * (vertices - wrist), faces, parts, weights


@cache
def _average_hand(side: str) -> _Piece:
    """Return the mesh of an average man's hand in the T pose, which reaches over the wrist."""
    wrist = average_joints()[INDEX[f"Wrist{side.title()}"]]
    length = float(np.linalg.norm(average_joints()[INDEX[f"HandTip{side.title()}"]] - wrist))
    mesh = hand_mesh(hand_model("full").shape("right", hand_length_m=length))
    left = side == "left"
    vertices = wrist + mesh.vertices[:, [2, 1, 0]] * [1.0 if left else -1.0, 1.0, 1.0]
    weights = np.zeros((len(vertices), len(mesh.part_names)))
    np.put_along_axis(weights, mesh.bones.astype(np.int64), mesh.shares, axis=1)
    fingers = tuple(f"{side} {digit} {k + 1}" for digit in DIGITS for k in range(3))
    return vertices, mesh.faces[:, ::-1] if left else mesh.faces, (f"{side} hand", *fingers), weights


def _weights(vertices: Float64, of: dict[str, Float64]) -> dict[str, Float64]:
    """Return the weights (vertices,) of the bones of a humanoid, given the weights of the mesh's parts."""
    place = {name: average_joints()[k] for k, name in enumerate(SKELETON.joints)}
    x, y = np.abs(vertices[:, 0]), vertices[:, 1]
    h = float(y.max())
    trunk = of["pelvis"] + of["torso"]
    above = smooth(y, place["SpineBase"][1] - 0.02 * h, place["SpineBase"][1] + 0.08 * h)
    bent = smooth(y, place["SpineMid"][1] - 0.07 * h, place["SpineMid"][1] + 0.07 * h)
    shoulder = float(place["ShoulderLeft"][0])
    lifted = smooth(x, 0.35 * shoulder, shoulder) * smooth(
        y, place["SpineShoulder"][1] - 0.10 * h, place["SpineShoulder"][1]
    )
    up = smooth(y, place["Neck"][1] - 0.02 * h, place["Neck"][1] + 0.02 * h)
    upper = trunk * above * bent
    weights = {
        "hips": trunk * (1 - above),
        "spine": trunk * above * (1 - bent),
        "chest": upper * (1 - lifted),
        "neck": of["head"] * (1 - up),
        "head": of["head"] * up,
    }
    for side in ("left", "right"):
        own = vertices[:, 0] > 0 if side == "left" else vertices[:, 0] <= 0
        wrist = place[f"Wrist{side.title()}"]
        handed = smooth(x, abs(wrist[0]) - 0.012 * h, abs(wrist[0]) + 0.012 * h)
        weights |= {
            f"{side} shoulder": upper * lifted * own,
            f"{side} upper arm": of[f"{side} upper arm"],
            f"{side} lower arm": of[f"{side} forearm"] * (1 - handed),
            f"{side} hand": of[f"{side} forearm"] * handed,
            f"{side} upper leg": of[f"{side} thigh"],
            f"{side} lower leg": of[f"{side} shank"],
            f"{side} foot": of[f"{side} foot"],
        }
    return weights
