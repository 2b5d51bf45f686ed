"""Match the bodies of two sensors that belong to one person.

This is data association between sensors: by known identities, or by mutual nearest neighbours within a gate.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import BodyTrack
from mocapella.geometry.rigid import apply

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


def nearest_bodies(
    T_a_b: Float64, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], within_m: float
) -> tuple[tuple[int, int], ...]:
    """Return pairs of tracking ids of bodies that are mutually nearest, and within a distance.

    Args:
        T_a_b: (4, 4) pose of the sensor b in a's frame.
        a, b: each sensor's bodies, by tracking id.
        within_m: largest distance of their centres [m].

    Returns:
        (id in a, id in b), ascending; none where a sensor has no body. A body without a visible joint matches nothing.
    """
    ours, theirs = sorted(a), sorted(b)
    (pairs,) = mutually_nearest(T_a_b[None], newest_centres(a), newest_centres(b), within_m)
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
    distance = np.linalg.norm(a[:, None] - apply(T_a_b, b[None])[:, None], axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    if not distance.size:
        return np.zeros(distance.shape, dtype=np.bool_)
    nearest = (distance == distance.min(axis=1, keepdims=True)) & (distance == distance.min(axis=2, keepdims=True))
    return np.asarray(nearest & (distance <= within_m))


def newest_centres(bodies: Mapping[int, BodyTrack]) -> Float64:
    """Return the centre of each body's newest visible joints (bodies, 3), in order of ids [m]; NaN without any."""
    return np.array([_newest_centre(bodies[body]) for body in sorted(bodies)]).reshape(-1, 3)


def _newest_centre(track: BodyTrack) -> Float64:
    newest = track.held[1] - 1
    seen = track.weights[newest] > 0
    return np.asarray(track.points[newest][seen].mean(axis=0)) if seen.any() else np.full(3, np.nan)
