"""All sensors in one frame, from what pairs of them know of each other.

A spanning tree of the surest pairs gives each sensor a first place; where there are more pairs than the tree needs,
weighted least squares over all of them (Gauss–Newton on twists) spreads the contradictions by how sure each pair is.
So sensors that never see the same person at once are tied through others. Sensors that nothing ties together are
*components*, each in a frame of its own.

Source: F. Lu and E. Milios, "Globally consistent range scan alignment for environment mapping", Autonomous Robots 4
(1997); in three dimensions G. Grisetti et al., "A tutorial on graph-based SLAM", IEEE ITS Magazine 2 (2010).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import adjoint, exp_twist, log_motion

Float64 = NDArray[np.float64]


class SensorPair(msgspec.Struct, frozen=True, eq=False):
    """What is known of two sensors.

    Attributes:
        a, b: their names.
        T_a_b: (4, 4); covariance: (6, 6). As in `pair_calibration.PairEstimate`.
        offset: of b's clock against a's.
        trusted: one that is not is used only where nothing else ties a sensor to the others.
    """

    a: str
    b: str
    T_a_b: Float64
    covariance: Float64
    offset: TimeOffset
    trusted: bool = True

    @property
    def variance(self) -> float:
        """One number for how unsure it is: that of a point 2.5 m before the sensor."""
        return float(np.trace(self.covariance[:3, :3]) + 2.5**2 * np.trace(self.covariance[3:, 3:]))


class PlacedSensor(msgspec.Struct, frozen=True, eq=False):
    """Where a sensor is.

    Attributes:
        T_root_sensor: (4, 4), in the frame of its component's first sensor.
        covariance: (6, 6) of a small motion in that frame; zero for the first sensor itself.
        offset: of its clock against the first sensor's; None where no chain of known offsets leads there.
        root: the component's first sensor.
        trusted: whether trusted pairs tie it to the first.
    """

    T_root_sensor: Float64
    covariance: Float64
    offset: TimeOffset | None
    root: str
    trusted: bool


MOST_STEPS: Final = 4
SMALLEST_STEP: Final = 1e-7
"""Metres and radians, at which the refinement ends."""


def place_sensors(sensors: Sequence[str], pairs: Collection[SensorPair]) -> dict[str, PlacedSensor]:
    """Where each sensor is, by its name.

    Args:
        sensors: names; the first of each component is its root, in whose frame the component is told.
        pairs: of these sensors, at most one for each two.
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
            placed |= _component(root, members, tree, pairs)
    return {sensor: placed[sensor] for sensor in sensors}


def _component(
    root: str, members: Sequence[str], tree: Sequence[SensorPair], pairs: Collection[SensorPair]
) -> dict[str, PlacedSensor]:
    T, covariance = {root: np.eye(4)}, {root: np.zeros((6, 6))}
    sure = {root}
    used = [pair for pair in tree if pair.a in members]
    waiting = list(used)
    while waiting:
        for pair in [pair for pair in waiting if pair.a in T or pair.b in T]:
            if pair.a in T:
                T[pair.b] = T[pair.a] @ pair.T_a_b
            else:
                T[pair.a] = T[pair.b] @ inverse(pair.T_a_b)
            old, new = (pair.a, pair.b) if pair.a in covariance else (pair.b, pair.a)
            to_root = adjoint(T[pair.a])
            covariance[new] = covariance[old] + to_root @ pair.covariance @ to_root.T
            if pair.trusted and (pair.a in sure or pair.b in sure):
                sure |= {pair.a, pair.b}
            waiting.remove(pair)
    in_tree = {(pair.a, pair.b) for pair in used}
    more = [pair for pair in pairs if pair.trusted and pair.a in T and (pair.a, pair.b) not in in_tree]
    used += more
    if more:
        covariance = _refine(T, root, used)
    offsets = _offsets(root, used)
    return {
        sensor: PlacedSensor(T[sensor], covariance[sensor], offsets.get(sensor), root, sensor in sure)
        for sensor in members
    }


def _refine(T: dict[str, Float64], root: str, pairs: Sequence[SensorPair]) -> dict[str, Float64]:
    """Improve T in place, and each sensor's covariance. exp(d) T_a_b = T_a⁻¹ T_b defines a pair's error d."""
    free = {sensor: 6 * i for i, sensor in enumerate(s for s in T if s != root)}
    n = 6 * len(free)
    weights = np.linalg.inv(np.stack([pair.covariance for pair in pairs]))
    for _ in range(MOST_STEPS):
        A, g = np.zeros((n, n)), np.zeros(n)
        for pair, weight in zip(pairs, weights, strict=True):
            to_a = adjoint(inverse(T[pair.a]))
            error = log_motion(inverse(T[pair.a]) @ T[pair.b] @ inverse(pair.T_a_b))
            W = to_a.T @ weight @ to_a
            force = to_a.T @ weight @ error
            for one, sign in ((pair.a, -1.0), (pair.b, 1.0)):
                if one == root:
                    continue
                i = free[one]
                g[i : i + 6] -= sign * force
                for other, other_sign in ((pair.a, -1.0), (pair.b, 1.0)):
                    if other != root:
                        k = free[other]
                        A[i : i + 6, k : k + 6] += sign * other_sign * W
        C = np.linalg.inv(A)
        step = C @ g
        for sensor, i in free.items():
            T[sensor] = exp_twist(step[i : i + 6]) @ T[sensor]
        if np.abs(step).max() < SMALLEST_STEP:
            break
    blocks = {sensor: C[i : i + 6, i : i + 6] for sensor, i in free.items()}
    return {root: np.zeros((6, 6)), **{sensor: (block + block.T) / 2 for sensor, block in blocks.items()}}


def _offsets(root: str, pairs: Sequence[SensorPair]) -> dict[str, TimeOffset]:
    """Clock offsets against the root, by weighted least squares over the pairs that know theirs."""
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
    C = np.linalg.inv(A)
    seconds = C @ g
    out = {sensor: TimeOffset(float(seconds[i]), float(np.sqrt(C[i, i])), True) for sensor, i in free.items()}
    return {root: TimeOffset(0.0, 0.0, True), **out}
