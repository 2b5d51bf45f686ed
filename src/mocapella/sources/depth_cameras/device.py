"""What every depth camera does, whatever package drives it: open, read with a time, notice that it is gone, close."""

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
"""A camera that gives nothing for so long is lost."""
WAIT_S: Final = 0.1
"""So long the package is waited for at a time, so that the end of the program is seen."""
JUMP_S: Final = 0.5
"""A stamp that is so far off the monotonic clock begins a new count."""


class Stamped(NamedTuple):
    """An image (height, width) and when it was captured on the device's clock [s]; None where it does not say."""

    depth: UInt16
    at_s: float | None


class DepthDevice(ABC):
    """A live depth camera; a `mocapella.sources.picture_source.PictureSource`.

    Its time is the device's stamps, brought to the monotonic clock by when its first image came; of a device without
    stamps, when images come.

    Args:
        which: number of the camera, or its serial number; empty is the first.
        name: as the user wrote it.
        options: what the user says; goes before what the device says.
        package: what drives it; imported where it is None.
        clock: the monotonic clock, in seconds.
    """

    live = True
    packages: ClassVar[tuple[str, ...]]
    """Modules that drive it, the first that is installed is taken."""
    install: ClassVar[str]
    """What to install, in words."""

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
        """Open the camera and start its stream; says size, rate, unit and lens."""

    @abstractmethod
    def _next(self, wait_s: float) -> Stamped | None:
        """The next image; None where none comes within so long."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop and close; nothing where nothing is open."""

    def _errors(self, package: Any) -> tuple[type[BaseException], ...]:
        """What the package raises where a camera is gone."""
        return (RuntimeError, OSError)

    def open(self) -> SourceState:
        """As `PictureSource.open`.

        Raises:
            SettingsError: the package is not installed.
            InputError: there is no such camera, or it cannot be started.
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

    def begin(self, zero_s: float) -> None:  # noqa: B027 - there is nothing to do, and nobody needs to change that
        """A camera has its own clock."""

    def read(self, stop: threading.Event) -> Picture | None:
        """As `PictureSource.read`; None where the camera is gone."""
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
                return Picture(found.depth, self._last_ns, number, came_s, 0.0)
            if came_s >= lost_s:
                return None
        return None

    def close(self) -> None:
        """As `PictureSource.close`."""
        if self._open:
            self._open = False
            self._stop_quietly(self._package)

    def _at(self, stamp_s: float | None, came_s: float) -> float:
        """When an image was captured, on the monotonic clock, give or take what the first took to come."""
        if stamp_s is None:
            return came_s
        if self._shift_s is None or abs(came_s - stamp_s - self._shift_s) > JUMP_S:
            self._shift_s = came_s - stamp_s
        return stamp_s + self._shift_s

    def _stop_quietly(self, package: Any) -> None:
        try:
            self._stop()
        except self._errors(package):  # it was unplugged: there is nothing left to close
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
        """The camera's number."""
        if not (self.which.isascii() and self.which.isdigit()):
            kind = self.name.partition(":")[0]
            raise SettingsError(f"source {self.name!r} cannot be used; write {kind}:0 for the first camera")
        return int(self.which)


def none_there(name: str, count: int) -> InputError:
    """That there is no such camera among those that are there."""
    there = f"{count} of them {'is' if count == 1 else 'are'} here, from 0" if count else "none is here; plug one in"
    return InputError("there is no such camera", file=name, fix=there)
