"""Small methods for the tests of the scoring: one honest, and some that try to flatter themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocapella.evaluation.protocol import JointBias, SensorViews
from mocapella.geometry import rigid
from mocapella.model.bodies import BodyKey, tracked_bodies
from mocapella.model.observations import Arrival
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, TrackerState

TOGETHER_NS = 17_000_000
"""Half a frame: two views that are nearer in time are of one instant."""


def fit(source: Any, target: Any, weights: Any) -> Any:
    """T_target_source, (4, 4), with the least weighted sum of squares over points (n, 3) (Kabsch, 1976)."""
    w = weights / weights.sum()
    mean_s, mean_t = w @ source, w @ target
    U, _, Vt = np.linalg.svd(((target - mean_t) * w[:, None]).T @ (source - mean_s))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return rigid.rigid(R, mean_t - R @ mean_s)


def robust_fit(source: Any, target: Any, rounds: int = 15) -> Any:
    """The same with the least sum of distances: iteratively reweighted."""
    weights = np.ones(len(source))
    for _ in range(rounds):
        T = fit(source, target, weights)
        weights = 1 / np.maximum(np.linalg.norm(rigid.apply(T, source) - target, axis=-1), 0.005)
    return T


class Method:
    """Each sensor's newest bodies; subclasses say what they conclude after a frame."""

    joint_bias: JointBias | None = None

    def __init__(self, sensors: int) -> None:
        self.T: dict[str, Any] = {}
        self.newest: dict[str, Any] = {}
        self.at_ns: dict[str, int] = {}
        self.offsets: dict[str, float] = {}
        self.swapped: frozenset[BodyKey] = frozenset()
        self.step = 0

    def start_from(self, T_world_sensor: Mapping[str, Any]) -> None:
        self.T = dict(T_world_sensor)
        self.reference, *self.others = self.T

    def sensor_views(self) -> SensorViews:
        return SensorViews(self.T, self.offsets, self.swapped)

    def conclude(self, arrival: Arrival) -> None:
        pass

    def update(self, arrival: Arrival) -> Scene:
        frame = arrival.frame
        self.newest[frame.sensor] = tracked_bodies(frame)
        self.at_ns[frame.sensor] = arrival.at_ns
        self.conclude(arrival)
        self.step += 1
        return Scene(
            self.step - 1,
            arrival.at_ns,
            frame.sensor,
            frame.node_id,
            frame.sequence,
            frame.topology,
            TrackerState(Phase.TRACKING),
            {"people": self.people()},
        )

    def people(self) -> tuple[Person, ...]:
        seen: dict[int, list[PotentialSkeleton]] = {}
        for sensor, bodies in sorted(self.newest.items()):
            if sensor in self.T:
                for i, body in enumerate(bodies.ids):
                    moved = rigid.apply(self.T[sensor], bodies.positions[i])
                    view = PotentialSkeleton(sensor, body, 0, 0, 0, self.T[sensor], moved, bodies.states[i])
                    seen.setdefault(body, []).append(view)
        return tuple(
            Person(body, np.mean([v.positions for v in views], axis=0), views[0].states, tuple(views))
            for body, views in sorted(seen.items())
        )

    def common(self) -> tuple[Any, Any]:
        """(points, 3) joints that both sensors see: the second sensor's, and the reference's."""
        if len(self.newest) < 2:
            return np.zeros((0, 3)), np.zeros((0, 3))
        one, other = self.newest[self.reference], self.newest[self.others[0]]
        both = [body for body in one.ids if body in other.ids]
        source, target = (
            bodies.positions[[bodies.ids.index(body) for body in both]].reshape(-1, 3) for bodies in (other, one)
        )
        finite = np.isfinite(source).all(axis=-1) & np.isfinite(target).all(axis=-1)
        return source[finite], target[finite]


class BatchFit(Method):
    """The robust rigid fit on all that was seen so far, made again whenever that has grown by a fifth."""

    def __init__(self, sensors: int) -> None:
        super().__init__(sensors)
        self.seen: list[tuple[Any, Any]] = []
        self.fitted_on = 50

    def start_from(self, T_world_sensor: Mapping[str, Any]) -> None:
        super().start_from(T_world_sensor)
        self.offsets = dict.fromkeys(self.T, 0.0)

    def conclude(self, arrival: Arrival) -> None:
        source, target = self.common()
        if len(source) and np.ptp(list(self.at_ns.values())) < TOGETHER_NS:
            self.seen.append((source, target))
        if len(self.seen) > 1.2 * self.fitted_on:
            self.fitted_on = len(self.seen)
            source, target = (np.concatenate(points)[::7] for points in zip(*self.seen, strict=True))
            self.T[self.others[0]] = self.T[self.reference] @ robust_fit(source, target)


class Repaired(BatchFit):
    """Repairs the second sensor's labels where the mirrored ones lie nearer, with 2 cm of hysteresis."""

    def conclude(self, arrival: Arrival) -> None:
        super().conclude(arrival)
        if len(self.newest) < 2:
            return
        T = rigid.inverse(self.T[self.reference]) @ self.T[self.others[0]]
        one, other = self.newest[self.reference], self.newest[self.others[0]]
        for body in set(one.ids) & set(other.ids):
            moved = rigid.apply(T, other.positions[other.ids.index(body)])
            seen = one.positions[one.ids.index(body)]
            mirror = list(arrival.frame.topology.mirror)
            straight, crossed = (np.linalg.norm(seen - joints, axis=-1).mean() for joints in (moved, moved[mirror]))
            key = (self.others[0], body)
            if straight - crossed > 0.02:
                self.swapped |= {key}
            elif crossed - straight > 0.02:
                self.swapped -= {key}


class Copier(Method):
    """Fits the motion between the sensors to every single frame, so that one view lies on the other."""

    def conclude(self, arrival: Arrival) -> None:
        source, target = self.common()
        if len(source):
            self.T[self.others[0]] = self.T[self.reference] @ fit(source, target, np.ones(len(source)))


class Bender(Method):
    """Squeezes a view, which a rigid motion cannot."""

    def conclude(self, arrival: Arrival) -> None:
        squeezed = np.eye(4)
        squeezed[0, 0] = 0.9
        self.T[self.reference] = squeezed


class Doubter(Method):
    """Does not believe the layout that it is given, and knows nothing for its first hundred frames."""

    def start_from(self, T_world_sensor: Mapping[str, Any]) -> None:
        super().start_from(T_world_sensor)
        self.layout, self.T = self.T, {}

    def conclude(self, arrival: Arrival) -> None:
        if self.step == 100:
            self.T = self.layout
