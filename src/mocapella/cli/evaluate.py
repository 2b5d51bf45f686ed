"""``mocapella lab evaluate``: score tracking methods on recordings of real people and in simulated rooms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import (
    JsonOut,
    Participants,
    Plot,
    StudyFolder,
    console,
    need_cameras,
    participant_numbers,
    say,
    write_json,
)

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
Methods = Annotated[
    str,
    typer.Option(
        "--methods",
        metavar="NAME,NAME,…",
        help="Tracking methods; settings of one follow a colon, as in default:people.smoothing=kalman.",
    ),
]
Scenes = Annotated[
    str | None,
    typer.Option("--scenes", metavar="NAME,NAME,…", help="Simulated scenes; all by default, `help` lists them."),
]
Recordings = Annotated[
    Path | None,
    typer.Option("--data", metavar="DIR", help="Folder of the recordings, which are scored, too.", show_default=False),
]
Seeds = Annotated[str, typer.Option("--seeds", metavar="N,N,…", help="Seeds of the simulation.")]
_PLACEMENTS = ("parallel", "45", "90")


@evaluate_app.command()
def kinectmultitrack(
    folder: StudyFolder,
    methods: Methods = "stand-still",
    participants: Participants = None,
    json: JsonOut = None,
) -> None:
    """Score tracking methods on the real logs of 2015: how far the two sensors' views of a person lie apart.

    docs/evaluation.md says how everything is scored. Exit status 1 says that a row fails, and the table why.

    Example:  mocapella lab evaluate kinectmultitrack shared/data/kinectmultitrack --methods stand-still --json out.json
    """
    from mocapella.evaluation.kinectmultitrack import evaluate
    from mocapella.evaluation.study_tables import rounded

    chosen = split_names(methods)
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


_JOINTS = {
    "fused_cm": "fused\ncm",
    "fused_labels_aside_cm": "labels\naside cm",
    "best_sensor_cm": "best\nsensor cm",
    "fused_of_best_sensor_percent": "fused\nof it %",
    "hidden_of_sensor_percent": "hidden\n%",
    "inferred_cm": "inferred\ncm",
    "wrong_left_right_percent": "L/R\n%",
}
_WHO_AND_WHERE = {
    "identity_switches": "switches",
    "lost_people": "lost",
    "hota": "HOTA",
    "idf1": "IDF1",
    "calibration_mm": "layout\nmm",
    "calibration_deg": "\n°",
    "calibration_end_mm": "end\nmm",
    "calibration_end_deg": "\n°",
    "time_offset_ms": "offset\nms",
}


@evaluate_app.command()
def simulation(
    methods: Methods = "stand-still,default",
    scenes: Scenes = None,
    seeds: Seeds = "0,1,2",
    json: JsonOut = None,
) -> None:
    """Score tracking methods against exact truth, in simulated rooms with the measured errors of real sensors.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella lab evaluate simulation --methods default --scenes crossing,leaving --seeds 0 --json out.json
    """
    from mocapella.evaluation.simulation import evaluate, scene_summaries
    from mocapella.evaluation.study_tables import rounded

    if scenes == "help":
        show_scenes(scene_summaries())
        return
    with console.status("making rooms …") as status:
        result = evaluate(
            split_names(methods),
            None if scenes is None else split_names(scenes),
            participant_numbers(seeds, "--seeds") or [],
            lambda text: status.update(f"scoring {text} …"),
        )
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show_simulation(result, Console())


_HANDS: Final = {
    "found_percent": "found\n%",
    "false_percent": "else-\nwhere %",
    "centre_px_median": "centre\npx",
    "marker_mm_median": "tips\nmm",
    "marker_mm_p95": "95 %",
    "marker_lost_percent": "lost\n%",
    "tip_mm_median": "of hand\nmm",
    "tip_mm_p95": "95 %",
    "landmark_mm_median": "all 21\nmm",
    "depth_percent_mean": "depth\n%",
    "angle_deg_median": "angles\n°",
    "jitter_mm": "jitter\nmm",
}


def _hands_keys(_context: typer.Context) -> Iterator[str]:
    from mocapella.tracker.method import METHODS

    yield from lines_of_dataclass(METHODS.find("hands").settings, "Settings of the method hands:")


@evaluate_app.command()
def hands(
    scenes: Scenes = None,
    seeds: Seeds = "0,1",
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, _hands_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Score the method hands against exact truth: rendered hands before rendered cameras.

    docs/hands.md says how everything is scored.

    Example:  mocapella lab evaluate hands --scenes wide,thesis --seeds 0 --json out.json
    """
    from mocapella.evaluation.hands import evaluate
    from mocapella.evaluation.study_tables import rounded
    from mocapella.evaluation.tagged import evaluate_tag
    from mocapella.sources.simulate.hand_scene import hand_scene_names

    if scenes == "help":
        typer.echo("\n".join(name for name in hand_scene_names() if name != "demo"))
        return
    with console.status("rendering …") as status:
        result = evaluate(
            None if scenes is None else split_names(scenes),
            participant_numbers(seeds, "--seeds") or [],
            read_settings(NoKeys, settings_file, settings)[1],
            lambda text: status.update(f"rendering {text} …"),
        )
        tell = lambda text: status.update(f"rendering {text} …")  # noqa: E731
        result["tag"] = evaluate_tag(list(result["scenes"]), result["seeds"], tell)
    result = rounded(result)
    write_json(json, result)
    if json == "-":
        return
    table = Table(title=f"hands  seeds {seeds} together", title_justify="left", box=SIMPLE_HEAD, padding=0)
    table.add_column("")
    for heading in _HANDS.values():
        table.add_column(heading, justify="right")
    for name, scores in result["scenes"].items():
        table.add_row(name, *(f"{scores['all'][key]:.2f}" for key in _HANDS))
    out = Console()
    out.print(table)
    out.print("tips: the painted fingertips in space; of hand: of the fitted hand; jitter: of its tips' error")
    out.print("about its mean; all with one marker on the hand's base")
    if result["tag"]:
        table = Table(title="a tag of 40 mm", title_justify="left", box=SIMPLE_HEAD, padding=0)
        for heading in ("", "mm", "95 %", "°", "95 %", "tracked %", "lost %"):
            table.add_column(heading, justify="right" if heading else "left")
        for name, scores in result["tag"].items():
            table.add_row(name, *(f"{value:.2f}" for value in scores.values()))
        out.print(table)


