"""Match the bodies of two sensors that belong to one person.

This is data association between sensors: by known identities, or by mutual nearest neighbours within a gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import BodyTrack
from mocapella.geometry.rigid import apply, inverse

Float64 = NDArray[np.float64]
HIDES: Final = np.radians(15.0)
"""A body hides people behind it within this angle [rad]."""
BEHIND_M: Final = 0.3
"""Least difference of their distances from the sensor, about the depth of a body [m]."""


class Field(NamedTuple):
    """Cone in which a sensor should see a person's centre: its depth range [m], and half of its angle [rad]."""

    nearest_m: float
    farthest_m: float
    half_angle: float


SURE_FIELD: Final = Field(1.2, 4.0, np.radians(25.0))
"""Field of every depth camera in use, less a margin for bodies that are cut off at its border."""
DOUBTED_FIELD: Final = Field(0.5, 5.0, np.radians(65.0))
"""The same for a pose that nobody has confirmed: it may be off by tens of degrees."""
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


def missed_people(T_a_b: Float64, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], field: Field) -> bool:
    """Return whether each of two sensors sees nobody at a position where it should see a person whom the other sees.

    Otherwise both may work, and people stand where only one of the two can see them.

    Args:
        T_a_b: (4, 4) pose of the sensor b in a's frame.
        a, b: each sensor's bodies, by tracking id.
        field: where a sensor should see people.
    """
    ours, theirs = newest_centres(a), newest_centres(b)
    return _misses(field, apply(inverse(T_a_b), ours), theirs) and _misses(field, apply(T_a_b, theirs), ours)


def _misses(field: Field, people: Float64, seen: Float64) -> bool:
    """Whether a person (n, 3) is in the field, not behind a body (m, 3) that is ``seen``; in the sensor's frame [m]."""
    x, y, z = people.T
    inside = (field.nearest_m < z) & (z < field.farthest_m)
    angle = np.arctan2(np.hypot(x, y), z)
    inside &= (angle < field.half_angle) & np.isfinite(angle)
    away, seen_away = np.linalg.norm(people, axis=-1)[:, None], np.linalg.norm(seen, axis=-1)
    cosine = np.einsum("pk,sk->ps", people, seen) / np.maximum(away * seen_away, 1e-9)
    behind = (cosine > np.cos(HIDES)) & (seen_away < away - BEHIND_M)
    return bool((inside & ~behind.any(axis=1)).any())


def newest_centres(bodies: Mapping[int, BodyTrack]) -> Float64:
    """Return the centre of each body's newest visible joints (bodies, 3), in order of ids [m]; NaN without any."""
    return np.array([_newest_centre(bodies[body]) for body in sorted(bodies)]).reshape(-1, 3)


def _newest_centre(track: BodyTrack) -> Float64:
    newest = track.held[1] - 1
    seen = track.weights[newest] > 0
    return np.asarray(track.points[newest][seen].mean(axis=0)) if seen.any() else np.full(3, np.nan)
