"""Compare a tracked body with ground truth: joint angles, jitter, lag, swapped legs, interpenetrating limbs.

    found, true = Movement(mesh, poses, fps), Movement(scene.mesh, scene.poses(), fps)
    score(found, true).angle_deg, outcome(found, true).problem

A joint's error is the angle between its estimated and its true rotation, so the parametrisation of three rotations
does not matter; for a hinge it is the difference of the two angles. Both bodies have all angles 0 in the same rest
pose, but may be of different sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import log_motion
from mocapella.model.body_capsules import capsules_of, depths_m
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.settings import check

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

JOINT_OF: Final = {
    "torso": "waist",
    **{f"{side} {part}": f"{side} {joint}" for side in ("left", "right") for part, joint in (
        ("upper arm", "shoulder"), ("forearm", "elbow"), ("thigh", "hip"), ("shank", "knee"), ("foot", "ankle"))},
}  # fmt: skip
"""Joint between a part of the body and its parent, by part."""
HINGES: Final = ("left knee", "right knee", "left elbow", "right elbow")
"""Hinge joints, which a marker system measures well, and the paper compares."""
FEET: Final = ("left ankle", "right ankle", "left toe", "right toe")
NEAR_DEG: Final = 5.0
FAILED_DEG: Final = 10.0
"""A run fails if the mean joint error is larger [°]."""
LATE_FRAMES: Final = 10
"""Number of frames at the end of a run whose own mean joint error must not exceed `FAILED_DEG`, either."""
APART_M: Final = 0.10
"""Legs with knees and ankles nearer to each other than this cannot be distinguished [m]."""
SWAPPED_FRAMES: Final = 3
"""A run fails with this many frames with swapped legs; the method corrects shorter swaps itself."""
THROUGH_MM: Final = 10.0
"""Largest penetration depth of limbs, in excess of the ground truth's, of a run that does not fail [mm]."""
LONGEST_LAG: Final = 20


class Movement(msgspec.Struct, frozen=True, eq=False, dict=True):
    """A body's poses, frame by frame.

    Attributes:
        mesh: the body's mesh.
        poses: poses with one batch axis (frames,); at least one frame.
        fps: constant frame rate [Hz].

    Raises:
        SettingsError: the poses have another shape, or the frame rate is not above 0.
    """

    mesh: RiggedMesh
    poses: TreePose
    fps: float

    def __post_init__(self) -> None:
        check(np.ndim(self.poses.angles) == 2 and len(self) > 0, "shape of angles", np.shape(self.poses.angles),
              "(1 frame or more, joints)")  # fmt: skip
        check(0 < self.fps < np.inf, "fps", self.fps, "above 0")

    def __len__(self) -> int:
        return len(self.poses.angles)

    @cached_property
    def landmarks(self) -> dict[str, Float64]:
        """Positions (frames, 3) of the landmarks in the world [m], by name."""
        return dict(zip(self.mesh.landmarks, np.moveaxis(landmarks_at(self.mesh, self.poses), -2, 0), strict=True))

    @cached_property
    def rotations(self) -> dict[str, Float64]:
        """Rotations (frames, 3, 3) of a part relative to its parent, by joint of `JOINT_OF`; the identity at rest."""
        R = part_motions(self.mesh.tree, self.poses)[..., :3, :3]
        parents = self.mesh.tree.parents
        return {
            JOINT_OF[part]: np.swapaxes(R[:, parents[k]], -1, -2) @ R[:, k]
            for k, part in enumerate(self.mesh.part_names)
            if part in JOINT_OF
        }

    def first(self, frames: int) -> Movement:
        """Return the movement's first ``frames`` frames, or all if there are fewer; the arrays are views."""
        return Movement(self.mesh, TreePose(self.poses.T_world_model[:frames], self.poses.angles[:frames]), self.fps)

    def flexion_deg(self, joint: str) -> Float64:
        """Return the angle (frames,) of a hinge joint, such as ``left knee`` [deg].

        Raises:
            EvaluationError: the body has no such hinge.
        """
        turns = [k for k, name in enumerate(self.mesh.joint_names) if name.startswith(f"{joint} ")]
        if len(turns) != 1:
            raise EvaluationError(f"{self.mesh.name} has no hinge {joint!r}; hinges: {', '.join(HINGES)}")
        return np.degrees(self.poses.angles[:, turns[0]])


