"""Match the bodies of two sensors that belong to one person.

This is data association between sensors: by known identities, or by mutual nearest neighbours within a gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import SensorTracks

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


def same_people(people_of_a: Mapping[int, int], people_of_b: Mapping[int, int]) -> tuple[tuple[int, int], ...]:
    """Return pairs of tracking ids in two sensors of the same person.

    Args:
        people_of_a, people_of_b: the person of each tracking id of a sensor.

    Returns:
        (id in a, id in b) of each person whom both have, in the order of a.
    """
    of_b = {person: body for body, person in people_of_b.items()}
    return tuple((body, of_b[person]) for body, person in people_of_a.items() if person in of_b)


def nearest_bodies(T_a_b: Float64, a: SensorTracks, b: SensorTracks, within_m: float) -> tuple[tuple[int, int], ...]:
    """Return pairs of tracking ids of bodies that are mutually nearest, and within a distance.

    Args:
        T_a_b: (4, 4) pose of the sensor b in a's frame.
        a, b: each sensor's bodies.
        within_m: largest distance of their centres [m].

    Returns:
        (id in a, id in b), ascending; none where a sensor has no body. A body without a visible joint matches nothing.
    """
    ours, theirs = sorted(a.bodies), sorted(b.bodies)
    (pairs,) = mutually_nearest(T_a_b[None], a.newest_centres(), b.newest_centres(), within_m)
    return tuple((ours[i], theirs[k]) for i, k in np.argwhere(pairs).tolist())


def mutually_nearest(T_a_b: Float64, a: Float64, b: Float64, within_m: float) -> Bools:
    """Return which points of two sensors are mutually nearest, and within a distance.

    Args:
        T_a_b: (tried, 4, 4) candidate poses of b in a's frame.
        a: (n, 3) in a's frame [m]; NaN where not known.
        b: (m, 3) in b's frame [m].
        within_m: largest distance [m].

    Returns:
        (tried, n, m) bool.
    """
    T_a_b, a, b = (np.ascontiguousarray(values, dtype=np.float64) for values in (T_a_b, a, b))
    return np.asarray(_kernels().mutually_nearest(T_a_b, a, b, within_m))


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import body_track_kernels

    return body_track_kernels
