"""Body proportions from a sensor's skeleton, to recognise a person who returns.

Lengths depend neither on the sensor's pose nor on swapped left and right. On the KinectMultiTrack logs, lengths over
one second are nearer to the person's own than to another's in 95 % of the comparisons within a session, and in 83 %
with another session of the same person (`mocapella lab train sensor-errors`, ``told_apart_by_lengths``).
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]

LENGTHS: Final = (
    ("SpineBase", "Head"),
    ("SpineBase", "SpineShoulder"),
    ("Hip", "Knee"),
    ("Knee", "Ankle"),
    ("Shoulder", "Elbow"),
    ("Elbow", "Wrist"),
)
"""Pairs of joints whose distances describe a body; for limbs, the mean of both sides."""
SD_M: Final[Float64] = np.array([0.030, 0.026, 0.020, 0.022, 0.018, 0.012])
"""(lengths,) standard deviation of each length measured over one second, rounded from the same logs [m]."""
MOST: Final = 3.0
"""Limit to which a measured length's deviation from the running mean is clipped, in standard deviations."""


def sizes(positions: Float64, topology: Topology) -> Float64:
    """Measure the lengths of bodies, to compare them by `size_difference`.

    Args:
        positions: (bodies, joints, 3) in any one frame [m]; NaN where not seen.
        topology: names and order of the joints.

    Returns:
        (bodies, lengths) in the order of `LENGTHS`, for limbs the mean of both sides [m]; NaN where a joint is missing,
        and everywhere if the topology lacks a joint of `LENGTHS`.
    """
    ends, lengths = ends_of_lengths(topology.joints), np.full((len(positions), len(LENGTHS)), np.nan)
    if ends is not None:
        _kernels().measure(np.ascontiguousarray(positions, dtype=np.float64), ends, lengths)
    return lengths


@cache
def unknown_size() -> Float64:
    """Return the initial record (2, lengths) of a body's lengths: running means [m], NaN; numbers of values, 0.

    It is one shared array, which must be copied before it is changed.
    """
    return np.stack([np.full(len(LENGTHS), np.nan), np.zeros(len(LENGTHS))])


def known_size(known: Float64) -> bool:
    """Return whether at least half of the lengths of a record (2, lengths) of `unknown_size` have been measured."""
    return bool(2 * (known[1] > 0).sum() >= known.shape[1])


def size_difference(one: Float64, other: Float64) -> float:
    """Return the mean squared difference of two bodies' common lengths, divided by the variances `SD_M`² [ratio].

    It is infinite if fewer than a third of the lengths are known of both.

    Args:
        one, other: (lengths,) [m]; NaN where not measured.
    """
    squared = ((one - other) / SD_M) ** 2
    both = np.isfinite(squared)
    return float(squared[both].mean()) if 3 * both.sum() >= len(squared) else float("inf")


@cache
def ends_of_lengths(joints: tuple[str, ...]) -> NDArray[np.int64] | None:
    """Return the indices of the joints at the ends of each length; None if a topology with these joints lacks one.

    Args:
        joints: names of the topology's joints, in its order.

    Returns:
        (2 · lengths, 2): for each length a row of the left and a row of the right side, or its row twice. The array is
        shared by all callers.
    """
    rows = []
    for one, other in LENGTHS:
        for side in ("Left", "Right"):
            names = (one, other) if one in joints else (one + side, other + side)
            if not set(names) <= set(joints):
                return None
            rows.append([joints.index(name) for name in names])
    return np.array(rows, dtype=np.int64)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.association import track_kernels

    return track_kernels
