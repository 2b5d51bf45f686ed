"""``mocapella lab evaluate marker-…``: evaluate the detection of colour markers in rendered images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, Plot, console, participant_numbers, say, write_json
from mocapella.cli.evaluate import Scenes, Seeds, split_names
from mocapella.errors import SettingsError

Row = tuple[str, Callable[[Any], str]]
_WINDOW: Final[tuple[Row, ...]] = (
    ("scene", lambda row: row.scene),
    ("window\npx", lambda row: "none" if row.window_px is None else f"{row.window_px:g}"),
    ("time\nµs", lambda row: f"{row.time_us:.0f}"),
    ("× no\nwindow", lambda row: f"{row.time_ratio:.2f}"),
    ("whole\n%", lambda row: f"{row.whole_percent:.1f}"),
    ("found\n%", lambda row: f"{row.found_percent:.2f}"),
    ("error\npx", lambda row: _number(row.error_px, 3)),
    ("95 %\npx", lambda row: _number(row.error_p95_px, 3)),
    ("false\n%", lambda row: f"{row.false_percent:.2f}"),
)
_KIND: Final[tuple[Row, ...]] = (
    ("scene", lambda row: row.scene),
    ("kind", lambda row: row.kind),
    ("refused", lambda row: str(row.refused)),
    ("area\npx²", lambda row: _number(row.area_px, 0)),
    ("found\n%", lambda row: f"{row.found_percent:.2f}"),
    ("false\n%", lambda row: f"{row.false_percent:.2f}"),
    ("error\npx", lambda row: _number(row.error_px, 3)),
    ("95 %\npx", lambda row: _number(row.error_p95_px, 3)),
    ("jitter\npx", lambda row: _number(row.jitter_px, 3)),
)
_THRESHOLD: Final[tuple[Row, ...]] = (
    ("scene", lambda row: row.scene),
    ("skin\ngloss", lambda row: f"{row.skin_gloss:g}"),
    ("by", lambda row: row.how),
    ("width", lambda row: f"{row.width:g}"),
    ("markers\nkept %", lambda row: f"{row.kept_percent:.2f}"),
    ("skin\ntaken %", lambda row: f"{row.skin_percent:.3f}"),
    ("shining skin\ntaken %", lambda row: f"{row.shining_percent:.3f}"),
)
_JITTER: Final[tuple[Row, ...]] = (
    ("light", lambda row: row.light),
    ("kind", lambda row: row.kind),
    ("distance\nm", lambda row: f"{row.distance_m:g}"),
    ("found\n%", lambda row: f"{row.found_percent:.1f}"),
    ("jitter\npx", lambda row: _number(row.jitter_px, 3)),
    ("jitter\nmm", lambda row: _number(row.jitter_mm, 3)),
)


@evaluate_app.command("marker-windows")
def marker_windows(
    scenes: Scenes = None,
    seeds: Seeds = "0,1",
    sizes: Annotated[
        str | None, typer.Option("--sizes", metavar="PX,PX,…", help="Sides of the window [px]; 10 to 200 by default.")
    ] = None,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Frame rate [Hz].")] = 30.0,
    plot: Plot = None,
    json: JsonOut = None,
) -> None:
    """Compare sizes of the markers' search window (region of interest): time, markers found, errors of centres.

    docs/markers.md has the table.

    Example:  mocapella lab evaluate marker-windows --sizes 20,40,80 --plot windows.png
    """
    import time

    from mocapella.evaluation.marker_windows import SIZES_PX, compare_windows, plot_windows

    if _scenes_listed(scenes):
        return
    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("rendering …") as status:
        rows = compare_windows(
            _chosen(scenes), numbers, _numbers(sizes, "--sizes", SIZES_PX), time.perf_counter,
            tell=lambda text: status.update(f"rendering {text} …"), rate_hz=rate,
        )  # fmt: skip
    _finish(rows, _WINDOW, plot_windows, plot, json, numbers)


@evaluate_app.command("marker-kinds")
def marker_kinds(scenes: Scenes = None, seeds: Seeds = "0,1", plot: Plot = None, json: JsonOut = None) -> None:
    """Compare kinds of fingertip markers: painted, with a grey border, shrink tube, nail varnish.

    docs/markers.md has the table.

    Example:  mocapella lab evaluate marker-kinds --scenes desk --seeds 0 --plot kinds.png
    """
    from mocapella.evaluation.marker_kind_scores import compare_kinds, plot_kinds

    if _scenes_listed(scenes):
        return
    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("rendering …") as status:
        rows = compare_kinds(_chosen(scenes), numbers, lambda text: status.update(f"rendering {text} …"))
    _finish(rows, _KIND, plot_kinds, plot, json, numbers)


@evaluate_app.command("marker-thresholds")
def marker_thresholds(
    scenes: Scenes = None,
    seeds: Seeds = "0,1",
    gloss: Annotated[
        str | None,
        typer.Option("--gloss", metavar="X,X,…", help="Glosses of the skin, 0 (matt) to 2; 0,0.2,0.5,1 by default."),
    ] = None,
    plot: Plot = None,
    json: JsonOut = None,
) -> None:
    """Show how the width of colour thresholds keeps marker pixels and takes pixels of skin that reflects.

    docs/markers.md has the table.

    Example:  mocapella lab evaluate marker-thresholds --gloss 0,0.5 --plot thresholds.png
    """
    from mocapella.evaluation.marker_thresholds import GLOSSES, compare_thresholds, plot_thresholds

    if _scenes_listed(scenes):
        return
    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("rendering …") as status:
        rows = compare_thresholds(
            _chosen(scenes),
            _numbers(gloss, "--gloss", GLOSSES),
            numbers,
            lambda text: status.update(f"rendering {text} …"),
        )
    _finish(rows, _THRESHOLD, plot_thresholds, plot, json, numbers)


@evaluate_app.command("marker-jitter")
def marker_jitter(
    seeds: Seeds = "0,1",
    distances: Annotated[
        str | None,
        typer.Option("--distances", metavar="M,M,…", help="Distances of the hand [m]; 0.25 to 1.5 by default."),
    ] = None,
    plot: Plot = None,
    json: JsonOut = None,
) -> None:
    """Measure the static jitter of found centres, for each kind of marker, distance and light.

    docs/markers.md has the chart.

    Example:  mocapella lab evaluate marker-jitter --distances 0.5,1 --plot jitter.png
    """
    from mocapella.evaluation.marker_jitter import DISTANCES_M, measure_jitter, plot_jitter

    numbers = participant_numbers(seeds, "--seeds") or []
    with console.status("rendering …") as status:
        rows = measure_jitter(
            _numbers(distances, "--distances", DISTANCES_M), numbers, lambda text: status.update(f"rendering {text} …")
        )
    _finish(rows, _JITTER, plot_jitter, plot, json, numbers)


def show_rows(rows: Sequence[Any], columns: Sequence[Row], out: Console) -> None:
    """Print rows as a table; a value of the first column that repeats is left out."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading, _ in columns:
        words = heading in {"scene", "kind", "light", "by"}
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    before = ""
    for row in rows:
        first, *others = (text(row) for _, text in columns)
        table.add_row("" if first == before else first, *others)
        before = first
    out.print(table)


