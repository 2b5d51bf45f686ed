"""Numbers of people: confirm candidates, and recognise people who were lost, by their place and the bones' lengths."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import topology
from mocapella.tracker.webcams_memory import CANDIDATE, LIFTED_M, LONG_SEEN, MOST_MISSED, ROAMED_M, PeopleArrays
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

LENGTH_SD_M: Final = 0.025
"""Standard deviation of a bone's length that a few instants measure [m]."""
NEAR_M: Final = 0.7
"""Distance within which a person lost a moment ago is found again [m]."""
SPEED_M_S: Final = 2.0
"""Speed of a lost person [m/s]."""
FAST_M_S: Final = 6.0
"""Largest speed of a person who returns [m/s]."""
SOON_S: Final = 3.0
"""Time within which a lost person is recognised by the place [s]."""


LEAST_SINE: Final = 0.6
"""Sine of the angle at which rays cross well."""
LATER_SINE: Final = 0.25
"""Sine of the angle at which rays cross well enough for a candidate that two cameras see walk or stand on the floor."""
LEAST_JOINTS: Final = 6
"""Number of joints about which a third camera must agree to confirm a candidate."""
STEADY_SD_M: Final = 0.15
"""Largest standard deviation of the heights of ankles that tell the floor [m]."""
STANDING_S: Final = 0.6
"""Time for which two cameras see a candidate who stands on the floor [s]."""
LEAST_UPRIGHT: Final = 0.9
"""Cosine of the angle between people, from ankles to neck, and the vertical, below which the floor is not known."""
FLOOR_M: Final = 0.2
"""Distance of the lower ankle from that of other people, besides its standard deviation, of who stands [m]."""
_NECK: Final = topology("halpe_26").index("Neck")
_ANKLES: Final = [topology("halpe_26").index(f"{side}Ankle") for side in "LR"]
MOST_REFUTED: Final = 0.6
"""A candidate waits from this ratio of the cameras that miss it (running mean) to the cameras that see it."""


class LostPerson(msgspec.Struct, frozen=True, eq=False):
    """A lost person.

    Attributes:
        id: number of the person.
        at_s: last time that two cameras agreed about the person [s].
        place: (3,) mean of the joints at that time, world [m].
        lengths: (bones,) lengths of the bones [m]; NaN where not measured.
    """

    id: int
    at_s: float
    place: Float64
    lengths: Float64


