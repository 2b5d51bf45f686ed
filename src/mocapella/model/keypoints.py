"""Observations of people's keypoints in one camera's image."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import Topology

Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]

NO_ID: Final = -1
"""Id of a detection that the detector does not follow from image to image."""


class KeypointFrame(SensorFrame, frozen=True, eq=False):
    """The keypoints of all people that one camera saw at one instant: arrays over (detections, keypoints).

    Attributes:
        time_ns: capture of the first row, mid-exposure; else see `SensorFrame`.
        size_px: (width, height) of the image.
        topology: names and order of the keypoints.
        ids: (detections,) the detector's ids of the people in this camera, `NO_ID` where it has none.
        positions_px: (detections, keypoints, 2) x, y, with the lens' distortion [px]; the centre of the first pixel is
            (0, 0). NaN where not seen. Detectors also report keypoints a little outside the image.
        confidences: (detections, keypoints) the detector's confidences, 0 to 1; 0 where not seen.
        relative: (detections, keypoints, 3) float32, the detector's own estimate in space, relative to any point of the
            body, in the axes of the camera: x right, y down, z out of the lens [m]; NaN where it has none. None if it
            estimates no depth.
    """

    size_px: tuple[int, int]
    topology: Topology
    ids: Int64
    positions_px: Float32
    confidences: Float32
    relative: Float32 | None = None

    @property
    def found(self) -> NDArray[np.bool_]:
        """(detections, keypoints) whether each keypoint is seen."""
        return np.asarray(np.isfinite(self.positions_px).all(axis=-1))

    @property
    def bodies(self) -> int:
        """Number of detections, which the sensor table shows."""
        return len(self.ids)


def keypoint_frame(
    sensor: str,
    topology: Topology,
    *,
    time_ns: int,
    size_px: tuple[int, int],
    positions_px: Any,
    confidences: Any = 1.0,
    ids: Any = None,
    relative: Any = None,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
) -> KeypointFrame:
    """Make a `KeypointFrame` of array-likes, which are copied.

    A keypoint with a coordinate that is not finite, or without confidence, is not seen.

    Args:
        sensor: name of the camera.
        topology: names and order of the keypoints.
        time_ns: capture time of the first row, mid-exposure, on the camera's own clock.
        size_px: (width, height) of the image.
        positions_px: (detections, keypoints, 2) x, y, with the lens' distortion [px]; empty if no person is seen.
        confidences: of each keypoint, 0 to 1; a scalar applies to all.
        ids: (detections,) the detector's ids; `NO_ID` for all if None.
        relative: (detections, keypoints, 3), see `KeypointFrame` [m]; None without.
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.

    Raises:
        SettingsError: a shape that does not fit the topology or the number of detections.
    """
    joints = len(topology)
    positions = np.array(positions_px, dtype=np.float32)
    if positions.size == 0:
        positions = positions.reshape(0, joints, 2)
    if positions.ndim != 3 or positions.shape[1:] != (joints, 2):
        raise SettingsError(
            f"positions_px has the shape {positions.shape}; {topology.name} wants (detections, {joints}, 2)"
        )
    count = len(positions)
    sure = np.array(np.broadcast_to(_shaped(confidences, (count, joints), "confidences"), (count, joints)))
    seen = np.isfinite(positions).all(axis=-1) & (sure > 0)
    positions[~seen] = np.nan
    own = np.full(count, NO_ID, np.int64) if ids is None else np.array(ids, dtype=np.int64)
    if own.shape != (count,):
        raise SettingsError(f"ids has the shape {own.shape}; {count} detections want ({count},)")
    depth = None if relative is None else np.array(relative, dtype=np.float32).reshape(count, joints, 3)
    return KeypointFrame(
        sensor, node_id, sequence, int(time_ns), int(sent_ns), size_px, topology, own, positions,
        np.where(seen, sure, np.float32(0.0)), depth,
    )  # fmt: skip


def _shaped(values: Any, shape: tuple[int, ...], field: str) -> Float32:
    array = np.array(values, dtype=np.float32)
    if array.shape not in ((), shape):
        raise SettingsError(f"{field} has the shape {array.shape}; it wants one number or {shape}")
    return array
