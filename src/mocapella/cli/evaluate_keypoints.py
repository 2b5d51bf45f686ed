"""``mocapella lab evaluate silhouettes-keypoints``: what keypoints add to the fit of silhouettes."""

from __future__ import annotations

from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Recordings, Scenes, Seeds, split_names
from mocapella.cli.evaluate_silhouettes import SceneSeconds


@evaluate_app.command("silhouettes-keypoints")
def silhouettes_keypoints(
    scenes: Scenes = None,
    seeds: Seeds = "100",
    data: Recordings = None,
    seconds: SceneSeconds = None,
    json: JsonOut = None,
) -> None:
    """Follow people with keypoints beside the silhouettes and without: seated among dark things, and in a recording.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella lab evaluate silhouettes-keypoints --scenes dark --seeds 100,101 --data recordings
    """
    from mocapella.evaluation.silhouette_seated import SEATED_SCENES
    from mocapella.evaluation.silhouettes_with_keypoints import evaluate
    from mocapella.evaluation.study_tables import rounded

    if scenes == "help":
        typer.echo("\n".join(SEATED_SCENES))
        return
    names = [*SEATED_SCENES] if scenes is None else split_names(scenes)
    with console.status("making rooms …") as status:
        found = evaluate(
            names, participant_numbers(seeds, "--seeds") or [], seconds, data,
            lambda text: status.update(f"following {text} …"),
        )  # fmt: skip
    found = rounded(found)
    write_json(json, found)
    if json != "-":
        show_keypoints(found, Console(highlight=False))


def show_keypoints(found: dict[str, Any], out: Console) -> None:
    """Print the figures of `evaluate` as one table for the scenes and one for the recordings."""
    for kind, rows in found.items():
        if not rows:
            continue
        table = Table(title=kind, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
        for heading in ("", "fit", "joint"):
            table.add_column(heading)
        for heading in ("overlap %", "median mm", "95 % mm", "worst mm", "unsupported %"):
            table.add_column(heading, justify="right")
        for name, of in rows.items():
            for given, figures in of.items():
                for joint, one in figures.items():
                    if isinstance(one, dict):
                        cells = (one["median_mm"], one["p95_mm"], one["worst_mm"], one["unsupported_percent"])
                        table.add_row(
                            name, given, joint, f"{figures['overlap_percent']:.1f}", *(f"{cell:.0f}" for cell in cells)
                        )
        out.print(table)
