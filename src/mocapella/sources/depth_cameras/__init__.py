"""Depth cameras through the packages of their makers, each of which is imported when such a camera is opened."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mocapella.sources.depth_cameras.device import DepthDevice

CAMERAS: Final = {
    "openni": ("openni", "OpenNiCamera", "0"),
    "freenect": ("freenect", "FreenectCamera", "0"),
    "realsense": ("realsense", "RealSenseCamera", ""),
    "orbbec": ("orbbec", "OrbbecCamera", "0"),
}
"""By the word before the colon: module, class, and which camera where nothing comes after it."""


def camera_class(kind: str) -> type[DepthDevice]:
    """What a camera of one of `CAMERAS` is opened by; its package is not imported yet."""
    module, name, _ = CAMERAS[kind]
    found: type[DepthDevice] = getattr(import_module(f"{__name__}.{module}"), name)
    return found
