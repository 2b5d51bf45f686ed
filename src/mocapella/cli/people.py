"""``mocapella people``: detect people in films, and track them in 3D; without a rig they calibrate the cameras."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.command_settings import KeySpec, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import (
    RIG_HELP,
    UP_HELP,
    FrameChoice,
    JsonOut,
    console,
    get_ready,
    method_setting_names,
    need_cameras,
    record_file,
    say,
    write_json,
)
from mocapella.cli.keypoint_options import KeypointDetectorName, ModelFile, detector_keys, opened_detector
from mocapella.cli.pictures import Fps
from mocapella.model.names import plural

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mocapella.live.film_people import FilmCounts, FilmPeople
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.protocol import Tracker

DEFAULT_RIG = Path("rig.toml")
METHOD = "webcams"
ALONE = "one-webcam"
"""Method of a single film."""


@dataclass(frozen=True)
class FilmKeys:
    """Settings of `people`."""

    other_size: Annotated[
        str | None, KeySpec("Track films of another size than the calibration's.", choices=("crop", "scale"))
    ] = None


def _people_keys(context: typer.Context) -> Iterator[str]:
    """Yield lines of ``--set help``: settings of the detector, and of the method for several films and for one."""
    from mocapella.tracker.method import METHODS

    yield from detector_keys(context)
    for name, what in ((METHOD, "two films or more"), (ALONE, "a single film")):
        yield from lines_of_dataclass(METHODS.find(name).settings, f"Settings of the method {name}, for {what}:")


@app.command(rich_help_panel=RECORDINGS, hidden=True)  # the introduction of `mocapella --help` names it
def people(
    films: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]FILM…",
            help="A film or a folder of images of each camera, named as in the rig, of one start.",
        ),
    ],
    out: Annotated[
        str, typer.Option("--out", metavar="FILE", help="Take to write: a name in the folder takes, or a path.")
    ],
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            metavar="FILE",
            help=f"{RIG_HELP} By default rig.toml; without it, the people calibrate the cameras.",
        ),
    ] = None,
    detector: KeypointDetectorName = None,
    model: ModelFile = None,
    up: Annotated[str, typer.Option("--up", metavar="AXIS", help=UP_HELP)] = "y",
    frames: FrameChoice = None,
    fps: Fps = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(FilmKeys, _people_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Track people in films of two or more cameras: detect keypoints, and write a take with people in 3D.

    The films begin at the same instant. `mocapella replay`, `export` and `view` take the result; replay uses its
    keypoints again, with other settings as well. Without a rig, the people who walk about in the films calibrate the
    cameras first. --set height_m=1.75 then tells how tall people are. In a single film, all distances are inferred.
    docs/webcams.md.

    Example:  mocapella people left.mp4 right.mp4 --rig rig.toml --out walk-1
    """
    need_cameras("people")
    from mocapella.library.calibration import named_inputs
    from mocapella.library.keypoint_tracking import rig_with_y_up
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.sources.video import parse_frames
    from mocapella.sources.video_set import VideoSet

    keys, own = read_settings(FilmKeys, settings_file, settings)
    paths = {name: Path(path) for name, path in named_inputs(films).items()}
    method = METHOD if len(paths) > 1 else ALONE
    unknown = rig is None and (method == ALONE or not DEFAULT_RIG.exists())
    of_method = _settings_of_method(method, own)
    known = _unknown_lenses(paths, of_method) if unknown else rig_with_y_up(load_camera_rig(rig or DEFAULT_RIG), up)
    shown = VideoSet(paths, known, frames=parse_frames(frames), rate_hz=fps, other_size=keys.other_size)
    for note in shown.notes:
        say(note)
    if method == ALONE:
        say(f"one film: distances are inferred from people's height (method {ALONE}); name two films to measure them")
    finds = {name: opened_detector("people", detector, model, own) for name in shown.rig.cameras}
    path = record_file(out)  # before a compilation of minutes
    get_ready(method, status=INTERRUPTED)
    if unknown and method == METHOD:
        counts, whole = _calibrate_and_track(path, shown, finds, of_method)
    else:
        counts, whole = _track(path, shown, finds, method, of_method)
    write_json(json, {"take": str(path), "whole": whole, **msgspec.to_builtins(counts)})
    _tell(counts, path)
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)
    if not counts.tracked:
        raise typer.Exit(1)


def _settings_of_method(method: str, own: dict[str, Any]) -> dict[str, Any]:
    """Take the settings of a tracking method out of ``own``, which keeps the detector's."""
    names = method_setting_names(method)
    return {name: own.pop(name) for name in list(own) if name.split(".", 1)[0] in names}


