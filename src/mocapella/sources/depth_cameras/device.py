"""Base class of depth cameras: open, read with capture times, detect a lost camera, close."""

from __future__ import annotations

import importlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.sources.depth_options import DepthOptions, check_lens
from mocapella.sources.picture_source import Picture, SourceState

UInt16 = NDArray[np.uint16]

LOST_S: Final = 2.0
"""Time without an image after which a camera is lost [s]."""
WAIT_S: Final = 0.1
"""Longest wait in the package at a time, so that a stop is noticed [s]."""
JUMP_S: Final = 0.5
"""Deviation of a time stamp from the monotonic clock that sets a new clock offset [s]."""


class Stamped(NamedTuple):
    """A depth image (height, width) in the device's unit, and its capture time on the device's clock [s].

    The time is None if the device gives none. ``colour`` is the (height, width, 3) uint8 BGR image of the same instant,
    None if it is not wanted.
    """

    depth: UInt16
    at_s: float | None
    colour: NDArray[np.uint8] | None = None


class DepthDevice(ABC):
    """A live depth camera; a `mocapella.sources.picture_source.PictureSource`.

    Capture times are the device's stamps plus a clock offset: the first image's arrival on the monotonic clock minus
    its stamp. Without stamps, they are the arrivals. Images are (height, width) uint16 distances along the optical axis
    in the unit of the state that `open` returns; 0 is not measured. The constructor does not open the camera.

    Args:
        which: number of the camera, or its serial number, as the subclass states.
        name: name of the source, as the user wrote it.
        options: the user's parameters; they take precedence over the device's.
        package: the driver's package; imported at `open` if None.
        clock: the monotonic clock, in seconds.

    Attributes:
        name, live, times: name as the user wrote it, whether a missing image means a lost camera, and the origin of the
            capture times in words.
        which, options: as given.
    """

    live = True
    packages: ClassVar[tuple[str, ...]]
    """Modules that drive it; the first installed one is used. Empty if `libraries` do."""
    libraries: ClassVar[tuple[str, ...]] = ()
    """Names of the vendor's C libraries that drive it, as of `mocapella.sources.k4a_libraries`."""
    install: ClassVar[str]
    """Instruction for the installation."""

    def __init__(
        self,
        which: str,
        name: str,
        options: DepthOptions | None = None,
        *,
        package: Any = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.which, self.name, self.options = which, name, options or DepthOptions()
        self.times = "the device's stamps, on the monotonic clock"
        self._package, self._clock = package, clock
        self._number, self._last_ns = 0, 0
        self._shift_s: float | None = None
        self._open = False

    @abstractmethod
    def _start(self, package: Any) -> SourceState:
        """Open the camera and start its stream; return its size, rate, unit and lens."""

    @abstractmethod
    def _next(self, wait_s: float) -> Stamped | None:
        """Wait for the next image; None if none arrives within ``wait_s``."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop and close the camera, if it is open."""

    def _errors(self, package: Any) -> tuple[type[BaseException], ...]:
        """Exceptions that the package raises when a camera is lost."""
        return (RuntimeError, OSError)

    def open(self) -> SourceState:
        """Open the source and return its state; see `PictureSource.open`.

        An open camera is closed first.

        Raises:
            SettingsError: no package is installed, or the source's name has no number where one is needed.
            InputError: there is no such camera, it cannot be started, or its lens is implausible.
        """
        self.close()
        package = self._package = self._package or self._imported()
        try:
            state = self._start(package)
        except self._errors(package) as error:
            self._stop_quietly(package)
            fix = "plug it in; no other program may use it, and this user must be allowed to (udev rules on Linux)"
            raise InputError(f"cannot be opened ({error})", file=self.name, fix=fix) from error
        except InputError:
            self._stop_quietly(package)
            raise
        self._open, self._shift_s = True, None
        lens = self.options.lens if self.options.lens is not None else state.lens
        unit_m = self.options.unit_m if self.options.unit_m is not None else state.unit_m
        state = replace(state, lens=lens, unit_m=unit_m)
        if lens is not None and state.size_px is not None:
            check_lens(lens, state.size_px, self.name)
        return state

    def begin(self, zero_s: float) -> None:  # noqa: B027 - no subclass needs to override it
        """Do nothing: a camera has its own clock."""

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; see `PictureSource.read`.

        None is returned if the camera is not open, if its driver fails, without an image for `LOST_S` seconds, or if
        ``stop`` is set.
        """
        if not self._open:
            return None
        lost_s = self._clock() + LOST_S
        while not stop.is_set():
            try:
                found = self._next(WAIT_S)
            except self._errors(self._package):
                return None
            came_s = self._clock()
            if found is not None:
                self._last_ns = max(round(self._at(found.at_s, came_s) * NS_PER_S), self._last_ns + 1)
                number, self._number = self._number, self._number + 1
                return Picture(found.depth, self._last_ns, number, came_s, 0.0, found.colour)
            if came_s >= lost_s:
                return None
        return None

    def close(self) -> None:
        """Stop the camera: `read` returns None until it is opened again. May be called twice; ignores driver errors."""
        if self._open:
            self._open = False
            self._stop_quietly(self._package)

    def _at(self, stamp_s: float | None, came_s: float) -> float:
        """Capture time of an image on the monotonic clock [s], too late by the latency of the first image."""
        if stamp_s is None:
            return came_s
        if self._shift_s is None or abs(came_s - stamp_s - self._shift_s) > JUMP_S:
            self._shift_s = came_s - stamp_s
        return stamp_s + self._shift_s

    def _stop_quietly(self, package: Any) -> None:
        try:
            self._stop()
        except self._errors(package):  # unplugged: nothing to close
            pass

    def _imported(self) -> Any:
        for module in self.packages:
            try:
                return importlib.import_module(module)
            except ImportError:
                continue
        package = self.packages[0].partition(".")[0]
        raise SettingsError(f"{self.name} needs the package {package}, which is not installed: {self.install}")

    def _index(self) -> int:
        """The camera's number.

        Raises:
            SettingsError: the source's name has no number.
        """
        if not (self.which.isascii() and self.which.isdigit()):
            kind = self.name.partition(":")[0]
            raise SettingsError(f"source {self.name!r} cannot be used; write {kind}:0 for the first camera")
        return int(self.which)


def bgr(values: Any, height: int, width: int) -> NDArray[np.uint8]:
    """Return the image (height, width, 3) uint8 BGR of bytes in the order red, green, blue; a copy."""
    return np.ascontiguousarray(np.frombuffer(values, np.uint8).reshape(height, width, 3)[..., ::-1])


def motion_rows(rotation: Any, translation_m: Any) -> tuple[tuple[float, ...], ...]:
    """Return the rows of the (4, 4) motion of a rotation (3, 3) and a translation (3,) [m]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation_m
    return tuple(tuple(map(float, row)) for row in T)


def none_there(name: str, count: int) -> InputError:
    """Return, not raise, the error that there is no camera ``name``; it states the ``count`` of connected ones."""
    there = f"{count} of them {'is' if count == 1 else 'are'} here, from 0" if count else "none is here; plug one in"
    return InputError("there is no such camera", file=name, fix=there)
