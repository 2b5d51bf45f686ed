"""Where pictures come from, one after the other: a camera, a stream, a film, a folder or a rendered scene.

    source = open_pictures("camera:0")     # sources/open_pictures.py; depth images: sources/open_depth.py
    source.open()
    source.begin(time.monotonic())
    picture = source.read(stop)

`Acquisition` reads a source in a thread of its own.
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
    """One picture and when it was captured.

    Attributes:
        image: (height, width, 3) uint8 blue, green, red; of a depth camera, (height, width) uint16 units.
        time_ns: of the capture, on the source's own clock, above 0 and rising.
        number: 0, 1, 2, … of the source.
        ready_s: when it was there to be looked at, on this machine's monotonic clock.
        retrieval_s: how long it took to decode, without the waiting for it.
    """

    image: Image
    time_ns: int
    number: int
    ready_s: float
    retrieval_s: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.image.shape[1], self.image.shape[0]


@dataclass(frozen=True)
class SourceState:
    """How a source was set when it was opened.

    Attributes:
        size_px: (width, height) that it says its pictures have; None where only a picture can say it.
        fps: pictures a second that were asked for, or that it says it gives; None where nobody knows.
        controls: as they were read back.
        problems: what was asked for and could not be set, in sentences that say what to do.
        unit_m: of a depth camera, metres a unit.
        lens: of a depth camera, the nine numbers of `mocapella.geometry.lens`.
    """

    size_px: tuple[int, int] | None = None
    fps: float | None = None
    controls: CameraControls = field(default_factory=CameraControls)
    problems: tuple[str, ...] = ()
    unit_m: float | None = None
    lens: tuple[float, ...] | None = None


class PictureSource(Protocol):
    """What gives pictures. It is opened and read in one thread at a time; waiting in it ends when ``stop`` is set."""

    name: str
    """As the user wrote it."""
    live: bool
    """Whether it is lost, and looked for again, when there is no picture; others have ended."""
    times: str
    """Where its times come from, in words."""

    def open(self) -> SourceState:
        """Make it ready; it may be opened again after `close`.

        Raises:
            InputError: it cannot be opened; says what can.
        """
        ...

    def begin(self, zero_s: float) -> None:
        """When its time 0 is, on the monotonic clock; cameras have a clock of their own, and do not mind."""
        ...

    def read(self, stop: threading.Event) -> Picture | None:
        """The next picture, when it is there; None where there is none any more."""
        ...

    def close(self) -> None:
        """Give back what it holds."""
        ...
