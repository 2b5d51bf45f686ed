"""``mocapella lab evaluate webcams``: score the method webcams on simulated crowds and on recordings."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Annotated, Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Recordings, Scenes, Seeds, figure_text, scene_table, show_scenes, split_names
from mocapella.cli.keypoint_options import KeypointDetectorName, opened_detector
from mocapella.errors import SettingsError

_WHO: Final = {
    "hota": "HOTA",
    "switches": "switches",
    "found_percent": "found\n%",
    "phantoms_percent": "phantoms\n%",
    "pcp_percent": "PCP\n%",
}
_WHERE: Final = {
    "visible_mm": "visible\nmm",
    "all_mm": "all\nmm",
    "p95_mm": "95 %\nmm",
    "measured_percent": "measured\n%",
    "false_percent": "false\n%",
    "normalised": "error\n/ sd",
}
_CAUSES: Final = {
    "pcp_percent": "correct limbs, by run [%]",
    "actors_percent": "correct limbs of the method, by person [%]",
    "parts_percent": "correct limbs of the method, by part [%]",
    "found_percent": "expected people who are found [%]",
    "precision_percent": "found people who are true [%]",
    "causes_percent": "missed limbs of the method, by cause [% of all limbs]",
    "parts_causes_percent": "missed limbs of the method, by part and cause [% of the part's limbs]",
    "actors_causes_percent": "missed limbs of the method, by person and cause [% of the person's limbs]",
}


def webcams_keys(_context: typer.Context) -> Iterator[str]:
    """Yield the lines of ``--set help``: the settings of the method webcams."""
    from mocapella.tracker.webcams_settings import WebcamsSettings

    yield from lines_of_dataclass(WebcamsSettings, "Settings of the method webcams:")


@evaluate_app.command("webcams")
def webcams(
    scenes: Scenes = None,
    seeds: Seeds = "0",
    data: Recordings = None,
    detector: KeypointDetectorName = None,
    causes: Annotated[
        bool, typer.Option("--causes", help="Print oracles and why limbs are missed, instead of scores.")
    ] = False,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, webcams_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Score the method webcams: simulated crowds against exact truth, recordings against their authors' results.

    With --data and --detector, also the people whom a detector finds in the recordings' films. With --causes, oracles
    that know who is who track simulated crowds, too, and each missed limb has a cause.

    docs/evaluation.md says how everything is scored. A number after a scene's name is that of its cameras: six-walk/8.

    Example:  mocapella lab evaluate webcams --scenes six-walk,crossing --seeds 0,1 --json out.json
    """
    from mocapella.evaluation.study_tables import rounded
    from mocapella.evaluation.webcams import evaluate
    from mocapella.sources.simulate.crowd import crowd_summaries

    if scenes == "help":
        show_scenes(crowd_summaries())
        return
    chosen = read_settings(NoKeys, settings_file, settings)[1]
    if causes:
        tell_causes(scenes, seeds, chosen, json)
        return
    finds = None
    if detector is not None:
        from mocapella.evaluation.keypoint_films import evaluate_films

        if data is None:
            raise SettingsError("--detector is of the films of recordings; name their folder with --data, too")
        finds = partial(opened_detector, "lab evaluate webcams", detector, None, {})
        finds()  # report missing parts before minutes of other scores
    with console.status("making rooms …") as status:
        result = evaluate(
            None if scenes is None else split_names(scenes), participant_numbers(seeds, "--seeds") or [], chosen, data,
            lambda text: status.update(f"scoring {text} …"),
        )  # fmt: skip
        if finds is not None and data is not None:
            result["films"], targets = evaluate_films(
                data, finds, chosen, lambda text: status.update(f"scoring {text} …")
            )
            result["targets"] |= targets
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show_webcams(result, Console())


