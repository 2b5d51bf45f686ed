"""Scores gestures of hands in rendered depth images with ground truth.

A scene defines the gesture of its hand; the time between two gestures is not scored, nor is the time just after the
beginning of a gesture, when it cannot be known yet.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mocapella.detectors import ArmDetector
from mocapella.evaluation.arms import in_image, matched
from mocapella.sources.simulate.depth_scene import DepthShot

SETTLED_S: Final = 0.2
"""Time from the beginning of a gesture to the beginning of its scoring [s]."""
CLOSED: Final = ("fist", "grab", "pinch")
"""Gestures of a closed hand; in the others the hand is open."""


@dataclass
class GestureScores:
    """Results of gestures, summed over frames.

    Attributes:
        told: number of frames for each pair of true and reported gesture; an empty name is no gesture. Frames less than
            `SETTLED_S` after the beginning of a true gesture do not count, here and in the next four.
        grabbed, grabbed_right: number of frames with a closed hand, and number of these frames with ``grabbing``
            reported.
        loose, loose_right: number of frames with an open hand, and number of these frames without ``grabbing``
            reported.
        begun: number of true gestures within the image.
        late_s: delay from the beginning of a true gesture to its detection, for each detected one [s].
    """

    told: Counter[tuple[str, str]] = field(default_factory=Counter)
    grabbed: int = 0
    grabbed_right: int = 0
    loose: int = 0
    loose_right: int = 0
    begun: int = 0
    late_s: list[float] = field(default_factory=list)

    def add(self, other: GestureScores) -> None:
        """Add another score to this one, in place."""
        self.told.update(other.told)
        self.late_s.extend(other.late_s)
        for name in ("grabbed", "grabbed_right", "loose", "loose_right", "begun"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def table(self) -> dict[str, float]:
        """Return the figures by name; NaN where nothing was counted.

        Returns:
            ``frames``: number of scored frames, all with a true gesture. ``late_median_ms``: median delay of the
            detected gestures [ms]. The rest are fractions, 0 to 1: ``NAME_right`` and ``right`` of the frames with the
            right gesture, of one gesture and of all; ``none`` of the frames without a reported gesture;
            ``grabbing_right`` and ``not_grabbing_right`` of the frames with a closed and with an open hand in which
            ``grabbing`` is right; ``never_told`` of the true gestures that were never detected.
        """

        def part(some: int, of_all: int) -> float:
            return round(some / of_all, 4) if of_all else float("nan")

        frames = Counter[str]()
        for (true, _), count in self.told.items():
            frames[true] += count
        total = sum(frames.values())
        return {
            "frames": total,
            **{f"{name}_right": part(self.told[name, name], frames[name]) for name in sorted(frames)},
            "right": part(sum(self.told[name, name] for name in frames), total),
            "none": part(sum(self.told[name, ""] for name in frames), total),
            "grabbing_right": part(self.grabbed_right, self.grabbed),
            "not_grabbing_right": part(self.loose_right, self.loose),
            "never_told": part(self.begun - len(self.late_s), self.begun),
            "late_median_ms": round(1e3 * float(np.median(self.late_s)), 1) if self.late_s else float("nan"),
        }


def gesture_scores(detector: ArmDetector, shots: Iterable[DepthShot]) -> GestureScores:
    """Run a detector with gestures over a scene's simulated depth images; score it by ground truth.

    Args:
        detector: from `mocapella.detectors.make_detector`, with gestures; new or reset.
        shots: the images and their ground truth, in the order of their times.
    """
    scores = GestureScores()
    since: dict[int, tuple[str, float]] = {}
    told: dict[int, bool] = {}
    for shot in shots:
        seen = detector.update(shot.depth * np.float32(shot.unit_m), shot.at_s)
        for i, truth in enumerate(shot.arms):
            if not truth.gesture or not in_image(truth, shot):
                since.pop(i, None)
                continue
            if i not in since or since[i][0] != truth.gesture:
                since[i], told[i] = (truth.gesture, shot.at_s), False
                scores.begun += 1
            arm = matched(truth, seen)
            name = "" if arm is None else arm.gesture
            if name == truth.gesture and not told[i]:
                told[i] = True
                scores.late_s.append(shot.at_s - since[i][1])
            if shot.at_s - since[i][1] < SETTLED_S:
                continue
            scores.told[truth.gesture, name] += 1
            grabbing = arm is not None and arm.grabbing
            if truth.gesture in CLOSED:
                scores.grabbed += 1
                scores.grabbed_right += grabbing
            else:
                scores.loose += 1
                scores.loose_right += not grabbing
    return scores
