"""``mocapella lab depth``: correction of the depth of two parallel cameras."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import depth_app
from mocapella.cli.common import JsonOut, Plot, say, write_json

if TYPE_CHECKING:
    from mocapella.geometry.parallel_pair import DistanceTable


@depth_app.callback()
def _depth() -> None:
    # Keeps `fit` a verb: without it typer takes a group's only command for the group itself.
    pass


@depth_app.command("fit")
def fit(
    measured: Annotated[
        Path, typer.Argument(metavar="MEASURED.csv", help="Columns distance_cm and disparity_px, a row a distance.")
    ],
    baseline_cm: Annotated[float, typer.Option(metavar="CM", help="Distance between the two cameras.")],
    width_px: Annotated[float, typer.Option(metavar="PX", help="Image width.")] = 640.0,
    view_angle: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="Horizontal angle of view; by default the one that fits best."),
    ] = None,
    plot: Plot = None,
    json: JsonOut = None,
) -> None:
    """Fit D = k·x^z, which corrects the depth of two parallel cameras, to distances measured with a ruler.

    Disparity is the right picture's column minus the left one's. docs/triangulation.md describes method and file.

    Example:  mocapella lab depth fit measured.csv --baseline-cm 7.5 --view-angle 62.2
    """
    from mocapella.geometry.parallel_pair import ParallelPair, distance_table, view_angle_of
    from mocapella.recording.measured_distances import read_measured_distances
    from mocapella.settings import check

    check(0 < baseline_cm < 1e5, "--baseline-cm", baseline_cm, "above 0 cm")
    check(0 < width_px < 1e6, "--width-px", width_px, "above 0 px")
    depth_m, disparity_px = read_measured_distances(measured)
    angle = (
        view_angle_of(depth_m, disparity_px, baseline_cm / 100, width_px)
        if view_angle is None
        else math.radians(view_angle)
    )
    table = distance_table(depth_m, disparity_px, ParallelPair(baseline_cm / 100, width_px, angle))
    result = {
        "k_cm": table.law.k_cm,
        "z": table.law.z,
        "view_angle_deg": math.degrees(angle),
        "mean_error_uncorrected_percent": 100 * table.mean_error,
        "mean_error_corrected_percent": 100 * table.corrected_mean_error,
        "rows": [dict(zip(_ROW, map(float, row), strict=True)) for row in table.rows_cm()],
    }
    write_json(json, result)
    if json != "-":
        _show(table, result, Console(highlight=False))
    if plot is not None:
        _plot(table, plot)


_ROW = ("distance_cm", "disparity_px", "calculated_cm", "corrected_cm", "expected_error_cm")


def _show(table: DistanceTable, result: dict[str, Any], out: Console) -> None:
    out.print(f"k = {table.law.k_cm:.1f} cm, z = {table.law.z:.4f}, view angle {result['view_angle_deg']:.1f}°")
    printed = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in ("distance cm", "disparity px", "calculated cm", "%", "corrected cm", "%", "ΔD of 1 px cm"):
        printed.add_column(words, justify="right")
    for distance, disparity, calculated, corrected, expected in table.rows_cm():
        off, left = (100 * abs(value - distance) / distance for value in (calculated, corrected))
        cells = (distance, disparity, calculated, off, corrected, left, expected)
        digits = (1, 1, 3, 2, 3, 2, 2)
        printed.add_row(*(f"{value:.{n}f}" for value, n in zip(cells, digits, strict=True)))
    out.print(printed)
    out.print(f"mean error {100 * table.mean_error:.2f} %, corrected {100 * table.corrected_mean_error:.2f} %")


def _plot(table: DistanceTable, path: Path) -> None:
    from mocapella.evaluation.plots import new_figure, save_figure

    rows = table.rows_cm()
    axes = (figure := new_figure(path, 6, 4)).subplots()
    axes.loglog(rows[:, 1], rows[:, 0], "k.", label="measured")
    axes.loglog(rows[:, 1], rows[:, 2], "--", label="calculated")
    axes.loglog(rows[:, 1], rows[:, 3], "-", label=f"{table.law.k_cm:.1f}·x^{table.law.z:.4f}")
    axes.set(xlabel="disparity [px]", ylabel="distance [cm]")
    axes.legend()
    save_figure(figure, path)
    say(f"plot in {path}")
