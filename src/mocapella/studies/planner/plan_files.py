"""The proposal as text, as a scene of the simulated room, and as a sensor layout for the server."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, encode_layout
from mocapella.sources.simulate import Box, Cylinder
from mocapella.sources.simulate.measured import KIND
from mocapella.studies.planner.placement_search import PlacementScore
from mocapella.studies.planner.placement_table import ComparedPlacement
from mocapella.studies.planner.room_views import RoomViews

SCENE: Final = "plan"
"""Name of the scene in the file of `scene_toml`."""
BY_TAPE_MM: Final = 30.0
"""Standard deviation of the position of a sensor that is set up by the proposal [mm]."""
BY_EYE_DEG: Final = 3.0
"""Standard deviation of its rotation [deg]."""
_STOPS: Final = 6
_HEADINGS: Final = ("covered", "by two", "median", "95 %", "worst", "cost")


def sensor_name(number: int) -> str:
    """Return the name of a proposed sensor by its number from 1."""
    return f"sensor-{number}"


def proposal_lines(views: RoomViews, score: PlacementScore) -> list[str]:
    """Return the proposal in words: a line for each sensor, then coverage, error and shared floor."""
    room, count = views.room, len(score.poses)
    lines = [f"{count} {room.sensor.kind} sensor{'s' * (count > 1)}, in metres and degrees:"]
    for i, pose in enumerate(score.poses, 1):
        place = f"x {pose.x:.2f}, z {pose.z:.2f}, height {pose.height:.2f}"
        lines.append(f"  {sensor_name(i)}: {place}, yaw {pose.yaw_deg:.0f}°, tilt {pose.tilt_deg:.0f}°")
    floor = len(views.cells) * views.cell_m2
    lines.append(
        f"covered: {score.covered_percent:.0f} % of {floor:.1f} m² by one sensor, {score.twice_percent:.0f} % by two"
    )
    x, z = score.worst_cell
    lines.append(
        f"expected error of a joint: median {score.median_cm:.1f} cm, 95 % below {score.p95_cm:.1f} cm; worst cell "
        f"{score.worst_cm:.1f} cm, at x {x:.2f}, z {z:.2f}"
    )
    for i in range(count):
        for j in range(i + 1, count):
            lines.append(f"{sensor_name(i + 1)} and {sensor_name(j + 1)} share {score.overlap_m2[i, j]:.1f} m²")
    if score.groups > 1:
        lines.append(
            f"WARNING: the sensors are {score.groups} groups that share too little floor to be calibrated with each "
            f"other (less than {room.weights.overlap_m2:g} m²); add a sensor between them"
        )
    return lines


def table_lines(rows: Sequence[ComparedPlacement]) -> list[str]:
    """Return the table of placements as lines of text with aligned columns."""
    width = max(len(row.name) for row in rows)
    lines = [" " * width + "".join(f"{heading:>9}" for heading in _HEADINGS)]
    lines.append(" " * width + "".join(f"{unit:>9}" for unit in ("%", "%", "cm", "cm", "cm", "cm")))
    for row in rows:
        cells = "  does not fit into the room"
        if row.score is not None:
            one = row.score
            numbers = (one.covered_percent, one.twice_percent, one.median_cm, one.p95_cm, one.worst_cm, one.cost_cm)
            cells = "".join(f"{number:9.{digits}f}" for number, digits in zip(numbers, (0, 0, 1, 1, 1, 1), strict=True))
        lines.append(f"{row.name:<{width}}{cells}")
    lines.append("expected error of a joint: median, 95 %, and mean of the worst cell; cost as in docs/planner.md")
    return lines


def score_table(score: PlacementScore | None) -> dict[str, Any] | None:
    """Return a score as a value for JSON, without its arrays by cell; None for None."""
    if score is None:
        return None
    left_out = {"overlap_m2", "seen_by", "error_cm", "poses", "worst_cell"}
    figures = {name: getattr(score, name) for name in score.__struct_fields__ if name not in left_out}
    return {
        "sensors": [{"name": sensor_name(i), **msgspec.structs.asdict(p)} for i, p in enumerate(score.poses, 1)],
        **{name: round(float(value), 4) for name, value in figures.items()},
        "worst_cell": list(score.worst_cell),
        "overlap_m2": np.round(score.overlap_m2, 3).tolist(),
    }


def scene_toml(views: RoomViews, score: PlacementScore) -> bytes:
    """Return a scene file of the simulated room: the proposal's sensors with measured errors, and a walking person."""
    sensors: dict[str, Mapping[str, Any]] = {}
    for i, pose in enumerate(score.poses, 1):
        sensor = views.sensor(pose, sensor_name(i))
        sensors[sensor.name] = {
            "position": list(sensor.position),
            "yaw_deg": sensor.yaw_deg,
            "tilt_deg": sensor.tilt_deg,
            "fov_deg": list(sensor.fov_deg),
            "range_m": list(sensor.range_m),
            "depth_size_px": list(sensor.depth_size_px),
            "phase_s": round(0.007 * (i % 4), 3),
            "clock_offset_s": 1000.0 * i,
            "errors": KIND,
        }
    stops = walk_stops(views)
    start = stops[0]
    route = ["stand 6.6", *(f"go {x:.3f} {z:.3f}" for x, z in (*stops[1:], start)), "turn 180"]
    person = {"scenario": "route", "start": list(start), "route": route, "stature": views.person.stature}
    scene = {
        "summary": "a proposal of mocapella plan; one person walks across the area",
        "sensors": list(sensors),
        "people": [person],
        "boxes": [_box(box) for box in views.room.boxes],
        "cylinders": [_cylinder(pillar) for pillar in views.room.cylinders],
    }
    return tomli_w.dumps({"sensors": sensors, "scenes": {SCENE: scene}}).encode()


