"""Poses of rigid bodies from another tracker, in its own frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.model.sensor_frame import SensorFrame

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


class PoseFrame(SensorFrame, frozen=True, eq=False):
    """The bodies of one tracker at one instant.

    Attributes:
        space: name of the other tracker's frame of reference, in which the poses are given; right-handed, metres.
        names: (bodies,) names of the bodies.
        positions: (bodies, 3) [m]; NaN where not tracked.
        orientations: (bodies, 4) unit quaternions w, x, y, z, from the body to the space; NaN where not tracked.
        states: (bodies,) `mocapella.model.observations.JointState`: 2 measured, 1 inferred, 0 not tracked.
    """

    space: str
    names: tuple[str, ...]
    positions: Float32
    orientations: Float32
    states: UInt8

    @property
    def bodies(self) -> int:
        """Number of bodies with a pose, which the sensor table shows."""
        return int((self.states > 0).sum())

    def T_space_body(self, name: str) -> Float64 | None:  # noqa: N802 - the field's notation
        """Return the pose (4, 4) of the body ``name``; None if it is missing or not tracked."""
        if name not in self.names:
            return None
        k = self.names.index(name)
        if not self.states[k]:
            return None
        return rigid(rotation_of(self.orientations[k]), self.positions[k])


def pose_frame(
    sensor: str,
    space: str,
    names: Sequence[str],
    *,
    time_ns: int,
    positions: Any,
    orientations: Any,
    states: Any = None,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
) -> PoseFrame:
    """Make a `PoseFrame` of array-likes, which are copied; bodies with values that are not finite are not tracked.

    Args:
        sensor: name of the sensor.
        space: name of the other tracker's frame of reference.
        names: names of the bodies.
        time_ns: capture time, on the sensor's own clock.
        positions: (bodies, 3) [m].
        orientations: (bodies, 4) quaternions w, x, y, z, which are normalised; a body with one of length 0 is not
            tracked.
        states: (bodies,) `JointState`; tracked if None.
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.

    Raises:
        SettingsError: names that are empty or not unique, a shape that does not fit their number, or an unknown state.
    """
    n = len(names)
    if len(set(names)) != n or not all(names):
        raise SettingsError(f"bodies {', '.join(map(repr, names))}: each wants a name of its own")
    p, q = np.array(positions, dtype=np.float64), np.array(orientations, dtype=np.float64)
    if p.shape != (n, 3) or q.shape != (n, 4):
        raise SettingsError(f"positions {p.shape} and orientations {q.shape}; {n} bodies want {(n, 3)} and {(n, 4)}")
    length = np.linalg.norm(q, axis=-1)
    there = np.isfinite(p).all(axis=-1) & np.isfinite(length) & (length > 1e-6)
    given = np.where(there, 2, 0) if states is None else np.array(states)
    if given.shape != (n,) or not np.isin(given, (0, 1, 2)).all():
        raise SettingsError(f"states {given.tolist()}; {n} bodies want {(n,)} of 0, 1 or 2")
    told = np.where(there, given, 0).astype(np.uint8)
    p[told == 0] = np.nan
    q[told == 0] = np.nan
    q[told > 0] /= length[told > 0, None]
    return PoseFrame(
        sensor, node_id, sequence, int(time_ns), int(sent_ns), space, tuple(names),
        p.astype(np.float32), q.astype(np.float32), told,
    )  # fmt: skip


def rotation_of(quaternions: Any) -> Float64:
    """Return the rotations (..., 3, 3) of quaternions (..., 4), w, x, y, z, which are normalised; NaN stays NaN."""
    q = np.asarray(quaternions, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_of(R: Float64) -> Float64:
    """Return the unit quaternion (4,) w, x, y, z, w ≥ 0, of a rotation (3, 3)."""
    from mocapella.geometry.twists import log_motion

    phi = log_motion(rigid(R, np.zeros(3)))[3:]
    angle = float(np.linalg.norm(phi))
    return np.array([np.cos(0.5 * angle), *(phi * (0.5 * np.sinc(0.5 * angle / np.pi)))])
