"""Match frames of several cameras that were captured at the same time.

Frames of one group count as simultaneous in triangulation and calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocapella.errors import CalibrationError


def synchronise_frames(
    times_s: Mapping[str, Sequence[float]], tolerance_s: float | None = None
) -> dict[tuple[str, int], int]:
    """Group frames that were captured within a tolerance of the first one of their group.

    Args:
        times_s: capture times of each camera's frames, on one clock [s]; NaN where unknown.
        tolerance_s: largest time difference within a group; must be below half of the shortest of the cameras' median
            frame intervals; None for a third of that interval.

    Returns:
        The group, numbered from 0 in order of time, of each (camera, index of the frame) whose time is known. A group
        has at most one frame per camera.

    Raises:
        CalibrationError: times do not increase, or the tolerance is too large.
    """
    known = {name: np.asarray(times)[np.isfinite(times)] for name, times in times_s.items()}
    intervals = [float(np.median(np.diff(times))) for times in known.values() if len(times) > 1]
    for name, times in known.items():
        if (np.diff(times) <= 0).any():
            raise CalibrationError(f"camera {name}: the times of its frames do not rise: check --timestamps")
    shortest = min(intervals, default=np.inf)
    if tolerance_s is None:
        tolerance_s = shortest / 3 if np.isfinite(shortest) else 0.0
    if not 0 <= tolerance_s < shortest / 2:
        raise CalibrationError(
            f"frames {1e3 * tolerance_s:.1f} ms apart cannot be taken as of one instant with one every "
            f"{1e3 * shortest:.1f} ms: choose less than half of that"
        )
    frames = sorted((at, name, k) for name, times in times_s.items() for k, at in enumerate(times) if np.isfinite(at))
    found: dict[tuple[str, int], int] = {}
    instant, began, names = -1, -np.inf, set[str]()
    for at, name, k in frames:
        if at - began > tolerance_s or name in names:
            instant, began, names = instant + 1, at, set()
        found[name, k] = instant
        names.add(name)
    return found