class Identities:
    """Numbers of people, and the memory of lost people.

    Args:
        settings: how long lost people are remembered, and how alike they must be.
    """

    def __init__(self, settings: WebcamsSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all people; the numbers restart at 0."""
        self._next = 0
        self._lost: list[LostPerson] = []

    def forget_people(self) -> None:
        """Forget lost people; numbers that were given are not given again."""
        self._lost = []

    def memory(self) -> dict[str, Any]:
        """Return all state, for a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in MEMORY}

    def lose(self, people: PeopleArrays, row: int) -> None:
        """Remember a confirmed person whose row is to be freed.

        Args:
            people: the people.
            row: row of the person.
        """
        place = people.agreed_place[row].copy()
        lengths = people.lengths[row].copy()
        self._lost.append(LostPerson(int(people.ids[row]), float(people.agreed_s[row]), place, lengths))

    def confirm(
        self, people: PeopleArrays, row: int, at_s: float, agreed: Bools, forget: Callable[[PeopleArrays, int], None]
    ) -> None:
        """Give a candidate a number: that of a person whom it replaces or who returns, or a new one.

        Args:
            people: the people, changed in place.
            row: row of the candidate.
            at_s: time of the instant [s].
            agreed: (people, cameras) whether a camera agrees about a person in this instant.
            forget: function that frees a row.
        """
        known = self._replaced(people, row, at_s, agreed)
        if known >= 0:
            people.ids[row] = people.ids[known]
            people.lengths[row], people.lengths_seen[row] = people.lengths[known], people.lengths_seen[known]
            forget(people, known)
            return
        self._lost = [one for one in self._lost if at_s - one.at_s <= self._settings.remember_s]
        found = self._returned(people, row, at_s)
        if found is not None:
            self._lost.remove(found)
            people.ids[row] = found.id
        else:
            people.ids[row] = self._next
            self._next += 1

    def returns(self, people: PeopleArrays, row: int, at_s: float) -> bool:
        """Return whether a candidate is a lost person, see `confirm`."""
        return self._returned(people, row, at_s) is not None

    def _replaced(self, people: PeopleArrays, row: int, at_s: float, agreed: Bools) -> int:
        """Return the row of the person hardly seen any more that the candidate is; −1 for none."""
        best, found = math.inf, -1
        for other in np.flatnonzero((people.ids >= 0) & (people.cameras < 2)).tolist():
            if (agreed[row] & agreed[other]).any():  # one camera sees both
                continue
            place = _place(people, row)
            now, then = _place(people, other), people.agreed_place[other]
            away = float(np.fmin(np.linalg.norm(place - now), np.linalg.norm(place - then)))
            reach = NEAR_M + SPEED_M_S * min(at_s - float(people.agreed_s[other]), SOON_S)
            alike = _difference(people.lengths[row], people.lengths[other]) <= 4.0 * self._settings.same_size
            if alike and away <= reach and away < best:
                best, found = away, other
        return found

    def _returned(self, people: PeopleArrays, row: int, at_s: float) -> LostPerson | None:
        """Return the lost person whom a candidate is; None if none is, or it is not certain."""
        place, scored = _place(people, row), []
        for one in self._lost:
            away_s = at_s - one.at_s
            away = float(np.linalg.norm(place - one.place))
            difference = _difference(people.lengths[row], one.lengths)
            if away_s > self._settings.remember_s or away > NEAR_M + FAST_M_S * away_s:
                continue
            near = away_s <= SOON_S and away <= NEAR_M + SPEED_M_S * away_s
            if near and difference <= 4.0 * self._settings.same_size:
                difference *= 0.25
            scored.append((difference, away, one.id, one))
        scored.sort(key=lambda item: item[:3])
        if not scored or scored[0][0] > self._settings.same_size:
            return None
        if len(scored) > 1 and 2.0 * scored[0][0] > scored[1][0]:
            close = [item for item in scored if item[1] <= NEAR_M and at_s - item[3].at_s <= SOON_S]
            return close[0][3] if len(close) == 1 else None
        return scored[0][3]


MEMORY: Final = ("_next", "_lost")
"""Attributes of `Identities` that are its state."""


def ready(
    people: PeopleArrays, settings: WebcamsSettings, agreed: Bools, origins: Float64, *, missed: Float64,
    floor: float, up: Float64, known: Callable[[int], bool],
) -> list[int]:  # fmt: skip
    """Return the rows of candidates to confirm, in the order of their rows.

    Of a rig of three cameras or more, two confirm a candidate only if their rays cross at a large angle. Else they may
    see two strangers on one line, or a person far behind the place that the cameras surround. Two do not confirm one
    who is far above or below the floor, as a body of two people's rays. A candidate also waits where nearly as many
    cameras look at its place and see no person. A candidate whom two cameras saw walk does not wait for these, and a
    smaller angle suffices (`LATER_SINE`), as for one who stands on the floor. A lost person who returns does not wait.

    Args:
        people: the people.
        settings: number of instants or cameras that must agree.
        agreed: (people, cameras) whether a camera agrees about a person in this instant.
        origins: (cameras, 3) centres of the cameras, world [m].
        missed: (cameras,) share of people whom a camera misses, see `CameraCounts`.
        floor: see `floor_of` [m].
        up: (3,) upward direction, world.
        known: tells whether the candidate of a row is a lost person.
    """
    found, trust = [], np.maximum(1.0 - missed / MOST_MISSED, 0.0)
    for row in np.flatnonzero((people.ids == CANDIDATE) & (people.doubts == 0)).tolist():
        views, hits = int(agreed[row].sum()), int(people.hits[row])
        sure, third = (int((people.support[row] >= count).sum()) for count in (settings.sure_cameras, 3))
        walked = hits >= LONG_SEEN and float(people.roamed[row]) >= ROAMED_M
        real = walked or _stands(people, row, floor, up)
        narrow = len(origins) > 2 and not _crossing(_place(people, row), origins[agreed[row]], real=real)
        doubtful = float(np.nansum(trust * people.refuted[row])) >= MOST_REFUTED * views and not walked
        if (doubtful or narrow) and hits >= settings.confirm_instants and known(row):
            doubtful = narrow = False
        if doubtful or ((narrow or _lifted(people, row, floor, up)) and third < LEAST_JOINTS):
            continue
        if hits >= settings.confirm_instants or (sure >= LEAST_JOINTS and hits >= 1):
            found.append(row)
    return found


