"""Trajectories: named keypoints of several individuals over time, as arrays, and how scenes are turned into them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.arms import ARM_POINTS, PALM
from mocapella.model.hand import ANGLES, LANDMARKS, PARENTS
from mocapella.model.names import distinct
from mocapella.model.observations import JointState
from mocapella.model.scene import Scene

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Floats = NDArray[np.floating]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
Bones = tuple[tuple[int, int], ...]

HAND_BONES: Final[Bones] = tuple((parent, child) for child, parent in enumerate(PARENTS) if parent >= 0)
ARM_POINT_BONES: Final[Bones] = (*HAND_BONES, (0, PALM), (PALM + 1, 0))
LABELS: Final = ("participant", "placement", "scenario")
"""Names of a run's labels in files."""
ORIGIN: Final = "origin"
"""Name of an object's only keypoint."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Keypoints of several individuals over time, in the world.

    Attributes:
        kind: name of the type of scene part, such as ``people``.
        times_s: (frames,) capture times since ``began_unix_ns``, strictly rising [s].
        runs: (frames,) number of the tracker's run.
        individuals: names, such as ``person_1``.
        keypoints: names of the keypoints.
        positions: (frames, individuals, keypoints, 3), world [m]; NaN where unknown. Of scenes in single
            precision: 4 µm at 100 m, in half the memory.
        states: (frames, individuals, keypoints) `JointState`; not tracked where an individual is absent.
        sd: (frames, individuals, keypoints) float32, standard deviation of a coordinate [m]; NaN where unknown.
        bones: (parent, child) indices of keypoints.
        angle_names: names of joint angles; none for kinds without a body model.
        angles: (frames, individuals, angles) [rad]; NaN where unknown.
        poses: (frames, individuals, 4, 4) pose in the world of an object, a palm or a body's root; NaN where unknown,
            None for kinds without one.
        rate_hz: median frame rate of the fastest sensor; NaN with fewer than two frames [Hz].
        began_unix_ns: wall clock of time 0, since 1970 [ns].
        labels: participant, placement, scenario and the like by name, of each run by its number.
        notes: sentences for the user about what a file of them lacks.
        sensors: (frames,) number of the sensor whose frame each result follows, of equal times one of them; empty if
            unknown.
        cut_off: whether the file has less than its header says.
    """

    kind: str
    times_s: Float64
    runs: Int64
    individuals: tuple[str, ...]
    keypoints: tuple[str, ...]
    positions: Floats
    states: UInt8
    sd: Float32
    bones: Bones = ()
    angle_names: tuple[str, ...] = ()
    angles: Float64 = field(default_factory=lambda: np.empty((0, 0, 0)))
    poses: Float64 | None = None
    rate_hz: float = math.nan
    began_unix_ns: int = 0
    labels: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    sensors: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    cut_off: bool = False

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def present(self) -> NDArray[np.bool_]:
        """(frames, individuals) whether an individual has a known keypoint."""
        return np.any(np.all(np.isfinite(self.positions), axis=3), axis=2)  # type: ignore[no-any-return]

    def of(self, individuals: Sequence[str] | str) -> Self:
        """Return the trajectories of one individual or several, each once, in the given order.

        Raises:
            SettingsError: an individual is unknown; lists the known ones.
        """
        names = dict.fromkeys([individuals] if isinstance(individuals, str) else individuals)
        for name in names:
            if name not in self.individuals:
                raise SettingsError(f"no {name!r} among {self.kind}; known: {one_of(name, self.individuals)}")
        places = [self.individuals.index(name) for name in names]
        return self._take(slice(None), slice(places[0], places[0] + 1) if len(places) == 1 else places)  # not copied

    def at(self, frames: Any) -> Self:
        """Return some frames, by a slice, a boolean mask or indices (frames,); their rate is that of their times."""
        some = self._take(frames, slice(None))
        whole = isinstance(frames, slice) and frames.step in (None, 1)
        return some if whole else replace(some, rate_hz=1.0 / median_step(some.times_s))

    def moved(self, T_to_world: Float64) -> Self:
        """Return the trajectories in another frame of coordinates.

        Args:
            T_to_world: (4, 4) rigid motion from the world to that frame, or (frames, 4, 4), one for each frame; NaN
                makes positions and poses unknown, and their keypoints not tracked.
        """
        T = np.broadcast_to(T_to_world, (len(self), 4, 4))[:, None]
        positions = apply(T, self.positions).astype(self.positions.dtype)
        lost = ~np.all(np.isfinite(positions), axis=3)
        return replace(
            self,
            positions=positions,
            states=np.where(lost, np.uint8(JointState.NOT_TRACKED), self.states),
            sd=np.where(lost, np.float32(np.nan), self.sd),
            poses=None if self.poses is None else T @ self.poses,
        )

    def _take(self, frames: Any, individuals: Any) -> Self:
        chosen = np.asarray(self.individuals, dtype=object)[individuals]
        return replace(
            self,
            times_s=self.times_s[frames],
            runs=self.runs[frames],
            individuals=tuple(map(str, chosen)),
            positions=self.positions[frames][:, individuals],
            states=self.states[frames][:, individuals],
            sd=self.sd[frames][:, individuals],
            angles=self.angles[frames][:, individuals] if self.angle_names else self.angles,
            poses=None if self.poses is None else self.poses[frames][:, individuals],
            sensors=self.sensors[frames] if len(self.sensors) else self.sensors,
        )


