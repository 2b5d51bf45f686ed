"""``mocapella plan``: where sensors should stand in a room."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import SET_UP, app
from mocapella.cli.common import JsonOut, Seed, participant_numbers, say, working, write_json
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.studies.planner.placement_search import PlacementScore
    from mocapella.studies.planner.placement_table import ComparedPlacement
    from mocapella.studies.planner.planned_room import PlannedRoom
    from mocapella.studies.planner.room_views import RoomViews

FILES: Final = ("plan.txt", "plan.png", "plan.svg", "scene.toml", "layout.json")
"""Files of the folder of ``--out``."""


# Hidden: a new user needs no planner, and the introduction of --help names it.
@app.command(rich_help_panel=SET_UP, hidden=True)
def plan(
    room: Annotated[Path | None, typer.Argument(metavar="ROOM", help="Description of the room (TOML).")] = None,
    sensors: Annotated[
        int | None,
        typer.Option("--sensors", metavar="NUMBER", min=1, help="Number of sensors to place; by default the file's."),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            "--sensor",
            metavar="SENSOR",
            help="Kind of the sensors: kinect-v2, kinect-v1, azure-kinect or azure-kinect-wide; by default the file's.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Folder to write to: the table, maps, a scene to simulate and a sensor layout for serve.",
        ),
    ] = None,
    seed: Seed = 0,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            metavar="N,N,…",
            help="Seeds of the simulation. With them the placements are also simulated, which takes minutes.",
        ),
    ] = None,
    example: Annotated[bool, typer.Option("--example", help="Print a room to begin with, as TOML.")] = False,
    json: JsonOut = None,
) -> None:
    """Propose where sensors should stand, for the largest covered floor and the smallest expected error.

    docs/planner.md describes the room's file, states the cost, and how well the prediction agrees with the simulation.

    Example:  mocapella plan --example > room.toml; mocapella plan room.toml --out plan
    """
    from mocapella.studies.planner.placement_search import best_placement
    from mocapella.studies.planner.placement_table import compare_placements
    from mocapella.studies.planner.plan_files import proposal_lines, score_table, table_lines
    from mocapella.studies.planner.planned_room import example_room
    from mocapella.studies.planner.room_views import RoomViews

    if example:
        typer.echo(example_room(), nl=False)
        return
    if room is None:
        raise SettingsError("no room to plan; name a file, which `mocapella plan --example > room.toml` begins")
    numbers = participant_numbers(seeds, "--seeds") or []
    planned = _planned(room, sensors, sensor)
    if out is not None:
        _check_folder(out)
    with working("planning …", status=INTERRUPTED) as shown:

        def tell(text: str) -> None:
            shown.update(f"{text} …")

        views = RoomViews(planned, tell)
        best = best_placement(views, planned.sensor.count, seed=seed, on_step=tell)
        rows = compare_placements(views, best, seed=seed, on_step=tell)
        check = _simulated(views, rows, numbers, tell)
        lines = [*proposal_lines(views, best), "", *table_lines(rows), *(["", *check[1]] if check else [])]
        if out is not None:
            _write(out, views, best, lines)
    for note in views.notes:
        say(note)
    if json != "-":
        typer.echo("\n".join(lines))
    table = [{"name": row.name, "score": score_table(row.score)} for row in rows]
    result = {"room": str(room), "notes": views.notes, "cell_m": views.room.cell_m, "proposal": score_table(best)}
    write_json(json, {**result, "placements": table, "simulated": check[0] if check else None})


def _planned(path: Path, sensors: int | None, kind: str | None) -> PlannedRoom:
    from mocapella.studies.planner.planned_room import PlannedSensors, read_room

    found = read_room(path)
    count = found.sensor.count if sensors is None else sensors
    if kind is not None:  # the optics that the file gives are another kind's
        return dataclasses.replace(found, sensor=PlannedSensors(kind, count))
    return dataclasses.replace(found, sensor=dataclasses.replace(found.sensor, count=count))


def _simulated(
    views: RoomViews, rows: list[ComparedPlacement], seeds: list[int], tell: Any
) -> tuple[dict[str, Any], list[str]] | None:
    """The agreement with the simulation for JSON and in words; None without seeds."""
    if not seeds:
        return None
    import msgspec

    from mocapella.studies.planner.placement_table import simulated_rows
    from mocapella.studies.planner.plan_files import summary_lines
    from mocapella.studies.planner.simulated_check import check_placements, summarise

    chosen = simulated_rows(rows)
    summary = summarise(check_placements(views, [score for _, score in chosen], seeds, tell))
    made = {"seeds": seeds, "placements": [name for name, _ in chosen], **msgspec.to_builtins(summary)}
    return made, summary_lines(summary)


def _check_folder(folder: Path) -> None:
    """Check, before the work, that the files can be written."""
    from mocapella.evaluation.plots import check_plot

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"--out {folder}: {error.strerror}; name a folder that can be made") from error
    for name in FILES:
        if (folder / name).is_dir():
            raise SettingsError(f"--out {folder}: {name} is a folder there; name another folder")
    check_plot(folder / "plan.png")


def _write(folder: Path, views: RoomViews, best: PlacementScore, lines: list[str]) -> None:
    from mocapella.model.whole_file import write_whole
    from mocapella.studies.planner.plan_files import layout_json, scene_toml
    from mocapella.studies.planner.plan_maps import draw_maps

    text, png, svg, scene, layout = (folder / name for name in FILES)
    write_whole(text, ("\n".join(lines) + "\n").encode())
    write_whole(scene, scene_toml(views, best))
    write_whole(layout, layout_json(views, best))
    draw_maps(views, best, (png, svg))
