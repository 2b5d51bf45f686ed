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

    @property
    def variance(self) -> float:
        """Scalar uncertainty: the variance of a point 2.5 m before the sensor [m²]."""
        return float(np.trace(self.covariance[:3, :3]) + 2.5**2 * np.trace(self.covariance[3:, 3:]))


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
    rank = {sensor: i for i, sensor in enumerate(sensors)}
    by_surety = sorted(pairs, key=lambda pair: (not pair.trusted, pair.variance, rank[pair.a], rank[pair.b]))
    leader = {sensor: sensor for sensor in sensors}

    def find(sensor: str) -> str:
        while leader[sensor] != sensor:
            sensor = leader[sensor]
        return sensor

    tree = []
    for pair in by_surety:
        one, other = sorted((find(pair.a), find(pair.b)), key=rank.__getitem__)
        if one != other:
            leader[other] = one
            tree.append(pair)
    placed: dict[str, PlacedSensor] = {}
    for root in sensors:
        members = [sensor for sensor in sensors if find(sensor) == root]
        if members:
            placed |= _component(root, members, tree, pairs, before or {})
    return {sensor: placed[sensor] for sensor in sensors}


def _component(
    root: str,
    members: Sequence[str],
    tree: Sequence[SensorPair],
    pairs: Collection[SensorPair],
    before: Mapping[str, PlacedSensor],
) -> dict[str, PlacedSensor]:
    used = [pair for pair in tree if pair.a in members]
    T, sure = {root: np.eye(4)}, {root}
    waiting = list(used)
    while waiting:
        for pair in [pair for pair in waiting if pair.a in T or pair.b in T]:
            if pair.a in T:
                T[pair.b] = T[pair.a] @ pair.T_a_b
            else:
                T[pair.a] = T[pair.b] @ inverse(pair.T_a_b)
            if pair.trusted and (pair.a in sure or pair.b in sure):
                sure |= {pair.a, pair.b}
            waiting.remove(pair)
    in_tree = {(pair.a, pair.b) for pair in used}
    more = [pair for pair in pairs if pair.trusted and pair.a in T and (pair.a, pair.b) not in in_tree]
    if more and all(sensor in before and before[sensor].root == root for sensor in T):
        T = {sensor: before[sensor].T_root_sensor for sensor in T}
    used += more
    covariance = _refine(T, used) if used else {root: np.zeros((6, 6))}
    offsets = _offsets(root, used)
    return {
        sensor: PlacedSensor(T[sensor], covariance[sensor], offsets.get(sensor), root, sensor in sure)
        for sensor in members
    }


def _refine(T: dict[str, Float64], pairs: Sequence[SensorPair]) -> dict[str, Float64]:
    """Refine T in place, whose first sensor is the root; return each sensor's covariance.

    exp(d) T_a_b = T_a⁻¹ T_b defines a pair's error d.
    """
    place = {sensor: i for i, sensor in enumerate(T)}
    a, b = (np.array([place[getattr(pair, end)] for pair in pairs]) for end in ("a", "b"))
    weights = np.stack([_kernels().inverse_of_positive(np.ascontiguousarray(pair.covariance)) for pair in pairs])
    world, n = np.stack(list(T.values())), len(T)
    T_a_b = np.stack([pair.T_a_b for pair in pairs])
    C = _kernels().refine(world, a, b, T_a_b, weights, MOST_STEPS, SMALLEST_STEP)
    T.update(zip(T, world, strict=True))
    blocks = C.reshape(n - 1, 6, n - 1, 6)[np.arange(n - 1), :, np.arange(n - 1)]
    return dict(zip(T, (np.zeros((6, 6)), *blocks), strict=True))


def _offsets(root: str, pairs: Sequence[SensorPair]) -> dict[str, TimeOffset]:
    """Return clock offsets against the root, by weighted least squares over the pairs with known offsets."""
    known = [pair for pair in pairs if pair.offset.known]
    reached = {root}
    for _ in known:
        reached |= {s for pair in known if reached & {pair.a, pair.b} for s in (pair.a, pair.b)}
    free = {sensor: i for i, sensor in enumerate(sorted(reached - {root}))}
    A, g = np.zeros((len(free), len(free))), np.zeros(len(free))
    for pair in known:
        if pair.a not in reached:
            continue
        row = np.zeros(len(free))
        for sensor, sign in ((pair.a, -1.0), (pair.b, 1.0)):
            if sensor != root:
                row[free[sensor]] = sign
        weight = 1.0 / max(pair.offset.sd, 1e-4) ** 2
        A += weight * np.outer(row, row)
        g += weight * pair.offset.seconds * row
    C = _kernels().inverse_of_positive(A)
    seconds = C @ g
    out = {sensor: TimeOffset(float(seconds[i]), float(np.sqrt(C[i, i])), True) for sensor, i in free.items()}
    return {root: TimeOffset(0.0, 0.0, True), **out}


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import graph_kernels

    return graph_kernels
