"""An individual as an animated skeleton with a skin, for BVH, glTF and USD."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.bone_rotations import local_rotations
from mocapella.geometry.swing_twist import quaternions
from mocapella.model.humanoid_motion import HumanoidMotion, humanoid_motion
from mocapella.model.humanoid_skin import humanoid_skin
from mocapella.model.rest_pose import SkeletonMotion, rigid_motion, skeleton_of
from mocapella.model.skin import SkinnedSurface, capsules, rest_positions
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

USUAL: Final = "vrm"
"""Humanoid of bodies, and in formats with a skin of people, if none is asked for."""


@dataclass(frozen=True, eq=False)
class AnimatedSkeleton:
    """A skeleton in its rest pose on the ground, its skin, and its motion.

    Attributes:
        name: name of the individual.
        motion: the skeleton and its poses.
        rest: (joints, 3) positions at rest; the skin stands on y = 0 [m].
        skin: the surface, in the frame of ``rest``.
        rotations: (frames, joints, 4) quaternions x, y, z, w relative to the parents, continuous over the frames.
        marks: ``held`` and ``twist_observed``: for each joint's name, the first and last frames of each stretch;
            joints without any are left out. ``residual_mm``: see `residual_mm`.
        notes: sentences for the user.
    """

    name: str
    motion: SkeletonMotion
    rest: Float64
    skin: SkinnedSurface
    rotations: Float64
    marks: dict[str, Any]
    notes: list[str]


def motion_of(trajectories: Trajectories, humanoid: str | None) -> SkeletonMotion:
    """Return the motion of one individual: of a humanoid if people or bodies have one, else of its own keypoints.

    Args:
        trajectories: one individual.
        humanoid: name of the humanoid; None for the keypoints of people, and for `USUAL` of bodies. Hands and arms
            have their own landmarks in any case.

    Raises:
        SettingsError: the individual has no such skeleton, or is never known.
    """
    if trajectories.kind == "bodies":
        humanoid = humanoid or USUAL
    if humanoid is not None and trajectories.kind in {"people", "views", "bodies"}:
        return humanoid_motion(trajectories, humanoid)
    return rigid_motion(trajectories, skeleton_of(trajectories))


def animated_skeleton(trajectories: Trajectories, humanoid: str | None) -> AnimatedSkeleton:
    """Return one individual as an animated skeleton with a skin.

    People and bodies have a body's surface, hands and arms capsules around their bones.

    Args:
        trajectories: one individual.
        humanoid: name of the humanoid of people and bodies; None for `USUAL`.

    Raises:
        SettingsError: as `motion_of`.
    """
    motion = motion_of(trajectories, humanoid or USUAL)
    skin = humanoid_skin(motion) if isinstance(motion, HumanoidMotion) else capsules(motion.skeleton)
    ground = np.array([0.0, -float(skin.vertices[:, 1].min(initial=0.0)), 0.0])
    return AnimatedSkeleton(
        trajectories.individuals[0], motion, rest_positions(motion.skeleton) + ground,
        SkinnedSurface(skin.vertices + ground, skin.faces, skin.joints, skin.shares),
        quaternions(local_rotations(motion.skeleton.parents, motion.R)), _marks(motion), notes_of(motion),
    )  # fmt: skip


def residual_mm(motion: SkeletonMotion) -> tuple[float, float]:
    """Return median and 95th percentile of the distances between rigid and measured joints [mm]; NaN without any."""
    known = motion.error_m[np.isfinite(motion.error_m)]
    if not len(known):
        return np.nan, np.nan
    median, most = 1000.0 * np.percentile(known, (50, 95), overwrite_input=True)
    return float(median), float(most)


def notes_of(motion: SkeletonMotion) -> list[str]:
    """Return sentences about the residual of rigid bones, held joints, and the twists that were observed."""
    median, most = residual_mm(motion)
    notes = [f"bones are rigid: joints are {median:.0f} mm off in the median, {most:.0f} mm at 95 %"]
    if motion.held.any():
        what = "rotation" if isinstance(motion, HumanoidMotion) else "position"
        notes.append(f"{motion.held.mean():.0%} of the joints are unknown and keep their last {what}")
    if isinstance(motion, HumanoidMotion):
        shares = motion.observed.mean(axis=0)
        told = [f"{part} {share:.0%}" for part, share, can in zip(motion.parts, shares, motion.twisting, strict=True)
                if can]  # fmt: skip
        notes.append(f"observed twists, share of frames (zero elsewhere): {', '.join(told)}")
    return notes


def _marks(motion: SkeletonMotion) -> dict[str, Any]:
    names = motion.skeleton.names
    marks: dict[str, Any] = {"held": _stretches(names, motion.held)}
    if isinstance(motion, HumanoidMotion):
        marks |= {"humanoid": motion.humanoid, "twist_observed": _stretches(names, motion.observed)}
    median, most = residual_mm(motion)
    return marks if np.isnan(median) else marks | {"residual_mm": {"median": round(median, 2), "p95": round(most, 2)}}


def _stretches(names: tuple[str, ...], marked: NDArray[np.bool_]) -> dict[str, list[list[int]]]:
    """Return first and last frame of each stretch of marked frames (frames, joints), by name."""
    out = {}
    for name, column in zip(names, marked.T, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        if len(edges):
            out[name] = [[int(first), int(end) - 1] for first, end in edges.reshape(-1, 2)]
    return out
