"""A body brought from when its sensor saw it to another instant: by one rigid motion, from that sensor's past alone.

Sensors take their pictures at different times; in 20 ms somebody who walks is 2 cm further. `motion_over` is how the
body as a whole moved lately, continued (or undone) for so long: along the way of its centre, and turning about the
vertical. Its joints' own movements stay as they were seen.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import BodyTrack
from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import rigid

Float64 = NDArray[np.float64]

UPWARD: Final = np.array([0.0, 1.0, 0.0])


def motion_over(
    track: BodyTrack, seconds: float, *, up: Float64 = UPWARD, window_s: float = 0.1, longest_s: float = 0.3
) -> Float64:
    """The motion of a body's newest frame over some time, in its sensor's camera space.

    To be exact it is better to go back: bring the newer of two views to the time of the older one, with ``seconds``
    below 0, for what happened in between is known.

    Args:
        track: the body's newest frames.
        seconds: how long, after the newest frame; no longer than ``longest_s`` counts.
        up: (3,) the vertical in camera space; a unit vector.
        window_s: over which the velocity is taken.

    Returns:
        (4, 4); the identity where there is no frame from so long ago.
    """
    begin, end = (int(i) for i in track.held)
    if end - begin < 2:
        return np.eye(4)
    before = track.times[end - 1] - window_s
    i = int(np.searchsorted(track.times[begin:end], before, side="right")) + begin
    if i == begin or track.times[i] - track.times[i - 1] > 2 * window_s:
        return np.eye(4)
    seen = np.minimum(np.minimum(track.weights[i - 1], track.weights[i]), track.weights[end - 1]) > 0
    if seen.sum() < 4:
        return np.eye(4)
    f = (before - track.times[i - 1]) / (track.times[i] - track.times[i - 1])
    old = (track.points[i - 1] + f * (track.points[i] - track.points[i - 1]))[seen]
    new = track.points[end - 1][seen]
    old_centre, new_centre = old.mean(axis=0), new.mean(axis=0)
    a, b = old - old_centre, new - new_centre
    a, b = a - np.outer(a @ up, up), b - np.outer(b @ up, up)
    turn = float(np.arctan2((np.cross(a, b) @ up).sum(), (a * b).sum()))
    part = float(np.clip(seconds, -longest_s, longest_s)) / window_s
    R = _about(up, turn * part)
    return rigid(R, new_centre + (new_centre - old_centre) * part - R @ new_centre)


def _about(axis: Float64, angle: float) -> Float64:
    """The rotation about a unit vector (Rodrigues)."""
    K = cross_matrix(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K))
