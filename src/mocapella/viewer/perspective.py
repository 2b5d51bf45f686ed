"""Transform people and frames into the perspective of one sensor, with a level floor.

The *stage* is a frame with y up and the floor at y = 0. The *perspective* is a sensor's name, whose camera frame
is levelled and shown on the stage, or `FREE`.

Most methods estimate one pose per sensor in one shared world, which each sensor's perspective shows from that pose. The
method ``stand-still`` centres every person on itself, so all people stand at the same place in its world. In a sensor's
perspective, each person is therefore transformed by the calibration of *that sensor's view of that person*, and stands
where the sensor saw it.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.model.scene import Person, Scene
from mocapella.model.session import SensorPose

Float64 = NDArray[np.float64]

FREE = "free"
"""Name of the perspective that shows the tracker's world frame instead of a sensor's camera frame."""
_FLOOR_MEMORY = 0.05
_ANOTHER_WORLD_M, _ANOTHER_WORLD_RAD = 0.1, np.radians(3.0)
"""If all sensors move farther than this between two scenes [m, rad], the world frame has changed."""


class OnFloor(Protocol):
    """Interface of a frame that serves to estimate the sensor's height above the floor."""

    @property
    def sensor(self) -> str:
        """The sensor's name."""

    @property
    def tilt(self) -> float:
        """Tilt of the sensor, upwards positive [rad]."""

    @property
    def height(self) -> float:
        """Height of the sensor above the floor [m]; 0 if unknown."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """Positions (..., 3) of people's joints in camera space [m]."""


@dataclass(frozen=True, eq=False)
class StageSpace:
    """Pose of the world on the stage in the `FREE` perspective, as a scene's parts define it.

    Attributes:
        T_stage_world: (4, 4) transform from the world to the stage [m].
        tall_m: initial height of the parts above the floor [m].
        half_wide_m: initial largest distance of the parts from the stage's centre along x [m].
    """

    T_stage_world: Float64
    tall_m: float
    half_wide_m: float


def level(tilt: float, height: float) -> Float64:
    """Return the pose T_stage_sensor (4, 4) of a sensor with an upward tilt [rad] at a height above the floor [m]."""
    return rigid(rotation_about_x(-tilt), (0.0, height, 0.0))


def upright(T_world_sensor: Float64, floor: float = 0.0) -> Float64:
    """Return the pose T_stage_sensor (4, 4) of a sensor on a stage whose origin is on the floor under the sensor.

    The stage's +z is the horizontal direction of the sensor's optical axis.

    Args:
        T_world_sensor: (4, 4) pose of the sensor in a world with y up [m].
        floor: height of the world's origin above the floor [m].
    """
    R, (_, y, _) = T_world_sensor[:3, :3], T_world_sensor[:3, 3]
    return rigid(rotation_about_y(-np.arctan2(R[0, 2], R[2, 2])) @ R, (0.0, y + floor, 0.0))


class Floors:
    """Estimates each sensor's tilt and height above the floor, and the height of the world's origin.

    They are taken from the calibrated pose, else from the setup or the frame. If no height is known, the floor moves
    slowly under the lowest visible joint, so that an outlier does not shake it.
    """

    def __init__(self) -> None:
        self._places: dict[str, Float64] = {}
        self._heights: dict[str, float] = {}
        self._tilts: dict[str, float] = {}

    def learn_frame(self, frame: OnFloor, pose: SensorPose | None = None) -> None:
        """Update a sensor's tilt and height from the setup, or else from its newest frame.

        If that height is not above 0, it is unknown, and the floor follows the lowest of the frame's positions; it
        stays if all of them are NaN.

        Args:
            frame: the frame, with the sensor's name.
            pose: tilt and height from the setup, which replace both of the frame's; None if not configured.
        """
        tilt, height = (frame.tilt, frame.height) if pose is None else (pose.tilt, pose.height)
        self._tilts[frame.sensor] = tilt
        if height > 0:
            self._heights[frame.sensor] = height
        else:
            self._learn_lowest(frame.sensor, apply(level(tilt, 0.0), frame.positions))

    def learn_scene(self, scene: Scene, space: StageSpace | None = None) -> None:
        """Update the height of the world's origin above the floor, and the sensors' poses, which replace earlier ones.

        The height is 0 if the parts define the world's pose, or if sensors' poses are known and none is at the world's
        origin. Else it follows the lowest joint of the people.

        Args:
            scene: the newest scene.
            space: pose of the world on the stage; None if the scene's parts define none.
        """
        self._places = places_of(scene)
        if space is not None:
            self._places = {name: space.T_stage_world @ T for name, T in self._places.items()}
            self._heights[FREE] = 0.0
        elif self._places and not any(np.allclose(T, np.eye(4), atol=1e-9) for T in self._places.values()):
            self._heights[FREE] = 0.0  # a world whose origin is no sensor has the floor at 0
        elif scene.people:
            self._learn_lowest(FREE, np.concatenate([person.positions for person in scene.people]))

    def height(self, perspective: str) -> float:
        """Return the height of a sensor, or for `FREE` of the world's origin, above the floor [m]; 0 if unknown."""
        if perspective in self._places:
            return float(self._places[perspective][1, 3]) + self._heights.get(FREE, 0.0)
        return self._heights.get(perspective, 0.0)

    def tilt(self, perspective: str) -> float:
        """Return the tilt of a sensor, upwards positive [rad]; 0 for `FREE`, and if unknown."""
        if perspective in self._places:
            return float(np.arcsin(np.clip(self._places[perspective][1, 2], -1.0, 1.0)))
        return self._tilts.get(perspective, 0.0)

    def level(self, perspective: str) -> Float64:
        """Return the transform T_stage_perspective (4, 4) from the perspective's camera frame to the stage [m].

        For `FREE`, it is the transform from the world.
        """
        if perspective in self._places:
            return upright(self._places[perspective], self._heights.get(FREE, 0.0))
        return level(self.tilt(perspective), self.height(perspective))

    def _learn_lowest(self, perspective: str, positions: Float64) -> None:
        heights = positions[..., 1]
        if not np.isfinite(heights).any():
            return
        now = -float(np.nanmin(heights))
        before = self._heights.get(perspective, now)
        self._heights[perspective] = before + _FLOOR_MEMORY * (now - before)


