"""Orbbec cameras (Femto, Gemini, Astra 2), by the package ``pyorbbecsdk``.

Orbbec SDK's Python wrapper: ``Context().query_devices()`` lists cameras, ``Pipeline(device)`` with a ``Config`` streams
one, a depth frame's ``get_depth_scale()`` is millimetres per unit, and the stream profile's ``get_intrinsic()`` and
``get_distortion()`` are the lens; ``get_timestamp()`` is in milliseconds. ``get_extrinsic_to(profile)`` has the
rotation ``rot`` (3, 3) and the translation ``transform`` in millimetres.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, bgr, motion_rows, none_there
from mocapella.sources.picture_source import ColourCamera, SourceState

FIRST_S: Final = 5.0
"""Longest wait for the first image, which gives the unit [s]."""


class OrbbecCamera(DepthDevice):
    """An Orbbec depth camera; arguments as in `DepthDevice`.

    It is selected by its number, at most three digits, or else by its serial number. Unit and lens are the camera's
    own; a size or rate that it does not have is replaced by its default, with a note.
    """

    packages = ("pyorbbecsdk",)
    install = "install pyorbbecsdk2 (or pyorbbecsdk) into the same environment"
    _pipeline: Any = None
    _first: Any = None
    _colour: Any = None

    def _errors(self, package: Any) -> tuple[type[BaseException], ...]:
        return (package.OBError, RuntimeError, OSError)

    def _start(self, package: Any) -> SourceState:
        pipeline = package.Pipeline(self._device(package))
        profiles = pipeline.get_stream_profile_list(package.OBSensorType.DEPTH_SENSOR)
        width, height = self.options.size_px or (0, 0)  # 0: the camera's default
        fps = round(self.options.fps or 0)
        problems: tuple[str, ...] = ()
        try:
            profile = profiles.get_video_stream_profile(width, height, package.OBFormat.Y16, fps)
        except package.OBError:
            profile = profiles.get_default_video_stream_profile()
            problems = ("it does not support the requested size or rate, and uses its default",) if width or fps else ()
        config = package.Config()
        config.enable_stream(profile)
        colour = self._colour_profile(package, pipeline) if self.options.colour else None
        if colour is not None:
            config.enable_stream(colour)
        pipeline.start(config)
        self._pipeline = pipeline
        first = self._first = self._frame(FIRST_S)
        if first is None:
            raise InputError(f"gave no image within {FIRST_S:g} s", file=self.name, fix="plug it in again")
        return SourceState(
            (first.get_width(), first.get_height()), float(profile.get_fps()), problems=problems,
            unit_m=float(first.get_depth_scale()) / 1e3, lens=_lens(profile),
            colour=None if colour is None else self._colour_camera(profile, colour),
        )  # fmt: skip

    def _colour_profile(self, package: Any, pipeline: Any) -> Any:
        profiles = pipeline.get_stream_profile_list(package.OBSensorType.COLOR_SENSOR)
        try:
            return profiles.get_video_stream_profile(0, 0, package.OBFormat.RGB, round(self.options.fps or 0))
        except package.OBError as error:
            fix = "use it for its depth alone, or another camera"
            raise InputError(f"gives no colour images as RGB ({error})", file=self.name, fix=fix) from error

    @staticmethod
    def _colour_camera(depth: Any, colour: Any) -> ColourCamera:
        seen, motion = colour.get_intrinsic(), depth.get_extrinsic_to(colour)
        R, t = np.reshape(motion.rot, (3, 3)), np.asarray(motion.transform, np.float64) / 1e3
        return ColourCamera((int(seen.width), int(seen.height)), _lens(colour), motion_rows(R, t))

    def _device(self, package: Any) -> Any:
        devices = package.Context().query_devices()
        if len(self.which) > 3 or not self.which.isdigit():
            return devices.get_device_by_serial_number(self.which)
        if self._index() >= devices.get_count():
            raise none_there(self.name, devices.get_count())
        return devices.get_device_by_index(self._index())

    def _next(self, wait_s: float) -> Stamped | None:
        first, self._first = self._first, None
        frame = first or self._frame(wait_s)
        if frame is None:
            return None
        colour = None
        if self.options.colour:
            colour = bgr(self._colour.get_data(), self._colour.get_height(), self._colour.get_width())
        values = np.frombuffer(frame.get_data(), np.uint8).view(np.uint16)
        depth = values.reshape(frame.get_height(), frame.get_width()).copy()
        return Stamped(depth, frame.get_timestamp() / 1e3, colour)

    def _frame(self, wait_s: float) -> Any:
        """The next depth frame; with colour, ``_colour`` is the frame of the same instant; None without either."""
        frames = self._pipeline.wait_for_frames(round(1e3 * wait_s))
        if frames is None or not self.options.colour:
            return None if frames is None else frames.get_depth_frame()
        self._colour = frames.get_color_frame()
        return None if self._colour is None else frames.get_depth_frame()

    def _stop(self) -> None:
        pipeline, self._pipeline, self._first, self._colour = self._pipeline, None, None, None
        if pipeline is not None:
            pipeline.stop()


def _lens(profile: Any) -> tuple[float, ...]:
    seen, bent = profile.get_intrinsic(), profile.get_distortion()
    return tuple(map(float, (seen.fx, seen.fy, seen.cx, seen.cy, bent.k1, bent.k2, bent.p1, bent.p2, bent.k3)))
