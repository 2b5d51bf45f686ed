"""``mocapella track points``: 2D points of several cameras become points in space."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import track_app
from mocapella.cli.common import JsonOut, console, say, working, write_json

if TYPE_CHECKING:
    from mocapella.fusion.point_tracks import TracksReport


@track_app.command("points")
def triangulate(
    points: Annotated[
        list[Path],
        typer.Argument(metavar="POINTS…", help="A folder of OpenPose JSON for each camera, or one CSV of all."),
    ],
    rig: Annotated[Path, typer.Option(metavar="FILE", help="The calibrated cameras, a TOML.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="What to write: its name ends with .csv or .trc.")],
    method: Annotated[str, typer.Option(metavar="NAME", help="robust, weighted-linear or linear.")] = "robust",
    sd_px: Annotated[
        float, typer.Option(metavar="PX", help="How far off a sure detection usually is; of the method robust.")
    ] = 3.0,
    least_confidence: Annotated[
        float, typer.Option(metavar="SHARE", help="Detections are used whose confidence is above that.")
    ] = 0.3,
    largest_error: Annotated[
        float, typer.Option(metavar="PX", help="Mean error of a point at most; of the linear methods.")
    ] = 15.0,
    order: Annotated[str, typer.Option(metavar="NAME", help="OpenPose's order of points: BODY_25B or BODY_25.")] = (
        "BODY_25B"
    ),
    up: Annotated[
        str, typer.Option(metavar="AXIS", help="Which axis of the rig's world is up: y, z or -y; a TRC has Y up.")
    ] = "y",
    hz: Annotated[
        float | None, typer.Option(metavar="HZ", help="Frames a second, where the points have no times.")
    ] = None,
    json: JsonOut = None,
) -> None:
    """Make points in space of the 2D points that any program found in the pictures of calibrated cameras.

    Reads OpenPose's JSON, Caliscope's CSV and our own; docs/triangulation.md describes files, methods and axes.

    Example:  mocapella track points cam1_json cam2_json --rig rig.toml --hz 60 --out walk.trc
    """
    import msgspec

    from mocapella.errors import InputError, SettingsError, one_of
    from mocapella.exports.space_tracks import write_space_tracks
    from mocapella.fusion.point_tracks import TracksSettings, triangulate_tracks
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.image_tracks_file import OPENPOSE_ORDERS, read_image_tracks

    settings = TracksSettings(method, sd_px, 4.0, least_confidence, largest_error)
    if order not in OPENPOSE_ORDERS:
        raise SettingsError(f"--order is {order!r}; it must be one of {one_of(order, OPENPOSE_ORDERS)}")
    if out.suffix.lower() not in (".csv", ".trc"):
        raise SettingsError(f"--out {out}: end its name with .csv or .trc")
    cameras = load_camera_rig(rig)
    if len(cameras.cameras) < 2:
        raise InputError(f"has {len(cameras.cameras)} camera", file=rig, fix="give a rig of two cameras or more")
    with working("reading …", status=INTERRUPTED), console.status("reading …") as status:
        tracks = read_image_tracks(
            points, order=order, progress=lambda text: status.update(f"reading {text.replace('[', '(')} …")
        )
        status.update(f"triangulating {len(tracks.frames)} frames …")
        space, report = triangulate_tracks(tracks, cameras, settings)
        status.update(f"writing {out} …")
        write_space_tracks(space, out, up=up, hz=hz)
    for note in tracks.notes:
        say(note)
    write_json(json, {"out": str(out), "method": method, **msgspec.to_builtins(report), "notes": list(tracks.notes)})
    if json != "-":
        show(report, Console(highlight=False))
    say(f"{report.counted['seen']} points of {report.frames} frames in {out}")
    if not report.counted["seen"]:
        say("no point was found: compare the cameras' names and the rig, and see which reason is the most frequent")
        raise typer.Exit(1)


def show(report: TracksReport, out: Console) -> None:
    """The tables for a person."""
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
