"""Calibrate body sensors continuously from the people they see: poses and clock offsets, without a procedure.

`PeopleCalibration.update` takes one sensor's bodies at a time. It does not depend on how people are tracked: which
bodies are one person may be given, and is otherwise derived from the calibration itself.

The cost of a frame does not grow with time. A frame is added to its sensor's tracks; each calibrated pair of sensors is
refined with one person, in turn; one uncalibrated pair is tried; and a few times a second all poses are recomputed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart, unwalked
from mocapella.calibration.floor import Floor, FloorFromFeet, floor_of_pose, mean_floor
from mocapella.calibration.moved_sensor import disagrees_for, moved_sensors
from mocapella.calibration.pair_calibration import MIRRORED_STREAM, NOT_ONE_BODY, PairCalibration, estimates
from mocapella.calibration.pair_memory import SensorTracks, turned_joints
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.quality import figures, pair_quality
from mocapella.calibration.sensor_conditions import StreamFaults, pose_condition
from mocapella.calibration.sensor_graph import PlacedSensor, SensorPair, place_sensors
from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, layout_pair, restored_pair
from mocapella.calibration.sensor_pair import (
    BY_LAYOUT,
    GIVEN_SD,
    GIVEN_SD_M,
    NO_OWNERS,
    Pair,
    PairOfSensors,
    agree_elsewhere,
    best_pairs,
    covariance_of,
    used_pairs,
)
from mocapella.calibration.shared_people import nearest_bodies, same_people
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import adjoint
from mocapella.model.bodies import Bodies
from mocapella.model.memory import set_memory
from mocapella.model.session import SensorPose

Float64 = NDArray[np.float64]
Identities = Callable[[str], Mapping[int, int]]
"""Returns the person of each tracking id of a sensor."""

REFRESH_PART: Final = 0.05
"""Poses are recomputed once a pair's shared motion has grown by this fraction."""
MOST_JUDGED: Final = 16
"""Most pairs whose hypotheses are compared at one refresh, in turn."""
MOST_TURNS: Final = 3
"""Largest number of people whom a refinement of a pair tries until one has a new frame."""
JUMPED_BACK_S: Final = 0.5
"""Decrease of a sensor's times above which its clock was set back [s]."""
_HALVES: Final = np.repeat(np.eye(2), 3, axis=0)
"""Sums the three translation and the three rotation components of a 6-vector."""
_RECORDED: Final = {"layout": "rig"}
"""Names of attributes in a take, where they differ."""


