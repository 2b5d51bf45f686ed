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


_ACCURACY = ("angles\n°", "sd\n°", "hinges\n°", "sd\n°", "marks\nmm", "95 %", "IoU\n%")
_STEADINESS = ("jitter\nm/s²", "feet\nm/s²", "true\nm/s²", "knees\nkept %", "late\nframes", "blind\nframes")


def show_runs(rows: Any, out: Console) -> None:
    """The tables for a person."""
    for headings, figures_of in ((_ACCURACY, _accuracy), (_STEADINESS, _steadiness)):
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
        for heading in ("", "penalty", *headings):
            table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
        before, line = None, 0
        for row in rows:
            run = (row.scene, row.seed, row.body, row.images)
            before, line = run, line + 1 if run == before else 0
            words = (f"{row.scene} {row.seed}", f"  {row.images}, {row.body}")
            figures = ("–" if x is None else str(x) if isinstance(x, int) else f"{x:.1f}" for x in figures_of(row))
            table.add_row(words[line] if line < len(words) else "", _penalty(row.weight), *figures)
        out.print(table)
    out.print("marks: landmarks; jitter: acceleration of their error; feet: that of ankles and", highlight=False)
    out.print("toes as such, beside the true one; blind: frames in which no camera counted", highlight=False)
    for row in rows:
        if row.outcome.problem:
            what = f"{row.scene} {row.seed}, {row.images}, {row.body} body, penalty {_penalty(row.weight)}"
            out.print(f"{what}: {row.outcome.problem}", highlight=False)


def _accuracy(row: Any) -> tuple[float | None, ...]:
    s = row.score
    return s.angle_deg, s.angle_sd_deg, s.hinge_deg, s.hinge_sd_deg, s.median_mm, s.p95_mm, 100 * row.overlap


def _steadiness(row: Any) -> tuple[float | None, ...]:
    s, kept = row.score, None if row.kept is None else 100 * row.kept
    return s.jitter, s.feet, s.true_feet, kept, row.lag, row.blind


def _penalty(weight: float) -> str:
    return f"× {weight:g}" if weight else "none"