@dataclass(frozen=True)
class IndividualRow:
    """One individual in one scene; arrays as in `Trajectories`, without the axes of frames and individuals."""

    name: str
    keypoints: tuple[str, ...]
    bones: Bones
    positions: Float64
    states: UInt8
    sd: Float32 | None = None
    angle_names: tuple[str, ...] = ()
    angles: Float64 | None = None
    pose: Float64 | None = None

    @property
    def layout(self) -> _Layout:
        """Names of the keypoints, bones and angles; the arrays of rows of one layout have equal shapes."""
        return self.keypoints, self.bones, self.angle_names


_Layout = tuple[tuple[str, ...], Bones, tuple[str, ...]]


def _people(scene: Scene) -> Iterator[IndividualRow]:
    joints, bones = scene.topology.joints, scene.topology.bones
    for person in scene.people:
        yield IndividualRow(
            person_name(person.name, person.id), joints, bones, person.positions, person.states, person.sd
        )


def _views(scene: Scene) -> Iterator[IndividualRow]:
    joints, bones = scene.topology.joints, scene.topology.bones
    for person in scene.people:
        for view in person.views:
            if view.sensor == scene.sensor:  # the views of other sensors are of earlier scenes
                yield IndividualRow(
                    f"{person_name(person.name, person.id)}@{view.sensor}", joints, bones, view.positions, view.states
                )


def person_name(name: str, number: int) -> str:
    """Return the name of a person's trajectories: its own, or one of its id ``number``."""
    return name or f"person_{number}"


def _hands(scene: Scene) -> Iterator[IndividualRow]:
    for hand in scene.hands:
        name, pose = f"hand_{hand.id}_{_side(hand.left)}", hand.T_world_palm
        yield IndividualRow(
            name, LANDMARKS, HAND_BONES, hand.landmarks, hand.states, hand.sd, ANGLES, hand.angles, pose
        )


def _arms(scene: Scene) -> Iterator[IndividualRow]:
    for arm in scene.arms:
        name, pose = f"arm_{arm.id}_{_side(arm.left)}", arm.T_world_palm
        yield IndividualRow(name, ARM_POINTS, ARM_POINT_BONES, arm.points, arm.states, arm.sd, ANGLES, arm.angles, pose)


def _side(left: bool) -> str:
    return "left" if left else "right"


def _bodies(scene: Scene) -> Iterator[IndividualRow]:
    for body in scene.bodies:
        yield IndividualRow(
            body.name or f"body_{body.id}", body.landmark_names, (), body.landmarks, body.states, None,
            body.joint_names, body.angles, body.T_world_model,
        )  # fmt: skip


def _objects(scene: Scene) -> Iterator[IndividualRow]:
    for thing in scene.objects:
        pose = thing.T_world_object
        position = np.full((1, 3), np.nan) if pose is None else pose[None, :3, 3]
        yield IndividualRow(thing.name, (ORIGIN,), (), position, np.array([thing.state], np.uint8), pose=pose)


def _points(scene: Scene) -> Iterator[IndividualRow]:
    points = scene.points
    if points is not None:
        known = np.isfinite(points.positions).all(axis=1)
        states = np.where(known, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)
        yield IndividualRow("points", points.names, (), points.positions, states, points.sd)


