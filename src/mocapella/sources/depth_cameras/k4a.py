"""The Azure Kinect as a depth camera, and Orbbec's Femto with the same interface, by the library ``k4a``.

The body tracker ``k4abt`` is not needed. The library decodes colour images to BGRA; depth is in millimetres, and 0 is
not measured. Both images of a capture are of one instant, whose stamp is in microseconds of the device's clock. The
lenses are fitted to the calibration (`mocapella.sources.k4a_lens`).
"""

from __future__ import annotations

import ctypes
from contextlib import ExitStack
from ctypes import byref, c_void_p
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, motion_rows
from mocapella.sources.k4a_devices import open_device
from mocapella.sources.k4a_lens import COLOUR, DEPTH, K4aCalibration, lens_of, motion_of, size_of
from mocapella.sources.k4a_libraries import (
    COLOUR_720P,
    COLOUR_BGRA,
    DEPTH_MODES,
    DEPTH_SIZE_PX,
    FPS,
    OK,
    TIMEOUT,
    DeviceConfiguration,
    load_camera_library,
    missing,
)
from mocapella.sources.picture_source import ColourCamera, SourceState

LARGEST_ERROR_PX: Final = 3.0
"""Largest error of a fitted lens before it is reported [px]."""
_USUAL_FPS: Final = 30


class K4aCamera(DepthDevice):
    """An Azure Kinect or Orbbec Femto as a depth camera of 640 × 576 or 320 × 288 px; arguments as in `DepthDevice`.

    It is selected by its number, at most two digits, or else by its serial number. Colour images have 1280 × 720 px. A
    size or rate that it does not have is replaced by the default, with a note. ``package`` is the loaded library.
    """

    packages = ()
    libraries = ("k4a",)
    install = missing("k4a")
    _opened: ExitStack | None = None
    _device: Any = None

    def _imported(self) -> Any:
        return load_camera_library()

    def _start(self, package: Any) -> SourceState:
        opened = self._opened = ExitStack()
        self._device, _ = open_device(package, self.which, self.name, opened)
        wanted_px, wanted_fps = self.options.size_px or DEPTH_SIZE_PX, round(self.options.fps or _USUAL_FPS)
        fits = wanted_px in DEPTH_MODES and wanted_fps in FPS
        size_px, fps = (wanted_px, wanted_fps) if fits else (DEPTH_SIZE_PX, _USUAL_FPS)
        colour = self.options.colour
        mode, resolution = DEPTH_MODES[size_px], COLOUR_720P if colour else 0
        how = DeviceConfiguration(
            color_format=COLOUR_BGRA if colour else 0, color_resolution=resolution, depth_mode=mode,
            camera_fps=FPS[fps], synchronized_images_only=colour,
        )  # fmt: skip
        if package.k4a_device_start_cameras(self._device, byref(how)) != OK:
            fix = "use another USB 3 port and its power supply; on Linux it needs a display (OpenGL)"
            raise InputError("its cameras do not start", file=self.name, fix=fix)
        opened.callback(package.k4a_device_stop_cameras, self._device)
        known = K4aCalibration()
        if package.k4a_device_get_calibration(self._device, mode, resolution, byref(known)) != OK:
            fix = "plug it in again, with its power supply"
            raise InputError("its calibration cannot be read", file=self.name, fix=fix)
        problems = () if fits else ("it does not support the requested size or rate, and uses its default",)
        lens, doubts = _lens(known, DEPTH, "depth")
        seen = None
        if colour:
            of_colour, more = _lens(known, COLOUR, "colour")
            seen, doubts = (
                ColourCamera(size_of(known, COLOUR), of_colour, motion_rows(*motion_of(known))),
                doubts + more,
            )
        return SourceState(
            size_px, float(fps), problems=problems + doubts, unit_m=0.001, lens=lens, colour=seen,
        )  # fmt: skip

    def _next(self, wait_s: float) -> Stamped | None:
        k4a, capture = self._package, c_void_p()
        result = k4a.k4a_device_get_capture(self._device, byref(capture), round(1e3 * wait_s))
        if result == TIMEOUT:
            return None
        if result != OK:
            raise OSError("the library gives no image")
        with ExitStack() as held:
            held.callback(k4a.k4a_capture_release, capture)
            depth = self._image(k4a.k4a_capture_get_depth_image(capture), 2, held)
            colour = None
            if self.options.colour:
                colour = self._image(k4a.k4a_capture_get_color_image(capture), 4, held)
            if depth is None or (self.options.colour and colour is None):
                return None
            picture, at_s = depth
            return Stamped(picture, at_s, None if colour is None else np.ascontiguousarray(colour[0][..., :3]))

    def _image(self, handle: int | None, pixel_bytes: int, held: ExitStack) -> tuple[NDArray[Any], float] | None:
        """Return a copy of an image, and its stamp [s]; None if the capture has none.

        Args:
            handle: the image's handle; None is null.
            pixel_bytes: 2 for uint16 depths (height, width), 4 for uint8 BGRA (height, width, 4).
            held: gets the callback that releases the image.
        """
        if not handle:
            return None
        k4a, image = self._package, c_void_p(handle)
        held.callback(k4a.k4a_image_release, image)
        width, height = k4a.k4a_image_get_width_pixels(image), k4a.k4a_image_get_height_pixels(image)
        stride, start = k4a.k4a_image_get_stride_bytes(image), k4a.k4a_image_get_buffer(image)
        if not start or min(width, height) <= 0 or stride < width * pixel_bytes:
            return None
        rows = np.ctypeslib.as_array((ctypes.c_uint8 * (stride * height)).from_address(start)).reshape(height, stride)
        values = rows[:, : width * pixel_bytes].copy()
        found = values.view(np.uint16) if pixel_bytes == 2 else values.reshape(height, width, pixel_bytes)
        return found, k4a.k4a_image_get_device_timestamp_usec(image) / 1e6

    def _stop(self) -> None:
        opened, self._opened, self._device = self._opened, None, None
        if opened is not None:
            opened.close()


def _lens(known: K4aCalibration, camera: int, words: str) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Return a camera's lens, and what to know about it."""
    lens, error_px = lens_of(known, camera)
    if error_px <= LARGEST_ERROR_PX:
        return lens, ()
    much = "its distortion is left out" if not np.isfinite(error_px) else f"it is off by up to {error_px:.1f} px"
    return lens, (f"the {words} camera's lens does not fit our model ({much}); --intrinsics gives that of the depth",)
