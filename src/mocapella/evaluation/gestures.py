"""How well gestures are told of hands in rendered depth images, whose truth is known.

A scene says which gesture its hand holds; between two of them it says nothing, and nothing is scored. Nor is the time
in which nobody could know yet: just after a gesture began.
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
"""A gesture is scored from so long after its beginning on."""
CLOSED: Final = ("fist", "grab", "pinch")
"""Of the scenes' gestures those in which a hand holds on; in the others it does not."""


@dataclass
class GestureScores:
    """What gestures came to, summed over frames.

    Attributes:
        told: how often each gesture of the scenes was told as which; an empty name is none.
        grabbed: frames of gestures in which the hand is closed; grabbed_right: of these, with ``grabbing``.
        loose, loose_right: likewise of those in which it is not.
        begun: gestures that began, as the scenes have it.
        late_s: from their beginning until they were told, of those that were.
    """

    told: Counter[tuple[str, str]] = field(default_factory=Counter)
    grabbed: int = 0
    grabbed_right: int = 0
    loose: int = 0
    loose_right: int = 0
    begun: int = 0
    late_s: list[float] = field(default_factory=list)

    def add(self, other: GestureScores) -> None:
        """Take in another's."""
        self.told.update(other.told)
        self.late_s.extend(other.late_s)
        for name in ("grabbed", "grabbed_right", "loose", "loose_right", "begun"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def table(self) -> dict[str, float]:
        """Parts of 1: of each gesture, how often it is told; how often another is; how often grabbing is right."""

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
    """Run a detector that tells gestures (`mocapella.detectors.make_detector`) over the shots of one scene."""
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
