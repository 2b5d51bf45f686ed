"""Where a server expects people in a camera's images: boxes for the detector of the camera's node (docs/wire.md)."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_json
from mocapella.errors import InputError, WireError

Float32 = NDArray[np.float32]

MOST_REGIONS: Final = 32
"""Largest number of boxes of one message."""
MAX_BYTES: Final = 8192
"""Largest size of a message [bytes]."""
FARTHEST_PX: Final = 1e5
"""Largest coordinate of a box [px]."""


class ExpectedPeople(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Boxes where people are expected in a camera's next image.

    Attributes:
        time_ns: capture time of the frame that the expectation follows, on the camera's clock [ns].
        regions_px: left, top, right, bottom of each person's box [px].
    """

    time_ns: int
    regions_px: tuple[tuple[float, float, float, float], ...]

    @property
    def boxes(self) -> Float32:
        """The boxes (people, 4) [px]."""
        return np.array(self.regions_px, np.float32).reshape(-1, 4)


def write_expected(time_ns: int, regions_px: Float32) -> bytes:
    """Encode boxes (people, 4), at most the first `MOST_REGIONS`; ``time_ns`` as in `ExpectedPeople`."""
    rows = np.round(regions_px[:MOST_REGIONS].astype(np.float64), 1).tolist()
    return msgspec.json.encode(ExpectedPeople(time_ns, tuple(tuple(row) for row in rows)))


def read_expected(data: bytes) -> ExpectedPeople:
    """Decode a message of `write_expected`.

    Raises:
        WireError: it is too long, no such JSON or of too many boxes, or a box has its left or top beyond its right or
            bottom, or a coordinate beyond `FARTHEST_PX`.
    """
    if len(data) > MAX_BYTES:
        raise WireError(f"{len(data)} bytes of expected people; at most {MAX_BYTES} are read")
    try:
        found = decode_json(data, ExpectedPeople, what="message about expected people")
    except InputError as error:
        raise WireError(str(error)) from error
    boxes = found.regions_px
    if len(boxes) > MOST_REGIONS or any(abs(value) > FARTHEST_PX for box in boxes for value in box):
        raise WireError(f"{len(boxes)} boxes; at most {MOST_REGIONS} within ±{FARTHEST_PX:g} px are read")
    if any(left > right or top > bottom for left, top, right, bottom in boxes):
        raise WireError("a box's left or top is beyond its right or bottom")
    return found
