"""What one colour camera saw of coloured markers at one instant: positions in its image, no image."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.observations import check_sensor_name

Float32 = NDArray[np.float32]


class MarkerFrame(msgspec.Struct, frozen=True, eq=False):
    """The markers in one image of one camera; arrays over markers, in the order of their names.

    A frame is identified by (camera, node_id, sequence), as a `BodyFrame` is. Pixels are OpenCV's: x to the right,
    y down, the middle of the first pixel is (0, 0), and nothing is rectified.

    Attributes:
        camera: the camera's name.
        node_id: random number of the process that serves the camera, new at each start.
        sequence: 0, 1, 2, … of that process.
        time_ns: when the image was captured, on the camera's own clock.
        sent_ns: when the node published it, on the node's monotonic clock; 0 where there was no node.
        size_px: (width, height) of the image.
        names: of the markers, each once.
        positions_px: (markers, 2) float32 the centres; NaN where not seen.
        sd_px: (markers,) float32 expected standard deviation of either coordinate of a centre; NaN where not seen.
        areas_px: (markers,) float32 pixels of the marker's colour; 0 where not seen.
        elongations: (markers,) float32 long axis over short axis; NaN where not seen.
        confidences: (markers,) float32 0 … 1, how much it looks like the marker; 0 where not seen.
        candidates: (markers,) uint8 how many pieces of the image could have been it; 255 stands for more, too.
    """

    camera: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    size_px: tuple[int, int]
    names: tuple[str, ...]
    positions_px: Float32
    sd_px: Float32
    areas_px: Float32
    elongations: Float32
    confidences: Float32
    candidates: NDArray[np.uint8]

    @property
    def found(self) -> NDArray[np.bool_]:
        """(markers,) which are seen."""
        return np.asarray(np.isfinite(self.positions_px).all(axis=-1))

    @property
    def key(self) -> tuple[str, int, int]:
        """What identifies the frame: (camera, node_id, sequence)."""
        return self.camera, self.node_id, self.sequence


def marker_frame(
    camera: str,
    names: tuple[str, ...],
    positions_px: Any,
    *,
    time_ns: int,
    size_px: tuple[int, int],
    sd_px: Any = 1.0,
    areas_px: Any = 1.0,
    elongations: Any = 1.0,
    confidences: Any = 1.0,
    candidates: Any = 1,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
) -> MarkerFrame:
    """A `MarkerFrame` of array-likes, with shapes checked; where a marker is not seen, nothing else is said of it.

    Raises:
        SettingsError: the camera's name cannot be used, a marker's name comes twice or is empty, or a shape does not
            fit the number of names.
    """
    count = len(names)
    for name in names:
        if not name or names.count(name) > 1:
            raise SettingsError(f"marker name {name!r} cannot be used: every marker has a name of its own")

    def filled(value: Any, dtype: Any, tail: tuple[int, ...], what: str) -> NDArray[Any]:
        array = np.array(value, dtype=dtype)
        if array.shape not in ((), (count, *tail)):
            raise SettingsError(f"{what} has the shape {array.shape}; {count} markers want {(count, *tail)}")
        return np.array(np.broadcast_to(array, (count, *tail)))

    positions = filled(positions_px, np.float32, (2,), "positions_px")
    gone = ~np.isfinite(positions).all(axis=-1)
    values = {
        "sd_px": (filled(sd_px, np.float32, (), "sd_px"), np.nan),
        "areas_px": (filled(areas_px, np.float32, (), "areas_px"), 0),
        "elongations": (filled(elongations, np.float32, (), "elongations"), np.nan),
        "confidences": (filled(confidences, np.float32, (), "confidences"), 0),
    }
    positions[gone] = np.nan
    for array, nothing in values.values():
        array[gone] = nothing
    return MarkerFrame(
        camera=check_sensor_name(camera),
        node_id=node_id,
        sequence=sequence,
        time_ns=int(time_ns),
        sent_ns=int(sent_ns),
        size_px=size_px,
        names=names,
        positions_px=positions,
        candidates=filled(candidates, np.uint8, (), "candidates"),
        **{key: array for key, (array, _) in values.items()},
    )
