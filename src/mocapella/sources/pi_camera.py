"""A Raspberry Pi's own camera, through libcamera and the vendor's package picamera2.

OpenCV cannot read these cameras, whose pictures libcamera develops. picamera2 comes with Raspberry Pi OS
(``python3-picamera2``), not from a package index. Names and units of its controls are from the Picamera2 manual,
appendix C: ExposureTime [µs], AnalogueGain and ColourGains (red, blue) [factors], Saturation, Contrast, Brightness.
"""

from __future__ import annotations

import importlib
import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.model.camera_controls import ControlDescription, checked
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.picture_source import Picture, SourceState, controls_of, set_at_start

PI_CAMERA: Final = "picamera:"
"""Beginning of such a source's name."""
SIZE_PX: Final = (640, 480)
"""Image size if none is requested: the RHOT thesis' [px]."""
FPS: Final = 90.0
"""Frame rate if none is requested: the highest of the camera module 2 at this size [Hz]."""
SETTLED: Final = 60
"""Number of images after which the automatic modes have settled, before they are switched off."""
TIMEOUT_S: Final = 3.0
"""Longest wait for an image, or for two if they take longer; libcamera can stop without an error [s]."""
_CLOSE_S: Final = 2.0
_BUFFERS: Final = 4
_US_PER_S: Final = 1e6
_CONTROLS: Final = (  # our name, libcamera's, its place in a tuple, unit, step, automatic mode
    ("exposure", "ExposureTime", None, "µs", 1.0, "exposure"),
    ("gain", "AnalogueGain", None, "×", 0.01, "exposure"),
    ("white_balance_red", "ColourGains", 0, "×", 0.01, "white_balance"),
    ("white_balance_blue", "ColourGains", 1, "×", 0.01, "white_balance"),
    ("saturation", "Saturation", None, "×", 0.01, ""),
    ("contrast", "Contrast", None, "×", 0.01, ""),
    ("brightness", "Brightness", None, "", 0.01, ""),
)
_MODES: Final = {"exposure": "AeEnable", "white_balance": "AwbEnable"}


def load_picamera2(number: int) -> Any:
    """Open a camera of the Raspberry Pi by its number.

    Raises:
        InputError: picamera2 is not installed or does not work, or there is no such camera.
    """
    name = f"picamera:{number}"
    try:
        module = importlib.import_module("picamera2")
    except (ImportError, ValueError) as error:  # a ValueError of numpy says that simplejpeg is for another numpy
        fix = "on a Raspberry Pi, install as docs/markers-rig.md says: picamera2 and numpy of Raspberry Pi OS must fit"
        raise InputError(f"needs the package picamera2 ({error})", file=name, fix=fix) from None
    try:
        return module.Picamera2(number)
    except (IndexError, RuntimeError) as error:
        fix = "look at the cable, and whether rpicam-hello shows it; another program may use it"
        raise InputError(f"cannot be opened ({error})", file=name, fix=fix) from None


