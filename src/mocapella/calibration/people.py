"""Where all sensors are and what their clocks say, from the people who walk before them: no ceremony, ever better.

`PeopleCalibration.update` takes one sensor's bodies after the other. It knows nothing of how people are tracked; who
is the same person in two sensors may be handed in, and is found from the calibration itself where it is not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import FloorFromFeet, floor_of_pose, mean_floor
from mocapella.calibration.moved_sensor import disagrees_for, moved_sensors
from mocapella.calibration.pair_calibration import PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import BodyTrack
from mocapella.calibration.quality import figures, pair_quality
from mocapella.calibration.rig import VERSION, Rig, RigSensor, restored_pair, rig_pair
from mocapella.calibration.sensor_graph import PlacedSensor, SensorPair, place_sensors
from mocapella.calibration.time_offset import TimeOffset
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import adjoint
from mocapella.model.bodies import Bodies, BodyKey
from mocapella.model.session import SensorPose
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class PeopleSettings:
    """What concerns all sensors.

    Attributes:
        pair: of each pair of sensors.
        match_within_m: bodies of two sensors whose centres are nearer are one person, where nobody else says who is
            who [m].
        moved_after_s: a sensor that nobody agrees with for so long was moved [s].
        frozen_after_s: a sensor whose bodies do not move by a bit for so long is not believed [s].
        gone_after_s: a body that a sensor has not seen for so long is forgotten [s].
        clock_jump_s: a sensor whose frames come later than others' with times so much older has another clock [s].
        refresh_s: the places of all sensors are worked out anew so often [s].
        partners: with more than so many others, each sensor is refined against so many of those it is tied to best.
    """

    pair: PairSettings = field(default_factory=PairSettings)
    match_within_m: float = 0.5
    moved_after_s: float = 2.0
    frozen_after_s: float = 0.5
    gone_after_s: float = 1.0
    clock_jump_s: float = 2.0
    refresh_s: float = 0.2
    partners: int = 4

    def __post_init__(self) -> None:
        for name in (
            "match_within_m", "moved_after_s", "frozen_after_s", "gone_after_s", "clock_jump_s", "refresh_s",
        ):  # fmt: skip
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "greater than 0")
        check(self.partners >= 1, "partners", self.partners, "1 or more")


class CalibratedSensor(msgspec.Struct, frozen=True, eq=False):
    """What is known of a sensor.

    Attributes:
        sensor: its name.
        T_world_sensor: (4, 4); of sensors with the same ``root`` the worlds are one.
        covariance: (6, 6) of a small motion in the world (translation [m], rotation [rad]): exp(d) T_world_sensor.
        root: the sensor in whose frame it is told; itself where nothing ties it to another.
        clock: what its times are ahead of the root's; None or not known: take 0.
        trusted: whether its place is sure enough to fuse what it sees with what others see.
        quality: ``12 mm, 0.4°``; empty where there is nothing to measure.
        condition: what is wrong or missing, and what to do; empty where nothing is.
    """

    sensor: str
    T_world_sensor: Float64
    covariance: Float64
    root: str
    clock: TimeOffset | None
    trusted: bool
    quality: str
    condition: str


class PeopleState(msgspec.Struct, frozen=True, eq=False):
    """What is known after a frame.

    Attributes:
        sensors: by name, in the order of the names.
        qualities: of every pair of sensors that has seen somebody together, in words.
        floor_known: whether the world's y = 0 is the floor; else the world is the root's camera space.
        calibrations: how many pairs of sensors were calibrated so far.
        moved: how often a sensor was found to have been moved.
    """

    sensors: Mapping[str, CalibratedSensor]
    qualities: tuple[str, ...]
    floor_known: bool
    calibrations: int
    moved: int

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every sensor's condition that is not empty, with its name."""
        return tuple(f"{name}: {sensor.condition}" for name, sensor in self.sensors.items() if sensor.condition)


