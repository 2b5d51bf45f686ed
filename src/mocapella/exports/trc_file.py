"""Write TRC, the marker file that OpenSim reads; one file has one individual at a constant rate."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.exports.space_tracks import as_trc
from mocapella.model.point_tracks import SpaceTracks
from mocapella.model.trajectories import Trajectories

T_OPENSIM_WORLD: Final = np.array(
    [[0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""OpenSim's ground from the world: a person who looks against the world's z axis, to a camera there, looks along +X."""


def write_trc(trajectories: Trajectories, path: Path) -> None:
    """Write one individual as TRC, in metres, with Y up; unknown coordinates are NaN. The first frame is number 1.

    Args:
        trajectories: one individual at a constant rate.
        path: the file.

    Raises:
        OSError: the file cannot be written.
    """
    frames, points = len(trajectories), len(trajectories.keypoints)
    tracks = SpaceTracks(
        points=trajectories.keypoints,
        frames=np.arange(1, frames + 1),
        at_s=trajectories.times_s,
        positions=trajectories.positions[:, 0].astype(np.float64),
        sds=trajectories.sd[:, 0].astype(np.float64),
        residuals_px=np.full((frames, points), math.nan),
        views=np.zeros((frames, points), np.int64),
        states=np.zeros((frames, points), np.uint8),
    )
    path.write_text(as_trc(tracks, path.name, hz=trajectories.rate_hz), encoding="utf-8", newline="")
