"""Registers the detector ``angular-segments``, one of the two ways of 2012 to find fingers that were given up then.

The implementation is `mocapella.sensing.palm_segments`, which is imported only when the detector is made.
`docs/detectors/angular-segments.md` describes the method.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.detector import ArmDetector, Detector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.model.camera import Camera
    from mocapella.sensing.palm_segments import PalmSegments


def _settings() -> type[Any]:
    from mocapella.sensing.palm_segments import PalmSegmentsSettings

    return PalmSegmentsSettings


def _make(camera: Camera, settings: Any) -> ArmDetector:
    from mocapella.sensing.palm_segments import PalmSegments

    return PalmSegments(camera, settings)


def _stages(made: PalmSegments, depth: NDArray[np.float32]) -> Mapping[str, NDArray[np.uint8]]:
    return made.stages(depth)


ANGULAR_SEGMENTS: Final = Detector(
    interface=1,
    name="angular-segments",
    summary="Finds one right arm; its fingertips are the farthest points in angular segments around the palm (2012).",
    frame_type="arms",
    settings=_settings,
    make=_make,
    stages=_stages,
)
