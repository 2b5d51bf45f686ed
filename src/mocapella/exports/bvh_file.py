"""Write BVH, an animated skeleton that Blender and other animation programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.exports import bvh_kernels as kernels
from mocapella.exports.animated_skeleton import motion_of, notes_of
from mocapella.model.rest_pose import FRAMES_AT_ONCE, RigidSkeleton
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

CM_PER_M: Final = 100.0
TURNS: Final = "Zrotation Xrotation Yrotation"
_DIGITS: Final = 6
_LONGEST_NUMBER: Final = 20
"""Largest size of a number with its space [bytes]."""
_LEAST_END_CM: Final = 2.0
"""Least length of the end of a joint without children [cm]."""


def write_bvh(trajectories: Trajectories, path: Path, *, humanoid: str | None = None) -> list[str]:
    """Write one individual as BVH, in centimetres, Y up; at rest in a T pose that looks along +Z, with its left on +X.

    Bones are rigid, with their median lengths. The root has a position; every joint has a rotation in the order Z, X,
    Y. A joint without a known position keeps its last one relative to its parent.

    Args:
        trajectories: one individual at a constant rate.
        path: the file.
        humanoid: names and rest pose of the bones (`mocapella.model.humanoid_bones`); None for the tracked joints of
            people, and ``vrm`` for bodies. Hands and arms have their own landmarks.

    Returns:
        Sentences about the distance of the rigid skeleton from the measured joints, joints that are held, and twists.

    Raises:
        SettingsError: the individual has no skeleton, or is never known.
        OSError: the file cannot be written.
    """
    motion = motion_of(trajectories, humanoid)
    skeleton = motion.skeleton
    order = np.array(_depth_first(skeleton))
    lines = ["HIERARCHY", *_joint(skeleton, 0, 0), "MOTION", f"Frames: {len(trajectories)}"]
    lines.append(f"Frame Time: {1.0 / trajectories.rate_hz:.9f}")
    last = np.zeros((len(order), 3))
    with path.open("wb") as file:
        file.write(("\n".join(lines) + "\n").encode())
        for begin in range(0, len(trajectories), FRAMES_AT_ONCE):
            some = slice(begin, begin + FRAMES_AT_ONCE)
            root = CM_PER_M * motion.root[some]
            angles = np.empty((len(root), 3 * len(order)))
            kernels.turns(skeleton.parents, order, motion.rotations(some), last, angles)
            file.write(_lines(np.concatenate([root, angles], axis=1)))
    return notes_of(motion)


def _lines(rows: Float64) -> bytes:
    """Return the text of rows of numbers."""
    text = np.empty(_LONGEST_NUMBER * rows.size, np.uint8)
    size = kernels.write_decimals(rows, _DIGITS, text)
    if size < 0:
        raise SettingsError(f"a number is not finite, or {np.abs(rows).max()} is too large for a BVH")
    return text[:size].tobytes()


def _depth_first(skeleton: RigidSkeleton, joint: int = 0) -> list[int]:
    """Return the joints in the order of the file's hierarchy."""
    children = np.flatnonzero(skeleton.parents == joint).tolist()
    return [joint, *(one for child in children for one in _depth_first(skeleton, child))]


def _joint(skeleton: RigidSkeleton, joint: int, depth: int) -> list[str]:
    """Return the lines of a joint and all joints below it."""
    indent, root = "\t" * depth, joint == 0
    offset = CM_PER_M * skeleton.offsets[joint]
    lines = [
        f"{indent}{'ROOT' if root else 'JOINT'} {_word(skeleton.names[joint])}",
        f"{indent}{{",
        f"{indent}\tOFFSET {_numbers(offset)}",
        f"{indent}\tCHANNELS 6 Xposition Yposition Zposition {TURNS}" if root else f"{indent}\tCHANNELS 3 {TURNS}",
    ]
    children = np.flatnonzero(skeleton.parents == joint).tolist()
    for child in children:
        lines += _joint(skeleton, child, depth + 1)
    if not children:
        length = float(np.linalg.norm(offset))
        end = offset * max(0.3, _LEAST_END_CM / length) if length > 1e-6 else np.array([0.0, _LEAST_END_CM, 0.0])
        lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_numbers(end)}", f"{indent}\t}}"]
    return [*lines, f"{indent}}}"]


def _numbers(values: Float64) -> str:
    return " ".join(f"{value:.6f}" for value in values.tolist())


def _word(name: str) -> str:
    """Return a name without spaces, which end a name in a BVH."""
    return "_".join(name.split()) or "joint"
