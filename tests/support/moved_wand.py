"""A wand that is moved about: what a server says of it, and what another tracker says, late and in its own space."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.observations import JointState
from mocapella.model.poses import pose_frame, quaternion_of
from mocapella.model.scene import Phase, Scene, TrackedObject, TrackedPoints, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import topology

T_WORLD_VR = rigid(exp_twist([0, 0, 0, 0.1, 1.0, -0.2])[:3, :3], [0.5, -1.0, 2.0])
ON_BODY = rigid(exp_twist([0, 0, 0, 0.4, 0, 0])[:3, :3], [0.01, 0.05, -0.02])
DELAY_S = 0.03
HZ = 50
_CLOCK_NS = 77_000_000_000
"""Of the other tracker's clock before ours."""


def wand(t: float, turned: float = 0.7, far: float = 0.15, axes: int = 3) -> np.ndarray:
    """``T_world_body`` at a time [s]."""
    phi = turned * np.sin(np.array([2.0, 3.1, 1.6]) * t + [0, 1, 2]) * (np.arange(3) < axes)
    return rigid(exp_twist([0, 0, 0, *phi])[:3, :3], far * np.sin(np.array([1.5, 2.2, 2.9]) * t))


def moved(
    seconds: float, motion: Callable[[float], np.ndarray] = wand, *, spaces: tuple[str, ...] = ("vr",),
    noise_m: float = 0.0, seed: int = 0, begin: int = 0,
) -> Iterator[tuple[Scene, SensorFrame | None]]:  # fmt: skip
    """The scenes of a camera, and those of the other tracker's frames, which repeat the camera's last places."""
    rng = np.random.default_rng(seed)
    state, sd, two = TrackerState(Phase.TRACKING), np.array([0.001], np.float32), np.array([2], np.uint8)
    step = begin * (1 + len(spaces))
    for k in range(begin, begin + round(seconds * HZ)):
        seen = motion(k / HZ) @ ON_BODY
        seen[:3, 3] += rng.normal(0, noise_m, 3)
        thing = TrackedObject("wand", seen, np.zeros((2, 3)), JointState.TRACKED)
        points = TrackedPoints(("cyan",), seen[None, :3, 3], sd, two)
        for sensor, after_s in (("left", 0.0), *((space, 0.011) for space in spaces)):
            t = k / HZ + after_s
            at_ns = round(1e9 * (1 + t))
            frame = None
            if sensor != "left":
                T = inverse(T_WORLD_VR) @ motion(t - DELAY_S)
                frame = pose_frame(
                    sensor, sensor, ["LHR-1"], time_ns=at_ns + _CLOCK_NS, positions=[T[:3, 3]],
                    orientations=[quaternion_of(T[:3, :3])], node_id=7, sequence=k,
                )  # fmt: skip
            yield (
                Scene(step, at_ns, sensor, 7, k, topology("hand"), state, {"points": (points,), "objects": (thing,)}),
                frame,
            )
            step += 1
