"""A Raspberry Pi's camera as the package picamera2 shows it: requests with pictures, metadata and controls."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

BOOT_S = 1000.0
"""How much the clock of the sensor's stamps is ahead of the test's monotonic clock."""


class FakeRequest:
    def __init__(self, camera: FakePicamera2) -> None:
        self._camera, self.released = camera, False

    def make_array(self, stream: str) -> Any:
        assert stream == "main"
        width, height = self._camera.size
        return np.full((height, width, 3), self._camera.count % 256, np.uint8)

    def get_metadata(self) -> dict[str, Any]:
        return self._camera.metadata()

    def release(self) -> None:
        self.released = True
        self._camera.held -= 1


class FakePicamera2:
    """One camera; its automatic modes approach 8 ms, gain 4 and the gains (2.1, 1.6).

    `now_s` is the time, and `silent` whether it gives no image any more.

    Args:
        number: as picamera2 has it.
        size: what it gives, whatever is requested; None for what is requested.
    """

    def __init__(self, number: int = 0, size: tuple[int, int] | None = None) -> None:
        self.number, self._gives, self.size = number, size, (0, 0)
        self.camera_controls: dict[str, tuple[Any, Any, Any]] = {
            "ExposureTime": (75, 11766829, 20000),
            "AnalogueGain": (1.0, 10.666, 1.0),
            "ColourGains": (0.0, 32.0, None),
            "Saturation": (0.0, 32.0, 1.0),
            "Contrast": (0.0, 32.0, 1.0),
            "Brightness": (-1.0, 1.0, 0.0),
            "AeEnable": (False, True, None),
            "AwbEnable": (False, True, None),
            "FrameDurationLimits": (11111, 11767556, None),
        }
        self.now_s, self.count, self.held = 5.0, 0, 0
        self.set: dict[str, Any] = {}
        self.plugged, self.started, self.closed = True, False, False
        self.silent, self.queued, self.stuck = False, 0, threading.Event()

    def create_video_configuration(self, main: dict[str, Any], **rest: Any) -> dict[str, Any]:
        assert main["format"] == "RGB888"
        return {"main": main, **rest}

    def configure(self, configuration: dict[str, Any]) -> None:
        self.configuration = configuration
        self.size = self._gives or configuration["main"]["size"]

    def camera_configuration(self) -> dict[str, Any]:
        return {"main": {**self.configuration["main"], "size": self.size}}

    def start(self) -> None:
        self.started = True

    def stop(self) -> None:
        while self.queued:  # picamera2 stops after the captures before
            self.stuck.wait()
        self.started = False

    def close(self) -> None:
        self.closed = True

    def set_controls(self, controls: dict[str, Any]) -> None:
        assert all(name in self.camera_controls for name in controls)
        self.set |= controls

    def capture_request(self, signal_function: Callable[[Any], None]) -> Any:
        if not (self.plugged and self.started):
            raise RuntimeError("the camera has gone")

        def taken() -> FakeRequest:
            self.held += 1
            self.now_s += 1 / 90
            return FakeRequest(self)

        return self._job(taken, signal_function)

    def capture_metadata(self, signal_function: Callable[[Any], None]) -> Any:
        return self._job(self.metadata, signal_function)

    def wait(self, job: Any) -> Any:
        return job

    def cancel_all_and_flush(self) -> None:
        self.queued = 0

    def _job(self, run: Callable[[], Any], signal_function: Callable[[Any], None]) -> Any:
        if self.silent:
            self.queued += 1
            return None
        self.count += 1
        job = run()
        signal_function(job)
        return job

    def metadata(self) -> dict[str, Any]:
        automatic = {"ExposureTime": 8000, "AnalogueGain": 4.0} if self.set.get("AeEnable", True) else {}
        white = {"ColourGains": (2.1, 1.6)} if self.set.get("AwbEnable", True) else {}
        now = {"ExposureTime": 20000, "AnalogueGain": 1.0, "ColourGains": (1.0, 1.0)}
        stamp_ns = round((self.now_s + BOOT_S) * 1e9)
        had = {**now, **self.set}
        had["ExposureTime"] -= 7  # a whole number of lines
        return {**had, **automatic, **white, "SensorTimestamp": stamp_ns}
