"""What a tracker offers beside `mocapella.tracker.Tracker`, so that it can be scored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.tracker.protocol import SensorViews

Float64 = NDArray[np.float64]

RIGID_WITHIN = 1e-6
"""How far a motion's rotation may be from orthonormal, by any element of Rᵀ R."""


class JointBias(Protocol):
    """A view-dependent joint bias, learnt on other people and declared before the first frame.

    It is a function of the fused person only, so it cannot know by how much the two views differ.
    """

    def __call__(self, sensor: str, facing: float, position: Float64, velocity: Float64) -> Float64:
        """What to add to the joints of a view.

        Args:
            sensor: whose view.
            facing: yaw of the fused person against the line of sight; 0 = towards the sensor [rad].
            position: (3,) of the fused SpineBase, this sensor's camera space [m].
            velocity: (3,) of the same over the last 0.2 s [m/s].

        Returns:
            (joints, 3), this sensor's camera space [m].
        """


@runtime_checkable
class ScoredTracker(Protocol):
    """A tracker whose knowledge of the sensors can be asked for after every frame."""

    @property
    def joint_bias(self) -> JointBias | None:
        """Read once, before the first frame."""

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Begin from a sensor layout, known before the first frame; a method is free not to believe it."""

    def update(self, arrival: Arrival) -> Scene:
        """As `mocapella.tracker.Tracker` has it."""

    def sensor_views(self) -> SensorViews:
        """What is known now."""


@runtime_checkable
class LearntFromStudies(Protocol):
    """A tracker of which a part was learnt from the very logs it may be scored on."""

    def leave_out(self, participant: int) -> None:
        """Use what was learnt without this participant; called before the first frame.

        Raises:
            SettingsError: nothing was learnt without this one.
        """


def check_rigid(T: Float64, what: str) -> Float64:
    """A copy of the motion, once it is known to be one.

    Args:
        T: (4, 4).
        what: whose it is, for the message.

    Raises:
        EvaluationError: it is not finite, not rigid, or a reflection.
    """
    T = np.array(T, dtype=np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise EvaluationError(f"{what} is no (4, 4) matrix of finite numbers; leave an unknown sensor out")
    R = T[:3, :3]
    skew = float(np.abs(R.T @ R - np.eye(3)).max())
    if skew > RIGID_WITHIN or np.linalg.det(R) < 0 or (T[3] != (0, 0, 0, 1)).any():
        raise EvaluationError(f"{what} is no rigid motion (RᵀR is off by {skew:.1e}); scaling and shear are not scored")
    return T
