"""Interfaces, besides `mocapella.tracker.Tracker`, of trackers that can be scored on the study logs.

Study logs have no ground truth, so a method is scored by how well its sensor poses align two sensors' views. It must
therefore report poses, clock offsets, label swaps and its joint bias.
"""

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
"""Largest deviation of an element of Rᵀ R from the identity, for a motion's rotation."""


class JointBias(Protocol):
    """Interface of a function that returns the correction to add to the joints of one view; learnt on other people.

    Its arguments describe the fused person only, so it cannot depend on the difference of the two views.
    """

    def __call__(self, sensor: str, facing: float, position: Float64, velocity: Float64) -> Float64:
        """Return the correction to add to the joints of a view.

        Args:
            sensor: name of the view's sensor.
            facing: yaw of the fused person against the line of sight; 0 = towards the sensor [rad].
            position: (3,) position of the fused SpineBase, this sensor's camera space [m].
            velocity: (3,) velocity of the same joint over the last 0.2 s, in the same space [m/s].

        Returns:
            (joints, 3), this sensor's camera space [m].
        """


@runtime_checkable
class ScoredTracker(Protocol):
    """Interface of a tracker that reports its estimates of the sensors after every frame."""

    @property
    def joint_bias(self) -> JointBias | None:
        """The joint bias, None without one; the scoring reads it once, before the first frame."""

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Start from poses T_world_sensor (4, 4), known before the first frame; a method may ignore them."""

    def update(self, arrival: Arrival) -> Scene:
        """Process one frame, in the order of arrival, and return the scene (`mocapella.tracker.protocol.Tracker`)."""

    def sensor_views(self) -> SensorViews:
        """Return the present estimates of the sensors' poses, clock offsets and label swaps."""


@runtime_checkable
class LearntFromStudies(Protocol):
    """Interface of a tracker with a model that was trained on the logs on which the tracker may be scored."""

    def leave_out(self, participant: int) -> None:
        """Use the model that was trained without this participant; called before the first frame.

        Raises:
            SettingsError: there is no model without this participant.
        """


def check_rigid(T: Float64, what: str) -> Float64:
    """Check a rigid motion and return a float64 copy.

    Args:
        T: (4, 4) the motion.
        what: name of the motion, for the error's message.

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