def _unknown_lenses(paths: Mapping[str, Path], settings: Mapping[str, Any]) -> Any:
    """Return a rig of films whose cameras were never calibrated: image sizes, and lenses of a typical field of view."""
    import math

    import numpy as np

    from mocapella.fusion.one_camera import camera_of_view
    from mocapella.model.camera import Camera, CameraRig, PlacedCamera
    from mocapella.settings import parse
    from mocapella.sources.video_set import probe
    from mocapella.tracker.one_webcam import OneWebcamSettings

    of_one = settings if len(paths) == 1 else {}
    view = math.radians(parse(OneWebcamSettings, of_one, where=f"settings of {ALONE}").field_of_view_deg)
    placed = {}
    for name, path in paths.items():
        size_px = probe(path).size_px
        camera = Camera(name, size_px, camera_of_view(size_px, view))
        placed[name] = PlacedCamera(camera, np.eye(4), np.full((6, 6), np.nan))
    return CameraRig(placed)


def _calibrate_and_track(
    path: Path, shown: VideoSet, finds: Mapping[str, Any], settings: Mapping[str, Any]
) -> tuple[FilmCounts, bool]:
    """Calibrate from all people in the films, then track them; return the counts, and whether it was to the end."""
    from rich.console import Console

    from mocapella.cli.calibrate_people import show
    from mocapella.library.film_calibration import calibrate_films, track_films
    from mocapella.live.film_people import detect_in_films
    from mocapella.live.signals import stop_on_signals

    done = 0
    with stop_on_signals() as stop, console.status("detecting …") as status:

        def on_instant() -> bool:
            nonlocal done
            done += 1
            status.update(f"detecting, instant {done} of {shown.count or 'many'}")
            return not stop.is_set()

        frames = detect_in_films(shown, finds, on_instant)
        found = calibrate_films(frames, settings, status.update)
        show(found, Console(stderr=True, highlight=False))
        for note in found.notes:
            say(note)
        say(f"the people calibrated {len(found.rig.cameras)} cameras, {'good' if found.good else 'not good yet'}")
        counts = track_films(frames, found, path, settings, status.update)
        return counts, not stop.is_set()


def _track(
    path: Path, shown: VideoSet, finds: Mapping[str, Any], method: str, settings: Mapping[str, Any]
) -> tuple[FilmCounts, bool]:
    """Track until the end or Ctrl-C; return the counts, and whether it was the end."""
    from mocapella.library.keypoint_tracking import wrong_up
    from mocapella.live.file_take import FileTake
    from mocapella.live.film_people import FilmPeople
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.camera_rig_file import encode_camera_rig
    from mocapella.model.session import Setup
    from mocapella.tracker import make_tracker

    used = {**settings, "rig": encode_camera_rig(shown.rig)}
    count = len(shown.rig.cameras)
    tracker: Tracker = make_tracker(method, sensors_expected=count, settings=used)
    with ExitStack() as closing, stop_on_signals() as stop:
        take = closing.enter_context(FileTake(path, Setup(method, count), used))
        placed = shown.rig.cameras if method == METHOD else {}
        run = FilmPeople(placed, finds, tracker, take.write)
        whole = _follow(run, shown, stop)
    for reason, frames in run.rejected.items():
        say(f"{frames} images were not used: {reason}")
    if method == METHOD and (problem := wrong_up(run.upright)):
        say(problem)
    return run.counts, whole


def _follow(run: FilmPeople, shown: VideoSet, stop: Any) -> bool:
    columns = (
        TextColumn("detecting and tracking"), BarColumn(), MofNCompleteColumn(), TextColumn("instants"),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("people", total=shown.count)
        for _ in run.steps(shown):
            progress.advance(task)
            if stop.is_set():
                return shown.count is not None and run.counts.instants == shown.count
    return True


def _tell(counts: FilmCounts, path: Path) -> None:
    for name, images in counts.images.items():
        say(f"{name}: somebody in {counts.with_people[name]} of {images} images")
    say(
        f"{path}: {plural(counts.ids, 'person', 'people')} in all, at most {counts.most_people} at once, "
        f"somebody tracked in {counts.tracked} of {counts.instants} instants"
    )
    if not counts.tracked:
        nobody = [name for name, seen in counts.with_people.items() if not seen]
        why = (
            f"nobody is seen by {', '.join(nobody)}"
            if nobody
            else "do the films belong to the rig, and begin together?"
        )
        say(f"nobody was tracked: {why}")
    else:
        say(f"next: mocapella replay {path} --view, or mocapella export trc {path}")
