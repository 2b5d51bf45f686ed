"""Solve for all sensors in one frame from the relative poses of pairs.

A spanning tree of the most certain pairs initialises each sensor; with more pairs than the tree needs, weighted least
squares over all of them (Gauss–Newton on twists) distributes the contradictions by certainty. So sensors that never see
the same person at once are tied through others. Sensors without any tie form separate *components*, each in its own
frame.

Source: F. Lu and E. Milios, "Globally consistent range scan alignment for environment mapping", Autonomous Robots 4
(1997); in three dimensions G. Grisetti et al., "A tutorial on graph-based SLAM", IEEE ITS Magazine 2 (2010).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import inverse

Float64 = NDArray[np.float64]


class SensorPair(msgspec.Struct, frozen=True, eq=False):
    """Relative pose and clock of two sensors.

    Attributes:
        a, b: their names.
        T_a_b: (4, 4) from b's camera space to a's.
        covariance: (6, 6) of a small motion d in a's frame (translation [m], rotation [rad]), pose exp(d) T_a_b.
        offset: offset of b's clock against a's.
        trusted: an untrusted pair is used only if nothing else ties a sensor to the others.
    """

    a: str
    b: str
    T_a_b: Float64
    covariance: Float64
    offset: TimeOffset
    trusted: bool = True


class PlacedSensor(msgspec.Struct, frozen=True, eq=False):
    """Pose of a sensor.

    Attributes:
        T_root_sensor: (4, 4), in the frame of its component's first sensor.
        covariance: (6, 6) of a small motion in that frame (translation [m], rotation [rad]); zero for the first sensor.
        offset: offset of its clock against the first sensor's; None without a chain of known offsets.
        root: name of the component's first sensor.
        trusted: whether trusted pairs tie it to the first.
    """

    T_root_sensor: Float64
    covariance: Float64
    offset: TimeOffset | None
    root: str
    trusted: bool


MOST_STEPS: Final = 4
SMALLEST_STEP: Final = 1e-3
"""Step at which the refinement ends [m], [rad]; the remaining error is of the order of its square."""


@dataclass
class Component:
    """Sensors that pairs tie together, while their poses are refined step by step.

    Attributes:
        names: (sensors,) their names; the first is the root.
        sure: (sensors,) whether trusted pairs tie a sensor to the root.
        T_root_sensor: (sensors, 4, 4) present poses.
        covariance: (sensors, 6, 6) as `PlacedSensor.covariance`; zero before the last step.
        ends: (pairs, 2) indices of each pair's sensors, a and b.
        T_a_b, weights: (pairs, 4, 4) relative poses and (pairs, 6, 6) inverses of their covariances.
        offsets: offset of each sensor's clock against the root's, where a chain of known ones leads to it.
        steps_left: largest number of steps still to take; 0 once the poses are final.
    """

    names: tuple[str, ...]
    sure: tuple[bool, ...]
    T_root_sensor: Float64
    covariance: Float64
    ends: NDArray[np.int64]
    T_a_b: Float64
    weights: Float64
    offsets: dict[str, TimeOffset]
    steps_left: int

    def refine(self) -> None:
        """Take one step of Gauss–Newton; the last one writes the covariance."""
        last = _kernels().refine(
            self.T_root_sensor, self.ends, self.T_a_b, self.weights, SMALLEST_STEP, self.steps_left == 1,
            self.covariance,
        )  # fmt: skip
        self.steps_left = 0 if last else self.steps_left - 1


def place_sensors(
    sensors: Sequence[str], pairs: Collection[SensorPair], before: Mapping[str, PlacedSensor] | None = None
) -> dict[str, PlacedSensor]:
    """Return the pose of each sensor, by name.

    Args:
        sensors: names; the first of each component is its root, whose frame the component is in.
        pairs: relative poses of these sensors, at most one for each two.
        before: the previous result, as initial values of the refinement.

    Returns:
        All sensors, in the order of ``sensors``; one that no pair ties to another is its own root, at the identity.
    """
    components = components_of(sensors, by_certainty(pairs), before)
    for component in components:
        while component.steps_left:
            component.refine()
    return placed_by(components, sensors)


def components_of(
    sensors: Sequence[str], pairs: Sequence[SensorPair], before: Mapping[str, PlacedSensor] | None = None
) -> list[Component]:
    """Return the components of the graph with initial poses, to be refined.

    Args:
        sensors, before: names, and the previous result as initial values, as in `place_sensors`.
        pairs: relative poses of these sensors, at most one for each two, the most certain first.
    """
    rank = {sensor: i for i, sensor in enumerate(sensors)}
    leader = {sensor: sensor for sensor in sensors}

    def find(sensor: str) -> str:
        while leader[sensor] != sensor:
            sensor = leader[sensor]
        return sensor

    tree = []
    for pair in pairs:
        one, other = sorted((find(pair.a), find(pair.b)), key=rank.__getitem__)
        if one != other:
            leader[other] = one
            tree.append(pair)
    roots = {sensor: find(sensor) for sensor in sensors}
    used: dict[str, list[SensorPair]] = {root: [] for root in roots.values()}
    for pair in tree:
        used[roots[pair.a]].append(pair)
    in_tree = {(pair.a, pair.b) for pair in tree}
    more: dict[str, list[SensorPair]] = {root: [] for root in used}
    for pair in pairs:
        if pair.trusted and (pair.a, pair.b) not in in_tree:
            more[roots[pair.a]].append(pair)
    return [_component(root, used[root], more[root], before or {}) for root in used]


def placed_by(components: Sequence[Component], sensors: Sequence[str]) -> dict[str, PlacedSensor]:
    """Return the pose of each sensor of refined components, by name, in the order of ``sensors``."""
    placed = {
        name: PlacedSensor(part.T_root_sensor[i], part.covariance[i], part.offsets.get(name), part.names[0], sure)
        for part in components
        for i, (name, sure) in enumerate(zip(part.names, part.sure, strict=True))
    }
    return {name: placed[name] for name in sensors}


def by_certainty(pairs: Collection[SensorPair]) -> list[SensorPair]:
    """Return the pairs in order of certainty: the trusted ones, each by the variance of a point 2.5 m before a."""
    if not pairs:
        return []
    C = np.diagonal(np.stack([pair.covariance for pair in pairs]), axis1=1, axis2=2)
    variances = (C[:, 0] + C[:, 1] + C[:, 2] + 2.5**2 * (C[:, 3] + C[:, 4] + C[:, 5])).tolist()
    ranks = sorted(
        (not pair.trusted, variance, pair.a, pair.b, pair) for pair, variance in zip(pairs, variances, strict=True)
    )
    return [pair for *_, pair in ranks]


def _component(
    root: str, tree: Sequence[SensorPair], more: Sequence[SensorPair], before: Mapping[str, PlacedSensor]
) -> Component:
    """Return a component by the pairs of its spanning tree, in order of certainty, and its other trusted pairs."""
    T, sure = {root: np.eye(4)}, {root}
    waiting = list(tree)
    while waiting:
        for pair in [pair for pair in waiting if pair.a in T or pair.b in T]:
            if pair.a in T:
                T[pair.b] = T[pair.a] @ pair.T_a_b
            else:
                T[pair.a] = T[pair.b] @ inverse(pair.T_a_b)
            if pair.trusted and (pair.a in sure or pair.b in sure):
                sure |= {pair.a, pair.b}
            waiting.remove(pair)
    if more and all(sensor in before and before[sensor].root == root for sensor in T):
        T = {sensor: before[sensor].T_root_sensor for sensor in T}
    pairs, place = [*tree, *more], {sensor: i for i, sensor in enumerate(T)}
    return Component(
        names=tuple(T),
        sure=tuple(sensor in sure for sensor in T),
        T_root_sensor=np.stack(list(T.values())),
        covariance=np.zeros((len(T), 6, 6)),
        ends=np.array([(place[pair.a], place[pair.b]) for pair in pairs], dtype=np.int64).reshape(-1, 2),
        T_a_b=np.array([pair.T_a_b for pair in pairs]).reshape(-1, 4, 4),
        weights=_kernels().inverses_of_positive(np.array([pair.covariance for pair in pairs]).reshape(-1, 6, 6)),
        offsets=_offsets(root, pairs),
        steps_left=MOST_STEPS if pairs else 0,
    )


def _offsets(root: str, pairs: Sequence[SensorPair]) -> dict[str, TimeOffset]:
    """Return clock offsets against the root, by weighted least squares over the pairs with known offsets."""
    known = [pair for pair in pairs if pair.offset.known]
    tied: dict[str, list[str]] = {}
    for pair in known:
        tied.setdefault(pair.a, []).append(pair.b)
        tied.setdefault(pair.b, []).append(pair.a)
    reached, newest = {root}, [root]
    while newest:
        newest = [other for one in newest for other in tied.get(one, ()) if other not in reached]
        reached.update(newest)
    free = {sensor: i for i, sensor in enumerate(sorted(reached - {root}))}
    A, g = np.zeros((len(free), len(free))), np.zeros(len(free))
    for pair in known:
        if pair.a not in reached:
            continue
        weight = 1.0 / max(pair.offset.sd, 1e-4) ** 2
        a, b = free.get(pair.a), free.get(pair.b)
        if a is not None:
            A[a, a] += weight
            g[a] -= weight * pair.offset.seconds
        if b is not None:
            A[b, b] += weight
            g[b] += weight * pair.offset.seconds
        if a is not None and b is not None:
            A[a, b] -= weight
            A[b, a] -= weight
    C = _kernels().inverse_of_positive(A)
    seconds = C @ g
    out = {sensor: TimeOffset(float(seconds[i]), float(np.sqrt(C[i, i])), True) for sensor, i in free.items()}
    return {root: TimeOffset(0.0, 0.0, True), **out}


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import graph_kernels

    return graph_kernels
