"""Depth cameras through their makers' packages or libraries; one is imported only when such a camera is opened."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mocapella.sources.depth_cameras.device import DepthDevice

CAMERAS: Final = {
    "openni": ("openni", "OpenNiCamera", "0"),
    "freenect": ("freenect", "FreenectCamera", "0"),
    "freenect2": ("freenect2", "Freenect2Camera", "0"),
    "realsense": ("realsense", "RealSenseCamera", ""),
    "orbbec": ("orbbec", "OrbbecCamera", "0"),
    "oak": ("oak", "OakCamera", "0"),
    "k4a": ("k4a", "K4aCamera", "0"),
}
"""Module, class and default camera, by the kind of camera, which precedes the colon in a source's name."""


def camera_class(kind: str) -> type[DepthDevice]:
    """Return the class of a kind of camera, a key of `CAMERAS`; the driver's package is not imported.

    Raises:
        KeyError: unknown kind.
    """
    module, name, _ = CAMERAS[kind]
    found: type[DepthDevice] = getattr(import_module(f"{__name__}.{module}"), name)
    return found
