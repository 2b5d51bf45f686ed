"""Observations of one sensor in one frame."""

from __future__ import annotations

import re
from enum import IntEnum, IntFlag
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.names import is_device
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import Topology

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

_SENSOR_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


class JointState(IntEnum):
    """Tracking state of a joint, with the Kinect's numbers."""

    NOT_TRACKED = 0
    INFERRED = 1
    TRACKED = 2


STATE_NAMES: Final = ("unknown", "inferred", "measured")
"""Names of the values 0, 1 and 2 of `JointState` in files."""


class Edge(IntFlag):
    """Edges of a sensor's view that clip a body, with the Kinect's bits."""

    NONE = 0
    RIGHT = 1
    LEFT = 2
    TOP = 4
    BOTTOM = 8


def check_sensor_name(name: str, *, recorded: bool = False) -> str:
    """Return a sensor's name unchanged if it is valid in keys, file names and headings.

    It has 1 to 64 ASCII letters, digits, ``_``, ``-`` or ``.``, and begins with a letter or digit.

    Args:
        name: the name.
        recorded: whether it is from a recorded frame; only then names that Windows reserves, or that end with ``.``,
            are valid, as in older takes.

    Raises:
        SettingsError: the name is not valid; states the rule.
    """
    if not _SENSOR_NAME.fullmatch(name) or not (recorded or _can_be_a_file(name)):
        raise SettingsError(
            f"sensor name {name!r} cannot be used; take 1 to 64 letters, digits, '_', '-' or '.', "
            "beginning with a letter or digit, not ending with '.', and no device of Windows, such as front"
        )
    return name


def _can_be_a_file(name: str) -> bool:
    return not (name.endswith(".") or is_device(name))


class BodyFrame(SensorFrame, frozen=True, eq=False):
    """The skeletons of one sensor's frame: arrays over (bodies, joints), for any number of bodies.

    Attributes:
        topology: names and order of the joints.
        depth_size_px: (width, height) of the sensor's depth image; (0, 0) if it has none.
        tilt: tilt of the sensor, upwards positive [rad].
        height: height of the sensor above the floor [m]; 0 if unknown.
        tracking_ids: (bodies,) uint64, the sensor's own ids, which change after a loss.
        tracked: (bodies,) bool, whether the sensor tracks the body.
        clipped_edges: (bodies,) uint8, `Edge` bits.
        states: (bodies, joints) uint8, `JointState`.
        positions: (bodies, joints, 3) float32, camera space: x to the sensor's left, y up, z out of the lens [m]; NaN
            where not tracked.
        depth_px: (bodies, joints, 2) float32, x, y in the depth image [px]; NaN if unknown; None if all are unknown.
        orientations: (bodies, joints, 4) float32 quaternions (w, x, y, z), from the joint to camera space; NaN if
            unknown; None if all are unknown.
    """

    topology: Topology
    depth_size_px: tuple[int, int]
    tilt: float
    height: float
    tracking_ids: NDArray[np.uint64]
    tracked: NDArray[np.bool_]
    clipped_edges: UInt8
    states: UInt8
    positions: Float32
    depth_px: Float32 | None = None
    orientations: Float32 | None = None

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.tracking_ids)

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Field of view of the sensors with this topology, horizontal and vertical [°]."""
        return self.topology.field_of_view_deg


def body_frame(
    sensor: str,
    topology: Topology,
    *,
    time_ns: int,
    positions: Any,
    states: Any = None,
    tracking_ids: Any = None,
    tracked: Any = None,
    clipped_edges: Any = None,
    depth_px: Any = None,
    orientations: Any = None,
    node_id: int = 0,
    sequence: int = 0,
    sent_ns: int = 0,
    depth_size_px: tuple[int, int] = (0, 0),
    tilt: float = 0.0,
    height: float = 0.0,
) -> BodyFrame:
    """Make a `BodyFrame` of array-likes, which are copied; missing arrays get defaults, shapes are checked.

    The number of bodies is that of ``positions``, none if it is empty. All values of joints that are not tracked become
    NaN.

    Args:
        sensor: name of the sensor.
        topology: names and order of the joints.
        time_ns: capture time, on the sensor's own clock.
        positions: (bodies, joints, 3) camera space: x to the sensor's left, y up, z out of the lens [m].
        states: (bodies, joints) `JointState`; if None, joints with finite coordinates are tracked and others are not.
        tracking_ids: (bodies,) the sensor's ids; 0, 1, … if None.
        tracked: (bodies,) whether the sensor tracks the body; all if None.
        clipped_edges: (bodies,) `Edge` bits; 0 if None.
        depth_px: (bodies, joints, 2) x, y in the depth image [px].
        orientations: (bodies, joints, 4) quaternions (w, x, y, z).
        node_id, sequence, sent_ns: the sending process, the frame's number, and its time of sending on the node's
            clock [ns]; a node sets them when it publishes.
        depth_size_px: (width, height) of the depth image; (0, 0) if there is none.
        tilt: tilt of the sensor, upwards positive [rad].
        height: height of the sensor above the floor [m]; 0 if unknown.

    Returns:
        The frame; ``depth_px`` and ``orientations`` stay None if not given.

    Raises:
        SettingsError: a shape that does not fit the number of bodies or the topology.
    """
    p = np.array(positions, dtype=np.float32)
    bodies, joints = (0 if p.size == 0 else p.shape[0]), len(topology)
    p = p.reshape(0, joints, 3) if bodies == 0 else p

    def filled(value: Any, default: Any, dtype: Any, tail: tuple[int, ...], what: str) -> NDArray[Any]:
        if value is None or (bodies == 0 and np.size(value) == 0):
            return np.full((bodies, *tail), default, dtype=dtype)
        array = np.array(value, dtype=dtype)
        if array.shape != (bodies, *tail):
            raise SettingsError(f"{what} has the shape {array.shape}; {bodies} bodies want {(bodies, *tail)}")
        return array

    filled(p, 0, np.float32, (joints, 3), "positions")
    seen = np.isfinite(p).all(axis=-1)
    s = np.where(seen, np.uint8(JointState.TRACKED), np.uint8(JointState.NOT_TRACKED)) if states is None else states
    s = filled(s, 0, np.uint8, (joints,), "states")
    gone = s == JointState.NOT_TRACKED
    p[gone] = np.nan
    d = None if depth_px is None else filled(depth_px, np.nan, np.float32, (joints, 2), "depth_px")
    q = None if orientations is None else filled(orientations, np.nan, np.float32, (joints, 4), "orientations")
    for optional in (d, q):
        if optional is not None:
            optional[gone] = np.nan
    ids = np.arange(bodies) if tracking_ids is None else tracking_ids
    return BodyFrame(
        sensor=sensor,
        node_id=node_id,
        sequence=sequence,
        time_ns=int(time_ns),
        sent_ns=int(sent_ns),
        topology=topology,
        depth_size_px=depth_size_px,
        tilt=float(tilt),
        height=float(height),
        tracking_ids=filled(ids, 0, np.uint64, (), "tracking_ids"),
        tracked=filled(tracked, True, np.bool_, (), "tracked"),
        clipped_edges=filled(clipped_edges, 0, np.uint8, (), "clipped_edges"),
        states=s,
        positions=p,
        depth_px=d,
        orientations=q,
    )


class Arrival(msgspec.Struct, frozen=True, eq=False):
    """A frame with its capture time ``at_ns``, converted to the common clock, which is the server's.

    ``at_ns`` is a tracker's only time, and it is recorded, so that a replay gives the same results.
    """

    frame: SensorFrame
    at_ns: int
