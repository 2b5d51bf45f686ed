"""Misdetections of `kinematic-arm` in the scene of ``mocapella demo arm``, with ground truth and without.

With it, a joint has jumped where its error changed by more than 5 cm between two images. Without it, as users see it
(`kinematics.arm_quality`), where it was faster than a finger can be. Seeds below 100 were used to choose numbers.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Final

import numpy as np

from benchmarks.harness import Row, at_most, measured
from mocapella.detectors import make_detector
from mocapella.evaluation.arms import LIMITS, ArmScores, score
from mocapella.kinematics.arm_quality import ArmQualityMeter, misdetected
from mocapella.model.arm_quality import Misdetections
from mocapella.model.arms import ARM_JOINTS, SeenArms
from mocapella.model.camera import Camera
from mocapella.sources.simulate.depth_scene import DepthShot, load_depth_scene

SCENE, SENSOR = "cloth", "kinect"
FPS: Final = 30.0
SEEDS: Final = (100, 101, 102)
SECONDS: Final = 21.0
"""Of each seed: twice the scene's keys."""
MOST_PER_MINUTE: Final = 2.0


class _Metered:
    """The detector, whose arms a meter sees, too."""

    name = "kinematic-arm"

    def __init__(self, camera: Camera) -> None:
        self.detector, self.meter = make_detector(self.name, camera), ArmQualityMeter()

    def update(self, depth: np.ndarray, at_s: float) -> SeenArms:
        seen = self.detector.update(depth, at_s)
        self.meter.update(seen.arms, at_s)
        return seen

    def reset(self) -> None:
        self.detector.reset()
        self.meter.reset()


def run(quick: bool = False) -> list[Row]:
    scores, found, true, seen_s, all_s = ArmScores(), Misdetections(), Misdetections(), 0.0, 0.0
    for seed in SEEDS[: 1 if quick else None]:
        print(f"arm_misdetections: seed {seed}", file=sys.stderr, flush=True)
        scene = load_depth_scene(SCENE, seed=seed, sensor=SENSOR)
        detector = _Metered(Camera(SENSOR, scene.sensor.size_px, scene.lens))
        shots = list(scene.frames(FPS, 0.0, 1.0 if quick else SECONDS))
        scores.add(score(detector, shots))
        found, seen_s = found.plus(detector.meter.quality.whole), seen_s + detector.meter.quality.seen_s
        true, all_s = true.plus(moves_of(shots)), all_s + shots[-1].at_s - shots[0].at_s
    table = scores.table()
    return [
        measured("arm_misdetections: a minute, by ground truth", table["misdetections_per_minute"], "",
                 goal=at_most(MOST_PER_MINUTE)),
        measured("arm_misdetections: a minute, without ground truth", 60 * found.of_joints / seen_s, "",
                 goal=at_most(MOST_PER_MINUTE)),
        measured("arm_misdetections: true joints that come 5 cm far between two images, a minute",
                 60 * true.of_joints / all_s, ""),
        measured("arm_misdetections: fingertips, 95 %", table["tip_p95_mm"], "mm"),
        measured("arm_misdetections: arms followed", 100 * table["followed"], "%"),
    ]  # fmt: skip


def moves_of(shots: list[DepthShot]) -> Misdetections:
    """What a count from image to image takes for misdetections, of the true arms."""
    joints = [shot.arms[0].points[list(ARM_JOINTS)] for shot in shots]
    found = Misdetections()
    for before, now in pairwise(joints):
        found = found.plus(misdetected(before, now, LIMITS.jump_m))
    return found
