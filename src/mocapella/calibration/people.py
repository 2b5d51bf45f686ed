"""Calibrate body sensors continuously from the people they see: poses and clock offsets, without a procedure.

`PeopleCalibration.update` takes one sensor's bodies at a time. It does not depend on how people are tracked: which
bodies are one person may be given, and is otherwise derived from the calibration itself.

The cost of a frame does not grow with time. A frame is added to its sensor's tracks; each calibrated pair of sensors is
refined with one person, in turn; one uncalibrated pair is tried; and a few times a second a *refresh* recomputes all
poses. With many sensors, a refresh takes longer than a frame may. So it is a list of steps with a known amount of work,
and each frame does no more than `WORK_A_FRAME`: frames alone decide, no clock, so that a replay does the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import Floor, FloorFromFeet, floor_of_pose, mean_floor
from mocapella.calibration.pair_calibration import PairCalibration
from mocapella.calibration.pair_memory import SensorTracks, legs_of, turned_joints
from mocapella.calibration.pairs_from_people import Identities, PairsFromPeople
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.quality import figures, pair_quality
from mocapella.calibration.sensor_conditions import StreamFaults, contradicts, pose_condition
from mocapella.calibration.sensor_graph import (
    Component,
    PlacedSensor,
    SensorPair,
    by_certainty,
    components_of,
    placed_by,
)
from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, layout_pair, restored_pair
from mocapella.calibration.sensor_pair import (
    BY_LAYOUT,
    GIVEN_SD,
    GIVEN_SD_M,
    Pair,
    PairOfSensors,
    best_pairs,
    covariance_of,
    used_pairs,
)
from mocapella.calibration.stated_pose import head_up_s, is_upside_down, oriented, refuted
from mocapella.calibration.time_offset import TimeOffset
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import inverse, rigid, rotation_about_z
from mocapella.geometry.twists import adjoint
from mocapella.model.bodies import Bodies
from mocapella.model.memory import set_memory
from mocapella.model.session import SensorPose

Float64 = NDArray[np.float64]

Step = tuple[str, tuple[Pair, ...]]
"""Name of a step of a refresh, and the pairs that it treats; none for all."""

MOST_JUDGED: Final = 16
"""Most pairs whose hypotheses are compared at one refresh, in turn."""
WORK_A_FRAME: Final = 48
"""Work of a refresh that one frame does: all of it for two sensors. A step with more has a frame of its own."""
WORK_PER_PAIR: Final = {"hypotheses": 12, "forgotten": 12, "calibrations": 3}
"""Work of a step for each of its pairs of sensors; 1 for other steps."""
JUMPED_BACK_S: Final = 0.5
"""Decrease of a sensor's times above which its clock was set back [s]."""
_LEVEL: Final = SensorPose()
"""Pose of a sensor without a stated one, to decide whether people are upright or upside down."""
_HALVES: Final = np.repeat(np.eye(2), 3, axis=0)
"""Sums the three translation and the three rotation components of a 6-vector."""
_RECORDED: Final = {"layout": "rig"}
"""Names of attributes in a take, where they differ."""


