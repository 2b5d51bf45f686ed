"""Registers the detector ``kinematic-arm``: arms in depth images, by fitting a kinematic model to the points.

The implementation is `mocapella.detectors.arm_following`, which is imported only when the detector is made.
`docs/detectors/kinematic-arm.md` describes the method.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.detector import ArmDetector, Detector

if TYPE_CHECKING:
    from mocapella.model.camera import Camera


def _settings() -> type[Any]:
    from mocapella.detectors.arm_settings import KinematicArmSettings

    return KinematicArmSettings


def _make(camera: Camera, settings: Any) -> ArmDetector:
    from mocapella.detectors.arm_following import KinematicArmDetector

    return KinematicArmDetector(camera, settings)


KINEMATIC_ARM: Final = Detector(
    interface=1,
    name="kinematic-arm",
    summary="Fits a kinematic arm and hand to the points of each depth image, and follows them.",
    frame_type="arms",
    settings=_settings,
    make=_make,
)
