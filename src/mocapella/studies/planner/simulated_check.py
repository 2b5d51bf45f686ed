"""Compare predicted coverage and error of a placement with the simulated room.

A person walks, so that the method ``default`` finds the sensors' poses, and then stands in cells of the area, each time
with another facing. Sensors have the measured errors of a Kinect v2. Of each stay, the error of the fused skeleton is
compared with the expected one, and what each sensor sees with its predicted coverage.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.observations import Arrival, JointState
from mocapella.sources.simulate import PersonSettings, Room, SceneSettings, SimulatedSensor, build_room, merge
from mocapella.sources.simulate.body import JOINT
from mocapella.sources.simulate.measured import KIND
from mocapella.sources.simulate.scenarios import written_route
from mocapella.studies.planner.person_views import SCORED_JOINTS
from mocapella.studies.planner.placement_search import PlacementScore
from mocapella.studies.planner.room_views import RoomViews
from mocapella.tracker.default import DefaultTracker

Float64 = NDArray[np.float64]

STAYS: Final = 12
"""Number of stays in a simulated session."""
STAY_S: Final = 1.5
"""Duration of a stay; its last second is scored [s]."""
RATE_HZ: Final = 15.0
"""Frame rate of the simulated sensors, half a Kinect v2's, for speed [Hz]."""
_SCORED_S: Final = 1.0
_UPPER: Final = [JOINT[name] for name in ("Head", "SpineBase")]
_ANKLES: Final = [JOINT[name] for name in ("AnkleLeft", "AnkleRight")]


class Stay(msgspec.Struct, frozen=True):
    """One stay of the simulated person.

    Attributes:
        cell, facing: indices of the cell and the facing.
        begins_s: room time at which it is scored from [s].
    """

    cell: int
    facing: int
    begins_s: float


class PlacementCheck(msgspec.Struct, frozen=True, eq=False):
    """Predicted and simulated figures of the stays of one session.

    Attributes:
        predicted_cm, simulated_cm: (stays,) error of the joints of `person_views.SCORED` [cm]; NaN where the person was
            not tracked.
        covers_predicted, covers_simulated: (stays, sensors) whether a sensor sees the person from head to ankle.
    """

    predicted_cm: Float64
    simulated_cm: Float64
    covers_predicted: NDArray[np.bool_]
    covers_simulated: NDArray[np.bool_]


class CheckSummary(msgspec.Struct, frozen=True):
    """Agreement of the prediction with the simulation over all sessions.

    Attributes:
        sessions, stays: their numbers.
        missing: number of stays without a tracked person.
        rank_of_stays: Spearman's rank correlation of predicted and simulated error over stays.
        rank_of_placements: the same over placements, of their mean errors.
        predicted_cm, simulated_cm: mean errors [cm].
        ratio: simulated over predicted mean error.
        covered_percent: of the stays that a sensor is predicted to cover, the share where it sees the person [%].
        also_seen_percent: the same of the other stays; people of some heights are seen where not all are [%].
    """

    sessions: int
    stays: int
    missing: int
    rank_of_stays: float
    rank_of_placements: float
    predicted_cm: float
    simulated_cm: float
    ratio: float
    covered_percent: float
    also_seen_percent: float


def check_placement(views: RoomViews, score: PlacementScore, seed: int) -> PlacementCheck:
    """Simulate one session with a placement, and return its stays.

    Args:
        views: the room.
        score: the placement, of `mocapella.studies.planner.placement_search.score_poses`.
        seed: random seed of the route and of the sensors' errors.
    """
    room, stays = _session(views, score, seed)
    names, count = room.sensor_names, len(stays)
    tracker = DefaultTracker(sensors_expected=len(names))
    T_world = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
    latency_ns = {sensor.name: round(sensor.latency_s * NS_PER_S) for sensor in room.settings.sensors}
    begins = np.array([stay.begins_s for stay in stays])
    errors: list[list[float]] = [[] for _ in stays]
    whole = np.zeros((count, len(names), 2))
    end_s = float(begins[-1] + _SCORED_S)
    for item in merge([SimulatedSensor(room, name) for name in names], 0.0, end_s):
        scene = tracker.update(Arrival(item.frame, item.truth.room_ns + latency_ns[item.frame.sensor]))
        at_s = item.truth.room_ns / NS_PER_S
        k = int(np.searchsorted(begins, at_s, side="right")) - 1
        if k < 0 or at_s > begins[k] + _SCORED_S:
            continue
        sensor = names.index(item.frame.sensor)
        states = item.frame.states
        known = states != JointState.NOT_TRACKED
        # Side-on, one ankle is behind the other, and after two seconds the simulated sensor no longer infers it.
        whole[k, sensor] += (bool(len(states)) and known[0, _UPPER].all() and known[0, _ANKLES].any(), 1)
        place = next((place.T_world_sensor for place in scene.sensors if place.sensor == names[0]), None)
        if sensor == 0 and scene.people and place is not None:
            found = apply(T_world[names[0]] @ inverse(place), scene.people[0].positions)
            away = np.linalg.norm(found - item.truth.positions[0], axis=-1)[SCORED_JOINTS]
            errors[k].append(float(np.nanmean(away)) if np.isfinite(away).any() else np.nan)
    simulated = np.array([100 * np.mean(each) if each else np.nan for each in errors])
    predicted = np.array([score.error_cm[stay.cell, stay.facing].mean() for stay in stays])
    covers = np.stack([views.see(views.lens_view(pose.lens), pose)[1] for pose in score.poses], axis=-1)
    share = whole[..., 0] / np.maximum(whole[..., 1], 1)
    return PlacementCheck(predicted, simulated, covers[[stay.cell for stay in stays]], share > 0.5)


