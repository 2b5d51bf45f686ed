"""``mocapella lab evaluate rgbd``: joints from keypoints and depth images, in rendered rooms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Scenes, Seeds


@evaluate_app.command()
def rgbd(scenes: Scenes = None, seeds: Seeds = "100", json: JsonOut = None) -> None:
    """Score the joints that a depth camera with colour gives, in rendered rooms with a Kinect's noise.

    The detector is simulated. docs/sensors.md says how the joints are found.

    Example:  mocapella lab evaluate rgbd --scenes walk,sit --seeds 100,101
    """
    import msgspec
    import typer

    from mocapella.evaluation.rgbd_rooms import SCENES, score_rgbd
    from mocapella.evaluation.study_tables import rounded

    if scenes == "help":
        typer.echo("\n".join(SCENES))
        return
    names = SCENES if scenes is None else tuple(name.strip() for name in scenes.split(","))
    with console.status("rendering …") as status:
        rows = score_rgbd(names, participant_numbers(seeds, "--seeds") or [], tell=status.update)
    write_json(json, {"seeds": seeds, "rows": rounded(msgspec.to_builtins(rows))})
    if json != "-":
        show_rgbd(rows, Console())


def show_rgbd(rows: Sequence[Any], out: Console) -> None:
    """Print the rows of `mocapella.evaluation.rgbd_rooms.score_rgbd` as one table."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    headings = ("", "people", "found\n%", "tracked\n%", "median\nmm", "p95\nmm", "far\n%", "hidden\n%", "inferred\nmm")
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for row in rows:
        table.add_row(
            row.scene, str(row.people), f"{100 * row.found:.1f}", f"{100 * row.tracked:.1f}", f"{row.median_mm:.0f}",
            f"{row.p95_mm:.0f}", f"{100 * row.far:.1f}", f"{100 * row.hidden_tracked:.1f}", f"{row.inferred_mm:.0f}",
        )  # fmt: skip
    out.print(table)
    out.print("found: detected people with a body in space; tracked: of the joints in view;", highlight=False)
    out.print("median, p95: error of tracked joints; far: of these, above 0.2 m; hidden: joints", highlight=False)
    out.print("behind something that are tracked nevertheless; inferred: their median error", highlight=False)
