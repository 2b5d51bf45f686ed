"""Synthetic keypoints on which the kernels of the method ``webcams`` are compiled."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import HandPose, hand_model
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.topology import topology
from mocapella.tracker.webcams import WebcamsTracker

Float64 = NDArray[np.float64]

_SIZE: Final = (640, 480)
_LENS: Final = np.array([530.0, 530.0, 319.5, 239.5, -0.05, 0.0, 0.0, 0.0, 0.0])
_RATE_HZ: Final = 30
_LATE_NS: Final = 4_000_000
"""Time between a camera's image of the hand and that of the next camera [ns]."""
_STANDING: Final = {
    "Nose": (0.0, 1.58, 0.1), "Eye": (0.03, 1.61, 0.08), "Ear": (0.07, 1.6, 0.0), "Shoulder": (0.18, 1.4, 0.0),
    "Elbow": (0.22, 1.12, 0.0), "Wrist": (0.24, 0.87, 0.05), "Hip": (0.1, 0.92, 0.0), "Knee": (0.11, 0.5, 0.02),
    "Ankle": (0.11, 0.08, 0.0), "Head": (0.0, 1.74, 0.0), "Neck": (0.0, 1.42, 0.0), "BigToe": (0.13, 0.02, 0.18),
    "SmallToe": (0.17, 0.02, 0.15), "Heel": (0.1, 0.02, -0.05),
}  # fmt: skip
"""Joints of a person of 1.74 m who faces z, without side: x of the left one, height, and z [m]."""


_REST: Final = HandPose(hand_model("full").natural, rigid(np.eye(3), (0.0, 1.0, 0.0)))
"""A hand at rest, between the cameras."""


def standing_person() -> Float64:
    """Return the joints of ``halpe_26`` (26, 3) of a standing person who faces z; y is up [m]."""
    joints = []
    for name in topology("halpe_26").joints:
        middle = name in _STANDING and name != "Hip"
        x, y, z = _STANDING[name if name in _STANDING else name[1:]]
        joints.append((0.0 if middle or name == "Hip" else x if name[0] == "L" else -x, y, z))
    return np.array(joints)


def circle_of_cameras(count: int, radius_m: float = 3.5, height_m: float = 1.8) -> CameraRig:
    """Return cameras around the origin that look at its middle, y up; their names are ``cam-0``, ….

    Args:
        count: number of cameras.
        radius_m: distance from the vertical axis [m].
        height_m: height over the floor [m].
    """
    cameras = {}
    for i in range(count):
        angle = 2.0 * np.pi * i / count
        centre = np.array([radius_m * np.sin(angle), height_m, radius_m * np.cos(angle)])
        forward = np.array([0.0, 1.0, 0.0]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        name = f"cam-{i}"
        T = rigid(R, -R @ centre)
        cameras[name] = PlacedCamera(Camera(name, _SIZE, _LENS), T, np.full((6, 6), np.nan))
    return CameraRig(cameras)


def seen_people(rig: CameraRig, people: list[Float64], *, at_ns: int, sequence: int = 0) -> list[Arrival]:
    """Return the frame of each camera of people without occlusion and noise, all at one time.

    Args:
        rig: the cameras.
        people: (26, 3) joints of each person, world [m].
        at_ns: capture time [ns].
        sequence: number of the frames.
    """
    arrivals = []
    for name, placed in sorted(rig.cameras.items()):
        lens, size = placed.camera.lens, placed.camera.size_px
        px = np.array([project(apply(placed.T_camera_world, one), lens) for one in people]).reshape(-1, 26, 2)
        outside = ((px < 0) | (px > np.array(size) - 1)).any(axis=-1)
        px[outside] = np.nan
        frame = keypoint_frame(
            name, topology("halpe_26"), time_ns=at_ns, size_px=size, positions_px=px, confidences=0.9, sequence=sequence
        )
        arrivals.append(Arrival(frame, at_ns))
    return arrivals


def warm_up_tracker() -> WebcamsTracker:
    """Return a tracker with three cameras."""
    return WebcamsTracker(circle_of_cameras(3))


def warm_up_arrivals() -> Iterator[Arrival]:
    """Yield frames of a person who moves, is seen by one camera only, and by none; then of a hand.

    One camera sees a hand beside the person once. The cameras' images of the hand alone are of different times.
    """
    rig, joints = circle_of_cameras(3), standing_person()
    hand = landmarks(hand_chain(hand_model("full"), hand_model("full").shape("left")), _REST)
    for k in range(20):
        people = [joints + np.array([0.02 * k, 0.0, 0.0])] if k < 16 else []
        at_ns = 1_000_000_000 + k * 1_000_000_000 // _RATE_HZ
        for i, arrival in enumerate(seen_people(rig, people, at_ns=at_ns, sequence=k)):
            if i == 0 and k == 9:
                yield _seen_hand(rig, arrival.frame.sensor, hand, at_ns, k)
            elif i == 0 or not 10 <= k < 13:
                yield arrival
    for k in range(20, 24):
        at_ns = 1_000_000_000 + k * 1_000_000_000 // _RATE_HZ
        for i, name in enumerate(sorted(rig.cameras)):
            if i == 0 or k < 23:
                yield _seen_hand(rig, name, hand, at_ns + i * _LATE_NS, k)


def _seen_hand(rig: CameraRig, name: str, hand: Float64, at_ns: int, sequence: int) -> Arrival:
    placed = rig.cameras[name]
    px = project(apply(placed.T_camera_world, hand), placed.camera.lens)
    frame = keypoint_frame(
        name, topology("hand"), time_ns=at_ns, size_px=_SIZE, positions_px=px[None], confidences=0.9, sequence=sequence
    )
    return Arrival(frame, at_ns)
