"""``mocapella lab evaluate silhouettes-jitter-limit``: how much jitter a penalty could remove at best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import SettingsFile
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Seeds
from mocapella.cli.evaluate_silhouettes import SceneSeconds, Settings, method_settings


@evaluate_app.command("silhouettes-jitter-limit")
def jitter_limit(
    seeds: Seeds = "100",
    seconds: SceneSeconds = None,
    settings_file: SettingsFile = None,
    settings: Settings = None,
    json: JsonOut = None,
) -> None:
    """Compare the jitter that the penalty removes with the most that any linear filter of the same fits could.

    A runner is tracked in images with 15 % of random pixels. docs/evaluation.md describes the limits.

    Example:  mocapella lab evaluate silhouettes-jitter-limit --seeds 100,101,102
    """
    import msgspec

    from mocapella.evaluation.jitter_limit import run_jitter_limit

    numbers = participant_numbers(seeds, "--seeds") or []
    fit = method_settings(settings_file, settings)
    with console.status("rendering …") as status:
        rows = run_jitter_limit(numbers, tell=status.update, seconds=seconds, settings=fit)
    write_json(json, {"seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if json != "-":
        show_jitter_limit(rows, Console())


def show_jitter_limit(rows: Sequence[Any], out: Console) -> None:
    """Print the rows of `mocapella.evaluation.jitter_limit.run_jitter_limit` as one table."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("", "without\nm/s²", "with\nm/s²", "\nlowered", "limit,\nno lag", "\nlagging", "\nsmoothed"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for row in rows:
        lowered = (row.with_it, row.no_lag, row.lagging, row.smoothed)
        table.add_row(
            f"{row.scene} {row.seed}", f"{row.without:.1f}", f"{row.with_it:.1f}",
            *(f"{100 * (1 - one / row.without):.0f} %" for one in lowered),
        )  # fmt: skip
    out.print(table)
    out.print("jitter without the penalty and with it; by how much it is lowered, and how much", highlight=False)
    out.print("a linear filter could lower it at most: of past frames without lag behind a", highlight=False)
    out.print("constant velocity, of past frames with any lag, and of later frames, too", highlight=False)