@evaluate_app.command("line-skeleton-grid")
def line_skeleton_grid(
    scenes: Scenes = None,
    seeds: Seeds = "100,101,102,103",
    depth_sensor: Annotated[
        str, typer.Option(metavar="MODEL", help="Simulated depth camera: kinect, sr305, tof or exact.")
    ] = "kinect",
    plot: Plot = None,
    json: JsonOut = None,
) -> None:
    """Measure time and accuracy of the detector line-skeleton by its grid: 1, 2, 4, 5, 8 and 10 pixels.

    docs/arms/line-skeleton.md defines the counts.

    Example:  mocapella lab evaluate line-skeleton-grid --plot grid.png --json grid.json
    """
    need_cameras("lab evaluate line-skeleton-grid")
    import time

    import msgspec

    from mocapella.evaluation.line_skeleton_grid import SCENES, grid_table, plot_grid, rendered_frames
    from mocapella.sources.simulate.depth_scene import depth_scene_names

    if scenes == "help":
        typer.echo("\n".join(depth_scene_names()))
        return
    numbers = participant_numbers(seeds, "--seeds") or []
    camera, frames = rendered_frames(SCENES if scenes is None else split_names(scenes), numbers, depth_sensor)
    with console.status("rendering arms, and looking at each with six grids …"):
        rows = grid_table(frames, camera, time.perf_counter)
    write_json(json, {"sensor": depth_sensor, "seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        plot_grid(rows, plot)
        say(f"plot in {plot}")
    if json == "-":
        return
    title = f"line-skeleton, {rows[0].frames} images of rendered right arms"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for heading in ("grid px", "ms", "95 %", "elbow, wrist, palm mm", "tips found %", "of these mm"):
        table.add_column(heading, justify="right")
    for row in rows:
        cells = (row.median_ms, row.p95_ms, row.arm_mm, 100 * row.tips_found, row.tips_mm)
        table.add_row(str(row.grid_px), *(f"{value:.1f}" for value in cells))
    Console().print(table)


def show_scenes(summaries: Mapping[str, str]) -> None:
    """Print the names of scenes with their summaries, for ``--scenes help``."""
    width = max(map(len, summaries)) + 2
    typer.echo("\n".join(f"{name:<{width}}{what}" for name, what in summaries.items()))


def split_names(text: str) -> list[str]:
    """Return the names of a list with commas, each once."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def scene_table(scenes: Mapping[str, Any], columns: Mapping[str, str], empty: Table) -> Table:
    """Fill a table with the mean figures of scenes, a row for each.

    Args:
        scenes: for each scene the means over the seeds, ``mean``.
        columns: heading of each figure.
        empty: the table, without columns.
    """
    for words in ("", *columns.values()):
        empty.add_column(words, justify="right" if words else "left", no_wrap=True)
    for name, of in scenes.items():
        empty.add_row(name, *(figure_text(of["mean"][figure]) for figure in columns))
    return empty


def show_simulation(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.simulation.evaluate` as tables."""
    for method, scored in result["methods"].items():
        out.print(f"\n[bold]{method}[/bold]  mean of seeds {', '.join(map(str, result['seeds']))}", highlight=False)
        for columns in (_JOINTS, _WHO_AND_WHERE):
            out.print(scene_table(scored["scenes"], columns, Table(box=SIMPLE_HEAD, padding=0, show_edge=False)))
        for figure, worst in scored["worst"].items():
            target = result["targets"][figure]
            judged = {True: "met", False: "[red]not met[/red]", None: "not known"}[worst["met"]]
            sign = "≥" if target["over_scenes"] == "least" else "≤"
            where = "all runs" if target["over_scenes"] == "sum" else worst["scene"] or "no scene"
            out.print(
                f"  {figure}: {figure_text(worst['value'])} ({where}; {sign} {target['limit']:g}) {judged}",
                highlight=False,
            )
    out.print(
        "labels aside: as if left and right were right; of it: of the best sensor's\n"
        "error; hidden: of a sensor's error, joints that it infers; layout: worst sensor,\n"
        "after 8 s of shared walking, and at the end",
        highlight=False,
    )


def failures(result: dict[str, Any]) -> list[str]:
    """Return a line for each row of the tables that has a problem and so fails, with the problem; empty without any.

    ``result`` is that of `mocapella.evaluation.kinectmultitrack.evaluate`.
    """
    return [
        f"{method}: {task} {placement} fails: {row['problem']}"
        for method, scored in result["methods"].items()
        for task, rows in scored["tasks"].items()
        for placement, row in rows.items()
        if row["problem"]
    ]


def show(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.kinectmultitrack.evaluate` as tables."""
    for method, scored in result["methods"].items():
        out.print(f"\n[bold]{method}[/bold]  {scored['scored']}", highlight=False)
        out.print(_tasks(scored["tasks"]))
        out.print("Std: of Δd over the joints; raw: Δd with the sensors' labels; worst: participant", highlight=False)
        for placement, yaw in sorted(scored["yaw_deg"].items(), key=_order):
            sessions = f"{yaw['sessions']} session" + ("" if yaw["sessions"] == 1 else "s")
            spread = "" if yaw["sd"] is None else f" ± {yaw['sd']:.2f}"
            out.print(
                f"yaw between the sensors, {placement}: {figure_text(yaw['mean'])}{spread}°, {sessions}",
                highlight=False,
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
            table.add_row(f"  {placement}", *map(figure_text, figures), str(row["pairs"]), style=style)
    return table


def _show_interactions(interactions: dict[str, Any], out: Console) -> None:
    if "files" not in interactions:
        return
    median, mean, p95 = (figure_text(interactions[name]) for name in ("median_cm", "mean_cm", "p95_cm"))
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
        table.add_row(words, *(figure_text(figures.get(key)) for figures in columns.values()))
    return table


def figure_text(value: float | None) -> str:
    """Return a figure as the text of a table's cell; a dash if it is unknown."""
    return "–" if value is None else f"{value:.2f}"


@evaluate_app.command()
def charuco(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the four webcams' recording.")],
    json: JsonOut = None,
) -> None:
    """Calibrate real webcams on the odd frames of a board's videos, and score the even ones by its true distances.

    docs/cameras.md says how everything is scored.

    Example:  mocapella lab evaluate charuco shared/data/charuco_4cam --json out.json
    """
    need_cameras("lab evaluate charuco")
    from mocapella.evaluation.charuco import evaluate
    from mocapella.evaluation.study_tables import rounded

    with console.status("reading …") as status:
        result = rounded(evaluate(folder, lambda text: status.update(f"{text} …")))
    write_json(json, result)
    if json != "-":
        show_charuco(result, Console())


def show_charuco(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.charuco.evaluate` as a table, and whether each target is met."""
    table = Table(title="even frames, corner by corner", title_justify="left", box=SIMPLE_HEAD, padding=0)
    rows = {
        "points": "corners",
        "distances": "distances",
        "distance_rms_mm": "distance RMSE mm",
        "distance_median_mm": "distance median mm",
        "scale_percent": "scale %",
        "reprojection_median_px": "reprojection median px",
        "reprojection_rms_px": "reprojection RMS px",
    }
    for words in ("", "odd frames", "recording's own"):
        table.add_column(words, justify="right" if words else "left")
    for key, words in rows.items():
        table.add_row(words, *(f"{result['scored'][who][key]:g}" for who in ("ours", "reference")))
    out.print(table)
    for name, target in result["targets"].items():
        judged = "met" if target["met"] else "[red]not met[/red]"
        out.print(f"  {rows[name]} ≤ {target['limit']:g}: {judged}", highlight=False)
