"""Depth cameras of OpenNI2 (Asus Xtion, PrimeSense, Orbbec Astra), by the package ``openni`` or ``primesense``.

OpenNI 2 Programmer's Guide, *VideoStream*: ``getVideoMode``, ``getHorizontalFieldOfView`` [rad] and pixel formats
``DEPTH_1_MM`` and ``DEPTH_100_UM``; a frame's time stamp is in microseconds. Many drivers mirror the image, which turns
left hands into right ones, so mirroring is switched off. With colour, the device itself registers the depth images to
the colour images (``setImageRegistrationMode``), whose lens its field of view gives.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, bgr, none_there
from mocapella.sources.picture_source import ColourCamera, SourceState


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
    _colour: Any = None

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
        problems = self._unmirrored(package, stream)
        if self.options.colour:
            problems += self._start_colour(package)
        stream.start()
        mode = stream.get_video_mode()
        units = {package.PIXEL_FORMAT_DEPTH_1_MM: 0.001, package.PIXEL_FORMAT_DEPTH_100_UM: 0.0001}
        if mode.pixelFormat not in units:
            raise InputError(f"gives pixels of the format {mode.pixelFormat}", file=self.name,
                             fix="ask for a size, so that it gives millimetres: --size 640x480")  # fmt: skip
        size, lens = _camera(stream)
        colour = None
        if self._colour is not None:
            of_colour = _camera(self._colour)
            if of_colour[0] != size:
                raise InputError(f"gives depth images of {size} and colour images of {of_colour[0]} px", file=self.name,
                                 fix="ask for a size that both have: --size 640x480")  # fmt: skip
            lens, colour = of_colour[1], ColourCamera(*of_colour)
        return SourceState(size, float(mode.fps), problems=problems, unit_m=units[mode.pixelFormat],
                           lens=lens, colour=colour)  # fmt: skip

    def _start_colour(self, package: Any) -> tuple[str, ...]:
        """Start the colour images, and have the device register the depth images to them; return problems."""
        colour = self._colour = self._device.create_color_stream()
        registered = package.IMAGE_REGISTRATION_DEPTH_TO_COLOR
        if colour is None or not self._device.is_image_registration_mode_supported(registered):
            fix = "use it for its depth alone, or another camera"
            raise InputError("has no colour images to which it registers its depth", file=self.name, fix=fix)
        if self.options.size_px is not None:
            fps = round(self.options.fps or colour.get_video_mode().fps)
            colour.configure_mode(*self.options.size_px, fps, package.PIXEL_FORMAT_RGB888)
        problems = self._unmirrored(package, colour)
        self._device.set_image_registration_mode(registered)
        colour.start()
        if colour.get_video_mode().pixelFormat != package.PIXEL_FORMAT_RGB888:
            fix = "ask for a size, so that it gives RGB: --size 640x480"
            raise InputError("gives colour images of another format than RGB", file=self.name, fix=fix)
        return problems

    def _unmirrored(self, package: Any, stream: Any) -> tuple[str, ...]:
        try:
            stream.set_mirroring_enabled(False)
            mirrored = stream.get_mirroring_enabled()
        except self._errors(package):
            return ()  # a driver without this property does not mirror
        return ("its image is mirrored and stays so: left hands will be taken for right ones",) if mirrored else ()

    def _next(self, wait_s: float) -> Stamped | None:
        if self._package.wait_for_any_stream([self._stream], wait_s) is None:
            return None
        frame = self._stream.read_frame()
        values = np.frombuffer(frame.get_buffer_as_uint16(), np.uint16)
        colour = None
        if self._colour is not None:
            if self._package.wait_for_any_stream([self._colour], wait_s) is None:
                return None
            beside = self._colour.read_frame()
            colour = bgr(beside.get_buffer_as_uint8(), beside.height, beside.width)
        return Stamped(values.reshape(frame.height, frame.width).copy(), frame.timestamp / 1e6, colour)

    def _stop(self) -> None:
        streams, device = (self._stream, self._colour), self._device
        self._stream = self._colour = self._device = None
        try:
            for stream in filter(None, streams):
                stream.stop()
                stream.close()
        finally:
            if device is not None:
                device.close()


def _camera(stream: Any) -> tuple[tuple[int, int], tuple[float, ...]]:
    """Return the size (width, height) [px] and the lens (9,) of a stream, from its field of view."""
    mode = stream.get_video_mode()
    width, height = mode.resolutionX, mode.resolutionY
    focal = (0.5 * width / math.tan(0.5 * stream.get_horizontal_fov()),
             0.5 * height / math.tan(0.5 * stream.get_vertical_fov()))  # fmt: skip
    return (width, height), (*focal, 0.5 * (width - 1), 0.5 * (height - 1), 0.0, 0.0, 0.0, 0.0, 0.0)
