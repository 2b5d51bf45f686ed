"""Registers the detector ``line-skeleton-3d``, one of the two ways of 2012 to find fingers that were given up then.

The implementation is `mocapella.sensing.skeleton_in_space`, which is imported only when the detector is made.
`docs/detectors/line-skeleton-3d.md` describes the method.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.detector import ArmDetector, Detector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.model.camera import Camera
    from mocapella.sensing.skeleton_in_space import SkeletonInSpace


def _settings() -> type[Any]:
    from mocapella.sensing.skeleton_in_space import SkeletonInSpaceSettings

    return SkeletonInSpaceSettings


def _make(camera: Camera, settings: Any) -> ArmDetector:
    from mocapella.sensing.skeleton_in_space import SkeletonInSpace

    return SkeletonInSpace(camera, settings)


def _stages(made: SkeletonInSpace, depth: NDArray[np.float32]) -> Mapping[str, NDArray[np.uint8]]:
    return made.stages(depth)


LINE_SKELETON_3D: Final = Detector(
    interface=1,
    name="line-skeleton-3d",
    summary="Finds one right arm; its fingertips are the ends of thin lines in space (2012).",
    frame_type="arms",
    settings=_settings,
    make=_make,
    stages=_stages,
)
