"""The bodies of a frame that a sensor tracks, in an order that does not depend on the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import BodyFrame, JointState
from mocapella.model.topology import Topology

BodyKey = tuple[str, int]
"""(sensor, tracking id) of a body, constant until that sensor loses it."""


def body_name(tracking_id: int) -> str:
    """Return a label: ``body 7``, or of a longer id, such as a Kinect's of 17 digits, the last three: ``body …123``."""
    return f"body {tracking_id}" if tracking_id < 1000 else f"body …{tracking_id % 1000:03d}"


class Bodies(msgspec.Struct, frozen=True, eq=False):
    """The tracked bodies of a frame, in the order of their ids.

    Attributes:
        sensor: name of the sensor.
        topology: names and order of the joints.
        ids: (bodies,) tracking ids, ascending.
        positions: (bodies, joints, 3) float64, camera space: x to the sensor's left, y up, z out of the lens [m]; NaN
            where not tracked.
        states: (bodies, joints) `JointState`.
    """

    sensor: str
    topology: Topology
    ids: tuple[int, ...]
    positions: NDArray[np.float64]
    states: NDArray[np.uint8]

    @property
    def numbers(self) -> NDArray[np.uint64]:
        """(bodies,) tracking ids, of `id_array`."""
        return id_array(self.ids)

    @property
    def keys(self) -> tuple[BodyKey, ...]:
        """(bodies,) sensor and tracking id of each body."""
        return tuple((self.sensor, body) for body in self.ids)

    def only(self, kept: NDArray[np.bool_]) -> Bodies:
        """Return the bodies where ``kept`` (bodies,) is True, in the same order; arrays are copies."""
        ids = tuple(body for body, stays in zip(self.ids, kept.tolist(), strict=True) if stays)
        return Bodies(self.sensor, self.topology, ids, self.positions[kept], self.states[kept])


def id_array(ids: Sequence[int]) -> NDArray[np.uint64]:
    """Return tracking ids as an array (bodies,); all callers with the same ids share it, and must not change it."""
    return _id_array(tuple(ids))


@lru_cache(maxsize=256)
def _id_array(ids: tuple[int, ...]) -> NDArray[np.uint64]:
    return np.array(ids, dtype=np.uint64)


def tracked_bodies(frame: BodyFrame) -> Bodies:
    """Return the tracked bodies of a frame, sorted by id, so that results do not depend on the frame's order.

    A joint at (0, 0, 0), where the camera is, counts as not tracked. Arrays are writable copies; without a tracked
    body, they have the length 0.
    """
    ids: list[int] = frame.tracking_ids.tolist()
    positions, states = frame.positions, frame.states
    tracked: list[bool] = frame.tracked.tolist()
    if not all(tracked) or ids != sorted(ids):
        rows = sorted((i for i, is_tracked in enumerate(tracked) if is_tracked), key=ids.__getitem__)
        ids, copy, states = [ids[i] for i in rows], positions[rows].astype(np.float64, copy=False), states[rows]
    else:  # Copies: a message's arrays are read-only, which is another type for numba.
        copy, states = positions.astype(np.float64), states.copy()
    if np.count_nonzero(copy) < copy.size:
        nowhere = ~copy.any(axis=-1)
        copy[nowhere], states[nowhere] = np.nan, JointState.NOT_TRACKED
    return Bodies(frame.sensor, frame.topology, tuple(ids), copy, states)
