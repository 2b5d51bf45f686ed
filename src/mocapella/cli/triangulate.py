"""``mocapella track points``: triangulate 2D points of several cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import track_app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import ORDER, OUT_HELP, RIG_HELP, UP_HELP, JsonOut, console, say, working, write_json
from mocapella.cli.pictures import Fps

if TYPE_CHECKING:
    from mocapella.fusion.point_tracks import TracksReport
    from mocapella.library.triangulation import TriangulatedPoints


@dataclass(frozen=True)
class PointsKeys:
    """Settings of `track points`."""

    sd_px: Annotated[float, KeySpec("Standard deviation of a certain detection; robust.", "px")] = 3.0
    least_confidence: Annotated[float, KeySpec("Use detections above this confidence.", "0 to 1")] = 0.3
    largest_error: Annotated[float, KeySpec("Largest mean reprojection error of a point; linear solvers.", "px")] = 15.0
    order: Annotated[str, ORDER] = "auto"


@track_app.command("points")
def triangulate(
    points: Annotated[
        list[Path],
        typer.Argument(metavar="POINTS…", help="A folder or file of keypoints for each camera, or one CSV of all."),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} A .csv or .trc.")],
    rig: Annotated[Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} By default rig.toml.")] = None,
    solver: Annotated[
        str, typer.Option(metavar="NAME", help="Triangulation: robust, weighted-linear or linear.")
    ] = "robust",
    up: Annotated[str, typer.Option("--up", metavar="AXIS", help=UP_HELP)] = "y",
    fps: Fps = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(PointsKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Triangulate 2D points, which any program found in the images of calibrated cameras, to points in space.

    Of several people in an image it takes the most confident; `mocapella triangulate` tracks all. docs/triangulation.md
    describes files, methods and axes.

    Example:  mocapella track points cam1_json cam2_json --rig rig.toml --fps 60 --out walk.trc
    """
    from mocapella.errors import SettingsError, one_of
    from mocapella.fusion.point_tracks import METHODS
    from mocapella.library.triangulation import triangulate as library_triangulate
    from mocapella.settings import check

    keys = read_keys(PointsKeys, settings_file, settings)
    check(solver in METHODS, "--solver", solver, f"one of {one_of(solver, METHODS)}")
    if out.suffix.lower() not in (".csv", ".trc"):
        raise SettingsError(f"--out {out}: end its name with .csv or .trc")
    with working("reading …", status=INTERRUPTED), console.status("reading …") as status:
        found = library_triangulate(
            points, rig or Path("rig.toml"), solver=solver, sd_px=keys.sd_px, least_confidence=keys.least_confidence,
            largest_error_px=keys.largest_error, order=keys.order, fps=fps,
            progress=lambda text: status.update(f"{text.replace('[', '(')} …"),
        )  # fmt: skip
        status.update(f"writing {out} …")
        found.save(out, up=up)
    tell_points(found, {"out": str(out), "method": solver}, json)


def tell_points(found: TriangulatedPoints, row: dict[str, Any], json: str | None) -> None:
    """Print triangulated points; exit with status 1 if there is none.

    Args:
        found: the points.
        row: first fields of the result for ``--json``: ``out`` and ``method``.
        json: target of ``--json``.
    """
    import msgspec

    report = found.report
    for note in found.notes:
        say(note)
    write_json(json, {**row, **msgspec.to_builtins(report), "notes": list(found.notes)})
    if json != "-":
        show(report, Console(highlight=False))
    say(f"{report.counted['seen']} points of {report.frames} frames in {row['out']}")
    if not report.counted["seen"]:
        say("no point was found: compare the cameras' names and the rig, and see which reason is the most frequent")
        raise typer.Exit(1)


def show(report: TracksReport, out: Console) -> None:
    """Print the counts and errors as tables."""
    total = report.frames * report.points
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in ("camera", "points", "rejected", "residual px"):
        table.add_column(words, justify="left" if words == "camera" else "right")
    for name, camera in report.cameras.items():
        cells = (str(camera.seen), f"{100 * camera.rejected_share:.1f} %", f"{camera.residual_px:.2f}")
        table.add_row(name, *cells)
    out.print(table)
    others = ", ".join(
        f"{state.replace('_', ' ')} {count}" for state, count in report.counted.items() if state != "seen" and count
    )
    out.print(f"{report.counted['seen']} of {total} points; {others or 'none without'}; {report.residual_px:.2f} px")
