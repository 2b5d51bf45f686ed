"""Where all sensors are and what their clocks say, from the people who walk before them: no ceremony, ever better.

`PeopleCalibration.update` takes one sensor's bodies after the other. It knows nothing of how people are tracked; who
is the same person in two sensors may be handed in, and is found from the calibration itself where it is not.

What a frame costs does not depend on what was before. A frame is added to its sensor's tracks; each pair of sensors
that is known is refined with one person at a time, in turn; one pair that is not known yet is tried; and a few times a
second everything is put together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import Floor, FloorFromFeet, floor_of_pose, mean_floor
from mocapella.calibration.moved_sensor import disagrees_for, moved_sensors
from mocapella.calibration.pair_calibration import (
    MIRRORED_STREAM,
    NOT_ONE_BODY,
    WALK,
    WALK_ACROSS,
    PairCalibration,
    PairEstimate,
    PairSettings,
    estimates,
)
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.quality import figures, pair_quality
from mocapella.calibration.sensor_graph import PlacedSensor, SensorPair, place_sensors
from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, layout_pair, restored_pair
from mocapella.calibration.shared_people import nearest_bodies, same_people
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import adjoint
from mocapella.model.bodies import Bodies
from mocapella.model.session import SensorPose
from mocapella.settings import check

Float64 = NDArray[np.float64]
Pair = tuple[str, str]
WhoIsWho = Callable[[str], Mapping[int, int]]
"""The person of each tracking id of a sensor."""


@dataclass(frozen=True)
class PeopleCalibrationSettings:
    """What concerns all sensors.

    Attributes:
        pair: of each pair of sensors.
        match_within_m: bodies of two sensors whose centres are nearer are one person, where nobody else says who is
            who [m].
        moved_after_s: a sensor that nobody agrees with for so long was moved [s].
        frozen_after_s: a sensor whose bodies do not move by a bit for so long is not believed [s].
        gone_after_s: a body that a sensor has not seen for so long is forgotten [s].
        clock_jump_s: a sensor whose frames come later than others' with times so much older has another clock [s].
        refresh_s: the places of all sensors are worked out anew so often [s] …
        first_refresh_s: … and so often at first, while a pair of sensors has hardly seen anybody walk.
        partners: with more than so many others, each sensor is refined against so many of those it is tied to best.
    """

    RECORDED_AS: ClassVar[str] = "PeopleSettings"

    pair: PairSettings = field(default_factory=PairSettings)
    match_within_m: float = 0.5
    moved_after_s: float = 2.0
    frozen_after_s: float = 0.5
    gone_after_s: float = 1.0
    clock_jump_s: float = 2.0
    refresh_s: float = 0.5
    first_refresh_s: float = 0.1
    partners: int = 4

    def __post_init__(self) -> None:
        for name in (
            "match_within_m", "moved_after_s", "frozen_after_s", "gone_after_s", "clock_jump_s", "refresh_s",
            "first_refresh_s",
        ):  # fmt: skip
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "greater than 0")
        check(self.partners >= 1, "partners", self.partners, "1 or more")


BY_LAYOUT: Final = "rig"
"""Of `PairOfSensors.told`; takes hold this value."""
_RECORDED: Final = {"layout": "rig"}
"""Names of attributes in a take, where they differ."""
_NOBODYS: Final[tuple[Mapping[int, int], Mapping[int, int]]] = ({}, {})


@dataclass
class PairOfSensors:
    """Two sensors: the estimate that is believed, or the hypotheses that are tried.

    Attributes:
        calibration: believed; None before there is one.
        cold: what else it could be; without hypotheses while nothing speaks against what is believed.
        told: `BY_LAYOUT` while all that is known is what a layout said; ``others`` while it is what other sensors say
            of these two; empty once people have shown it.
        shown: whether people have shown it once: then it is used also while it is less sure again.
        matched: tracking ids in a and b of bodies that are one person.
        owners: what that was last made of, where somebody says who is who.
        turn: counts up; whose turn it is among them.
        due: when it is refined again [s].
        trying: whether the hypotheses are tried.
        agreed_at: when somebody was last where both say [s].
        seen_since: since when both see somebody without a break [s].
        estimate: of the last refresh at which there was something new; judged_steps: how many steps it was made of.
    """

    calibration: PairCalibration | None
    cold: ColdStart
    told: str = ""
    shown: bool = False
    matched: tuple[tuple[int, int], ...] = ()
    owners: tuple[Mapping[int, int], Mapping[int, int]] = _NOBODYS
    turn: int = 0
    due: float = -np.inf
    trying: bool = True
    agreed_at: float = -np.inf
    seen_since: float = np.inf
    estimate: PairEstimate | None = None
    judged_steps: float = -1.0

    @property
    def unproven(self) -> bool:
        """Whether it is only a hypothesis on which people agree: refined by everybody, and used when that is sure."""
        return self.calibration is not None and not self.shown and not self.told

    @property
    def trusted(self) -> bool:
        """Whether the place of one beside the other is used."""
        if self.calibration is None or self.estimate is None:
            return False
        problem = self.estimate.problem
        unsure = problem in (WALK, WALK_ACROSS)
        return not problem or (self.shown and unsure) or (self.told == BY_LAYOUT and problem != MIRRORED_STREAM)


class PeopleCalibration:
    """All sensors. Which there are is learnt from who speaks; no sensor is announced."""

    def __init__(
        self, settings: PeopleCalibrationSettings | None = None, *, layout: SensorLayout | None = None
    ) -> None:
        self.settings = settings or PeopleCalibrationSettings()
        self.layout = layout
        self.reset()

    def reset(self) -> None:
        """Forget everything but the layout that it was made with."""
        self._zero_ns: int | None = None
        self._tracks: dict[str, SensorTracks] = {}
        self._newest: dict[str, float] = {}
        self._floors: dict[str, FloorFromFeet] = {}
        self._poses: dict[str, SensorPose] = {}
        self._mirror = np.zeros(0, dtype=np.int64)
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
        """Forget everything, and begin from places that somebody told: used at once, believed little, and checked."""
        sensors = {name: LayoutSensor(T.tolist(), 1e3 * TOLD_SD_M, float(np.degrees(TOLD_SD)))
                   for name, T in T_world_sensor.items()}  # fmt: skip
        self.layout = SensorLayout(VERSION, False, sensors, [])
        self.reset()

    def update(
        self,
        bodies: Bodies,
        at_ns: int,
        people: WhoIsWho | None = None,
        pose: SensorPose | None = None,
    ) -> PeopleState:
        """Take one sensor's newest bodies in.

        Args:
            bodies: that it tracks.
            at_ns: when it captured them, on the common clock.
            people: tells who is who, as far as it is known: bodies with one number are one person. None = find it out.
            pose: the sensor's tilt and height where they are given; a height of 0 is none.

        Returns:
            What is known now; also at `state`.
        """
        sensor, now = bodies.sensor, self._seconds(at_ns)
        joins = sensor not in self._tracks
        if joins:
            self._join(sensor, len(bodies.topology))
            self._mirror = np.array(bodies.topology.mirror, dtype=np.int64)
        elif now < self._newest[sensor] - JUMPED_BACK_S:
            self._tracks[sensor].clear()
            self._jumped[sensor] = now
        if pose is not None and pose.height > 0 and sensor not in self._moved:
            self._poses[sensor] = pose
        self._newest[sensor], self._now = now, now
        # What comes last is newest, a few tenths of a second aside: who comes later with older times is behind.
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
        """The sensors that people have shown to be where they are believed to be."""
        return frozenset(
            name
            for key, pair in self._pairs.items()
            if pair.trusted and not pair.told
            for name in key
            if self.state.sensors[name].trusted
        )

    def layout_now(self) -> SensorLayout:
        """What people have shown, to be saved: the sensors that are `tied`."""
        tied = self.tied
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
            if pair.calibration is not None and pair.estimate is not None and pair.trusted and {a, b} <= tied
        ]
        return SensorLayout(VERSION, self.state.floor_known, sensors, pairs)

    def memory(self) -> dict[str, Any]:
        """Return everything it remembers, by the names that takes hold."""
        return {_RECORDED.get(name, name): value for name, value in vars(self).items()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Remember what a `memory` holds."""
        names = {recorded: name for name, recorded in _RECORDED.items()}
        vars(self).update({names.get(name, name): value for name, value in memory.items()})

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
        """Which pairs each sensor's frames concern: all, or ``partners`` and those that nothing ties yet."""
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

    def _refine(self, key: Pair, people: WhoIsWho | None, now: float) -> None:
        """Take in one person's newest frame, if there is one: everybody in turn."""
        pair = self._pairs[key]
        if pair.calibration is None or not self._both_see(key):
            return
        a, b = (self._tracks[sensor].bodies for sensor in key)
        if people is not None and pair.trusted:
            one, other = people(key[0]), people(key[1])
            if one is not pair.owners[0] or other is not pair.owners[1]:
                pair.owners, pair.matched = (one, other), same_people(one, other)
        bodies = [
            who for who in dict.fromkeys((*pair.matched, *pair.calibration.bodies)) if who[0] in a and who[1] in b
        ]
        for _ in range(min(len(bodies), MOST_TURNS)):
            who = bodies[pair.turn % len(bodies)]
            pair.turn += 1
            if pair.calibration.update(who, a[who[0]], b[who[1]], self._mirror):
                pair.due = now + self.settings.pair.every_s
                return

    def _try(self, keys: tuple[Pair, ...]) -> None:
        """Take the newest frames in for all hypotheses of one pair, in turn."""
        self._turn += 1
        key = keys[self._turn % len(keys)]
        pair = self._pairs[key]
        if not self._both_see(key):
            return
        a, b = (self._tracks[sensor].bodies for sensor in key)
        pair.cold.update(a, b, self._mirror)

    def _refresh(self, now: float, people: WhoIsWho | None) -> None:
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
            doubtful = self._doubtful(pair, now) and not _agree_elsewhere(key, agreeing)
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
            pair, estimate = self._pairs[key], one.judged(raw)
            if estimate.trusted:
                self._believe(key, one.pair, now)
                continue
            if pair.calibration is None:
                pair.estimate = estimate
            if pair.calibration is None or pair.unproven:
                a, b = (self._tracks[sensor].bodies for sensor in key)
                agreed = pair.cold.agreed(a, b, pair.calibration)
                if agreed is not pair.calibration:
                    pair.calibration, pair.judged_steps, pair.agreed_at = agreed, -1.0, now

    def _judge_calibrations(self, now: float, people: WhoIsWho | None) -> None:
        self._match(people is None)
        known = [(key, pair, pair.calibration) for key, pair in self._pairs.items() if pair.calibration is not None]
        for key, _, calibration in known:
            a, b = (self._tracks[sensor].bodies for sensor in key)
            calibration.forget_bodies(lambda who, a=a, b=b: who[0] in a and who[1] in b)
            if self._frozen(key[0]) or self._frozen(key[1]):
                for body in calibration.bodies.values():  # a picture that stands still disagrees, and was not moved
                    body[at.DISAGREES_SINCE] = np.nan
        news = [one for one in known if one[1].estimate is None or one[2].scalars[at.STEPS] != one[1].judged_steps]
        for (key, pair, calibration), estimate in zip(news, estimates([one[2] for one in news]), strict=True):
            pair.estimate, pair.judged_steps = estimate, float(calibration.scalars[at.STEPS])
            if pair.unproven and estimate.problem in (NOT_ONE_BODY, MIRRORED_STREAM):
                pair.calibration, pair.matched, pair.owners = None, (), _NOBODYS
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
        """Who is who, where nobody says it, or not of sensors whose place is not used yet: the nearest."""
        for key in sorted({key for keys in self._refined.values() for key in keys}):
            pair = self._pairs[key]
            if pair.calibration is not None and (all_pairs or not pair.trusted):
                a, b = (self._tracks[sensor].bodies for sensor in key)
                pair.owners = _NOBODYS
                pair.matched = nearest_bodies(pair.calibration.T_a_b, a, b, self.settings.match_within_m)

    def _doubtful(self, pair: PairOfSensors, now: float) -> bool:
        """Both see somebody, and for long nobody has been where both say."""
        return now - max(pair.agreed_at, pair.seen_since) > self.settings.moved_after_s

    def _agreeing(self, now: float) -> list[Pair]:
        return [key for key, pair in self._pairs.items() if now - pair.agreed_at < self.settings.moved_after_s]

    def _believe(self, key: Pair, found: PairCalibration, now: float) -> None:
        """A hypothesis has won; where another estimate was believed, a sensor was moved, or the layout was wrong."""
        pair = self._pairs[key]
        if pair.calibration is not None and not pair.told and not pair.unproven:
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
        moved = moved_sensors(disagreeing, self._agreeing(now), sorted(self._tracks))
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
        edges = [
            SensorPair(*key, pair.estimate.T_a_b, _covariance_of(pair), pair.estimate.offset, pair.trusted)
            for key, pair in self._pairs.items()
            if pair.estimate is not None and pair.told != "others" and np.isfinite(pair.estimate.T_a_b).all()
        ]
        placed = self._placed = place_sensors(names, edges, self._placed)
        for sensor in [s for s in self._moved if any(s in key and pair.trusted for key, pair in self._pairs.items())]:
            del self._moved[sensor]
        self._begin_from_others(placed)
        self._choose_pairs(self._partners(placed, edges))
        tried = {key for keys in self._tried.values() for key in keys}
        for key, pair in self._pairs.items():
            if key not in tried:
                pair.cold.hypotheses.clear()
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
        """Two sensors that others tie to each other need no hypotheses; what they see together refines it."""
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
        """``T_world_root``, and whether its floor is known. A given pose is believed rather than feet."""
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
        # The standard deviations of a sensor's own place: as a small motion in its own frame.
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
                condition=self._condition(name, place, placed),
            )
            for i, (name, place) in enumerate(placed.items())
        }

    def _condition(self, name: str, place: PlacedSensor, placed: Mapping[str, PlacedSensor]) -> str:
        if condition := self._stream_condition(name):
            return condition
        pairs = {key: pair for key, pair in self._pairs.items() if name in key}
        if not pairs:
            return "it is the only sensor: what it does not see, nobody sees"
        tied = place.trusted and any(
            other.root == place.root and other.trusted for key, other in placed.items() if key != name
        )
        if tied:
            return self._doubts(name, pairs)
        seen = [(key, pair.estimate) for key, pair in pairs.items() if pair.estimate is not None]
        if not seen:
            return "no other sensor sees the people that it sees: walk where two sensors see you"
        key, estimate = min(seen, key=lambda item: item[1].position_sd)
        return f"with {_other(key, name)}: {estimate.problem}" if estimate.problem else ""

    def _stream_condition(self, name: str) -> str:
        """What is wrong with what the sensor sends; empty where nothing is."""
        if self._frozen(name):
            return "its picture stands still: start the sensor again"
        if self._behind.get(name, 0.0) > self.settings.clock_jump_s:
            return f"its clock is {self._behind[name]:.0f} s behind another sensor's: set the clocks alike"
        if 0 <= self._now - self._jumped.get(name, -np.inf) < SAID_FOR_S:
            return "its clock jumped back"
        if name in self._moved:
            return "it was moved (or the sensor beside it): walk a few steps where both see you"
        return ""

    def _doubts(self, name: str, pairs: Mapping[Pair, PairOfSensors]) -> str:
        for key, pair in pairs.items():
            if pair.trusted and pair.estimate is not None and _in_one_place(pair.estimate.T_a_b):
                return f"it stands where {_other(key, name)} stands, and sees no more"
            if pair.calibration is not None and pair.trying:
                where = "where the layout says" if pair.told == BY_LAYOUT else f"where {_other(key, name)} sees them"
                return f"it does not see people {where}: walk a few steps where both see you"
        return ""

    def _partners(self, placed: Mapping[str, PlacedSensor], edges: Iterable[SensorPair]) -> frozenset[Pair] | None:
        """Which pairs go on being refined: with few sensors all, else as many for each sensor as are wanted."""
        if len(placed) <= self.settings.partners + 1:
            return None
        kept = {
            (a, b)
            for a, b in combinations(sorted(placed), 2)
            if not (placed[a].trusted and placed[b].trusted and placed[a].root == placed[b].root)
        }
        count = dict.fromkeys(placed, 0)
        for edge in sorted((edge for edge in edges if edge.trusted), key=lambda edge: edge.variance):
            if min(count[edge.a], count[edge.b]) < self.settings.partners:
                kept.add((edge.a, edge.b))
                count[edge.a] += 1
                count[edge.b] += 1
        return frozenset(kept)


