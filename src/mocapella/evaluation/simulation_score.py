"""Compares a method's scenes with the ground truth of one simulated room.

Skeletons are compared at the frames of the main sensor, in the room's world frame. A method's world frame is aligned by
its estimated pose of the main sensor and the true one. If a method without sensor poses has no view of a person from
the main sensor, another view of the person is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.conventions import NS_PER_S
from mocapella.evaluation.identity import IdentityFrame, hota, identity_switches, idf1, similarity
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.observations import JointState
from mocapella.model.scene import Person, Scene
from mocapella.model.skeleton import SKELETON
from mocapella.model.truth import Truth
from mocapella.sources.simulate import Room, SimulatedFrame

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
Figures = dict[str, float | None]

SHARED_WALKING: Final = 8.0
"""Time of shared walking before the calibration is scored [s]."""
WALKING: Final = 0.3
"""Smallest speed of a walking person [m/s]."""
IN_VIEW_FOR: Final = 0.5
"""Time in view after which a person is expected [s]."""
UNSEEN_FOR: Final = 0.25
"""Time out of view after which a person is no longer expected [s]."""
LOST_AFTER: Final = 1.0
"""Time without a match after which an expected person is lost [s]."""
ALIKE: Final = 0.5
"""Smallest similarity of a match; see `mocapella.evaluation.identity.similarity`."""
FRESH: Final = 0.05
"""Largest delay between a sensor's frame and the fused skeleton compared with it [s]."""
IDENTITY_EVERY: Final = 3
"""Stride of the main sensor's frames for the identity metrics."""


class _SensorNow(msgspec.Struct, frozen=True, eq=False):
    """The errors of a sensor's newest frame.

    Attributes:
        room_ns: the instant.
        people: (bodies,) numbers of the true people.
        errors: (bodies, joints) with the sensor's own labels, in its true pose [m]; NaN where not tracked.
        hidden: (bodies, joints) whether the sensor only inferred the joint.
    """

    room_ns: int
    people: tuple[int, ...]
    errors: Float64
    hidden: Bools


class _Mean:
    """Running mean of errors; its value is None without any."""

    def __init__(self) -> None:
        self.sum, self.count = 0.0, 0

    def add(self, values: Float64) -> None:
        self.sum += float(values.sum())
        self.count += values.size

    @property
    def value(self) -> float | None:
        return self.sum / self.count if self.count else None


