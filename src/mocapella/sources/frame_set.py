"""Images of one instant of several cameras, and the rig's cameras for images of the sizes that come.

Videos (`video_set.py`) and live cameras (`live_set.py`) give them alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, Literal, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.camera import CameraRig, PlacedCamera

UInt8 = NDArray[np.uint8]

OtherSize = Literal["crop", "scale"]
OTHER_SIZES: Final = {
    "crop": "pixels are where the calibration says, and only the border was cut off at the right and below",
    "scale": "the whole picture was made larger or smaller",
}
RATIO_WITHIN: Final = 0.01
"""A picture that was scaled by other factors across and high than these allow was not only scaled."""


class FrameSet(msgspec.Struct, frozen=True, eq=False):
    """A frame of all cameras.

    Attributes:
        frame: its number.
        time_ns: of capture; 0 is a video's first frame, and of live cameras the first that was followed.
        images: (height, width, 3) BGR by camera; a camera that gave none is missing.
    """

    frame: int
    time_ns: int
    images: Mapping[str, UInt8]

    @classmethod
    def at_rate(cls, frame: int, rate_hz: float, images: Mapping[str, UInt8]) -> FrameSet:
        """Of a video with so many frames a second."""
        return cls(frame, time_of_frame(frame, rate_hz), images)


class FrameSource(Protocol):
    """What gives frames of all cameras, one after the other."""

    rig: CameraRig
    """Of the cameras that give images, for images of their sizes."""
    rate_hz: float
    """Frames a second."""
    notes: list[str]
    """What was chosen or left out, a line each."""

    @property
    def count(self) -> int | None:
        """Of the frames; None where nobody knows."""
        ...

    def described(self) -> dict[str, dict[str, Any]]:
        """Where images come from and how large they are, by camera, as ``--json`` has it."""
        ...

    def summary(self) -> dict[str, Any]:
        """What is to be told of it at the end, as ``--json`` has it."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...


def time_of_frame(frame: int, rate_hz: float) -> int:
    """When a video's frame of that number was captured [ns]."""
    return round(frame * NS_PER_S / rate_hz)


def check_other_size(other_size: str | None) -> None:
    """See that it is one of `OTHER_SIZES`, or None.

    Raises:
        SettingsError: it is not.
    """
    if other_size is not None and other_size not in OTHER_SIZES:
        raise SettingsError(f"--other-size is {other_size!r}; it must be one of {one_of(other_size, OTHER_SIZES)}")


def fitted(
    placed: PlacedCamera, size: tuple[int, int], other_size: str | None, *, source: object
) -> tuple[PlacedCamera, str]:
    """The camera for pictures of another size, and what is to be said of it.

    Args:
        placed: as it was calibrated.
        size: (width, height) of the pictures.
        other_size: of `OTHER_SIZES`; None: another size is an error.
        source: of the pictures, as the user wrote it.

    Raises:
        InputError: of another size, and that was not allowed; or no scale makes one of the other.
    """
    wanted = placed.camera.size_px
    if size == wanted:
        return placed, ""
    told = (
        f"images of {size[0]} × {size[1]} px, but the camera {placed.camera.name} is calibrated for "
        f"{wanted[0]} × {wanted[1]} px"
    )
    if other_size is None:
        turned = size == wanted[::-1]
        fix = "turn the video: it lies on its side" if turned else (
            "--other-size crop where pixels are as calibrated and only the right and lower border is missing, "
            "--other-size scale where the whole picture was scaled"
        )  # fmt: skip
        raise InputError(f"has {told}", file=source, field="size", value=size, fix=fix)
    lens, factors = placed.camera.lens.copy(), np.array(size) / wanted
    if other_size == "scale":
        if abs(factors[0] / factors[1] - 1) > RATIO_WITHIN:
            raise InputError(
                f"has {told}: no scale of the whole picture makes one of the other", file=source, field="size",
                value=size, fix="try --other-size crop",
            )  # fmt: skip
        lens[:2] *= factors
        lens[2:4] = (lens[2:4] + 0.5) * factors - 0.5  # the first pixel's middle is 0
    camera = msgspec.structs.replace(placed.camera, size_px=size, lens=lens)
    return msgspec.structs.replace(placed, camera=camera), f"{source}: {told}; --other-size {other_size}"
