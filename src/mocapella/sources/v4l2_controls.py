"""Read and set the controls of a Linux camera through V4L2, with its driver's own ranges.

The device is opened a second time: V4L2 lets a program read and set controls while another file of it streams. Numbers
are those of ``linux/v4l2-controls.h`` and ``linux/videodev2.h``; the ioctls are QUERYCTRL, G_CTRL and S_CTRL of the
Video4Linux documentation (Linux Media Subsystem, part I, section 1.8).
"""

from __future__ import annotations

import errno
import os
import struct
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from mocapella.model.camera_controls import ControlDescription, checked

_QUERYCTRL: Final = 0xC0445624
_G_CTRL: Final = 0xC008561B
_S_CTRL: Final = 0xC008561C
_QUERY: Final = struct.Struct("=II32siiiiIII")
"""struct v4l2_queryctrl: id, type, name, minimum, maximum, step, default, flags, two reserved."""
_VALUE: Final = struct.Struct("=Ii")
"""struct v4l2_control: id, value."""
_INTEGER: Final = 1
_DISABLED, _GRABBED, _READ_ONLY = 0x1, 0x2, 0x4
_USER, _CAMERA = 0x00980900, 0x009A0900


class _Control(NamedTuple):
    id: int
    unit: str = ""
    mode: str = ""


class _Mode(NamedTuple):
    id: int
    off: int
    on: tuple[int, ...]


_CONTROLS: Final = {
    "exposure": _Control(_CAMERA + 2, "100 µs", "exposure"),
    "gain": _Control(_USER + 19, "", "gain"),
    "white_balance": _Control(_USER + 26, "K", "white_balance"),
    "white_balance_red": _Control(_USER + 14, "", "white_balance"),
    "white_balance_blue": _Control(_USER + 15, "", "white_balance"),
    "saturation": _Control(_USER + 2),
    "contrast": _Control(_USER + 1),
    "brightness": _Control(_USER + 0),
}
_MODES: Final = {
    "exposure": _Mode(_CAMERA + 1, 1, (3, 0)),  # of the menu: manual; aperture priority as in UVC, or automatic
    "gain": _Mode(_USER + 18, 0, (1,)),
    "white_balance": _Mode(_USER + 12, 0, (1,)),
}

Ioctl = Callable[[int, int, bytearray], Any]
"""`fcntl.ioctl` on a file descriptor, with a request and a buffer that it changes."""


class V4l2Controls:
    """The controls of one V4L2 device; its methods may be called from any thread.

    Args:
        fd: file descriptor of the device; `close` closes it.
        ioctl: the system call; a test's device has its own.
    """

    def __init__(self, fd: int, ioctl: Ioctl) -> None:
        self._fd, self._ioctl, self._lock = fd, ioctl, threading.Lock()

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return the controls that the device has, with their present values; none once it is unplugged or closed."""
        with self._lock:
            modes = {name: value for name, mode in _MODES.items() if (value := self._get(mode.id)) is not None}
            found = (self._described(name, control, modes) for name, control in _CONTROLS.items())
            return tuple(control for control in found if control is not None)

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Switch automatic modes, then set values, and read both back.

        Args:
            values: requested values by name of the control.
            automatic: automatic modes to switch on or off, by name of the mode.

        Returns:
            A sentence for each that the driver did not accept.

        Raises:
            SettingsError: the request is invalid, see `mocapella.model.camera_controls.checked`; nothing is set.
        """
        accepted = checked(self.controls(), values, automatic)
        problems = []
        with self._lock:
            for name, wanted in automatic.items():
                mode = _MODES[name]
                choices = mode.on if wanted else (mode.off,)
                if not any(self._put(mode.id, choice) for choice in choices):
                    problems.append(
                        f"automatic {name.replace('_', ' ')} cannot be switched {'on' if wanted else 'off'}"
                    )
            for name, value in accepted.items():
                if not self._put(_CONTROLS[name].id, round(value)):
                    stays = self._get(_CONTROLS[name].id)
                    why = "the device does not answer" if stays is None else f"it stays {stays}"
                    problems.append(f"{name.replace('_', ' ')} cannot be set to {value:g}: {why}")
        return tuple(problems)

    def close(self) -> None:
        """Close the device; may be called twice."""
        with self._lock:
            if self._fd >= 0:
                os.close(self._fd)
            self._fd = -1

    def _described(self, name: str, control: _Control, modes: Mapping[str, int]) -> ControlDescription | None:
        asked = bytearray(_QUERY.pack(control.id, 0, b"", 0, 0, 0, 0, 0, 0, 0))
        if not self._call(_QUERYCTRL, asked):
            return None
        _, kind, _, least, most, step, default, flags, _, _ = _QUERY.unpack(asked)
        value = self._get(control.id)
        if kind != _INTEGER or flags & _DISABLED or value is None or least > most:
            return None
        mode = control.mode if control.mode in modes else ""
        automatic = bool(mode) and modes[mode] != _MODES[mode].off
        fixed = bool(flags & (_READ_ONLY | _GRABBED))
        return ControlDescription(name, control.unit, least, most, max(1, step), default, value, mode, automatic, fixed)

    def _get(self, number: int) -> int | None:
        asked = bytearray(_VALUE.pack(number, 0))
        return int(_VALUE.unpack(asked)[1]) if self._call(_G_CTRL, asked) else None

    def _put(self, number: int, value: int) -> bool:
        """Set a control; whether it has that value then."""
        return self._call(_S_CTRL, bytearray(_VALUE.pack(number, value))) and self._get(number) == value

    def _call(self, request: int, buffer: bytearray) -> bool:
        """Whether the device carried out the request; drivers refuse unknown controls with various error numbers."""
        if self._fd < 0:
            return False
        while True:
            try:
                self._ioctl(self._fd, request, buffer)
                return True
            except OSError as error:
                if error.errno != errno.EINTR:
                    return False


def open_v4l2(number: int) -> V4l2Controls | None:
    """Open the controls of ``/dev/videoNUMBER``; None on other systems than Linux, or if it cannot be opened."""
    if sys.platform != "linux":
        return None
    import fcntl

    try:
        fd = os.open(f"/dev/video{number}", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    return V4l2Controls(fd, lambda at, request, buffer: fcntl.ioctl(at, request, buffer, True))
