"""Observations of markers in one camera's image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.sensor_frame import SensorFrame

Float32 = NDArray[np.float32]


class MarkerFrame(SensorFrame, frozen=True, eq=False):
    """The markers that one camera saw at one instant.

    Attributes:
        time_ns: capture of the first row, mid-exposure; else see `SensorFrame`.
        size_px: (width, height) of the image.
        names: (markers,) names of all markers that the detector looks for.
        positions_px: (markers, 2) x, y, with the lens' distortion [px]; the centre of the first pixel is (0, 0). NaN
            where the marker is not seen.
        sd_px: (markers,) standard deviation of a coordinate [px]; NaN where not seen.
        areas_px: (markers,) number of the marker's pixels; 0 where not seen.
        confidences: (markers,) confidence of each marker, 0 to 1.
        elongations: (markers,) long axis over short axis of the marker's region, NaN where not seen. Like
            ``candidates``, it is not part of a message, so None in a frame from a node or a take.
        candidates: (markers,) number of the image's regions that could be the marker; at most 255; None as above.
    """

    size_px: tuple[int, int]
    names: tuple[str, ...]
    positions_px: Float32
    sd_px: Float32
    areas_px: Float32
    confidences: Float32
    elongations: Float32 | None = None
    candidates: NDArray[np.uint8] | None = None

    @property
    def found(self) -> NDArray[np.bool_]:
        """(markers,) whether each marker is seen."""
        return np.asarray(np.isfinite(self.positions_px).all(axis=-1))

    @property
    def bodies(self) -> int:
        """Number of visible markers, which the sensor table shows."""
        return int(self.found.sum())


def marker_frame(
    sensor: str,
    names: Sequence[str],
    *,
    time_ns: int,
    size_px: tuple[int, int],
    positions_px: Any,
    sd_px: Any = 0.3,
    areas_px: Any = 0.0,
    confidences: Any = 1.0,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
) -> MarkerFrame:
    """Make a `MarkerFrame` of array-likes, which are copied; scalars apply to all visible markers.

    A marker with a coordinate that is not finite is not seen. ``elongations`` and ``candidates`` are None.

    Args:
        sensor: name of the camera.
        names: names of all markers that the detector looks for.
        time_ns: capture time of the first row, mid-exposure, on the camera's own clock.
        size_px: (width, height) of the image.
        positions_px: (markers, 2) x, y, with the lens' distortion [px].
        sd_px: standard deviation of a coordinate [px].
        areas_px: number of each marker's pixels.
        confidences: confidence of each marker, 0 to 1.
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.

    Raises:
        SettingsError: names that are empty or not unique, or a shape that does not fit their number.
    """
    n = len(names)
    if len(set(names)) != n or not all(names):
        raise SettingsError(f"markers {', '.join(map(repr, names))}: each wants a name of its own")
    positions = np.array(positions_px, dtype=np.float32)
    if positions.shape != (n, 2):
        raise SettingsError(f"positions_px has the shape {positions.shape}; {n} markers want {(n, 2)}")
    seen = np.isfinite(positions).all(axis=-1)
    positions[~seen] = np.nan

    def filled(value: Any, where_not: float, what: str) -> Float32:
        array = np.array(value, dtype=np.float32)
        if array.shape not in ((), (n,)):
            raise SettingsError(f"{what} has the shape {array.shape}; {n} markers want one number or ({n},)")
        return np.where(seen, array, np.float32(where_not))

    return MarkerFrame(
        sensor, node_id, sequence, int(time_ns), int(sent_ns), size_px, tuple(names), positions,
        filled(sd_px, np.nan, "sd_px"), filled(areas_px, 0.0, "areas_px"), filled(confidences, 0.0, "confidences"),
    )  # fmt: skip


def joined(frame: MarkerFrame, *others: MarkerFrame) -> MarkerFrame:
    """Join several detectors' markers of one image, with time, node and sequence number of the first frame.

    The frames are not changed. Elongations are NaN, and candidates 0, for markers of a frame without them, or None if
    no frame has them.

    Raises:
        SettingsError: they are of different cameras or sizes, or two have a marker of one name.
    """
    frames = (frame, *others)
    for other in others:
        if (other.sensor, other.size_px) != (frame.sensor, frame.size_px):
            raise SettingsError(
                f"markers of {other.sensor}, {other.size_px}, cannot be joined to the markers of {frame.sensor}, "
                f"{frame.size_px}: only those of one picture can"
            )
    names = tuple(name for one in frames for name in one.names)
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise SettingsError(f"two detectors call a marker {', '.join(map(repr, twice))}: give it another name")

    def together(field: str, unsaid: float, dtype: Any) -> Any:
        told = [getattr(one, field) for one in frames]
        if all(values is None for values in told):
            return None
        filled = [
            np.full(len(one.names), unsaid, dtype) if values is None else values
            for one, values in zip(frames, told, strict=True)
        ]
        return np.concatenate(filled)

    return msgspec.structs.replace(
        frame,
        names=names,
        positions_px=together("positions_px", np.nan, np.float32),
        sd_px=together("sd_px", np.nan, np.float32),
        areas_px=together("areas_px", 0.0, np.float32),
        confidences=together("confidences", 0.0, np.float32),
        elongations=together("elongations", np.nan, np.float32),
        candidates=together("candidates", 0, np.uint8),
    )
