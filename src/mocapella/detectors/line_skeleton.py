"""Registers the detector ``line-skeleton``: arms in depth images, by thinning the silhouette to lines.

The implementation is `mocapella.sensing.line_skeleton`, which is imported only when the detector is made.
`docs/detectors/line-skeleton.md` describes the method.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.detector import ArmDetector, Detector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.model.camera import Camera
    from mocapella.sensing.line_skeleton import LineSkeleton


def _settings() -> type[Any]:
    from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings

    return LineSkeletonSettings


def _make(camera: Camera, settings: Any) -> ArmDetector:
    from mocapella.sensing.line_skeleton import LineSkeleton

    return LineSkeleton(camera, settings)


def _stages(made: LineSkeleton, depth: NDArray[np.float32]) -> Mapping[str, NDArray[np.uint8]]:
    return made.stages(depth)


LINE_SKELETON: Final = Detector(
    interface=1,
    name="line-skeleton",
    summary="Finds one right arm by the image processing of 2012; a baseline to compare with.",
    frame_type="arms",
    settings=_settings,
    make=_make,
    stages=_stages,
)
