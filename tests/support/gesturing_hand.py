"""A hand unlike the average one shows the gesture its bones are measured by to two cameras; without pictures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.model.camera import CameraRig
from mocapella.model.hand import DIGIT_ANGLES, TIPS, Handedness, HandPose, HandShape, hand_model
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.sources.simulate.hand_motion import UPRIGHT, landmarks_of
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.tracker.hands import HandsSettings, HandsTracker

Float64 = NDArray[np.float64]
TIP_NAMES = ("red", "yellow", "green", "blue", "magenta")
BASE_NAMES = ("cyan", "white", "orange")
HZ = 30.0
NOISE_PX = 0.15
PHASES_S = {"flat": (0.0, 2.0), "knuckles": (2.0, 5.0), "hook": (5.0, 8.0)}
PALM_SIDE_M = -0.0125
MODEL = hand_model("thesis")


@cache
def rig() -> CameraRig:
    return load_hand_scene("wide", seed=1).rig


def somebody(side: Handedness = "right", seed: int = 1) -> HandShape:
    """Fingers of other lengths than the average hand's, each of its own."""
    rng = np.random.default_rng([seed, 5])
    start = MODEL.shape(side)
    lengths = 1.06 * start.lengths * rng.uniform(0.92, 1.08, (5, 1)) * rng.uniform(0.97, 1.03, (5, 3))
    return HandShape(side, lengths, start.bases)


def pose(phase: str, at_s: float, *, since_s: float = 0.0, bend: float = 1.0) -> HandPose:
    """In the part of the gesture that is named, which began at a time."""
    swing = bend * (0.5 - 0.5 * np.cos(2 * np.pi * (at_s - since_s) / 1.5))
    angles = np.zeros(21)
    for digit, row in enumerate(DIGIT_ANGLES[1:]):
        held = np.radians(1.0 + digit)
        angles[row[0]] = np.radians(80) * swing if phase == "knuckles" else held
        angles[row[2]] = np.radians(95) * swing if phase == "hook" else held
        angles[row[3]] = 2 / 3 * angles[row[2]]
    turn, tilt = 0.15 * np.sin(1.1 * at_s), 0.15 * np.cos(0.7 * at_s)
    R = rotation_about_y(turn) @ rotation_about_x(tilt) @ UPRIGHT
    T = rigid(R, np.array([0.02 * np.sin(at_s), -0.10, 0.02 * np.cos(0.8 * at_s)]))
    return HandPose(angles, T)


def markers(shape: HandShape, held: HandPose, base: int = 3) -> Float64:
    """(5 + base, 3) world."""
    places = base_layout(shape, base, PALM_SIDE_M)
    return np.concatenate(
        [landmarks_of(MODEL, shape, held)[list(TIPS)], apply(held.T_world_palm, shape.mirror * places)]
    )


@cache
def scenes(side: Handedness = "right", base: int = 3) -> tuple[tuple[Arrival, Scene], ...]:
    """The gesture of `somebody` as the method hands sees it, with an average hand."""
    tracker = HandsTracker(rig(), HandsSettings(base=BASE_NAMES[:base]), shape=MODEL.shape(side))
    return tuple((arrival, tracker.update(arrival)) for arrival in frames(somebody(side), base=base))


def frames(
    shape: HandShape, *, base: int = 3, hidden: tuple[str, ...] = (), seed: int = 0, **how: float
) -> Iterator[Arrival]:
    """What the cameras send of the whole gesture, the right one half a frame later."""
    rng, names = np.random.default_rng([seed, 6]), (*TIP_NAMES, *BASE_NAMES[:base])
    for phase, (begin_s, end_s) in PHASES_S.items():
        for k in range(round(begin_s * HZ), round(end_s * HZ)):
            for shift, (camera, eye) in enumerate(sorted(rig().cameras.items())):
                at_s = (k + 0.5 * shift) / HZ
                points = markers(shape, pose(phase, at_s, since_s=begin_s, **how), base)
                px = project(apply(eye.T_camera_world, points), eye.camera.lens) + rng.normal(
                    0, NOISE_PX, (len(points), 2)
                )
                px[[name in hidden for name in names]] = np.nan
                at_ns = round(at_s * 1e9) + 1
                frame = marker_frame(
                    camera, names, time_ns=at_ns, size_px=eye.camera.size_px, positions_px=px, sd_px=NOISE_PX,
                    sequence=k, node_id=7,
                )  # fmt: skip
                yield Arrival(frame, at_ns)
