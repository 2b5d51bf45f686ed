"""``mocapella lab evaluate silhouettes-wrong-frame``: the penalty on jitter in a knee bend with one wrong frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import SettingsFile
from mocapella.cli.common import JsonOut, Plot, console, participant_numbers, say, write_json
from mocapella.cli.evaluate import Seeds
from mocapella.cli.evaluate_silhouettes import Settings, method_settings


@evaluate_app.command("silhouettes-wrong-frame")
def wrong_frame(
    seeds: Seeds = "100",
    plot: Plot = None,
    settings_file: SettingsFile = None,
    settings: Settings = None,
    json: JsonOut = None,
) -> None:
    """Track a knee bend with one frame that is wrong in all cameras, with the penalty on jitter and without.

    Of legs alone and of a whole body. With --set rejection=none nothing else protects the body; by default the wrong
    images are left out. docs/methods/silhouettes.md describes the experiment.

    Example:  mocapella lab evaluate silhouettes-wrong-frame --set rejection=none --plot wrong-frame.png
    """
    import msgspec

    from mocapella.evaluation.silhouette_wrong_frame import plot_wrong_frame, run_wrong_frame

    numbers = participant_numbers(seeds, "--seeds") or []
    fit = method_settings(settings_file, settings)
    with console.status("rendering …") as status:
        rows, shown = run_wrong_frame(numbers, status.update, settings=fit)
    write_json(json, {"rejection": fit.rejection, "seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        plot_wrong_frame(shown, plot)
        say(f"plot in {plot}")
    if json != "-":
        show_wrong_frame(rows, fit.rejection, Console())


def show_wrong_frame(rows: Sequence[Any], rejection: str, out: Console) -> None:
    """Print the rows of `mocapella.evaluation.silhouette_wrong_frame.run_wrong_frame` as one table."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("", "before\n°", "at it\n°", "worst\n°", "\nframes", "end\n°", "left\nout"):
        table.add_column(heading, justify="right" if "\n" in heading else "left", no_wrap=True)
    before: tuple[Any, ...] = ()
    for row in rows:
        now = (row.body, row.where, row.seed)
        if now != before:
            where = "whole frame" if row.where == "everywhere" else "legs' part"
            table.add_row(f"[bold]{row.body}, {where} wrong, {row.seed}[/bold]")
        before = now
        table.add_row(
            f"  {row.wrong}, penalty {f'× {row.weight:g}' if row.weight else 'none'}", f"{row.before_deg:.1f}",
            f"{row.at_deg:.1f}", f"{row.most_deg:.1f}", str(row.disturbed), f"{row.late_deg:.1f}",
            "yes" if row.left_out else "",
        )  # fmt: skip
    out.print(table)
    out.print(f"image rejection: {rejection}. Mean joint error before the wrong frame, at it, the", highlight=False)
    out.print("largest from there on, and at the end; frames: more than 1° worse than without", highlight=False)
    out.print("the wrong frame; left out: image rejection found it in every camera", highlight=False)