PARTS: Final[Mapping[str, Callable[[Scene], Iterator[IndividualRow]]]] = {
    "people": _people,
    "hands": _hands,
    "arms": _arms,
    "bodies": _bodies,
    "objects": _objects,
    "points": _points,
}
"""Types of scene parts that become trajectories."""
VIEWS: Final = "views"
"""Kind of the trajectories of each sensor's own skeletons, such as ``person_1@front``."""
_KINDS: Final = {**PARTS, VIEWS: _views}
_WITH_POSES: Final = frozenset({"hands", "arms", "bodies", "objects"})
_NUMBERED: Final = re.compile(r"(person|body)_\d+(@.*)?|(hand|arm)_\d+_(left|right)")
"""Names made of an id, which another tracker gives to other individuals."""


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of one individual with the same keypoints and angles, in several scenes.

    Attributes:
        run: number of the tracker's run.
        name: name of the individual in this run.
        scenes: (rows,) numbers of the scenes, in the order of `TimeAxis.of`.
        layout: names of the keypoints, bones and names of the angles.
        positions, states: (rows, keypoints, 3) and (rows, keypoints), as in `Trajectories`.
        sd, angles, poses: (rows, keypoints), (rows, angles), (rows, 4, 4); None where unknown.
    """

    run: int
    name: str
    scenes: Int64
    layout: _Layout
    positions: Float64
    states: UInt8
    sd: Float32 | None = None
    angles: Float64 | None = None
    poses: Float64 | None = None


def _blocks(rows: Mapping[tuple[int, str, _Layout], Sequence[tuple[int, IndividualRow]]]) -> Iterator[Block]:
    for (run, name, layout), own in rows.items():
        yield Block(
            run,
            name,
            np.array([number for number, _ in own]),
            layout,
            np.stack([row.positions for _, row in own]),
            np.stack([row.states for _, row in own]),
            _stacked([row.sd for _, row in own], len(layout[0])),
            _stacked([row.angles for _, row in own], len(layout[2])),
            _stacked([row.pose for _, row in own], 4, 4),
        )


def _stacked(values: Sequence[Any], *shape: int) -> Any:
    """Stack arrays of a shape, NaN for None; None if all are."""
    if all(one is None for one in values):
        return None
    return np.stack([np.full(shape, np.nan) if one is None else one for one in values])


def trajectories_of(
    scenes: Iterable[tuple[int, int, Scene]],
    kinds: Sequence[str] = tuple(PARTS),
    *,
    sensor: str | None = None,
    trackers: Mapping[int, int] | None = None,
) -> dict[str, Trajectories]:
    """Return the trajectories of a sequence of scenes, by kind; a kind without any part is left out.

    Frames are in the order of their capture times; of several scenes with equal times, the last one counts, and views
    of all. An individual without a name gets one of its id, such as ``person_1``, and in a later run ``run1_person_1``,
    because another tracker gives other ids.

    Args:
        scenes: (run, unix_ns, scene): number of the tracker's run, capture time since 1970 [ns], and the scene.
        kinds: kinds to collect, of `PARTS`, and `VIEWS`.
        sensor: name of the sensor whose camera space the trajectories are in, unknown while its pose is; None for the
            world.
        trackers: as in `TimeAxis`.

    Raises:
        SettingsError: no scene has a pose of the sensor; lists the known sensors.
    """
    collected: dict[str, dict[tuple[int, str, _Layout], list[tuple[int, IndividualRow]]]] = {kind: {} for kind in kinds}
    times: list[tuple[int, int]] = []
    by_sensor: dict[tuple[int, str], list[int]] = {}
    sensor_poses: list[Float64 | None] = []
    for number, (run, unix_ns, scene) in enumerate(scenes):
        times.append((run, unix_ns))
        by_sensor.setdefault((run, scene.sensor), []).append(unix_ns)
        if sensor is not None:
            sensor_poses.append(next((one.T_world_sensor for one in scene.sensors if one.sensor == sensor), None))
        for kind, rows in collected.items():
            own = list(_KINDS[kind](scene))
            for name, row in zip(distinct(row.name for row in own), own, strict=True):
                rows.setdefault((run, name, row.layout), []).append((number, row))
    if not times:
        return {}
    axis = TimeAxis.of(times, by_sensor, trackers)
    made = {kind: assembled(kind, _blocks(rows), axis) for kind, rows in collected.items()}
    found = {kind: some for kind, some in made.items() if some is not None}
    if sensor is None:
        return found
    if all(T is None for T in sensor_poses):
        raise SettingsError(f"no pose of a sensor {sensor!r}; sensors: {one_of(sensor, {s for _, s in by_sensor})}")
    T = np.full((len(axis.times_s), 4, 4), np.nan)
    for frame, T_world_sensor in zip(axis.frame_of.tolist(), sensor_poses, strict=True):
        if T_world_sensor is not None:
            T[frame] = inverse(T_world_sensor)
    return {kind: some.moved(T) for kind, some in found.items()}


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Frames of trajectories.

    Attributes:
        times_s, runs, rate_hz, began_unix_ns, sensors: as in `Trajectories`.
        first_run: number of the first run.
        frame_of: (scenes,) frame of each scene.
        replaced: (scenes,) whether a later scene with an equal time replaces it, but for its own sensor's views.
        trackers: number of the first run of a run's tracker, for runs that are not the first of theirs.
    """

    times_s: Float64
    runs: Int64
    frame_of: Int64
    replaced: NDArray[np.bool_]
    first_run: int
    rate_hz: float
    began_unix_ns: int
    sensors: Int64
    trackers: Mapping[int, int]

    @staticmethod
    def of(
        times: Sequence[tuple[int, int]] | Int64,
        by_sensor: Mapping[tuple[int, Any], Sequence[int] | Int64],
        trackers: Mapping[int, int] | None = None,
    ) -> TimeAxis:
        """Return the frames of scenes, in the order of their times; of equal times, the last scene counts.

        Args:
            times: (scenes, 2) run and unix_ns of each scene; at least one.
            by_sensor: unix_ns of the scenes of each run and sensor, by (run, sensor).
            trackers: see the attribute; None if each run has a tracker of its own.
        """
        runs, at_ns = np.asarray(times, dtype=np.int64).T
        order = np.argsort(at_ns, kind="stable")
        last = np.ones(len(order), dtype=np.bool_)
        last[:-1] = np.diff(at_ns[order]) != 0
        kept = order[last]
        replaced = np.ones(len(times), dtype=np.bool_)
        replaced[kept] = False
        frame_of = np.empty(len(times), dtype=np.int64)
        frame_of[order] = np.cumsum(last) - last
        began = int(at_ns.min())
        numbers = {name: number for number, name in enumerate(dict.fromkeys(name for _, name in by_sensor))}
        sensors = np.empty(len(kept), dtype=np.int64)
        for (_, name), own in by_sensor.items():
            sensors[np.searchsorted(at_ns[kept], own)] = numbers[name]
        rates = [NS_PER_S / median for sensor in by_sensor.values() if (median := median_step(sensor)) > 0]
        return TimeAxis(
            (at_ns[kept] - began) / NS_PER_S, runs[kept], frame_of, replaced, int(runs.min()),
            max(rates, default=math.nan), began, sensors, trackers or {},
        )  # fmt: skip


