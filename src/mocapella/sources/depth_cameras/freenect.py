"""The Kinect v1 through libfreenect's own Python module.

``sync_get_depth(index, format)`` returns (depth (480, 640) uint16, time stamp), or None without a Kinect (libfreenect,
``wrappers/python/freenect.pyx``). ``DEPTH_MM`` is millimetres by the device's own calibration, ``DEPTH_11BIT`` its
disparities, which `mocapella.geometry.kinect_depth` converts to depths. The module does not give the lens: its focal
length is the infrared camera's nominal 120 mm at pixels of 2 · 0.1042 mm, which libfreenect's
``freenect_camera_to_world`` uses for images of 640 px. Stamps count a clock of 60 MHz with an unknown origin and
wrap-around, so capture times are the arrivals. With colour, ``DEPTH_REGISTERED`` is millimetres in the pixels of the
colour image, which ``sync_get_video(index, VIDEO_RGB)`` returns.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.geometry.kinect_depth import UNIT_M, kinect_units
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, bgr, none_there
from mocapella.sources.picture_source import ColourCamera, SourceState

FOCAL_PX: Final = 120.0 / (2 * 0.1042)
SIZE_PX: Final = (640, 480)
COLOUR_FOCAL_PX: Final = 525.0
"""Nominal focal length of the colour camera; that of one camera differs by some pixels [px]."""


class FreenectCamera(DepthDevice):
    """A Kinect v1 as a depth camera of 640 × 480 px and 30 Hz, selected by its number; arguments as in `DepthDevice`.

    Depths are in millimetres, by the device's own calibration. With the option ``kinect_raw`` they are computed from
    its raw disparities, in units of 0.125 mm.
    """

    packages = ("freenect",)
    install = "install libfreenect with its Python module (Debian: python3-freenect; freenect of the package index)"
    _first: Stamped | None = None

    def _start(self, package: Any) -> SourceState:
        self.times = "the monotonic clock, when an image was there"
        self._first = self._grab(package)
        if self._first is None:
            raise none_there(self.name, 0)
        width, height = SIZE_PX
        focal = COLOUR_FOCAL_PX if self.options.colour else FOCAL_PX
        lens = (focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), 0.0, 0.0, 0.0, 0.0, 0.0)
        colour = ColourCamera(SIZE_PX, lens) if self.options.colour else None
        unit_m = UNIT_M if self.options.kinect_raw else 0.001
        return SourceState(SIZE_PX, 30.0, unit_m=unit_m, lens=lens, colour=colour)

    def _next(self, wait_s: float) -> Stamped | None:
        first, self._first = self._first, None
        found = first or self._grab(self._package)
        if found is None:  # the call does not wait: the Kinect is lost
            raise OSError("the Kinect gives nothing")
        return found

    def _grab(self, package: Any) -> Stamped | None:
        raw = self.options.kinect_raw
        if self.options.colour:
            found = package.sync_get_depth(self._index(), package.DEPTH_REGISTERED)
            beside = None if found is None else package.sync_get_video(self._index(), package.VIDEO_RGB)
            if beside is None:
                return None
            image = np.ascontiguousarray(beside[0], dtype=np.uint8)
            return Stamped(np.array(found[0], dtype=np.uint16), None, bgr(image, *image.shape[:2]))
        found = package.sync_get_depth(self._index(), package.DEPTH_11BIT if raw else package.DEPTH_MM)
        if found is None:
            return None
        depth = np.array(found[0], dtype=np.uint16)
        return Stamped(kinect_units(depth) if raw else depth, None)

    def _stop(self) -> None:
        self._first = None
        if self._package is not None:
            self._package.sync_stop()
