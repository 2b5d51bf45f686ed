"""Which bodies of two sensors are one person."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import BodyTrack
from mocapella.geometry.rigid import apply

Float64 = NDArray[np.float64]


def same_people(
    a: Iterable[int], b: Iterable[int], people_of_a: Mapping[int, int], people_of_b: Mapping[int, int]
) -> tuple[tuple[int, int], ...]:
    """Tracking ids in two sensors of bodies that are one person."""
    of_b = {people_of_b[body]: body for body in b if body in people_of_b}
    return tuple((body, of_b[people_of_a[body]]) for body in a if people_of_a.get(body) in of_b)


def nearest_bodies(
    T_a_b: Float64, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], within_m: float
) -> tuple[tuple[int, int], ...]:
    """Tracking ids in two sensors of bodies of which each is the other's nearest, and near enough."""
    if not a or not b:
        return ()
    ours, theirs = sorted(a), sorted(b)
    there = np.array([_newest_centre(b[body]) for body in theirs])
    distance = np.linalg.norm(
        np.array([_newest_centre(a[body]) for body in ours])[:, None] - apply(T_a_b, there)[None], axis=-1
    )
    distance = np.nan_to_num(distance, nan=np.inf)
    return tuple(
        (body, theirs[k])
        for i, body in enumerate(ours)
        if distance[i, k := int(distance[i].argmin())] <= within_m and int(distance[:, k].argmin()) == i
    )


def _newest_centre(track: BodyTrack) -> Float64:
    newest = track.held[1] - 1
    seen = track.weights[newest] > 0
    return np.asarray(track.points[newest][seen].mean(axis=0)) if seen.any() else np.full(3, np.nan)
