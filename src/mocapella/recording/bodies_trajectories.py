"""Trajectories of a result of silhouette tracking."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocapella.geometry.twists import exp_twist
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories, median_step
from mocapella.recording.bodies_file import read_followed_people


def read_bodies(path: Path) -> Trajectories:
    """Read a result of `mocapella track silhouettes` as trajectories of the kind ``bodies``.

    A landmark that images do not support is inferred, as are all of a lost body. A body without a name is ``body``.

    Raises:
        InputError: the file cannot be read, or is no such result.
    """
    people = {name or "body": body for name, body in read_followed_people(path).items()}
    times = np.unique([frame.time_s for body in people.values() for frame in body.frames])
    bodies = list(people.values())
    keypoints = tuple(dict.fromkeys(name for body in bodies for frame in body.frames for name in frame.joints))
    angle_names = tuple(dict.fromkeys(name for body in bodies for frame in body.frames for name in frame.angles))
    shape = (len(times), len(people))
    positions, angles = np.full((*shape, len(keypoints), 3), np.nan), np.full((*shape, len(angle_names)), np.nan)
    states, poses = np.zeros((*shape, len(keypoints)), np.uint8), np.full((*shape, 4, 4), np.nan)
    for i, body in enumerate(bodies):
        for frame in body.frames:
            t = int(np.searchsorted(times, frame.time_s))
            poses[t, i] = exp_twist(np.array(frame.root_twist))
            for k, name in enumerate(keypoints):
                if name in frame.joints:
                    positions[t, i, k] = frame.joints[name]
                    unsure = frame.lost or name in frame.unsupported
                    states[t, i, k] = JointState.INFERRED if unsure else JointState.TRACKED
            angles[t, i] = [frame.angles.get(name, np.nan) for name in angle_names]
    return Trajectories(
        "bodies", times, np.zeros(len(times), np.int64), tuple(people), keypoints, positions, states,
        np.full(states.shape, np.nan, np.float32), (), angle_names, angles, poses, 1.0 / median_step(times),
    )  # fmt: skip
