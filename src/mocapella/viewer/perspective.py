"""People and frames as a sensor sees them, with its floor made level.

The ``stand-still`` method centres every person on itself, so that in its world all stand in one place. From a sensor's
perspective each person goes back through the calibration of *that sensor's view of that person* and stands where the
sensor saw it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import Person, Scene
from mocapella.model.session import SensorPose

Float64 = NDArray[np.float64]

FREE = "free"
"""The perspective that is no sensor's: the tracker's world as it is."""
_FLOOR_MEMORY = 0.05


def level(tilt: float, height: float) -> Float64:
    """(4, 4) T_stage_sensor: camera space of a sensor tilted up by ``tilt`` [rad], ``height`` [m] over a floor."""
    return rigid(rotation_about_x(-tilt), (0.0, height, 0.0))


class Floors:
    """How each sensor, and the free world's origin, stands over the floor.

    A height that was set up is taken as it is. Where none was, the floor is put under the lowest joint that is seen,
    slowly, so that a stray joint does not shake it.
    """

    def __init__(self) -> None:
        self._heights: dict[str, float] = {}
        self._tilts: dict[str, float] = {}

    def learn_frame(self, frame: BodyFrame, pose: SensorPose | None = None) -> None:
        """Learn of a sensor's frame; ``pose`` was set up for the sensor, and goes before what the frame says."""
        tilt, height = (frame.tilt, frame.height) if pose is None else (pose.tilt, pose.height)
        self._tilts[frame.sensor] = tilt
        if height > 0:
            self._heights[frame.sensor] = height
        else:
            self._learn_lowest(frame.sensor, apply(level(tilt, 0.0), frame.positions))

    def learn_scene(self, scene: Scene) -> None:
        """Learn of the free world."""
        if scene.people:
            self._learn_lowest(FREE, np.concatenate([person.positions for person in scene.people]))

    def height(self, perspective: str) -> float:
        """Of that sensor, or of the free world's origin, over the floor [m]; 0 where nothing is known."""
        return self._heights.get(perspective, 0.0)

    def tilt(self, perspective: str) -> float:
        """Of that sensor, upwards positive [rad]; 0 for the free world, and where nothing is known."""
        return self._tilts.get(perspective, 0.0)

    def level(self, perspective: str) -> Float64:
        """(4, 4) T_stage_perspective: to a stage whose floor is level and at y = 0."""
        return level(self.tilt(perspective), self.height(perspective))

    def _learn_lowest(self, perspective: str, positions: Float64) -> None:
        heights = positions[..., 1]
        if not np.isfinite(heights).any():
            return
        now = -float(np.nanmin(heights))
        before = self._heights.get(perspective, now)
        self._heights[perspective] = before + _FLOOR_MEMORY * (now - before)


class Perspectives:
    """From which motion each person was last seen by each sensor, so that a person does not jump when one loses it."""

    def __init__(self) -> None:
        self._T_world_sensor: dict[tuple[int, str], Float64] = {}

    def learn(self, scene: Scene) -> None:
        """Take up the scene's views, and forget those who are gone."""
        here = {person.id for person in scene.people}
        self._T_world_sensor = {key: T for key, T in self._T_world_sensor.items() if key[0] in here}
        for person in scene.people:
            for view in person.views:
                self._T_world_sensor[person.id, view.sensor] = view.T_world_sensor

    def from_world(self, person: Person, perspective: str) -> Float64 | None:
        """(4, 4), world to the perspective's camera space, or None where that sensor never saw the person."""
        if perspective == FREE:
            return np.eye(4)
        T = self._T_world_sensor.get((person.id, perspective))
        return None if T is None else inverse(T)
