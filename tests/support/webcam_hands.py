"""Hands of walking people, and hands alone, as keypoints of simulated cameras, for tests of the method webcams."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from support.webcam_people import HALPE, circling, walker

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.model.camera import CameraRig
from mocapella.model.hand import DIGIT_ANGLES, Handedness, HandPose, hand_model
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene, TrackedHand
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
HandAt = Callable[[float], Float64]
Fault = Callable[[str, float, Float64, Float64], tuple[Float64, Float64]]
"""Changes the pixels (detections, keypoints, 2) and confidences (detections, keypoints) of a camera at a time."""

MODEL = hand_model("full")
HALPE_136 = topology("halpe_136")
LEFT, RIGHT = 94, 115
"""First keypoints of the hands in halpe_136."""


def posed(side: Handedness, at_s: float, T_world_palm: Float64, *, length_m: float = 0.185) -> Float64:
    """(21, 3) landmarks of a hand that closes and opens once in two seconds."""
    angles = MODEL.natural.copy()
    for row in DIGIT_ANGLES[1:]:
        angles[row[0]], angles[row[2]] = np.radians([25.0, 35.0]) * (1.0 + 0.8 * np.sin(np.pi * at_s))
        angles[row[3]] = 0.6 * angles[row[2]]
    chain = hand_chain(MODEL, MODEL.shape(side, hand_length_m=length_m))
    return landmarks(chain, HandPose(MODEL.limited(angles), T_world_palm))


def palm_pose(wrist: Float64, forwards: Float64, back: Float64) -> Float64:
    """T_world_palm (4, 4) at a wrist, with the fingers forwards; the back of the hand faces about ``back``."""
    z = forwards / np.linalg.norm(forwards)
    x = np.cross(back, z)
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), wrist)


def person(at_s: float) -> Float64:
    """(26, 3) joints of a person who walks in a circle."""
    return walker(at_s, circling(0.8, 6.0))


def hands_of(joints: Float64, at_s: float) -> tuple[Float64, Float64]:
    """Landmarks (21, 3) of the left and the right hand at the wrists of a person; the backs face outwards."""
    across = joints[HALPE.index("LHip")] - joints[HALPE.index("RHip")]
    left, right = (
        posed(
            side,  # type: ignore[arg-type]
            at_s,
            palm_pose(
                joints[HALPE.index(f"{letter}Wrist")],
                joints[HALPE.index(f"{letter}Wrist")] - joints[HALPE.index(f"{letter}Elbow")],
                sign * across,
            ),
        )
        for side, letter, sign in (("left", "L", 1.0), ("right", "R", -1.0))
    )
    return left, right


def arm_alone(side: Handedness) -> HandAt:
    """A hand without a body that moves and turns at the middle of the cameras."""

    def at(at_s: float) -> Float64:
        turn = 0.5 * np.sin(1.5 * at_s)
        forwards = np.array([np.sin(turn), 0.3, np.cos(turn)])
        wrist = np.array([0.1 * np.sin(2.0 * at_s), 1.0, 0.1 * np.cos(2.0 * at_s)])
        return posed(side, at_s, palm_pose(wrist, forwards, np.array([0.3, 1.0, 0.0])))

    return at


def seen_points(rig: CameraRig, name: str, points: Float64) -> Float64:
    """(n, 2) pixels; NaN outside of the image."""
    placed = rig.cameras[name]
    px = project(apply(placed.T_camera_world, points), placed.camera.lens)
    px[((px < 0) | (px > np.array(placed.camera.size_px) - 1)).any(axis=1)] = np.nan
    return px


def frames(
    rig: CameraRig,
    detections: Callable[[str, float], Sequence[tuple[Float64, Float64]]],
    *,
    seconds: float,
    of: str,
    noise_px: float = 2.0,
    seed: int = 1,
    fault: Fault | None = None,
    offsets_s: Mapping[str, float] | None = None,
) -> list[Arrival]:
    """Frames of all cameras at 30 Hz, in the order of their capture.

    ``detections`` gives for a camera and a time the points (keypoints, 3) and confidences (keypoints,) of each.
    """
    random, own, found = np.random.default_rng(seed), topology(of), []
    events = [(k / 30 + (offsets_s or {}).get(name, 0.0), name, k) for name in rig.cameras for k in range(30 * 60)]
    for at_s, name, k in sorted(event for event in events if event[0] < seconds):
        pixels, sure = [], []
        for points, confidences in detections(name, at_s):
            px = seen_points(rig, name, points)
            pixels.append(px + random.normal(size=px.shape) * noise_px)
            sure.append(confidences)
        px = np.array(pixels).reshape(-1, len(own), 2)
        values = np.array(sure).reshape(-1, len(own))
        if fault is not None:
            px, values = fault(name, at_s, px, values)
        at_ns = round(1e9 * (1.0 + at_s))
        frame = keypoint_frame(
            name, own, time_ns=at_ns, size_px=rig.cameras[name].camera.size_px, positions_px=px,
            confidences=values if len(values) else 1.0, sequence=k,
        )  # fmt: skip
        found.append(Arrival(frame, at_ns))
    return found


@cache
def whole_body(at_s: float) -> tuple[Float64, Float64]:
    """Points (136, 3) and confidences (136,) of the person with both hands; the face is not seen."""
    joints = person(at_s)
    points, sure = np.full((136, 3), np.nan), np.zeros(136)
    left, right = hands_of(joints, at_s)
    points[:26], points[LEFT : LEFT + 21], points[RIGHT : RIGHT + 21] = joints, left, right
    sure[np.isfinite(points[:, 0])] = 0.9
    return points, sure


def errors_of(scenes: Sequence[Scene], truth: Callable[[float], Mapping[bool, Float64]]) -> dict[bool, Float64]:
    """Distances (n,) of all landmarks from the true ones of the same side, by whether the hand is left [m]."""
    away: dict[bool, list[float]] = {True: [], False: []}
    for scene in scenes:
        true = truth(scene.at_ns / 1e9 - 1.0)
        for hand in scene.hands:
            if hand.left in true:
                away[hand.left] += np.linalg.norm(hand.landmarks - true[hand.left], axis=1).tolist()
    return {left: np.array(values) for left, values in away.items()}


def of_side(scene: Scene, left: bool) -> TrackedHand:
    """The only hand of a side in a scene."""
    (hand,) = [hand for hand in scene.hands if hand.left == left]
    return hand
