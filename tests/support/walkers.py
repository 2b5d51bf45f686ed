"""Made-up people who walk before made-up sensors: what the view's tests look at."""

from __future__ import annotations

import numpy as np

from mocapella.model.observations import BodyFrame, JointState, body_frame
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, TrackerState
from mocapella.model.topology import topology
from mocapella.testing import sensor_health as health
from mocapella.testing import session_status as status
from mocapella.viewer.layout import Look

__all__ = ["HEIGHT_M", "KINECT", "Room", "health", "in_picture", "rigid", "standing", "status", "turn"]

KINECT = topology("kinect_v2")
HEIGHT_M = 1.1
# x to the left of who looks at it, y over the floor, z towards where it goes; standing, arms a little out.
_BODY = {
    "SpineBase": (0, 0.95, 0), "SpineMid": (0, 1.2, 0), "SpineShoulder": (0, 1.43, 0), "Neck": (0, 1.5, 0),
    "Head": (0, 1.66, 0), "ShoulderLeft": (0.18, 1.4, 0), "ElbowLeft": (0.25, 1.13, 0), "WristLeft": (0.29, 0.9, 0.03),
    "HandLeft": (0.3, 0.82, 0.05), "HandTipLeft": (0.3, 0.74, 0.06), "ThumbLeft": (0.26, 0.8, 0.1),
    "HipLeft": (0.09, 0.91, 0), "KneeLeft": (0.1, 0.5, 0.02),
    "AnkleLeft": (0.1, 0.08, 0), "FootLeft": (0.11, 0.03, 0.13),
}  # fmt: skip


def standing(step: float = 0.0) -> np.ndarray:
    """(25, 3), a body in mid-stride; ``step`` is the phase of its walk [rad]."""
    p = np.zeros((25, 3))
    for name, (x, y, z) in _BODY.items():
        p[KINECT.index(name)] = x, y, z
        if name.endswith("Left"):
            p[KINECT.index(name.replace("Left", "Right"))] = -x, y, z
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        swing = 0.3 * sign * np.sin(step)
        for joint, share in (("Knee", 0.5), ("Ankle", 1.0), ("Foot", 1.0)):
            p[KINECT.index(joint + side), 2] += swing * share
            p[KINECT.index(joint + side), 1] += 0.12 * share * max(0.0, -sign * np.cos(step))
        for joint, share in (("Elbow", 0.4), ("Wrist", 0.9), ("Hand", 1.0), ("HandTip", 1.1), ("Thumb", 1.0)):
            p[KINECT.index(joint + side), 2] -= swing * share
    return p


def turn(angle: float) -> np.ndarray:
    """(3, 3), about +y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rigid(angle: float, t: tuple[float, float, float]) -> np.ndarray:
    """(4, 4), a turn about +y and a translation."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn(angle), t
    return T


def in_picture(look: Look, points: np.ndarray, aspect: float) -> np.ndarray:
    """(n, 2) of each point in the camera's picture, −1 to 1, rightwards and upwards."""
    forward = look.target - look.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right)
    up = np.cross(right, forward)
    relative = points - look.position
    depth = relative @ forward
    assert (depth > 0).all()
    half = np.tan(look.fov / 2)
    return np.stack([relative @ right / depth / half / aspect, relative @ up / depth / half], axis=-1)


class Room:
    """People on circles, seen by sensors around them; the world is the first sensor's, at its height."""

    def __init__(self, people: int = 2, sensors: int = 3, *, first_id: int = 1, seed: int = 1) -> None:
        self.people, self.sensors, self.first_id = people, sensors, first_id
        self.names = ["front", "left", "right", "back", "aisle", "ceiling"][:sensors]
        spread = np.linspace(0, 2 * np.pi, sensors, endpoint=False) if sensors > 3 else np.array([0, 0.85, -0.85])
        centre = np.array([0.0, 0.0, 2.6])
        self.T_world = []
        for angle in spread[:sensors]:
            place = centre + turn(angle) @ np.array([0.0, 0.0, -2.6])
            self.T_world.append(rigid(angle, tuple(place)))
        self._noise = np.random.default_rng(seed)
        self._bias = self._noise.normal(0, 0.03, (sensors, 25, 3))

    def truth(self, t: float) -> np.ndarray:
        """(people, 25, 3), in the world, at ``t`` seconds."""
        bodies = []
        for k in range(self.people):
            around = 0.55 * t + 2 * np.pi * k / max(self.people, 1)
            place = np.array([1.15 * np.cos(around), -HEIGHT_M, 2.6 + 0.75 * np.sin(around)])
            heading = -around if self.people > 1 else np.pi
            bodies.append(standing(4.2 * t + k) @ turn(heading).T + place)
        return np.array(bodies)

    def frames(self, t: float) -> dict[str, BodyFrame]:
        """Each sensor's frame; some far joints are inferred."""
        truth, frames = self.truth(t), {}
        for s, name in enumerate(self.names):
            T = np.linalg.inv(self.T_world[s])
            seen = truth @ T[:3, :3].T + T[:3, 3] + self._bias[s] + self._noise.normal(0, 0.006, truth.shape)
            states = np.full(truth.shape[:2], JointState.TRACKED, np.uint8)
            far = KINECT.index("WristRight") if s % 2 else KINECT.index("WristLeft")
            states[:, far : far + 2] = JointState.INFERRED
            frames[name] = body_frame(
                name, KINECT, time_ns=int(t * 1e9), positions=seen, states=states, height=HEIGHT_M, sequence=int(t * 30)
            )
        return frames

    def scene(self, t: float, frames: dict[str, BodyFrame]) -> Scene:
        """What a perfect tracker would make of the frames."""
        people = []
        for k in range(self.people):
            views = []
            for s, name in sorted(enumerate(self.names), key=lambda pair: pair[1]):
                T, frame = self.T_world[s], frames[name]
                positions = frame.positions[k].astype(np.float64) @ T[:3, :3].T + T[:3, 3]
                views.append(PotentialSkeleton(name, k, frame.time_ns, 0.0, HEIGHT_M, T, positions, frame.states[k]))
            fused = np.mean([view.positions for view in views], axis=0)
            states = np.max([view.states for view in views], axis=0).astype(np.uint8)
            people.append(Person(self.first_id + k, fused, states, tuple(views)))
        state = TrackerState(Phase.TRACKING)
        return Scene(int(t * 30), int(t * 1e9), "front", 0, int(t * 30), KINECT, state, {"people": tuple(people)})
