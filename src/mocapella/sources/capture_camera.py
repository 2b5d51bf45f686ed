"""Local cameras and network streams, through `cv2.VideoCapture`.

OpenCV chooses the backend of the system, such as V4L2 on Linux.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.model.camera_controls import ControlDescription
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes, set_camera
from mocapella.sources.picture_source import Picture, SourceState, controls_of, left_automatic, stuck_automatic
from mocapella.sources.v4l2_controls import V4l2Controls, open_v4l2

OPEN_TIMEOUT_S: Final = 5.0
READ_TIMEOUT_S: Final = 3.0
"""Timeout for the next frame of a stream [s]."""
NEWEST_S: Final = 0.5
"""Greatest plausible age of a driver's time stamp; an older one belongs to another clock [s]."""
_FROM_GRAB: Final = "the monotonic clock, when a frame was there"
_FROM_DRIVER: Final = "the driver's stamps on the monotonic clock"


class CaptureCamera:
    """A local camera or a network stream.

    Capture times are on the monotonic clock. Where the driver stamps frames on that clock (Linux, V4L2), its stamp is
    used. Elsewhere, and from the first stamp on that is not within `NEWEST_S` before the frame's arrival or does not
    rise, the capture time is the arrival.

    Args:
        target: number of the camera, or address of the stream.
        name: name of the source, as the user wrote it.
        wishes: requested settings; they have no effect on a stream, whose rate is reported as ``wishes.fps``.
        open_capture: replaces `cv2.VideoCapture` in tests.
        open_controls: opens the driver's controls by the camera's number; replaced in tests.
        clock: the monotonic clock, in seconds.

    Attributes:
        name, live, times: name as the user wrote it, whether a missing image means a lost camera, and the origin of the
            capture times in words; ``times`` changes when the driver's stamps are no longer used.
    """

    live = True

    def __init__(
        self,
        target: int | str,
        name: str,
        wishes: CameraWishes | None = None,
        *,
        open_capture: Callable[..., Any] = cv2.VideoCapture,
        open_controls: Callable[[int], V4l2Controls | None] = open_v4l2,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.times = name, _FROM_GRAB
        self._target, self._wishes = target, wishes or CameraWishes()
        self._open_capture, self._open_controls, self._clock = open_capture, open_controls, clock
        self._capture: Any = None
        self._device: V4l2Controls | None = None
        self._number, self._last_ns = 0, 0

    def open(self) -> SourceState:
        """Open the source and return its state, after closing it if it was open; see `PictureSource.open`.

        Raises:
            InputError: the camera or stream cannot be opened; states a remedy.
        """
        self.close()
        capture = self._opened()
        if not capture.isOpened():
            capture.release()
            fix = (
                "see mocapella doctor for the cameras that there are; another program may use it"
                if isinstance(self._target, int)
                else "look whether a browser or a player shows the stream"
            )
            raise InputError("cannot be opened", file=self.name, fix=fix)
        self._capture = capture
        if not isinstance(self._target, int):
            self.times = _FROM_GRAB
            return SourceState(fps=self._wishes.fps)
        driven = getattr(capture, "getBackendName", lambda: "")() == "V4L2"
        self.times = _FROM_DRIVER if driven else _FROM_GRAB
        self._device = device = self._open_controls(self._target)
        wishes, problems = (self._wishes, ()) if device is None else _with_gain_mode(device, self._wishes)
        state = set_camera(capture, wishes)
        state = replace(state, problems=(*problems, *state.problems))
        found = () if device is None else device.controls()
        return replace(state, controls=_with_focus(controls_of(found), state.controls)) if found else state

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return the camera's controls, see `ControlledSource`; empty of a stream, and where no V4L2 driver is."""
        return () if self._device is None else self._device.controls()

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Set controls while the camera gives images, see `ControlledSource`; a lost camera has them again later.

        Raises:
            SettingsError: the request is invalid, or the camera's driver does not state ranges.
        """
        device = self._device
        if device is None:
            at_start = "set them at its start (--set exposure=…)" if isinstance(self._target, int) else "at the camera"
            raise SettingsError(
                f"{self.name}: only V4L2 cameras have controls that can be set while they run; {at_start}"
            )
        problems = device.set_controls(values, automatic)
        if found := device.controls():
            kept = _with_focus(controls_of(found), self._wishes.controls)
            self._wishes = replace(self._wishes, controls=kept)
        return problems

    def begin(self, zero_s: float) -> None:
        """Do nothing: a camera has its own clock."""

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; None if the camera gave no frame or is not open. See `PictureSource.read`.

        ``stop`` has no effect: OpenCV's wait for a frame cannot be interrupted. Grey images are converted to BGR.
        """
        if self._capture is None or not self._capture.grab():
            return None
        came_s = self._clock()
        at_s = self._stamp(came_s)
        read, image = self._capture.retrieve()
        ready_s = self._clock()
        if not read or image is None:
            return None
        self._last_ns = max(round(at_s * NS_PER_S), self._last_ns + 1)
        number, self._number = self._number, self._number + 1
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
        return Picture(np.asarray(image, dtype=np.uint8), self._last_ns, number, ready_s, ready_s - came_s)

    def close(self) -> None:
        """Release the camera or stream: `read` returns None until it is opened again. May be called twice."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _opened(self) -> Any:
        if isinstance(self._target, int):
            return self._open_capture(self._target)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1e3 * OPEN_TIMEOUT_S)]
        limits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1e3 * READ_TIMEOUT_S)]
        return self._open_capture(self._target, cv2.CAP_FFMPEG, limits)

    def _stamp(self, came_s: float) -> float:
        """Capture time of the frame that has just arrived [s]."""
        if self.times != _FROM_DRIVER:
            return came_s
        stamp_s = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
        if 0 <= came_s - stamp_s <= NEWEST_S and stamp_s * NS_PER_S > self._last_ns:
            return stamp_s
        self.times = _FROM_GRAB
        return came_s


def _with_gain_mode(device: V4l2Controls, wishes: CameraWishes) -> tuple[CameraWishes, tuple[str, ...]]:
    """Switch the automatic gain, which OpenCV does not know, on or off as requested, if the driver has it.

    Returns the wishes for OpenCV, without the gain if its automatic mode is on now, and a sentence if it is.
    """
    if not any(control.mode == "gain" for control in device.controls()):
        return wishes, ()
    wanted = "gain" in wishes.controls.automatic
    device.set_controls({}, {"gain": wanted})
    if not any(control.mode == "gain" and control.automatic for control in device.controls()):
        return wishes, ()
    rest = replace(wishes, controls=replace(wishes.controls, gain=None))
    return rest, (left_automatic("gain") if wanted else stuck_automatic("gain"),)


def _with_focus(controls: CameraControls, before: CameraControls) -> CameraControls:
    """Return the driver's controls, and the automatic focus, which is none of them, unchanged."""
    focus = tuple(mode for mode in before.automatic if mode == "focus")
    return replace(controls, automatic=controls.automatic + focus)


def camera_number(path: str) -> int | None:
    """Return the camera number, 0 for ``/dev/video0``, also of a link in ``/dev`` to such a device.

    None for any other path. The device need not exist.
    """
    if not path.startswith("/dev/"):
        return None
    match = re.fullmatch(r"/dev/video(\d+)", str(Path(path).resolve()))
    return int(match[1]) if match else None