class MovementScore(msgspec.Struct, frozen=True):
    """Figures of one run.

    Attributes:
        frames: number of frames.
        angle_deg, angle_sd_deg: mean and standard deviation of the joints' errors, over joints and frames [deg].
        near: fraction of the errors below `NEAR_DEG`, 0 to 1.
        hinge_deg, hinge_sd_deg: mean absolute error, and standard deviation of the error, of knees and elbows [deg].
        joints_deg: mean error by joint [deg].
        median_mm, p95_mm: median and 95th percentile of the errors of landmarks that both bodies have [mm].
        acceleration, true_acceleration: root mean square acceleration of the landmarks, estimated and true [m/s²].
        jitter: root mean square acceleration of the landmarks' errors [m/s²].
        feet, true_feet, feet_jitter: ``acceleration``, ``true_acceleration`` and ``jitter`` of `FEET` alone [m/s²].
    """

    frames: int
    angle_deg: float
    angle_sd_deg: float
    near: float
    hinge_deg: float
    hinge_sd_deg: float
    joints_deg: dict[str, float]
    median_mm: float
    p95_mm: float
    acceleration: float
    true_acceleration: float
    jitter: float
    feet: float
    true_feet: float
    feet_jitter: float


class Outcome(msgspec.Struct, frozen=True):
    """Whether a body was tracked to the last frame.

    Attributes:
        angle_deg, late_deg: mean error of the joints over all frames, and over the last `LATE_FRAMES` [deg].
        swapped: number of frames with swapped legs.
        through_mm: penetration depth of limbs in the worst frame, in excess of the ground truth's [mm].
        problem: the reason of the failure; empty after success.
    """

    angle_deg: float
    late_deg: float
    swapped: int
    through_mm: float
    problem: str


def joint_errors_deg(found: Movement, true: Movement) -> dict[str, Float64]:
    """Return the angle (frames,) between the estimated and the true rotation, by joint that both bodies have [°].

    Raises:
        EvaluationError: the numbers of frames or the frame rates differ.
    """
    _same(found, true)
    out = {}
    for joint, R in true.rotations.items():
        if joint in found.rotations:
            between = rigid(np.swapaxes(found.rotations[joint], -1, -2) @ R, np.zeros(3))
            out[joint] = np.degrees(np.linalg.norm(log_motion(between)[..., 3:], axis=-1))
    return out


def score(found: Movement, true: Movement) -> MovementScore:
    """Compute the errors of an estimated movement against the true one, with the same number of frames.

    Raises:
        EvaluationError: the numbers or the frame rates differ, or there are fewer than three frames.
    """
    errors = joint_errors_deg(found, true)
    if len(found) < 3:
        raise EvaluationError(f"{len(found)} frames have no acceleration; three or more are wanted")
    every = np.array(list(errors.values()))
    hinges = np.array([found.flexion_deg(name) - true.flexion_deg(name) for name in HINGES if name in errors])
    names = [name for name in true.landmarks if name in found.landmarks]
    off_mm = 1e3 * np.linalg.norm(_places(found, names) - _places(true, names), axis=-1)
    figures = []
    for some in (names, FEET):
        ours, theirs = _places(found, some), _places(true, some)
        figures += [rms_acceleration(x, true.fps) for x in (ours, theirs, ours - theirs)]
    return MovementScore(
        len(found), float(every.mean()), float(every.std()), float(np.mean(every < NEAR_DEG)),
        float(np.abs(hinges).mean()), float(hinges.std()),
        {name: float(error.mean()) for name, error in errors.items()},
        float(np.median(off_mm)), float(np.percentile(off_mm, 95)), *figures,
    )  # fmt: skip