def median_step(times: Sequence[int] | Int64 | Float64) -> float:
    """Return the median step of times, NaN with fewer than two or without a step above 0."""
    steps = np.diff(np.sort(times))
    return float(np.median(steps)) if len(steps) and np.median(steps) > 0 else math.nan


_DENSE: Final = ("positions", "states", "sd", "angles", "poses")
_AT_FIRST: Final = 8


class _Dense:
    """Arrays of individuals with one layout; an individual's frames are together in memory, as are `Trajectories`'.

    Rows that no block has are not written before `finish`, so that growing takes no memory.
    """

    def __init__(self, frames: int, layout: _Layout, individuals: Sequence[str] = ()) -> None:
        points, angles = len(layout[0]), len(layout[2])
        self.layout = layout
        self.places = {name: i for i, name in enumerate(individuals)}
        self.known = np.zeros((max(_AT_FIRST, len(individuals)), frames), np.bool_)
        shapes = {"positions": (points, 3), "states": (points,), "sd": (points,), "angles": (angles,), "poses": (4, 4)}
        types = {"positions": np.float32, "states": np.uint8, "sd": np.float32}
        self.arrays: dict[str, NDArray[Any]] = {
            name: np.empty((*self.known.shape, *shape), types.get(name, np.float64)) for name, shape in shapes.items()
        }

    def add(self, individual: str, at: Int64, values: Mapping[str, NDArray[Any] | None]) -> None:
        """Write an individual's values in some frames ``at``; None makes them unknown."""
        i = self.places.setdefault(individual, len(self.places))
        if i == len(self.known):
            before, self.known = self.known, np.concatenate([self.known, np.zeros_like(self.known)])
            for name, one in self.arrays.items():
                self.arrays[name] = np.empty((2 * len(one), *one.shape[1:]), one.dtype)
                self.arrays[name][: len(one)][before] = one[before]
        self.known[i, at] = True
        for name, some in values.items():
            self.arrays[name][i, at] = np.nan if some is None else some

    def finish(self) -> None:
        """Make all unknown that no block had."""
        self.known = self.known[: len(self.places)]
        for name, one in self.arrays.items():
            self.arrays[name] = one[: len(self.places)]
            one[: len(self.places)][~self.known] = JointState.NOT_TRACKED if name == "states" else np.nan


