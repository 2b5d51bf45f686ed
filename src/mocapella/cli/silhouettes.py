"""``mocapella track silhouettes``: body models fitted to silhouettes in images of calibrated cameras, files or live."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import track_app
from mocapella.cli.common import (
    DEFAULT_VIEW_PORT,
    JsonOut,
    Seconds,
    console,
    need_cameras,
    say,
    telling_of_compiling,
    working,
)
from mocapella.cli.pictures import Fourcc
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from threading import Event

    from mocapella.cli.silhouette_live import LiveWishes
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.live.silhouette_view import SilhouetteView
    from mocapella.model.camera import CameraRig
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.video import Frames
    from mocapella.tracker.initial_body import InitialBody


@track_app.command()
def silhouettes(  # noqa: PLR0915 - every option is passed on
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME=]SOURCE…",
            help="A video or a folder of images of each camera, or live: camera:0, /dev/video0, http://… or rtsp://…; "
            "in any order, called as in the rig.",
        ),
    ] = None,
    rig: Annotated[Path, typer.Option(metavar="FILE", help="The calibrated cameras, a TOML.")] = Path("rig.toml"),
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]FILE[:FRAME]",
            help="Where the bodies are at first: JSON of named joints in metres, of one or of several people by name, "
            "or what this command wrote before; may be repeated.",
        ),
    ] = None,
    points: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]POINTS",
            help="Instead of --start: the first frame's 2D keypoints, as triangulate takes them; may be repeated, or "
            "a folder of OpenPose's folders.",
        ),
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]NAME",
            help="male, female, legs, or a rigged .glb or .gltf file; male. May be repeated, one a person.",
        ),
    ] = None,
    height: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]METRES",
            help="Of the person; without it, as large as the start's joints say. May be repeated, one a person.",
        ),
    ] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]VIDEO", help="The empty room, as a camera sees it; may be repeated."),
    ] = None,
    frames: Annotated[str | None, typer.Option(metavar="odd|even|FROM:TO:STEP", help="Which frames to use.")] = None,
    hz: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Frames a second, where the files do not say it, or not rightly; what to ask cameras for.",
        ),
    ] = None,
    other_size: Annotated[
        str | None,
        typer.Option(
            metavar="crop|scale", help="Images of another size than the calibration's: border cut off, or all scaled."
        ),
    ] = None,
    order: Annotated[str, typer.Option(metavar="NAME", help="OpenPose's order of points: BODY_25B or BODY_25.")] = (
        "BODY_25B"
    ),
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Take videos as if they were cameras: at their own pace; what it has no time for is dropped."
        ),
    ] = False,
    empty_room: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Live: for so long nobody is in the images; then somebody may come to the start."
        ),
    ] = None,
    late: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=MS",
            help="Live: a camera whose pictures show what was so many milliseconds ago when they come, as of network "
            "cameras; may be repeated.",
        ),
    ] = None,
    seconds: Seconds = None,
    fourcc: Fourcc = None,
    no_steadiness: Annotated[
        bool, typer.Option("--no-steadiness", help="Fit every frame for itself: without the penalty on jitter.")
    ] = False,
    json: JsonOut = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the joints' angles over time, where matplotlib is installed."),
    ] = None,
    beside: Annotated[
        Path | None, typer.Option(metavar="FILE", help="In the plot, beside an earlier result of this command.")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR|FILE.mp4",
            help="Write the images with the models' outlines, and the images' where they are outside (red) or inside "
            "(blue) of them.",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="TAKE",
            help="Record a take that refers to the videos; `mocapella replay` tracks it again.",
        ),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser meanwhile, and until Ctrl-C.")] = False,
    view_port: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="View port; by default 7448, or a free one.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the view's URL, open no browser.")] = False,
) -> None:
    """Fit body models to the silhouettes of one or several people in videos of calibrated cameras, or live.

    docs/silhouettes.md describes how to film, what a start is, the results, and what the messages mean.

    Example:  mocapella track silhouettes cam1.mp4 cam2.mp4 --rig rig.toml --start joints.json --json out.json

    Live:  mocapella track silhouettes a=camera:0 b=camera:2 --start joints.json --empty-room 3 --view --json out.json
    """
    need_cameras("track silhouettes")
    from mocapella.cli.silhouette_live import LiveWishes, wait_for_people
    from mocapella.cli.silhouette_result import SilhouetteResult, show
    from mocapella.cli.silhouette_start import StartWishes, check_seen, find_start, learn
    from mocapella.cli.silhouette_take import recorded
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.bodies_file import read_followed_people
    from mocapella.sources.video import parse_frames

    live_wishes = LiveWishes(
        _inputs(sources, hz), live, hz, other_size, fourcc, empty_room, seconds, frames, background or (), late or ()
    )
    live_wishes.verify()
    wanted = parse_frames(frames)
    earlier = None if beside is None else read_followed_people(beside)
    wishes = StartWishes(start or (), points or (), model or (), height or (), order)
    with ExitStack() as closing:
        with working("reading …", status=INTERRUPTED), telling_of_compiling("the method silhouettes"):
            cameras = load_camera_rig(rig)
            shown = _opened(live_wishes, cameras, wanted, closing)
            tell: list[Callable[[Step], None]] = []
            if overlay is not None:
                writer = _Overlays(overlay, shown, wanted.step)
                closing.callback(writer.close)
                tell.append(writer.write)
            found = find_start(wishes, cameras, wanted)
            bodies = {name: body.starting(pose) for name, (body, pose) in found.items()}
            check_seen(bodies, shown.rig, ", ".join(start or ["--points"]))
            if record is None:
                run = _started(bodies, shown, live_wishes, wanted, steady=not no_steadiness)
            else:
                take = recorded(record, found, shown, live_wishes, wanted, steady=not no_steadiness)
                closing.callback(take.close)
                run = take.run
            if background:
                learn(run, background, cameras, shown, other_size)
        if live_wishes.live and (background or empty_room is not None):
            wait_for_people(run, shown, empty_room, view=view)
        with stop_on_signals() as stop, telling_of_compiling("the method silhouettes"):
            page = None
            if view:
                page = open_view(run, view_port, no_browser=no_browser)
                closing.callback(page.close)
                tell.append(page.tell)
            whose = {name: body for name, (body, _) in found.items()}
            result = closing.enter_context(SilhouetteResult(json, plot, whose, shown, rig, steady=not no_steadiness))
            whole = _follow(run, shown, stop, seconds, [result.keep, *tell])
            result.finish(run, shown)
            if json != "-":
                show(run, Console(highlight=False), shown.summary())
            result.draw(earlier, str(beside))
            if page is not None and whole and not (stop.is_set() or seconds is not None):
                say("the view stays until Ctrl-C")
                page.stay(stop)
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)


def _opened(wishes: LiveWishes, cameras: CameraRig, wanted: Frames, closing: ExitStack) -> FrameSource:
    """The cameras, or the videos."""
    from mocapella.cli.silhouette_live import open_live
    from mocapella.sources.video_set import VideoSet

    if wishes.live:
        return closing.enter_context(open_live(wishes, cameras))
    paths = {name: Path(path) for name, path in wishes.sources.items()}
    return VideoSet(paths, cameras, frames=wanted, rate_hz=wishes.hz, other_size=wishes.other_size)


def _started(
    bodies: Mapping[str, InitialBody], shown: FrameSource, wishes: LiveWishes, wanted: Frames, *, steady: bool
) -> SilhouetteRun:
    """The run, before its first frame. Of videos, who starts is there; before live cameras they may have to come."""
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.tracker.frame_sync import FrameSyncSettings
    from mocapella.tracker.silhouette_settings import SilhouetteSettings
    from mocapella.tracker.silhouettes import SilhouettesTracker

    tracker = SilhouettesTracker(
        bodies,
        shown.rig,
        SilhouetteSettings() if steady else SilhouetteSettings(steadiness=None),
        sync=FrameSyncSettings(period_s=wanted.step / shown.rate_hz),
        empty_room_s=wishes.empty_room_s or 0.0,
        waiting=wishes.live and bool(wishes.background),
    )
    run = SilhouetteRun(tracker, say)
    for note in shown.notes:
        run.note(note)
    return run


def _inputs(sources: Sequence[str] | None, hz: float | None) -> dict[str, str]:
    """Videos or cameras by name; the rate is looked at, too."""
    from mocapella.cli.calibrate import named_inputs
    from mocapella.settings import check

    check(hz is None or 0 < hz <= 1000, "--hz", hz, "above 0, at most 1000")
    if not sources:
        raise SettingsError(
            "no videos are named; name one for each camera: mocapella track silhouettes cam1.mp4 cam2.mp4 …"
        )
    return named_inputs(sources)


def open_view(run: SilhouetteRun, port: int | None, *, no_browser: bool) -> SilhouetteView:
    """Serve the view, say where, and open it."""
    from mocapella.cli.demo import choose_port
    from mocapella.cli.serve import say_url
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
    """Frame by frame; False where it was stopped before the end. Live cameras have no other end."""
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
        """One step's."""
        self._writer.write(step.frame, step.pictures())

    def close(self) -> None:
        """Finish."""
        self._writer.close()
