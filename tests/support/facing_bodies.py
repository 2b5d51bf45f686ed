"""Bodies as sensors show them, for the tests of facing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocapella.fusion.facing import FacingFilter, Facings
from mocapella.fusion.facing_shape import LEANS_FROM, ShapeClassifier, view_of
from mocapella.geometry.rigid import rotation_about_y
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
MIRROR = list(KINECT.mirror)
ACROSS_X = np.array([-1.0, 1.0, 1.0])
SENSORS = ("front", "side", "back")


@dataclass
class Frames:
    """What a few sensors say of a few people, frame by frame; every frame is of one sensor.

    Attributes:
        sensors: (frames,) names. at_s: (frames,).
        people: of every frame the same ones.
        positions: (frames, people, joints, 3). toward: (frames, people). velocities: (frames, people, 3).
    """

    sensors: list[str]
    at_s: np.ndarray
    people: list[int]
    positions: np.ndarray
    toward: np.ndarray
    velocities: np.ndarray

    def give(self, facings: FacingFilter, first: int = 0, last: int | None = None) -> list[Facings]:
        """What the filter says of the frames from ``first`` to before ``last``."""
        return [
            facings.update(
                self.sensors[k], self.people, self.positions[k], self.toward[k], self.at_s[k], self.velocities[k]
            )
            for k in range(len(self.at_s))[first:last]
        ]

    def turned(self, angle: float) -> Frames:
        """In a world in which every yaw is larger by the angle."""
        R = rotation_about_y(angle)
        return Frames(
            self.sensors, self.at_s, self.people, self.positions @ R.T, self.toward + angle, self.velocities @ R.T
        )


def frames_of(
    seed: int, frames: int = 12, people: int = 3, missing: float = 0.1, like: ShapeClassifier | None = None
) -> Frames:
    """People who turn and walk as they like, whose bodies are none that there is: laws hold of any.

    With ``like``, the head is hidden of bodies that lean or are unlike its training data, so that they have no shape.
    """
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(people, len(KINECT), 3)) * [0.2, 0.4, 0.2]
    positions = shape + 0.05 * rng.normal(size=(frames, *shape.shape))
    positions[rng.random(positions.shape[:-1]) < missing] = np.nan
    made = Frames(
        sensors=rng.choice(SENSORS, frames).tolist(),
        at_s=10.0 + np.cumsum(rng.choice([0.0, 0.008, 0.033, 0.1, 0.7], frames)),
        people=rng.choice(50, people, replace=False).tolist(),
        positions=positions,
        toward=rng.uniform(-np.pi, np.pi, (frames, people)),
        velocities=rng.normal(size=(frames, people, 3)) * rng.choice([0.1, 1.0]),
    )
    if like is not None:
        trunk = positions[..., KINECT.index("Head"), :] - positions[..., KINECT.index("SpineBase"), :]
        leans = np.hypot(trunk[..., 0], trunk[..., 2]) > np.tan(LEANS_FROM) * trunk[..., 1]
        unlike = leans | (like.unlike(view_of(positions, made.toward, KINECT).features) > 0)
        positions[unlike, KINECT.index("Head")] = np.nan
    return made
