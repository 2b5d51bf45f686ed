"""State of the calibration of one pair of sensors from people.

A pair begins with a hypothesis per pair of bodies (`cold_start`), and is refined with bodies of one person once one
hypothesis is accepted (`pair_calibration`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from operator import is_
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import MIRRORED_STREAM, WALK, WALK_ACROSS, PairCalibration, PairEstimate
from mocapella.calibration.pair_memory import BodyTrack, SensorTracks
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.shared_people import DOUBTED_FIELD, SURE_FIELD, missed_people

Float64 = NDArray[np.float64]
Pair = tuple[str, str]
BY_LAYOUT: Final = "rig"
"""Value of `PairOfSensors.told` for an estimate from a layout file; takes contain it."""
NO_OWNERS: Final[tuple[Mapping[int, int], Mapping[int, int]]] = ({}, {})
GIVEN_SD_M: Final = 0.15
"""Expected error of a given relative position, until people confirm it [m]."""
GIVEN_SD: Final = np.radians(10.0)
"""Expected error of a given relative rotation, until people confirm it [rad]."""
_GIVEN: Final = np.diag([GIVEN_SD_M**2 / 3] * 3 + [GIVEN_SD**2 / 3] * 3)


@dataclass
class PairOfSensors:
    """Two sensors, a and b: the accepted estimate of their relative pose, or the hypotheses that are tried.

    Attributes:
        calibration: accepted estimate; None before there is one.
        cold: hypotheses; empty while nothing contradicts the accepted estimate.
        told: source of the estimate until people confirm it: `BY_LAYOUT`, or ``others`` for other pairs' poses; empty
            once confirmed.
        shown: whether people have confirmed the estimate once; it then stays in use even if it becomes less certain.
        matched: tracking ids in a and b of bodies of one person.
        owners: person of each tracking id, in a and in b, that ``matched`` was derived from; empty mappings if none.
        turn: counter that selects the matched bodies in turn, one pair of bodies for each refinement.
        due: capture time of the next refinement [s].
        trying: whether the hypotheses are tried.
        agreed_at: capture time at which a body last was at the same position in both sensors [s].
        seen_since: capture time since when both sensors see bodies without a break [s].
        estimate: result of the last refresh with new data; None before the first.
        quality: description of ``estimate``; empty without one.
        judged_steps: number of frames in the calibration (`pair_memory.STEPS`) when ``estimate`` was computed.
        wary: whether an estimate from single postures was contradicted; the next one needs people who walk.
        missed_since: capture time since when each sensor sees nobody where the other one sees a person [s].
        contradicted: whether ``missed_since`` is so long ago that the estimate counts as contradicted.
    """

    calibration: PairCalibration | None
    cold: ColdStart
    told: str = ""
    shown: bool = False
    matched: tuple[tuple[int, int], ...] = ()
    owners: tuple[Mapping[int, int], Mapping[int, int]] = NO_OWNERS
    turn: int = 0
    due: float = -np.inf
    trying: bool = True
    agreed_at: float = -np.inf
    seen_since: float = np.inf
    estimate: PairEstimate | None = None
    quality: str = ""
    judged_steps: float = -1.0
    wary: bool = False
    missed_since: float = np.inf
    contradicted: bool = False

    def __post_init__(self) -> None:
        # What the lists of bodies were computed from, for `bodies_of_both` and `forget_bodies`; not part of the state.
        self._listed_from: tuple[Any, ...] = ()
        self._listed: list[tuple[int, int]] = []
        self._kept_from: tuple[Any, ...] = ()
        # In a snapshot, an estimator that is also a hypothesis is there twice; both names stand for one again.
        for key, one in self.cold.hypotheses.items():
            if self.calibration is not None and one.is_copy_of(self.calibration):
                self.cold.hypotheses[key] = self.calibration

    def bodies_of_both(self, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack]) -> list[tuple[int, int]]:
        """Return the pairs of tracking ids that refine the estimate, in turn: those matched, then those matched before.

        There must be an estimate. The list is shared between calls, and must not be changed.

        Args:
            a, b: bodies of both sensors by tracking id; new objects whenever these change, as of `SensorTracks`.
        """
        assert self.calibration is not None
        known = self.calibration.bodies
        inputs = (self.matched, known, a, b, len(known))
        if not _unchanged(inputs, self._listed_from):
            self._listed_from = inputs
            self._listed = [who for who in dict.fromkeys((*self.matched, *known)) if who[0] in a and who[1] in b]
        return self._listed

    def forget_bodies(self, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack]) -> None:
        """Drop the estimate's state of bodies that either sensor has no more; the arguments are of `bodies_of_both`."""
        assert self.calibration is not None
        known = self.calibration.bodies
        if _unchanged((known, a, b, len(known)), self._kept_from):
            return
        self.calibration.forget_bodies(lambda who: who[0] in a and who[1] in b)
        known = self.calibration.bodies
        self._kept_from = (known, a, b, len(known))

    def compare(self, seen: tuple[SensorTracks, SensorTracks] | None, now: float, lasts_s: float) -> None:
        """Set `contradicted`: whether each sensor has missed a person of the other for longer than ``lasts_s``.

        `shared_people.missed_people` decides whether a person is missed now; one negative result ends the time.

        Args:
            seen: the bodies of both sensors if none is at the same position in both; None otherwise, which counts as
                not missed.
            now: capture time of the newest frame [s].
            lasts_s: time for which people have to be missed [s].
        """
        missed = False
        if seen is not None and self.calibration is not None and all(tracks.bodies for tracks in seen):
            field = DOUBTED_FIELD if self.told == BY_LAYOUT else SURE_FIELD
            centres = [tracks.newest_centres() for tracks in seen]
            missed = missed_people(self.calibration.T_a_b, centres[0], centres[1], field)
        self.missed_since = min(self.missed_since, now) if missed else np.inf
        self.contradicted = now - self.missed_since > lasts_s

    @property
    def unproven(self) -> bool:
        """Whether the estimate is a hypothesis that most bodies agree with, refined but not yet confirmed."""
        return self.calibration is not None and not self.shown and not self.told

    @property
    def walked(self) -> bool:
        """Whether there is an estimate that does not rest on single postures."""
        return self.calibration is not None and self.calibration.walked

    @property
    def trusted(self) -> bool:
        """Whether the relative pose is used: a trusted estimate, one that people confirmed, or one from a layout."""
        if self.calibration is None or self.estimate is None:
            return False
        problem = self.estimate.problem
        unsure = problem in (WALK, WALK_ACROSS)
        return not problem or (self.shown and unsure) or (self.told == BY_LAYOUT and problem != MIRRORED_STREAM)