class Score:
    """Accumulates a method's errors against ground truth with each frame; `figures` returns the score at the end.

    Args:
        room: the simulated room; its first sensor is the main one.

    Attributes:
        sensors: names of the sensors.
        main: name of the main sensor.
        identity: true and found people, for the identity metrics.
    """

    def __init__(self, room: Room) -> None:
        self.sensors = room.sensor_names
        self.main = self.sensors[0]
        self._T_world_sensor = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
        self._latency_s = {sensor.name: sensor.latency_s for sensor in room.settings.sensors}
        self._mirror = np.array(SKELETON.mirror)
        self._root = SKELETON.parts["root"]
        self._middle = _middle(room)
        self._now: dict[str, _SensorNow] = {}
        # calibration
        self._shared_s = dict.fromkeys(self.sensors, 0.0)
        self._layout: dict[str, tuple[float, float] | None] = dict.fromkeys(self.sensors)
        self._layout_then: dict[str, tuple[float, float] | None] = {}
        self._offsets_s: dict[str, float | None] = dict.fromkeys(self.sensors)
        # people
        self._before: Truth | None = None
        self._since_ns: dict[int, int] = {}
        self._seen_ns: dict[int, int] = {}
        self._unfound_s: dict[int, float] = {}
        self.lost: list[tuple[float, int]] = []
        """(room time [s], person) of each loss."""
        self.identity: list[IdentityFrame] = []
        self._frames = 0
        # joints
        self._errors = {
            name: _Mean()
            for name in ("fused", "fused_labels_aside", "measured", "inferred", "hidden", "hidden_by_sensor")
        }
        self._of_sensor = {name: (_Mean(), _Mean()) for name in self.sensors}
        self._wrong_labels = _Mean()

    def update(self, item: SimulatedFrame, scene: Scene, offsets: Mapping[str, float]) -> None:
        """Add a frame with its ground truth, and the method's scene; call it for every frame, in the order of arrival.

        Args:
            item: the frame and its ground truth.
            scene: the method's scene.
            offsets: estimated time to add to the capture times of a sensor's frames, by sensor, see
                `mocapella.tracker.protocol.SensorViews` [s].
        """
        sensor, truth = item.frame.sensor, item.truth
        self._now[sensor] = _sensor_now(item)
        self._learn_layout(scene, offsets)
        tied = self._tied()
        if sensor in tied or not tied:
            everywhere = set.intersection(*(set(now.people) for now in self._now.values()))
            for person in truth.body_people.tolist():
                if sensor not in tied and (person not in everywhere or len(self._now) < len(self.sensors)):
                    continue
                if truth.room_ns - self._seen_ns.get(person, -(10**18)) > UNSEEN_FOR * NS_PER_S:
                    self._since_ns[person] = truth.room_ns
                self._seen_ns[person] = truth.room_ns
        if sensor == self.main:
            if self._before is not None:
                elapsed_s = (truth.room_ns - self._before.room_ns) / NS_PER_S
                self._count_walking(truth, self._before, elapsed_s)
                self._compare(scene, truth, elapsed_s)
            self._before = truth

    def figures(self) -> Figures:
        """Return all figures of docs/evaluation.md, by name; an unknown figure is None."""
        others = [name for name in self.sensors if name != self.main]
        errors = {name: mean.value for name, mean in self._errors.items()}
        known = {name: sums for name, sums in self._of_sensor.items() if sums[0].count}
        alone = {name: sums[0].sum / sums[0].count for name, sums in known.items()}
        best = min(alone, key=lambda name: alone[name], default=None)
        of_best = None if best is None else 100 * known[best][1].sum / known[best][0].sum
        hidden = self._errors["hidden_by_sensor"]
        return {
            "sensors": float(len(self.sensors)),
            "identity_switches": float(identity_switches(self.identity, ALIKE)),
            "lost_people": float(len(self.lost)),
            "hota": hota(self.identity).hota,
            "idf1": idf1(self.identity, ALIKE),
            **{f"{name}_cm": _times(100, value) for name, value in errors.items()},
            "best_sensor_cm": None if best is None else 100 * alone[best],
            "fused_of_best_sensor_percent": of_best,
            "hidden_of_sensor_percent": 100 * self._errors["hidden"].sum / hidden.sum if hidden.count else None,
            "wrong_left_right_percent": _times(100, self._wrong_labels.value),
            "calibration_mm": _times(1000, _greatest(self._layout_then.get(name) for name in others)[0]),
            "calibration_deg": _greatest(self._layout_then.get(name) for name in others)[1],
            "calibration_end_mm": _times(1000, _greatest(self._layout[name] for name in others)[0]),
            "calibration_end_deg": _greatest(self._layout[name] for name in others)[1],
            "time_offset_ms": _times(1000, self._time_offset_s()),
        }

    def _tied(self) -> set[str]:
        """Return the sensors whose relative poses must be known by now, with the main one; none before the first."""
        tied = {name for name in self._now if self._shared_s[name] >= SHARED_WALKING}
        return tied | {self.main} if tied or len(self.sensors) == 1 else tied

    def _learn_layout(self, scene: Scene, offsets: Mapping[str, float]) -> None:
        places = _places(scene)
        for name in self.sensors:
            self._layout[name] = None
            if name in places and self.main in places:
                found = inverse(places[self.main]) @ places[name]
                self._layout[name] = self._layout_error(found, name)
            self._offsets_s[name] = offsets.get(name)

    def _layout_error(self, T_main_sensor: Float64, sensor: str) -> tuple[float, float]:
        """Return the error of a motion: displacement of the middle of the room [m], and rotation [deg]."""
        T_main_world = inverse(self._T_world_sensor[self.main])
        true = T_main_world @ self._T_world_sensor[sensor]
        middle = apply(inverse(self._T_world_sensor[sensor]), self._middle[None])
        moved = np.linalg.norm(apply(T_main_sensor, middle) - apply(true, middle))
        R = T_main_sensor[:3, :3] @ true[:3, :3].T
        sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
        return float(moved), float(np.degrees(np.arctan2(sine, (np.trace(R) - 1) / 2)))

    def _time_offset_s(self) -> float | None:
        """Return the largest error of a sensor's clock offset from the main one; None if one is not declared."""
        if len(self.sensors) < 2 or None in self._offsets_s.values():
            return None
        # The true offset: at_ns is the capture time plus the latency.
        wrong = {name: (value or 0.0) + self._latency_s[name] for name, value in self._offsets_s.items()}
        return max(abs(value - wrong[self.main]) for value in wrong.values())

    def _count_walking(self, truth: Truth, before: Truth, elapsed_s: float) -> None:
        """Update each sensor's time of shared walking with a sensor that is connected to the main one."""
        moved = np.linalg.norm((truth.positions - before.positions)[:, self._root], axis=-1)
        walking = set(np.flatnonzero(moved > WALKING * elapsed_s).tolist())
        tied = [self.main, *self._tied()]
        for name, now in self._now.items():
            seen_too = {person for other in tied if other != name for person in self._now[other].people}
            if name == self.main or not walking & set(now.people) & seen_too:
                continue
            self._shared_s[name] += elapsed_s
            if self._shared_s[name] >= SHARED_WALKING and name not in self._layout_then:
                self._layout_then[name] = self._layout[name]

    def _compare(self, scene: Scene, truth: Truth, elapsed_s: float) -> None:
        places = _places(scene) if scene.sensors else {}
        T_true = [self._truth_from_method(person, places) for person in scene.people]
        people = [(p, T) for p, T in zip(scene.people, T_true, strict=True) if T is not None]
        found = np.array([apply(T, person.positions) for person, T in people]).reshape(-1, *truth.positions.shape[1:])
        alike = similarity(truth.positions, found)
        wanted = [
            person
            for person, seen_ns in self._seen_ns.items()
            if truth.room_ns - seen_ns <= UNSEEN_FOR * NS_PER_S
            and seen_ns - self._since_ns[person] >= IN_VIEW_FOR * NS_PER_S
        ]
        pairs = _matches(alike)
        matched = {person for person, _ in pairs}
        for person in truth.people.tolist():
            unfound_s = self._unfound_s.get(person, 0.0)
            late = person in wanted and person not in matched
            self._unfound_s[person] = unfound_s + elapsed_s if late else 0.0
            if unfound_s <= LOST_AFTER < self._unfound_s[person]:
                self.lost.append((truth.room_ns / NS_PER_S, person))
        for person, column in pairs:
            self._compare_joints(person, found[column], people[column][0].states, truth)
        if self._frames % IDENTITY_EVERY == 0:
            # Detections of people who are not expected do not count.
            spare = {column for person, column in pairs if person not in wanted}
            columns = [c for c in range(len(people)) if c not in spare]
            ids = tuple(people[c][0].id for c in columns)
            self.identity.append(IdentityFrame(tuple(wanted), ids, alike[np.ix_(wanted, columns)]))
        self._frames += 1

    def _truth_from_method(self, person: Person, places: Mapping[str, Float64]) -> Float64 | None:
        if self.main in places:
            return self._T_world_sensor[self.main] @ inverse(places[self.main])
        views = {view.sensor: view.T_world_sensor for view in person.views}
        name = self.main if self.main in views else next(iter(views), None)
        return None if name is None else self._T_world_sensor[name] @ inverse(views[name])

    def _compare_joints(self, person: int, positions: Float64, states: NDArray[np.uint8], truth: Truth) -> None:
        true, mirror = truth.positions[person], self._mirror
        errors = np.linalg.norm(positions - true, axis=-1)
        seen = np.isfinite(errors)
        self._errors["fused"].add(errors[seen])
        self._errors["measured"].add(errors[seen & (states == JointState.TRACKED)])
        self._errors["inferred"].add(errors[seen & (states == JointState.INFERRED)])
        swapped = np.linalg.norm(positions[mirror] - true, axis=-1)
        sided = seen & np.isfinite(swapped) & (mirror != np.arange(len(mirror)))
        is_wrong = bool(swapped[sided].sum() < errors[sided].sum())
        if sided.any():
            self._wrong_labels.add(np.array([is_wrong], dtype=np.float64))
        self._errors["fused_labels_aside"].add(np.where(sided, swapped, errors)[seen] if is_wrong else errors[seen])
        for name, now in self._now.items():
            if person in now.people and truth.room_ns - now.room_ns <= FRESH * NS_PER_S:
                body = now.people.index(person)
                both = seen & np.isfinite(now.errors[body])
                alone, fused = self._of_sensor[name]
                alone.add(now.errors[body][both])
                fused.add(errors[both])
                hidden = both & now.hidden[body]
                self._errors["hidden"].add(errors[hidden])
                self._errors["hidden_by_sensor"].add(now.errors[body][hidden])


