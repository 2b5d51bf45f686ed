"""Detectors: they convert the images of one camera to observations, without a clock, thread, file or socket.

`DETECTORS` lists them by name. A tracker (`mocapella.tracker`) turns their observations into scenes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.detector import ArmDetector, Detector
from mocapella.errors import SettingsError, one_of
from mocapella.registry import Table

if TYPE_CHECKING:
    from mocapella.detectors.arm_gestures import WithGestures
    from mocapella.model.camera import Camera

__all__ = [
    "DETECTORS",
    "NEVER_INDEPENDENT_S",
    "RENAMED",
    "ArmDetector",
    "Detector",
    "arm_detector",
    "arm_detectors",
    "detectors_of",
    "make_detector",
]

DETECTORS: Final = Table("mocapella.detectors", Detector, "detector")
"""Descriptors of all detectors, by name."""
RENAMED: Final[Mapping[str, str]] = {"default": "kinematic-arm"}
"""The present names of detectors, by former name."""
NEVER_INDEPENDENT_S: Final = 3600.0
"""Value of the setting ``independent_s`` for which all images are a video."""


def arm_detectors() -> dict[str, Detector]:
    """Return the descriptors of the detectors that find arms in depth images, by name."""
    return detectors_of("arms")


def detectors_of(frame_type: str) -> dict[str, Detector]:
    """Return the descriptors of the detectors that make frames of a type, such as ``arms``, by name."""
    return {name: detector for name, detector in DETECTORS.items() if detector.frame_type == frame_type}


def arm_detector(name: str) -> Detector:
    """Return the descriptor of the arm detector of that name.

    Raises:
        SettingsError: there is none; names the detector's present name if it was renamed, or lists the known ones.
    """
    known = arm_detectors()
    if name in known:
        return known[name]
    if name in RENAMED:
        raise SettingsError(f"the detector {name!r} is called {RENAMED[name]} now")
    raise SettingsError(f"unknown arm detector {name!r}; known: {one_of(name, known)}")


def make_detector(
    name: str, camera: Camera, settings: Mapping[str, Any] | None = None, *, independent_s: float | None = None
) -> WithGestures:
    """Make a detector of arms, with their gestures, for the depth images of one camera.

    The nodes of depth cameras and the ``arm`` commands make their detectors by this function.

    Args:
        name: one of the names in `arm_detectors()`.
        camera: size and lens of the depth camera.
        settings: the detector's own settings by name, and ``gestures``, a mapping of settings by the names of
            `mocapella.kinematics.gestures.GestureSettings`; missing ones take their defaults, as do
            all if None. It is not changed.
        independent_s: default of the setting ``independent_s`` of detectors that have it [s]; None for their own.

    Returns:
        An `ArmDetector` that adds gestures to its arms. It remembers earlier images, so each camera needs its own.

    Raises:
        SettingsError: no such detector, an unknown setting, or one out of range; names valid ones.
    """
    from mocapella.detectors.arm_gestures import WithGestures
    from mocapella.kinematics.gestures import GestureSettings
    from mocapella.settings import parse

    detector, own = arm_detector(name), dict(settings or {})
    if independent_s is not None and hasattr(detector.settings(), "independent_s"):
        own.setdefault("independent_s", independent_s)
    gestures = parse(GestureSettings, own.pop("gestures", {}), where=f"settings of {name}, gestures")
    made: ArmDetector = detector.make(camera, parse(detector.settings(), own, where=f"settings of {name}"))
    return WithGestures(made, gestures, detector.stages)
