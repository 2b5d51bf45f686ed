"""The interface of image sources: a camera, a stream, a video, a folder of images or a rendered scene.

    source = open_pictures("camera:0")     # sources/open_pictures.py; depth images: sources/open_depth.py
    source.open()
    source.begin(time.monotonic())
    picture = source.read(stop)

`mocapella.sources.acquisition.Acquisition` reads a source in its own thread.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.colour_profile import CameraControls

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Picture:
    """One image and its capture time.

    Attributes:
        image: (height, width, 3) uint8 BGR; of a depth camera, (height, width) uint16 distances along the optical axis,
            in the unit of the source's state.
        time_ns: capture time on the source's own clock, above 0 and rising.
        number: number of images that the source has given before this one.
        ready_s: time at which the decoded image was available, on this machine's monotonic clock [s].
        retrieval_s: duration of the decoding, without the wait for the image [s].
    """

    image: Image
    time_ns: int
    number: int
    ready_s: float
    retrieval_s: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the image."""
        return self.image.shape[1], self.image.shape[0]


@dataclass(frozen=True)
class SourceState:
    """The state of a source after it was opened.

    Attributes:
        size_px: (width, height) that the source states; None if unknown before the first image.
        fps: requested frame rate, or the rate that the source states [Hz]; None if unknown.
        controls: exposure, gain and others, as read back from the camera.
        problems: requested settings that the source did not accept, or values that it had to assume, each a sentence
            with a remedy.
        unit_m: length of a unit of a depth camera's image [m]; None if unknown, or no depth camera.
        lens: (9,) intrinsics of a depth camera, see `mocapella.geometry.lens`; None if unknown, or no depth camera.
    """

    size_px: tuple[int, int] | None = None
    fps: float | None = None
    controls: CameraControls = field(default_factory=CameraControls)
    problems: tuple[str, ...] = ()
    unit_m: float | None = None
    lens: tuple[float, ...] | None = None


class PictureSource(Protocol):
    """A source of images. It is opened and read by one thread at a time."""

    name: str
    """Name of the source, as the user wrote it."""
    live: bool
    """Whether a missing image means that a camera was lost and must be reopened; otherwise the source has ended."""
    times: str
    """The origin of its capture times, in words."""

    def open(self) -> SourceState:
        """Open the source; it may be opened again after `close`.

        Raises:
            InputError: it cannot be opened; states a remedy.
        """
        ...

    def begin(self, zero_s: float) -> None:
        """Set the source's time 0, on the monotonic clock [s], after `open` and before the first `read`.

        Recordings are played from then on in real time; cameras ignore this, since they have their own clock.
        """
        ...

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; None if a recording has ended, a camera is lost, or ``stop`` is set.

        Setting ``stop`` ends the wait early, except in drivers that cannot be interrupted.
        """
        ...

    def close(self) -> None:
        """Release the source's resources; may be called twice, or before `open`."""
        ...
