"""Plan-view maps of a proposal: how many sensors cover each cell, and the expected error there.

Seen from above, x grows to the left of z, as in the room. The colours are distinct for colour-blind readers: cividis
(J. Nuñez et al., 2018), and Okabe and Ito's palette for the sensors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.studies.planner.placement_search import PlacementScore
from mocapella.studies.planner.plan_files import sensor_name
from mocapella.studies.planner.planned_room import box_corners
from mocapella.studies.planner.room_views import PlannedPose, RoomViews

Float64 = NDArray[np.float64]

SENSOR_COLOURS: Final = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
"""Okabe and Ito's palette, the colours that stand out from cividis first."""


def draw_maps(views: RoomViews, score: PlacementScore, paths: tuple[Path, ...]) -> None:
    """Draw both maps side by side into each of the files, whose endings state their formats.

    Raises:
        SettingsError: matplotlib is not installed, or a file cannot be written.
    """
    room = views.room
    height = 4.2 * room.depth / room.width + 1.0
    figure = new_figure(paths[0], 11.0, float(np.clip(height, 3.5, 14.0)))
    coverage, error = figure.subplots(1, 2)
    most = len(score.poses)
    counts = _on_grid(views, score.seen_by.astype(np.float64))
    shown = _image(coverage, counts, _colours(most + 1), -0.5, most + 0.5)
    bar = figure.colorbar(shown, ax=coverage, ticks=range(most + 1), shrink=0.7)
    bar.set_label("sensors that see a person from head to ankle")
    coverage.set_title(f"covered: {score.covered_percent:.0f} %, by two sensors {score.twice_percent:.0f} %")
    by_cell = _on_grid(views, score.error_cm.mean(axis=(1, 2)))
    shown = _image(error, by_cell, "cividis_r", None, None)
    figure.colorbar(shown, ax=error, shrink=0.7).set_label("expected error of a joint [cm]")
    error.set_title(f"expected error: median {score.median_cm:.1f} cm, 95 % below {score.p95_cm:.1f} cm")
    for axes in (coverage, error):
        _draw_room(axes, views)
        for i, pose in enumerate(score.poses):
            _draw_sensor(axes, views, pose, i)
    for path in paths:
        save_figure(figure, path)


def field_of_view(pose: PlannedPose, fov_deg: float, range_m: tuple[float, float]) -> Float64:
    """Return the outline (n, 2) of a level field of view on the floor: x and z between nearest and farthest depth [m].

    Args:
        pose: the sensor.
        fov_deg: horizontal field of view [deg].
        range_m: nearest and farthest depth along the optical axis [m].
    """
    angle = np.radians(np.linspace(-fov_deg / 2, fov_deg / 2, 25))
    yaw, tilt = np.radians(pose.yaw_deg), np.radians(pose.tilt_deg)
    near, far = (np.stack([depth * np.tan(angle), np.full(25, depth * np.cos(tilt))], axis=-1) for depth in range_m)
    outline = np.concatenate([near, far[::-1]])
    x = pose.x + outline[:, 0] * np.cos(yaw) + outline[:, 1] * np.sin(yaw)
    z = pose.z - outline[:, 0] * np.sin(yaw) + outline[:, 1] * np.cos(yaw)
    return np.stack([x, z], axis=-1)


def _colours(count: int) -> Any:
    from matplotlib import colormaps

    return colormaps["cividis"].resampled(count)


def _on_grid(views: RoomViews, values: Float64) -> tuple[Float64, Float64, Float64]:
    """Edges along x and z, and the values (z, x) of a grid of cells; NaN where there is no cell."""
    cell = views.room.cell_m
    low = views.cells.min(axis=0)
    place = np.round((views.cells - low) / cell).astype(int)
    shape = place.max(axis=0) + 1
    grid = np.full((shape[1], shape[0]), np.nan)
    grid[place[:, 1], place[:, 0]] = values
    x, z = (low[k] + cell * (np.arange(shape[k] + 1) - 0.5) for k in range(2))
    return x, z, grid


def _image(axes: Any, grid: tuple[Float64, Float64, Float64], colours: Any, low: Any, high: Any) -> Any:
    return axes.pcolormesh(*grid, cmap=colours, vmin=low, vmax=high)


def _draw_room(axes: Any, views: RoomViews) -> None:
    from matplotlib.patches import Circle, Polygon, Rectangle

    room = views.room
    axes.add_patch(Rectangle(room.corner, room.width, room.depth, fill=False, edgecolor="black", linewidth=2))
    axes.add_patch(Polygon(np.array(room.floor), fill=False, edgecolor="black", linestyle="--", linewidth=1))
    grey: dict[str, Any] = {"facecolor": "0.55", "edgecolor": "black", "hatch": "///", "linewidth": 0.8}
    for box in room.boxes:
        axes.add_patch(Polygon(np.array(box_corners(box)), **grey))
    for pillar in room.cylinders:
        axes.add_patch(Circle(pillar.centre, pillar.radius, **grey))
    (x, z), margin = room.corner, 0.02 * max(room.width, room.depth)
    axes.set_xlim(x + room.width + margin, x - margin)  # seen from above, x grows to the left
    axes.set_ylim(z - margin, z + room.depth + margin)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")


def _draw_sensor(axes: Any, views: RoomViews, pose: PlannedPose, index: int) -> None:
    from matplotlib.patches import Polygon

    colour, model = SENSOR_COLOURS[index % len(SENSOR_COLOURS)], views.room.sensor.model
    outline = field_of_view(pose, min(model.fov_deg[0], 170.0), model.range_m)
    axes.add_patch(Polygon(outline, fill=False, edgecolor=colour, linewidth=1.4))
    axes.plot(pose.x, pose.z, "o", color=colour, markeredgecolor="white", markersize=9, clip_on=False, zorder=5)
    label = f"{sensor_name(index + 1)}\n{pose.height:.1f} m, {pose.tilt_deg:.0f}°"
    above = pose.z < views.room.corner[1] + views.room.depth / 2
    axes.annotate(
        label, (pose.x, pose.z), textcoords="offset points", xytext=(0, 9 if above else -9), ha="center",
        va="bottom" if above else "top", fontsize=7.5, zorder=6,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": colour, "linewidth": 0.8},
    )  # fmt: skip
