"""``mocapella lab evaluate webcams``: score the method webcams on simulated crowds and on recordings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Scenes, Seeds, _cell, _names

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


def _webcams_keys(_context: typer.Context) -> Iterator[str]:
    from mocapella.tracker.webcams_settings import WebcamsSettings

    yield from lines_of_dataclass(WebcamsSettings, "Settings of the method webcams:")


@evaluate_app.command("webcams")
def webcams(
    scenes: Scenes = None,
    seeds: Seeds = "0",
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder of the recordings; score their people, too.")
    ] = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, _webcams_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Score the method webcams: simulated crowds against exact truth, recordings against their authors' results.

    docs/evaluation.md says how everything is scored. A number after a scene's name is that of its cameras: six-walk/8.

    Example:  mocapella lab evaluate webcams --scenes six-walk,crossing --seeds 0,1 --json out.json
    """
    from mocapella.evaluation.study_tables import rounded
    from mocapella.evaluation.webcams import evaluate
    from mocapella.sources.simulate.crowd import crowd_summaries

    if scenes == "help":
        known = crowd_summaries()
        width = max(map(len, known)) + 2
        typer.echo("\n".join(f"{name:<{width}}{what}" for name, what in known.items()))
        return
    chosen = read_settings(NoKeys, settings_file, settings)[1]
    with console.status("making rooms …") as status:
        result = evaluate(
            None if scenes is None else _names(scenes), participant_numbers(seeds, "--seeds") or [], chosen, data,
            lambda text: status.update(f"scoring {text} …"),
        )  # fmt: skip
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show_webcams(result, Console())


def show_webcams(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.webcams.evaluate` as tables."""
    if result["scenes"]:
        seeds = ", ".join(map(str, result["seeds"]))
        for columns in (_WHO, _WHERE):
            title = f"mean of seeds {seeds}" if columns is _WHO else None
            table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            for words in ("", *columns.values()):
                table.add_column(words, justify="right" if words else "left", no_wrap=True)
            for name, of in result["scenes"].items():
                table.add_row(name, *(_cell(of["mean"][figure]) for figure in columns))
            out.print(table)
        out.print(
            "visible: joints that two cameras see; all: also others; false: measured joints\n"
            "more than 50 mm off; error / sd: of measured joints, 1 is consistent; switches: sum",
            highlight=False,
        )
    if result["clips"]:
        table = Table(
            title="recordings, against the authors' results", title_justify="left", box=SIMPLE_HEAD, padding=0
        )
        for words in ("", "present\n%", "median\nmm", "95 %\nmm", "ids\n", "others\n%", "measured\n%"):
            table.add_column(words, justify="right" if words else "left", no_wrap=True)
        for name, clip in result["clips"].items():
            for k, person in enumerate(clip["people"], 1):
                figures = [person[key] for key in ("present_percent", "median_mm", "p95_mm")]
                shared = [clip["others_percent"], clip["measured_percent"]] if k == 1 else []
                cells = [*map(_cell, figures), str(person["ids"]), *map(_cell, shared)]
                table.add_row(f"{name} {k}", *cells)
        out.print(table)
    for name, target in result["targets"].items():
        sign = "≥" if target["kind"] == "least" else "≤"
        verdict = "met" if target["met"] else "[red]not met[/red]"
        out.print(f"  {name}: {_cell(target['value'])} ({sign} {target['limit']:g}) {verdict}", highlight=False)
