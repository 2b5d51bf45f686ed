"""A detector for tests of what is around one: all points of its arm are where the nearest pixel is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocapella.detectors import DETECTORS, Detector
from mocapella.geometry.lens import undistort
from mocapella.model.arms import ARM_POINTS, ELBOW, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import ANGLES


@dataclass(frozen=True)
class NearestArmSettings:
    a: dict[str, int] = field(default_factory=dict)


class NearestArm:
    """A `mocapella.detectors.ArmDetector`. The elbow is not known, and the wrist inferred."""

    name = "nearest"

    def __init__(self, camera: Camera, settings: NearestArmSettings | None = None) -> None:
        self.camera, self.settings = camera, settings or NearestArmSettings()
        self.times: list[float] = []

    def update(self, depth: np.ndarray, at_s: float) -> SeenArms:
        assert depth.dtype == np.float32
        self.times.append(at_s)
        if not depth.any():
            return SeenArms(())
        y, x = np.unravel_index(np.where(depth > 0, depth, np.inf).argmin(), depth.shape)
        point = np.array([*undistort([x, y], self.camera.lens), 1.0]) * depth[y, x]
        points, states = np.tile(point, (len(ARM_POINTS), 1)), np.full(len(ARM_POINTS), 2, np.uint8)
        sd = np.full(len(ARM_POINTS), 0.01, np.float32)
        points[ELBOW], states[ELBOW], sd[ELBOW] = np.nan, 0, np.nan
        states[0] = 1
        left = bool(depth[y, x] < 0.705)
        arm = SeenArm(7, left, 0.9, points, states, sd, np.full(len(ANGLES), np.nan), None, "open", 0.8, left)
        return SeenArms((arm,), "" if depth.all() else "there are holes")

    def reset(self) -> None:
        self.times.clear()

    def stages(self, depth: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"8 bit": (depth * 100).astype(np.uint8), "colours": np.zeros((*depth.shape, 3), np.uint8)}


def _stages(made: NearestArm, depth: np.ndarray) -> Mapping[str, Any]:
    return made.stages(depth)


NEAREST = Detector(1, "nearest", "For tests.", "arms", lambda: NearestArmSettings, NearestArm, _stages)


def main() -> None:
    """The command line, with this detector in it."""
    from mocapella.cli import main as mocapella

    DETECTORS["nearest"] = NEAREST
    mocapella()


if __name__ == "__main__":
    main()