def _agree_elsewhere(key: Pair, agreeing: Iterable[Pair]) -> bool:
    """Each of the two agrees with a third: then these two just see different people."""
    return all(any(sensor in other and other != key for other in agreeing) for sensor in key)


def _covariance_of(pair: PairOfSensors) -> Float64:
    assert pair.estimate is not None
    return _TOLD if pair.told == BY_LAYOUT and not pair.estimate.trusted else pair.estimate.covariance


def _other(key: Pair, name: str) -> str:
    return key[0] if key[1] == name else key[1]


def _in_one_place(T_a_b: Float64) -> bool:
    x, y, z = T_a_b[:3, 3].tolist()
    cosine = (T_a_b[0, 0] + T_a_b[1, 1] + T_a_b[2, 2] - 1) / 2
    return bool(x * x + y * y + z * z < ONE_PLACE_M**2 and cosine > np.cos(ONE_PLACE_TURN))


REFRESH_PART: Final = 0.05
"""Of the motion that a pair of sensors has seen so far: after so much more everything is worked out anew."""
MOST_JUDGED: Final = 16
"""Pairs of sensors whose hypotheses are compared at one refresh, in turn."""
MOST_TURNS: Final = 3
"""Of people in a row who have no new frame; then the next frame goes on."""
JUMPED_BACK_S: Final = 0.5
"""Times that go back by more are those of another clock [s]."""
SAID_FOR_S: Final = 5.0
"""A clock that jumped is told of for so long [s]."""
ONE_PLACE_M: Final = 0.1
"""Two sensors that are nearer stand in one place [m] …"""
ONE_PLACE_TURN: Final = np.radians(5.0)
"""… if they also look the same way [rad]."""
TOLD_SD_M: Final = 0.15
"""What is expected of a place that somebody told [m] …"""
TOLD_SD: Final = np.radians(10.0)
"""… and of the direction [rad], until people have shown it."""
_TOLD: Final = np.diag([TOLD_SD_M**2 / 3] * 3 + [TOLD_SD**2 / 3] * 3)
_HALVES: Final = np.repeat(np.eye(2), 3, axis=0)
"""Sums the translation's and the rotation's part of six numbers."""