class PiCamera:
    """A camera at the ribbon cable of a Raspberry Pi, as a `mocapella.sources.picture_source.PictureSource`.

    Capture times are the middle of the first row's exposure: the sensor's stamp, which is the beginning of its readout,
    less half the exposure time, brought to the monotonic clock.

    Args:
        number: number of the camera, from 0.
        name: name of the source, as the user wrote it.
        wishes: requested settings; size and rate are `SIZE_PX` and `FPS` if they are None.
        open_camera: opens a ``Picamera2``; replaced in tests.
        clock: the monotonic clock, in seconds.
        boot_clock: the clock of the sensor's stamps, in seconds.
        timeout_s: longest wait for an image, at least two intervals of the frame rate [s].

    Attributes:
        name, live, times: name as the user wrote it, whether a missing image means a lost camera, and the origin of the
            capture times in words.
    """

    live = True
    times = "the sensor's stamps, the middle of the first row's exposure on the monotonic clock"

    def __init__(
        self,
        number: int,
        name: str,
        wishes: CameraWishes | None = None,
        *,
        open_camera: Callable[[int], Any] = load_picamera2,
        clock: Callable[[], float] = time.monotonic,
        boot_clock: Callable[[], float] | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.name, self._timeout_s = name, timeout_s
        self._target, self._wishes, self._open_camera = number, wishes or CameraWishes(), open_camera
        self._clock, self._boot_clock = clock, boot_clock or _boot_s
        self._lock = threading.Lock()
        self._camera: Any = None
        self._ranges: dict[str, tuple[Any, Any, Any]] = {}
        self._values: dict[str, float] = {}
        self._automatic: dict[str, bool] = {}
        self._number, self._last_ns, self._frame_us = 0, 0, 0

    def open(self) -> SourceState:
        """Open the camera, start it and return its state; see `mocapella.sources.picture_source.PictureSource.open`.

        Where no values are requested for exposure and white balance, the automatic modes set them for `SETTLED` images,
        and are switched off then.

        Raises:
            InputError: picamera2 is not installed, the camera cannot be opened, or gives no image in time; states a
                remedy.
        """
        self.close()
        camera = self._open_camera(self._target)
        try:
            return self._started(camera)
        except (RuntimeError, OSError, TimeoutError) as error:
            with self._lock:
                self._camera = None
            _closed(camera)
            fix = "see whether another program uses it; a smaller --size needs less memory"
            if isinstance(error, TimeoutError):
                fix = "look at the cable and whether rpicam-hello shows it; else restart the Raspberry Pi"
            raise InputError(f"cannot be started ({error})", file=self.name, fix=fix) from None

    def _started(self, camera: Any) -> SourceState:
        """Start a camera that is open; return its state."""
        wishes = self._wishes
        size, fps = wishes.size_px or SIZE_PX, wishes.fps or FPS
        frame_us = round(_US_PER_S / fps)
        configuration = camera.create_video_configuration(
            main={"size": size, "format": "RGB888"},  # libcamera's name of blue, green, red in memory
            buffer_count=_BUFFERS,
            queue=False,  # the next request is a new picture, not one that waited
            controls={"FrameDurationLimits": (frame_us, frame_us)},
        )
        camera.configure(configuration)
        camera.start()
        problems = [] if wishes.fourcc is None else [f"fourcc={wishes.fourcc} has no effect on a Raspberry Pi's camera"]
        with self._lock:
            self._camera, self._ranges = camera, dict(camera.camera_controls)
            self._automatic = {mode: True for mode, theirs in _MODES.items() if theirs in self._ranges}
            self._frame_us = frame_us
            self._values = {name: default for name, *_, default in self._known()}
        self._settle(wishes.controls)
        problems += set_at_start(self, wishes.controls)
        got = tuple(camera.camera_configuration()["main"]["size"])
        if got != tuple(size):
            problems.append(f"it gives {got[0]} × {got[1]} px, not {size[0]} × {size[1]}; request that with --size")
        state = SourceState((got[0], got[1]), fps, problems=tuple(problems))
        return replace(state, controls=controls_of(self.controls()))

    def begin(self, zero_s: float) -> None:
        """Do nothing: a camera has its own clock."""

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; None if the camera is lost or not open. ``stop`` does not interrupt the wait.

        A camera that gives no image in time is closed: libcamera's thread may wait for it without end.
        """
        camera = self._camera
        if camera is None:
            return None
        try:
            request = self._captured(camera, camera.capture_request)
            came_s = self._clock()
            try:
                image, facts = request.make_array("main"), request.get_metadata()
            finally:
                request.release()
        except TimeoutError:
            self.close()
            return None
        except (RuntimeError, OSError):
            return None
        ready_s = self._clock()
        stamp_s = facts["SensorTimestamp"] / NS_PER_S - 0.5 * facts.get("ExposureTime", 0) / _US_PER_S
        at_s = stamp_s + self._clock() - self._boot_clock()
        self._last_ns = max(round(at_s * NS_PER_S), self._last_ns + 1)
        number, self._number = self._number, self._number + 1
        self._follow(facts)
        return Picture(np.ascontiguousarray(image[..., :3]), self._last_ns, number, ready_s, ready_s - came_s)

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return the camera's controls, see `mocapella.sources.picture_source.ControlledSource`."""
        with self._lock:
            if self._camera is None:
                return ()
            return tuple(
                ControlDescription(
                    name, unit, least, most, step, default, self._values[name], mode if mode in self._automatic else "",
                    self._automatic.get(mode, False),
                )
                for name, unit, step, mode, least, most, default in self._known()
            )  # fmt: skip

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Set controls, see `mocapella.sources.picture_source.ControlledSource`; libcamera refuses no valid value.

        Raises:
            SettingsError: the camera is lost, or the request is invalid, see
                `mocapella.model.camera_controls.checked`; nothing is set.
        """
        if self._camera is None:
            raise SettingsError(f"{self.name}: the camera is lost just now; set its controls again when it is back")
        accepted = checked(self.controls(), values, automatic)
        with self._lock:
            if self._camera is None:
                return ("the camera is lost just now",)
            self._values.update(accepted)
            self._automatic.update(automatic)
            order: dict[str, Any] = {_MODES[mode]: on for mode, on in automatic.items()}
            touched = {theirs for name, theirs, *_, mode in _CONTROLS if name in accepted or mode in automatic}
            for theirs in touched:
                ours = [name for name, other, *_ in _CONTROLS if other == theirs and name in self._values]
                mode = next(mode for _, other, *_, mode in _CONTROLS if other == theirs)
                if self._automatic.get(mode, False):
                    continue
                order[theirs] = self._value(theirs, ours)
            self._camera.set_controls(order)
        self._wishes = replace(self._wishes, controls=controls_of(self.controls()))
        return ()

    def close(self) -> None:
        """Stop and release the camera: `read` returns None until it is opened again. May be called twice."""
        with self._lock:
            camera, self._camera = self._camera, None
        if camera is not None:
            _closed(camera)

    def _settle(self, wanted: CameraControls) -> None:
        """Let the automatic modes find values that were not requested: libcamera's defaults are dark and green."""
        open_modes = {
            mode
            for name, *_, mode in _CONTROLS
            if mode in self._automatic and mode not in wanted.automatic and name not in wanted.values
        }
        for _ in range(SETTLED if open_modes else 0):
            self._follow(self._captured(self._camera, self._camera.capture_metadata))

    def _captured(self, camera: Any, capture: Callable[..., Any]) -> Any:
        """The result of one of picamera2's captures, which wait without end by themselves.

        Raises:
            TimeoutError: there is none in time; the capture is still queued.
        """
        done = threading.Event()
        job = capture(signal_function=lambda _: done.set())
        longest_s = max(self._timeout_s, 2 * self._frame_us / _US_PER_S)
        if not done.wait(longest_s):
            raise TimeoutError(f"no image within {longest_s:g} s")
        return camera.wait(job)

    def _value(self, theirs: str, ours: list[str]) -> Any:
        """The value of a control as libcamera takes it."""
        if theirs == "ColourGains":
            return tuple(self._values[name] for name in ours)
        return round(self._values[ours[0]]) if theirs == "ExposureTime" else self._values[ours[0]]

    def _known(self) -> list[tuple[str, str, float, str, float, float, float]]:
        """Name, unit, step, mode, least, most and default of each control that the camera has."""
        found = []
        for name, theirs, place, unit, step, mode in _CONTROLS:
            if theirs not in self._ranges:
                continue
            least, most, default = (_part(value, place) for value in self._ranges[theirs])
            least, most = _number(least, 0.0), _number(most, 32.0)
            if name == "exposure":
                most = max(least, min(most, float(self._frame_us)))  # a longer one would slow the frames down
            usual = _number(default, 1.0 if unit == "×" else least)
            found.append((name, unit, step, mode, least, most, min(max(usual, least), most)))
        return found

    def _follow(self, facts: Mapping[str, Any]) -> None:
        """Take over what the automatic modes have set, of an image's metadata."""
        with self._lock:
            for name, theirs, place, _, _, mode in _CONTROLS:
                if self._automatic.get(mode, False) and theirs in facts and name in self._values:
                    self._values[name] = _number(_part(facts[theirs], place), self._values[name])


def _closed(camera: Any) -> None:
    """Stop and release a camera, which may have gone; leave it after `_CLOSE_S` seconds if libcamera does not answer.

    Queued captures are cancelled, for picamera2 stops only after them.
    """

    def release() -> None:
        for step in (getattr(camera, "cancel_all_and_flush", lambda: None), camera.stop, camera.close):
            with suppress(RuntimeError, OSError, TimeoutError):
                step()

    closing = threading.Thread(target=release, name="closing a camera", daemon=True)
    closing.start()
    closing.join(_CLOSE_S)


def pi_camera_number(text: str) -> int | None:
    """Return the number in ``picamera:0``; None for any other text."""
    number = text.removeprefix(PI_CAMERA)
    return int(number) if text.startswith(PI_CAMERA) and number.isascii() and number.isdecimal() else None


def _part(value: Any, place: int | None) -> Any:
    return value[place] if place is not None and isinstance(value, list | tuple) else value


def _number(value: Any, otherwise: float) -> float:
    """A finite number; some versions of libcamera state None."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if good else otherwise


def _boot_s() -> float:
    """The time since the machine was started [s], on the clock of the sensor's stamps."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock is None else time.clock_gettime(clock)
