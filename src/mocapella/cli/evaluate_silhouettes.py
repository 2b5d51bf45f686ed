"""``mocapella evaluate silhouettes-…``: what the penalty on jitter does to a body fitted to silhouettes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, console, participant_numbers, say, write_json

Seeds = Annotated[str, typer.Option(metavar="N,N,…", help="Of person, clothes, room, cameras and noise.")]
Bodies = Annotated[
    str,
    typer.Option(
        "--bodies",
        metavar="NAME,NAME,…",
        help="What is tracked with: the subject's own mesh, or one of the proportions measured in the first frame.",
    ),
]
FirstSeconds = Annotated[
    float | None, typer.Option("--seconds", metavar="SECONDS", min=0, help="Only so much of each scene.")
]
Plot = Annotated[Path | None, typer.Option(metavar="FILE", help="Draw it, where matplotlib is installed.")]
_SEEDS = "100"


@evaluate_app.command("silhouettes-knee-bend")
def knee_bend(
    seeds: Seeds = _SEEDS, bodies: Bodies = "own,measured", seconds: FirstSeconds = None, plot: Plot = None,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Measure what the penalty on jitter leaves of a knee bend: its peak, how late it comes, and the feet's jitter.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella evaluate silhouettes-knee-bend --plot knee-bend.png
    """
    _experiment("knee-bend", seeds, bodies, seconds, plot, json)


@evaluate_app.command("silhouettes-runner")
def runner(
    seeds: Seeds = _SEEDS, bodies: Bodies = "own,measured", seconds: FirstSeconds = None, plot: Plot = None,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Follow a runner in images with noise and random rectangles, with the penalty on jitter and without.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella evaluate silhouettes-runner --plot runner.png
    """
    _experiment("runner", seeds, bodies, seconds, plot, json)


@evaluate_app.command("silhouettes-acrobatics")
def acrobatics(
    seeds: Seeds = _SEEDS, bodies: Bodies = "own,measured", seconds: FirstSeconds = None, plot: Plot = None,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Follow a cartwheel and a flick-flack of which some frames are stored completely wrong.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella evaluate silhouettes-acrobatics --plot acrobatics.png
    """
    _experiment("acrobatics", seeds, bodies, seconds, plot, json)


@evaluate_app.command("silhouettes-weight")
def weight(
    seeds: Seeds = _SEEDS, bodies: Bodies = "own", seconds: FirstSeconds = None, plot: Plot = None,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Follow clean and noisy images with one and the same weight of the penalty on jitter, for many weights.

    docs/evaluation.md says how everything is scored.

    Example:  mocapella evaluate silhouettes-weight --plot weight.png
    """
    _experiment("weight", seeds, bodies, seconds, plot, json)


def _experiment(name: str, seeds: str, bodies: str, seconds: float | None, plot: Path | None, json: str | None) -> None:
    import msgspec

    from mocapella.cli.evaluate import _names
    from mocapella.evaluation.silhouette_experiments import EXPERIMENTS, plot_movements, plot_weights, run

    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("rendering …") as status:
        rows, shown = run(name, numbers, seconds, _names(bodies), status.update)
    write_json(json, {"experiment": name, "seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        if name == "weight":
            plot_weights(rows, plot)
        else:
            plot_movements(shown, EXPERIMENTS[name].hinges, plot)
        say(f"plot in {plot}")
    if json != "-":
        show_runs(rows, Console())


_HEADINGS = (
    *("scene", "body", "images", "penalty"),
    *("angles\n°", "sd\n°", "hinges\n°", "sd\n°", "marks\nmm", "95 %", "jitter\nm/s²", "feet\nm/s²", "true\nm/s²"),
    *("knees\nkept %", "late\nframes", "IoU\n%", "blind\nframes", ""),
)


def show_runs(rows: Any, out: Console) -> None:
    """The table for a person."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for k, heading in enumerate(_HEADINGS):
        table.add_column(heading, justify="right" if 3 <= k < len(_HEADINGS) - 1 else "left", no_wrap=True)
    for row in rows:
        s = row.score
        cells = (s.angle_deg, s.angle_sd_deg, s.hinge_deg, s.hinge_sd_deg, s.median_mm, s.p95_mm, s.jitter, s.feet,
                 s.true_feet, 100 * row.kept, row.lag, 100 * row.overlap)  # fmt: skip
        table.add_row(
            f"{row.scene} {row.seed}", row.body, row.images, f"× {row.weight:g}" if row.weight else "none",
            *(f"{cell:.1f}" for cell in cells), str(row.blind), "fails" if row.outcome.problem else "",
        )  # fmt: skip
    out.print(table)
    out.print("jitter: acceleration of the error, all landmarks; feet: of ankles and toes as such, beside the true one")
    for row in rows:
        if row.outcome.problem:
            penalty = f"penalty × {row.weight:g}" if row.weight else "no penalty"
            out.print(f"{row.scene} {row.seed}, {row.body} body, {row.images}, {penalty}: {row.outcome.problem}")
