"""Turn simultaneous images into arrivals for a tracker."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.model.images import image_frame
from mocapella.model.observations import Arrival

UInt8 = NDArray[np.uint8]


def arrivals_of(
    images: Mapping[str, UInt8],
    time_ns: int,
    *,
    cameras: Iterable[str] | None = None,
    number: int = 0,
    empty_room: bool = False,
) -> list[Arrival]:
    """Return the arrivals of simultaneous images, without copying them, for the tracking of files.

    Args:
        images: (height, width, 3) uint8 BGR, by camera.
        time_ns: capture time, on the common clock.
        cameras: names of the rig's cameras; a camera without an image gets an arrival with an empty image. None: the
            keys of ``images``.
        number: sequence number of the frames.
        empty_room: whether the images show the room without people.

    Raises:
        SettingsError: an array has another shape or type.
    """
    names = images if cameras is None else cameras
    frames = (
        image_frame(name, images.get(name), time_ns=time_ns, sequence=number, empty_room=empty_room) for name in names
    )
    return [Arrival(frame, time_ns) for frame in frames]