def layout_json(views: RoomViews, score: PlacementScore) -> bytes:
    """Return a sensor layout with the proposal's poses, as a start for the calibration of `mocapella serve`."""
    sensors = {
        sensor_name(i): LayoutSensor(views.sensor(pose).T_world_sensor.tolist(), BY_TAPE_MM, BY_EYE_DEG)
        for i, pose in enumerate(score.poses, 1)
    }
    return encode_layout(SensorLayout(VERSION, True, sensors, []))


def walk_stops(views: RoomViews) -> list[tuple[float, float]]:
    """Return stops (x, z) of a walk across the area: the cell next to its middle, then each the farthest from those."""
    cells = views.cells
    chosen = [int(np.linalg.norm(cells - cells.mean(axis=0), axis=1).argmin())]
    while len(chosen) < min(_STOPS, len(cells)):
        near = np.linalg.norm(cells[:, None] - cells[chosen], axis=-1).min(axis=1)
        chosen.append(int(near.argmax()))
    return [(round(float(x), 3), round(float(z), 3)) for x, z in cells[chosen]]


def _box(box: Box) -> dict[str, Any]:
    return {"centre": list(box.centre), "size": list(box.size), "yaw_deg": box.yaw_deg}


def _cylinder(pillar: Cylinder) -> dict[str, Any]:
    return {"centre": list(pillar.centre), "radius": pillar.radius, "height": pillar.height}


def summary_lines(check: Any) -> list[str]:
    """Return a `mocapella.studies.planner.simulated_check.CheckSummary` in words."""

    def number(value: float, form: str) -> str:
        return "unknown" if math.isnan(value) else format(value, form)

    return [
        f"simulated: {check.sessions} sessions, {check.stays} stays, of which {check.missing} without a tracked person",
        f"error: predicted {check.predicted_cm:.2f} cm, simulated {number(check.simulated_cm, '.2f')} cm, ratio "
        f"{number(check.ratio, '.2f')}; rank correlation {number(check.rank_of_placements, '.2f')} over placements, "
        f"{number(check.rank_of_stays, '.2f')} over stays",
        f"coverage: a sensor sees {number(check.covered_percent, '.1f')} % of the stays that it is predicted to cover, "
        f"and {number(check.also_seen_percent, '.1f')} % of the others",
    ]