class PeopleCalibration:
    """Estimates the poses and clocks of all sensors that send frames. Sensors need not be announced.

    Attributes:
        settings: the settings; the defaults if None is given.
        state: the present result; a new value at each refresh.
        layout: poses from a file that are used until people confirm or contradict them; None for none.
    """

    def __init__(
        self, settings: PeopleCalibrationSettings | None = None, *, layout: SensorLayout | None = None
    ) -> None:
        self.settings = settings or PeopleCalibrationSettings()
        self.layout = layout
        self.reset()

    def reset(self) -> None:
        """Forget everything except the layout."""
        self._zero_ns: int | None = None
        self._tracks: dict[str, SensorTracks] = {}
        self._newest: dict[str, float] = {}
        self._floors: dict[str, FloorFromFeet] = {}
        self._poses: dict[str, SensorPose] = {}
        self._mirror = np.zeros(0, dtype=np.int64)
        self._turned = np.zeros(0, dtype=np.bool_)
        self._pairs: dict[Pair, PairOfSensors] = {}
        self._refined: dict[str, tuple[Pair, ...]] = {}
        self._tried: dict[str, tuple[Pair, ...]] = {}
        self._turn = 0
        self._judged = 0
        self._placed: dict[str, PlacedSensor] = {}
        self._moved: dict[str, float] = {}
        self._doubted: frozenset[str] = frozenset()
        self._jumped: dict[str, float] = {}
        self._behind: dict[str, float] = {}
        self._refreshed, self._refresh_s = -np.inf, self.settings.first_refresh_s
        self._now = -np.inf
        self._completed = 0
        self._moves = 0
        self.state = PeopleState({}, (), False, 0, 0)

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Restart from given poses (4, 4), by sensor; they are used at once with little weight, and checked."""
        sensors = {name: LayoutSensor(T.tolist(), 1e3 * GIVEN_SD_M, float(np.degrees(GIVEN_SD)))
                   for name, T in T_world_sensor.items()}  # fmt: skip
        self.layout = SensorLayout(VERSION, False, sensors, [])
        self.reset()

    def update(
        self,
        bodies: Bodies,
        at_ns: int,
        people: Identities | None = None,
        pose: SensorPose | None = None,
    ) -> PeopleState:
        """Update the calibration with one sensor's frame; return the present result, as in `state`.

        Args:
            bodies: the sensor's bodies.
            at_ns: capture time on the common clock [ns].
            people: returns the person of each tracking id of a sensor; bodies of one person are matched. None derives
                the matches from the calibration.
            pose: tilt and height of the sensor, if given; a height of 0 means not given.
        """
        sensor, now = bodies.sensor, self._seconds(at_ns)
        joins = sensor not in self._tracks
        if joins:
            self._join(sensor, len(bodies.topology))
            self._mirror = np.array(bodies.topology.mirror, dtype=np.int64)
            self._turned = turned_joints(bodies.topology)
        elif now < self._newest[sensor] - JUMPED_BACK_S:
            self._tracks[sensor].clear()
            self._jumped[sensor] = now
        if pose is not None and pose.height > 0 and sensor not in self._moved:
            self._poses[sensor] = pose
        self._newest[sensor], self._now = now, now
        # Frames arrive within a few tenths of a second: a sensor whose times are older has a clock that is behind.
        self._behind[sensor] = max(self._newest.values()) - now
        weight = self.settings.pair.inferred_weight
        self._tracks[sensor].add(now, bodies.ids, bodies.positions, bodies.states, weight)
        self._floors[sensor].update(bodies, now)
        for key in self._refined[sensor]:
            if not 0 < self._pairs[key].due - now <= self.settings.pair.every_s:
                self._refine(key, people, now)
        if self._tried[sensor]:
            self._try(self._tried[sensor])
        if joins or not 0 <= now - self._refreshed < self._refresh_s:
            self._refresh(now, people)
        return self.state

    @property
    def tied(self) -> frozenset[str]:
        """Names of the sensors whose poses observations of people have confirmed."""
        return frozenset(
            name
            for key in used_pairs(self._pairs)
            if not self._pairs[key].told
            for name in key
            if self.state.sensors[name].trusted
        )

    def layout_now(self) -> SensorLayout:
        """Return the layout of the `tied` sensors, for `sensor_layout.save_layout`."""
        tied, used = self.tied, used_pairs(self._pairs)
        sensors = {
            name: LayoutSensor(
                sensor.T_world_sensor.tolist(),
                1e3 * float(np.sqrt(np.trace(sensor.covariance[:3, :3]))),
                float(np.degrees(np.sqrt(np.trace(sensor.covariance[3:, 3:])))),
            )
            for name, sensor in self.state.sensors.items()
            if name in tied
        }
        pairs = [
            layout_pair(a, b, pair_quality(a, b, pair.estimate), pair.calibration)
            for (a, b), pair in sorted(self._pairs.items())
            if pair.calibration is not None and pair.estimate is not None and (a, b) in used and {a, b} <= tied
        ]
        return SensorLayout(VERSION, self.state.floor_known, sensors, pairs)

    def memory(self) -> dict[str, Any]:
        """Return all state, not copied, for `recall`, by the names of its parts in takes."""
        return {_RECORDED.get(name, name): value for name, value in vars(self).items()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned, without a copy; `ValueError` if it is of another kind."""
        names = {recorded: name for name, recorded in _RECORDED.items()}
        set_memory(self, {names.get(name, name): value for name, value in memory.items()})

    def _seconds(self, at_ns: int) -> float:
        if self._zero_ns is None:
            self._zero_ns = at_ns
        return (at_ns - self._zero_ns) / NS_PER_S

    def _join(self, sensor: str, joints: int) -> None:
        settings = self.settings.pair
        kept = {(pair.a, pair.b): pair for pair in self.layout.pairs} if self.layout else {}
        places = (
            {name: np.array(known.T_world_sensor) for name, known in self.layout.sensors.items()} if self.layout else {}
        )
        for other in self._tracks:
            key = (min(sensor, other), max(sensor, other))
            pair = PairOfSensors(None, ColdStart(settings))
            if key in kept:
                pair.calibration, pair.told = restored_pair(kept[key], settings), BY_LAYOUT
            elif sensor in places and other in places:
                T_a_b = inverse(places[key[0]]) @ places[key[1]]
                pair.calibration, pair.told = PairCalibration.begun_from(T_a_b, settings), BY_LAYOUT
            pair.trying = pair.calibration is None
            self._pairs[key] = pair
        self._tracks[sensor] = SensorTracks.empty(joints)
        self._floors[sensor] = FloorFromFeet()
        self._newest[sensor] = -np.inf
        self._choose_pairs(None)

    def _choose_pairs(self, partners: frozenset[Pair] | None) -> None:
        """Choose the pairs that each sensor's frames update: all, or only ``partners``."""
        for chosen, wanted in ((self._refined, False), (self._tried, True)):
            keys = sorted(
                key
                for key, pair in self._pairs.items()
                if (pair.trying if wanted else pair.calibration is not None) and (partners is None or key in partners)
            )
            chosen.update({sensor: tuple(key for key in keys if sensor in key) for sensor in self._tracks})

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
        bodies = [
            ids for ids in dict.fromkeys((*pair.matched, *pair.calibration.bodies)) if ids[0] in a and ids[1] in b
        ]
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

    def _refresh(self, now: float, people: Identities | None) -> None:
        paused = now - self._refreshed > self.settings.gone_after_s
        self._refreshed, self._refresh_s = now, self.settings.refresh_s
        for sensor, tracks in self._tracks.items():
            tracks.forget_before(self._newest[sensor] - self.settings.gone_after_s)
        for key, pair in self._pairs.items():
            since = now if paused else min(pair.seen_since, now)
            pair.seen_since = since if self._both_see(key) else np.inf
        self._judge_hypotheses(now)
        self._judge_calibrations(now, people)
        self._find_moved(now)
        agreeing = self._agreeing(now)
        for key, pair in self._pairs.items():
            doubtful = self._doubtful(pair, now) and not agree_elsewhere(key, agreeing)
            pair.trying = pair.calibration is None or doubtful or pair.unproven
        unchecked = [key for key, pair in self._pairs.items() if pair.trying and pair.told and pair.calibration]
        self._doubted = frozenset(moved_sensors(unchecked, agreeing, sorted(self._tracks)))
        self._place()

    def _judge_hypotheses(self, now: float) -> None:
        tried = [(key, pair) for key, pair in self._pairs.items() if pair.cold.hypotheses]
        self._judged += MOST_JUDGED
        first = self._judged % len(tried) if len(tried) > MOST_JUDGED else 0
        found = [(key, pair.cold.likeliest()) for key, pair in (tried[first:] + tried[:first])[:MOST_JUDGED]]
        likeliest = [(key, one) for key, one in found if one is not None]
        for (key, one), raw in zip(likeliest, estimates([one.pair for _, one in likeliest]), strict=True):
            pair, (a, b) = self._pairs[key], (self._tracks[sensor] for sensor in key)
            # One posture does not tell people apart, who resemble each other.
            estimate = one.judged(raw, wary=pair.wary or max(len(a.bodies), len(b.bodies)) > 1)
            if estimate.trusted:
                self._believe(key, one.pair, now)
                continue
            if pair.calibration is None:
                pair.estimate = estimate
            if pair.calibration is None or pair.unproven:
                agreed = pair.cold.agreed(a, b, pair.calibration)
                if agreed is not pair.calibration:
                    pair.calibration, pair.judged_steps, pair.agreed_at = agreed, -1.0, now

    def _judge_calibrations(self, now: float, people: Identities | None) -> None:
        self._match(people is None)
        known = [(key, pair, pair.calibration) for key, pair in self._pairs.items() if pair.calibration is not None]
        for key, _, calibration in known:
            a, b = (self._tracks[sensor].bodies for sensor in key)
            calibration.forget_bodies(lambda who, a=a, b=b: who[0] in a and who[1] in b)
            if self._frozen(key[0]) or self._frozen(key[1]):
                for body in calibration.bodies.values():  # a frozen stream disagrees, but the sensor was not moved
                    body[at.DISAGREES_SINCE] = np.nan
        news = [one for one in known if one[1].estimate is None or one[2].scalars[at.STEPS] != one[1].judged_steps]
        for (key, pair, calibration), raw in zip(news, estimates([one[2] for one in news]), strict=True):
            doubted = (pair.unproven or pair.told) and not calibration.walked
            estimate = unwalked(raw) if doubted else raw
            pair.estimate, pair.judged_steps = estimate, float(calibration.scalars[at.STEPS])
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
                np.isnan(body[at.DISAGREES_SINCE]) and now - body[at.STEP_AT] < self.settings.gone_after_s
                for body in calibration.bodies.values()
            ):
                pair.agreed_at = now
                if estimate.trusted:
                    pair.told, pair.shown = "", True

    def _match(self, all_pairs: bool) -> None:
        """Match the nearest bodies of a pair where identities are not given, or its pose is not trusted yet."""
        for key in sorted({key for keys in self._refined.values() for key in keys}):
            pair = self._pairs[key]
            if pair.calibration is not None and (all_pairs or not pair.trusted):
                a, b = (self._tracks[sensor] for sensor in key)
                pair.owners = NO_OWNERS
                pair.matched = nearest_bodies(pair.calibration.T_a_b, a, b, self.settings.match_within_m)

    def _doubtful(self, pair: PairOfSensors, now: float) -> bool:
        """Return whether both sensors have seen bodies for long without any agreeing."""
        return now - max(pair.agreed_at, pair.seen_since) > self.settings.moved_after_s

    def _agreeing(self, now: float) -> list[Pair]:
        return [key for key, pair in self._pairs.items() if now - pair.agreed_at < self.settings.moved_after_s]

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

    def _note_moved(self, moved: Iterable[str], now: float) -> None:
        for sensor in moved:
            self._moved[sensor] = now
            self._floors[sensor] = FloorFromFeet()
            self._poses.pop(sensor, None)
            self._moves += 1

    def _place(self) -> None:
        names = sorted(self._tracks)
        used = used_pairs(self._pairs)
        edges = [
            SensorPair(*key, pair.estimate.T_a_b, covariance_of(pair), pair.estimate.offset, key in used)
            for key, pair in self._pairs.items()
            if pair.estimate is not None and pair.told != "others" and np.isfinite(pair.estimate.T_a_b).all()
        ]
        placed = self._placed = place_sensors(names, edges, self._placed)
        for sensor in [s for s in self._moved if any(s in key and pair.trusted for key, pair in self._pairs.items())]:
            del self._moved[sensor]
        self._begin_from_others(placed)
        self._choose_pairs(best_pairs(placed, edges, self.settings.partners))
        tried = {key for keys in self._tried.values() for key in keys}
        for key, pair in self._pairs.items():
            if key not in tried:
                pair.cold.clear()
        worlds = {root: self._world(root, placed) for root in dict.fromkeys(place.root for place in placed.values())}
        self.state = PeopleState(
            sensors=self._sensors(placed, {root: T for root, (T, _) in worlds.items()}),
            qualities=tuple(
                pair_quality(*key, pair.estimate)
                for key, pair in sorted(self._pairs.items())
                if pair.estimate is not None
            ),
            floor_known=bool(worlds) and all(known for _, known in worlds.values()),
            calibrations=self._completed,
            moved=self._moves,
        )

    def _begin_from_others(self, placed: Mapping[str, PlacedSensor]) -> None:
        """Initialise pairs without an estimate from other pairs' poses, instead of trying hypotheses."""
        if len(placed) > self.settings.partners + 1:
            return
        for (a, b), pair in self._pairs.items():
            one, other = placed[a], placed[b]
            tied = one.trusted and other.trusted and one.root == other.root
            if pair.calibration is None and tied and a not in self._moved and b not in self._moved:
                clocks = [place.offset.seconds if place.offset is not None else 0.0 for place in (one, other)]
                T_a_b = inverse(one.T_root_sensor) @ other.T_root_sensor
                offset = clocks[1] - clocks[0]
                pair.calibration = PairCalibration.begun_from(T_a_b, self.settings.pair, offset)
                pair.told, pair.trying, pair.cold = "others", False, ColdStart(self.settings.pair)

    def _world(self, root: str, placed: Mapping[str, PlacedSensor]) -> tuple[Float64, bool]:
        """Return ``T_world_root``, and whether its floor is known; a given pose takes precedence over feet."""
        members = {name: place for name, place in placed.items() if place.root == root and place.trusted}
        given = [
            (place.T_root_sensor, floor_of_pose(self._poses[name].tilt, self._poses[name].height))
            for name, place in members.items()
            if name in self._poses
        ]
        found = {name: self._floors[name].known or self._layout_floor(name) for name in members}
        floors = given or [(members[name].T_root_sensor, floor) for name, floor in found.items() if floor is not None]
        return (mean_floor(floors).T_level_sensor, True) if floors else (np.eye(4), False)

    def _layout_floor(self, sensor: str) -> Floor | None:
        if (
            self.layout is None
            or not self.layout.floor_known
            or sensor not in self.layout.sensors
            or sensor in self._moved
        ):
            return None
        return Floor.under(np.array(self.layout.sensors[sensor].T_world_sensor))

    def _sensors(
        self, placed: Mapping[str, PlacedSensor], T_world_root: Mapping[str, Float64]
    ) -> dict[str, CalibratedSensor]:
        to_world = np.stack([T_world_root[place.root] for place in placed.values()])
        T = to_world @ np.stack([place.T_root_sensor for place in placed.values()])
        turn = adjoint(to_world)
        covariance = turn @ np.stack([place.covariance for place in placed.values()]) @ np.swapaxes(turn, -1, -2)
        # A sensor's standard deviations refer to a small motion in its own frame.
        own = adjoint(inverse(T))
        sd = np.sqrt(np.diagonal(own @ covariance @ np.swapaxes(own, -1, -2), axis1=-2, axis2=-1) @ _HALVES)
        return {
            name: CalibratedSensor(
                sensor=name,
                T_world_sensor=T[i],
                covariance=covariance[i],
                root=place.root,
                clock=place.offset,
                trusted=place.trusted and not ({name} & (self._moved.keys() | self._doubted) or self._frozen(name)),
                quality="" if place.root == name else figures(float(sd[i, 0]), float(sd[i, 1])),
                condition=self._condition(name, placed),
            )
            for i, (name, place) in enumerate(placed.items())
        }

    def _condition(self, name: str, placed: Mapping[str, PlacedSensor]) -> str:
        behind_s = self._behind.get(name, 0.0)
        faults = StreamFaults(
            frozen=self._frozen(name),
            behind_s=behind_s if behind_s > self.settings.clock_jump_s else 0.0,
            jumped_s=self._now - self._jumped.get(name, -np.inf),
            moved=name in self._moved,
        )
        pairs = {key: pair for key, pair in self._pairs.items() if name in key}
        return faults.condition or pose_condition(name, pairs, placed)
