"""Retarget a BVH file to a person of the room: joints by name, in metres, on the floor, facing the main sensor.

Only joint positions are used: bones have the file's directions and the medians of its lengths, scaled to the person.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.errors import InputError
from mocapella.geometry.rigid import rotation_about_y
from mocapella.model.bvh import Bvh
from mocapella.settings import check
from mocapella.sources.simulate.body import BODY, JOINT, ROOT, body_template, bone_lengths, facing, joint_positions
from mocapella.sources.simulate.gait import animate
from mocapella.sources.simulate.motion import POSE_HZ, Motion, normalised, smooth_step
from mocapella.sources.simulate.route import Point, Route, Spot
from mocapella.sources.simulate.scenarios import FACING_MAIN, STILL_S

Float64 = NDArray[np.float64]

BLEND_S = 1.6
"""Duration of the blend from standing to the file's first pose, and from its last pose to standing [s]."""
_TRUNK = (("SpineShoulder", ("ShoulderLeft", "ShoulderRight")), ("SpineMid", ("SpineBase", "SpineShoulder")))
"""Trunk joints that a file may lack: each is half way between two others."""
_SIZE_BONES = ("KneeLeft", "AnkleLeft", "KneeRight", "AnkleRight")
"""The bones that define a person's size; every file has them."""


def bvh_motion(
    bvh: Bvh,
    start: Point,
    stature: float,
    rng: np.random.Generator,
    *,
    metres_per_unit: float | None = None,
    file: object = None,
) -> Motion:
    """Make a motion of standing still, the file's motion, and the return to the start.

    The person keeps the file's bone lengths (their median over the frames). The return is a blend from the last pose to
    standing, in which feet slide, since files seldom end where they begin.

    Args:
        bvh: content of the file.
        start: position of the first pose (world x, z) [m].
        stature: height of the person [m]; the file is scaled to it if ``metres_per_unit`` is None.
        rng: as in `mocapella.sources.simulate.gait.animate`.
        metres_per_unit: the file's unit [m], such as 0.01 for centimetres; the stature then follows from the file.
        file: named in errors; None leaves it out.

    Raises:
        InputError: joints are missing, or the legs have no length.
        SettingsError: with ``metres_per_unit``, the person would not be from 0.3 to 3 m tall.
    """
    root, directions, lengths = _skeleton(bvh, file)
    size = lengths[[JOINT[name] for name in _SIZE_BONES]].sum()
    if not size > 0:
        raise InputError("the legs have no length", file=file, field="OFFSET", fix="export the file with its skeleton")
    wanted = bone_lengths(stature)[[JOINT[name] for name in _SIZE_BONES]].sum()
    scale = wanted / size if metres_per_unit is None else metres_per_unit
    stature = stature * scale * size / wanted
    check(0.3 <= stature <= 3, "metres_per_unit", scale, "such that the person is from 0.3 to 3 m tall, or left out")
    lengths = lengths * scale
    missing = lengths == 0
    missing[ROOT] = False
    lengths[missing] = (np.linalg.norm(body_template().offsets, axis=1) * stature)[missing]
    root, directions = _placed(root * scale, directions, lengths, start)
    root, directions = _resampled(root, directions, bvh.frame_s)
    still = Route(Spot(*start, FACING_MAIN))
    still.stand(STILL_S)
    before = animate(still.legs, lengths, stature, rng)
    root, directions = _joined(before, root, directions)
    # Interpolation between two poses may move a foot below the floor: lift the body by as much.
    root[:, 1] -= np.minimum(joint_positions(root, directions, lengths)[..., 1].min(axis=1), 0.0)
    return Motion(root, directions, lengths, body_template().radii * stature)


def joint_columns(bvh: Bvh, file: object = None) -> Mapping[str, int]:
    """Map the names of the body's joints to indices of the file's joints, by the first naming scheme that fits.

    Optional joints that the file lacks, such as toes, are missing in the result. ``file`` is named in errors.

    Raises:
        InputError: no scheme fits; names the missing joints of the closest one.
    """
    data = _names()
    place: dict[str, int] = {}
    for i, joint in enumerate(bvh.joints):
        place.setdefault(_plain(joint.name), i)
    closest: tuple[int, str, list[str]] | None = None
    for scheme, names in data["schemes"].items():
        found = _found(names, place, data["sides"])
        missing = [joint for joint in data["required"] if joint not in found]
        if not missing:
            return found
        if closest is None or len(missing) < closest[0]:
            closest = (len(missing), scheme, missing)
    assert closest is not None
    raise InputError(
        f"by the names of {closest[1]}, which fit best, these joints are missing: {', '.join(closest[2])}",
        file=file,
        field="JOINT",
        fix=f"name the joints as one of {', '.join(data['schemes'])} does",
    )


