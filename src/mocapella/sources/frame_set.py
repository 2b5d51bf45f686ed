"""Synchronised images of several cameras, and the adaptation of a rig's intrinsics to their size.

Videos (`video_set.py`) and live cameras (`live_set.py`) both produce them.
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
"""Largest relative difference of the horizontal and vertical scale factors at which ``scale`` is accepted."""


class FrameSet(msgspec.Struct, frozen=True, eq=False):
    """One frame: an image of each camera.

    Attributes:
        frame: number of the frame: of a video its own, from 0; of live cameras counted from 0 in each run.
        time_ns: capture time since the first frame of the video, or of the live run [ns].
        images: (height, width, 3) uint8 BGR, by the rig's camera names; a camera without an image is missing.
    """

    frame: int
    time_ns: int
    images: Mapping[str, UInt8]

    @classmethod
    def at_rate(cls, frame: int, rate_hz: float, images: Mapping[str, UInt8]) -> FrameSet:
        """Make the frame number ``frame`` of videos with a constant frame rate [Hz]; its time is number / rate.

        Frame numbers start at 0, and so does the time.

        Args:
            frame: number of the frame.
            rate_hz: frame rate [Hz].
            images: (height, width) or (height, width, 3) uint8 BGR, by camera.
        """
        return cls(frame, time_of_frame(frame, rate_hz), images)


class FrameSource(Protocol):
    """A source of synchronised images of a rig's cameras: `VideoSet` or `LiveSet`. Iteration yields its frames."""

    rig: CameraRig
    """The cameras that have images, with intrinsics for the images' sizes."""
    rate_hz: float
    """Frame rate [Hz]."""
    notes: list[str]
    """Choices and omissions to report, one line each."""

    @property
    def count(self) -> int | None:
        """Number of frames; None if unknown."""
        ...

    def described(self) -> dict[str, dict[str, Any]]:
        """Return source and image size by camera, as JSON types, for ``--json``."""
        ...

    def summary(self) -> dict[str, Any]:
        """Return facts of the run so far, such as dropped images, as JSON types, for ``--json``; may be empty."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...


def time_of_frame(frame: int, rate_hz: float) -> int:
    """Return the time from a video's frame 0 to its frame of this number, at a constant frame rate ``rate_hz`` [ns]."""
    return round(frame * NS_PER_S / rate_hz)


def check_other_size(other_size: str | None) -> None:
    """Check that the value is one of `OTHER_SIZES`, or None.

    Raises:
        SettingsError: it is not.
    """
    if other_size is not None and other_size not in OTHER_SIZES:
        raise SettingsError(f"other_size is {other_size!r}; it must be one of {one_of(other_size, OTHER_SIZES)}")


def fitted(
    placed: PlacedCamera, size: tuple[int, int], other_size: str | None, *, source: object
) -> tuple[PlacedCamera, str]:
    """Adapt a calibrated camera to images of another size; return the new camera and a note for the user.

    With equal sizes, the camera itself and an empty note are returned. With ``crop``, only the size changes; with
    ``scale``, also focal lengths and principal point. The extrinsics stay.

    Args:
        placed: the calibrated camera.
        size: (width, height) of the images.
        other_size: how the images' size may differ from the calibration's, one of `OTHER_SIZES`; None refuses another
            size.
        source: the images' source, as the user wrote it; named in errors.

    Raises:
        InputError: the size differs and ``other_size`` is None, or scaling does not explain the size.
    """
    wanted = placed.camera.size_px
    if size == wanted:
        return placed, ""
    mismatch = (
        f"images of {size[0]} × {size[1]} px, but the camera {placed.camera.name} is calibrated for "
        f"{wanted[0]} × {wanted[1]} px"
    )
    if other_size is None:
        turned = size == wanted[::-1]
        fix = "turn the video: it lies on its side" if turned else (
            "--set other_size=crop where pixels are as calibrated and only the right and lower border is missing, "
            "--set other_size=scale where the whole picture was scaled"
        )  # fmt: skip
        raise InputError(f"has {mismatch}", file=source, field="size", value=size, fix=fix)
    lens, factors = placed.camera.lens.copy(), np.array(size) / wanted
    if other_size == "scale":
        if abs(factors[0] / factors[1] - 1) > RATIO_WITHIN:
            raise InputError(
                f"has {mismatch}: no scale of the whole picture makes one of the other", file=source, field="size",
                value=size, fix="try --set other_size=crop",
            )  # fmt: skip
        lens[:2] *= factors
        lens[2:4] = (lens[2:4] + 0.5) * factors - 0.5  # the centre of the first pixel is (0, 0)
    camera = msgspec.structs.replace(placed.camera, size_px=size, lens=lens)
    return msgspec.structs.replace(placed, camera=camera), f"{source}: {mismatch}; --set other_size={other_size}"
