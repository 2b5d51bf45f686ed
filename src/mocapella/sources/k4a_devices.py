"""Open an Azure Kinect or Orbbec Femto by its number or serial number, with the library ``k4a``."""

from __future__ import annotations

import ctypes
import re
from contextlib import ExitStack
from ctypes import byref, c_size_t, c_void_p
from typing import Any, Final

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import none_there
from mocapella.sources.k4a_libraries import OK

_PLUG: Final = "plug it in; no other program may use it, and this user must be allowed to (udev rules on Linux)"


def open_device(k4a: Any, which: str, name: str, opened: ExitStack) -> tuple[c_void_p, str]:
    """Open a camera; ``opened`` closes it.

    Args:
        k4a: the library, of `mocapella.sources.k4a_libraries`.
        which: number of the camera, from 0, in one or two digits; or its serial number.
        name: name in errors.
        opened: gets the callback that closes the camera.

    Returns:
        The handle, and the serial number.

    Raises:
        InputError: there is no such camera, or it cannot be opened.
    """
    number = int(which) if re.fullmatch("[0-9]{1,2}", which) else None
    count = k4a.k4a_device_get_installed_count()
    if not count:
        fix = "plug one in; Microsoft's libk4a sees only an Azure Kinect, Orbbec's only a Femto"
        raise InputError("there is no camera", file=name, fix=fix)
    if number is not None and number >= count:
        raise none_there(name, count)
    others = []
    for index in range(count) if number is None else (number,):
        handle = c_void_p()
        if k4a.k4a_device_open(index, byref(handle)) != OK:
            others.append("one that cannot be opened")
            continue
        serial = _serial(k4a, handle)
        if number is not None or serial == which:
            opened.callback(k4a.k4a_device_close, handle)
            return handle, serial
        k4a.k4a_device_close(handle)
        others.append(serial)
    if number is not None:
        raise InputError("cannot be opened", file=name, fix=_PLUG)
    fix = f"here: {', '.join(others)}; a number below 100 counts them from 0"
    raise InputError("there is no camera with this serial number", file=name, fix=fix)


def _serial(k4a: Any, device: c_void_p) -> str:
    text, size = ctypes.create_string_buffer(64), c_size_t(64)
    if k4a.k4a_device_get_serialnum(device, text, byref(size)) != OK:
        return "one without a serial number"
    return text.value.decode("ascii", errors="replace")
