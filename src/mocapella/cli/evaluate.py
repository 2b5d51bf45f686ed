"""``mocapella evaluate``: how good tracking methods are, on recordings of real people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, Participants, console, participant_numbers, say, write_json

_FUSED = {
    "bone_length_variation_percent": "bone length variation %",
    "stationary_jitter_mm": "stationary jitter mm",
    "foot_slide_cm_s": "foot slide cm/s",
    "shoulder_collapse_percent": "shoulder collapse %",
    "facing_against_motion_percent": "facing against motion %",
    "steps_facing_wrong_percent": "Steps facing wrong %",
    "yaw_reversals_per_min": "yaw reversals /min",
    "label_flips_per_min": "label flips /min",
    "lag_ms": "lag ms",
}
_PLACEMENTS = ("parallel", "45", "90")


@evaluate_app.command()
def kinectmultitrack(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the KinectMultiTrack study logs.")],
    methods: Annotated[str, typer.Option(help="Tracking methods, with commas between them.")] = "stand-still",
    participants: Participants = None,
    json: JsonOut = None,
) -> None:
    """Score tracking methods on the real logs of 2015: how far the two sensors' views of a person lie apart.

    docs/evaluation.md says how everything is scored. Exit status 1 says that a row fails, and the table why.

    Example:  mocapella evaluate kinectmultitrack shared/data/kinectmultitrack --methods stand-still --json out.json
    """
    from mocapella.evaluation.kinectmultitrack import evaluate
    from mocapella.evaluation.study_tables import rounded

    chosen = list(dict.fromkeys(name.strip() for name in methods.split(",") if name.strip()))
    with console.status("reading …") as status:
        result = evaluate(
            folder,
            chosen,
            participant_numbers(participants),
            lambda text: status.update(f"scoring {text.replace('[', '(')} …"),
        )
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show(result, Console())
    problems = failures(result)
    for problem in problems:
        say(problem)
    if problems:
        raise typer.Exit(1)


def failures(result: dict[str, Any]) -> list[str]:
    """Every row that fails, and why."""
    return [
        f"{method}: {task} {placement} fails: {row['problem']}"
        for method, scored in result["methods"].items()
        for task, rows in scored["tasks"].items()
        for placement, row in rows.items()
        if row["problem"]
    ]


def show(result: dict[str, Any], out: Console) -> None:
    """The tables for a person."""
    for method, scored in result["methods"].items():
        out.print(f"\n[bold]{method}[/bold]  {scored['scored']}", highlight=False)
        out.print(_tasks(scored["tasks"]))
        out.print("Std: of Δd over the joints; raw: Δd with the sensors' labels; worst: participant", highlight=False)
        for placement, yaw in sorted(scored["yaw_deg"].items(), key=_order):
            sessions = f"{yaw['sessions']} session" + ("" if yaw["sessions"] == 1 else "s")
            spread = "" if yaw["sd"] is None else f" ± {yaw['sd']:.2f}"
            out.print(
                f"yaw between the sensors, {placement}: {_cell(yaw['mean'])}{spread}°, {sessions}", highlight=False
            )
        _show_interactions(scored["interactions"], out)
    out.print(_fused(result))


def _order(item: tuple[str, Any]) -> int:
    return _PLACEMENTS.index(item[0]) if item[0] in _PLACEMENTS else len(_PLACEMENTS)


def _tasks(tasks: dict[str, Any]) -> Table:
    table = Table(title="cm between the two views", title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    table.add_column("", no_wrap=True)
    for name in ("Δx", "Δy", "Δz", "Δd", "Std", "raw", "worst", "torso", "pairs"):
        table.add_column(name, justify="right", no_wrap=True)
    shown: list[Any] = []
    for task, placements in tasks.items():
        if placements in shown:  # a protocol that makes no difference to this method
            continue
        shown.append(placements)
        table.add_row(f"[bold]{task}[/bold]")
        for placement, row in sorted(placements.items(), key=_order):
            dd = row["dd_cm"]
            figures = [row[name]["mean"] for name in ("dx_cm", "dy_cm", "dz_cm", "dd_cm")]
            figures += [dd["std"], row["raw_labels"]["dd_cm"]["mean"], dd["worst_participant"]]
            figures += [row["torso_dd_cm"]["mean"]]
            style = "red" if row["problem"] else None
            table.add_row(f"  {placement}", *map(_cell, figures), str(row["pairs"]), style=style)
    return table


def _show_interactions(interactions: dict[str, Any], out: Console) -> None:
    if "files" not in interactions:
        return
    median, mean, p95 = (_cell(interactions[name]) for name in ("median_cm", "mean_cm", "p95_cm"))
    switches, missed, labels = (interactions[name] for name in ("identity_switches", "missed", "labels"))
    out.print(
        f"interactions: {switches} identity switches, {missed} of {labels} labelled places empty; "
        f"Δd of both people: median {median}, mean {mean}, p95 {p95} cm",
        highlight=False,
    )


def _fused(result: dict[str, Any]) -> Table:
    table = Table(title="fused skeleton: mean over sessions", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("")
    columns = {name: scored["fused"].get("all", {}) for name, scored in result["methods"].items()}
    columns["front sensor alone"] = result["front_sensor_alone"]["fused"].get("all", {})
    for name in columns:
        table.add_column(name, justify="right")
    for key, words in _FUSED.items():
        table.add_row(words, *(_cell(figures.get(key)) for figures in columns.values()))
    return table


def _cell(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