def _found(names: dict[str, list[str]], place: dict[str, int], sides: dict[str, list[str]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for joint, candidates in names.items():
        for body_joint, words in ((joint, sides["left"]), (BODY.joints[BODY.mirror[JOINT[joint]]], sides["right"])):
            plain = [_plain(candidate.replace("{left}", word)) for candidate in candidates for word in words]
            hit = next((place[name] for name in plain if name in place), None)
            if hit is not None:
                found[body_joint] = hit
    return found


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower().rpartition(":")[2])


@cache
def _names() -> dict[str, Any]:
    return own_toml("mocapella.sources.simulate", "data", "bvh_names.toml")


def _skeleton(bvh: Bvh, file: object) -> tuple[Float64, Float64, Float64]:
    """Root (frames, 3), directions (frames, 25, 3) and lengths (25,) in the file's unit; 0 for a missing bone.

    A missing bone has the direction of its parent bone; a missing spine joint is half way between its neighbours.
    """
    columns = joint_columns(bvh, file)
    positions = bvh.positions()
    joints = {name: positions[:, column] for name, column in columns.items()}
    for name, (a, b) in _TRUNK:
        joints.setdefault(name, (joints[a] + joints[b]) / 2)
    joints.setdefault("Neck", (2 * joints["SpineShoulder"] + joints["Head"]) / 3)
    directions, lengths = np.zeros((len(positions), len(BODY), 3)), np.zeros(len(BODY))
    for parent, child in BODY.bones:
        a, b = BODY.joints[parent], BODY.joints[child]
        if b not in joints:
            directions[:, child] = directions[:, parent]
            continue
        bone = joints[b] - joints.get(a, joints[b])
        lengths[child] = np.median(np.linalg.norm(bone, axis=1))
        short = lengths[child] < 1e-9
        directions[:, child] = directions[:, parent] if short else normalised(bone)
    return joints["SpineBase"], directions, lengths


def _placed(root: Float64, directions: Float64, lengths: Float64, start: Point) -> tuple[Float64, Float64]:
    """Rotate about the vertical and translate so that the first pose faces the main sensor, at ``start``."""
    first = facing(joint_positions(root[:1], directions[:1], lengths))[0]
    turn = rotation_about_y(FACING_MAIN - np.arctan2(first[0], first[2]))
    root, directions = root @ turn.T, directions @ turn.T
    lowest = joint_positions(root, directions, lengths)[..., 1].min()
    return root + np.array([start[0] - root[0, 0], -lowest, start[1] - root[0, 2]]), directions


def _resampled(root: Float64, directions: Float64, frame_s: float) -> tuple[Float64, Float64]:
    at = np.arange(0, (len(root) - 1) * frame_s + 1e-9, 1 / POSE_HZ) / frame_s
    index = np.minimum(at.astype(np.int64), len(root) - 1)
    after, weight = np.minimum(index + 1, len(root) - 1), (at - index)[:, None]
    blended = (1 - weight[..., None]) * directions[index] + weight[..., None] * directions[after]
    return (1 - weight) * root[index] + weight * root[after], normalised(blended)


def _joined(still: Motion, root: Float64, directions: Float64) -> tuple[Float64, Float64]:
    """Join standing, a blend, the file's motion, and a blend back to the first standing pose."""
    count = round(BLEND_S * POSE_HZ)
    weight = smooth_step(np.arange(1, count + 1) / (count + 1))[:, None]

    def blend(a: Float64, b: Float64) -> Float64:
        w = weight if a.ndim == 1 else weight[..., None]
        return np.asarray((1 - w) * a + w * b)

    roots = [still.root, blend(still.root[-1], root[0]), root, blend(root[-1], still.root[0])]
    into = normalised(blend(still.directions[-1], directions[0]))
    back = normalised(blend(directions[-1], still.directions[0]))
    return np.concatenate(roots), np.concatenate([still.directions, into, directions, back])