@dataclass
class PairOfSensors:
    """Two sensors: the estimate that is believed, or the hypotheses that are tried.

    Attributes:
        calibration: believed; None before there is one.
        cold: what else it could be; without hypotheses while nothing speaks against what is believed.
        matched: tracking ids in a and b of bodies that are one person.
        agreed_at: when somebody was last where both say [s].
        seen_since: since when both see somebody without a break [s].
        estimate: of the last refresh.
    """

    calibration: PairCalibration | None
    cold: ColdStart
    matched: tuple[tuple[int, int], ...] = ()
    agreed_at: float = -np.inf
    seen_since: float = np.inf
    estimate: PairEstimate | None = None


class PeopleCalibration:
    """All sensors. Which there are is learnt from who speaks; no sensor is announced."""

    def __init__(self, settings: PeopleSettings | None = None, *, rig: Rig | None = None) -> None:
        self.settings = settings or PeopleSettings()
        self.rig = rig
        self.reset()

    def reset(self) -> None:
        """Forget everything but the rig that it was made with."""
        self._zero_ns: int | None = None
        self._tracks: dict[str, dict[int, BodyTrack]] = {}
        self._newest: dict[str, float] = {}
        self._floors: dict[str, FloorFromFeet] = {}
        self._poses: dict[str, SensorPose] = {}
        self._mirror = np.zeros(0, dtype=np.int64)
        self._pairs: dict[tuple[str, str], PairOfSensors] = {}
        self._active: frozenset[tuple[str, str]] | None = None
        self._moved: dict[str, float] = {}
        self._jumped: dict[str, float] = {}
        self._behind: dict[str, float] = {}
        self._refreshed = -np.inf
        self._now = -np.inf
        self._completed = 0
        self._moves = 0
        self.state = PeopleState({}, (), False, 0, 0)

    def update(
        self,
        bodies: Bodies,
        at_ns: int,
        people: Mapping[BodyKey, int] | None = None,
        pose: SensorPose | None = None,
    ) -> PeopleState:
        """Take one sensor's newest bodies in.

        Args:
            bodies: that it tracks.
            at_ns: when it captured them, on the common clock.
            people: who is who, as far as it is known: bodies with one number are one person. None = find it out.
            pose: the sensor's tilt and height where they are given; a height of 0 is none.

        Returns:
            What is known now; also at `state`.
        """
        sensor, now = bodies.sensor, self._seconds(at_ns)
        known = sensor in self._tracks
        if not known:
            self._join(sensor)
        elif now < self._newest[sensor] - 0.5:
            self._tracks[sensor].clear()
            self._jumped[sensor] = now
        if len(bodies.topology) != len(self._mirror):
            self._mirror = np.array(bodies.topology.mirror, dtype=np.int64)
        if pose is not None and pose.height > 0:
            self._poses[sensor] = pose
        self._newest[sensor], self._now = now, now
        # What comes last is newest, a few tenths of a second aside: a sensor that comes later with older times is behind.
        self._behind[sensor] = max(self._newest.values()) - now
        self._see(bodies, now)
        self._floors[sensor].update(bodies, now)
        for key in self._pairs_of(sensor):
            self._update_pair(key, people, now)
        if now >= self._refreshed + self.settings.refresh_s or now < self._refreshed or not known or self._first_view():
            self._refresh(now, people)
        return self.state

    def rig_now(self) -> Rig:
        """What is believed now, to be saved."""
        sensors = {
            name: RigSensor(
                sensor.T_world_sensor.tolist(),
                1e3 * float(np.sqrt(np.trace(sensor.covariance[:3, :3]))),
                float(np.degrees(np.sqrt(np.trace(sensor.covariance[3:, 3:])))),
            )
            for name, sensor in self.state.sensors.items()
        }
        pairs = [
            rig_pair(a, b, pair_quality(a, b, pair.estimate or pair.calibration.estimate()), pair.calibration)
            for (a, b), pair in sorted(self._pairs.items())
            if pair.calibration is not None
        ]
        return Rig(VERSION, sensors, pairs)

    def _seconds(self, at_ns: int) -> float:
        if self._zero_ns is None:
            self._zero_ns = at_ns
        return (at_ns - self._zero_ns) / NS_PER_S

    def _join(self, sensor: str) -> None:
        kept = {(pair.a, pair.b): pair for pair in self.rig.pairs} if self.rig else {}
        for other in self._tracks:
            key = (min(sensor, other), max(sensor, other))
            calibration = restored_pair(kept[key], self.settings.pair) if key in kept else None
            self._pairs[key] = PairOfSensors(calibration, ColdStart(self.settings.pair))
        self._tracks[sensor] = {}
        self._floors[sensor] = FloorFromFeet()
        self._newest[sensor] = -np.inf
        self._active = None

    def _see(self, bodies: Bodies, now: float) -> None:
        tracks = self._tracks[bodies.sensor]
        for body, positions, states in zip(bodies.ids, bodies.positions, bodies.states, strict=True):
            if body not in tracks or tracks[body].points.shape[1] != len(states):
                tracks[body] = BodyTrack.empty(len(states))
            tracks[body].add(now, positions, states, self.settings.pair.inferred_weight)
        gone = [body for body, track in tracks.items() if track.newest < now - self.settings.gone_after_s]
        for body in gone:
            del tracks[body]

    def _frozen(self, sensor: str) -> bool:
        tracks = self._tracks[sensor].values()
        limit = self._newest[sensor] - self.settings.frozen_after_s
        return bool(tracks) and all(bool(track.frozen_since[0] <= limit) for track in tracks)

    def _pairs_of(self, sensor: str) -> Iterable[tuple[str, str]]:
        keys = self._pairs if self._active is None else self._active
        return sorted(key for key in keys if sensor in key)

    def _update_pair(self, key: tuple[str, str], people: Mapping[BodyKey, int] | None, now: float) -> None:
        pair = self._pairs[key]
        a, b = (self._tracks[sensor] for sensor in key)
        if not a or not b or self._frozen(key[0]) or self._frozen(key[1]):
            pair.seen_since = np.inf
            return
        pair.seen_since = min(pair.seen_since, now)
        if pair.calibration is None or (self._doubtful(pair, now) and not self._agree_elsewhere(key, now)):
            pair.cold.update(a, b, self._mirror)
        elif pair.cold.hypotheses:
            pair.cold.hypotheses.clear()
        if pair.calibration is not None:
            if people is not None:
                pair.matched = same_people(key, a, b, people)
            for who in dict.fromkeys((*pair.matched, *pair.calibration.bodies)):
                if who[0] in a and who[1] in b:
                    pair.calibration.update(who, a[who[0]], b[who[1]], self._mirror)

    def _doubtful(self, pair: PairOfSensors, now: float) -> bool:
        """Both see somebody, and for long nobody has been where both say."""
        return now - max(pair.agreed_at, pair.seen_since) > self.settings.moved_after_s

    def _agree_elsewhere(self, key: tuple[str, str], now: float) -> bool:
        """Each of the two agrees with a third: then these two just see different people."""
        agreeing = self._agreeing(now)
        return all(any(sensor in other and other != key for other in agreeing) for sensor in key)

    def _first_view(self) -> bool:
        """A pair has its first estimate, which the state does not say yet."""
        return any(
            pair.estimate is None and any(known.moments[0] > 0 for known in pair.cold.hypotheses.values())
            for pair in self._pairs.values()
        )

    def _refresh(self, now: float, people: Mapping[BodyKey, int] | None) -> None:
        self._refreshed = now
        for key, pair in self._pairs.items():
            best = pair.cold.best() if pair.cold.hypotheses else None
            if best is not None and best[1].trusted:
                self._believe(key, pair, best[0], now)
            if pair.calibration is None:
                pair.estimate = best[1] if best else None
                continue
            pair.estimate = pair.calibration.estimate()
            pair.calibration.trust(pair.estimate)
            a, b = (self._tracks[sensor] for sensor in key)
            pair.calibration.forget_bodies(lambda who, a=a, b=b: who[0] in a and who[1] in b)
            bodies = pair.calibration.bodies.values()
            fresh = [body for body in bodies if now - body[at.STEP_AT] < self.settings.gone_after_s]
            if any(np.isnan(body[at.DISAGREES_SINCE]) for body in fresh):
                pair.agreed_at = now
            if people is None:
                pair.matched = nearest_bodies(pair.calibration.T_a_b, a, b, self.settings.match_within_m)
        self._find_moved(now)
        self._place()

    def _believe(self, key: tuple[str, str], pair: PairOfSensors, found: PairCalibration, now: float) -> None:
        """A hypothesis has won; where another estimate was believed, a sensor was moved."""
        if pair.calibration is not None:
            self._note_moved(moved_sensors([key], self._agreeing(now), sorted(self._tracks)), now)
        pair.calibration, pair.cold = found, ColdStart(self.settings.pair)
        pair.agreed_at = now
        self._completed += 1

    def _agreeing(self, now: float) -> list[tuple[str, str]]:
        return [key for key, pair in self._pairs.items() if now - pair.agreed_at < self.settings.moved_after_s]

    def _find_moved(self, now: float) -> None:
        disagreeing = [
            key
            for key, pair in self._pairs.items()
            if pair.calibration is not None
            and pair.estimate is not None
            and pair.estimate.trusted
            and disagrees_for(pair.calibration, now) > self.settings.moved_after_s
        ]
        if not disagreeing:
            return
        moved = moved_sensors(disagreeing, self._agreeing(now), sorted(self._tracks))
        self._note_moved(moved, now)
        for key, pair in self._pairs.items():
            if set(key) & set(moved):
                pair.calibration, pair.cold, pair.matched = None, ColdStart(self.settings.pair), ()
                pair.estimate = None
        self._active = None

    def _note_moved(self, moved: Iterable[str], now: float) -> None:
        for sensor in moved:
            self._moved[sensor] = now
            self._floors[sensor] = FloorFromFeet()
            self._poses.pop(sensor, None)
            self._moves += 1

    def _place(self) -> None:
        names = sorted(self._tracks)
        edges = [
            SensorPair(*key, pair.estimate.T_a_b, pair.estimate.covariance, pair.estimate.offset, pair.estimate.trusted)
            for key, pair in self._pairs.items()
            if pair.estimate is not None and np.isfinite(pair.estimate.T_a_b).all()
        ]
        placed = place_sensors(names, edges)
        for sensor in [s for s in self._moved if self._tied_again(s)]:
            del self._moved[sensor]
        worlds = {root: self._world(root, placed) for root in {place.root for place in placed.values()}}
        self._active = self._partners(placed, edges)
        self.state = PeopleState(
            sensors={name: self._sensor(name, placed[name], worlds[placed[name].root][0], placed) for name in names},
            qualities=tuple(
                pair_quality(*key, pair.estimate)
                for key, pair in sorted(self._pairs.items())
                if pair.estimate is not None
            ),
            floor_known=bool(worlds) and all(known for _, known in worlds.values()),
            calibrations=self._completed,
            moved=self._moves,
        )

    def _tied_again(self, sensor: str) -> bool:
        return any(
            pair.estimate is not None and pair.estimate.trusted and pair.calibration is not None
            for key, pair in self._pairs.items()
            if sensor in key
        )

    def _world(self, root: str, placed: Mapping[str, PlacedSensor]) -> tuple[Float64, bool]:
        """``T_world_root``, and whether its floor is known. A given pose is believed rather than feet."""
        members = {name: place for name, place in placed.items() if place.root == root and place.trusted}
        given = [
            (place.T_root_sensor, floor_of_pose(self._poses[name].tilt, self._poses[name].height))
            for name, place in members.items()
            if name in self._poses
        ]
        found = ((place.T_root_sensor, self._floors[name].known) for name, place in members.items())
        floors = given or [(T, floor) for T, floor in found if floor is not None]
        return (mean_floor(floors).T_level_sensor, True) if floors else (np.eye(4), False)

    def _sensor(
        self, name: str, place: PlacedSensor, T_world_root: Float64, placed: Mapping[str, PlacedSensor]
    ) -> CalibratedSensor:
        to_world = adjoint(T_world_root)
        T = T_world_root @ place.T_root_sensor
        covariance = to_world @ place.covariance @ to_world.T
        alone = place.root == name
        condition = self._condition(name, place, placed)
        return CalibratedSensor(
            sensor=name,
            T_world_sensor=T,
            covariance=covariance,
            root=place.root,
            clock=place.offset,
            trusted=place.trusted and name not in self._moved and not self._frozen(name),
            quality="" if alone else _quality(T, covariance),
            condition=condition,
        )

    def _condition(self, name: str, place: PlacedSensor, placed: Mapping[str, PlacedSensor]) -> str:
        if condition := self._stream_condition(name):
            return condition
        pairs = {key: pair for key, pair in self._pairs.items() if name in key}
        tied = place.trusted and any(
            other.root == place.root and other.trusted for key, other in placed.items() if key != name
        )
        if not pairs or tied:
            return self._doubts(name, pairs)
        seen = [(key, pair.estimate) for key, pair in pairs.items() if pair.estimate is not None]
        if not seen:
            return "no other sensor sees the people that it sees: walk where two sensors see you"
        key, estimate = min(seen, key=lambda item: item[1].position_sd)
        return f"with {key[0] if key[1] == name else key[1]}: {estimate.problem}" if estimate.problem else ""

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

    def _doubts(self, name: str, pairs: Mapping[tuple[str, str], PairOfSensors]) -> str:
        for key, pair in pairs.items():
            other = key[0] if key[1] == name else key[1]
            if pair.estimate is not None and pair.estimate.trusted and _in_one_place(pair.estimate.T_a_b):
                return f"it stands where {other} stands, and sees no more"
            doubtful = pair.calibration is not None and self._doubtful(pair, self._now)
            if doubtful and not self._agree_elsewhere(key, self._now):
                return f"it does not see people where {other} sees them: walk a few steps where both see you"
        return ""

    def _partners(
        self, placed: Mapping[str, PlacedSensor], edges: Iterable[SensorPair]
    ) -> frozenset[tuple[str, str]] | None:
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


