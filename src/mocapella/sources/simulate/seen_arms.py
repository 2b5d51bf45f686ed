"""A simulated arm detector of a given quality: ground truth plus noise, with hidden joints inferred.

It replaces a detector in tests of the later stages. Visible joints have an error that is independent from frame to
frame; hidden joints are inferred with an error that is correlated in time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.arms import ARM_POINTS, SeenArm, SeenArms
from mocapella.model.observations import JointState
from mocapella.settings import check
from mocapella.sources.simulate.depth_scene import DepthShot

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class SeenArmSettings:
    """Quality of the simulated arm detector `SimulatedArms`.

    Attributes:
        measured_sd_m: standard deviation of a visible joint's coordinate [m].
        inferred_sd_m: standard deviation of an inferred joint's coordinate [m].
        lasts_s: time constant of the errors of inferred joints [s].
        left_sure: reported confidence of the side, from 0.5 to 1.
        wrong_side: fraction of the frames with the wrong side, 0 to 1.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    measured_sd_m: float = 0.004
    inferred_sd_m: float = 0.02
    lasts_s: float = 0.5
    left_sure: float = 0.9
    wrong_side: float = 0.0

    def __post_init__(self) -> None:
        for name in ("measured_sd_m", "inferred_sd_m"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1 m")
        check(0 < self.lasts_s <= 60, "lasts_s", self.lasts_s, "above 0 and at most 60 s")
        check(0.5 <= self.left_sure <= 1, "left_sure", self.left_sure, "from 0.5 to 1")
        check(0 <= self.wrong_side <= 1, "wrong_side", self.wrong_side, "from 0 to 1")


class SimulatedArms:
    """Simulated detector of the arms in one camera's depth images: ground truth plus noise.

    The errors of hidden joints are correlated in time, so the images must come in the order of their times.

    Args:
        settings: quality of the detector; None for the defaults.
        seed: random seed of the errors.
    """

    def __init__(self, settings: SeenArmSettings | None = None, *, seed: int = 0) -> None:
        self.settings, self._seed = settings or SeenArmSettings(), seed
        self.reset()

    def reset(self) -> None:
        """Restart: the next images get the same random errors as the first ones did."""
        self._rng = np.random.default_rng(self._seed)
        self._lasting: dict[int, Float64] = {}
        self._at_s = -math.inf

    def look(self, shot: DepthShot) -> SeenArms:
        """Detect the arms in a simulated depth image; return their joints in the camera frame [m].

        An arm with neither wrist nor palm visible is not detected. A detected arm's angles and palm are exact.
        If no arm is detected, the result has no arms and a message.
        """
        s, rng = self.settings, self._rng
        keep = math.exp(-max(shot.at_s - self._at_s, 0.0) / s.lasts_s)
        self._at_s = shot.at_s
        arms = []
        for number, truth in enumerate(shot.arms):
            fresh = rng.normal(size=(len(ARM_POINTS), 3))
            lasting = keep * self._lasting.get(number, fresh) + math.sqrt(1.0 - keep * keep) * fresh
            self._lasting[number] = lasting
            wrong = bool(rng.random() < s.wrong_side)
            if not truth.seen[_NEEDED].any():
                continue
            sd = np.where(truth.seen, s.measured_sd_m, s.inferred_sd_m)
            noise = np.where(truth.seen[:, None], rng.normal(size=fresh.shape), lasting)
            states = np.where(truth.seen, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
            arms.append(
                SeenArm(
                    number, truth.left != wrong, s.left_sure, truth.points + sd[:, None] * noise, states,
                    sd.astype(np.float32), truth.angles, truth.T_camera_palm, truth.gesture,
                    0.8 if truth.gesture else 0.0,
                )
            )  # fmt: skip
        return SeenArms(tuple(arms), "" if arms else "no hand is seen")


_NEEDED: Final = [0, 21]
