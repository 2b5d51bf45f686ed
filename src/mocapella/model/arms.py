"""Observations of arms and hands by one depth camera."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.hand import LANDMARKS, TIPS, WRIST
from mocapella.model.sensor_frame import SensorFrame

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

ARM_POINTS: Final = (*LANDMARKS, "palm", "elbow")
"""The hand's 21 landmarks, the centre of the palm and the elbow."""
PALM: Final = len(LANDMARKS)
ELBOW: Final = PALM + 1
ARM_JOINTS: Final = (ELBOW, WRIST, PALM, *TIPS)
"""Indices in `ARM_POINTS` of an arm's eight joints: elbow, wrist, palm, thumb tip … little fingertip."""
ARM_JOINT_NAMES: Final = tuple(ARM_POINTS[k] for k in ARM_JOINTS)
ARM_BONES: Final = ((0, 1), (1, 2), *((2, k) for k in range(3, 8)))
"""Bones, as pairs of positions in `ARM_JOINTS`: from elbow to wrist, wrist to palm, palm to each fingertip."""


class SeenArm(msgspec.Struct, frozen=True, eq=False):
    """An arm in the camera frame: x right, y down, z out of the lens.

    The centre of the palm is halfway between the wrist and the knuckle of the middle finger.

    Attributes:
        id: constant for as long as the camera's detector tracks the arm.
        left: whether it is a left arm.
        left_sure: probability that ``left`` is correct, from 0.5 (a guess) to 1.
        points: (23, 3) in the order of `ARM_POINTS` [m]; NaN where not known.
        states: (23,) `JointState`: 2 measured in this image, 1 inferred, 0 not known.
        sd: (23,) standard deviation of a coordinate [m]; NaN where not known.
        angles: (21,) angles in the order of `mocapella.model.hand.ANGLES` [rad]; NaN if the detector has none.
        T_camera_palm: (4, 4) from the palm's frame, see `mocapella.model.hand`, to the camera frame; None if the
            detector has none.
        gesture: its name, such as open or fist; empty if none is recognised.
        gesture_sure: confidence of the gesture, from 0 to 1.
        grabbing: whether the hand holds on to something.
    """

    id: int
    left: bool
    left_sure: float
    points: Float64
    states: UInt8
    sd: Float32
    angles: Float64
    T_camera_palm: Float64 | None = None
    gesture: str = ""
    gesture_sure: float = 0.0
    grabbing: bool = False

    @property
    def joints(self) -> Float64:
        """(8, 3) positions of `ARM_JOINTS` in the camera frame [m]."""
        return self.points[list(ARM_JOINTS)]

    @property
    def joint_states(self) -> UInt8:
        """(8,) tracking states, `JointState`, of elbow, wrist, palm and fingertips, in the order of `ARM_JOINTS`."""
        return self.states[list(ARM_JOINTS)]


class SeenArms(msgspec.Struct, frozen=True, eq=False):
    """The arms that a detector found in one image.

    Attributes:
        arms: in the order of their ids.
        reason: why there is none, or a warning about the image, in a sentence; empty if there is neither.
    """

    arms: tuple[SeenArm, ...]
    reason: str = ""


class ArmFrame(SensorFrame, frozen=True, eq=False):
    """The arms that one depth camera saw at one instant.

    Attributes:
        size_px: (width, height) of the depth image.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        method: name of the detector.
        arms: the arms, in the order of their ids.
        reason: why no arm was detected, or a warning about the image; empty if there is neither.
    """

    size_px: tuple[int, int]
    lens: Float64
    method: str
    arms: tuple[SeenArm, ...]
    reason: str = ""

    @property
    def bodies(self) -> int:
        """Number of arms, which the sensor table shows."""
        return len(self.arms)