def assembled(kind: str, blocks: Iterable[Block], axis: TimeAxis) -> Trajectories | None:
    """Return the trajectories of one kind; keypoints and angles that only some blocks have are unknown elsewhere.

    Args:
        kind: name of the kind.
        blocks: each is needed only until the next one.
        axis: the frames.

    Returns:
        The trajectories; None without a block.
    """
    by_layout: dict[_Layout, _Dense] = {}
    names: dict[tuple[int, str], str] = {}
    for block in blocks:
        tracker = axis.trackers.get(block.run, block.run)
        numbered = tracker > axis.first_run and _NUMBERED.fullmatch(block.name)
        name = names[block.run, block.name] = f"run{tracker}_{block.name}" if numbered else block.name
        if block.layout not in by_layout:
            by_layout[block.layout] = _Dense(len(axis.times_s), block.layout)
        dense = by_layout[block.layout]
        kept: Any = slice(None)
        if kind != VIEWS and axis.replaced[block.scenes].any():
            kept = ~axis.replaced[block.scenes]
        values = {one: getattr(block, one) for one in _DENSE}
        if not block.layout[2]:
            del values["angles"]
        if kind not in _WITH_POSES:
            del values["poses"]
        some = {one: None if array is None else array[kept] for one, array in values.items()}
        dense.add(name, axis.frame_of[block.scenes][kept], some)
    if not names:
        return None
    individuals = tuple(dict.fromkeys(names[key] for key in sorted(names)))
    parts = list(by_layout.values())
    for dense in parts:
        dense.finish()
    whole = parts[0] if len(parts) == 1 and tuple(parts[0].places) == individuals else _merged(parts, individuals)
    keypoints, bones, angle_names = whole.layout
    arrays = {name: np.swapaxes(one, 0, 1) for name, one in whole.arrays.items()}
    return Trajectories(
        kind, axis.times_s, axis.runs, individuals, keypoints, arrays["positions"], arrays["states"], arrays["sd"],
        bones, angle_names, arrays["angles"] if angle_names else np.empty((0, 0, 0)),
        arrays["poses"] if kind in _WITH_POSES else None, axis.rate_hz, axis.began_unix_ns, sensors=axis.sensors,
    )  # fmt: skip


def _merged(parts: Sequence[_Dense], individuals: tuple[str, ...]) -> _Dense:
    """Return the arrays of all layouts together, with individuals in the given order."""
    layouts = [one.layout for one in parts]
    widest, bones, _ = max(layouts, key=lambda layout: len(layout[0]))
    keypoints = tuple(dict.fromkeys([*widest, *(name for own, _, _ in layouts for name in own)]))
    angle_names = tuple(dict.fromkeys(name for _, _, own in layouts for name in own))
    out = _Dense(parts[0].known.shape[1], (keypoints, bones, angle_names), individuals)
    out.finish()
    for one in parts:
        points = [keypoints.index(name) for name in one.layout[0]]
        angles = [angle_names.index(name) for name in one.layout[2]]
        columns = {"positions": points, "states": points, "sd": points, "angles": angles, "poses": list(range(4))}
        for name, i in one.places.items():
            at = np.flatnonzero(one.known[i])
            for array, columns_of in columns.items():
                out.arrays[array][out.places[name]][at[:, None], columns_of] = one.arrays[array][i, at]
    return out
