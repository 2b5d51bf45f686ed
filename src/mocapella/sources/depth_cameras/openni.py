"""Depth cameras of OpenNI2 (Asus Xtion, PrimeSense, Orbbec Astra), by the package ``openni`` or ``primesense``.

OpenNI 2 Programmer's Guide, *VideoStream*: ``getVideoMode``, ``getHorizontalFieldOfView`` [rad] and pixel formats
``DEPTH_1_MM`` and ``DEPTH_100_UM``; a frame's time stamp is in microseconds. Many drivers mirror the image, which turns
left hands into right ones, so mirroring is switched off.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, none_there
from mocapella.sources.picture_source import SourceState


class OpenNiCamera(DepthDevice):
    """A depth camera that OpenNI2 lists, by its number; arguments as in `DepthDevice`.

    Depths are in units of 1 mm or 0.1 mm, as the camera's mode says. Size and rate are requested only if the options
    give a size.
    """

    packages = ("openni.openni2", "primesense.openni2")
    install = (
        "install openni into the same environment, and OpenNI2 itself (libOpenNI2); let OPENNI2_REDIST point to it"
    )
    _device: Any = None
    _stream: Any = None

    def _errors(self, package: Any) -> tuple[type[BaseException], ...]:
        return (package.OpenNIError, package.InitializationError, OSError)

    def _start(self, package: Any) -> SourceState:
        number = self._index()
        package.initialize()
        uris = package.Device.enumerate_uris()
        if number >= len(uris):
            raise none_there(self.name, len(uris))
        self._device = package.Device(uris[number])
        stream = self._stream = self._device.create_depth_stream()
        if stream is None:
            raise InputError("has no depth sensor", file=self.name, fix="name another camera")
        if self.options.size_px is not None:
            mode = stream.get_video_mode()
            fps = round(self.options.fps or mode.fps)
            stream.configure_mode(*self.options.size_px, fps, package.PIXEL_FORMAT_DEPTH_1_MM)
        problems = self._unmirrored(package)
        stream.start()
        mode = stream.get_video_mode()
        units = {package.PIXEL_FORMAT_DEPTH_1_MM: 0.001, package.PIXEL_FORMAT_DEPTH_100_UM: 0.0001}
        if mode.pixelFormat not in units:
            raise InputError(f"gives pixels of the format {mode.pixelFormat}", file=self.name,
                             fix="ask for a size, so that it gives millimetres: --size 640x480")  # fmt: skip
        width, height = mode.resolutionX, mode.resolutionY
        focal = (0.5 * width / math.tan(0.5 * stream.get_horizontal_fov()),
                 0.5 * height / math.tan(0.5 * stream.get_vertical_fov()))  # fmt: skip
        lens = (*focal, 0.5 * (width - 1), 0.5 * (height - 1), 0.0, 0.0, 0.0, 0.0, 0.0)
        return SourceState((width, height), float(mode.fps), problems=problems,
                           unit_m=units[mode.pixelFormat], lens=lens)  # fmt: skip

    def _unmirrored(self, package: Any) -> tuple[str, ...]:
        try:
            self._stream.set_mirroring_enabled(False)
            mirrored = self._stream.get_mirroring_enabled()
        except self._errors(package):
            return ()  # a driver without this property does not mirror
        return ("its image is mirrored and stays so: left hands will be taken for right ones",) if mirrored else ()

    def _next(self, wait_s: float) -> Stamped | None:
        if self._package.wait_for_any_stream([self._stream], wait_s) is None:
            return None
        frame = self._stream.read_frame()
        values = np.frombuffer(frame.get_buffer_as_uint16(), np.uint16)
        return Stamped(values.reshape(frame.height, frame.width).copy(), frame.timestamp / 1e6)

    def _stop(self) -> None:
        stream, device = self._stream, self._device
        self._stream = self._device = None
        try:
            if stream is not None:
                stream.stop()
                stream.close()
        finally:
            if device is not None:
                device.close()