def _finish(
    rows: Sequence[Any], columns: Sequence[Row], draw: Callable[..., None], plot: Plot, json: JsonOut,
    seeds: Sequence[int],
) -> None:  # fmt: skip
    """Write the JSON and the plot that were asked for, and print the table."""
    import msgspec

    write_json(json, {"seeds": seeds, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        draw(rows, plot)
        say(f"plot in {plot}")
    if json != "-":
        show_rows(rows, columns, Console())


def _scenes_listed(scenes: str | None) -> bool:
    """Print the scenes' names if the option is ``help``."""
    from mocapella.sources.simulate.marker_scene import marker_scene_names

    if scenes == "help":
        typer.echo("\n".join(marker_scene_names()))
    return scenes == "help"


def _chosen(scenes: str | None) -> list[str] | None:
    return None if scenes is None else split_names(scenes)


def _numbers(text: str | None, option: str, default: Sequence[float]) -> Sequence[float]:
    """Return the numbers of an option, or the default if it is not given.

    Raises:
        SettingsError: a part is no number.
    """
    if text is None:
        return default
    found = []
    for part in text.split(","):
        try:
            found.append(float(part))
        except ValueError:
            raise SettingsError(f"{option}: {part.strip()!r} is no number; write numbers as in 0.5,1") from None
    return found


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
