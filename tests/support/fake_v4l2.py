"""A V4L2 device behind the ioctl function: a table of controls that may refuse, be fixed, or be unplugged."""

from __future__ import annotations

import errno
import struct
from dataclasses import dataclass

QUERYCTRL, G_CTRL, S_CTRL = 0xC0445624, 0xC008561B, 0xC008561C
QUERY, VALUE = struct.Struct("=II32siiiiIII"), struct.Struct("=Ii")
INTEGER, BOOLEAN, MENU = 1, 2, 3
DISABLED, GRABBED, READ_ONLY = 1, 2, 4
BRIGHTNESS, CONTRAST, SATURATION, AUTO_WHITE_BALANCE = 0x00980900, 0x00980901, 0x00980902, 0x0098090C
RED_BALANCE, BLUE_BALANCE, AUTO_GAIN, GAIN, TEMPERATURE = 0x0098090E, 0x0098090F, 0x00980912, 0x00980913, 0x0098091A
EXPOSURE_AUTO, EXPOSURE = 0x009A0901, 0x009A0902


@dataclass
class Control:
    """As the driver has it."""

    least: int
    most: int
    step: int
    default: int
    value: int
    kind: int = INTEGER
    flags: int = 0
    refuses: bool = False


def webcam() -> dict[int, Control]:
    """Controls of an ordinary USB camera, in automatic mode."""
    return {
        BRIGHTNESS: Control(-64, 64, 1, 0, 0),
        CONTRAST: Control(0, 64, 1, 32, 32),
        SATURATION: Control(0, 128, 1, 64, 64),
        AUTO_WHITE_BALANCE: Control(0, 1, 1, 1, 1, BOOLEAN),
        GAIN: Control(0, 100, 1, 0, 10),
        TEMPERATURE: Control(2800, 6500, 10, 4600, 4600),
        EXPOSURE_AUTO: Control(0, 3, 1, 3, 3, MENU),
        EXPOSURE: Control(1, 5000, 1, 156, 156),
    }


class FakeV4l2:
    """What is behind a file descriptor.

    Args:
        controls: by number; those of a webcam if None.
        modes: values of the exposure's menu that exist.
    """

    def __init__(self, controls: dict[int, Control] | None = None, modes: tuple[int, ...] = (1, 3)) -> None:
        self.controls = webcam() if controls is None else controls
        self.modes, self.plugged, self.interrupted = modes, True, 0

    def ioctl(self, fd: int, request: int, buffer: bytearray) -> int:
        if self.interrupted:
            self.interrupted -= 1
            raise OSError(errno.EINTR, "interrupted")
        if not self.plugged:
            raise OSError(errno.ENODEV, "no such device")
        number = struct.unpack_from("=I", buffer)[0]
        control = self.controls.get(number)
        if control is None:
            raise OSError(errno.EINVAL, "no such control")
        if request == QUERYCTRL:
            c = control
            assert len(buffer) == 68  # sizeof (struct v4l2_queryctrl)
            QUERY.pack_into(buffer, 0, number, c.kind, b"x", c.least, c.most, c.step, c.default, c.flags, 0, 0)
        elif request == G_CTRL:
            VALUE.pack_into(buffer, 0, number, control.value)
        else:
            assert request == S_CTRL
            value = VALUE.unpack_from(buffer)[1]
            if number == EXPOSURE_AUTO and value not in self.modes:
                raise OSError(errno.EINVAL, "not in the menu")
            if number == EXPOSURE and self.controls[EXPOSURE_AUTO].value != 1:
                raise OSError(errno.EACCES, "inactive")
            if not control.least <= value <= control.most:
                raise OSError(errno.ERANGE, "out of range")
            if not control.refuses:
                control.value = value
        return 0