def tell_causes(scenes: str | None, seeds: str, settings: dict[str, Any], json: str | None) -> None:
    """Run `mocapella.evaluation.webcam_causes.evaluate_causes`, and print or write its result."""
    from mocapella.evaluation.study_tables import rounded
    from mocapella.evaluation.webcam_causes import evaluate_causes

    names = None if scenes is None else split_names(scenes)
    with console.status("making rooms …") as status:
        result = evaluate_causes(
            names, participant_numbers(seeds, "--seeds") or [], settings,
            lambda text: status.update(f"scoring {text} …"),
        )  # fmt: skip
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show_causes(result, Console())


def show_causes(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.webcam_causes.evaluate_causes` as tables, a row for each seed."""
    for key, title in _CAUSES.items():
        rows = [
            (f"{name} {seed}{more}", figures)
            for name, runs in result["causes"].items()
            for seed, one in zip(result["seeds"], runs, strict=True)
            for more, figures in _rows(_figures(one[key]))
        ]
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for words in ("", *max((figures for _, figures in rows), key=len)):
            table.add_column(words.replace(" ", "\n"), justify="right" if words else "left", no_wrap=True)
        for name, figures in rows:
            table.add_row(name, *map(figure_text, figures.values()))
        out.print(table)


def _rows(figures: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Rows of figures: one, or one for each part or person, with its name."""
    if all(isinstance(value, dict) for value in figures.values()):
        return [(f", {name}", value) for name, value in figures.items()]
    return [("", figures)]


def _figures(values: Any) -> dict[str, Any]:
    """Figures by their names: of people by their numbers, and a single one alone."""
    if isinstance(values, dict):
        return values
    return {str(k): value for k, value in enumerate(values, 1)} if isinstance(values, list) else {"people": values}


def show_webcams(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.webcams.evaluate` as tables."""
    if result["scenes"]:
        seeds = ", ".join(map(str, result["seeds"]))
        for columns in (_WHO, _WHERE):
            title = f"mean of seeds {seeds}" if columns is _WHO else None
            empty = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            out.print(scene_table(result["scenes"], columns, empty))
        out.print(
            "visible: joints that two cameras see; all: also others; false: measured joints\n"
            "more than 50 mm off; error / sd: of measured joints, 1 is consistent; switches: sum",
            highlight=False,
        )
    if result["clips"]:
        table = _people_table("recordings, against the authors' results")
        for name, clip in result["clips"].items():
            _add_people(table, name, clip, numbered=True)
        out.print(table)
    for name, films in result.get("films", {}).items():
        show_films(name, films, out)
    for name, target in result["targets"].items():
        sign = "≥" if target["kind"] == "least" else "≤"
        verdict = "met" if target["met"] else "[red]not met[/red]"
        out.print(f"  {name}: {figure_text(target['value'])} ({sign} {target['limit']:g}) {verdict}", highlight=False)


def show_films(name: str, films: dict[str, Any], out: Console) -> None:
    """Print the figures of a clip's films, `mocapella.evaluation.keypoint_films.FilmFigures`, as a table."""
    table = _people_table(f"films of {name}")
    for key, words in (("as_is", "as numbered"), ("aligned", "same image")):
        _add_people(table, words, films[key])
    out.print(table)
    out.print(
        f"lag behind the images: of the recording's own keypoints {figure_text(films['reference_lag_frames'])}, "
        f"of the detector's {figure_text(films['detector_lag_frames'])} frames",
        highlight=False,
    )


def _people_table(title: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for words in ("", "present\n%", "median\nmm", "95 %\nmm", "ids\n", "others\n%", "measured\n%"):
        table.add_column(words, justify="right" if words else "left", no_wrap=True)
    return table


def _add_people(table: Table, name: str, clip: dict[str, Any], *, numbered: bool = False) -> None:
    """Add a row for each person of a clip; the figures of all people together are in the first one."""
    for k, person in enumerate(clip["people"], 1):
        figures = [person[key] for key in ("present_percent", "median_mm", "p95_mm")]
        shared = [clip["others_percent"], clip["measured_percent"]] if k == 1 else []
        cells = [*map(figure_text, figures), str(person["ids"]), *map(figure_text, shared)]
        table.add_row(f"{name} {k}" if numbered else name, *cells)
