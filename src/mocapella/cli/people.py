"""``mocapella people``: detect people in films, and track them in 3D; without a rig they calibrate the cameras."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

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
from mocapella.cli.people_result import people_row, show_people
from mocapella.cli.pictures import Fps
from mocapella.errors import CalibrationError, InputError, SettingsError
from mocapella.model.names import plural

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from mocapella.library.people_report import PeopleComparison, PeopleReport
    from mocapella.live.film_people import FilmCounts, FilmPeople
    from mocapella.model.keypoints import KeypointFrame
    from mocapella.sources.frame_set import FrameSet
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.protocol import Tracker

DEFAULT_RIG = Path("rig.toml")
METHOD = "webcams"
ALONE = "one-webcam"
"""Method of a single film."""
SHORT = 5
"""Films of fewer instants can be too short to track a person."""


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
    from mocapella.association.hand_keypoints import hand_sources
    from mocapella.association.keypoint_rays import sources_named
    from mocapella.library.calibration import named_inputs
    from mocapella.library.keypoint_tracking import rig_with_y_up
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.disk import check_can_record
    from mocapella.sources.video import parse_frames
    from mocapella.sources.video_set import VideoSet

    keys, own = read_settings(FilmKeys, settings_file, settings)
    paths = {name: _film(path) for name, path in named_inputs(films).items()}
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
    topologies = {one.topology.name for one in finds.values()}
    hands = all(sources_named(one) is None and hand_sources(one) for one in topologies)
    if hands and unknown and method == METHOD:
        fix = "give one of these cameras with --rig (mocapella calibrate cameras makes it with a printed board)"
        raise SettingsError(f"hands alone do not calibrate cameras, and there is no rig: {fix}")
    path = record_file(out)
    check_can_record(path)  # before a compilation of minutes, and a detection that may take longer
    get_ready(method, status=INTERRUPTED)
    if unknown and method == METHOD:
        done = _calibrate_and_track(path, shown, finds, of_method, json)
    else:
        done = _track(path, shown, finds, method, of_method)
    counts, whole = done.counts, done.whole
    report = None if hands else done.report
    agreement = {} if report is None else {"agreement": people_row(report)}
    write_json(json, {"take": str(path), "whole": whole, **msgspec.to_builtins(counts), **agreement})
    _tell(counts, path, hands=hands)
    if report is not None:
        _tell_agreement(report)
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)
    if not counts.tracked:
        raise typer.Exit(1)


class _Done(NamedTuple):
    """What a run gives: counts, whether it was to the end, and how well the cameras agree; None of one camera."""

    counts: FilmCounts
    whole: bool
    report: PeopleReport | None


def _film(text: str) -> Path:
    """Return the path of a film.

    Raises:
        InputError: it names a live camera, or is a folder of films.
    """
    from mocapella.recording.detection_files import FILMS
    from mocapella.sources.open_pictures import is_live
    from mocapella.sources.video import IMAGES

    path = Path(text)
    if path.is_dir() and not any(one.suffix.lower() in IMAGES for one in path.iterdir()):
        films = sorted(one.name for one in path.iterdir() if one.suffix.lower() in FILMS)
        if films:
            raise InputError(
                "is a folder of films",
                file=path,
                fix=f"name the films: mocapella people {path}/*{Path(films[0]).suffix} …",
            )
    if not path.exists() and (text.isdigit() or is_live(text)):
        fix = f"track it live: mocapella serve --method {METHOD}, and mocapella node keypoints {text}"
        raise InputError("is a live camera and no film", file=text, fix=fix)
    return path


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
    path: Path, shown: VideoSet, finds: Mapping[str, Any], settings: Mapping[str, Any], json: str | None
) -> _Done:
    """Calibrate from all people in the films, then track them; keep their keypoints if the calibration refuses."""
    from rich.console import Console

    from mocapella.cli.calibrate_people import show
    from mocapella.library.film_calibration import calibrate_films, track_films
    from mocapella.live.film_faults import FilmFaults
    from mocapella.live.film_people import detect_in_films
    from mocapella.live.signals import stop_on_signals
    from mocapella.settings import parse
    from mocapella.tracker.webcams_settings import WebcamsSettings

    parse(WebcamsSettings, dict(settings), where=f"settings of {METHOD}")  # before a detection that takes minutes
    done = 0
    faults = FilmFaults(shown.rig.cameras)
    with stop_on_signals() as stop, console.status("detecting …") as status:

        def on_instant() -> bool:
            nonlocal done
            done += 1
            status.update(f"detecting, instant {done} of {shown.count or 'many'}")
            return not stop.is_set()

        frames = detect_in_films(faults.watch(shown), finds, on_instant)
        for sentence in faults.sentences():
            say(sentence)
        try:
            found = calibrate_films(frames, settings, status.update)
        except CalibrationError as error:
            _keep(frames, path, settings, error, json)
            raise
        show(found, Console(stderr=True, highlight=False))
        for note in found.notes:
            say(note)
        say(f"the people calibrated {len(found.rig.cameras)} cameras, {'good' if found.good else 'not good yet'}")
        counts, report = track_films(frames, found, path, settings, status.update)
        return _Done(counts, not stop.is_set(), report)


def _keep(
    frames: dict[str, list[KeypointFrame]], path: Path, settings: Mapping[str, Any], error: Exception, json: str | None
) -> None:
    """Keep the keypoints of films whose people do not calibrate the cameras, and say how to go on."""
    from mocapella.library.film_calibration import keep_frames

    if not any(frame.bodies for of in frames.values() for frame in of):
        return
    keep_frames(frames, path, settings)
    write_json(json, {"take": str(path), "refused": str(error)})
    again = f"mocapella replay {path} --rig rig.toml --record {path.stem}-tracked"
    say(f"{path}: the keypoints of {sum(map(len, frames.values()))} images were kept, without people in 3D")
    say(
        f"next: {again}, with a rig of mocapella calibrate cameras, or of "
        f"mocapella calibrate people {path} --out rig.toml, which is less strict"
    )


def _track(path: Path, shown: VideoSet, finds: Mapping[str, Any], method: str, settings: Mapping[str, Any]) -> _Done:
    """Track until the end or Ctrl-C."""
    from mocapella.library.keypoint_tracking import wrong_up
    from mocapella.library.people_report import PeopleComparison
    from mocapella.live.file_take import FileTake
    from mocapella.live.film_faults import FilmFaults
    from mocapella.live.film_people import FilmPeople
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.camera_rig_file import encode_camera_rig
    from mocapella.model.session import Setup
    from mocapella.tracker import make_tracker

    used = {**settings, "rig": encode_camera_rig(shown.rig)}
    count = len(shown.rig.cameras)
    tracker: Tracker = make_tracker(method, sensors_expected=count, settings=used)
    faults = FilmFaults(shown.rig.cameras)
    compared = PeopleComparison(shown.rig)
    with ExitStack() as closing, stop_on_signals() as stop:
        take = closing.enter_context(FileTake(path, Setup(method, count), used))
        placed = shown.rig.cameras if method == METHOD else {}
        run = FilmPeople(placed, finds, tracker, take.write)
        whole = _follow(run, faults.watch(shown), shown.count, stop, compared)
    for sentence in faults.sentences():
        say(sentence)
    for reason, frames in run.rejected.items():
        say(f"{frames} images were not used: {reason}")
    report = compared.report() if method == METHOD else None
    if report is not None and not report.flipped and (problem := wrong_up(run.upright)):
        say(problem)
    return _Done(run.counts, whole, report)


def _follow(
    run: FilmPeople, films: Iterable[FrameSet], count: int | None, stop: Any, compared: PeopleComparison
) -> bool:
    """Track all instants and compare their people with the keypoints; return whether it was to the end."""
    columns = (
        TextColumn("detecting and tracking"), BarColumn(), MofNCompleteColumn(), TextColumn("instants"),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("people", total=count)
        for scene in run.steps(films):
            compared.add(run.frames, scene)
            progress.advance(task)
            if stop.is_set():
                return count is not None and run.counts.instants == count
    return True


def _tell(counts: FilmCounts, path: Path, *, hands: bool) -> None:
    """Print the counts; ``hands``: whether the detector finds hands alone."""
    who = "hands" if hands else "somebody"
    for name, images in counts.images.items():
        say(f"{name}: {who} in {counts.with_people[name]} of {images} images")
    where = f"{who} tracked in {counts.tracked} of {counts.instants} instants"
    if hands:
        say(f"{path}: {where}")
    else:
        all_in_all = f"{plural(counts.ids, 'person', 'people')} in all, at most {counts.most_people} at once"
        say(f"{path}: {all_in_all}, {where}")
    if not counts.tracked:
        say(f"{'no hand' if hands else 'nobody'} was tracked: {_why_nobody(counts, hands=hands)}")
    else:
        say(f"next: mocapella replay {path} --view, or mocapella export trc {path}")


def _tell_agreement(report: PeopleReport) -> None:
    """Print how well the cameras agree about the people, and name cameras that do not; nothing without people."""
    from rich.console import Console

    from mocapella.library.people_report import alarms

    if not report.people and not report.flipped:
        return  # the reason is printed
    if report.people:
        show_people(report, Console(stderr=True, highlight=False))
    for sentence in alarms(report, films=True):
        say(sentence)


def _why_nobody(counts: FilmCounts, *, hands: bool = False) -> str:
    """Return the likely reason why no person, or no hand, was tracked, with the remedy."""
    nobody = [name for name, seen in counts.with_people.items() if not seen]
    if nobody and hands:
        return (
            f"none is seen by {', '.join(nobody)}; hands are found best within an arm's length or two of the camera, "
            "or try --set least_confidence=0.3; the detector mediapipe finds people"
        )
    if nobody:
        return (
            f"nobody is seen by {', '.join(nobody)}; people are found best whole and a quarter of the image tall, "
            "or try --set least_confidence=0.3"
        )
    if len(counts.images) > 1 and counts.instants < SHORT:
        what = "hand" if hands else "person"
        return (
            f"{plural(counts.instants, 'instant', 'instants')} of the films is too little, for a {what} is shown when "
            f"cameras agree for some; give longer films{'' if hands else ', or --set confirm_instants=1'}"
        )
    return (
        f"no two cameras of {', '.join(counts.images)} agree about a {'hand' if hands else 'person'}; do the films "
        "belong to the rig's cameras, show the same room, and begin at the same instant? Leave out the film of another "
        "room, or give a rig of these cameras"
    )
