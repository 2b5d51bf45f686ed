"""Depth images as frames."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt16 = NDArray[np.uint16]


IMAGES_SUFFIX: Final = ".depth"
"""Suffix of the sensor name under which a node that detects arms also sends its depth images."""


class DepthFrame(SensorFrame, frozen=True, eq=False):
    """A depth image of one camera.

    Attributes:
        depth: (height, width) uint16 distance along the optical axis in units; 0 where nothing was measured.
        unit_m: length of a unit [m].
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
    """

    depth: UInt16
    unit_m: float
    lens: Float64

    @property
    def for_the_take(self) -> bool:
        """Whether the frame is only for recording: the image that a node sends beside the arms detected in it.

        The names of such images' sensors end with `IMAGES_SUFFIX`.
        """
        return self.sensor.endswith(IMAGES_SUFFIX)

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the image."""
        return self.depth.shape[1], self.depth.shape[0]

    @property
    def metres(self) -> Float32:
        """(height, width) float32 [m], a new array; 0 where nothing was measured."""
        return self.depth * np.float32(self.unit_m)


def depth_frame(
    sensor: str,
    depth: Any,
    *,
    unit_m: float,
    lens: Any,
    time_ns: int,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
) -> DepthFrame:
    """Make a `DepthFrame`; the image is not copied.

    Args:
        sensor: the camera's name.
        depth: (height, width) uint16 distance along the optical axis in whole units; 0 where nothing was measured.
        unit_m: length of a unit [m].
        lens: (4,) fx, fy, cx, cy [px], for a lens without distortion, or (9,) of `mocapella.geometry.lens`.
        time_ns: capture time, on the camera's own clock.
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.

    Raises:
        SettingsError: a depth that is not a uint16 image, or an impossible unit or lens.
    """
    image, numbers = np.asarray(depth), np.asarray(lens, dtype=np.float64)
    if image.ndim != 2 or image.dtype != np.uint16 or 0 in image.shape:
        raise SettingsError(f"depth is {image.dtype} {image.shape}; (height, width) of uint16 is wanted")
    check(1e-6 <= unit_m <= 0.1, "unit_m", unit_m, "metres a unit, such as 0.001")
    if numbers.shape not in ((4,), (9,)) or not np.isfinite(numbers).all() or not (numbers[:2] > 0).all():
        raise SettingsError(f"lens {numbers.tolist()}; fx, fy, cx, cy in pixels are wanted, the first two above 0")
    lens9 = np.concatenate([numbers, np.zeros(9 - len(numbers))])
    return DepthFrame(sensor, node_id, sequence, int(time_ns), int(sent_ns), image, float(unit_m), lens9)
