"""Scores detectors of arms and fingertips on rendered depth images with ground truth.

A true arm is matched to the detected arm with the nearest palm, within 10 cm. Detections are scored without alignment
or other corrections, and a detector has no information about the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors import ArmDetector
from mocapella.kinematics.arm_quality import ArmQualitySettings, misdetected
from mocapella.model.arm_quality import Misdetections
from mocapella.model.arms import ARM_JOINTS, ELBOW, PALM, SeenArm, SeenArms
from mocapella.model.hand import TIPS, WRIST
from mocapella.model.observations import JointState
from mocapella.sources.simulate.depth_scene import ArmTruth, DepthShot

Float64 = NDArray[np.float64]

MATCH_M: Final = 0.10
"""Largest distance between the palms of a true and a detected arm that match [m]."""
FOUND_M: Final = 0.015
"""Largest error of a fingertip with the right name that counts as found [m]."""
LIMITS: Final = ArmQualitySettings()
"""Least way of a joint that jumped beyond its true motion, and longest time between images that are compared."""


@dataclass
class ArmScores:
    """A detector's counts and errors over all frames; `table` computes the figures from them.

    Attributes:
        frames: number of true arms in the images, summed over frames.
        followed: number of these arms that are matched to a detected arm.
        tips: errors of visible fingertips that the detector measured [m].
        inferred: number of visible fingertips of matched arms that the detector did not measure.
        named: number of visible fingertips whose nearest detected tip, or one within `FOUND_M`, has the right name.
        visible: number of visible fingertips, also of arms without a match.
        occluded, occluded_found: number of visible fingertips in front of the palm or of other digits, and number of
            these that are measured within `FOUND_M`.
        hidden: errors of fingertips without pixels in the image [m].
        wrist, palm, elbow: errors of these joints, of the elbow only if it is visible [m].
        sided: number of matched arms whose side, left or right, is correct.
        lost: length of the longest run of frames without a match for an arm, after its first match.
        misdetected: misdetections (`kinematics.arm_quality.misdetected`) of matched arms, without the true motion.
        compared_s: time over which they were counted [s].
    """

    frames: int = 0
    followed: int = 0
    tips: list[float] = field(default_factory=list)
    inferred: int = 0
    named: int = 0
    visible: int = 0
    occluded: int = 0
    occluded_found: int = 0
    hidden: list[float] = field(default_factory=list)
    wrist: list[float] = field(default_factory=list)
    palm: list[float] = field(default_factory=list)
    elbow: list[float] = field(default_factory=list)
    sided: int = 0
    lost: int = 0
    misdetected: Misdetections = field(default_factory=Misdetections)
    compared_s: float = 0.0

    def add(self, other: ArmScores) -> None:
        """Add another score to this one, in place; the longest loss is the longer of both."""
        for name in ("frames", "followed", "inferred", "named", "visible", "occluded", "occluded_found", "sided"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("tips", "hidden", "wrist", "palm", "elbow"):
            getattr(self, name).extend(getattr(other, name))
        self.lost = max(self.lost, other.lost)
        self.misdetected, self.compared_s = self.misdetected.plus(other.misdetected), self.compared_s + other.compared_s

    def table(self) -> dict[str, float]:
        """Return the figures: errors [mm] and shares, 0 to 1; NaN where nothing was counted.

        A visible fingertip without a detected position, and each of an arm without a match, counts as misnamed.
        """

        def of(values: list[float], q: float) -> float:
            return round(1e3 * float(np.percentile(values, q)), 2) if values else float("nan")

        def part(some: int, of_all: float) -> float:
            return round(some / of_all, 4) if of_all else float("nan")

        return {
            "frames": self.frames,
            "followed": part(self.followed, self.frames),
            "tip_median_mm": of(self.tips, 50),
            "tip_p95_mm": of(self.tips, 95),
            "named": part(self.named, self.visible),
            "inferred": part(self.inferred, self.visible),
            "occluded": self.occluded,
            "occluded_found": part(self.occluded_found, self.occluded),
            "hidden_median_mm": of(self.hidden, 50),
            "wrist_median_mm": of(self.wrist, 50),
            "palm_median_mm": of(self.palm, 50),
            "elbow_median_mm": of(self.elbow, 50),
            "elbow_p95_mm": of(self.elbow, 95),
            "sided": part(self.sided, self.followed),
            "longest_loss_frames": self.lost,
            "misdetections_per_minute": part(60 * self.misdetected.of_joints, self.compared_s),
        }


def score(detector: ArmDetector, shots: Iterable[DepthShot]) -> ArmScores:
    """Run a detector over a scene's simulated depth images, and score it by ground truth.

    Args:
        detector: a new or reset detector; it keeps its memory of the scene afterwards.
        shots: the images and their ground truth, in the order of their times; only arms that are `in_image` count.
    """
    scores = ArmScores()
    runs: dict[int, int] = {}
    last: dict[int, tuple[float, SeenArm, ArmTruth]] = {}
    for shot in shots:
        seen = detector.update(shot.depth * np.float32(shot.unit_m), shot.at_s)
        for i, truth in enumerate(shot.arms):
            if not in_image(truth, shot):
                runs.pop(i, None)
                continue
            scores.frames += 1
            arm = matched(truth, seen)
            if arm is None:
                if i in runs:
                    runs[i] += 1
                    scores.lost = max(scores.lost, runs[i])
                scores.visible += int(truth.seen[list(TIPS)].sum())
                scores.occluded += int(truth.self_occluded.sum())
                continue
            runs[i] = 0
            _add(scores, truth, arm)
            if i in last:
                _compare(scores, last[i], (shot.at_s, arm, truth))
            last[i] = shot.at_s, arm, truth
    return scores


def in_image(truth: ArmTruth, shot: DepthShot) -> bool:
    """Return whether a true arm is scored: its palm is at least 15 pixels inside the image, and more than 5 cm away."""
    x, y, z = truth.points[PALM]
    if z <= 0.05:
        return False
    u, v = shot.lens[0] * x / z + shot.lens[2], shot.lens[1] * y / z + shot.lens[3]
    height, width = shot.depth.shape
    return bool(15 <= u < width - 15 and 15 <= v < height - 15)


def matched(truth: ArmTruth, seen: SeenArms) -> SeenArm | None:
    """Return the detected arm whose palm is nearest to the true one; None if none is within `MATCH_M`."""
    near = [(float(np.linalg.norm(arm.points[PALM] - truth.points[PALM])), k) for k, arm in enumerate(seen.arms)]
    near = [pair for pair in near if pair[0] <= MATCH_M]
    return seen.arms[min(near)[1]] if near else None


def _compare(scores: ArmScores, before: tuple[float, SeenArm, ArmTruth], now: tuple[float, SeenArm, ArmTruth]) -> None:
    """Count the misdetections of an arm between two images, if they follow each other and it kept its id."""
    step_s = now[0] - before[0]
    if before[1].id != now[1].id or not 0 < step_s <= LIMITS.gap_s:
        return
    joints = list(ARM_JOINTS)
    true = now[2].points[joints] - before[2].points[joints]
    found = misdetected(before[1].joints, now[1].joints, LIMITS.jump_m, true)
    found = found.plus(Misdetections(swapped=int(before[1].left != now[1].left)))
    scores.misdetected, scores.compared_s = scores.misdetected.plus(found), scores.compared_s + step_s


def _add(scores: ArmScores, truth: ArmTruth, arm: SeenArm) -> None:
    scores.followed += 1
    scores.sided += arm.left == truth.left
    tips = list(TIPS)
    apart = np.linalg.norm(arm.points[tips][None] - truth.points[tips][:, None], axis=-1)  # (true, detector's)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    own = np.diag(apart)
    measured = arm.states[tips] == JointState.TRACKED
    visible = truth.seen[tips]
    scores.visible += int(visible.sum())
    for k in range(5):
        if not visible[k]:
            if np.isfinite(own[k]):
                scores.hidden.append(float(own[k]))
            continue
        if measured[k] and np.isfinite(own[k]):
            scores.tips.append(float(own[k]))
        else:
            scores.inferred += 1
        scores.named += bool(np.isfinite(own[k]) and (own[k] <= FOUND_M or own[k] == apart[k].min()))
        if truth.self_occluded[k]:
            scores.occluded += 1
            scores.occluded_found += bool(measured[k] and own[k] <= FOUND_M)
    for name, at in (("wrist", WRIST), ("palm", PALM), ("elbow", ELBOW)):
        error = float(np.linalg.norm(arm.points[at] - truth.points[at]))
        if np.isfinite(error) and (at != ELBOW or truth.seen[ELBOW]):
            getattr(scores, name).append(error)


def jitter(detector: ArmDetector, shots: Iterable[DepthShot], *, settle: int = 15) -> Mapping[str, float]:
    """Return the root mean square motion of a still arm's joints about their mean [m], by joint.

    Args:
        detector: the detector.
        shots: simulated depth images of one still arm, in the order of their times.
        settle: number of first frames that are not counted.

    Returns:
        Jitter by joint, from the frames with a detected arm; NaN for all joints if there are fewer than two, and for a
        joint that is missing in one of them.
    """
    from mocapella.model.arms import ARM_JOINT_NAMES

    rows: list[Any] = []
    for k, shot in enumerate(shots):
        seen = detector.update(shot.depth * np.float32(shot.unit_m), shot.at_s)
        arm = matched(shot.arms[0], seen)
        if k >= settle and arm is not None:
            rows.append(arm.joints)
    if len(rows) < 2:
        return dict.fromkeys(ARM_JOINT_NAMES, float("nan"))
    joints = np.stack(rows)
    motion = np.sqrt(((joints - np.nanmean(joints, axis=0)) ** 2).sum(axis=-1).mean(axis=0))
    return dict(zip(ARM_JOINT_NAMES, motion.tolist(), strict=True))
