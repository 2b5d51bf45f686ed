"""``mocapella lab evaluate hand-solvers``: compare the solvers of a hand's inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, Plot, console, participant_numbers, say, write_json
from mocapella.cli.evaluate import Scenes, Seeds, split_names

_HEADINGS: Final = (
    *("angles\n°", "95 %", "tips\nmm", "reached\n%", "within\n%", "jitter\nmm", "iter-\nations", "time\n× map"),
)


@evaluate_app.command("hand-solvers")
def hand_solvers(scenes: Scenes = None, seeds: Seeds = "0,1", plot: Plot = None, json: JsonOut = None) -> None:
    """Compare the solvers of the method hands (its setting solver) on simulated markers with exact truth.

    docs/methods/hand.md defines the figures.

    Example:  mocapella lab evaluate hand-solvers --plot solvers.png --json solvers.json
    """
    import time

    import msgspec

    from mocapella.evaluation.hand_solvers import SCENES, compare_solvers, plot_solvers

    if scenes == "help":
        typer.echo("\n".join(SCENES))
        return
    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("tracking …") as status:
        chosen = None if scenes is None else split_names(scenes)
        rows = compare_solvers(
            chosen, numbers, time.perf_counter, lambda text: status.update(f"tracking {text} with each solver …")
        )
    write_json(json, {"seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        plot_solvers(rows, plot)
        say(f"plot in {plot}")
    if json != "-":
        show_solvers(rows, Console())


def show_solvers(rows: Sequence[Any], out: Console) -> None:
    """Print the rows of `mocapella.evaluation.hand_solvers.compare_solvers` as one table."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("", *_HEADINGS):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    scene = ""
    for row in rows:
        if row.scene != scene:
            scene = row.scene
            table.add_row(f"[bold]{scene}[/bold]")
        iterations = "" if row.iterations is None else f"{row.iterations:.1f}"
        table.add_row(
            f"  {row.solver}", f"{row.angle_deg:.2f}", f"{row.angle_p95_deg:.2f}", f"{row.tip_mm:.2f}",
            f"{row.reached_percent:.1f}", f"{row.within_percent:.1f}", f"{row.jitter_mm:.2f}", iterations,
            f"{row.time_ratio:.2f}",
        )  # fmt: skip
    out.print(table)
    out.print("tips: from the true ones; reached: visible tips within 0.1 mm of their markers;", highlight=False)
    out.print("jitter: change of the landmarks' error from frame to frame; iterations: for a", highlight=False)
    out.print("digit; time: of a tracker's frame, which includes the fit of the palm", highlight=False)
