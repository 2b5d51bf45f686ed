"""``mocapella triangulate``: all people, or named points, in space from other programs' keypoint files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.command_settings import SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import (
    ORDER,
    OUT_HELP,
    RIG_HELP,
    UP_HELP,
    JsonOut,
    check_out,
    method_setting_names,
    say,
    take_file,
    telling_of_compiling,
    working,
    write_json,
)
from mocapella.cli.people_result import people_row, show_people
from mocapella.cli.pictures import Fps

if TYPE_CHECKING:
    from mocapella.library.people_triangulation import TriangulatedPeople
    from mocapella.model.camera import CameraRig
    from mocapella.recording.detections import CameraDetections

_METHOD = "webcams"


@dataclass(frozen=True)
class PeopleKeys:
    """Settings of `triangulate`."""

    order: Annotated[str, ORDER] = "auto"


def _method_keys(_context: typer.Context) -> Iterator[str]:
    """Yield the settings of the tracking method, for ``--set help``."""
    from mocapella.tracker.method import METHODS

    yield from lines_of_dataclass(METHODS.find(_METHOD).settings, f"Settings of the method {_METHOD}:")


@app.command(rich_help_panel=RECORDINGS, hidden=True)  # the introduction of `mocapella --help` names it
def triangulate(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES…", help="A folder with a folder or file of keypoints for each camera, or several of these."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help=f"{OUT_HELP} Its ending is that of an export, such as .trc; a take without."
        ),
    ],
    rig: Annotated[Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} By default rig.toml.")] = None,
    fps: Fps = None,
    up: Annotated[str, typer.Option("--up", metavar="AXIS", help=UP_HELP)] = "y",
    most: Annotated[
        int | None,
        typer.Option("--max-people", metavar="NUMBER", min=1, help="Write at most so many, those in most frames."),
    ] = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(PeopleKeys, _method_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Track all people in the keypoint files of calibrated cameras, or triangulate named points such as an animal's.

    Reads OpenPose, Pose2Sim, MMPose, AlphaPose, DeepLabCut, SLEAP and our CSV; docs/keypoint-files.md describes them.

    Example:  mocapella triangulate session/pose --rig Calib.toml --up z --fps 60 --out walk.trc
    """
    from mocapella.library.keypoint_tracking import rig_with_y_up
    from mocapella.library.people_files import export_of
    from mocapella.library.people_triangulation import track_detections
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.detection_files import read_detections
    from mocapella.recording.disk import check_can_record

    keys, method_settings = read_settings(PeopleKeys, settings_file, settings, method_setting_names(_METHOD))
    take = take_file(out) if out.suffix.lower() in ("", ".mcap") else None
    if take is None:
        check_out(out)
        export_of(out)
    else:
        check_can_record(take)
    cameras = load_camera_rig(rig or Path("rig.toml"))
    with working("reading …", status=INTERRUPTED) as status, telling_of_compiling(f"the method {_METHOD}"):

        def tell(text: str) -> None:
            status.update(f"{text.replace('[', '(')} …")

        found = read_detections(files, order=keys.order, progress=lambda text: tell(f"reading {text}"))
        if all(one.topology is None for one in found):
            _points(found, cameras, out, up, fps, json)
            return
        done = track_detections(
            found, rig_with_y_up(cameras, up), source=files[0], fps=fps, most=most, record=take,
            settings=method_settings, progress=tell,
        )  # fmt: skip
        written = [] if take is not None or done.people is None else done.save(out)
    _tell(done, written if take is None else [take], json)


def _tell(done: TriangulatedPeople, written: list[Path], json: str | None) -> None:
    """Print the result; exit with status 1 if no person was tracked."""
    for note in done.notes:
        say(note)
    row = {"out": [str(path) for path in written], **people_row(done.report), "notes": list(done.notes)}
    write_json(json, row)
    if json != "-":
        show_people(done.report, Console(highlight=False))
    people, count = done.people, len(done.report.people)
    if people is None:
        say("nobody was tracked; the lines above say why")
        raise typer.Exit(1)
    shown = len(people.individuals)
    limit = f", of {count}" if count > shown else ""
    say(f"{shown} people{limit} in {done.report.instants} frames: {', '.join(map(str, written))}")


def _points(
    found: list[CameraDetections], rig: CameraRig, out: Path, up: str, fps: float | None, json: str | None
) -> None:
    """Triangulate points that are no people's, as `mocapella track points` does."""
    from mocapella.cli.triangulate import tell_points
    from mocapella.errors import SettingsError
    from mocapella.library.triangulation import triangulate as triangulate_points
    from mocapella.recording.detections import image_tracks

    if out.suffix.lower() not in (".csv", ".trc"):
        raise SettingsError(f"--out {out}: these are points and no people; end its name with .csv or .trc")
    points = triangulate_points(image_tracks(found), rig, fps=fps)
    points.save(out, up=up)
    more: dict[str, Any] = {"out": str(out), "method": "robust"}
    tell_points(points, more, json)