def places_of(scene: Scene) -> dict[str, Float64]:
    """Return the pose T_world_sensor (4, 4) of every sensor of a scene with a known pose, by name."""
    return {place.sensor: place.T_world_sensor for place in scene.sensors if place.T_world_sensor is not None}


class Perspectives:
    """Remembers the last known poses of the sensors and of each person's views, so that people stay if a view is lost.

    Attributes:
        places: last known pose T_world_sensor (4, 4) of every sensor of the session, by name.
        world: number of the world frame; it grows by one when the frame changes, which invalidates remembered
            positions.
        T_free_world: (4, 4) transform from the world to the `FREE` perspective.
    """

    def __init__(self) -> None:
        self.places: dict[str, Float64] = {}
        self.world = 0
        self.T_free_world = np.eye(4)
        self._step = -1
        self._newest: dict[str, Float64] = {}
        self._T_world_sensor: dict[tuple[int, str], Float64] = {}

    def copy(self) -> Perspectives:
        """Return a copy that later calls of `learn` do not change."""
        return copy.copy(self)  # its mappings are replaced, never changed

    def learn(self, scene: Scene, space: StageSpace | None = None) -> None:
        """Update the poses of the sensors and of people's views; forget people and sensors that the scene lacks.

        If the step number falls, or every sensor's pose changes by 10 cm or 3°, `world` grows and `places` keeps only
        the scene's poses. In a scene without sensors' poses, `world` also grows if all of a person's views change so.

        Args:
            scene: the newest scene.
            space: gives `T_free_world`; None if the scene's parts define none, then it is the identity.
        """
        self.T_free_world = np.eye(4) if space is None else space.T_stage_world
        now = places_of(scene)
        if scene.step < self._step or _laid_anew(self._newest, now):
            self.places = {}
            self.world += 1
        self._step, self._newest = scene.step, now
        here = {place.sensor for place in scene.sensors}
        self.places = {name: T for name, T in (self.places | now).items() if name in here}
        people = {person.id for person in scene.people}
        before = {key: T for key, T in self._T_world_sensor.items() if key[0] in people}
        views = {(person.id, view.sensor): view.T_world_sensor for person in scene.people for view in person.views}
        seen_again = {who for who, sensor in before.keys() & views.keys()}
        if not now and any(_laid_anew(_of(who, before), _of(who, views)) for who in seen_again):
            self.world += 1  # the method has a world for each person
        self._T_world_sensor = before | views

    def from_world(self, person: Person, perspective: str) -> Float64 | None:
        """Return the transform (4, 4) from a person's world to the perspective's camera space.

        For `FREE`, it is `T_free_world`. None if the perspective's sensor has no known pose and never saw the person.
        The method ``stand-still`` has a separate world for each person.
        """
        if perspective == FREE:
            return self.T_free_world
        T = self.places.get(perspective, self._T_world_sensor.get((person.id, perspective)))
        return None if T is None else inverse(T)

    def from_shared_world(self, perspective: str) -> Float64 | None:
        """Return the transform (4, 4) from the world to the perspective's camera space; None without a sensor pose.

        For `FREE`, it is `T_free_world`.
        """
        if perspective == FREE:
            return self.T_free_world
        T = self.places.get(perspective)
        return None if T is None else inverse(T)


def _of(who: int, views: Mapping[tuple[int, str], Float64]) -> dict[str, Float64]:
    return {sensor: T for (person, sensor), T in views.items() if person == who}


def _laid_anew(before: Mapping[str, Float64], now: Mapping[str, Float64]) -> bool:
    """Whether every sensor's pose changed; if a single sensor was moved, the others' poses stay."""
    if not before or not now:
        return False
    return not any(_near(T, now[name]) for name, T in before.items() if name in now)


def _near(a: Float64, b: Float64) -> bool:
    if np.array_equal(a, b):
        return True
    turn = np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1.0, 1.0))
    return bool(np.linalg.norm(a[:3, 3] - b[:3, 3]) < _ANOTHER_WORLD_M and turn < _ANOTHER_WORLD_RAD)