def same_people(
    key: tuple[str, str], a: Iterable[int], b: Iterable[int], people: Mapping[BodyKey, int]
) -> tuple[tuple[int, int], ...]:
    """Tracking ids in two sensors of bodies that have one number."""
    of_b = {people[key[1], body]: body for body in b if (key[1], body) in people}
    numbers = ((body, people.get((key[0], body))) for body in a)
    return tuple((body, of_b[number]) for body, number in numbers if number is not None and number in of_b)


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


def _quality(T_world_sensor: Float64, covariance: Float64) -> str:
    """Of the sensor's own place: its standard deviation [mm] and its angle's."""
    own = adjoint(T_world_sensor)
    at_sensor = np.linalg.solve(own, np.linalg.solve(own, covariance).T)
    return figures(float(np.sqrt(np.trace(at_sensor[:3, :3]))), float(np.sqrt(np.trace(at_sensor[3:, 3:]))))


def _in_one_place(T_a_b: Float64) -> bool:
    turn = float(np.arccos(np.clip((np.trace(T_a_b[:3, :3]) - 1) / 2, -1, 1)))
    return bool(np.linalg.norm(T_a_b[:3, 3]) < ONE_PLACE_M and turn < ONE_PLACE_TURN)


SAID_FOR_S: Final = 5.0
"""A clock that jumped is told of for so long [s]."""
ONE_PLACE_M: Final = 0.1
"""Two sensors that are nearer stand in one place [m] …"""
ONE_PLACE_TURN: Final = np.radians(5.0)
"""… if they also look the same way [rad]."""
