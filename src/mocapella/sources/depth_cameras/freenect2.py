"""The Kinect v2 through libfreenect2, by the package ``pylibfreenect2``.

``Freenect2().openDevice(serial)`` opens a Kinect, and a ``SyncMultiFrameListener`` collects images of one instant:
``waitForNewFrame(milliseconds=…)`` returns them by name, or None; ``release`` gives them back. Depth is float32 in
millimetres, 0 is not measured. ``Registration.apply(color, depth, undistorted, registered)`` removes the depth image's
distortion and fetches the colour of each of its pixels (BGRX), so both have the lens ``getIrCameraParams()``. The
package does not document the origin of its stamps, so capture times are the arrivals.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, none_there
from mocapella.sources.picture_source import ColourCamera, SourceState

SIZE_PX: Final = (512, 424)
_PIXEL_BYTES: Final = 4


class Freenect2Camera(DepthDevice):
    """A Kinect v2 as a depth camera of 512 × 424 px and 30 Hz; arguments as in `DepthDevice`.

    It is selected by its number, at most three digits, or else by its serial number. The lens is the camera's own,
    without distortion; colour images have the pixels of the depth images, black where the colour camera sees nothing.
    """

    packages = ("pylibfreenect2",)
    install = "install libfreenect2 and its Python package pylibfreenect2 into the same environment"
    _device: Any = None
    _listener: Any = None
    _registration: Any = None

    def _start(self, package: Any) -> SourceState:
        self.times = "the monotonic clock, when an image was there"
        driver = package.Freenect2()
        self._device = driver.openDevice(self._serial(driver))
        if self._device is None:
            fix = (
                "plug it into a USB 3 port; no other program may use it, and this user must be allowed to (udev rules)"
            )
            raise InputError("cannot be opened", file=self.name, fix=fix)
        kinds = package.FrameType.Color | package.FrameType.Ir | package.FrameType.Depth
        self._listener = package.SyncMultiFrameListener(kinds)
        self._device.setColorFrameListener(self._listener)
        self._device.setIrAndDepthFrameListener(self._listener)
        self._device.start()
        seen = self._device.getIrCameraParams()
        self._registration = package.Registration(seen, self._device.getColorCameraParams())
        lens = (float(seen.fx), float(seen.fy), float(seen.cx), float(seen.cy), 0.0, 0.0, 0.0, 0.0, 0.0)
        colour = ColourCamera(SIZE_PX, lens) if self.options.colour else None
        return SourceState(SIZE_PX, 30.0, unit_m=0.001, lens=lens, colour=colour)

    def _serial(self, driver: Any) -> Any:
        """Return the serial number of the Kinect to open; the driver crashes with one that is not there.

        Raises:
            InputError: there is none of this number.
        """
        there = [driver.getDeviceSerialNumber(index) for index in range(driver.enumerateDevices())]
        if len(self.which) > 3 or not self.which.isdigit():
            if self.which.encode() not in there:
                raise none_there(self.name, len(there))
            return self.which.encode()
        if self._index() >= len(there):
            raise none_there(self.name, len(there))
        return there[self._index()]

    def _next(self, wait_s: float) -> Stamped | None:
        frames = self._listener.waitForNewFrame(milliseconds=round(1e3 * wait_s))
        if not frames:
            return None
        try:
            straight = self._package.Frame(*SIZE_PX, _PIXEL_BYTES)
            coloured = self._package.Frame(*SIZE_PX, _PIXEL_BYTES)
            self._registration.apply(frames["color"], frames["depth"], straight, coloured)
            depth = np.nan_to_num(straight.asarray(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
            image = np.clip(np.rint(depth), 0, np.iinfo(np.uint16).max).astype(np.uint16)
            colour = np.array(coloured.asarray(np.uint8)[..., :3]) if self.options.colour else None
        finally:
            self._listener.release(frames)
        return Stamped(image, None, colour)

    def _stop(self) -> None:
        device, self._device, self._listener, self._registration = self._device, None, None, None
        if device is not None:
            device.stop()
            device.close()
