"""Match the bodies of two sensors that belong to one person.

This is data association between sensors: by known identities, or by mutual nearest neighbours within a gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import SensorTracks
from mocapella.geometry.rigid import apply, inverse

Float64 = NDArray[np.float64]
HIDES: Final = np.radians(15.0)
"""A body hides people behind it within this angle [rad]."""
BEHIND_M: Final = 0.3
"""Least difference of their distances from the sensor, about the depth of a body [m]."""


class Field(NamedTuple):
    """Cone where a sensor should see a person's centre: its depth range [m], and half of its angle [rad]."""

    nearest_m: float
    farthest_m: float
    half_angle: float


SURE_FIELD: Final = Field(1.2, 4.0, np.radians(25.0))
"""Field of every depth camera in use, less a margin for bodies that are cut off at its border."""
DOUBTED_FIELD: Final = Field(0.5, 5.0, np.radians(65.0))
"""The same for an unconfirmed pose: it may be off by tens of degrees."""
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


def missed_people(T_a_b: Float64, a: Float64, b: Float64, field: Field) -> bool:
    """Return whether each of two sensors should see a person of the other; call it while no two bodies coincide.

    A sensor should see a person in its field who does not stand behind a body that it sees. If this is true of only one
    of the two, both may work, and people stand where one sensor alone can see them.

    Args:
        T_a_b: (4, 4) pose of the sensor b in a's frame.
        a, b: (bodies, 3) centres of each sensor's bodies in its own frame [m]; NaN where not known.
        field: where a sensor should see people.
    """
    return _misses(field, apply(inverse(T_a_b), a), b) and _misses(field, apply(T_a_b, b), a)


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


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import body_track_kernels

    return body_track_kernels