class PeopleCalibration(PairsFromPeople):
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
        self.reset_pairs()
        self._zero_ns: int | None = None
        self._judged = 0
        self._steps: list[Step] = []
        self._graph: list[Component] = []
        self._edges: list[SensorPair] = []
        self._conditions: dict[str, str] = {}
        self._worlds: dict[str, tuple[Float64, bool]] = {}
        self._placed: dict[str, PlacedSensor] = {}
        self._jumped: dict[str, float] = {}
        self._behind: dict[str, float] = {}
        self._refreshed = -np.inf
        self._now = -np.inf
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
            pose: tilt and height of the sensor; None, or a height of 0, if not given.
        """
        sensor, now = bodies.sensor, self._seconds(at_ns)
        joins = sensor not in self._tracks
        if joins:
            self._join(sensor, len(bodies.topology))
            self._mirror = np.array(bodies.topology.mirror, dtype=np.int64)
            self._turned, self._legs = turned_joints(bodies.topology), legs_of(bodies.topology)
        elif now < self._newest[sensor] - JUMPED_BACK_S:
            self._tracks[sensor].clear()
            self._jumped[sensor] = now
        if pose is not None and pose.height > 0 and sensor not in self._moved:
            self._poses[sensor] = pose
        self._orient(bodies, self._poses.get(sensor, _LEVEL), now - self._newest[sensor])
        self._newest[sensor], self._now = now, now
        # Frames arrive within a few tenths of a second: a sensor whose times are older has a clock that is behind.
        self._behind[sensor] = max(self._newest.values()) - now
        weight = self.settings.pair.inferred_weight
        self._tracks[sensor].add(now, bodies.ids, bodies.positions, bodies.states, weight, legs=self._legs)
        self._floors[sensor].update(bodies, now)
        for key in self._refined[sensor]:
            if not 0 < self._pairs[key].due - now <= self.settings.pair.every_s:
                self._refine(key, people, now)
        if self._tried[sensor]:
            self._try(self._tried[sensor])
        work = WORK_A_FRAME
        if joins or not (self._steps or 0 <= now - self._refreshed < self._refresh_s):
            self._begin_refresh(now)
            work -= len(self._pairs)
        self._advance(now, people, work)
        if joins and sensor not in self.state.sensors:
            self._show_alone(sensor)
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
        """Restore the state that `memory` returned, without a copy.

        Raises:
            ValueError: its settings, or a part of it that can be reset, are of another class, or a name is a method's.
        """
        names = {recorded: name for name, recorded in _RECORDED.items()}
        self._steps, self._graph, self._edges = [], [], []  # older takes have none
        set_memory(self, {names.get(name, name): value for name, value in memory.items()})

    def _orient(self, bodies: Bodies, pose: SensorPose, dt: float) -> None:
        """Update whether a sensor's people show that it is upside down."""
        before_s = self._head_up_s.get(bodies.sensor, 0.0)
        after_s = self._head_up_s[bodies.sensor] = head_up_s(before_s, bodies, pose, dt)
        if is_upside_down(before_s) is not is_upside_down(after_s):
            self._refresh_s = 0.0  # people are about to be shown

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
        new = {
            (min(sensor, other), max(sensor, other)): PairOfSensors(None, ColdStart(settings)) for other in self._tracks
        }
        known = [key for key in new if key not in kept and places.keys() >= set(key)]
        T_a_b = [inverse(places[a]) @ places[b] for a, b in known]
        begun = PairCalibration.each_begun_from(np.array(T_a_b).reshape(-1, 4, 4), settings)
        for key, calibration in [
            *((key, restored_pair(kept[key], settings)) for key in new if key in kept),
            *zip(known, begun, strict=True),
        ]:
            new[key].calibration, new[key].told, new[key].trying = calibration, BY_LAYOUT, False
        self._pairs |= new
        self._tracks[sensor] = SensorTracks.empty(joints)
        self._floors[sensor] = FloorFromFeet()
        self._newest[sensor] = -np.inf
        self._choose_pairs(None)

    def _begin_refresh(self, now: float) -> None:
        """Plan the steps of a refresh; an unfinished one is dropped."""
        paused = now - self._refreshed > self.settings.gone_after_s
        self._refreshed, self._refresh_s = now, self.settings.refresh_s
        for sensor, tracks in self._tracks.items():
            silent = now - self._newest[sensor] > self.settings.gone_after_s
            tracks.forget_before(np.inf if silent else self._newest[sensor] - self.settings.gone_after_s)
        seeing = {sensor for sensor, tracks in self._tracks.items() if tracks.bodies and not self._frozen(sensor)}
        for key, pair in self._pairs.items():
            since = now if paused else min(pair.seen_since, now)
            pair.seen_since = since if seeing.issuperset(key) else np.inf
        tried = [key for key, pair in self._pairs.items() if pair.cold.hypotheses]
        self._judged += MOST_JUDGED
        first = self._judged % len(tried) if len(tried) > MOST_JUDGED else 0
        tried = (tried[first:] + tried[:first])[:MOST_JUDGED]
        known = {key for key, pair in self._pairs.items() if pair.calibration is not None}.union(tried)
        last = ("moved", "doubts", "edges", "graph", "poses", "choice", "conditions", "worlds", "results")
        self._steps = [
            *_parts("hypotheses", tried),
            *_parts("calibrations", sorted(known)),
            *((name, ()) for name in last),
        ]

    def _advance(self, now: float, people: Identities | None, left: int) -> None:
        """Take the next steps of a refresh with no more work than is left of `WORK_A_FRAME`, or one step alone."""
        while self._steps:
            name, keys = self._steps[0]
            work = WORK_PER_PAIR.get(name, 1) * (len(keys) or len(self._pairs))
            if work > left < WORK_A_FRAME:
                return
            left -= work
            self._steps = self._steps[1:]
            self._take(name, keys, now, people)

    def _take(self, name: str, keys: tuple[Pair, ...], now: float, people: Identities | None) -> None:
        """Take one step of a refresh; they are in the order of a refresh."""
        steps: dict[str, Callable[[], None]] = {
            "hypotheses": lambda: self._judge_hypotheses(keys, now),
            "calibrations": lambda: self._judge_calibrations(keys, now, people),
            "moved": lambda: self._find_moved(now),
            "doubts": lambda: self._find_doubts(now),
            "edges": self._find_edges,
            "graph": self._draw_graph,
            "poses": self._refine_poses,
            "choice": self._choose,
            "forgotten": lambda: self._forget_hypotheses(keys),
            "conditions": self._find_conditions,
            "worlds": self._find_worlds,
            "results": self._show,
        }
        steps[name]()

    def _find_edges(self) -> None:
        """Collect the pairs' relative poses, the most certain first."""
        used = used_pairs(self._pairs)
        self._edges = by_certainty(
            [
                SensorPair(key[0], key[1], pair.estimate.T_a_b, covariance_of(pair), pair.estimate.offset, key in used)
                for key, pair in self._pairs.items()
                if pair.estimate is not None and pair.told != "others" and math.isfinite(pair.estimate.T_a_b[0, 3])
            ]
        )

    def _draw_graph(self) -> None:
        self._graph = components_of(self._in_order(self._tracks), self._edges, self._placed)

    def _in_order(self, sensors: Iterable[str]) -> list[str]:
        """Return the names in an order that does not depend on arrivals: as in the layout, then by name.

        The first of a component is its root. So the sensor that a layout begins with stays where the layout has it.
        """
        rank = {name: i for i, name in enumerate(self.layout.sensors)} if self.layout else {}
        return sorted(sensors, key=lambda name: (rank.get(name, len(rank)), name))

    def _refine_poses(self) -> None:
        """Take one step of the refinement of one component; the next one is a step of its own."""
        for component in self._graph:
            if component.steps_left:
                component.refine()
                break
        if any(component.steps_left for component in self._graph):
            self._steps = [("poses", ()), *self._steps]

    def _choose(self) -> None:
        """Accept the poses, and choose the pairs that frames update from now on."""
        placed = self._placed = placed_by(self._graph, self._in_order(self._tracks))
        self._graph = []
        for sensor in [s for s in self._moved if any(s in key and pair.trusted for key, pair in self._pairs.items())]:
            del self._moved[sensor]
        self._begin_from_others(placed)
        trusted = [(edge.a, edge.b) for edge in self._edges if edge.trusted]
        self._choose_pairs(best_pairs(placed, trusted, self.settings.partners))
        self._edges = []
        tried = {key for keys in self._tried.values() for key in keys}
        stale = [key for key, pair in self._pairs.items() if key not in tried and pair.cold.hypotheses]
        self._steps = [*_parts("forgotten", stale), *self._steps]

    def _forget_hypotheses(self, keys: Sequence[Pair]) -> None:
        for key in keys:
            if key not in self._tried[key[0]]:
                self._pairs[key].cold.clear()

    def _show(self) -> None:
        worlds = self._worlds
        self.state = PeopleState(
            sensors=self._sensors(self._placed, {root: T for root, (T, _) in worlds.items()}, self._conditions),
            qualities=tuple(pair.quality for _, pair in sorted(self._pairs.items(), key=itemgetter(0)) if pair.quality),
            floor_known=bool(worlds) and all(known for _, known in worlds.values()),
            calibrations=self._completed,
            moved=self._moves,
        )

    def _show_alone(self, sensor: str) -> None:
        """Add a sensor that has just joined to the results; it is untied before the refresh ends."""
        placed = {sensor: PlacedSensor(np.eye(4), np.zeros((6, 6)), TimeOffset(0.0, 0.0, True), sensor, True)}
        T, _ = self._world(sensor, placed)
        sensors = {**self.state.sensors, **self._sensors(placed, {sensor: T}, self._conditions_of(placed))}
        self.state = msgspec.structs.replace(
            self.state, sensors={name: sensors[name] for name in self._in_order(sensors)}
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

    def _find_conditions(self) -> None:
        self._conditions = self._conditions_of(self._placed)

    def _find_worlds(self) -> None:
        roots = dict.fromkeys(place.root for place in self._placed.values())
        self._worlds = {root: self._world(root, self._placed) for root in roots}

    def _world(self, root: str, placed: Mapping[str, PlacedSensor]) -> tuple[Float64, bool]:
        """Return ``T_world_root``, and whether its floor is known; a given pose takes precedence over feet."""
        members = {name: place for name, place in placed.items() if place.root == root and place.trusted}
        stated = {name: self._stated_floor(name) for name in members}
        given = [(members[name].T_root_sensor, floor) for name, floor in stated.items() if floor is not None]
        found = {name: self._floors[name].known or self._layout_floor(name) for name in members}
        floors = given or [(members[name].T_root_sensor, floor) for name, floor in found.items() if floor is not None]
        if floors:
            return mean_floor(floors).T_level_sensor, True
        return rigid(rotation_about_z(np.pi if self._is_upside_down(root) else 0.0), np.zeros(3)), False

    def _is_upside_down(self, sensor: str) -> bool:
        return is_upside_down(self._head_up_s.get(sensor, 0.0))

    def _stated_floor(self, sensor: str) -> Floor | None:
        """Return the floor of a sensor's stated pose; None without one, or if people refute it."""
        if sensor not in self._poses:
            return None
        pose = oriented(self._poses[sensor], upside_down=self._is_upside_down(sensor))
        floor = floor_of_pose(pose.tilt, pose.height)
        return None if refuted(floor, self._floors[sensor].known) else floor

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
        self,
        placed: Mapping[str, PlacedSensor],
        T_world_root: Mapping[str, Float64],
        conditions: Mapping[str, str],
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
                condition=conditions[name],
            )
            for i, (name, place) in enumerate(placed.items())
        }

    def _conditions_of(self, placed: Mapping[str, PlacedSensor]) -> dict[str, str]:
        contradicted = {key: pair for key, pair in self._pairs.items() if contradicts(pair)}
        own: dict[str, dict[Pair, PairOfSensors]] = {name: {} for name in placed}
        for key, pair in self._pairs.items():
            for name in own.keys() & key:
                own[name][key] = pair
        conditions = {}
        for name in placed:
            behind_s = self._behind.get(name, 0.0)
            faults = StreamFaults(
                frozen=self._frozen(name),
                behind_s=behind_s if behind_s > self.settings.clock_jump_s else 0.0,
                jumped_s=self._now - self._jumped.get(name, -np.inf),
                moved=name in self._moved,
                mistilted=name in self._poses and self._stated_floor(name) is None,
            )
            conditions[name] = faults.condition or pose_condition(
                name, own[name], contradicted, placed, seeing=bool(self._tracks[name].bodies)
            )
        return conditions


def _parts(name: str, keys: Sequence[Pair]) -> list[Step]:
    """Return steps of the same name that together treat the pairs, each as many as one frame does."""
    most = WORK_A_FRAME // WORK_PER_PAIR.get(name, 1)
    return [(name, tuple(keys[i : i + most])) for i in range(0, len(keys), most)]
