"""Placements to compare a proposal with: parallel, 45°, 90°, opposite, more sensors, other heights and tilts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np

from mocapella.studies.planner.placement_search import PlacementScore, best_placement, score_poses
from mocapella.studies.planner.room_views import PlannedPose, RoomViews, is_solid, wrapped

ARRANGEMENTS: Final = {
    "parallel": (0.0, 0.0),
    "45°": (0.0, 45.0),
    "90°": (0.0, 90.0),
    "opposite": (0.0, 180.0),
    "three around": (0.0, 120.0, 240.0),
    "four around": (0.0, 90.0, 180.0, 270.0),
}
"""Directions of the sensors from the area's middle, relative to the first [deg]."""
PARALLEL_M: Final = 0.5
"""Distance of two parallel sensors, as in the study [m]."""
FARTHEST_M: Final = 2.8
"""Distance of an arrangement's sensors from the area's middle, if the room is wide enough [m]."""
NEAREST_M: Final = 1.5
"""Least such distance [m]."""
HEIGHT_M: Final = 1.0
"""Height of an arrangement's sensors [m]."""
AIMED_AT_M: Final = 0.95
"""Height above the area's middle at which sensors of another height aim [m]."""
HEIGHTS_M: Final = (0.6, 1.0, 1.4, 1.8, 2.2)
TILTS_DEG: Final = (-20.0, -10.0, 0.0, 10.0)
_TURNS_DEG: Final = tuple(range(0, 360, 45))
_WALL_M: Final = 0.1


class ComparedPlacement(msgspec.Struct, frozen=True, eq=False):
    """A row of the table.

    Attributes:
        name: name of the compared placement, such as ``90°`` or ``height 1.4 m``.
        score: its score; None if it does not fit into the room.
    """

    name: str
    score: PlacementScore | None


def compare_placements(
    views: RoomViews, proposal: PlacementScore, *, seed: int = 0, on_step: Callable[[str], None] = lambda text: None
) -> list[ComparedPlacement]:
    """Return the rows of the table: arrangements, numbers of sensors, and the proposal at other heights and tilts.

    Args:
        views: the room.
        proposal: the best placement found.
        seed: random seed of the searches.
        on_step: called with the next step, in words.
    """
    rows = [ComparedPlacement("proposal", proposal)]
    for name, angles in ARRANGEMENTS.items():
        on_step(f"placement {name}")
        rows.append(ComparedPlacement(name, best_arrangement(views, angles)))
    count = len(proposal.poses)
    for number in sorted({max(1, count - 1), count + 1} - {count}):
        on_step(f"the best {number} sensors")
        best = best_placement(views, number, seed=seed, restarts=0)
        rows.append(ComparedPlacement(f"best {number} sensor{'s' * (number > 1)}", best))
    for height in (height for height in HEIGHTS_M if height <= views.room.height):
        on_step(f"height {height} m")
        poses = [aimed(views, (pose.x, height, pose.z), pose.yaw_deg) for pose in proposal.poses]
        rows.append(ComparedPlacement(f"height {height:g} m, aimed", _score(views, poses)))
    for tilt in TILTS_DEG:
        on_step(f"tilt {tilt:g}°")
        poses = [msgspec.structs.replace(pose, tilt_deg=tilt) for pose in proposal.poses]
        rows.append(ComparedPlacement(f"tilt {tilt:g}°", _score(views, poses)))
    return rows


def simulated_rows(rows: Sequence[ComparedPlacement]) -> list[tuple[str, PlacementScore]]:
    """Return name and score of the rows that are worth a simulation: arrangements and best placements of two or more.

    Heights and tilts hardly change what the simulation's errors depend on, and a single sensor has nothing to fuse.
    """
    return [
        (row.name, row.score)
        for row in rows
        if row.score is not None and len(row.score.poses) > 1 and not row.name.startswith(("height", "tilt"))
    ]


def best_arrangement(views: RoomViews, angles_deg: Sequence[float]) -> PlacementScore | None:
    """Return the arrangement of least cost among eight directions of its first sensor; None if none fits."""
    found = [
        score
        for turn in _TURNS_DEG
        if (poses := arrangement(views, angles_deg, turn)) and (score := _score(views, poses)) is not None
    ]
    return min(found, key=lambda score: round(score.cost_cm, 6), default=None)


def arrangement(views: RoomViews, angles_deg: Sequence[float], turn_deg: float) -> list[PlannedPose]:
    """Return sensors around the area's middle, level and at `HEIGHT_M`; empty if they do not fit.

    Two equal angles are two parallel sensors, `PARALLEL_M` apart.
    """
    x, z = views.cells.mean(axis=0)
    poses = []
    for i, angle in enumerate(angles_deg):
        away = math.radians(turn_deg + angle)
        direction = np.array([math.sin(away), math.cos(away)])
        far = min(FARTHEST_M, _to_wall(views, direction) - _WALL_M)
        if far < NEAREST_M:
            return []
        aside = 0.0 if i == 0 or angle != angles_deg[0] else PARALLEL_M
        place = np.array([x, z]) + far * direction + aside * np.array([direction[1], -direction[0]])
        yaw = wrapped(turn_deg + angle + 180.0)
        poses.append(PlannedPose(float(place[0]), HEIGHT_M, float(place[1]), yaw, 0.0))
    return poses


def aimed(views: RoomViews, lens: tuple[float, float, float], yaw_deg: float) -> PlannedPose:
    """Return a pose whose tilt aims at `AIMED_AT_M` above the area's middle, rounded to a degree."""
    far = float(np.hypot(*(views.cells.mean(axis=0) - np.array([lens[0], lens[2]]))))
    tilt = math.degrees(math.atan2(AIMED_AT_M - lens[1], max(far, 0.1)))
    return PlannedPose(*lens, yaw_deg, float(round(tilt)))


def _score(views: RoomViews, poses: Sequence[PlannedPose]) -> PlacementScore | None:
    room = views.room
    (x, z), w, d = room.corner, room.width, room.depth
    for pose in poses:
        if not (x <= pose.x <= x + w and z <= pose.z <= z + d) or is_solid(room, pose.lens):
            return None
    return score_poses(views, poses)


def _to_wall(views: RoomViews, direction: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Distance from the area's middle to the walls in a direction [m]."""
    room, middle = views.room, views.cells.mean(axis=0)
    low = np.array(room.corner)
    high = low + np.array([room.width, room.depth])
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.where(direction > 0, high - middle, low - middle) / direction
    return float(np.nanmin(np.where(np.abs(direction) < 1e-9, np.inf, distances)))