def summarise(checks: Sequence[Sequence[PlacementCheck]]) -> CheckSummary:
    """Return the agreement over sessions, given by placement and seed; placements have at least one session."""
    sessions = [check for of_placement in checks for check in of_placement]
    predicted = np.concatenate([check.predicted_cm for check in sessions])
    simulated = np.concatenate([check.simulated_cm for check in sessions])
    known = np.isfinite(simulated)
    means = np.array([_means(of_placement) for of_placement in checks])
    covers = np.concatenate([check.covers_predicted.ravel() for check in sessions])
    sees = np.concatenate([check.covers_simulated.ravel() for check in sessions])
    both = float(predicted[known].mean()), float(simulated[known].mean())
    return CheckSummary(
        sessions=len(sessions),
        stays=len(known),
        missing=int((~known).sum()),
        rank_of_stays=_rank(predicted[known], simulated[known]),
        rank_of_placements=_rank(means[:, 0], means[:, 1]),
        predicted_cm=both[0],
        simulated_cm=both[1],
        ratio=both[1] / both[0],
        covered_percent=100 * float(sees[covers].mean()) if covers.any() else math.nan,
        also_seen_percent=100 * float(sees[~covers].mean()) if not covers.all() else math.nan,
    )


def check_placements(
    views: RoomViews, scores: Sequence[PlacementScore], seeds: Sequence[int],
    on_step: Callable[[str], None] = lambda text: None,
) -> list[list[PlacementCheck]]:  # fmt: skip
    """Simulate every placement with every seed; ``on_step`` is called with the next session, in words."""
    total, out = len(scores) * len(seeds), []
    for i, score in enumerate(scores):
        row = []
        for k, seed in enumerate(seeds):
            on_step(f"simulated session {i * len(seeds) + k + 1} of {total}")
            row.append(check_placement(views, score, seed))
        out.append(row)
    return out


def _means(checks: Sequence[PlacementCheck]) -> tuple[float, float]:
    predicted = np.concatenate([check.predicted_cm for check in checks])
    simulated = np.concatenate([check.simulated_cm for check in checks])
    known = np.isfinite(simulated)
    if not known.any():
        return float(predicted.mean()), math.nan
    return float(predicted[known].mean()), float(simulated[known].mean())


def _rank(one: Float64, other: Float64) -> float:
    known = np.isfinite(one) & np.isfinite(other)
    if known.sum() < 3 or np.ptp(one[known]) == 0 or np.ptp(other[known]) == 0:
        return math.nan
    return float(spearmanr(one[known], other[known]).statistic)


def _session(views: RoomViews, score: PlacementScore, seed: int) -> tuple[Room, list[Stay]]:
    """The room of one session, and its stays: a walk across the area, then cells in a random order."""
    rng = np.random.default_rng([seed, len(score.poses)])
    cells, facings = views.cells, views.room.people.facings
    start = cells[np.linalg.norm(cells - cells.mean(axis=0), axis=1).argmin()]
    words = ["stand 2"]
    for cell in rng.choice(len(cells), 5):
        words.append(_go(cells[cell]))
    stays = []
    for cell in rng.choice(len(cells), STAYS, replace=len(cells) < STAYS):
        facing = int(rng.integers(facings))
        words += [_go(cells[cell]), f"turn {360.0 * facing / facings}"]
        begins = written_route((float(start[0]), float(start[1])), words).seconds + STAY_S - _SCORED_S
        words.append(f"stand {STAY_S}")
        stays.append(Stay(int(cell), facing, begins))
    words.append("stand 1")
    low, high = views.room.people.heights_m
    person = PersonSettings(
        (float(start[0]), float(start[1])), "route", route=tuple(words), stature=float(rng.uniform(low, high))
    )
    sensors = tuple(
        dataclasses.replace(views.sensor(pose, f"sensor-{i}"), errors=KIND, rate_hz=RATE_HZ, phase_s=0.007 * (i % 4))
        for i, pose in enumerate(score.poses, 1)
    )
    settings = SceneSettings(
        "plan", sensors, (person,), boxes=views.room.boxes, cylinders=views.room.cylinders, seed=seed
    )
    return build_room(settings), stays


def _go(cell: Float64) -> str:
    return f"go {cell[0]} {cell[1]}"
