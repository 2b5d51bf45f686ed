"""``mocapella compare``: how far a recording is from a reference, such as a marker system."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli import DAMAGED, INTERRUPTED
from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.common import JsonOut, Plot, drawable, say, working, write_json
from mocapella.errors import SettingsError, TakeExistsError

if TYPE_CHECKING:
    from mocapella.comparison.comparison import Compared


def _report(path: Path | None) -> Path | None:
    """Check ``--report`` before any work: it needs matplotlib, and a folder that exists."""
    if path is None:
        return None
    if path.suffix.lower() != ".html":
        raise SettingsError(f"--report {path}: end its name with .html")
    drawable(path.with_suffix(".png"))
    return path


@app.command(rich_help_panel=RECORDINGS)
def compare(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A take, or a file that `load` reads.")],
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="C3D, TRC, BVH, CSV, silhouettes result, or another take.")
    ],
    kind: Annotated[
        str | None, typer.Option("--kind", metavar="KIND", help="Results to compare: people, hands, arms, bodies, ….")
    ] = None,
    pairs: Annotated[
        str | None,
        typer.Option(
            "--pairs", metavar="OURS=THEIRS,…",
            help="Pairs of individuals; by default matched by motion, or by distance with --same-clock --same-space.",
        ),
    ] = None,
    joint_map: Annotated[
        Path | None,
        typer.Option("--map", metavar="FILE", help="TOML: markers of the reference by joint (docs/compare.md)."),
    ] = None,
    unit: Annotated[
        str | None, typer.Option("--bvh-unit", metavar="UNIT", help="Unit of a reference in BVH: m, dm, cm, mm or in.")
    ] = None,
    remove_bias: Annotated[
        bool,
        typer.Option("--remove-bias", help="Subtract each joint's mean difference, as of a marker beside the joint."),
    ] = False,
    same_clock: Annotated[
        bool, typer.Option("--same-clock", help="Hold the time: both have one clock, as a take tracked again has.")
    ] = False,
    same_space: Annotated[
        bool, typer.Option("--same-space", help="Hold the rigid motion: both are in the same coordinates.")
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE", help="Write the report, an HTML page.", callback=_report),
    ] = None,
    curves: Annotated[
        Path | None, typer.Option("--curves", metavar="FILE", help="Write all differences over time, as CSV.")
    ] = None,
    plot: Plot = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Estimate time, rate and rigid motion between a recording and a reference; score joints and angles.

    Each correction that sees the reference is named. docs/compare.md explains the figures.

    Exit status: 3 if a file is damaged or cut off, and what can be read was compared.

    Example:  mocapella compare walk-1 vicon.c3d --report walk-1.html
    """
    from mocapella.comparison.comparison import compared
    from mocapella.comparison.joint_names import read_joint_map
    from mocapella.comparison.pairing import pairs_of_text
    from mocapella.exports.comparison_report import as_dict
    from mocapella.recording.trajectory_files import trajectories_in

    files = [file for file in (report, curves, plot) if file is not None]
    if len({file.resolve() for file in files}) < len(files):
        raise SettingsError("--report, --curves and --plot name the same file; give each its own")
    for file in files:
        if os.path.lexists(file) and not force:
            raise TakeExistsError(f"{file} exists; add --force to replace it, or name another file")
    chosen, matched = None if joint_map is None else read_joint_map(joint_map), pairs_of_text(pairs)
    with working("comparing …", status=INTERRUPTED):
        ours, theirs = trajectories_in(recording), trajectories_in(reference, unit)
        found = compared(
            ours.found, theirs.found, kind=kind, people=matched, joints=chosen, remove_bias=remove_bias,
            same_clock=same_clock, same_space=same_space,
        )  # fmt: skip
        _write_files(found, {"recording": ours.path.name, "reference": theirs.path.name}, report, curves, plot)
    problems = [f"{side.path.name}: {problem}" for side in (ours, theirs) for problem in side.problems]
    for problem in problems:
        say(problem)
    result = {"recording": str(ours.path), "reference": str(theirs.path), **as_dict(found), "problems": problems}
    write_json(json, result)
    if json != "-":
        show_comparison(found)
    if ours.damaged or theirs.damaged:
        raise typer.Exit(DAMAGED)


def _write_files(
    found: Compared, titles: dict[str, str], report: Path | None, curves: Path | None, plot: Path | None
) -> None:
    from mocapella.evaluation.plots import save_figure
    from mocapella.exports.comparison_report import figure_of, write_curves, write_report
    from mocapella.exports.new_file import new_file

    if report is not None:
        with new_file(report, force=True) as part:
            write_report(found, part, titles)
        say(f"report in {report}")
    if curves is not None:
        with new_file(curves, force=True) as part:
            write_curves(found, part)
        say(f"curves in {curves}")
    if plot is not None:
        with new_file(plot, force=True) as part:
            save_figure(figure_of(found), part)
        say(f"plot in {plot}")


def show_comparison(found: Compared) -> None:
    """Print the findings and the tables of positions and angles."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from mocapella.exports.comparison_report import (
        ANGLE_HEADS,
        POSITION_HEADS,
        angle_rows,
        findings,
        fitting,
        position_rows,
        position_words,
    )

    out = Console(highlight=False)
    for line in findings(found):
        out.print(line, markup=False, soft_wrap=True)
    out.print(position_words(found), markup=False, soft_wrap=True)
    for title, heads, rows in (
        ("positions, recording minus reference", POSITION_HEADS, position_rows(found)),
        ("angles, recording minus reference", ANGLE_HEADS, angle_rows(found)),
    ):
        if rows:
            columns = fitting(heads, rows, out.width)
            table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            for k in columns:
                table.add_column(heads[k], justify="right" if heads[k] else "left", no_wrap=True)
            for row in rows:
                table.add_row(*(escape(row[k]) for k in columns))
            out.print(table)
            lost = [head for k, head in enumerate(heads) if k not in columns]
            if lost:
                out.print(
                    f"not shown for want of width: {'; '.join(lost)} (--report and --json have all)", markup=False
                )
