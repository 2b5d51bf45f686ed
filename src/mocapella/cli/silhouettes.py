"""``mocapella track silhouettes``: fit body models to silhouettes in images of calibrated cameras, recorded or live."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import track_app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import (
    DEFAULT_VIEW_PORT,
    ORDER,
    PLOT_HELP,
    RIG_HELP,
    START_FORM,
    START_HELP,
    FrameChoice,
    JsonOut,
    RecordTo,
    View,
    chosen,
    console,
    drawable,
    need_cameras,
    say,
    seconds_option,
    telling_of_compiling,
    working,
)
from mocapella.cli.pictures import FOURCC, Fps
from mocapella.cli.silhouette_keys import REJECTION, fit_settings
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from threading import Event

    from mocapella.cli.silhouette_live import LiveWishes
    from mocapella.cli.silhouette_people import PeopleWishes
    from mocapella.cli.silhouette_start import StartWishes
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.live.silhouette_view import SilhouetteView
    from mocapella.model.camera import CameraRig
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.video import Frames
    from mocapella.tracker.initial_body import InitialBody


@dataclass(frozen=True)
class SilhouetteKeys:
    """Settings of `track silhouettes`."""

    points: Annotated[
        tuple[str, ...],
        KeySpec(
            "In place of --start: 2D keypoints, as of `track points`; later ones find a lost body.", "[PERSON=]POINTS"
        ),
    ] = ()
    keypoints: Annotated[
        tuple[str, ...],
        KeySpec("In place of --start: keypoints of all people, as of `triangulate`; they refine the fit.", "FOLDER"),
    ] = ()
    detector: Annotated[
        str | None, KeySpec("In place of --start: detect people in all images; as of `people --detector`.", "NAME")
    ] = None
    up: Annotated[
        str, KeySpec("With keypoints or detector: upward axis of the rig's world.", choices=("y", "z", "-y"))
    ] = "y"
    model: Annotated[
        tuple[str, ...],
        KeySpec("Body model: male (default), female, legs, or a rigged .glb or .gltf.", "[PERSON=]NAME"),
    ] = ()
    height: Annotated[
        tuple[str, ...], KeySpec("Body height [m]; by default as the joints of --start say.", "[PERSON=]METRES")
    ] = ()
    other_size: Annotated[
        str | None, KeySpec("Fit images of another size than the calibration's.", choices=("crop", "scale"))
    ] = None
    order: Annotated[str, ORDER] = "auto"
    live: Annotated[
        bool, KeySpec("Treat videos as live cameras: in real time; frames that come too soon are dropped.")
    ] = False
    empty_room: Annotated[
        float | None, KeySpec("Live: learn the background for this time, while the images are empty.", "s")
    ] = None
    late: Annotated[tuple[str, ...], KeySpec("Live: latency of a camera, as of network cameras.", "NAME=MS")] = ()
    fourcc: Annotated[str | None, FOURCC] = None
    steadiness: Annotated[bool, KeySpec("Penalise jitter; false fits every frame independently.")] = True
    rejection: Annotated[str, REJECTION] = "adaptive"
    plot: Annotated[Path | None, KeySpec(f"{PLOT_HELP} Joint angles over time.", "file")] = None
    beside: Annotated[Path | None, KeySpec("In the plot, compare with this earlier result.", "file")] = None
    view_port: Annotated[
        int | None, KeySpec("TCP port of the live view; by default 7448, or a free one.", "port", 1, 65535)
    ] = None
    browser: Annotated[bool, KeySpec("Open the live view in the browser.")] = True


@track_app.command()
def silhouettes(
    context: typer.Context,
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME=]SOURCE…",
            help="A video or a folder of images of each camera, or live: camera:0, /dev/video0, http://… or rtsp://…; "
            "in any order, named as in the rig.",
        ),
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} By default rig.toml.")] = None,
    start: Annotated[list[str] | None, typer.Option("--start", metavar=START_FORM, help=START_HELP)] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]VIDEO", help="Images of the empty room, of one camera. Repeatable."),
    ] = None,
    frames: FrameChoice = None,
    fps: Fps = None,
    seconds: Annotated[float | None, seconds_option("Of tracking, live cameras only; without it, at Ctrl-C.")] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|FILE.mp4",
            help="Write the images with the models' outlines; image contours outside them are red, inside blue.",
        ),
    ] = None,
    record: RecordTo = None,
    view: View = True,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(SilhouetteKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Fit body models to the silhouettes of one or several people, in videos of calibrated cameras or live.

    docs/silhouettes.md describes filming, the start, the results and the messages.

    Example:  mocapella track silhouettes cam1.mp4 cam2.mp4 --rig rig.toml --start joints.json --json out.json

    Live:  mocapella track silhouettes a=camera:0 b=camera:2 --start joints.json --set empty_room=3 --json out.json
    """
    need_cameras("track silhouettes")
    from mocapella.cli.silhouette_live import LiveWishes
    from mocapella.cli.silhouette_start import StartWishes
    from mocapella.sources.video import parse_frames

    keys = read_keys(SilhouetteKeys, settings_file, settings)
    drawable(keys.plot)
    live_wishes = LiveWishes(
        _inputs(sources, fps), keys.live, fps, keys.other_size, keys.fourcc, keys.empty_room, seconds, frames,
        background or (), keys.late,
    )  # fmt: skip
    live_wishes.verify()
    named_view = chosen(context, "view", view)
    page = None if named_view is False or not (named_view or live_wishes.live) else _Page(keys.view_port, keys.browser)
    files = _Files(rig or Path("rig.toml"), json, keys.plot, keys.beside, overlay, record)
    starts = StartWishes(
        start or (), keys.points, keys.model, keys.height, keys.order, _people_wishes(keys, live=live_wishes.live)
    )
    whole = _track(live_wishes, starts, parse_frames(frames), files, page, fit_settings(keys))
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)