def outcome(found: Movement, true: Movement, through_mm: float = THROUGH_MM) -> Outcome:
    """Judge a run by the mean error of the joints, their error at the end, swapped legs and penetrating limbs.

    Args:
        found, true: estimated and true movement.
        through_mm: largest allowed penetration depth of limbs in excess of the ground truth's [mm].

    Raises:
        EvaluationError: the numbers of frames or the frame rates differ.
    """
    every = np.array(list(joint_errors_deg(found, true).values()))
    mean, late = float(every.mean()), float(every[:, -LATE_FRAMES:].mean())
    swapped = int(legs_swapped(found, true).sum())
    deeper = float(through_itself_mm(found, true).max())
    problem = ""
    if not max(mean, late) <= FAILED_DEG:
        problem = f"joints are {mean:.0f}° off, {late:.0f}° at the end"
    elif swapped >= SWAPPED_FRAMES:
        problem = f"a leg is where the other one belongs in {swapped} frames"
    elif not deeper <= through_mm:
        problem = f"limbs are {deeper:.0f} mm deeper in each other than they are"
    return Outcome(mean, late, swapped, deeper, problem)


def rms_acceleration(places: Float64, fps: float) -> float:
    """Return the root mean square acceleration of positions (frames, ..., 3), in their unit per s²; ``fps`` in Hz."""
    change = np.diff(places, 2, axis=0) * fps**2
    return float(np.sqrt(np.square(change).sum(axis=-1).mean()))


def lag_frames(found: Float64, true: Float64, longest: int = LONGEST_LAG) -> float:
    """Return the lag of a curve (frames,) behind the true one: the delay of the best match [frames], interpolated.

    The lag is negative if the curve leads. Delays up to ``longest`` frames, or a third of the curve, are tried.

    Raises:
        EvaluationError: there are too few frames, or the true curve does not move.
    """
    n, longest = len(true), min(longest, len(true) // 3)
    if longest < 1 or np.ptp(true) < 1e-9:
        raise EvaluationError(
            f"a curve of {n} frames that spans {np.ptp(true) if n else 0:.3g} has no lag; more, please"
        )
    inside = slice(longest, n - longest)
    shifts = np.arange(-longest, longest + 1)
    off = np.array([np.square(found[longest + s : n - longest + s] - true[inside]).mean() for s in shifts])
    best = int(off.argmin())
    if not 0 < best < len(off) - 1:
        return float(shifts[best])
    before, least, after = off[best - 1 : best + 2]
    return float(shifts[best] + 0.5 * (before - after) / (before - 2 * least + after))


def peak_kept(found: Float64, true: Float64) -> float:
    """Return the ratio of the peaks of a curve (frames,) and the true one, each above the true curve's minimum.

    A smoothing that flattens peaks gives less than 1. The true curve must not be constant.
    """
    return float((found.max() - true.min()) / np.ptp(true))


def legs_swapped(found: Movement, true: Movement) -> Bools:
    """Return for each frame (frames,) whether a leg's knee and ankle are nearer to the other leg's true positions.

    Frames with true legs nearer to each other than `APART_M` are not swapped.

    Raises:
        EvaluationError: the numbers of frames or the frame rates differ.
    """
    _same(found, true)
    names = ("knee", "ankle")
    ours, theirs = (
        np.array([[movement.landmarks[f"{side} {name}"] for name in names] for side in ("left", "right")])
        for movement in (found, true)
    )  # (sides, names, frames, 3)
    own, other = (np.square(ours - at).sum(axis=(1, -1)) for at in (theirs, theirs[::-1]))
    apart = np.square(theirs[0] - theirs[1]).sum(axis=-1).max(axis=0) > APART_M**2
    return np.asarray((own > other).any(axis=0) & apart)


def through_itself_mm(found: Movement, true: Movement) -> Float64:
    """Return the penetration depth (frames,) of limbs in excess of the ground truth's own overlaps [mm]; 0 without any.

    Raises:
        EvaluationError: the numbers of frames or the frame rates differ.
    """
    _same(found, true)
    ours, theirs = (
        depths_m(capsules_of(movement.mesh), landmarks_at(movement.mesh, movement.poses)) for movement in (found, true)
    )
    return np.asarray(1e3 * np.maximum(ours - theirs, 0.0).max(axis=1, initial=0.0))


def _places(movement: Movement, names: Sequence[str]) -> Float64:
    """Return positions (frames, names, 3) of landmarks in the world [m]."""
    return np.stack([movement.landmarks[name] for name in names], axis=1)


def _same(found: Movement, true: Movement) -> None:
    if (len(found), found.fps) != (len(true), true.fps):
        raise EvaluationError(
            f"{len(found)} frames at {found.fps:g} Hz cannot be compared with {len(true)} at {true.fps:g} Hz; "
            "`Movement.first` takes as many as were followed"
        )