def _crossing(place: Float64, origins: Float64, *, real: bool) -> bool:
    """Return whether rays from origins (n, 3) cross at a place (3,) at a large angle.

    For a candidate who walked or stands on the floor (``real``), the smaller `LATER_SINE` suffices, of cameras on the
    same side.
    """
    rays = place - origins
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    sines = np.linalg.norm(np.cross(rays[:, None], rays[None]), axis=2)
    beside = (rays @ rays.T > 0.0) & (sines >= LATER_SINE)  # opposite cameras hardly tell the place along their line
    return bool(sines.max(initial=0.0) >= LEAST_SINE or (real and beside.any()))


def floor_of(people: PeopleArrays, up: Float64) -> float:
    """Return the height of the ankles of people who are well known, along the upward direction ``up`` (3,) [m].

    NaN if nobody is well known, or if people do not stand along it.
    """
    rows = np.flatnonzero((people.ids >= 0) & (people.sure >= LONG_SEEN))
    joints = people.positions[rows]
    mean = np.nanmean(joints[:, _NECK] - joints[:, _ANKLES].mean(axis=1), axis=0) if len(rows) else np.zeros(3)
    steady = people.height_variances[rows][:, _ANKLES] < STEADY_SD_M**2
    heights = people.heights[rows][:, _ANKLES][steady]
    heights = heights[np.isfinite(heights)]
    upright = mean @ up > LEAST_UPRIGHT * np.linalg.norm(mean)
    return float(np.median(heights)) if upright and len(heights) else math.nan


def _stands(people: PeopleArrays, row: int, floor: float, up: Float64) -> bool:
    """Return whether two cameras see a candidate for some time, with the lower ankle at the height of other people's.

    The place where the rays of two strangers on one line meet is nearer or farther than these, so its feet are not on
    the floor.
    """
    if people.hits[row] < LONG_SEEN or people.at_s[row] - people.born_s[row] < STANDING_S:
        return False
    away, sd = _above(people, row, floor, up)
    return abs(away) <= FLOOR_M + sd


def _lifted(people: PeopleArrays, row: int, floor: float, up: Float64) -> bool:
    """Return whether a candidate is far above or below the floor, as a body from the rays of two people is."""
    away, sd = _above(people, row, floor, up)
    return abs(away) > LIFTED_M + sd


def _above(people: PeopleArrays, row: int, floor: float, up: Float64) -> tuple[float, float]:
    """Return how far a candidate's lower ankle is above the floor, and its standard deviation [m]; NaN if unknown."""
    heights = people.positions[row, _ANKLES] @ up
    low = int(np.argmin(heights))
    variance = float(up @ people.covariances[row, _ANKLES[low]] @ up)
    return float(heights[low] - floor), math.sqrt(variance) if variance >= 0.0 else math.nan


def _place(people: PeopleArrays, row: int) -> Float64:
    known = np.isfinite(people.positions[row, :, 0])
    return people.positions[row][known].mean(axis=0) if known.any() else np.full(3, np.nan)


def _difference(one: Float64, other: Float64) -> float:
    """Return the mean squared difference of two people's lengths, in variances; 1 if they share too few."""
    squared = np.clip((one - other) / LENGTH_SD_M, -5.0, 5.0) ** 2
    both = np.isfinite(squared)
    return float(squared[both].mean()) if 3 * both.sum() >= len(squared) else 1.0
