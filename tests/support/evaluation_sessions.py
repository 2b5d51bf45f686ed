"""Sessions of two simulated sensors, as study logs, for the tests of the scoring."""

from __future__ import annotations

from typing import Any

import numpy as np
from support import study_examples as examples

from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry import rigid
from mocapella.model.observations import Arrival
from mocapella.model.study_log import StudyLog
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
TASKS = (1, 2, 3)


def body(yaw: Any = 0.0) -> Any:
    """(25, 3) a person who stands at the origin and faces +z (yaw 0), y up [m]."""
    heights = {"SpineBase": 0.0, "SpineMid": 0.3, "SpineShoulder": 0.5, "Neck": 0.6, "Head": 0.8}
    sides = {"Shoulder": (0.2, 0.5), "Elbow": (0.25, 0.2), "Wrist": (0.27, 0.0), "Hand": (0.27, -0.1)}
    sides |= {"HandTip": (0.27, -0.2), "Thumb": (0.24, -0.1), "Hip": (0.1, -0.05), "Knee": (0.12, -0.5)}
    sides |= {"Ankle": (0.12, -0.9), "Foot": (0.12, -0.95)}
    joints = np.zeros((25, 3))
    for name, y in heights.items():
        joints[KINECT.index(name)] = [0, y, 0]
    for name, (x, y) in sides.items():
        for side, sign in (("Left", 1), ("Right", -1)):
            joints[KINECT.index(name + side)] = [sign * x, y, 0.1 if name == "Foot" else 0.0]
    return rigid.apply(rigid.rigid(rigid.rotation_about_y(yaw), np.zeros(3)), joints)


def walker(frames: int) -> tuple[Any, Any]:
    """(frames,) times at 30 Hz [s], and (frames, 25, 3) somebody who walks in a circle, the arms and legs swinging."""
    t = np.arange(frames) / 30
    place = np.stack([0.6 * np.cos(t), np.zeros(frames), 2.4 + 0.6 * np.sin(t)], axis=-1)
    moved = np.stack([body(-angle) for angle in t]) + place[:, None]
    swing = 0.15 * np.sin(4 * t)
    for name, sign in (("HandLeft", 1), ("HandRight", -1), ("FootLeft", -1), ("FootRight", 1)):
        moved[:, KINECT.index(name), 2] += sign * swing
    return t, moved


def log_of(frames: int = 240, noise: float = 0.01, wrong: Any = None, lag_s: float = 0.0, seed: int = 0) -> StudyLog:
    """A third each of Stationary, Steps and Walk; the second sensor's rows are off by the motion ``wrong``.

    Args:
        frames: of each sensor.
        noise: of each joint [m].
        wrong: (4, 4), what the calibration of the day did.
        lag_s: the second sensor shows where the person was so long before what its time says.
        seed: of the noise.
    """
    random = np.random.default_rng(seed)
    _, path = walker(frames + 60)
    rows = examples.Rows(frames=frames)
    late = path[30 : 30 + frames]
    if lag_s:
        at = 30 + np.arange(frames) - lag_s * 30
        flat = path.reshape(len(path), -1)
        late = np.stack([np.interp(at, np.arange(len(path)), column) for column in flat.T], axis=-1).reshape(-1, 25, 3)
    seen = rigid.apply(np.eye(4) if wrong is None else wrong, late)
    positions = np.stack([path[30 : 30 + frames], seen], axis=1).reshape(2 * frames, 25, 3)
    rows["positions"] = (positions + noise * random.normal(size=positions.shape)).astype(np.float32)
    step = np.arange(2 * frames) // 2
    rows["scenario_id"] = np.array(TASKS)[np.minimum(3 * step // frames, 2)]
    rows["tracker_time_ms"] = examples.NOON_MS + step * 33
    second = np.arange(2 * frames) % 2
    rows["skeleton_time_ticks"] = step * examples.FRAME_TICKS + np.where(second, 5_000_000_000, 100_000)
    rows["tracker_time_ms"] = examples.NOON_MS + (step * examples.FRAME_TICKS) // 10_000 + np.where(second, 0, 10)
    rows["tracker_time_ms"] = examples.NOON_MS + (step * examples.FRAME_TICKS) // 10_000
    return rows.log("Study_7_Kinect_2.csv")


def session_of(**options: Any) -> StudySession:
    return StudySession(log_of(**options))


def frames_of(session: StudySession) -> list[Arrival]:
    return list(session.frames.arrivals)
