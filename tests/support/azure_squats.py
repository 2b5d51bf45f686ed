"""A real recording: somebody squats before one Azure Kinect, which reports left and right truly all the time."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.body_rows import BodyRows
from mocapella.model.skeleton import SKELETON, skeleton_mapping
from mocapella.recording.body_csv import read_body_csv

KINECT = SKELETON


class Squats(NamedTuple):
    """(frames,) times [s]; what the sensor reported, and the skeletons (frames, 25, 3) mapped from it [m]."""

    at_s: NDArray[np.float64]
    rows: BodyRows
    positions: NDArray[np.float64]


def read_squats(folder: Path) -> Squats:
    rows = read_body_csv(folder / "azure_positions.csv.gz")
    mapping = skeleton_mapping("azure_kinect")
    assert mapping is not None
    return Squats((rows.time_ns - rows.time_ns[0]) * 1e-9, rows, mapping.positions(rows.positions.astype(np.float64)))


def knee_flexion(positions: NDArray[np.float64], side: str) -> NDArray[np.float64]:
    """Angle (...,) of skeletons (..., joints, 3), 0 where the leg is straight [°]."""
    hip, knee, ankle = (positions[..., KINECT.index(name + side), :] for name in ("Hip", "Knee", "Ankle"))
    thigh, shank = knee - hip, ankle - knee
    cos = (thigh * shank).sum(axis=-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shank, axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(cos, -1, 1))))
