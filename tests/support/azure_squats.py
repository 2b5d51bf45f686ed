"""A real recording: somebody squats before one Azure Kinect, which reports left and right truly all the time."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
_NAMES = {
    "SpineBase": "PELVIS", "SpineMid": "SPINE_NAVEL", "SpineShoulder": "SPINE_CHEST", "Neck": "NECK", "Head": "HEAD",
}  # fmt: skip
_MEDIUM = 2
"""Confidence from which a joint counts as tracked."""


class Squats(NamedTuple):
    """(frames,) times [s]; (frames, joints, 3) positions in Kinect v2's camera space [m]; (frames, joints) states."""

    at_s: NDArray[np.float64]
    positions: NDArray[np.float64]
    states: NDArray[np.uint8]


def read_squats(folder: Path) -> Squats:
    with gzip.open(folder / "azure_positions.csv.gz", "rt", encoding="ascii") as file:
        titles = next(file).strip().split(";")
        rows = np.loadtxt(file, delimiter=";")

    def column(title: str) -> NDArray[np.float64]:
        return rows[:, titles.index(title)]

    names = [_of_azure(joint) for joint in KINECT.joints]
    positions = [
        [scale * column(f"{n} ({a})") for a, scale in (("x", -1e-3), ("y", -1e-3), ("z", 1e-3))] for n in names
    ]
    sure = np.stack([column(f"{name} (c)") for name in names], axis=1)
    states = np.where(sure >= _MEDIUM, JointState.TRACKED, np.where(sure > 0, JointState.INFERRED, 0)).astype(np.uint8)
    return Squats((column("timestamp") - rows[0, 0]) * 1e-6, np.array(positions).transpose(2, 0, 1), states)


def _of_azure(joint: str) -> str:
    for side in ("Left", "Right"):
        if joint.endswith(side):
            return f"{joint.removesuffix(side).upper()}_{side.upper()}"
    return _NAMES[joint]


def knee_flexion(positions: NDArray[np.float64], side: str) -> NDArray[np.float64]:
    """Angle (...,) of skeletons (..., joints, 3), 0 where the leg is straight [°]."""
    hip, knee, ankle = (positions[..., KINECT.index(name + side), :] for name in ("Hip", "Knee", "Ankle"))
    thigh, shank = knee - hip, ankle - knee
    cos = (thigh * shank).sum(axis=-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shank, axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(cos, -1, 1))))
