"""What the view shows of arms beside the arms themselves: how good they are, and the cloth that they play with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.kinematics.arm_quality import ArmQualityMeter
from mocapella.model.scene import Scene
from mocapella.sources.simulate.cloth import ClothBeforeHand
from mocapella.viewer.arms import ArmsShown, centre_of

Float64 = NDArray[np.float64]

GONE_AFTER_S = 5.0
"""The arms' stage stays so long after the last arm."""


class ArmShow:
    """Takes in scenes as they come; a scene that was taken in already changes nothing.

    Args:
        cloth: whether there is one.
    """

    def __init__(self, cloth: bool = False) -> None:
        self._meter, self._cloth = ArmQualityMeter(), ClothBeforeHand() if cloth else None
        self._centre: Float64 | None = None
        self._scene: Scene | None = None
        self._seen_s = 0.0
        self._shown: ArmsShown | None = None

    def update(self, scene: Scene | None) -> ArmsShown | None:
        """What belongs to the newest scene; None where there are no arms and were none of late."""
        if scene is None or scene is self._scene:
            self._shown = None if scene is None else self._shown
            return self._shown
        self._scene, at_s = scene, scene.at_ns / NS_PER_S
        if scene.arms:
            self._seen_s = at_s
            self._centre = centre_of(scene.arms, self._centre)
        if self._centre is None or not 0 <= at_s - self._seen_s <= GONE_AFTER_S:
            self._centre = self._shown = None
            return None
        eye = next((place.T_world_sensor[:3, 3] for place in scene.sensors if place.T_world_sensor is not None), None)
        cloth = None if self._cloth is None else self._cloth.update(scene.arms, eye, at_s)
        quality = self._meter.update(scene.arms, at_s)
        grid = None if cloth is None else cloth.positions.reshape(*cloth.shape, 3).copy()
        self._shown = ArmsShown(self._centre, quality, grid)
        return self._shown
