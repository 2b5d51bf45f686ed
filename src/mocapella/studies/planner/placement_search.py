"""The best poses for a number of sensors: greedy, then exchanges, from several starts.

    cost = E + w₀ (1 − C₁) + w₁ (1 − C₂) + w₂ (groups − 1)

E is the mean expected error of a joint, C₁ and C₂ the shares of the cells that at least one and two sensors cover, and
*groups* the number of groups of sensors that cannot be calibrated with each other (docs/planner.md). The exchange of
one sensor at a time is that of Fedorov for designs of experiments (V. V. Fedorov, "Theory of Optimal Experiments",
1972, chapter 3); the greedy start is within 1 − 1/e of the best coverage (Nemhauser et al., 1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.studies.planner.room_views import PlannedPose, RoomViews
from mocapella.studies.planner.symmetric import trace_of_inverse

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

RESTARTS: Final = 3
"""Number of random starts beside the greedy one."""
BETTER_CM: Final = 1e-4
"""Least decrease of the cost by an exchange [cm]."""
_CM: Final = 100.0


class PlacementScore(msgspec.Struct, frozen=True, eq=False):
    """Coverage and expected error of sensors in a room.

    Attributes:
        poses: the sensors.
        cost_cm: the cost [cm].
        covered_percent, twice_percent: share of the area where a person is seen from head to ankle by at least one
            and by at least two sensors [%].
        mean_cm, median_cm, p95_cm: expected error of a joint, over all cells, facings and postures [cm].
        worst_cm: greatest mean expected error of a cell [cm].
        worst_cell: centre of that cell, x and z [m].
        groups: number of groups of sensors that cannot be calibrated with each other; 1 if all can.
        overlap_m2: (sensors, sensors) area that two sensors both cover [m²].
        seen_by: (cells,) number of sensors that cover each cell.
        error_cm: (cells, facings, postures) expected error, mean over the joints [cm].
    """

    poses: tuple[PlannedPose, ...]
    cost_cm: float
    covered_percent: float
    twice_percent: float
    mean_cm: float
    median_cm: float
    p95_cm: float
    worst_cm: float
    worst_cell: tuple[float, float]
    groups: int
    overlap_m2: Float64
    seen_by: NDArray[np.int64]
    error_cm: Float64


def score_poses(views: RoomViews, poses: Sequence[PlannedPose]) -> PlacementScore:
    """Return coverage and expected error of any poses, also of those at no site.

    Raises:
        SettingsError: there is no pose.
    """
    if not poses:
        raise SettingsError("no sensor to score; give one or more")
    total = _nothing(views).reshape(6, *views.shape)
    covers = np.zeros((len(poses), len(views.cells)), dtype=np.bool_)
    for i, pose in enumerate(poses):
        view = views.lens_view(pose.lens)
        seen, covers[i] = views.see(view, pose)
        total += view.information * seen
    error = _CM * np.sqrt(trace_of_inverse(total.astype(np.float64))).mean(axis=-1)
    by_cell = error.mean(axis=(1, 2))
    overlap = views.cell_m2 * (covers[:, None] & covers[None]).sum(axis=-1)
    groups = groups_of(overlap >= views.room.weights.overlap_m2)
    seen_by = covers.sum(axis=0)
    worst = int(by_cell.argmax())
    return PlacementScore(
        poses=tuple(poses),
        cost_cm=_cost(views, float(error.mean()), seen_by[None], np.array([groups]))[0],
        covered_percent=100 * float((seen_by >= 1).mean()),
        twice_percent=100 * float((seen_by >= 2).mean()),
        mean_cm=float(error.mean()),
        median_cm=float(np.median(error)),
        p95_cm=float(np.quantile(error, 0.95)),
        worst_cm=float(by_cell[worst]),
        worst_cell=(float(views.cells[worst, 0]), float(views.cells[worst, 1])),
        groups=groups,
        overlap_m2=overlap,
        seen_by=seen_by,
        error_cm=error,
    )


def groups_of(linked: Bools) -> int:
    """Return the number of connected components of a graph with the adjacency matrix ``linked`` (n, n)."""
    reach = linked | np.eye(len(linked), dtype=np.bool_)
    for _ in range(len(linked)):
        reach = (reach.astype(np.int64) @ reach) > 0
    return len(np.unique(reach, axis=0))


def best_placement(
    views: RoomViews, sensors: int, *, seed: int = 0, restarts: int = RESTARTS,
    on_step: Callable[[str], None] = lambda text: None,
) -> PlacementScore:  # fmt: skip
    """Search the poses of least cost.

    Args:
        views: the room.
        sensors: number of sensors.
        seed: random seed of the starts; the same seed gives the same poses.
        restarts: number of random starts beside the greedy one.
        on_step: called with the next step, in words.

    Raises:
        SettingsError: fewer than one sensor.
    """
    if sensors < 1:
        raise SettingsError(f"{sensors} sensors cannot be placed; give --sensors 1 or more")
    on_step("best pose of a single sensor")
    first = costs_with(views, [])
    ranked = np.lexsort((np.arange(len(first)), first.round(6)))
    starts = [_greedy(views, sensors, int(ranked[0]), on_step)]
    rng = np.random.default_rng(seed)
    if sensors > 1:
        starts += [ranked[rng.integers(0, len(ranked), sensors)].tolist() for _ in range(restarts)]
    found = []
    for number, start in enumerate(starts, 1):
        on_step(f"exchanges, start {number} of {len(starts)}")
        found.append(_exchanged(views, start))
    _, best = min(found, key=lambda each: round(each[0], 6))
    ordered = sorted(best, key=lambda index: (first[index].round(6), index))
    return score_poses(views, [views.poses[index] for index in ordered])


def exhaustive_placement(views: RoomViews, sensors: int) -> tuple[float, tuple[int, ...]]:
    """Return the least cost of any poses [cm], and their indices, by trying all; for small rooms."""
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for chosen in combinations(range(len(views.poses)), sensors - 1):
        cost = costs_with(views, list(chosen))
        index = int(cost.argmin())
        best = min(best, (float(cost[index]), (*chosen, index)))
    return best


def costs_with(views: RoomViews, chosen: Sequence[int]) -> Float64:
    """Return the cost (poses,) of each pose together with those chosen already, by their indices [cm]."""
    base = _nothing(views)
    for index in chosen:
        base[:, views.joints[index]] += views.information[index]
    alone = np.sqrt(trace_of_inverse(base))
    error = np.full(len(views.poses), alone.sum(dtype=np.float64))
    for index, (joints, information) in enumerate(zip(views.joints, views.information, strict=True)):
        both = np.sqrt(trace_of_inverse(base[:, joints] + information))
        error[index] += (both - alone[joints]).sum(dtype=np.float64)  # the other joints' errors do not change
    mean = _CM * error / alone.size
    already = views.covers[list(chosen)]
    seen_by = already.sum(axis=0) + views.covers
    return _cost(views, mean, seen_by, _groups_with(views, already))


def _groups_with(views: RoomViews, already: Bools) -> NDArray[np.int64]:
    """Groups (poses,) of the chosen sensors, whose covered cells are given (chosen, cells), and each pose."""
    if not len(already):
        return np.ones(len(views.poses), dtype=np.int64)
    least = views.room.weights.overlap_m2 / views.cell_m2
    between = already.astype(np.float32) @ already.T.astype(np.float32) >= least
    to_pose = views.covers.astype(np.float32) @ already.T.astype(np.float32) >= least
    known: dict[bytes, int] = {}
    groups = np.empty(len(views.poses), dtype=np.int64)
    for index, links in enumerate(to_pose):
        key = links.tobytes()
        if key not in known:
            linked = np.zeros((len(already) + 1, len(already) + 1), dtype=np.bool_)
            linked[:-1, :-1] = between
            linked[-1, :-1] = linked[:-1, -1] = links
            known[key] = groups_of(linked)
        groups[index] = known[key]
    return groups


def _cost(views: RoomViews, mean_cm: Any, seen_by: NDArray[np.int64], groups: NDArray[np.int64]) -> Float64:
    weights = views.room.weights
    once, twice = (seen_by >= 1).mean(axis=-1), (seen_by >= 2).mean(axis=-1)
    return np.asarray(
        mean_cm + weights.uncovered_cm * (1 - once) + weights.single_cm * (1 - twice) + weights.apart_cm * (groups - 1)
    )


def _nothing(views: RoomViews) -> Float32:
    """Information (6, joints) of all joints of `RoomViews.shape` without sensors [1/m²]."""
    base = np.zeros((6, math.prod(views.shape)), dtype=np.float32)
    base[:3] = views.prior
    return base


def _greedy(views: RoomViews, sensors: int, first: int, on_step: Callable[[str], None]) -> list[int]:
    chosen = [first]
    while len(chosen) < sensors:
        on_step(f"best pose of sensor {len(chosen) + 1} beside those before")
        chosen.append(int(costs_with(views, chosen).round(6).argmin()))
    return chosen


def _exchanged(views: RoomViews, start: list[int]) -> tuple[float, list[int]]:
    """Exchange one sensor at a time for the best other pose until no exchange lowers the cost."""
    chosen, cost, since = list(start), np.inf, 0
    place = 0
    while since < len(chosen):
        others = chosen[:place] + chosen[place + 1 :]
        costs = costs_with(views, others).round(6)
        index = int(costs.argmin())
        if costs[index] < min(cost, costs[chosen[place]]) - BETTER_CM:
            chosen[place], since = index, 0
        else:
            since += 1
        cost = min(float(costs[chosen[place]]), cost)
        place = (place + 1) % len(chosen)
    return cost, chosen
