"""A device behind OpenCV's interface, with controls that may refuse, and a plug that can be pulled."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

NONE = -1.0
FILM = cv2.VideoCapture


class FakeDevice:
    """What stays when a capture is closed and opened again.

    Args:
        size: (width, height) of its pictures.
        refuses: properties that keep their value, whatever is set.
        values: of its properties; those that are not here do not exist.
        fps: how often it has a picture; None: as often as it is asked.
        stamps: whether it stamps its frames on the monotonic clock, so long before they come [s].
    """

    def __init__(
        self,
        size: tuple[int, int] = (64, 48),
        *,
        refuses: tuple[int, ...] = (),
        values: Mapping[int, float] | None = None,
        fps: float | None = None,
        stamps: float | None = None,
    ) -> None:
        self.values = {
            cv2.CAP_PROP_FRAME_WIDTH: size[0],
            cv2.CAP_PROP_FRAME_HEIGHT: size[1],
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter_fourcc(*"YUYV"),
            cv2.CAP_PROP_BUFFERSIZE: 4,
            cv2.CAP_PROP_EXPOSURE: 156.0,
            cv2.CAP_PROP_GAIN: 10.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
            cv2.CAP_PROP_SATURATION: 64.0,
            cv2.CAP_PROP_CONTRAST: 32.0,
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            **(values or {}),
        }
        self.refuses, self.fps, self.stamps = refuses, fps, stamps
        self.plugged, self.hangs = True, threading.Event()
        self.opened = self.grabs = 0

    def open(self, *_how: Any) -> FakeCapture:
        self.opened += 1
        return FakeCapture(self)


class FakeCapture:
    """`cv2.VideoCapture` on a device."""

    def __init__(self, device: FakeDevice) -> None:
        self.device, self.released, self._at_s = device, False, 0.0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's
        return self.device.plugged

    def getBackendName(self) -> str:  # noqa: N802 - OpenCV's
        return "V4L2"

    def set(self, prop: int, value: float) -> bool:
        if prop not in self.device.values:
            return False
        if prop not in self.device.refuses:
            self.device.values[prop] = value
        return True  # as many drivers say, whatever they did

    def get(self, prop: int) -> float:
        if prop == cv2.CAP_PROP_POS_MSEC:
            return 0.0 if self.device.stamps is None else 1e3 * (self._at_s - self.device.stamps)
        return float(self.device.values.get(prop, NONE))

    def grab(self) -> bool:
        if self.device.fps is not None:
            time.sleep(1 / self.device.fps)
        if self.device.hangs.is_set():
            time.sleep(30.0)
        self._at_s = time.monotonic()
        self.device.grabs += 1
        return self.device.plugged

    def retrieve(self) -> tuple[bool, Any]:
        width, height = (int(self.device.values[k]) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        return True, np.full((height, width, 3), self.device.grabs % 256, np.uint8)

    def release(self) -> None:
        self.released = True


class FilmWithoutRate:
    """OpenCV's film whose frames a second nobody knows. (OpenCV's own class cannot be derived from.)"""

    def __init__(self, path: str) -> None:
        self._film = FILM(path)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._film, name)

    def get(self, prop: int) -> float:
        return 0.0 if prop == cv2.CAP_PROP_FPS else float(self._film.get(prop))
