"""Motion of a simulated hand: a sequence of postures within the joint limits, and a path through space.

The landmarks are computed from rotations, joint by joint. They share only the hand's description with the estimator's
chain of twists, so that estimates can be tested against them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y
from mocapella.model.hand import BASES, DIGIT_ANGLES, LANDMARKS, HandModel, HandPose, HandShape
from mocapella.settings import check

Float64 = NDArray[np.float64]

UPRIGHT: Final = np.stack([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], axis=-1)
"""``R_world_palm`` of a hand whose fingers point up, with the palm towards a viewer who looks along −z."""


@dataclass(frozen=True)
class HandMotionSettings:
    """Parameters of the hand's motion.

    Attributes:
        centre_m: centre of the motion in the world [m].
        travel_m: amplitude of the translation along x, y, z [m].
        travel_hz: frequency of the translation [Hz].
        turn_deg: amplitude of the rotation about the world's x, y and z, from upright [deg].
        posture_s: time from one posture to the next [s].
        bend: range of the flexions, from 0 (a hand at rest) to 1 (all within the joint limits).
        spread: range of the abductions, from 0 (a hand at rest) to 1 (all within the joint limits).

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    travel_m: tuple[float, float, float] = (0.08, 0.05, 0.06)
    travel_hz: float = 0.4
    turn_deg: tuple[float, float, float] = (20.0, 15.0, 25.0)
    posture_s: float = 0.8
    bend: float = 0.6
    spread: float = 0.7

    def __post_init__(self) -> None:
        check(all(abs(c) <= 10 for c in self.centre_m), "centre_m", self.centre_m, "within 10 m")
        check(all(0 <= t <= 5 for t in self.travel_m), "travel_m", self.travel_m, "from 0 to 5 m")
        check(0 <= self.travel_hz <= 10, "travel_hz", self.travel_hz, "from 0 to 10 Hz")
        check(all(0 <= t <= 180 for t in self.turn_deg), "turn_deg", self.turn_deg, "from 0 to 180")
        check(0.05 <= self.posture_s <= 60, "posture_s", self.posture_s, "from 0.05 to 60 s")
        check(0 <= self.bend <= 1, "bend", self.bend, "from 0 to 1")
        check(0 <= self.spread <= 1, "spread", self.spread, "from 0 to 1")


class HandMotion:
    """A hand's pose at any time; the same seed gives the same motion.

    Args:
        model: model of the hand's joints, with the joint limits.
        shape: the hand's bones.
        settings: parameters of the motion.
        seed: random seed of the postures and of the path.
    """

    def __init__(self, model: HandModel, shape: HandShape, settings: HandMotionSettings, seed: int = 0) -> None:
        self.model, self.shape, self.settings, self.seed = model, shape, settings, seed
        rng = np.random.default_rng([seed, 11])
        self._phases = rng.uniform(0, 2 * math.pi, 6)
        self._rates = rng.uniform(0.8, 1.25, 6)

    def at(self, at_s: float) -> HandPose:
        """Return the hand's pose at a time of the scene [s]."""
        s = self.settings
        swing = np.sin(2 * math.pi * s.travel_hz * self._rates * at_s + self._phases)
        x, y, z = np.radians(s.turn_deg) * swing[3:]
        R = rotation_about_y(y) @ rotation_about_x(x) @ _about_z(z) @ UPRIGHT
        T = rigid(R, np.array(s.centre_m) + np.array(s.travel_m) * swing[:3])
        # The palm's origin is the wrist; the middle of the hand moves around the centre.
        T[:3, 3] -= R @ [0.0, 0.0, 0.55 * float(self.shape.bases[2, 2] + self.shape.lengths[2].sum())]
        return HandPose(self.angles(at_s), T)

    def angles(self, at_s: float) -> Float64:
        """Return the angles (21,) of `mocapella.model.hand.ANGLES` at a time of the scene [s], in radians.

        Between postures, motion has minimum jerk (T. Flash, N. Hogan, 1985).
        """
        k, u = divmod(at_s / self.settings.posture_s, 1.0)
        part = u**3 * (10 - 15 * u + 6 * u * u)
        before, after = self._posture(int(k)), self._posture(int(k) + 1)
        return self.model.limited(before + part * (after - before))

    def _posture(self, k: int) -> Float64:
        rng, s, model = np.random.default_rng([self.seed, 12, k + 1_000_000]), self.settings, self.model
        least, most = model.limits[:, 0], model.limits[:, 1]
        free = rng.uniform(least, most)
        closed = rng.uniform(0, 1)  # fingers mostly bend together
        for row in DIGIT_ANGLES[1:]:
            for angle in (row[0], row[2]):
                free[angle] = least[angle] + (most[angle] - least[angle]) * np.clip(closed + rng.normal(0, 0.2), 0, 1)
        amount = np.full(len(free), s.bend)
        amount[DIGIT_ANGLES[:, 1]] = s.spread
        angles = model.natural + amount * (free - model.natural)
        for row, ratio in zip(DIGIT_ANGLES, model.coupling, strict=True):
            angles[row[3]] = ratio * angles[row[2]]
        return model.limited(angles)


def landmarks_of(model: HandModel, shape: HandShape, pose: HandPose) -> Float64:
    """Compute the landmarks (21, 3) of a hand, `mocapella.model.hand.LANDMARKS`, in the world [m].

    Args:
        model: model of the hand's joints.
        shape: the hand's bones and side; a left hand is mirrored.
        pose: angles, and pose of the palm in the world.
    """
    points = np.zeros((len(LANDMARKS), 3))
    for digit in range(5):
        R, point = model.frames[digit], np.array(shape.bases[digit])
        flexion, abduction, middle, last, second_abduction = DIGIT_ANGLES[digit]
        sideways = [abduction, second_abduction, -1]
        landmark = BASES[digit]
        points[landmark] = point
        for bone, bends in enumerate((flexion, middle, last)):
            if sideways[bone] >= 0:
                R = R @ rotation_about_y(pose.angles[sideways[bone]])
            R = R @ rotation_about_x(pose.angles[bends])
            point = point + shape.lengths[digit, bone] * R[:, 2]
            landmark += 1
            points[landmark] = point
    T = pose.T_world_palm
    return np.asarray((shape.mirror * points) @ T[:3, :3].T + T[:3, 3])


def _about_z(angle: float) -> Float64:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