def _sensor_now(item: SimulatedFrame) -> _SensorNow:
    frame, truth = item.frame, item.truth
    seen = apply(truth.T_world_sensor, frame.positions.astype(np.float64))
    errors = np.linalg.norm(seen - truth.positions[truth.body_people], axis=-1)
    return _SensorNow(
        truth.room_ns, tuple(truth.body_people.tolist()), errors, np.asarray(frame.states == JointState.INFERRED)
    )


def _places(scene: Scene) -> dict[str, Float64]:
    """Return a method's sensor poses: as reported, or else from the first person's views."""
    if scene.sensors:
        return {place.sensor: place.T_world_sensor for place in scene.sensors if place.T_world_sensor is not None}
    return {view.sensor: view.T_world_sensor for view in scene.people[0].views} if scene.people else {}


def _matches(alike: Float64) -> list[tuple[int, int]]:
    """Match true and found people of similarity `ALIKE` one to one: as many as possible, then the most similar."""
    good = alike >= ALIKE
    rows, columns = linear_sum_assignment(np.where(good, 10.0 + alike, 0.0), maximize=True)
    return [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if good[r, c]]


def _middle(room: Room) -> Float64:
    """Return the mean position (3,) of the people within reach of the main sensor [m]."""
    settings = room.settings.sensors[0]
    instants = np.linspace(0, room.duration_ns, 50, endpoint=False).astype(np.int64).tolist()
    places = np.concatenate([room.positions_at(t)[:, 0] for t in instants])
    near = np.linalg.norm(places - settings.T_world_sensor[:3, 3], axis=-1) < settings.range_m[1]
    return np.asarray(places[near].mean(axis=0) if near.any() else places.mean(axis=0))


def _greatest(errors: Iterable[tuple[float, float] | None]) -> tuple[float | None, float | None]:
    """Return the largest of each of two errors; None if one is unknown, or there is none."""
    of = list(errors)
    known = [error for error in of if error is not None]
    if not known or len(known) < len(of):
        return None, None
    return max(e[0] for e in known), max(e[1] for e in known)


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
