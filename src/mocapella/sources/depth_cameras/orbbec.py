"""Orbbec cameras (Femto, Gemini, Astra 2), by the package ``pyorbbecsdk``.

Orbbec SDK's Python wrapper: ``Context().query_devices()`` lists cameras, ``Pipeline(device)`` with a ``Config`` streams
one, a depth frame's ``get_depth_scale()`` is millimetres per unit, and the stream profile's ``get_intrinsic()`` and
``get_distortion()`` are the lens; ``get_timestamp()`` is in milliseconds.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, none_there
from mocapella.sources.picture_source import SourceState

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
        pipeline.start(config)
        self._pipeline = pipeline
        first = self._first = self._frame(FIRST_S)
        if first is None:
            raise InputError(f"gave no image within {FIRST_S:g} s", file=self.name, fix="plug it in again")
        seen, bent = profile.get_intrinsic(), profile.get_distortion()
        lens = tuple(map(float, (seen.fx, seen.fy, seen.cx, seen.cy, bent.k1, bent.k2, bent.p1, bent.p2, bent.k3)))
        return SourceState(
            (first.get_width(), first.get_height()), float(profile.get_fps()), problems=problems,
            unit_m=float(first.get_depth_scale()) / 1e3, lens=lens,
        )  # fmt: skip

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
        values = np.frombuffer(frame.get_data(), np.uint8).view(np.uint16)
        depth = values.reshape(frame.get_height(), frame.get_width()).copy()
        return Stamped(depth, frame.get_timestamp() / 1e3)

    def _frame(self, wait_s: float) -> Any:
        frames = self._pipeline.wait_for_frames(round(1e3 * wait_s))
        return None if frames is None else frames.get_depth_frame()

    def _stop(self) -> None:
        pipeline, self._pipeline, self._first = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()