@dataclass(frozen=True)
class _Page:
    """How to show the live view."""

    port: int | None
    browser: bool


@dataclass(frozen=True)
class _Files:
    """Files of a run; None if the option is not given."""

    rig: Path
    json: str | None
    plot: Path | None
    beside: Path | None
    overlay: Path | None
    record: str | None


def _track(
    live_wishes: LiveWishes,
    starts: StartWishes,
    wanted: Frames,
    files: _Files,
    page: _Page | None,
    fit: Mapping[str, Any],
) -> bool:
    """Track until the end, with settings of the fit as of `fit_settings`; return False if it is interrupted before."""
    from mocapella.cli.silhouette_live import wait_for_people
    from mocapella.cli.silhouette_result import SilhouetteResult, show
    from mocapella.cli.silhouette_start import check_seen, find_later, find_start, learn
    from mocapella.cli.silhouette_take import recorded
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.bodies_file import read_followed_people

    seconds, background = live_wishes.seconds, live_wishes.background
    earlier = None if files.beside is None else read_followed_people(files.beside)
    with ExitStack() as closing:
        with working("reading …", status=INTERRUPTED), telling_of_compiling("the method silhouettes"):
            cameras = load_camera_rig(files.rig)
            shown = _opened(live_wishes, cameras, wanted, closing)
            on_step: list[Callable[[Step], None]] = []
            if files.overlay is not None:
                writer = _Overlays(files.overlay, shown, wanted.step)
                closing.callback(writer.close)
                on_step.append(writer.write)
            starts = with_films(starts, live_wishes, cameras, shown, wanted)
            found = find_start(starts, cameras, wanted)
            later = {} if live_wishes.live else find_later(starts, cameras, wanted, shown.rate_hz)
            bodies = {name: body.starting(pose, later.get(name, ())) for name, (body, pose) in found.items()}
            check_seen(bodies, shown.rig, ", ".join(starts.starts or ["keypoints"]))
            if files.record is None:
                run = _started(bodies, shown, live_wishes, wanted, fit)
            else:
                take = recorded(files.record, found, later, shown, live_wishes, wanted=wanted, fit=fit)
                closing.callback(take.close)
                run = take.run
            run.keypoints = starts.people.frames
            if background:
                learn(run, background, cameras, shown, live_wishes.other_size)
        if live_wishes.live and (background or live_wishes.empty_room_s is not None):
            wait_for_people(run, shown, live_wishes.empty_room_s, view=page is not None)
        with stop_on_signals() as stop, telling_of_compiling("the method silhouettes"):
            opened = None
            if page is not None:
                opened = open_view(run, page.port, no_browser=not page.browser)
                closing.callback(opened.close)
                on_step.append(opened.tell)
            result = closing.enter_context(
                SilhouetteResult(
                    files.json, files.plot, {name: body for name, (body, _) in found.items()}, shown, files.rig, fit
                )
            )
            whole = _follow(run, shown, stop, seconds, [result.keep, *on_step])
            result.finish(run, shown)
            if files.json != "-":
                show(run, Console(highlight=False), shown.summary())
            result.draw(earlier, str(files.beside))
            if opened is not None and whole and not (stop.is_set() or seconds is not None):
                say("the view stays until Ctrl-C")
                opened.stay(stop)
    return whole


def _people_wishes(keys: SilhouetteKeys, *, live: bool) -> PeopleWishes:
    """Return where the bodies of all people come from.

    Raises:
        SettingsError: both keypoints and a detector are given, or one of them with live cameras.
    """
    from mocapella.cli.silhouette_people import NOBODY, PeopleWishes

    if not keys.keypoints and keys.detector is None:
        return NOBODY
    if keys.keypoints and keys.detector is not None:
        raise SettingsError("keypoints and detector are both given; choose one of them")
    if live:
        raise SettingsError("keypoints and detector are of films; with live cameras give --start joints.json")
    finds = None if keys.detector is None else {"": keys.detector}
    return PeopleWishes(keys.keypoints, finds, keys.up, keys.order)


