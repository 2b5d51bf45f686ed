"""The pairs of sensors that people calibrate: their refinement by frames, and the judgement of estimates.

`people.PeopleCalibration` decides when a pair is updated and judged, and makes poses of sensors from those of pairs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart, unwalked
from mocapella.calibration.floor import FloorFromFeet
from mocapella.calibration.moved_sensor import disagrees_for, moved_sensors
from mocapella.calibration.pair_calibration import MIRRORED_STREAM, NOT_ONE_BODY, PairCalibration, estimates
from mocapella.calibration.pair_memory import NO_LEGS, SensorTracks
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.calibration.quality import pair_quality
from mocapella.calibration.sensor_pair import NO_OWNERS, Pair, PairOfSensors, agree_elsewhere
from mocapella.calibration.shared_people import nearest_bodies, same_people
from mocapella.model.session import SensorPose

Identities = Callable[[str], Mapping[int, int]]
"""Returns the person of each tracking id of a sensor."""

REFRESH_PART: Final = 0.05
"""Poses are recomputed once a pair's shared motion has grown by this fraction."""
MOST_TURNS: Final = 3
"""Largest number of people whom a refinement of a pair tries until one has a new frame."""


class PairsFromPeople:
    """Base of `people.PeopleCalibration`: the relative pose of every two sensors, estimated from the people they see.

    Attributes:
        settings: settings of the calibration.
    """

    settings: PeopleCalibrationSettings

    def reset_pairs(self) -> None:
        """Forget all sensors and pairs."""
        self._tracks: dict[str, SensorTracks] = {}
        self._newest: dict[str, float] = {}
        self._floors: dict[str, FloorFromFeet] = {}
        self._poses: dict[str, SensorPose] = {}
        self._head_up_s: dict[str, float] = {}
        self._mirror = np.zeros(0, dtype=np.int64)
        self._turned = np.zeros(0, dtype=np.bool_)
        self._legs = NO_LEGS
        self._pairs: dict[Pair, PairOfSensors] = {}
        self._refined: dict[str, tuple[Pair, ...]] = {}
        self._tried: dict[str, tuple[Pair, ...]] = {}
        self._turn = 0
        self._moved: dict[str, float] = {}
        self._doubted: frozenset[str] = frozenset()
        self._refresh_s = self.settings.first_refresh_s
        self._completed = 0
        self._moves = 0

    def _choose_pairs(self, partners: frozenset[Pair] | None) -> None:
        """Choose the pairs that each sensor's frames update: all, or only ``partners``."""
        self._refined, self._tried = (
            by_sensor(
                self._tracks,
                sorted(
                    key
                    for key, pair in self._pairs.items()
                    if (pair.trying if wanted else pair.calibration is not None)
                    and (partners is None or key in partners)
                ),
            )
            for wanted in (False, True)
        )

    def _frozen(self, sensor: str) -> bool:
        return bool(self._tracks[sensor].frozen <= self._newest[sensor] - self.settings.frozen_after_s)

    def _both_see(self, key: Pair) -> bool:
        one, other = (self._tracks[sensor].bodies for sensor in key)
        return bool(one) and bool(other) and not self._frozen(key[0]) and not self._frozen(key[1])

    def _refine(self, key: Pair, people: Identities | None, now: float) -> None:
        """Refine a pair by the newest frame of one person, in turn."""
        pair = self._pairs[key]
        if pair.calibration is None or not self._both_see(key):
            return
        a, b = (self._tracks[sensor].bodies for sensor in key)
        if people is not None and pair.trusted:
            one, other = people(key[0]), people(key[1])
            if one is not pair.owners[0] or other is not pair.owners[1]:
                pair.owners, pair.matched = (one, other), same_people(one, other)
        bodies = pair.bodies_of_both(a, b)
        for _ in range(min(len(bodies), MOST_TURNS)):
            ids = bodies[pair.turn % len(bodies)]
            pair.turn += 1
            if pair.calibration.update(ids, a[ids[0]], b[ids[1]], self._mirror, self._turned):
                pair.due = now + self.settings.pair.every_s
                return

    def _try(self, keys: tuple[Pair, ...]) -> None:
        """Update all hypotheses of one pair, in turn."""
        self._turn += 1
        key = keys[self._turn % len(keys)]
        pair = self._pairs[key]
        if not self._both_see(key):
            return
        a, b = (self._tracks[sensor] for sensor in key)
        pair.cold.update(a, b, self._mirror, self._turned)

    def _judge_hypotheses(self, keys: Sequence[Pair], now: float) -> None:
        found = [(key, self._pairs[key].cold.likeliest()) for key in keys]
        likeliest = [(key, one) for key, one in found if one is not None]
        for (key, one), raw in zip(likeliest, estimates([one.pair for _, one in likeliest]), strict=True):
            pair, (a, b) = self._pairs[key], (self._tracks[sensor] for sensor in key)
            # One posture does not tell people apart, who resemble each other.
            estimate = one.judged(raw, wary=pair.wary or pair.walked or max(len(a.bodies), len(b.bodies)) > 1)
            if estimate.trusted:
                self._believe(key, one.pair, now)
                continue
            if pair.calibration is None:
                pair.estimate, pair.quality = estimate, pair_quality(*key, estimate)
            if pair.calibration is None or pair.unproven:
                agreed = pair.cold.agreed(a, b, pair.calibration)
                if agreed is not pair.calibration:
                    pair.calibration, pair.judged_steps, pair.agreed_at = agreed, -1.0, now

    def _judge_calibrations(self, keys: Sequence[Pair], now: float, people: Identities | None) -> None:
        self._match(keys, people is None)
        pairs = [(key, self._pairs[key]) for key in keys]
        known = [(key, pair, pair.calibration) for key, pair in pairs if pair.calibration is not None]
        for key, pair, calibration in known:
            pair.forget_bodies(*(self._tracks[sensor].bodies for sensor in key))
            if self._frozen(key[0]) or self._frozen(key[1]):
                for body in calibration.bodies.values():  # a frozen stream disagrees, but the sensor was not moved
                    body[at.DISAGREES_SINCE] = np.nan
        news = [one for one in known if one[1].estimate is None or one[2].scalars[at.STEPS] != one[1].judged_steps]
        for (key, pair, calibration), raw in zip(news, estimates([one[2] for one in news]), strict=True):
            doubted = (pair.unproven or pair.told) and not calibration.walked
            estimate = unwalked(raw) if doubted else raw
            pair.estimate, pair.judged_steps = estimate, float(calibration.scalars[at.STEPS])
            pair.quality = pair_quality(*key, estimate)
            if pair.unproven and estimate.problem in (NOT_ONE_BODY, MIRRORED_STREAM):
                pair.calibration, pair.matched, pair.owners = None, (), NO_OWNERS
                continue
            calibration.trust(estimate)
            calibration.follow_clock(estimate)
            if not self._both_see(key):
                continue
            soon = max(self.settings.first_refresh_s, REFRESH_PART * estimate.motion_s)
            self._refresh_s = min(self._refresh_s, soon)
            if any(
                math.isnan(body.item(at.DISAGREES_SINCE)) and now - body.item(at.STEP_AT) < self.settings.gone_after_s
                for body in calibration.bodies.values()
            ):
                pair.agreed_at = now
                if estimate.trusted:
                    pair.told, pair.shown = "", True

    def _match(self, keys: Sequence[Pair], all_pairs: bool) -> None:
        """Match the nearest bodies of a pair where identities are not given, or its pose is not trusted yet."""
        for key in keys:
            if key not in self._refined[key[0]]:
                continue
            pair = self._pairs[key]
            if pair.calibration is not None and (all_pairs or not pair.trusted):
                a, b = (self._tracks[sensor] for sensor in key)
                pair.owners = NO_OWNERS
                pair.matched = nearest_bodies(pair.calibration.T_a_b, a, b, self.settings.match_within_m)

    def _doubtful(self, pair: PairOfSensors, now: float) -> bool:
        """Return whether both sensors have seen bodies for long without any agreeing."""
        return now - max(pair.agreed_at, pair.seen_since) > self.settings.moved_after_s

    def _agreeing(self, now: float) -> dict[Pair, None]:
        return {key: None for key, pair in self._pairs.items() if now - pair.agreed_at < self.settings.moved_after_s}

    def _believe(self, key: Pair, found: PairCalibration, now: float) -> None:
        """Accept a hypothesis. If it replaces a confirmed estimate, a sensor was moved."""
        pair = self._pairs[key]
        if pair.walked and not pair.told and not pair.unproven:
            self._note_moved(moved_sensors([key], self._agreeing(now), sorted(self._tracks)), now)
        pair.calibration, pair.cold, pair.told = found, ColdStart(self.settings.pair), ""
        pair.shown, pair.judged_steps, pair.agreed_at = True, -1.0, now
        self._completed += 1

    def _find_moved(self, now: float) -> None:
        disagreeing = [
            key
            for key, pair in self._pairs.items()
            if pair.calibration is not None
            and pair.trusted
            and disagrees_for(pair.calibration, now) > self.settings.moved_after_s
        ]
        if not disagreeing:
            return
        walked = [key for key in disagreeing if self._pairs[key].walked or self._pairs[key].told]
        for key in set(disagreeing) - set(walked):  # the estimate from single postures was wrong
            self._pairs[key] = PairOfSensors(None, ColdStart(self.settings.pair), wary=True)
        moved = moved_sensors(walked, self._agreeing(now), sorted(self._tracks))
        self._note_moved(moved, now)
        for key in self._pairs:
            if set(key) & set(moved):
                self._pairs[key] = PairOfSensors(None, ColdStart(self.settings.pair))

    def _find_doubts(self, now: float) -> None:
        """Decide which pairs' hypotheses are tried, and which sensors' poses are doubted."""
        agreeing = self._agreeing(now)
        agree = Counter(sensor for key in agreeing for sensor in key)
        for key, pair in self._pairs.items():
            doubtful = self._doubtful(pair, now) and not agree_elsewhere(key, agreeing, agree)
            pair.trying = pair.calibration is None or doubtful or pair.unproven
            seen = (self._tracks[key[0]], self._tracks[key[1]]) if doubtful else None
            pair.compare(seen, now, self.settings.gone_after_s)
        unchecked = [key for key, pair in self._pairs.items() if pair.contradicted and pair.told]
        self._doubted = frozenset(moved_sensors(unchecked, agreeing, sorted(self._tracks)))

    def _note_moved(self, moved: Iterable[str], now: float) -> None:
        for sensor in moved:
            self._moved[sensor] = now
            self._floors[sensor] = FloorFromFeet()
            self._poses.pop(sensor, None)
            self._head_up_s.pop(sensor, None)
            self._moves += 1


def by_sensor(sensors: Iterable[str], keys: Iterable[Pair]) -> dict[str, tuple[Pair, ...]]:
    """Group pairs by sensor.

    Args:
        sensors: names; each gets an entry, which is empty if it is in no pair.
        keys: pairs of these names.

    Returns:
        The pairs of each sensor, in the order of ``keys``.
    """
    found: dict[str, list[Pair]] = {sensor: [] for sensor in sensors}
    for key in keys:
        for sensor in key:
            found[sensor].append(key)
    return {sensor: tuple(own) for sensor, own in found.items()}
