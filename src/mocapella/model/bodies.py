"""The bodies of a frame that a sensor tracks, in an order that does not depend on the sensor."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import BodyFrame
from mocapella.model.topology import Topology

BodyKey = tuple[str, int]
"""(sensor, tracking id): one body for as long as that sensor does not lose it."""


def body_name(tracking_id: int) -> str:
    """A body in a text for people: real sensors count in 17 digits, of which the last three tell bodies apart."""
    return f"body {tracking_id}" if tracking_id < 1000 else f"body …{tracking_id % 1000:03d}"


class Bodies(msgspec.Struct, frozen=True, eq=False):
    """What a frame says of the bodies that are tracked, in the order of their ids.

    Attributes:
        sensor: whose they are.
        topology: which joints.
        ids: (bodies,) tracking ids, ascending.
        positions: (bodies, joints, 3) float64, camera space [m]; NaN where not tracked.
        states: (bodies, joints) `JointState`.
    """

    sensor: str
    topology: Topology
    ids: tuple[int, ...]
    positions: NDArray[np.float64]
    states: NDArray[np.uint8]

    @property
    def keys(self) -> tuple[BodyKey, ...]:
        """(bodies,) what identifies each."""
        return tuple((self.sensor, body) for body in self.ids)

    def only(self, kept: NDArray[np.bool_]) -> Bodies:
        """Those of the bodies; kept (bodies,)."""
        ids = tuple(body for body, stays in zip(self.ids, kept.tolist(), strict=True) if stays)
        return Bodies(self.sensor, self.topology, ids, self.positions[kept], self.states[kept])


def tracked_bodies(frame: BodyFrame) -> Bodies:
    """The tracked bodies of a frame, sorted by id, so that what follows does not depend on the order in the frame."""
    ids: list[int] = frame.tracking_ids.tolist()
    positions, states = frame.positions, frame.states
    if not frame.tracked.all() or ids != sorted(ids):
        tracked: list[bool] = frame.tracked.tolist()
        rows = sorted((i for i, is_tracked in enumerate(tracked) if is_tracked), key=ids.__getitem__)
        ids, positions, states = [ids[i] for i in rows], positions[rows], states[rows]
    # Arrays of their own: those of a message cannot be written, which to a compiler is another type.
    return Bodies(frame.sensor, frame.topology, tuple(ids), positions.astype(np.float64), states.copy())