def _unchanged(inputs: tuple[Any, ...], before: tuple[Any, ...]) -> bool:
    """Return whether two tuples have the same objects, and an equal number as their last item."""
    return len(inputs) == len(before) and inputs[-1] == before[-1] and all(map(is_, inputs[:-1], before[:-1]))


def covariance_of(pair: PairOfSensors) -> Float64:
    """Return the covariance (6, 6) of a pair's relative pose; of a given pose, an assumed one until people confirm it.

    The pair must have an estimate. The covariance is that of a small motion in a's frame, see `PairEstimate`.
    """
    assert pair.estimate is not None
    return _GIVEN if pair.told == BY_LAYOUT and not pair.estimate.trusted else pair.estimate.covariance


def used_pairs(pairs: Mapping[Pair, PairOfSensors]) -> frozenset[Pair]:
    """Return the pairs whose relative pose is used.

    A pose from single postures may come from two different people, so it is used only where no better pairs connect
    its sensors.
    """
    groups = dict[str, set[str]]()
    trusted = {key: pair for key, pair in pairs.items() if pair.trusted}
    surer = {key for key, pair in trusted.items() if pair.told == BY_LAYOUT or pair.walked}
    for one, other in sorted(surer):
        if other in groups.get(one, ()):
            continue
        joined = groups.get(one, {one}) | groups.get(other, {other})
        groups.update(dict.fromkeys(joined, joined))
    return frozenset(key for key in trusted if key in surer or key[1] not in groups.get(key[0], ()))


def agree_elsewhere(key: Pair, agreeing: Collection[Pair], agree: Mapping[str, int]) -> bool:
    """Return whether each sensor of the pair ``key`` agrees with a third one; then these two see different people.

    Args:
        key: the pair, whose sensors do not agree with each other.
        agreeing: the pairs whose sensors see a body at the same position.
        agree: number of agreeing pairs of each sensor that is in one.
    """
    return all(agree.get(sensor, 0) > (key in agreeing) for sensor in key)


def best_pairs(placed: Mapping[str, PlacedSensor], trusted: Iterable[Pair], partners: int) -> frozenset[Pair] | None:
    """Choose the pairs to refine: the best ``partners`` of each sensor, and all of unconnected ones; None for all.

    Args:
        placed: all sensors' poses.
        trusted: the trusted pairs, the most certain first.
        partners: number of pairs of each sensor.
    """
    if len(placed) <= partners + 1:
        return None
    tied = {name: place.root if place.trusted else None for name, place in placed.items()}
    kept = {(a, b) for a, b in combinations(sorted(placed), 2) if tied[a] is None or tied[a] != tied[b]}
    count = dict.fromkeys(placed, 0)
    for a, b in trusted:
        if min(count[a], count[b]) < partners:
            kept.add((a, b))
            count[a] += 1
            count[b] += 1
    return frozenset(kept)
