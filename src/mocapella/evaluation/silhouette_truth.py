"""Compares a tracked body with the ground truth of a rendered scene, frame by frame.

Figures: errors of joint angles and landmarks, and intersection over union of the model and the true masks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.silhouette_fit import Outline
from mocapella.model.silhouettes import overlap
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]


class TruthScore(msgspec.Struct, frozen=True):
    """The errors of a body.

    Attributes:
        frames: number of frames.
        angle_deg: median of the absolute errors of all joint angles [deg].
        angle_mean_deg: mean of these errors [deg].
        angles_deg: mean absolute error by joint angle [deg]. A rotation about the axis of a straight limb shows in no
            outline.
        joints_mm: median distance of the landmarks from their true positions [mm].
        overlap: mean intersection over union of the model and the true person, over frames and cameras; NaN without
            any.
    """

    frames: int
    angle_deg: float
    angle_mean_deg: float
    angles_deg: dict[str, float]
    joints_mm: float
    overlap: float


class TruthMeter:
    """Collects errors frame by frame.

    Args:
        joint_names: names of the joint angles, in the order of `TreePose.angles`.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._names = tuple(joint_names)
        self._angles: list[Float64] = []
        self._joints: list[Float64] = []
        self._overlaps: list[float] = []

    def update(
        self,
        pose: TreePose,
        landmarks: Float64,
        outlines: Mapping[str, Outline],
        truth: tuple[TreePose, Float64, Mapping[str, Bool]],
    ) -> None:
        """Add one frame.

        Args:
            pose: estimated pose.
            landmarks: (n, 3) estimated landmarks in the world [m].
            outlines: outlines of the posed mesh, by camera; the overlap counts cameras of both mappings only.
            truth: true pose, true landmarks (n, 3) [m], and true masks (height, width) by camera.
        """
        true_pose, true_landmarks, masks = truth
        self._angles.append(np.abs(pose.angles - true_pose.angles))
        self._joints.append(np.linalg.norm(landmarks - true_landmarks, axis=-1))
        for name, mask in masks.items():
            if name in outlines:
                covered = outlines[name].silhouette.mask((mask.shape[1], mask.shape[0]))
                self._overlaps.append(overlap(covered, mask))

    @property
    def score(self) -> TruthScore | None:
        """Return the errors of all frames so far; None before the first."""
        if not self._angles:
            return None
        angles = np.degrees(np.array(self._angles))
        return TruthScore(
            len(self._angles),
            float(np.median(angles)),
            float(angles.mean()),
            dict(zip(self._names, angles.mean(axis=0).tolist(), strict=True)),
            1e3 * float(np.median(self._joints)),
            float(np.mean(self._overlaps)) if self._overlaps else float("nan"),
        )


def rough_start(pose: TreePose, limits: Float64, seed: int, off: Sequence[float] = (0.03, 0.08)) -> TreePose:
    """Return a copy of a pose with normally distributed errors, to simulate a pose that was set by hand.

    The orientation of the root is unchanged.

    Args:
        pose: the true pose.
        limits: (joints, 2) least and most value of each angle [rad]; the result keeps them.
        seed: random seed of the errors.
        off: standard deviations of the position [m] and of the angles [rad].
    """
    rng = np.random.default_rng([seed, 71])
    T = pose.T_world_model.copy()
    T[:3, 3] += rng.normal(0.0, off[0], 3)
    angles = pose.angles + rng.normal(0.0, off[1], len(pose.angles))
    return TreePose(T, np.clip(angles, *limits.T))
