"""Keep each sensor's newest frame, and detect silent sensors and unusable frames.

Sensors are not synchronised: each frame is tracked as it arrives, with the other sensors' newest ones. Sensors may have
different topologies: bodies are mapped to the people's skeleton here, frames stay as they came.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import one_of
from mocapella.model.bodies import Bodies, tracked_bodies
from mocapella.model.camera import CameraRig
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.skeleton import SKELETON, mapping_problem, to_skeleton
from mocapella.model.topology import Topology


def time_problem(frame: SensorFrame, last: tuple[int, int] | None) -> str:
    """Return why a frame cannot follow its sensor's last one; empty if it can. A new process may have a new clock.

    Args:
        frame: the newer frame.
        last: ``node_id`` and ``time_ns``, on the sensor's own clock, of the sensor's last frame; None if there is none.
    """
    if last is None or frame.node_id != last[0] or frame.time_ns > last[1]:
        return ""
    return "time goes backwards" if frame.time_ns < last[1] else "repeats the time of the frame before"


def camera_problem(rig: CameraRig, sensor: str, size_px: tuple[int, int] | None = None) -> str:
    """Return why a camera's frame does not belong to a rig, with the remedy; empty if it does.

    Args:
        rig: the rig.
        sensor: name of the camera.
        size_px: width and height of the frame's image [px]; None if they do not matter.
    """
    if sensor not in rig.cameras:
        return f"the rig has no camera {sensor!r}; it has {one_of(sensor, rig.cameras)}"
    size = rig.cameras[sensor].camera.size_px
    if size_px is None or size_px == size:
        return ""
    own = f"{size_px[0]} × {size_px[1]}"
    return f"its images are {own}, the rig's {size[0]} × {size[1]}: calibrate with this size"


class Sighting(msgspec.Struct, frozen=True, eq=False):
    """A sensor's newest frame, its capture time ``at_ns`` on the common clock [ns], and the bodies that it tracks.

    The bodies have the joints of `mocapella.model.skeleton.SKELETON`, whichever the frame has.
    """

    frame: BodyFrame
    at_ns: int
    bodies: Bodies


class Heard(msgspec.Struct, frozen=True, eq=False):
    """Result of an arrival: the usable frames of all sensors at this time, or the reason for its rejection.

    Attributes:
        problem: why the frame cannot be used; empty if it can.
        sensor: name of the sensor.
        node_changed: whether another process serves this sensor now, so that old tracking ids are invalid.
        newest: newest frames of all sensors that are not silent, by name, in the order of names; with this frame. Empty
            if there is a problem.
    """

    problem: str
    sensor: str
    node_changed: bool
    newest: Mapping[str, Sighting]


class Arrivals:
    """Keeps each body sensor's newest frame, leaves out silent sensors, and rejects frames that cannot be used.

    Args:
        silent_after_s: a sensor without a frame for longer is silent [s].

    Attributes:
        topology: topology of all bodies, `mocapella.model.skeleton.SKELETON`; None before the first usable frame.
    """

    def __init__(self, silent_after_s: float) -> None:
        self._silent_after_ns = round(silent_after_s * NS_PER_S)
        self.reset()

    def reset(self) -> None:
        """Forget every sensor."""
        self.topology: Topology | None = None
        self._last: dict[str, Sighting] = {}
        self._now_ns: int | None = None

    def update(self, arrival: Arrival) -> Heard:
        """Store a frame of bodies as its sensor's newest, and return the newest frames of all active sensors.

        A frame is rejected, with the reason and without effect, if its topology has no mapping to the people's
        skeleton, if its time does not rise, or if two bodies have one tracking id. ``arrival.frame`` must be a
        `BodyFrame`.
        """
        frame: Any = arrival.frame
        bodies = tracked_bodies(frame)
        last = self._last.get(frame.sensor)
        node_changed = last is not None and last.frame.node_id != frame.node_id
        if problem := self._problem(frame, bodies, None if node_changed else last):
            return Heard(problem, frame.sensor, False, {})
        self.topology = SKELETON
        self._last[frame.sensor] = Sighting(frame, arrival.at_ns, to_skeleton(bodies))
        self._now_ns = arrival.at_ns if self._now_ns is None else max(self._now_ns, arrival.at_ns)
        if last is None:
            self._last = dict(sorted(self._last.items()))
        spoke_since = self._now_ns - self._silent_after_ns
        newest = {
            sensor: sighting
            for sensor, sighting in self._last.items()
            if sighting.at_ns >= spoke_since or sensor == frame.sensor
        }
        return Heard("", frame.sensor, node_changed, newest)

    def _problem(self, frame: BodyFrame, bodies: Bodies, last: Sighting | None) -> str:
        if problem := mapping_problem(frame.topology):
            return problem
        if problem := time_problem(frame, None if last is None else (last.frame.node_id, last.frame.time_ns)):
            return problem
        if len(set(bodies.ids)) != len(bodies.ids):
            return "two bodies have the same tracking id"
        return ""