def with_films(
    starts: StartWishes, wishes: LiveWishes, cameras: CameraRig, shown: FrameSource, wanted: Frames
) -> StartWishes:
    """Return the options of the initialisation with the films that keypoints of all people belong to."""
    people = starts.people
    if not people.given:
        return starts
    finds = people.finds
    if finds is not None:
        from mocapella.cli.keypoint_options import opened_detector

        (name,) = finds.values()
        finds = {camera: opened_detector("track silhouettes", name, None, {}) for camera in shown.rig.cameras}
        with ExitStack() as closing:  # the films once more: the tracked ones stay at their beginning
            again = _opened(wishes, cameras, wanted, closing)
            filled = replace(people, finds=finds, rig=shown.rig, shown=again, first=wanted.first)
            filled.joints  # noqa: B018 - cached while the films are open
            return replace(starts, people=filled)
    return replace(starts, people=replace(people, rig=cameras, shown=shown, first=wanted.first))


def _opened(wishes: LiveWishes, cameras: CameraRig, wanted: Frames, closing: ExitStack) -> FrameSource:
    """Open the live cameras or the videos."""
    from mocapella.cli.silhouette_live import open_live
    from mocapella.sources.video_set import VideoSet

    if wishes.live:
        return closing.enter_context(open_live(wishes, cameras))
    paths = {name: Path(path) for name, path in wishes.sources.items()}
    return VideoSet(paths, cameras, frames=wanted, rate_hz=wishes.hz, other_size=wishes.other_size)


def _started(
    bodies: Mapping[str, InitialBody],
    shown: FrameSource,
    wishes: LiveWishes,
    wanted: Frames,
    fit: Mapping[str, Any],
) -> SilhouetteRun:
    """Return the run before its first frame; before live cameras, people may arrive later."""
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.settings import parse
    from mocapella.tracker.frame_sync import FrameSyncSettings
    from mocapella.tracker.silhouette_settings import SilhouetteSettings
    from mocapella.tracker.silhouettes import SilhouettesTracker

    tracker = SilhouettesTracker(
        bodies,
        shown.rig,
        parse(SilhouetteSettings, fit),
        sync=FrameSyncSettings(period_s=wanted.step / shown.rate_hz),
        empty_room_s=wishes.empty_room_s or 0.0,
        waiting=wishes.live and bool(wishes.background),
    )
    run = SilhouetteRun(tracker, say)
    for note in shown.notes:
        run.note(note)
    return run


def _inputs(sources: Sequence[str] | None, hz: float | None) -> dict[str, str]:
    """Return videos or cameras by name; check the frame rate, too."""
    from mocapella.library.calibration import named_inputs
    from mocapella.settings import check

    check(hz is None or 0 < hz <= 1000, "--fps", hz, "above 0, at most 1000")
    if not sources:
        raise SettingsError(
            "no videos are named; name one for each camera: mocapella track silhouettes cam1.mp4 cam2.mp4 …"
        )
    return named_inputs(sources)


def open_view(run: SilhouetteRun, port: int | None, *, no_browser: bool) -> SilhouetteView:
    """Serve the live view, print its address, and open it in the browser unless ``no_browser``.

    ``port`` None takes the default port, or a free one if that is in use. The caller closes the returned view.
    """
    from mocapella.cli.demo import choose_port
    from mocapella.cli.live_session import say_url
    from mocapella.live.silhouette_view import SilhouetteView

    page = SilhouetteView("127.0.0.1", choose_port(port, DEFAULT_VIEW_PORT), run)
    say_url(page.url)
    if not no_browser:
        webbrowser.open(page.url)
    return page


def _follow(
    run: SilhouetteRun,
    shown: FrameSource,
    stop: Event,
    seconds: float | None,
    tell: Sequence[Callable[[Step], None]],
) -> bool:
    """Track frame by frame; return False if a video was stopped before its end. Live cameras end only by a stop."""
    from mocapella.cli.silhouette_live import follow_live
    from mocapella.sources.live_set import LiveSet

    if isinstance(shown, LiveSet):
        follow_live(run, shown, stop, seconds, tell)
        return True
    whom = ", ".join(filter(None, run.meshes))
    columns = (
        TextColumn(f"following {whom}".strip(), markup=False), BarColumn(), MofNCompleteColumn(), TextColumn("frames"),
        TimeRemainingColumn(),
    )  # fmt: skip
    said = len(shown.notes)
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("following", total=shown.count)
        for step in run.steps(shown):
            for each in tell:
                each(step)
            progress.advance(task)
            if stop.is_set():
                return shown.count is not None and run.frames == shown.count
    for note in shown.notes[said:]:
        run.note(note)
    return True


class _Overlays:
    """Writes every step's images with the outlines."""

    def __init__(self, path: Path, shown: FrameSource, step: int) -> None:
        from mocapella.sensing.outline_picture import OverlayWriter

        sizes = {name: placed.camera.size_px for name, placed in shown.rig.cameras.items()}
        self._writer = OverlayWriter(path, shown.rate_hz / step, sizes)

    def write(self, step: Step) -> None:
        """Write the images of one step."""
        self._writer.write(step.frame, step.pictures())

    def close(self) -> None:
        """Finish the files."""
        self._writer.close()
